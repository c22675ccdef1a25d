"""Closed loop of a run: plan, move, measure and update the belief until the task ends.

A simulation and the replay of a saved run differ in the source of plans and in the `World`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.ground_truth import Truth, measure
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.errors import NoPlanError
from planopt.planning.certificate import BlockedError, BlockedWay
from planopt.planning.loop.ending import Progress, run_ending
from planopt.planning.loop.log import Outcome, channel_log, channel_row, target_log
from planopt.planning.loop.metrics import robot_run, run_costs, true_serving_dbm
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan
from planopt.planning.stepping import Planning, Stepper
from planopt.planning.target_watch import TargetWatch
from planopt.planning.values.exploration import workspace_region
from planopt.problems.problem import Problem
from planopt.targets.sensor import sense
from planopt.world.lattice import RoadMap


@dataclass(frozen=True, eq=False)
class World:
    """Radio channel in which the robots move."""

    truths: tuple[Truth, ...]  # Ground truth by station; empty if unknown
    # Function of robot number, step and positions (n, 2) from that step on: serving power (n,)
    serving_dbm: Callable[[int, int, NDArray[np.float64]], NDArray[np.float64]]
    # Function of step and robot positions (robots, 2): measurements by robot and station
    measured: Callable[[int, NDArray[np.float64]], list[list[Measurements]]]
    # Function of step, posteriors by station and positions (n, 2): row of the channel log
    channel_row: Callable[[int, Sequence[ChannelPosterior], NDArray[np.float64]], tuple[float, ...]]
    # Function of tracks (steps + 1, 2) by robot: true costs by metric; empty without goals
    costs: Callable[[Sequence[NDArray[np.float64]], Outcome], dict[str, float]]


def true_world(
    problem: Problem,
    truths: tuple[Truth, ...],
    road_maps: Callable[[], Sequence[RoadMap]],  # One per robot with a goal
) -> World:
    """Return the world for a known ground truth."""
    return World(
        truths=truths,
        serving_dbm=lambda _number, _step, places: true_serving_dbm(problem, truths, places),
        measured=lambda _step, places: [
            [measure(truth, place[None]) for truth in truths] for place in places
        ],
        channel_row=lambda _step, posteriors, places: channel_row(posteriors, truths, places),
        costs=lambda tracks, outcome: run_costs(problem, road_maps(), truths, tracks, outcome),
    )


def drive(
    problem: Problem,
    seed: int,
    belief: Belief,
    world: World,
    planning: Planning,
    target: TargetWatch | None,
    generator: np.random.Generator,  # Noise of target sensors
    *,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run:
    """Run the loop until :func:`planopt.planning.loop.ending.run_ending` ends it."""
    robots = Stepper(problem, belief, planning, target)
    # Errors over the whole workspace are slow to compute and irrelevant to runs to a goal.
    known_at = None if problem.task == "reach" else workspace_region(problem).grid_m
    rows: list[tuple[float, ...]] = []
    if known_at is not None:
        rows.append(world.channel_row(0, robots.beliefs[0].posteriors, known_at))
    ended, blocked = _ending(robots), tuple[BlockedWay, ...]()
    while ended is None:
        try:
            step_plans = robots.plan()
        except NoPlanError as error:
            ended = Outcome.NO_PLAN, str(error)
            blocked = error.blocked if isinstance(error, BlockedError) else ()
            break
        step = len(robots.connected) + 1
        if step == 1 and on_start is not None:
            on_start(step_plans)
        _observe(robots, [plan.next_state for plan in step_plans], world, generator)
        if known_at is not None:
            rows.append(world.channel_row(step, robots.beliefs[0].posteriors, known_at))
        if on_step is not None:
            on_step(step)
        ended = _ending(robots)
    tracks = [np.array(driven)[:, :2] for driven in robots.states]
    return Run(
        problem=problem,
        seed=seed,
        truths=world.truths,
        runs=tuple(
            robot_run(own, track, world.serving_dbm(number, 0, track), made, measured, ended)
            for number, (own, track, made, measured) in enumerate(
                zip(robots.owns, tracks, robots.plans, robots.learnt, strict=True)
            )
        ),
        plans=tuple(tuple(made) for made in robots.plans),
        aims=tuple(tuple(known) for known in robots.aims),
        beliefs=tuple(robots.beliefs),
        first_measurements=len(belief.posterior.measurements),
        target=target_log(robots.watches, robots.connected),
        channel=channel_log(rows) if rows else None,
        costs=world.costs(tracks, ended[0]),
        blocked=blocked,
    )


def first_steps(
    problem: Problem,
    belief: Belief,
    world: World,
    planning: Planning,
    target: TargetWatch | None,
    generator: np.random.Generator,
    count: int,
    recorded: Sequence[Sequence[Sequence[float]]] = (),  # (steps, robots, state)
) -> tuple[list[list[Plan]], list[list[NDArray[np.float64]]]]:
    """Return the plans and states of the first steps of a run, by step and robot.

    Robots are set to recorded states, if any, so that rounding errors do not accumulate.
    """
    robots = Stepper(problem, belief, planning, target)
    made: list[list[Plan]] = []
    for step in range(len(recorded) or count):
        if not recorded and _ending(robots) is not None:
            break
        made.append(robots.plan())
        states = (
            [np.array(state) for state in recorded[step]]
            if recorded
            else [plan.next_state for plan in made[-1]]
        )
        _observe(robots, states, world, generator)
    by_robot = [driven[1:] for driven in robots.states]
    return made, [list(states) for states in zip(*by_robot, strict=True)]


def _observe(
    robots: Stepper,
    states: Sequence[NDArray[np.float64]],
    world: World,
    generator: np.random.Generator,
) -> None:
    """Set the robots to new states, and update their beliefs with the measurements taken there."""
    step, watch = len(robots.connected) + 1, robots.watches[-1]
    here = np.array([state[:2] for state in states])
    serving = [world.serving_dbm(number, step, place[None])[0] for number, place in enumerate(here)]
    robots.observe(
        states,
        world.measured(step, here),
        np.array(serving) >= robots.problem.stations[0].true_threshold_dbm,
        None if watch is None else sense(watch.sensor, here, watch.true_m[step], generator),
    )


def _ending(robots: Stepper) -> tuple[Outcome, str] | None:
    """Return the outcome of a run at the current states; None if it continues."""
    progress = [
        Progress(own, driven, measured, made, belief.posteriors)
        for own, driven, measured, made, belief in zip(
            robots.owns, robots.states, robots.learnt, robots.plans, robots.beliefs, strict=True
        )
    ]
    return run_ending(robots.problem, robots.connected, progress)
