"""Gaps of proven bounds on additive tracking over time, for seeded single steps.

Run from the project's root: python benchmarks/bound_cases.py --steps 10 --count 102 --seeds 40
Scenes are those of `tracking_scene.py`: eight obstacles and p_min = 0.8; `--free` drops both.
Times are processor times, with planning excluded.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import process_time

import numpy as np
from tracking_scene import context_in, single_step

from planopt.bounds.multipliers import local_optimum, tilts_near
from planopt.bounds.tube import tube_bounds
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.proof.bounds import stages_of
from planopt.planning.prove import SURPLUS, better_of
from planopt.planning.scene import build_ground


def gaps_of(
    steps: int, count: int, seed: int, limit_s: float, free: bool
) -> list[tuple[float, float]]:
    """Processor times and gaps of the bounds of one step, until the limit."""
    place, at, scorer = single_step(steps, count, seed)
    if free:
        problem = place.problem
        workspace = replace(problem.workspace, obstacles=())
        limits = replace(problem.constraints, p_min=0.0)
        problem = replace(problem, workspace=workspace, constraints=limits)
        place = replace(place, problem=problem, ground=build_ground(problem, at.position_m))
        at, scorer = context_in(place, place.belief, at.position_m, np.asarray(at.aim.target_m))
    plan = HorizonPlanner(place.problem, place.ground).plan(at, scorer)
    begun, found = process_time(), list[tuple[float, float]]()
    stages = stages_of(place.problem, at, plan)
    if isinstance(stages, str):
        raise AssertionError(stages)
    optimum = local_optimum(stages, plan.positions_m[1:], SURPLUS)
    plan = better_of(at, plan, optimum)
    tilts = tilts_near(
        stages, [plan.positions_m[1:], optimum], at.law.posteriors[0].measurements.positions_m
    )
    for bound in tube_bounds(stages, plan.objective, tilts, 1e6):
        taken = process_time() - begun
        if taken > limit_s:
            break
        found.append((taken, bound.value / plan.objective - 1.0))
    return found


def main() -> None:
    """Print median, 95 % and worst gap after 1, 10 and 30 seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--count", type=int, default=102)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--free", action="store_true")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    cases = []
    for seed in seeds:
        cases.append(gaps_of(given.steps, given.count, seed, given.seconds, given.free))
        print(
            f"seed {seed}:",
            ", ".join(f"{t:.2f} s {100 * gap:.3f} %" for t, gap in cases[-1]),
            flush=True,
        )
    for limit in (1.0, 10.0, 30.0):
        if limit > given.seconds:
            break
        gaps = [min([gap for t, gap in case if t <= limit], default=np.inf) for case in cases]
        middle, high, worst = 100.0 * np.quantile(gaps, [0.5, 0.95, 1.0], method="higher")
        print(f"{limit:g} s: median {middle:.3f} %, 95 % {high:.3f} %, worst {worst:.3f} %")


if __name__ == "__main__":
    main()
