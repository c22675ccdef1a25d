"""Termination of a closed loop: task completed, robots stalled, or step limit reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.proof.motion import is_at_goal, stands
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import (
    NOTHING_PENDING,
    Pending,
    anticipated,
    counts_others,
    places_of_others,
)
from planopt.planning.values.exploration import learns, left_to_learn
from planopt.problems.problem import Problem
from planopt.world.clearance import index_obstacles
from planopt.world.lattice import build_lattice

STALL_STEPS = 30
"""Steps without new measurements, spent within two maximum step lengths, that count as a stall."""


@dataclass(frozen=True, eq=False)
class Progress:
    """Progress of one robot."""

    problem: Problem  # Problem restricted to this robot
    # States (s,), position first: at the start and after each step
    states: Sequence[NDArray[np.float64]]
    learnt: Sequence[bool]  # Whether each step brought a measurement
    plans: Sequence[Plan]  # The plan whose first step was executed, by step
    posteriors: Sequence[ChannelPosterior]  # Current belief about each station's channel


def run_ending(
    problem: Problem, connected: NDArray[np.bool_], robots: Sequence[Progress]
) -> tuple[Outcome, str] | None:
    """Return the outcome of a run after its latest step and the reason; None if it continues."""
    # Shapes: connected (steps, robots).
    if problem.task == "reach":
        return goals_ending(problem, robots)
    return terms_ending(problem, connected, robots) if len(connected) else None


def goals_ending(problem: Problem, robots: Sequence[Progress]) -> tuple[Outcome, str] | None:
    """Return the outcome of a run to goals, which continues while any robot does.

    Robots that have arrived or wait may still give way to others.
    """
    ends = [
        goal_ending(each.problem, each.states, each.learnt, each.plans[-1] if each.plans else None)
        for each in robots
    ]
    if len(robots) == 1:
        return ends[0]
    late = [
        each.problem.robots[0].name
        for each, end in zip(robots, ends, strict=True)
        if end is None or end[0] is not Outcome.REACHED
    ]
    if not late:
        return Outcome.REACHED, "all robots within goal_radius_m of their goals"
    if len(robots[0].learnt) >= problem.planner.max_steps:
        words = f"{', '.join(late)} not arrived after {problem.planner.max_steps} steps"
        return Outcome.STEP_LIMIT, words
    stay = all(_stays(each.states, each.problem.step_length_m) for each in robots)
    if None in ends or not stay:
        return None
    stuck = [
        (each, end[1])
        for each, end in zip(robots, ends, strict=True)
        if end is not None and end[0] is Outcome.STALLED
    ]
    return Outcome.STALLED, _in_words(problem, stuck)


def goal_ending(
    problem: Problem,
    track: Sequence[NDArray[np.float64]],
    learnt: Sequence[bool],
    plan: Plan | None,
) -> tuple[Outcome, str] | None:
    """Return the outcome of a run of one robot to its goal and the reason; None if it continues."""
    if _has_arrived(problem, track[-1]):
        where = "the start is within" if plan is None else "within"
        return Outcome.REACHED, f"{where} goal_radius_m of the goal"
    why = None if plan is None else _circling(problem, track, learnt, plan)
    if why is not None and not problem.workspace.moving:
        return Outcome.STALLED, why
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
    """Return why a robot will stand still or circle from now on; None if it may move on."""
    unit = np.array(problem.robots[0].dynamics.unit_m(problem.planner.step_s))
    stood = bool(np.linalg.norm((track[-1] - track[-2]) * unit) <= STANDSTILL_M)
    # A plan that moves after waiting gives the next plan another initial guess.
    waits = np.linalg.norm(plan.positions_m - plan.positions_m[0], axis=1).max() > STANDSTILL_M
    # At the same position, belief, obstacles and time, the next plan is the same.
    again = plan.rung is not Rung.SHIFTED and not problem.workspace.moving and alone
    again &= problem.planner.budget_s is None
    if stood and not waits and not learnt[-1] and again:
        return f"standing still with nothing new to learn{plan.message and ': ' + plan.message}"
    return _circling(problem, track, learnt, plan)


def _circling(
    problem: Problem,
    track: Sequence[NDArray[np.float64]],
    learnt: Sequence[bool],
    plan: Plan,
) -> str | None:
    """Return the reason if a robot stays near one position without new measurements, else None."""
    if any(learnt[-STALL_STEPS:]) or not _stays(track, problem.step_length_m):
        return None
    return (
        f"within {2 * problem.step_length_m:g} m of one place for {STALL_STEPS} steps, "
        f"with nothing new to learn{plan.message and ': ' + plan.message}"
    )


def _stays(track: Sequence[NDArray[np.float64]], step_length_m: float) -> bool:
    """Return whether a robot stayed within two steps of one position for `STALL_STEPS`."""
    if len(track) <= STALL_STEPS:
        return False
    recent = np.array(track[-STALL_STEPS - 1 :])[:, :2]
    return bool(np.linalg.norm(recent - recent[0], axis=1).max() <= 2.0 * step_length_m)


def terms_ending(
    problem: Problem, connected: NDArray[np.bool_], robots: Sequence[Progress]
) -> tuple[Outcome, str] | None:
    """Return the outcome of a run for a sum of terms, as :func:`run_ending`.

    The run ends if all robots that are to connect are connected, if all with goals have arrived, if
    no robot can make progress, or after `planner.max_steps`. It has stalled if all robots are stuck
    (at the step limit: any robot), unless nothing is left to learn.
    """
    # Shapes: connected (steps, robots).
    steps, term = len(connected), problem.terms[0]
    waiting = [robot.problem.terms[0].steers == "connection" for robot in robots]
    if term.steers == "connection" and bool(connected[-1, waiting].all()):
        return Outcome.COMPLETED, f"connected after step {steps}"
    led = [r for r in robots if any(term.steers == "goal" for term in r.problem.terms)]
    if led and all(_has_arrived(robot.problem, robot.states[-1]) for robot in led):
        return Outcome.REACHED, f"within goal_radius_m of the goal after step {steps}"
    last = steps >= problem.planner.max_steps
    stuck = [
        (robot, why)
        for number, robot in enumerate(robots)
        if (why := _stuck(problem, connected[:, number], robot)) is not None
    ]
    if stuck and (last or len(stuck) == len(robots)):
        stuck = [
            (robot, why)
            for robot, why in stuck
            if not learns(robot.problem) or _has_left(robot, _others_of(problem, robots, robot))
        ]
        if stuck:
            return Outcome.STALLED, _in_words(problem, stuck)
        if not last:
            return Outcome.COMPLETED, f"nothing left to learn after step {steps}"
    if not last:
        return None
    if led:
        return Outcome.STEP_LIMIT, f"not arrived after planner.max_steps {steps}"
    if term.steers == "connection":
        return Outcome.STEP_LIMIT, f"not connected after planner.max_steps {steps}"
    return Outcome.COMPLETED, f"all {steps} steps driven"


def _has_arrived(problem: Problem, state: NDArray[np.float64]) -> bool:
    """Return whether a robot is at rest at its goal."""
    return is_at_goal(problem, state[:2]) and stands(problem, state)


def _stuck(problem: Problem, connected: NDArray[np.bool_], robot: Progress) -> str | None:
    """Return why a robot can make no further progress; None if it can.

    A stationary tracking robot does its task as long as packets arrive. For custom terms, standing
    still may be optimal if plans are verified.
    """
    recent, term = slice(-STALL_STEPS, None), robot.problem.terms[0]
    if term.sensor is not None and connected[recent].any():
        return None
    if term.task == "custom" and term.steers is None and not learns(robot.problem):
        verdicts = [plan.verdict for plan in robot.plans[recent]]
        if any(verdict is Verdict.VERIFIED for verdict in verdicts):
            return None
    interacts = problem.constraints.separation_m > 0.0 or counts_others(problem)
    apart = len(problem.robots) > 1 and interacts
    alone = not apart and term.sensor is None and problem.planner.name != "random"
    return standstill(robot.problem, robot.states, robot.learnt, robot.plans[-1], alone=alone)


def _others_of(problem: Problem, robots: Sequence[Progress], robot: Progress) -> Pending:
    """Return the past positions of the other robots if the objective depends on them."""
    if not counts_others(problem):
        return NOTHING_PENDING
    driven = [np.array(each.states)[1:, :2] for each in robots]
    number = next(number for number, each in enumerate(robots) if each is robot)
    return Pending((), places_of_others(driven, number))


def _has_left(robot: Progress, others: Pending) -> bool:
    """Return whether a robot has positions left to measure, in addition to those of the others."""
    problem, states = robot.problem, robot.states
    spacing = problem.channel.measure_spacing_m
    posteriors = anticipated(robot.posteriors, others, states[-1][:2], spacing)
    lattice = build_lattice(
        problem.workspace,
        states[0][:2],
        problem.step_length_m - STEP_PAD_M,
        problem.constraints.clearance_m + CLEARANCE_PAD_M,
    )
    index = index_obstacles(problem.workspace)
    return len(left_to_learn(problem, index, lattice, states[-1][:2], posteriors)) > 0


def _in_words(problem: Problem, stuck: Sequence[tuple[Progress, str]]) -> str:
    """Return the robots that stand still or circle, with reasons, as text."""
    unmeasured = any(learns(robot.problem) for robot, _ in stuck)
    whys = [
        f"{robot.problem.robots[0].name}: {why}" if len(problem.robots) > 1 else why
        for robot, why in stuck
    ]
    return "; ".join(whys) + ("; places are left to measure" if unmeasured else "")
