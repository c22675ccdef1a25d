"""A plan as it must be: from its path, what the verifier says, and what only its planner knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.files.run_json import PlannedRecord, ReleasedRecord
from planopt.planning.files.solution_json import PlanRecord
from planopt.planning.files.team_solution_json import RobotPlanRecord
from planopt.planning.message import plan_message
from planopt.planning.plan import Pivot, Plan, Rung, Termination
from planopt.planning.proof.verify import Judgement
from planopt.planning.worth.reach_cost import ReachCost
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive


@dataclass(frozen=True)
class Effort:
    """Wall times and iterations, which nothing proves.

    Attributes
    ----------
    wall_s, solve_s, iterations
        As in :class:`planopt.planning.plan.Plan`.
    """

    wall_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0


def rebuilt_reach_plan(
    problem: Problem,
    path_m: NDArray[np.float64],
    judgement: Judgement,
    record: PlanRecord | ReleasedRecord,
    effort: Effort,
    drive: Drive | None = None,
) -> Plan:
    """The plan to a goal, by a path (N + 1, 2) with the robot's own place first.

    Parameters
    ----------
    problem
        What was asked.
    path_m
        The path, from the file.
    judgement
        What the verifier says of it.
    record
        Rung, termination, lattice objective and pivot are taken from it.
    effort
        Taken as it is.
    drive
        How the robot drives along the path; None for the single integrator.
    """
    pivot = None
    if record.pivot is not None:
        place = np.array([record.pivot.x_m, record.pivot.y_m])
        pivot = Pivot(place, record.pivot.cost_m, record.pivot.metre_cost)
    ahead = None if pivot is None else partial(_pivot_itself, pivot)
    priced = record.rung != Rung.DIRECT.value
    cost = ReachCost(problem, path_m[0], _certified(judgement), ahead, priced)
    cost_s = cost(path_m[1:], drive)
    return rebuilt_plan(problem, path_m, judgement, record, effort, cost_s, pivot, drive)


def _certified(judgement: Judgement) -> Callable[[NDArray[np.float64]], Prediction]:
    """The power along the judged path."""
    power = judgement.power
    if power is None:
        raise AssertionError("places in files are finite")
    return lambda _: power


def _pivot_itself(pivot: Pivot, _end_m: NDArray[np.float64]) -> Pivot:
    return pivot


def rebuilt_plan(
    problem: Problem,
    path_m: NDArray[np.float64],
    judgement: Judgement,
    record: PlanRecord | PlannedRecord | RobotPlanRecord,
    effort: Effort,
    objective: float,
    pivot: Pivot | None = None,
    drive: Drive | None = None,
) -> Plan:
    """The plan of any task; parameters as in :func:`rebuilt_reach_plan`.

    Parameters
    ----------
    problem, path_m, judgement, record, effort
        As there; the problem has one robot.
    objective
        What the path is worth.
    pivot
        The way beyond the horizon that this charges.
    drive
        How the robot drives along the path; None for the single integrator.
    """
    power = judgement.power
    if power is None:
        raise AssertionError("places in files are finite")
    return Plan(
        robot=problem.robots[0].name,
        t_s=problem.planner.step_s * np.arange(len(path_m), dtype=np.float64),
        positions_m=path_m,
        mean_dbm=power.mean_db,
        deviation_db=power.deviation_db,
        connectivity=connection_probability(
            power.mean_db, power.deviation_db, problem.stations[0].threshold_dbm
        ),
        objective=objective,
        lattice_objective=record.lattice_objective,
        termination=Termination(record.termination),
        verdict=judgement.verdict,
        rung=Rung(record.rung),
        certificate=judgement.certificate,
        wall_s=effort.wall_s,
        solve_s=effort.solve_s,
        iterations=effort.iterations,
        message=plan_message(judgement.certificate, path_m),
        pivot=pivot,
        sense=problem.sense,
        drive=drive,
    )
