"""Whether both ways to polish agree, and what each costs: IPOPT and sequential convex programming.

``python benchmarks/method_agreement.py --horizon 10`` plans one cold step in each of 50 seeded
scenes with ``nlp`` and with ``scp``, from the same starts. Worths are from all measurements.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter, process_time

import numpy as np
from tracking_scene import single_step

from planopt import Plan, Verdict
from planopt.planning.horizon_planner import HorizonPlanner

METHODS: tuple[str, ...] = ("nlp", "scp")
AGREEMENT = 0.01


def main() -> None:
    """Print a line for each scene, and what they come to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument("--instances", type=int, default=50)
    parser.add_argument("--measurements", type=int, default=1000)
    parser.add_argument("--munich-like", action="store_true")
    chosen = parser.parse_args()
    plans: dict[str, list[Plan]] = {name: [] for name in METHODS}
    wall_s: dict[str, list[float]] = {name: [] for name in METHODS}
    cpu_s: dict[str, list[float]] = {name: [] for name in METHODS}
    for seed in range(chosen.instances):
        place, situation, scorer = single_step(
            chosen.horizon, chosen.measurements, seed, chosen.munich_like
        )
        for name in METHODS:
            problem = replace(place.problem, planner=replace(place.problem.planner, name=name))
            planner = HorizonPlanner(problem, place.ground)
            # The first plan fills the map; what it found is forgotten.
            planner.plan(replace(situation), scorer)
            again = replace(situation)
            fresh = replace(scorer, objective=replace(scorer.objective, context=again))
            wall, cpu = perf_counter(), process_time()
            plans[name].append(planner.plan(again, fresh))
            wall_s[name].append(perf_counter() - wall)
            cpu_s[name].append(process_time() - cpu)
        nlp, scp = (plans[name][-1] for name in METHODS)
        print(
            f"{seed:3} nlp {nlp.objective:9.3f} {nlp.verdict.value} {nlp.rung.value}"
            f"  scp {scp.objective:9.3f} {scp.verdict.value} {scp.rung.value}",
            flush=True,
        )
    both = [
        (nlp.objective, scp.objective)
        for nlp, scp in zip(plans["nlp"], plans["scp"], strict=True)
        if nlp.verdict is scp.verdict is Verdict.VERIFIED
    ]
    apart = np.array([abs(scp - nlp) / abs(nlp) for nlp, scp in both])
    print(
        f"both verified in {len(both)} of {chosen.instances}; {int((apart <= AGREEMENT).sum())} of "
        f"them agree within {100.0 * AGREEMENT:g} %, largest difference {100.0 * apart.max():.2f} %"
    )
    for name in METHODS:
        gain = [plan.polish_gain for plan in plans[name]]
        print(
            f"{name}: median {1e3 * np.median(wall_s[name]):.1f} ms wall, "
            f"{1e3 * np.median(cpu_s[name]):.1f} ms CPU; "
            f"{np.median([plan.iterations for plan in plans[name]]):.0f} iterations; polish gain "
            f"{100.0 * np.median(gain):.2f} % over the lattice (median), {100.0 * max(gain):.1f} % "
            "at most"
        )


if __name__ == "__main__":
    main()
