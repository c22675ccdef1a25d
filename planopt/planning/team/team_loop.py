"""The closed loop for a sum of terms: every robot plans, moves, measures, and all look again.

Robots plan one after the other, each on what it believes itself, and keep apart as
:mod:`planopt.planning.team.team_step` says. What happens is fixed by the seed:
the truth, the first measurements, the target's way and the sensors' noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError
from planopt.planning.history import history_of
from planopt.planning.loop.channel_log import channel_log, channel_row
from planopt.planning.loop.learning import learn_here
from planopt.planning.loop.robot_run import completed_run
from planopt.planning.loop.target_log import target_log
from planopt.planning.loop.target_watch import aim_of, observed, watch_target
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.plan import Plan
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.team.crew import build_crew
from planopt.planning.team.team_ending import Progress, team_ending
from planopt.planning.team.team_run import TeamRun
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.team.team_step import TeamMoment, plan_together
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.region import workspace_region
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem


@one_blas_thread()
def simulate_team(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    seed: int = 0,
    prepared: Prepared | None = None,
    on_step: Callable[[int], None] | None = None,
) -> TeamRun:
    """Drive a problem's robots in the true channel for `planner.max_steps` steps.

    A run ends before where :func:`planopt.planning.team.team_ending.team_ending` says so.

    Parameters
    ----------
    problem
        A problem whose objective is a sum of terms; it must have a truth.
    horizon, planner
        Override the problem's planner settings.
    seed
        Of everything that happens.
    prepared
        Truth and first belief if they are there already, for many runs of one seed.
    on_step
        Called after every step with its number, for progress display.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner)
    prepared = prepared if prepared is not None else prepare(problem, seed)
    if not prepared.truths:
        raise InputError(
            "a simulation needs a truth to drive in", file=problem.file, key="channel.truth"
        )
    truths = prepared.truths
    seeds = team_seeds(problem, seed)
    watches = [watch_target(problem, seeds.target)]
    crew = build_crew(problem, seeds)
    region = workspace_region(problem)
    states = [[member.start] for member in crew]
    learnt: list[list[bool]] = [[] for _ in crew]
    plans: list[list[Plan]] = [[] for _ in crew]
    aims: list[list[Aim]] = [[] for _ in crew]
    beliefs = [prepared.belief for _ in crew]
    rows = [channel_row(beliefs[0].posteriors, truths, region.grid_m)]
    delivered: list[NDArray[np.bool_]] = []
    ended = None
    while ended is None:
        step = len(delivered) + 1
        watch = watches[-1]
        moment = TeamMoment(
            beliefs=beliefs,
            states=[driven[-1] for driven in states],
            watched=[aim_of(watch, number, problem.planner.horizon) for number in range(len(crew))],
            histories=[
                history_of(
                    member.problem,
                    np.array(states[number])[:, :2],
                    np.array([arrived[number] for arrived in delivered], dtype=bool),
                )
                for number, member in enumerate(crew)
            ],
            warm=[made[-1] if made else None for made in plans],
            driven_m=[np.array(driven)[1:, :2] for driven in states],
        )
        for number, (plan, aim) in enumerate(
            zip(*plan_together(problem, crew, moment), strict=True)
        ):
            plans[number].append(plan)
            aims[number].append(aim)
        for number in range(len(crew)):
            states[number].append(plans[number][-1].next_state)
            before = beliefs[number]
            beliefs[number] = learn_here(problem, truths, before, states[number][-1][:2])
            learnt[number].append(beliefs[number] is not before)
        here = np.array([driven[-1][:2] for driven in states])
        arrived = true_serving_dbm(problem, truths, here) >= problem.stations[0].threshold_dbm
        delivered.append(arrived)
        watches.append(
            None if watch is None else observed(watch, step, here, arrived, seeds.target)
        )
        rows.append(channel_row(beliefs[0].posteriors, truths, region.grid_m))
        if on_step is not None:
            on_step(step)
        robots = [
            Progress(member.problem, driven, measured, made, belief.posteriors)
            for member, driven, measured, made, belief in zip(
                crew, states, learnt, plans, beliefs, strict=True
            )
        ]
        ended = team_ending(problem, np.array(delivered), robots)
    tracks = [np.array(driven)[:, :2] for driven in states]
    return TeamRun(
        problem=problem,
        seed=seed,
        truth=truths[0],
        runs=tuple(
            completed_run(
                member.problem,
                seed,
                track,
                true_serving_dbm(problem, truths, track),
                made,
                measured,
                ended,
            )
            for member, track, made, measured in zip(crew, tracks, plans, learnt, strict=True)
        ),
        plans=tuple(tuple(made) for made in plans),
        aims=tuple(tuple(known) for known in aims),
        beliefs=tuple(beliefs),
        first_measurements=len(prepared.belief.posterior.measurements),
        target=target_log(watches, np.array(delivered)),
        channel=channel_log(rows),
        further_truths=truths[1:],
    )
