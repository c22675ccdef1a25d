"""Smoothing of a route: a polyline that is locally cheapest by its integrated cost.

A lattice has sixteen headings, so that its routes are up to 2.7 % too long and zigzag around
coverage. The points of the route move sideways: dynamic programming over a few offsets of each
point finds the cheapest combination, first with few points and large offsets, then with more points
and smaller offsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import integrated_cost_m
from planopt.planning.scene import stops_along
from planopt.world.clearance import ObstacleIndex, segments_clear

MetreCost = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function from positions (n, 2) to the cost of a metre at each; (n,)."""

PIECES = (8, 16, 32, 64, 128, 256)
"""Numbers of pieces of a route on the levels of smoothing."""

OFFSETS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
"""Sideways moves of a point in each pass, in units of the pass."""

WIDEST, NARROWEST = 0.25, 0.002
"""First and last unit of a level, in lengths of its pieces."""

FINEST = 2.0
"""Shortest piece of a level, in spacings of the raster."""

PASSES = 4
"""Maximum number of passes with the same unit."""

RASTER_SHARE = 3e-3
"""Spacing of the raster of costs, in diagonals of the workspace; values are interpolated."""

RASTER_M = (0.2, 3.0)
"""Smallest and largest spacing."""


def smooth_route(
    metre_cost: MetreCost,
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    clearance_m: float,
    corners_m: NDArray[np.float64],  # (n, 2)
) -> NDArray[np.float64]:
    """Return a route between the same ends that costs at most as much; (m, 2)."""
    raster = CostRaster(metre_cost, bounds_m)
    total = float(np.linalg.norm(np.diff(corners_m, axis=0), axis=1).sum())
    route = corners_m
    for pieces in PIECES:
        longest = total / pieces
        if longest < FINEST * raster.spacing_m:
            break
        route = stops_along(_taut(raster, index, clearance_m, route), longest)
        unit = WIDEST * longest
        while unit > NARROWEST * longest:
            for _ in range(PASSES):
                moved = _moved(raster, index, bounds_m, clearance_m, route, unit)
                is_same = np.array_equal(moved, route)
                route = moved
                if is_same:
                    break
            unit *= 0.5
    costs_m = [integrated_cost_m(metre_cost, each) for each in (corners_m, route)]
    return route if costs_m[1] < costs_m[0] else corners_m


