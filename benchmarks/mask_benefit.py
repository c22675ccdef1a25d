"""Benefit of planopt's Nav2 masks: one path planner with four costmaps of the same log.

``python benchmarks/mask_benefit.py --first-seed 2000 --seeds 96 --log FILE`` draws for each seed a
log of a robot's drive through Munich (``--legs`` routes between random places, a reading every
`READ_M` metres, rounded to 1 dB, none below the receiver's floor) and a start and goal in contact,
at least `LEAST_M` apart. Even and odd seeds have the thresholds of two library problems. The
planner is the shortest path on the lattice of the free space with the costs of Nav2's NavFn:
(50 + 0.8 c) per cell, where c, from 0 to 252, is the cost of a mask value from 0 to 100.

``none``      no mask: the shortest path
``planopt``   the mask ``weighted`` of ``planopt map --nav2``
``heat map``  readings interpolated by inverse squared distance, scaled from the floor (99) to the
              strongest reading (0)
``colours``   the heat map in three colours: 99 below the threshold, 50 up to 10 dB above it, else 0
``known``     the mask ``weighted`` of the true mean power: what a perfect map would give

The table has metres truly out of contact, fading included, and path lengths, with 95 % intervals of
the ratios by bootstrap over seeds. The log is a cache: its seeds are not computed again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planopt import Problem, load
from planopt.channel import (
    Measurements,
    Truth,
    condition,
    fit_channel,
    posterior_map,
    true_power_dbm,
)
from planopt.channel.ground_truth import mean_power_dbm
from planopt.channel.kriging import connection_probability
from planopt.planning.initial_data import draw_truth
from planopt.planning.scene import Scene, build_scene
from planopt.world import RoadMap, lattice_paths, nearest_cells, route_from
from planopt.world.nav2_masks import MaskLimits, mask_values

Floats = NDArray[np.float64]

PROBLEMS = ("munich_courier", "munich_hard")
READ_M, LEAST_M = 4.0, 300.0
FLOOR_BELOW_DB = 10.0  # The receiver's floor below the threshold
NEUTRAL, FACTOR, LARGEST = 50.0, 0.8, 252.0
INTERPOLATED = 12
COLOUR_DB = 10.0
CELL_M = 2.0
KINDS = ("none", "planopt", "heat map", "colours", "known")


def traversal(mask: Floats) -> Floats:
    """Return NavFn's cost per metre relative to a free cell, of mask values from 0 to 100."""
    return 1.0 + FACTOR * np.trunc(mask * LARGEST / 100.0) / NEUTRAL


def route(roads: RoadMap, ends: tuple[int, int], mask: Floats) -> Floats:
    """Return the cheapest path (n, 2) between two nodes."""
    paths = lattice_paths(roads, ends[1], traversal(mask))
    return roads.nodes_m[route_from(roads, paths, ends[0], np.inf)]


def along(path_m: Floats, spacing_m: float) -> Floats:
    """Return points on a path at equal distances, its ends included."""
    done = np.append(0.0, np.linalg.norm(np.diff(path_m, axis=0), axis=1).cumsum())
    at = np.linspace(0.0, done[-1], max(2, round(done[-1] / spacing_m) + 1))
    return np.stack([np.interp(at, done, path_m[:, axis]) for axis in (0, 1)], axis=1)


def drawn_log(
    problem: Problem, scene: Scene, truth: Truth, joined: NDArray[np.intp], seed: int, legs: int
) -> tuple[Measurements, tuple[int, int]]:
    """Return the readings of a drive, and the nodes of start and goal."""
    generator = np.random.default_rng([seed, 1])
    roads = scene.road_map
    free = np.zeros(len(roads.nodes_m))
    stops = generator.choice(joined, legs + 1)
    routes = [route(roads, (int(a), int(b)), free) for a, b in pairwise(stops)]
    places = np.vstack([along(leg, READ_M) for leg in routes if len(leg) > 1])
    floor = problem.stations[0].threshold_dbm - FLOOR_BELOW_DB
    power = np.maximum(np.round(true_power_dbm(truth, places)), floor)
    power_dbm = mean_power_dbm(truth, roads.nodes_m[joined])
    covered = joined[power_dbm >= problem.stations[0].true_threshold_dbm]
    start, goal = generator.choice(covered, 2)
    while np.linalg.norm(roads.nodes_m[start] - roads.nodes_m[goal]) < LEAST_M:
        start, goal = generator.choice(covered, 2)
    return Measurements(places, power, power <= floor), (int(start), int(goal))


def planopt_mask(problem: Problem, log: Measurements, nodes_m: Floats) -> Floats:
    """Return planopt's mask ``weighted`` at the nodes."""
    station = problem.stations[0]
    fit = fit_channel(replace(log, resolution_db=np.ones(len(log))), station.site)
    posterior = condition(fit.parameters, log)
    maps = posterior_map(posterior, problem.workspace.bounds_m, CELL_M, station.threshold_dbm)
    weights = mask_values(maps.connectivity.values, MaskLimits())["weighted"]
    return weights[nearest_cells(maps.connectivity, nodes_m)].astype(np.float64)


