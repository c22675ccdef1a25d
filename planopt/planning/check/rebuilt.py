"""A plan as it must be: from its path, what the verifier says, and what only its planner knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.mapping import Region
from planopt.planning.files.run_json import ReleasedRecord
from planopt.planning.files.solution_json import RobotPlanRecord
from planopt.planning.ground_reasons import obstacles_met
from planopt.planning.message import plan_message
from planopt.planning.plan import Pivot, Plan, Rung, Termination
from planopt.planning.proof.circumstances import Circumstances
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.verify import judge
from planopt.planning.robot_problem import problem_at
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.path_worth import PathWorth
from planopt.planning.worth.reach_cost import ReachCost
from planopt.planning.worth.region import workspace_region
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import steering_way
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex, index_obstacles


@dataclass(frozen=True, eq=False)
class Place:
    """Geometry that all plans of a problem share.

    Attributes
    ----------
    index
        The obstacles.
    region
        Where the map is wanted; None on the way to a goal.
    """

    index: ObstacleIndex
    region: Region | None

    @classmethod
    def of(cls, problem: Problem) -> Place:
        """Return the geometry of a problem."""
        region = None if problem.task == "reach" else workspace_region(problem)
        return cls(index_obstacles(problem.workspace), region)


def places_of(problem: Problem, steps: int) -> list[Place]:
    """Return the geometry that each of so many steps is planned in, the same where it stays."""
    now = problem_at(problem, 0)
    found = [Place.of(now)]
    for step in range(1, steps):
        then = problem_at(now, step)
        found.append(found[-1] if then is now else Place.of(then))
        now = then
    return found


def obstacles_met_then(
    problem: Problem, places: Sequence[Place], track_m: NDArray[np.float64]
) -> list[str]:
    """A reason for every place of a track that was not clear of the obstacles known then."""
    changes = [k for k in range(1, len(places)) if places[k] is not places[k - 1]]
    reasons: list[str] = []
    for first, last in pairwise([0, *changes, len(track_m) - 1]):
        met = obstacles_met(problem, places[first].index, track_m[first : last + 1], first)
        reasons += [reason for reason in met if reason not in reasons]
    return reasons


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


@dataclass(frozen=True, eq=False)
class Asked:
    """Context of one plan of one robot.

    Attributes
    ----------
    problem
        With this robot alone.
    place
        Its geometry.
    posteriors
        Channel estimate of each station when the plan was made.
    state
        ``(s,)`` of the robot then.
    aim
        External inputs of the objective.
    circumstances
        What else was known then.
    """

    problem: Problem
    place: Place
    posteriors: Sequence[ChannelPosterior]
    state: NDArray[np.float64]
    aim: Aim
    circumstances: Circumstances


def rebuilt_plan(
    asked: Asked,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    record: RobotPlanRecord | ReleasedRecord,
    residual: float | None,
    effort: Effort,
) -> Plan:
    """Return the plan of a path (N + 1, 2) with the robot's own place first.

    Parameters
    ----------
    asked
        Its context.
    path_m, drive
        The path from the file, and how the robot drives along it; None for the single integrator.
    record
        Rung, termination, lattice objective and pivot are taken from it.
    residual
        KKT residual of the path, if a solver found it.
    effort
        Taken as it is.
    """
    problem = asked.problem
    judgement = judge(
        problem,
        asked.place.index,
        asked.posteriors[0],
        asked.state,
        path_m,
        residual,
        asked.circumstances,
        drive,
    )
    power = judgement.power
    if power is None:
        raise AssertionError("places in files are finite")
    pivot = None
    if record.pivot is not None:
        place = np.array([record.pivot.x_m, record.pivot.y_m])
        pivot = Pivot(place, record.pivot.cost_m, record.pivot.metre_cost)
    if problem.task == "reach":
        objective = _reach_cost(asked, path_m, drive, power, pivot, record.rung)
    else:
        objective = _worth(asked, path_m)
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


def _reach_cost(
    asked: Asked,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    power: Prediction,
    pivot: Pivot | None,
    rung: str,
) -> float:
    """Return the cost of a path to a goal, at the power that the verifier predicted along it."""

    def certified(places_m: NDArray[np.float64]) -> Prediction:
        if np.array_equal(places_m, path_m):
            return power
        return search_prediction(asked.posteriors[0], places_m, asked.circumstances.broad)

    ahead = None if pivot is None else partial(_pivot_itself, pivot)
    priced = rung != Rung.DIRECT.value
    cost = ReachCost(asked.problem, path_m[0], certified, ahead, priced)
    return cost(path_m[1:], drive)


def _pivot_itself(pivot: Pivot, _end_m: NDArray[np.float64]) -> Pivot:
    return pivot


def _worth(asked: Asked, path_m: NDArray[np.float64]) -> float:
    """Return the weighted sum of the terms of a path."""
    problem, turns, region = asked.problem, asked.aim.steering_turns_m, asked.place.region
    if region is None:
        raise AssertionError("terms have a region")
    steering = None
    if turns is not None:
        steering = steering_way(problem, asked.place.index, turns)
    at = Situation(
        problem,
        asked.posteriors[0],
        path_m[0],
        asked.aim.target_m,
        region,
        steering,
        asked.aim.information,
        circumstances=asked.circumstances,
        pending=asked.aim.pending,
    )
    return PathWorth(at)(path_m[1:])
