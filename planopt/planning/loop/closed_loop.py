"""The closed loop: plan, move, measure, update the belief, plan again, until the task has ended.

Robots plan one after the other, each on its own belief, and keep apart as
:mod:`planopt.planning.team.team_step` says. The seed fixes everything that happens: the ground
truth, the first measurements, the target's path and the sensors' noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from planopt.channel.fields.truth import measure
from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.parts import calling
from planopt.planning.given import (
    GivenMeasurements,
    team_seeds,
    with_drawn_starts,
    with_measurements,
)
from planopt.planning.holes import BlockedError, BlockedWay
from planopt.planning.loop.clairvoyant import run_costs
from planopt.planning.loop.ending import Progress, run_ending
from planopt.planning.loop.log import Outcome, channel_log, channel_row, target_log
from planopt.planning.loop.robot_run import robot_run, true_serving_dbm
from planopt.planning.loop.target_watch import watch_target
from planopt.planning.plan import Plan
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.run import Run
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.stepping import Stepper, planning
from planopt.planning.worth.left_to_learn import workspace_region
from planopt.problems.overrides import with_overrides
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem
from planopt.targets.sensor import sense


@one_blas_thread()
def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: GivenMeasurements | None = None,
    scenes: Sequence[Scene] | None = None,
    prepared: Prepared | None = None,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run:
    """Drive a problem's robots in the true channel.

    The run ends as :func:`planopt.planning.loop.ending.run_ending` says.

    Parameters
    ----------
    problem
        The problem; it must have a ground truth.
    horizon, planner, cost_to_go
        Override the problem's planner settings; a cost-to-go only where there is a goal.
    seed
        Of everything that happens.
    measurements
        First measurements in place of those that the problem names: :class:`planopt.Measurements`
        or a table (dictionary or DataFrame) with ``x_m``, ``y_m`` and ``power_dbm``; of several
        stations a sequence with one for each.
    scenes, prepared
        Geometry of each robot that is to reach a goal, ground truth and first belief if they are
        there already, for many runs of one seed.
    on_start
        Called with the first plan of each robot, before the first step.
    on_step
        Called after every step with its number, for progress display.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used, or there is no ground truth.
    NoPlanError
        Obstacles cut the goal off.
    """
    problem, given = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    problem = with_drawn_starts(problem, seed)
    prepared = prepared if prepared is not None else prepare(problem, seed, given)
    truths = prepared.truths
    if not truths:
        raise InputError(
            "a simulation needs a ground truth to drive in, and there is none",
            file=problem.file,
            key="channel.truth",
            remedy="add [channel.truth], or ChannelSetup(truth=...); solve and Planner need none",
        )
    reaches = problem.task == "reach"
    if scenes is None:
        scenes = build_scenes(problem)
    seeds = team_seeds(problem, seed)
    target, foreseen = watch_target(problem, seeds.target), None
    kind = planner_kind(problem.planner.name)
    if kind.foresees:
        true_m = np.zeros((0, 2)) if target is None else target.true_m
        make = kind.maker()
        with calling(make, "", key="planner.name"):
            foreseen = make(problem, truths[0], true_m)
    robots = Stepper(
        problem,
        prepared.belief,
        planning(problem, scenes if reaches else None, seeds, foreseen),
        target,
    )
    # The error over the whole workspace is dear, and tells little of a way to a goal.
    known_at = None if reaches else workspace_region(problem).grid_m
    rows = [] if known_at is None else [channel_row(robots.beliefs[0].posteriors, truths, known_at)]
    ended, blocked = _ending(robots), tuple[BlockedWay, ...]()
    while ended is None:
        try:
            step_plans = robots.plan()
        except NoPlanError as error:
            ended = Outcome.NO_PLAN, str(error)
            blocked = error.blocked if isinstance(error, BlockedError) else ()
            break
        step, watch = len(robots.connected) + 1, robots.watches[-1]
        if step == 1 and on_start is not None:
            on_start(step_plans)
        states = [plan.next_state for plan in step_plans]
        here = np.array([state[:2] for state in states])
        robots.observe(
            states,
            [[measure(truth, place[None]) for truth in truths] for place in here],
            true_serving_dbm(problem, truths, here) >= problem.stations[0].true_threshold_dbm,
            None if watch is None else sense(watch.sensor, here, watch.true_m[step], seeds.target),
        )
        if known_at is not None:
            rows.append(channel_row(robots.beliefs[0].posteriors, truths, known_at))
        if on_step is not None:
            on_step(step)
        ended = _ending(robots)
    tracks = [np.array(driven)[:, :2] for driven in robots.states]
    return Run(
        problem=problem,
        seed=seed,
        truths=truths,
        runs=tuple(
            robot_run(own, track, true_serving_dbm(problem, truths, track), made, measured, ended)
            for own, track, made, measured in zip(
                robots.owns, tracks, robots.plans, robots.learnt, strict=True
            )
        ),
        plans=tuple(tuple(made) for made in robots.plans),
        aims=tuple(tuple(known) for known in robots.aims),
        beliefs=tuple(robots.beliefs),
        first_measurements=len(prepared.belief.posterior.measurements),
        target=target_log(robots.watches, robots.connected),
        channel=channel_log(rows) if rows else None,
        costs=run_costs(
            problem, [scene.road_map for scene in scenes or ()], prepared.truths, tracks, ended[0]
        ),
        blocked=blocked,
    )


def _ending(robots: Stepper) -> tuple[Outcome, str] | None:
    """Return how a run ends where its robots are now; None if it goes on."""
    progress = [
        Progress(own, driven, measured, made, belief.posteriors)
        for own, driven, measured, made, belief in zip(
            robots.owns, robots.states, robots.learnt, robots.plans, robots.beliefs, strict=True
        )
    ]
    return run_ending(robots.problem, robots.connected, progress)
