"""Simulate a problem's robots in the true channel.

The seed determines ground truth, first measurements, target path and sensor noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from planopt.channel.cholesky import one_blas_thread
from planopt.errors import InputError
from planopt.parts import calling
from planopt.planning.free_space import with_drawn_starts
from planopt.planning.initial_data import (
    Prepared,
    UserMeasurements,
    prepare,
    team_seeds,
    with_measurements,
)
from planopt.planning.loop.drive import drive, true_world
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.target_watch import watch_target
from planopt.planning.team.couriers import planning
from planopt.problems.load import with_overrides
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem


@one_blas_thread()
def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: UserMeasurements | None = None,
    scenes: Sequence[Scene] | None = None,
    prepared: Prepared | None = None,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run:
    """Simulate the closed loop; arguments as for :func:`planopt.simulate`.

    Runs of one seed may share `scenes` (geometry) and `prepared` (ground truth, initial belief).
    """
    problem, measured = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    problem = with_drawn_starts(problem, seed)
    prepared = prepared if prepared is not None else prepare(problem, seed, measured)
    truths = prepared.truths
    if not truths:
        raise InputError(
            "a simulation needs a ground truth to drive in, and there is none",
            file=problem.file,
            key="channel.truth",
            remedy="add [channel.truth], or ChannelSetup(truth=...); solve and Planner need none",
        )
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
    world = true_world(problem, truths, lambda: [scene.road_map for scene in scenes or ()])
    plans = planning(problem, scenes, seeds, foreseen)
    return drive(
        problem,
        seed,
        prepared.belief,
        world,
        plans,
        target,
        seeds.target,
        on_start=on_start,
        on_step=on_step,
    )
