"""How good single plans are: their worth as a share of the best of 60 polished starts.

``python benchmarks/tracking_quality.py --horizon 10`` plans one cold step in each of 50 seeded
scenes, by the planner. The starts are the lattice's best paths
to places drawn at random within reach; each is polished, and counts if the verifier accepts it and
it misses the connectivity bound nowhere. Worths are from all 1,000 measurements.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter, process_time

import numpy as np
from tracking_scene import STEP_M, single_step

from planopt import Verdict
from planopt.extend import Rung
from planopt.planning.candidates import Scorer
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.search.guess_search import GuessSearch
from planopt.planning.values.context import StepContext


def best_of_starts(
    planner: HorizonPlanner,
    search: GuessSearch,
    situation: StepContext,
    scorer: Scorer,
    count: int,
    seed: int,
) -> float:
    """The largest worth that `count` random starts are polished to; -inf without any."""
    generator = np.random.default_rng(seed)
    horizon = situation.problem.planner.horizon
    best = -np.inf
    for _ in range(count):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        away = STEP_M * horizon * np.sqrt(generator.uniform())
        place = situation.position_m + away * np.array([np.cos(angle), np.sin(angle)])
        # A target that waits at the place draws the lattice's path there.
        aim = replace(situation.aim, target_m=np.tile(place, (horizon, 1)))
        lured = replace(situation, aim=aim)
        for start in search.find_guesses(lured, None)[:1]:
            start = replace(start, value=max(scorer.objective(start.path_m), 1e-3))
            for candidate in planner.cascade.refinement.candidates(
                situation, scorer, start, Rung.PLAN
            ):
                if candidate.verdict is Verdict.VERIFIED and not candidate.relaxes:
                    best = max(best, candidate.objective)
    return best


def main() -> None:
    """Print shares and times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument("--instances", type=int, default=50)
    parser.add_argument("--starts", type=int, default=60)
    parser.add_argument("--measurements", type=int, default=1000)
    parser.add_argument("--munich-like", action="store_true")
    chosen = parser.parse_args()
    shares: list[float] = []
    wall_s: list[float] = []
    cpu_s: list[float] = []
    for seed in range(chosen.instances):
        place, situation, scorer = single_step(
            chosen.horizon, chosen.measurements, seed, chosen.munich_like
        )
        planner = HorizonPlanner(place.problem, place.ground)
        search = GuessSearch(place.problem, place.ground)
        best = best_of_starts(planner, search, situation, scorer, chosen.starts, seed)
        # The first plan fills the map.
        planner.plan(replace(situation), scorer)
        again = replace(situation)
        fresh = replace(scorer, objective=replace(scorer.objective, context=again))
        wall, cpu = perf_counter(), process_time()
        plan = planner.plan(again, fresh)
        wall_s.append(perf_counter() - wall)
        cpu_s.append(process_time() - cpu)
        kept = plan.verdict is Verdict.VERIFIED and not plan.certificate.relaxed_steps
        shares.append(plan.objective / best if kept else 0.0)
        print(f"{seed:3} best {best:9.3f}  plan {shares[-1]:.4f}", flush=True)
    print(
        f"share mean {np.mean(shares):.4f}, least {np.min(shares):.4f}; "
        f"median {1e3 * np.median(wall_s):.1f} ms wall, {1e3 * np.median(cpu_s):.1f} ms CPU"
    )


if __name__ == "__main__":
    main()
