"""Rebuild the fields of a saved plan from its path and the verifier, and judge its provenance.

Only planning again could compute the provenance: which fallback released the plan, why the solver
stopped, how long it took. But a fallback says something of the path, and a termination something of
the fallback, so that combinations which cannot be are found.
"""

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
from planopt.planning.certificate import plan_message
from planopt.planning.check.agreement import EXACT
from planopt.planning.files.run_json import ReleasedRecord
from planopt.planning.files.solution_json import RobotPlanRecord
from planopt.planning.free_space import obstacles_met
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict
from planopt.planning.proof.circumstances import Circumstances
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.proof.verify import judge
from planopt.planning.worth.left_to_learn import workspace_region
from planopt.planning.worth.path_worth import PathWorth
from planopt.planning.worth.reach_cost import ReachCost
from planopt.planning.worth.situation import Aim, Situation
from planopt.planning.worth.steering_way import steering_way
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem, problem_at
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex, index_obstacles

UNSOLVED = {
    Termination.LATTICE_ONLY: (
        Rung.PLAN,
        Rung.LATTICE,
        Rung.COLD_RETRY,
        Rung.RELAXED,
        Rung.DIRECT,
        Rung.GIVE_WAY,
    ),
    Termination.STOPPED: (Rung.SHIFTED, Rung.RESERVED),
    Termination.NO_PATH: (Rung.STOP, Rung.LEAVE),
}
"""Terminations of plans for which no solver ran, and the fallbacks that these come from."""

SOLVED = (Termination.CONVERGED, Termination.ACCEPTABLE)
"""Terminations of a solver that met its tolerance."""

SOLVED_RESIDUAL, LARGEST_RESIDUAL = 1.0, 1e12
"""Largest KKT residual of a path that a solver accepted, for each unit of the objective and of the
distance from the bounds that its multipliers are multiplied by, and of any path, for each unit of
the objective: those of the problem library are below 0.03."""

WITHOUT_SEARCH = (Rung.SHIFTED, Rung.RESERVED, Rung.LEAVE, Rung.STOP)
"""Rungs whose paths no search found."""

POLISHED = (Rung.PLAN, Rung.COLD_RETRY, Rung.RELAXED)
"""Rungs whose paths a solver may have found."""


def provenance_faults(problem: Problem, plan: Plan, previous: Plan | None) -> list[tuple[str, str]]:
    """Key and reason for everything in a rebuilt plan's provenance that cannot be so."""
    return [
        *_rung_faults(problem, plan, previous),
        *_termination_faults(problem, plan),
        *(_reach_faults if problem.task == "reach" else _objective_faults)(problem, plan),
    ]


def _rung_faults(problem: Problem, plan: Plan, previous: Plan | None) -> list[tuple[str, str]]:
    rung = plan.rung
    faults: list[str] = []
    if rung is Rung.STOP and not _is_stop(problem, plan, previous):
        faults.append(
            "the path does not stand still" if plan.drive is None else "the robot does not stop"
        )
    if rung is Rung.LEAVE and (plan.verdict is not Verdict.VIOLATED or not _is_one_step(plan)):
        faults.append("the path is no single step from where the robot must not be")
    if rung is Rung.SHIFTED and (
        previous is None
        or previous.verdict is not Verdict.VERIFIED
        or not _is_shifted(problem, plan, previous)
    ):
        faults.append("the path is not the rest of a verified plan before it")
    if rung is Rung.RESERVED and not (previous and _is_shifted(problem, plan, previous)):
        faults.append("the path is not the rest of the plan before it")
    if rung is Rung.RELAXED and not plan.certificate.relaxed_steps:
        faults.append("every step meets constraints.p_min")
    # The bound of another task may be given up where the way to a goal would be searched for.
    if rung is Rung.LATTICE and problem.task == "reach" and plan.certificate.relaxed_steps:
        faults.append("a step does not meet constraints.p_min")
    alone = rung is Rung.COLD_RETRY and not planner_kind(problem.planner.name).searches
    if alone or (rung is Rung.LATTICE and _is_unpolished(problem)):
        faults.append(f"planner.name is {problem.planner.name}, which has no such rung")
    return [("rung", f"{rung.value}, but {fault}") for fault in faults]


def _is_stop(problem: Problem, plan: Plan, previous: Plan | None) -> bool:
    """Return whether a plan stops: at once, by braking, or after the rest of the last one."""
    if plan.drive is None:
        return bool(np.abs(plan.positions_m - plan.positions_m[0]).max() <= EXACT)
    braking = plan.drive.dynamics.braking(
        plan.drive.states[0], problem.planner.step_s, len(plan.drive.inputs)
    )
    if np.abs(braking - plan.drive.inputs).max() <= EXACT:
        return True
    return previous is not None and _is_shifted(problem, plan, previous)


def _is_one_step(plan: Plan) -> bool:
    """Return whether a plan moves in its first step alone."""
    return bool(np.abs(np.diff(plan.positions_m[1:], axis=0)).max(initial=0.0) <= EXACT)


def _is_shifted(problem: Problem, plan: Plan, previous: Plan) -> bool:
    if plan.drive is None or previous.drive is None:
        return _is_rest(plan, previous)
    last = plan.drive.dynamics.braking(previous.drive.states[-1], problem.planner.step_s, 1)
    inputs = np.vstack([previous.drive.inputs[1:], last])
    same = inputs.shape == plan.drive.inputs.shape
    return same and bool(np.abs(inputs - plan.drive.inputs).max() <= EXACT)


