"""Write the sample log: walks through Munich with a receiver, in the truth of a problem: LOG.csv.

Each walk goes from one random free place to another on the shortest way of a grid, and measures
every few seconds. The fading, the places and so the file are those of one seed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from planopt import load
from planopt.channel import measure
from planopt.files.writing import write_text
from planopt.planning.initial_data import draw_initial_data
from planopt.world.clearance import clearance_m, index_obstacles
from planopt.world.workspace import Workspace

PROBLEM, SEED = "munich_courier", 7
WALKS, LONGEST_M = 8, 480.0
CELL_M, CLEARANCE_M = 5.0, 2.0
SPEED_M_S, EVERY_S = 1.4, 5.0
WAIT_S = 3600.0
"""Between the begins of two walks."""


def main(log: str) -> None:
    """Walk, measure, write."""
    problem = load(PROBLEM)
    (truth,) = draw_initial_data(problem, SEED).truths
    generator = np.random.default_rng(SEED)
    grid, ways = free_grid(problem.workspace)
    lines = ["x_m,y_m,power_dbm,at_floor,walk,t_s"]
    for walk in range(WALKS):
        places = a_walk(grid, ways, generator)
        taken = measure(truth, places)
        rows = zip(taken.positions_m, taken.power_dbm, taken.censored, strict=True)
        for number, ((x, y), power, floor) in enumerate(rows):
            time_s = walk * WAIT_S + number * EVERY_S
            lines.append(f"{x:.1f},{y:.1f},{power:.1f},{floor:d},{walk + 1},{time_s:.0f}")
    write_text(Path(log), "\n".join([*lines, ""]))
    print(f"{log}: {len(lines) - 1} measurements on {WALKS} walks")


def free_grid(workspace: Workspace) -> tuple[NDArray[np.float64], coo_array]:
    """Return the free places (n, 2) of a grid, and the lengths of the ways to their neighbours."""
    x_min, y_min, x_max, y_max = workspace.bounds_m
    x, y = np.arange(x_min + CELL_M, x_max, CELL_M), np.arange(y_min + CELL_M, y_max, CELL_M)
    places = np.stack(np.meshgrid(x, y), axis=-1)
    # The way to a neighbour is at most 1.5 cells long, so its middle is this far from both ends.
    free = clearance_m(index_obstacles(workspace), places.reshape(-1, 2)) > CLEARANCE_M
    free = free.reshape(places.shape[:2])
    number = np.cumsum(free).reshape(free.shape) - 1
    start, end, length = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = free[: free.shape[0] - dy, max(0, -dx) : free.shape[1] - max(0, dx)]
        there = free[dy:, max(0, dx) : free.shape[1] + min(0, dx)]
        both = here & there
        start.append(number[: free.shape[0] - dy, max(0, -dx) : free.shape[1] - max(0, dx)][both])
        end.append(number[dy:, max(0, dx) : free.shape[1] + min(0, dx)][both])
        length.append(np.full(both.sum(), CELL_M * np.hypot(dx, dy)))
    joined = (np.concatenate(length), (np.concatenate(start), np.concatenate(end)))
    return places[free], coo_array(joined, shape=(free.sum(), free.sum()))


def a_walk(
    places: NDArray[np.float64], ways: coo_array, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Return where a walk measures: from one random place to another, not too far away."""
    while True:
        start, end = generator.integers(len(places), size=2)
        away, before = dijkstra(
            ways.tocsr(), directed=False, indices=start, return_predecessors=True
        )
        if LONGEST_M / 2 < away[end] <= LONGEST_M:
            break
    path = [end]
    while path[-1] != start:
        path.append(before[path[-1]])
    corners = places[path[::-1]]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(0.0, along[-1], SPEED_M_S * EVERY_S)
    return np.column_stack([np.interp(at, along, corners[:, axis]) for axis in range(2)])


if __name__ == "__main__":
    main(*sys.argv[1:])
