"""When a closed loop ends: at the goal, at a standstill, or after the steps that it may take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.arrival import is_at_goal, stands
from planopt.planning.loop.run import Outcome
from planopt.planning.plan import Plan, Rung
from planopt.planning.tolerances import STANDSTILL_M
from planopt.problems.problem import Problem

STALL_STEPS = 30
"""A robot that learns nothing new for this many steps and stays within two longest steps of one
place has stalled."""


def ending(
    problem: Problem,
    track: Sequence[NDArray[np.float64]],
    learnt: Sequence[bool],
    plan: Plan | None,
) -> tuple[Outcome, str] | None:
    """How a run ends where its track does, and why in words; None if it goes on.

    Parameters
    ----------
    problem
        A problem that is to reach a goal.
    track
        States (s,) of the robot, its place first; of a single integrator its place. The start
        comes first.
    learnt
        Whether something was measured after each step.
    plan
        The plan whose first step was the last one; None at the start.
    """
    here = track[-1]
    if is_at_goal(problem, here[:2]) and stands(problem, here):
        where = "the start is within" if plan is None else "within"
        return Outcome.REACHED, f"{where} goal_radius_m of the goal"
    if plan is not None and not any(learnt[-STALL_STEPS:]):
        if _circling(track, problem.step_length_m) and not problem.workspace.moving:
            return Outcome.STALLED, (
                f"within {2 * problem.step_length_m:g} m of one place for {STALL_STEPS} steps, "
                f"with nothing new to learn{_detail(plan)}"
            )
    if len(learnt) >= problem.planner.max_steps:
        return Outcome.STEP_LIMIT, f"not arrived after {problem.planner.max_steps} steps"
    return None


def standstill(
    problem: Problem,
    track: Sequence[NDArray[np.float64]],
    learnt: Sequence[bool],
    plan: Plan,
    *,
    alone: bool = True,
) -> str | None:
    """Why a robot that stands still or circles will go on doing so, in words; None if it may not.

    Parameters
    ----------
    problem, track, learnt
        As in :func:`ending`; at least one step was driven.
    plan
        The plan whose first step was the last one.
    alone
        Whether nothing else that plans depend on changes while the robot stands.
    """
    stood = bool(np.linalg.norm((track[-1] - track[-2]) * _unit_m(problem)) <= STANDSTILL_M)
    # Same place, same belief, and nothing that moves: the next plan would be this one again.
    again = plan.rung is not Rung.SHIFTED and not problem.workspace.moving and alone
    if stood and not learnt[-1] and again:
        return f"standing still with nothing new to learn{_detail(plan)}"
    if not any(learnt[-STALL_STEPS:]) and _circling(track, problem.step_length_m):
        return (
            f"within {2 * problem.step_length_m:g} m of one place for {STALL_STEPS} steps, "
            f"with nothing new to learn{_detail(plan)}"
        )
    return None


def _unit_m(problem: Problem) -> NDArray[np.float64]:
    """What makes metres of a state."""
    dynamics = problem.robots[0].dynamics
    return np.ones(2) if dynamics is None else np.array(dynamics.unit_m(problem.planner.step_s))


def _circling(track: Sequence[NDArray[np.float64]], step_length_m: float) -> bool:
    if len(track) <= STALL_STEPS:
        return False
    recent = np.array(track[-STALL_STEPS - 1 :])[:, :2]
    return bool(np.linalg.norm(recent - recent[0], axis=1).max() <= 2.0 * step_length_m)


def _detail(plan: Plan) -> str:
    return f": {plan.message}" if plan.message else ""