class CostRaster:
    """Cost of a metre at the nodes of a raster, computed where needed and interpolated."""

    def __init__(self, metre_cost: MetreCost, bounds_m: tuple[float, float, float, float]) -> None:
        self._metre_cost = metre_cost
        self._low = np.array(bounds_m[:2])
        size = np.array(bounds_m[2:]) - self._low
        self.spacing_m = float(np.clip(RASTER_SHARE * np.hypot(*size), *RASTER_M))
        columns, rows = (math.ceil(side / self.spacing_m) + 2 for side in size.tolist())
        self._shape = columns, rows
        self._values = np.full(columns * rows, np.nan)

    def __call__(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the interpolated costs at positions (n, 2)."""
        at = (places_m - self._low) / self.spacing_m
        columns, rows = self._shape
        cell = np.clip(at.astype(np.intp), 0, np.array([columns, rows]) - 2)
        first = cell[:, 0] * rows + cell[:, 1]
        corners = first[:, None] + np.array([0, rows, 1, rows + 1])
        new = np.unique(corners[np.isnan(self._values[corners])])
        if len(new):
            nodes = np.column_stack([new // rows, new % rows])
            self._values[new] = self._metre_cost(self._low + self.spacing_m * nodes)
        x, y = (at - cell).T
        weights = np.column_stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])
        return np.asarray((self._values[corners] * weights).sum(axis=1))

    def legs_m(
        self, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the costs of straight legs (n, 2), by the midpoint rule."""
        lengths = np.linalg.norm(ends_m - starts_m, axis=1)
        count = max(1, math.ceil(float(lengths.max()) / self.spacing_m))
        share = (np.arange(count) + 0.5) / count
        places = starts_m[:, None] + share[None, :, None] * (ends_m - starts_m)[:, None]
        return lengths * self(places.reshape(-1, 2)).reshape(-1, count).mean(axis=1)


def _taut(
    raster: CostRaster,
    index: ObstacleIndex,
    clearance_m: float,
    corners_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the route over the corners (n, 2) with the cheapest straight legs."""
    count = len(corners_m)
    cost, before = np.full(count, np.inf), np.zeros(count, dtype=int)
    cost[0] = 0.0
    for k in range(1, count):
        first = np.arange(max(0, k - 40), k)
        ends = np.broadcast_to(corners_m[k], (len(first), 2))
        legs = raster.legs_m(corners_m[first], ends)
        clear = segments_clear(index, corners_m[first], ends, clearance_m)
        clear[-1] = True
        through = np.where(clear, cost[first] + legs, np.inf)
        before[k] = first[int(through.argmin())]
        cost[k] = through.min()
    chosen = [count - 1]
    while chosen[-1] > 0:
        chosen.append(int(before[chosen[-1]]))
    return corners_m[chosen[::-1]]


def _moved(
    raster: CostRaster,
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    clearance_m: float,
    route_m: NDArray[np.float64],
    unit_m: float,
) -> NDArray[np.float64]:
    """Return the cheapest route with each inner point moved sideways; its ends stay."""
    along = np.zeros_like(route_m)
    along[1:-1] = route_m[2:] - route_m[:-2]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    places = route_m[:, None] + unit_m * OFFSETS[None, :, None] * normal[:, None]
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    inside = np.asarray(((places >= low) & (places <= high)).all(axis=2))
    count, choices = len(route_m), len(OFFSETS)
    starts = np.repeat(places[:-1], choices, axis=1).reshape(-1, 2)
    ends = np.tile(places[1:], (1, choices, 1)).reshape(-1, 2)
    legs = raster.legs_m(starts, ends)
    clear = segments_clear(index, starts, ends, clearance_m)
    legs = np.where(clear, legs, np.inf).reshape(count - 1, choices, choices)
    # The present route may be closer to an obstacle than the clearance with its pad.
    still = choices // 2
    present = raster.legs_m(route_m[:-1], route_m[1:])
    legs[:, still, still] = np.minimum(legs[:, still, still], present)
    legs = np.where(inside[1:, None, :], legs, np.inf)
    cost = np.zeros(choices)
    before = np.zeros((count, choices), dtype=int)
    for k in range(1, count):
        through = cost[:, None] + legs[k - 1]
        before[k] = through.argmin(axis=0)
        # Prefer the present point, so that equal costs end the passes.
        tie = through[still] <= through.min(axis=0) + 1e-12
        before[k][tie] = still
        cost = np.take_along_axis(through, before[k][None], axis=0)[0]
    chosen = [still if cost[still] <= cost.min() else int(cost.argmin())]
    for k in range(count - 1, 0, -1):
        chosen.append(int(before[k][chosen[-1]]))
    return places[np.arange(count), chosen[::-1]]


ROUND = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
"""Moves of a position of a plan in each pass, in units of the pass; no move is in the middle."""

STEP_UNITS = 0.25 * 0.5 ** np.arange(7)
"""Units of the passes over the positions of a plan, in longest steps."""

STEP_PASSES = 6
"""Maximum number of passes with the same unit."""


def smooth_steps(
    leg_value: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    places_m: NDArray[np.float64],
    longest_m: float,
) -> NDArray[np.float64]:
    """Return positions (k + 1, 2) whose legs cost least; the first and the last position stay.

    `leg_value` maps starts and ends (n, k, 2) of the k legs to costs (n, k), infinite if a leg is
    not allowed.
    """
    places = places_m.copy()
    choices, still = len(ROUND), len(ROUND) // 2
    for unit in (longest_m * STEP_UNITS).tolist():
        for _ in range(STEP_PASSES):
            moved = places[:, None] + unit * ROUND
            moved[0], moved[-1] = places[0], places[-1]
            starts = np.repeat(moved[:-1], choices, axis=1).swapaxes(0, 1)
            values = leg_value(starts, np.tile(moved[1:], (1, choices, 1)).swapaxes(0, 1))
            legs = values.T.reshape(-1, choices, choices)
            cost, before = legs[0][still], list[NDArray[np.intp]]()
            for leg in legs[1:]:
                through = cost[:, None] + leg
                before.append(through.argmin(axis=0))
                cost = through.min(axis=0)
            chosen = [still]
            for back in before[::-1]:
                chosen.append(int(back[chosen[-1]]))
            found = moved[1:-1][np.arange(len(places) - 2), chosen[:0:-1]]
            if not np.isfinite(cost[still]) or np.array_equal(found, places[1:-1]):
                break
            places[1:-1] = found
    return places
