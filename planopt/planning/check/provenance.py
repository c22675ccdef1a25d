"""What a plan says of how it was found must fit together, and fit its path.

None of it can be computed again without planning again: which rung released a plan, why the solver
stopped, how long it took. But a rung says something of the path, and a termination of the rung.
"""

from __future__ import annotations

import numpy as np

from planopt.planning.check.agreement import EXACT
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem

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
"""Terminations of plans for which no solver ran, and the rungs that these come from."""

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
    """Key and reason for everything in a rebuilt plan's provenance that cannot be so.

    Parameters
    ----------
    problem
        What was asked.
    plan
        The plan.
    previous
        The plan that the step before was the first of; None if there is none.
    """
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
    """Whether a plan stops: at once, by braking, or after the rest of the last one."""
    if plan.drive is None:
        return bool(np.abs(plan.positions_m - plan.positions_m[0]).max() <= EXACT)
    braking = plan.drive.dynamics.braking(
        plan.drive.states[0], problem.planner.step_s, len(plan.drive.inputs)
    )
    if np.abs(braking - plan.drive.inputs).max() <= EXACT:
        return True
    return previous is not None and _is_shifted(problem, plan, previous)


def _is_one_step(plan: Plan) -> bool:
    """Whether a plan moves in its first step alone."""
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
    """How far from its bound a row may be: metres of a place, their squares of a step; from 1."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return max(1.0, np.hypot(x_max - x_min, y_max - y_min), problem.step_length_m**2)


def _is_unpolished(problem: Problem) -> bool:
    return not planner_kind(problem.planner.name).solves


def _objective_faults(problem: Problem, plan: Plan) -> list[tuple[str, str]]:
    """Of a sum of terms: a path found without the lattice is compared with itself."""
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
    """Where nothing was polished, the two objectives are one."""
    if abs(plan.lattice_objective - plan.objective) <= EXACT * max(1.0, abs(plan.objective)):
        return []
    return [
        (
            "lattice_objective",
            f"{plan.lattice_objective:.9g}, but nothing was polished and the objective is "
            f"{plan.objective:.9g}",
        )
    ]
