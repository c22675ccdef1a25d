"""Drive couriers through Munich at the same time; count who arrives, and who comes too near.

``python benchmarks/courier_teams.py --counts 2 3 5 --seeds 10 --log FILE`` draws, for each seed, as
many places in the streets of a square of 300 m somewhere on the map of the library problem
`munich_courier`, at least 60 m from each other; each courier drives from its own to that of the
next one. So every goal is a start, and two change places. A line a run goes to the log, which is a
cache: runs that it has are not driven again.
Contacts are counted on the driven tracks, sampled 200 times a step, not taken from the planner.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from planopt import Problem, Robot, load, simulate
from planopt.planning.free_space import build_roads
from planopt.world import index_obstacles, lattice_paths, swept_clearance_m
from planopt.world.lattice import node_at

PROBLEM = "munich_courier"
SEPARATION_M = 10.0
SQUARE_M, LEAST_M = 300.0, 60.0
"""Places are drawn in a square of this side, at least so far from each other."""

HEADER = (
    "| couriers | all arrive | contacts | least separation [m] | verified steps "
    "| steps that give way | cost ratio, mean | worst | CPU a step and courier [ms] |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Record:
    """One run.

    Attributes
    ----------
    count, seed, outcome
        Couriers, the seed of places and channel, and how the run ended.
    steps, verified_steps, giving_way_steps
        Steps of all couriers; those whose plan was verified, and those that gave way.
    contacts
        Steps in which two couriers came nearer than the separation, or one nearer to an obstacle
        than the clearance.
    least_m
        Least distance of two couriers.
    cost_ratio
        Realised cost of all over the sum of their clairvoyants', each alone.
    cpu_s
        Processor time of the run, first measurements and geometry included.
    """

    count: int
    seed: int
    outcome: str
    steps: int
    verified_steps: int
    giving_way_steps: int
    contacts: int
    least_m: float
    cost_ratio: float
    cpu_s: float


def drawn_problem(base: Problem, count: int, seed: int) -> Problem:
    """Return the problem with couriers between drawn places in streets that are joined."""
    road_map = build_roads(base, np.asarray(base.goal_m))
    ways = lattice_paths(road_map, node_at(road_map, np.asarray(base.goal_m)))
    free = road_map.nodes_m[np.isfinite(ways.cost_m)]
    generator = np.random.default_rng(seed)
    middle = free[generator.integers(len(free))]
    free = free[np.abs(free - middle).max(axis=1) <= SQUARE_M / 2.0]
    places: list[NDArray[np.float64]] = []
    while len(places) < count:
        place = free[generator.integers(len(free))].round(1)
        if all(np.linalg.norm(place - other) >= LEAST_M for other in places):
            places.append(place)
    starts = [(float(x), float(y)) for x, y in places]
    robots = tuple(
        Robot(
            name=f"courier{number}",
            start_m=start,
            goal_m=starts[(number + 1) % count],
            speed_max_m_s=base.robots[0].speed_max_m_s,
        )
        for number, start in enumerate(starts)
    )
    constraints = replace(base.constraints, separation_m=SEPARATION_M)
    return replace(base, name=f"{base.name}_{count}", robots=robots, constraints=constraints)


def drive(base: Problem, count: int, seed: int) -> Record:
    """Drive one team."""
    begun = process_time()
    run = simulate(drawn_problem(base, count, seed), seed=seed)
    cpu_s = process_time() - begun
    tracks = [one.log.positions_m for one in run.runs]
    near = [least_distances_m(one, other) for one, other in combinations(tracks, 2)]
    index, clearance = index_obstacles(base.workspace), base.constraints.clearance_m
    struck = sum(int((swept_clearance_m(index, t) < clearance - 1e-6).sum()) for t in tracks)
    met = int((np.array(near) < SEPARATION_M - 1e-6).any(axis=0).sum())
    steps = sum(len(track) - 1 for track in tracks)
    return Record(
        count,
        seed,
        run.outcome.value,
        steps,
        sum(plan.verdict.value == "verified" for made in run.plans for plan in made),
        run.rungs.get("give_way", 0),
        met + struck,
        float(np.min(near)),
        run.metrics["cost_ratio"],
        cpu_s,
    )


def least_distances_m(
    first_m: NDArray[np.float64], second_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the least distance of two tracks (n + 1, 2) in each step, by sampling; (n,)."""
    share = np.linspace(0.0, 1.0, 201)[:, None, None]
    apart = first_m - second_m
    return np.linalg.norm((1.0 - share) * apart[:-1] + share * apart[1:], axis=2).min(axis=0)


def read_log(log: Path | None) -> list[Record]:
    """Return the runs of a log; none where there is no file."""
    if log is None or not log.exists():
        return []
    return [Record(**json.loads(line)) for line in log.read_text().splitlines()]


def line_of(records: Sequence[Record]) -> str:
    """Return a row of the table, of runs of equally many couriers."""
    steps = sum(r.steps for r in records)
    arrived = [r for r in records if r.outcome == "reached"]
    ratios = [r.cost_ratio for r in arrived] or [float("nan")]
    return (
        f"| {records[0].count} | {len(arrived)} of {len(records)} "
        f"| {sum(r.contacts for r in records)} | {min(r.least_m for r in records):.3f} "
        f"| {sum(r.verified_steps for r in records)} of {steps} "
        f"| {sum(r.giving_way_steps for r in records)} "
        f"| {np.mean(ratios):.3f} | {max(ratios):.3f} "
        f"| {1e3 * sum(r.cpu_s for r in records) / steps:.0f} |"
    )


def main() -> None:
    """Drive what the log has not, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--log", type=Path)
    parser.add_argument("--problem", default=PROBLEM)
    asked = parser.parse_args()
    base, known = load(asked.problem), {(r.count, r.seed): r for r in read_log(asked.log)}
    print(HEADER)
    for count in asked.counts:
        rows: list[Record] = []
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
            if (count, seed) not in known:
                known[count, seed] = drive(base, count, seed)
                if asked.log is not None:
                    with asked.log.open("a") as file:
                        file.write(json.dumps(asdict(known[count, seed])) + "\n")
            rows.append(known[count, seed])
        print(line_of(rows), flush=True)


if __name__ == "__main__":
    main()
