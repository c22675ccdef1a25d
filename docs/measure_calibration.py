"""Print predicted against true connection over fresh runs: PROBLEM [RUNS] [FIRST] [STEPS] [LAW].

Each run has its own seed, start and goal: both free and truly connected, apart by half the shorter
side of the workspace at least. FIRST is the first seed, STEPS the longest run, LAW the calibration
to drive with. The normal law of the same runs' posteriors is printed beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt import load
from planopt.channel.connection.serving_power import any_probability
from planopt.channel.posterior import condition
from planopt.channel.validation.calibration import reliability
from planopt.errors import NoPlanError
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.robot_run import true_serving_dbm
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.run import Run
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem
from planopt.report.tables import reliability_lines
from planopt.world.clearance import clearance_m, index_obstacles

AHEAD = 5
"""Predictions of the places so many steps ahead are compared with the truth too."""

LEAST_CLEARANCE = 1.5
"""Of starts and goals, in clearances that are asked for."""

Outcomes = tuple[NDArray[np.float64], NDArray[np.bool_]]
"""``(n,)`` predicted probabilities of connection, and whether there was one."""


def main(
    name: str, runs: str = "20", first: str = "0", steps: str = "150", law: str = "platt"
) -> None:
    """Drive all runs and print the tables."""
    problem = with_overrides(load(name), calibration=law)
    problem = replace(problem, planner=replace(problem.planner, max_steps=int(steps)))
    seeds = range(int(first), int(first) + int(runs))
    found: dict[str, list[Outcomes]] = {}
    reached = 0
    for seed in seeds:
        driven = drive(problem, seed)
        reached += driven.run.outcome is Outcome.REACHED
        each = {
            f"calibration {law}, driven steps": outcomes(driven, 1),
            f"calibration {law}, {AHEAD} steps ahead": outcomes(driven, AHEAD),
            "normal law, driven steps": (normal_probabilities(driven), outcomes(driven, 1)[1]),
        }
        for words, one in each.items():
            found.setdefault(words, []).append(one)
        print(f"\rseed {seed}", end="", file=sys.stderr, flush=True)
    print(f"\n{reached} of {len(seeds)} runs reached the goal")
    for words, each in found.items():
        print("\n".join(report(words, each)))


def report(words: str, runs: Sequence[Outcomes]) -> list[str]:
    """Return the lines of a table of predicted against true connection."""
    predicted, realised = (np.concatenate(parts) for parts in zip(*runs, strict=True))
    bins = reliability(predicted, realised, np.repeat(range(len(runs)), [len(p) for p, _ in runs]))
    score = -np.log(np.where(realised, predicted, 1.0 - predicted).clip(1e-9)).mean()
    return [
        f"{words}: mean predicted {predicted.mean():.4f}, connected {realised.mean():.4f}, "
        f"logarithmic score {score:.4f} a step, "
        f"{sum(one.agrees is False for one in bins)} of {len(bins)} intervals miss",
        *reliability_lines(bins, "steps", "runs"),
    ]


def drive(problem: Problem, seed: int) -> Run:
    """Drive from a start to a goal that are drawn for the seed."""
    prepared = prepare(problem, seed)
    generator = np.random.default_rng([seed, 33])
    while True:
        start, goal = _start_and_goal(problem, prepared, generator)
        robot = replace(problem.robots[0], start_m=start, goal_m=goal)
        try:
            return simulate(replace(problem, robots=(robot,)), seed=seed, prepared=prepared)
        except NoPlanError:
            continue


def _start_and_goal(
    problem: Problem, prepared: Prepared, generator: np.random.Generator
) -> tuple[tuple[float, float], tuple[float, float]]:
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    apart = 0.5 * min(x_max - x_min, y_max - y_min)
    index = index_obstacles(problem.workspace)
    while True:
        ends = generator.uniform((x_min, y_min), (x_max, y_max), (2, 2))
        if np.linalg.norm(ends[1] - ends[0]) < apart:
            continue
        if clearance_m(index, ends).min() < LEAST_CLEARANCE * problem.constraints.clearance_m:
            continue
        power = true_serving_dbm(problem, prepared.truths, ends)
        if (power >= problem.stations[0].threshold_dbm).all():
            (ax, ay), (bx, by) = ends.tolist()
            return (ax, ay), (bx, by)


def outcomes(driven: Run, ahead: int) -> Outcomes:
    """Return P(connected) of places `ahead` steps ahead of each plan, and whether they were."""
    plans = [plan for plan in driven.plans[0] if len(plan.connectivity) > ahead]
    places = np.array([plan.positions_m[ahead] for plan in plans]).reshape(-1, 2)
    power = true_serving_dbm(driven.problem, driven.truths, places)
    predicted = np.array([plan.connectivity[ahead] for plan in plans])
    return predicted, power >= driven.problem.stations[0].threshold_dbm


def normal_probabilities(driven: Run) -> NDArray[np.float64]:
    """Return what the normal law says of each driven step, from the measurements before it."""
    logs = [posterior.measurements for posterior in driven.belief.posteriors]
    known = driven.first_measurements
    posteriors = [
        condition(posterior.parameters, log.take(slice(known)))
        for posterior, log in zip(driven.belief.posteriors, logs, strict=True)
    ]
    thresholds = [radio.threshold_dbm for radio in driven.problem.stations]
    chances: list[float] = []
    for place in driven.run.log.positions_m[1:]:
        each = [posterior.predict(place[None]) for posterior in posteriors]
        chances.append(float(any_probability(each, thresholds)[0]))
        if known < len(logs[0]) and np.array_equal(logs[0].positions_m[known], place):
            row = np.array([known])
            posteriors = [
                posterior.extend(log.take(row))
                for posterior, log in zip(posteriors, logs, strict=True)
            ]
            known += 1
    return np.array(chances)


if __name__ == "__main__":
    main(*sys.argv[1:])
