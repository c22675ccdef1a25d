"""Gaps of proven bounds on additive tracking over time, for seeded single steps.

Run from the project's root: python benchmarks/bound_cases.py --steps 10 --count 102 --seeds 40
Scenes are those of `tracking_scene.py`: eight obstacles and p_min = 0.8; `--free` drops both. With
`--team`, `outdoor_track` is solved: three robots that keep apart, each given the others' plans.
Times are processor times, with planning excluded.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import process_time

import numpy as np
from tracking_scene import context_in, single_step

import planopt
from planopt.bounds import tube
from planopt.planning import prove
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.scene import build_ground
from planopt.planning.solve import proven
from planopt.world.motion import NOTHING_MOVES


def gaps_of(steps: int, count: int, seed: int, limits_s: list[float], free: bool) -> list[float]:
    """Gaps of one plan after some processor times, each from a search of its own."""
    place, at, scorer = single_step(steps, count, seed)
    if free:
        problem = place.problem
        workspace = replace(problem.workspace, obstacles=())
        limits = replace(problem.constraints, p_min=0.0)
        problem = replace(problem, workspace=workspace, constraints=limits)
        place = replace(place, problem=problem, ground=build_ground(problem, at.position_m))
        at, scorer = context_in(place, place.belief, at.position_m, np.asarray(at.aim.target_m))
    plan = HorizonPlanner(place.problem, place.ground).plan(at, scorer)
    found = list[float]()
    for limit_s in limits_s:
        given = place.problem, place.belief, plan, at.aim, NOTHING_MOVES
        *_, proven = prove.sum_plan(*given, limit_s, improves=True)
        bound = proven.bound
        assert bound is not None
        assert bound.gap is not None
        found.append(bound.gap)
    return found


def team_gaps(steps: int, count: int, seed: int, limits_s: list[float]) -> list[list[float]]:
    """Gaps of the three robots of `outdoor_track` after some processor times."""
    problem = planopt.load("outdoor_track")
    measured = replace(problem.channel.measurements, count=count)
    problem = replace(problem, channel=replace(problem.channel, measurements=measured))
    solution = planopt.solve(problem, horizon=steps, seed=seed)
    bounds = [
        [plan.bound for plan in proven(solution, limit_s).plans if plan.bound is not None]
        for limit_s in limits_s
    ]
    return [[each.gap or 0.0 for each in robot] for robot in zip(*bounds, strict=True)]


def main() -> None:
    """Print median, 95 % and worst gap after 1, 10 and 30 seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--count", type=int, default=102)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--free", action="store_true")
    parser.add_argument("--team", action="store_true")
    given = parser.parse_args()
    tube.monotonic = prove.monotonic = process_time
    limits = [limit for limit in (1.0, 10.0, 30.0) if limit <= given.seconds]
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    cases: list[list[float]] = []
    for seed in seeds:
        if given.team:
            cases += team_gaps(given.steps, given.count, seed, limits)
        else:
            cases.append(gaps_of(given.steps, given.count, seed, limits, given.free))
        words = zip(limits, cases[-1], strict=True)
        print(
            f"seed {seed}:", ", ".join(f"{t:g} s {100 * gap:.3f} %" for t, gap in words), flush=True
        )
    for limit, gaps in zip(limits, np.array(cases).T, strict=True):
        middle, high, worst = 100.0 * np.quantile(gaps, [0.5, 0.95, 1.0], method="higher")
        print(f"{limit:g} s: median {middle:.3f} %, 95 % {high:.3f} %, worst {worst:.3f} %")


if __name__ == "__main__":
    main()
