"""The closed loop for a sum of terms: every robot plans, moves, measures, and all look again.

Robots plan one after the other, each on what it believes itself. What happens is fixed by the seed:
the truth, the first measurements, the target's way and the sensors' noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.truth import Truth, true_power_dbm
from planopt.errors import InputError
from planopt.planning.candidate import Judge
from planopt.planning.channel_log import channel_errors_db, channel_log, theta_variance_db
from planopt.planning.ground import Ground, build_ground
from planopt.planning.learning import learn_here
from planopt.planning.metrics import metrics_of
from planopt.planning.path_worth import PathWorth
from planopt.planning.plan import Plan
from planopt.planning.planners import Planner, planner_for
from planopt.planning.prepare import prepare
from planopt.planning.region import workspace_region
from planopt.planning.run import Outcome, Run
from planopt.planning.situation import Situation
from planopt.planning.steering import Steering
from planopt.planning.step_log import step_log
from planopt.planning.target_watch import TargetWatch, observed, watch_target
from planopt.planning.team_run import TargetLog, TeamRun
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import MappingTerm, Problem


@one_blas_thread()
def simulate_team(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    seed: int = 0,
    on_step: Callable[[int], None] | None = None,
) -> TeamRun:
    """Drive a problem's robots in the true channel for `planner.max_steps` steps.

    Parameters
    ----------
    problem
        A problem whose objective is a sum of terms; it must have a truth.
    horizon, planner
        Override the problem's planner settings.
    seed
        Of everything that happens.
    on_step
        Called after every step with its number, for progress display.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner)
    prepared = prepare(problem, seed)
    if prepared.truth is None:
        raise InputError(
            "a simulation needs a truth to drive in", file=problem.file, key="channel.truth"
        )
    truth = prepared.truth
    # Apart from the streams of truth and measurements, so that another task leaves these as they are.
    target_seed, planner_seed = np.random.SeedSequence(seed, spawn_key=(1,)).spawn(2)
    generator = np.random.default_rng(target_seed)
    watch = watch_target(problem, generator)
    crew = [
        _member(problem, number, np.random.default_rng(stream))
        for number, stream in enumerate(planner_seed.spawn(len(problem.robots)))
    ]
    region = workspace_region(problem)
    tracks: list[list[NDArray[np.float64]]] = [[member.start_m] for member in crew]
    plans: list[list[Plan]] = [[] for _ in crew]
    beliefs = [prepared.belief for _ in crew]
    rows = [_knowledge(beliefs[0], truth, region.grid_m)]
    targets = [_target_row(watch)]
    delivered: list[NDArray[np.bool_]] = []
    threshold = problem.stations[0].threshold_dbm
    for step in range(1, problem.planner.max_steps + 1):
        for number, member in enumerate(crew):
            here = tracks[number][-1]
            situation = Situation(
                member.problem,
                beliefs[number].posterior,
                here,
                None if watch is None else watch.expected_m(number, problem.planner.horizon),
                region,
            )
            if member.steering is not None:
                place = member.steering.find_place(situation.posterior, here)
                situation = replace(situation, steering_m=place)
            judge = Judge(
                member.problem, member.ground.index, beliefs[number], here, PathWorth(situation)
            )
            warm = plans[number][-1] if plans[number] else None
            plans[number].append(member.planner.plan(situation, judge, warm))
        for number in range(len(crew)):
            tracks[number].append(plans[number][-1].positions_m[1])
            beliefs[number] = learn_here(problem, truth, beliefs[number], tracks[number][-1])
        here = np.array([track[-1] for track in tracks])
        arrived = true_power_dbm(truth, here) >= threshold
        delivered.append(arrived)
        if watch is not None:
            watch = observed(watch, step, here, arrived, generator)
        targets.append(_target_row(watch))
        rows.append(_knowledge(beliefs[0], truth, region.grid_m))
        if on_step is not None:
            on_step(step)
    return TeamRun(
        problem=problem,
        seed=seed,
        truth=truth,
        runs=tuple(
            _run(member.problem, seed, truth, np.array(track), released)
            for member, track, released in zip(crew, tracks, plans, strict=True)
        ),
        plans=tuple(tuple(released) for released in plans),
        beliefs=tuple(beliefs),
        first_measurements=len(prepared.belief.posterior.measurements),
        target=_target_log(watch, targets, delivered),
        channel=channel_log(rows),
    )


@dataclass(frozen=True, eq=False)
class _Member:
    """One robot: its own problem, ground and planner, and what finds where to steer to."""

    problem: Problem
    start_m: NDArray[np.float64]
    ground: Ground
    planner: Planner
    steering: Steering | None


def _member(
    problem: Problem, number: int, generator: np.random.Generator
) -> _Member:
    own = replace(problem, robots=(problem.robots[number],))
    start = np.asarray(problem.robots[number].start_m)
    ground = build_ground(own, start)
    steered = [t for t in own.terms if isinstance(t, MappingTerm) and t.form == "two_layer"]
    steering = Steering(own, ground, steered[0]) if steered else None
    return _Member(own, start, ground, planner_for(own, ground, generator), steering)


def _knowledge(
    belief: Belief, truth: Truth, places_m: NDArray[np.float64]
) -> tuple[float, float, float]:
    errors = channel_errors_db(belief.posterior, truth, places_m)
    return *errors, theta_variance_db(belief.posterior)


TargetRow = tuple[NDArray[np.float64], float]
"""Where the station thinks that the target is, and tr P."""


def _target_row(watch: TargetWatch | None) -> TargetRow | None:
    return None if watch is None else (watch.station_mean_m, watch.station_variance_m2)


def _target_log(
    watch: TargetWatch | None,
    rows: Sequence[TargetRow | None],
    delivered: Sequence[NDArray[np.bool_]],
) -> TargetLog | None:
    if watch is None:
        return None
    there = [row for row in rows if row is not None]
    return TargetLog(
        true_m=watch.true_m[: len(there)],
        station_mean_m=np.array([mean for mean, _ in there]),
        station_variance_m2=np.array([variance for _, variance in there]),
        delivered=np.array(delivered),
    )


def _run(
    problem: Problem,
    seed: int,
    truth: Truth,
    track_m: NDArray[np.float64],
    plans: Sequence[Plan],
) -> Run:
    log = step_log(problem, track_m, true_power_dbm(truth, track_m), plans)
    return Run(
        robot=problem.robots[0].name,
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=None,
        seed=seed,
        outcome=Outcome.COMPLETED,
        reason=f"all {problem.planner.max_steps} steps driven",
        log=log,
        metrics=metrics_of(log, plans, Outcome.COMPLETED),
    )
