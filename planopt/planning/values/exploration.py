"""Steering paths, region of the map, and informative positions."""

import math
from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.neighbours import PlaceTree
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.measuring import MeasuringRule
from planopt.objectives.moments import Region
from planopt.objectives.terms.context import SteeringPath
from planopt.objectives.terms.term import explores
from planopt.planning.proof.context import search_power
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    index_obstacles,
    inside_bounds,
    segments_clear,
)
from planopt.world.lattice import MOVES, Lattice, moves_from


def steering_path(
    problem: Problem, index: ObstacleIndex, turns_m: Floats, lattice_m: Floats | None = None
) -> SteeringPath:
    """Return a steering path with turns `turns_m` (m, 2)."""
    in_order = any(term.steers == "goal" for term in problem.terms)
    apart_m = problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
    return SteeringPath(turns_m, index, apart_m, lattice_m, in_order)


PLACES = 200
"""Approximate number of grid cells that represent the workspace."""
NEAR_PLACES = 900
"""Approximate number of grid cells where a plan can change the channel map."""
ROOM_STEPS = 5.0
"""Margin around the reachable positions in longest steps."""


def workspace_region(problem: Problem) -> Region:
    """Return the workspace as a region: grid positions outside obstacles with equal weights."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    grid = _centres((x_min, y_min, x_max, y_max), _coarse_m(problem))
    free = grid[clearance_m(index_obstacles(problem.workspace), grid) > 0.0]
    places = free if len(free) else grid
    return Region(places, np.full(len(places), 1.0 / len(places)))


def region_near(problem: Problem, whole: Region, position_m: Floats) -> Region:
    """Return the region `whole` with a fine grid near a robot's position (2,)."""
    # The coarse grid alone would strongly overestimate the value of plans through its nodes.
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    reach = problem.step_length_m * (problem.planner.horizon + ROOM_STEPS)
    low = np.maximum(position_m - reach, (x_min, y_min))
    high = np.minimum(position_m + reach, (x_max, y_max))
    side = high - low
    cell, coarse = math.sqrt(float(side.prod()) / NEAR_PLACES), _coarse_m(problem)
    if not (side > 0.0).all() or cell >= coarse:
        return whole
    near = _centres((low[0], low[1], high[0], high[1]), cell)
    near = near[clearance_m(index_obstacles(problem.workspace), near) > 0.0]
    far = whole.grid_m[~((whole.grid_m >= low) & (whole.grid_m <= high)).all(axis=1)]
    weight = np.concatenate([np.full(len(near), cell**2), np.full(len(far), coarse**2)])
    if not len(weight):
        return whole
    return Region(np.concatenate([near, far]), weight / weight.sum())


def region_along(problem: Problem, region: Region, path_m: Floats) -> Region:
    """Return the part of the map `region` that measurements near `path_m` (N, 2) can change."""
    away = np.linalg.norm(region.grid_m[:, None] - path_m, axis=2).min(axis=1)
    near = away <= ROOM_STEPS * problem.step_length_m
    return Region(region.grid_m[near], region.weight[near]) if near.any() else region


def _coarse_m(problem: Problem) -> float:
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    return math.sqrt((x_max - x_min) * (y_max - y_min) / PLACES)


def _centres(bounds_m: tuple[float, float, float, float], cell_m: float) -> Floats:
    """Return the centres (n, 2) of cells about `cell_m` wide that fill the bounds, row by row."""
    x_min, y_min, x_max, y_max = bounds_m
    x, y = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for low, high in ((x_min, x_max), (y_min, y_max))
        for count in (max(1, round((high - low) / cell_m)),)
    )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


FINER = 4
"""Subdivision of the lattice spacing, for intermediate positions once all nodes are measured."""


def learns(problem: Problem) -> bool:
    """Return whether any term of the problem guides its robots to unmeasured positions."""
    return any(explores(term) for term in problem.terms)


def left_to_learn(
    problem: Problem,
    index: ObstacleIndex,
    lattice: Lattice,
    here_m: Floats,  # (2,) position of the robot
    posteriors: Sequence[ChannelPosterior],
) -> Floats:
    """Return the reachable positions (k, 2) at which measurements are informative."""
    # They are lattice nodes, or intermediate positions if all nodes are measured. If all terms have
    # a variance threshold, they are the positions of the workspace grid above the threshold.
    nodes = lattice.positions_m[reachable_nodes(problem, index, lattice, here_m)]
    rule = MeasuringRule.of(posteriors, problem.channel.measure_spacing_m)
    limits = [term.variance_threshold for term in problem.terms if explores(term)]
    known = [limit for limit in limits if limit is not None]
    if known and len(known) == len(limits):
        places = _joined(problem, index, nodes, workspace_region(problem).grid_m)
        places = places[rule.is_open(places)]
        if not len(places):
            return places
        variance = np.max(
            [search_power(station, places).deviation_db ** 2 for station in posteriors], axis=0
        )
        return places[variance > min(known)]
    left = nodes[rule.is_open(nodes)]
    if len(left) or not len(nodes):
        return left
    share = lattice.spacing_m * (np.arange(FINER) / FINER - 0.5)
    around = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 1, 2)
    between = (nodes + around).reshape(-1, 2)
    between = between[rule.is_open(between)]
    return _joined(problem, index, nodes, between)


def reachable_nodes(
    problem: Problem, index: ObstacleIndex, lattice: Lattice, here_m: Floats
) -> Mask:
    """Return a mask (ny, nx) of nodes reachable by lattice moves from a position (2,)."""
    found = np.zeros(lattice.shape, dtype=np.bool_)
    reach = problem.step_length_m - STEP_PAD_M
    rows, columns, clear = moves_from(
        index, lattice, here_m, reach, problem.constraints.clearance_m
    )
    if not clear.any():
        return found
    number = np.arange(found.size).reshape(lattice.shape)
    begins: list[Indices] = []
    ends: list[Indices] = []
    for (dx, dy), opened in zip(MOVES, lattice.open_moves, strict=True):
        begin = number[opened]
        begins.append(begin)
        ends.append(begin + dy * lattice.shape[1] + dx)
    begin, end = np.concatenate(begins), np.concatenate(ends)
    graph = csr_matrix((np.ones(len(begin)), (begin, end)), shape=(found.size, found.size))
    _, part = cast("tuple[int, NDArray[np.int32]]", connected_components(graph, directed=False))
    part = part.reshape(lattice.shape)
    return np.isin(part, part[rows[clear], columns[clear]]) & lattice.free


def _joined(problem: Problem, index: ObstacleIndex, nodes_m: Floats, places_m: Floats) -> Floats:
    """Return the positions that have a collision-free segment from their nearest node."""
    places = places_m[inside_bounds(problem.workspace, places_m)]
    if not len(places) or not len(nodes_m):
        return places[:0]
    nearest = nodes_m[PlaceTree(nodes_m).nearest(places, 1)[0][:, 0]]
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    return places[segments_clear(index, nearest, places, wanted)]
