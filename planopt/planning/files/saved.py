"""A plan or a run as a folder: ``plan.json`` or ``run.json``, ``steps.csv`` and ``belief.npz``.

The files of a folder are replaced together (:mod:`planopt.files.result_folder`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.files.result_folder import ResultFiles, replaced_results
from planopt.files.whole import strict_text, write_text
from planopt.planning.files.belief_file import BELIEF_FILE, write_belief
from planopt.planning.files.run_json import released_plans_json, simulation_json
from planopt.planning.files.solution_json import solution_json
from planopt.planning.files.steps_file import STEPS_FILE, steps_of_plan, steps_of_run, steps_text
from planopt.planning.loop.simulation import Simulation
from planopt.planning.solution import Solution
from planopt.planning.team.team_tables import KNOWLEDGE_FILE, TARGET_FILE
from planopt.problems.problem import Problem
from planopt.problems.save import problem_to_dict

PLAN_FILE, RUN_FILE = "plan.json", "run.json"

PLAN_OR_RUN = ResultFiles(
    "plan_or_run",
    (
        *(PLAN_FILE, RUN_FILE, STEPS_FILE, BELIEF_FILE, "belief_*.npz", TARGET_FILE),
        *(KNOWLEDGE_FILE, "plan.png", "run.png", "run.gif", "series.png", "belief.png"),
    ),
)
"""The files of a plan or run with its pictures: a folder has one of either."""


def save_solution(solution: Solution, folder: Path, *, pictures_follow: bool = False) -> None:
    """Save a plan so that it can be judged from its files alone.

    It replaces the plan or run that the folder had, with its pictures.

    Parameters
    ----------
    solution
        The plan.
    folder
        Made if it is missing.
    pictures_follow
        Whether pictures will be added (:func:`planopt.files.result_folder.added_results`).

    Raises
    ------
    OutputError
        The folder cannot be written; what it had is still there.
    """
    with replaced_results(folder, PLAN_OR_RUN, pictures_follow=pictures_follow) as new:
        write_text(new / STEPS_FILE, steps_text(steps_of_plan(solution.plan)))
        write_belief_of_plan(new / BELIEF_FILE, solution.belief)
        write_record(solution_json(solution), solution.problem, new / PLAN_FILE)


def save_simulation(simulation: Simulation, folder: Path, *, pictures_follow: bool = False) -> None:
    """Save a run so that every released plan can be judged from its files alone.

    Parameters and errors are those of :func:`save_solution`.
    """
    run = simulation.run
    data = {**simulation_json(simulation), "plans": released_plans_json(simulation.plans)}
    with replaced_results(folder, PLAN_OR_RUN, pictures_follow=pictures_follow) as new:
        write_text(new / STEPS_FILE, steps_text(steps_of_run(run.robot, run.log, run.drive)))
        write_belief_of_run(
            new / BELIEF_FILE,
            simulation.belief,
            simulation.first_measurements,
            run.log.positions_m,
        )
        write_record(data, simulation.problem, new / RUN_FILE)


def save_no_plan(data: dict[str, Any], problem: Problem, folder: Path, name: str) -> None:
    """Save that there is no plan, as `PLAN_FILE` or `RUN_FILE`, in place of what there was.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    with replaced_results(folder, PLAN_OR_RUN) as new:
        write_record(data, problem, new / name)


def write_record(data: dict[str, Any], problem: Problem, path: Path) -> None:
    """Write a JSON object with the problem in full beside its keys."""
    write_text(path, strict_text({**data, "problem_file": problem_to_dict(problem)}))


def write_belief_of_plan(path: Path, belief: Belief) -> None:
    """Save what a plan was made from."""
    nothing = np.zeros(0, dtype=np.int64)
    write_belief(path, belief, nothing, [nothing] * len(belief.further))


def write_belief_of_run(
    path: Path, belief: Belief, first: int, track_m: NDArray[np.float64]
) -> None:
    """Save what was known at the end of a run, and how much of it before each step.

    Parameters as in :func:`known_before_steps`.
    """
    further = [known_before_steps(own, own.fit.measurements, track_m) for own in belief.further]
    write_belief(path, belief, known_before_steps(belief, first, track_m), further)


def known_before_steps(
    belief: Belief, first: int, track_m: NDArray[np.float64]
) -> NDArray[np.int64]:
    """How many measurements each step was planned on; ``(steps,)``.

    Measurements of the run are taken at the places driven to, in order, each place at most once
    a visit; so going along both finds the step of each.

    Parameters
    ----------
    belief
        At the end of the run.
    first
        How many of its measurements were there before the run.
    track_m
        ``(steps + 1, 2)`` the places, the start first.
    """
    taken = belief.posterior.measurements.positions_m
    count = first
    known: list[int] = []
    for place in track_m[1:]:
        known.append(count)
        if count < len(taken) and np.array_equal(taken[count], place):
            count += 1
    return np.array(known, dtype=np.int64)
