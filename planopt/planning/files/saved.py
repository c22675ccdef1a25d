"""A plan or a run as a folder: ``plan.json`` or ``run.json``, ``steps.csv`` and ``belief.npz``.

The files of a folder are replaced together (:mod:`planopt.files.result_folder`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.files.result_folder import replaced_results
from planopt.files.whole import strict_text, write_text
from planopt.planning.files.belief_file import BELIEF_FILE, write_belief
from planopt.planning.files.run_json import released_plans_json, run_json
from planopt.planning.files.solution_json import solution_json
from planopt.planning.files.steps_file import (
    KNOWLEDGE_FILE,
    STEPS_FILE,
    TARGET_FILE,
    joined_steps,
    run_tables,
    steps_of_plan,
    steps_of_run,
    steps_text,
    table_text,
)
from planopt.planning.run import Run
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem
from planopt.problems.save import problem_to_dict

PLAN_FILE, RUN_FILE = "plan.json", "run.json"

PLAN_OR_RUN = (
    *(PLAN_FILE, RUN_FILE, STEPS_FILE, BELIEF_FILE, "belief_*.npz", TARGET_FILE),
    *(KNOWLEDGE_FILE, "plan.png", "run.png", "run.gif", "series.png", "belief.png"),
)
"""The files of a plan or run with its pictures: a folder has one of either."""

FORMAT = 2
"""Of ``plan.json`` and ``run.json``; files without the key ``format`` are of format 1."""


def belief_files(problem: Problem) -> tuple[str, ...]:
    """Return the names of the files that a run's beliefs are saved as, by robot."""
    if len(problem.robots) == 1:
        return (BELIEF_FILE,)
    return tuple(f"belief_{robot.name}.npz" for robot in problem.robots)


def save_solution(solution: Solution, folder: Path) -> None:
    """Save plans so that they can be judged from their files alone.

    They replace the plan or run that the folder had, with its pictures.
    """
    steps = joined_steps([steps_of_plan(plan) for plan in solution.plans])
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_text(new / STEPS_FILE, steps_text(steps))
        write_belief_of_plan(new / BELIEF_FILE, solution.belief)
        write_result(solution_json(solution), solution.problem, new / PLAN_FILE)


def save_run(run: Run, folder: Path) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Parameters and errors are those of :func:`save_solution`. Each robot has a belief of its own.
    """
    problem = run.problem
    steps = joined_steps([steps_of_run(one.robot, one.log, one.drive) for one in run.runs])
    data = {**run_json(run), "plans": released_plans_json(run)}
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_text(new / STEPS_FILE, steps_text(steps))
        tracks = [one.log.positions_m for one in run.runs]
        for name, belief, track in zip(belief_files(problem), run.beliefs, tracks, strict=True):
            theirs = tracks if problem.channel.share_measurements else [track]
            write_belief_of_run(new / name, belief, run.first_measurements, theirs)
        for name, table in run_tables(run).items():
            write_text(new / name, table_text(table))
        write_result(data, problem, new / RUN_FILE)


def save_no_plan(
    data: dict[str, Any],
    problem: Problem,
    folder: Path,
    name: str,
) -> None:
    """Save that there is no plan, as `PLAN_FILE` or `RUN_FILE`, in place of what there was."""
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_result(data, problem, new / name)


def write_result(data: dict[str, Any], problem: Problem, path: Path) -> None:
    """Write the JSON object of a plan or run with its format and the problem in full."""
    write_record({"format": FORMAT, **data}, problem, path)


def write_record(data: dict[str, Any], problem: Problem, path: Path) -> None:
    """Write a JSON object with the problem in full beside its keys."""
    write_text(path, strict_text({**data, "problem_file": problem_to_dict(problem)}))


def write_belief_of_plan(path: Path, belief: Belief) -> None:
    """Save what a plan was made from."""
    nothing = np.zeros(0, dtype=np.int64)
    write_belief(path, belief, nothing, [nothing] * len(belief.further))


def write_belief_of_run(
    path: Path, belief: Belief, first: int, tracks_m: Sequence[NDArray[np.float64]]
) -> None:
    """Save what was known at the end of a run, and how much of it before each step.

    Parameters as in :func:`known_before_steps`.
    """
    further = [known_before_steps(own, own.fit.measurements, tracks_m) for own in belief.further]
    write_belief(path, belief, known_before_steps(belief, first, tracks_m), further)


def known_before_steps(
    belief: Belief, first: int, tracks_m: Sequence[NDArray[np.float64]]
) -> NDArray[np.int64]:
    """Return how many measurements each step was planned on; ``(steps,)``.

    Measurements of the run are taken at the places driven to, in order, each place at most once
    a visit; so going along both finds the step of each.
    """
    # Shapes: tracks_m (steps + 1, 2).
    taken = belief.posterior.measurements.positions_m
    count = first
    known: list[int] = []
    for places in list(zip(*tracks_m, strict=True))[1:]:
        known.append(count)
        for place in places:
            if count < len(taken) and np.array_equal(taken[count], place):
                count += 1
    return np.array(known, dtype=np.int64)