def interpolated_dbm(log: Measurements, nodes_m: Floats) -> Floats:
    """Return powers interpolated between the nearest readings by inverse squared distance."""
    distance, index = KDTree(log.positions_m).query(nodes_m, INTERPOLATED)
    weight = 1.0 / np.maximum(distance, 0.1) ** 2
    return (weight * log.power_dbm[index]).sum(axis=1) / weight.sum(axis=1)


def masks_of(problem: Problem, truth: Truth, log: Measurements, nodes_m: Floats) -> Callable:
    """Return the function from the kind of a mask to its values at the nodes."""
    threshold = problem.stations[0].threshold_dbm
    heat = interpolated_dbm(log, nodes_m)
    above = heat - threshold
    low, high = log.power_dbm.min(), log.power_dbm.max()
    fading = np.full(len(nodes_m), problem.channel.truth.multipath.std_db)  # type: ignore[union-attr]
    masks = {
        "none": lambda: np.zeros(len(nodes_m)),
        "planopt": lambda: planopt_mask(problem, log, nodes_m),
        "heat map": lambda: 99.0 * (high - np.clip(heat, low, high)) / (high - low),
        "colours": lambda: np.where(above < 0.0, 99.0, np.where(above < COLOUR_DB, 50.0, 0.0)),
        "known": lambda: np.minimum(
            100.0
            - 100.0 * connection_probability(mean_power_dbm(truth, nodes_m), fading, threshold),
            99.0,
        ),
    }
    return lambda kind: masks[kind]()


def case(seed: int, legs: int, scenes: dict[str, Scene]) -> dict[str, float]:
    """Return metres out of contact and length of each path of a seed, and the mask's time."""
    problem = load(PROBLEMS[seed % 2])
    scene = scenes[problem.name]
    roads = scene.road_map
    joined = np.flatnonzero(np.isfinite(scene.cost_to_go.cost_m))
    truth = draw_truth(problem, np.random.default_rng([seed, 0]))
    assert truth is not None
    log, ends = drawn_log(problem, scene, truth, joined, seed, legs)
    mask = masks_of(problem, truth, log, roads.nodes_m)
    found: dict[str, float] = {"seed": seed, "legs": legs, "readings": len(log)}
    for kind in KINDS:
        began = time.process_time()
        values = mask(kind)
        if kind == "planopt":
            found["mask_cpu_s"] = time.process_time() - began
        path = route(roads, ends, values)
        fine = along(path, 0.5)
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        out = true_power_dbm(truth, fine) < problem.stations[0].true_threshold_dbm
        found |= {f"{kind} out_m": float(length * out.mean()), f"{kind} length_m": length}
    return found


def ratio(rows: list[dict[str, float]], over: str, under: str) -> str:
    """Return the ratio of two sums over seeds with its bootstrap interval."""
    pairs = np.array([[row[over], row[under]] for row in rows])
    drawn = np.random.default_rng(0).integers(len(rows), size=(10_000, len(rows)))
    sums = np.maximum(pairs[drawn].sum(axis=1), 1e-9)
    low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.025, 0.975])
    total = pairs.sum(axis=0)
    return f"{total[0] / total[1]:.3f} ({low:.3f} to {high:.3f})"


def table(rows: list[dict[str, float]]) -> str:
    """Return means by mask, and planopt's ratios to each."""
    lines = [
        "| mask | out of contact [m] | length [m] | planopt's metres out over it "
        "| planopt's length over it |\n|---|---|---|---|---|"
    ]
    for kind in KINDS:
        out, length = (np.mean([row[f"{kind} {what}"] for row in rows]) for what in WHATS)
        ratios = [ratio(rows, f"planopt {what}", f"{kind} {what}") for what in WHATS]
        lines.append(f"| {kind} | {out:.1f} | {length:.1f} | {ratios[0]} | {ratios[1]} |")
    return "\n".join(lines)


WHATS = ("out_m", "length_m")


def main() -> None:
    """Compute missing seeds, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--legs", type=int, default=2)
    parser.add_argument("--log", type=Path, required=True)
    asked = parser.parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    text = asked.log.read_text(encoding="utf-8") if asked.log.exists() else ""
    known = {(row["seed"], row["legs"]): row for row in map(json.loads, text.splitlines())}
    scenes = {name: build_scene(load(name)) for name in PROBLEMS}
    for seed in seeds:
        if (seed, asked.legs) not in known:
            known[seed, asked.legs] = case(seed, asked.legs, scenes)
            with asked.log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[seed, asked.legs]) + "\n")
    rows = [known[seed, asked.legs] for seed in seeds]
    for name, chosen in (("all", rows), *((n, rows[k::2]) for k, n in enumerate(PROBLEMS))):
        print(f"{name}: {len(chosen)} seeds\n\n{table(chosen)}\n")
    print(
        f"readings {np.mean([row['readings'] for row in rows]):.0f} on average, mask "
        f"{max(row['mask_cpu_s'] for row in rows):.1f} s of CPU time at most"
    )


if __name__ == "__main__":
    main()