def _is_rest(plan: Plan, previous: Plan | None) -> bool:
    if previous is None:
        return False
    rest = np.vstack([previous.positions_m[1:], previous.positions_m[-1:]])
    return rest.shape == plan.positions_m.shape and np.abs(rest - plan.positions_m).max() <= EXACT


def _termination_faults(problem: Problem, plan: Plan) -> list[tuple[str, str]]:
    termination, rung, residual = plan.termination, plan.rung, plan.certificate.kkt_residual
    if termination in UNSOLVED:
        faults: list[tuple[str, str]] = []
        if rung not in UNSOLVED[termination]:
            faults.append(("termination", f"{termination.value}, but the rung is {rung.value}"))
        if rung is Rung.PLAN and not _is_unpolished(problem):
            fault = f"{termination.value}, but planner.name is {problem.planner.name}"
            faults.append(("termination", fault))
        for key, value in (
            ("kkt_residual", residual),
            ("solve_s", plan.solve_s or None),
            ("iterations", plan.iterations or None),
        ):
            if value is not None:
                faults.append((key, f"{value:g}, but the termination is {termination.value}"))
        return faults
    if _is_unpolished(problem):
        fault = f"{termination.value}, but planner.name is {problem.planner.name}"
        return [("termination", fault)]
    if residual is None:
        return []
    # The shortest path is only polished for a robot that cannot turn or stop at will.
    if rung not in POLISHED and not (rung is Rung.DIRECT and plan.drive is not None):
        return [("kkt_residual", f"{residual:g}, but no solver found a path of rung {rung.value}")]
    most = SOLVED_RESIDUAL * _widest(problem) if termination in SOLVED else LARGEST_RESIDUAL
    if residual > most * max(1.0, abs(plan.objective)):
        return [("kkt_residual", f"{residual:g}, but the termination is {termination.value}")]
    return []


def _widest(problem: Problem) -> float:
    """Return how far from its bound a row may be: metres, or their squares of a step."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return max(1.0, np.hypot(x_max - x_min, y_max - y_min), problem.step_length_m**2)


def _is_unpolished(problem: Problem) -> bool:
    return not (problem.can_be_polished and planner_kind(problem.planner.name).solves)


def _objective_faults(problem: Problem, plan: Plan) -> list[tuple[str, str]]:
    """Check the objectives of a sum of terms; a path without the lattice is its own measure."""
    alone = plan.rung in WITHOUT_SEARCH or not planner_kind(problem.planner.name).searches
    return _unpolished_faults(plan) if alone else []


def _reach_faults(problem: Problem, plan: Plan) -> list[tuple[str, str]]:
    faults: list[tuple[str, str]] = []
    pivot = plan.pivot
    if pivot is None and plan.rung not in WITHOUT_SEARCH:
        faults.append(("pivot", f"null, but the rung is {plan.rung.value}"))
    if pivot is not None and problem.cost_to_go == "geodesic":
        straight = float(np.linalg.norm(pivot.position_m - np.asarray(problem.goal_m)))
        if pivot.cost_m < straight - EXACT:
            faults.append(
                (
                    "pivot.cost_m",
                    f"{pivot.cost_m:.9g}, but the goal is {straight:.9g} m away from the pivot",
                )
            )
    alone = plan.termination in UNSOLVED or plan.rung not in POLISHED
    # A robot that cannot turn or stop at will follows several ways, and all are compared with one.
    if alone if plan.drive is None else plan.rung in WITHOUT_SEARCH:
        faults += _unpolished_faults(plan)
    return faults


def _unpolished_faults(plan: Plan) -> list[tuple[str, str]]:
    """Check that the two objectives are one where nothing was polished."""
    if abs(plan.lattice_objective - plan.objective) <= EXACT * max(1.0, abs(plan.objective)):
        return []
    return [
        (
            "lattice_objective",
            f"{plan.lattice_objective:.9g}, but nothing was polished and the objective is "
            f"{plan.objective:.9g}",
        )
    ]


@dataclass(frozen=True, eq=False)
class Place:
    """Geometry that all plans of a problem share."""

    index: ObstacleIndex  # The obstacles
    region: Region | None  # Where the map is wanted; None on the way to a goal

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
    """Wall times and iterations, which nothing proves."""

    wall_s: float = 0.0  # As in :class:`planopt.planning.plan.Plan`
    solve_s: float = 0.0
    iterations: int = 0


@dataclass(frozen=True, eq=False)
class Asked:
    """Context of one plan of one robot."""

    problem: Problem  # With this robot alone
    place: Place  # Its geometry
    # Channel estimate of each station when the plan was made
    posteriors: Sequence[ChannelPosterior]
    state: NDArray[np.float64]  # (s,) of the robot then
    aim: Aim  # External inputs of the objective
    circumstances: Circumstances  # What else was known then


def rebuilt_plan(
    asked: Asked,
    path_m: NDArray[np.float64],
    drive: Drive | None,
    record: RobotPlanRecord | ReleasedRecord,
    residual: float | None,
    effort: Effort,
) -> Plan:
    """Return the plan of a path (N + 1, 2) with the robot's own place first."""
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
        held=asked.aim.held,
    )
    return PathWorth(at)(path_m[1:])
