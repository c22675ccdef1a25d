"""Reported probabilities of connection against the share of connected steps, over closed loops.

``python benchmarks/known_connection.py fig4 --first-seed 31000 --seeds 40`` prints, for steps to
measured, to visited but unmeasured and to new positions, and by bins of the reported probability,
the number of steps, the mean probability and the share of connected steps. The last line has the
mean and the largest tr P.
"""

from __future__ import annotations

import argparse
from itertools import pairwise

import numpy as np

from planopt import load, simulate

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.001)
SAME_M = 1e-6


def main() -> None:
    """Run the seeds and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=20)
    chosen = parser.parse_args()
    problem = load(chosen.problem)
    steps: list[tuple[float, bool, bool, bool]] = []
    means: list[float] = []
    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
        run = simulate(problem, seed=seed)
        for robot, belief in zip(run.runs, run.beliefs, strict=True):
            log, read_m = robot.log, belief.posterior.measurements.positions_m
            for k in range(1, len(log.t_s)):
                here = log.positions_m[k]
                visited = (np.abs(log.positions_m[1:k] - here).max(axis=1) <= SAME_M).any()
                measured = (np.abs(read_m - here).max(axis=1) <= SAME_M).any()
                row = (log.connectivity[k], log.connected[k], visited, visited and measured)
                steps.append((float(row[0]), bool(row[1]), bool(row[2]), bool(row[3])))
        if run.target is not None:
            means.append(float(run.target.station_variance_m2[1:].mean()))
    probability, connected, visited, measured = map(np.array, zip(*steps, strict=True))
    kinds = {"measured": measured, "visited": visited & ~measured, "new": ~visited}
    bins = pairwise(EDGES)
    kinds |= {f"{a:g}-{b:g}": (probability >= a) & (probability < b) for a, b in bins}
    print("steps count mean_probability connected")
    for name, which in {"all": np.ones(len(steps), dtype=bool), **kinds}.items():
        if which.any():
            share = connected[which].mean()
            print(f"{name} {np.count_nonzero(which)} {probability[which].mean():.3f} {share:.3f}")
    print(f"mean tr P {np.mean(means):.4f} of {len(means)} runs")


if __name__ == "__main__":
    main()
