"""A plan or a run as a folder: ``plan.json`` or ``run.json``, ``steps.csv`` and ``belief.npz``.

The files of a folder are replaced together (:mod:`planopt.files.result_folder`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from planopt.files.compare import DIGEST, digest
from planopt.files.result_folder import replaced_results
from planopt.files.tables import write_tables
from planopt.files.whole import strict_text, write_text
from planopt.planning.files.belief_file import BELIEF_FILE, belief_of_plan, beliefs_of_run, write
from planopt.planning.files.run_json import released_plans_json, run_json
from planopt.planning.files.run_tables import (
    KNOWLEDGE_FILE,
    STEPS_FILE,
    TARGET_FILE,
    run_tables,
    step_columns,
    steps_of_plans,
)
from planopt.planning.files.solution_json import solution_json
from planopt.problems.problem import Problem
from planopt.problems.save import problem_to_dict

if TYPE_CHECKING:
    from planopt.planning.run import Run
    from planopt.planning.solution import Solution

PLAN_FILE, RUN_FILE = "plan.json", "run.json"

PLAN_OR_RUN = (
    *(PLAN_FILE, RUN_FILE, STEPS_FILE, BELIEF_FILE, "belief_*.npz", TARGET_FILE),
    *(KNOWLEDGE_FILE, "plan.png", "run.png", "run.gif", "series.png", "belief.png"),
)
"""The files of a plan or run with its pictures: a folder has one of either."""

FORMAT = 3
"""Of ``plan.json`` and ``run.json``."""


def belief_files(problem: Problem) -> tuple[str, ...]:
    """Return the names of the files that a run's beliefs are saved as, by robot."""
    if len(problem.robots) == 1:
        return (BELIEF_FILE,)
    return tuple(f"belief_{robot.name}.npz" for robot in problem.robots)


def plan_data(solution: Solution) -> dict[str, Any]:
    """Return the contents of ``plan.json`` but for digest and problem."""
    return {"format": FORMAT, **solution_json(solution)}


def run_data(run: Run) -> dict[str, Any]:
    """Return the contents of ``run.json`` but for digest and problem."""
    return {"format": FORMAT, **run_json(run), "plans": released_plans_json(run)}


def save_solution(solution: Solution, folder: Path) -> None:
    """Save plans so that they can be judged from their files alone.

    They replace the plan or run that the folder had, with its pictures.
    """
    problem = solution.problem
    steps = step_columns(problem), steps_of_plans(problem, solution.plans)
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_tables(new, {STEPS_FILE: steps})
        write(new / BELIEF_FILE, belief_of_plan(solution.belief))
        write_result(plan_data(solution), problem, new / PLAN_FILE)


def save_run(run: Run, folder: Path) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Parameters and errors are those of :func:`save_solution`. Each robot has a belief of its own.
    """
    with replaced_results(folder, PLAN_OR_RUN) as new:
        for name, arrays in zip(belief_files(run.problem), beliefs_of_run(run), strict=True):
            write(new / name, arrays)
        write_tables(new, run_tables(run))
        write_result(run_data(run), run.problem, new / RUN_FILE)


def save_no_plan(
    data: dict[str, Any],
    problem: Problem,
    folder: Path,
    name: str,
) -> None:
    """Save that there is no plan, as `PLAN_FILE` or `RUN_FILE`, in place of what there was."""
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_result({"format": FORMAT, **data}, problem, new / name)


def write_result(data: dict[str, Any], problem: Problem, path: Path) -> None:
    """Write the JSON object of a plan or run with its digest and the problem in full."""
    tables = problem_to_dict(problem)
    write_text(path, strict_text({**data, DIGEST: digest(data), "problem_file": tables}))
