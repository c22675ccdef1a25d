"""How far robots out of contact drive until they are connected, beside the shortest path there.

``python benchmarks/connect_search.py connect_rooftop connect_street`` drives 20 seeded starts of
each problem at horizons 1, 5, 10 and 20. A start is a node of the problem's lattice that is out of
contact by its mean power, at least `LEAST_M` of path from the nearest node that is connected by
its mean power, which is what the driven length is compared with. On a ray-traced map that node is
often a single cell that a reflection happens to hit: the length is compared with the shortest path
to the nearest region of `REGION_M2` that is connected throughout, too. ``--plain`` drives instead
to the nearest node that is likely connected, by the same posterior, and replans at every step: what
a search without an objective of its own makes of the same measurements.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from planopt import Problem, load
from planopt.channel import measure
from planopt.channel.posterior import extend
from planopt.planning.initial_data import prepare
from planopt.planning.loop.metrics import true_serving_dbm
from planopt.planning.scene import Ground, build_ground
from planopt.planning.solve import simulate

LEAST_M = 30.0
"""Starts are at least so far from the nearest connected node, by the shortest path."""

REGION_M2 = 200.0
"""A connected region has this area at least."""

LIKELY = 0.5
"""Probability of connection from which on the plain search drives to a place."""


@dataclass(frozen=True)
class Search:
    """One run from a start out of contact.

    Attributes
    ----------
    start, horizon
        Number of the start, which is the run's random seed too, and N.
    outcome
        How the run ended.
    shortest_m, region_m, driven_m
        To the nearest connected node, to the nearest connected region (infinite if the robot can
        come to none), and what the robot drove.
    step_s
        ``(steps,)`` processor time of each step.
    """

    start: int
    horizon: int
    outcome: str
    shortest_m: float
    region_m: float
    driven_m: float
    step_s: NDArray[np.float64]


def graph_of(ground: Ground) -> csr_matrix:
    """The lattice, weighted by the lengths of its moves."""
    road_map, count = ground.road_map, len(ground.road_map.nodes_m)
    return csr_matrix(
        (road_map.edge_length_m, road_map.edge_to, road_map.edge_start), shape=(count, count)
    )


def in_regions(graph: csr_matrix, connected: NDArray[np.bool_], node_m2: float) -> NDArray:
    """Which of the connected nodes (n,) are in a region of at least `REGION_M2`; (n,)."""
    nodes = np.flatnonzero(connected)
    number, label = connected_components(graph[nodes][:, nodes], directed=False)
    large = np.bincount(label, minlength=number) * node_m2 >= REGION_M2
    found = np.zeros(len(connected), dtype=np.bool_)
    found[nodes] = large[label]
    return found


def seeded_starts(problem: Problem, count: int, seed: int) -> list[NDArray[np.float64]]:
    """Places out of contact ``(count, 2)``; shortest paths to a connected node, and region."""
    ground = build_ground(problem, np.asarray(problem.robots[0].start_m))
    road_map, graph = ground.road_map, graph_of(ground)
    unfaded = replace(problem.channel.truth, multipath=None)
    channel = replace(problem.channel, truth=unfaded)
    truths = prepare(replace(problem, channel=channel), seed).truths
    power = true_serving_dbm(problem, truths, road_map.nodes_m)
    connected = power >= problem.stations[0].threshold_dbm
    away = dijkstra(graph, indices=np.flatnonzero(connected), min_only=True)
    large = in_regions(graph, connected, road_map.lattice.spacing_m**2)
    region = dijkstra(graph, indices=np.flatnonzero(large), min_only=True)
    far = np.flatnonzero(np.isfinite(away) & (away >= LEAST_M))
    chosen = np.random.default_rng(seed).permutation(far)[:count]
    return [road_map.nodes_m[chosen], away[chosen], region[chosen]]


def searches(
    problem: Problem,
    horizons: Iterable[int],
    count: int,
    seed: int,
    *,
    plain: bool = False,
    first: int = 0,
) -> Iterable[Search]:
    """Drive from the seeded starts `first` to `count` at every horizon, or by the plain search."""
    found = zip(*seeded_starts(problem, count, seed), strict=True)
    for number, (start, *away) in list(enumerate(found))[first:]:
        robot = replace(problem.robots[0], start_m=(float(start[0]), float(start[1])))
        placed = replace(problem, robots=(robot,))
        if plain:
            yield plain_search(placed, number, away, seed + number)
            continue
        prepared = prepare(placed, seed + number)
        for horizon in horizons:
            clock = [time.process_time()]
            run = simulate(
                placed,
                horizon=horizon,
                seed=seed + number,
                prepared=prepared,
                on_step=lambda _, clock=clock: clock.append(time.process_time()),
            ).runs[0]
            yield Search(
                number,
                horizon,
                run.outcome.value,
                *map(float, away),
                run.metrics.path_m,
                np.diff(clock),
            )


def plain_search(problem: Problem, number: int, away_m: list[float], seed: int) -> Search:
    """Drive to the nearest node whose predicted probability is at least `LIKELY`, until connected.

    Where there is none, to the most probable of all. Nodes that were visited are left out.
    """
    start = np.asarray(problem.robots[0].start_m)
    prepared, ground = prepare(problem, seed), build_ground(problem, start)
    threshold = problem.stations[0].threshold_dbm
    road_map, graph = ground.road_map, graph_of(ground)
    here = int(np.argmin(np.linalg.norm(road_map.nodes_m - start, axis=1)))
    belief, visited, driven_m, clock = prepared.belief.posterior, [here], 0.0, [time.process_time()]
    for _ in range(problem.planner.max_steps):
        length, before = dijkstra(graph, indices=here, return_predecessors=True)
        length[visited] = np.inf
        open_nodes = np.flatnonzero(np.isfinite(length))
        chance = belief.connectivity(road_map.nodes_m[open_nodes], threshold)
        likely = open_nodes[chance >= LIKELY]
        goal = likely[length[likely].argmin()] if len(likely) else open_nodes[chance.argmax()]
        path = [int(goal)]
        while before[path[-1]] != here:
            path.append(int(before[path[-1]]))
        within = [node for node in path if length[node] <= problem.step_length_m + 1e-9]
        following = within[0] if within else path[-1]
        driven_m, here = driven_m + float(length[following]), following
        visited.append(here)
        clock.append(time.process_time())
        heard = measure(prepared.truths[0], road_map.nodes_m[here][None])
        if heard.power_dbm[0] >= threshold and not heard.censored[0]:
            return Search(number, 0, "completed", *away_m, driven_m, np.diff(clock))
        belief = extend(belief, heard)
    return Search(number, 0, "step_limit", *away_m, driven_m, np.diff(clock))


def summary(found: list[Search]) -> str:
    """One line of the table: how many connect, the mean ratio, and the time of a step."""
    connected = sum(search.outcome == "completed" for search in found)
    ratios = np.array([search.driven_m / search.shortest_m for search in found])
    driven = sum(search.driven_m for search in found) / sum(s.shortest_m for s in found)
    near = [search for search in found if np.isfinite(search.region_m)]
    region = sum(search.driven_m for search in near) / sum(s.region_m for s in near)
    steps = 1e3 * np.concatenate([search.step_s[1:] for search in found])
    return (
        f"N {found[0].horizon:2d}: {connected} of {len(found)} connect, driven / shortest "
        f"{ratios.mean():.2f} in the mean, {ratios.max():.2f} at most, {driven:.2f} of all metres, "
        f"{region:.2f} of those to regions ({len(near)}), "
        f"step p50 {np.median(steps):.0f} ms, p95 {np.quantile(steps, 0.95):.0f} ms (processor)"
    )


def main() -> None:
    """Print a table of each problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="+", help="names of the library, or files")
    parser.add_argument("--horizons", default="1,5,10,20")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first start")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plain", action="store_true", help="the plain search, without horizon")
    parser.add_argument("--each", action="store_true", help="print every run")
    args = parser.parse_args()
    horizons = [0] if args.plain else [int(part) for part in args.horizons.split(",")]
    for name in args.problems:
        problem = load(name)
        found: list[Search] = []
        for search in searches(
            problem, horizons, args.starts, args.seed, plain=args.plain, first=args.first
        ):
            found.append(search)
            if args.each:
                print(
                    f"  start {search.start} N {search.horizon}: {search.outcome} shortest "
                    f"{search.shortest_m:.0f} m, region {search.region_m:.0f} m, driven "
                    f"{search.driven_m:.0f} m, step {1e3 * np.median(search.step_s):.0f} ms",
                    flush=True,
                )
        print(name)
        for horizon in horizons:
            print(summary([search for search in found if search.horizon == horizon]))


if __name__ == "__main__":
    sys.exit(main())
