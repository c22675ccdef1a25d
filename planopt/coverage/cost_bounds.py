"""Lower bounds on the coverage cost of any deployment, by Lagrangian relaxation (equation 7.21).

Prices are optimised on coarse cells, and then interpolated on fine ones, where an upper bound of
the gain G is computed on boxes that cover all positions of an agent.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize
from scipy.spatial import KDTree

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.assignment import HEXAGON
from planopt.coverage.density import CallableDensity, UniformDensity
from planopt.coverage.geodesic import GeodesicGround, Ground, polygon_boundaries

EFFORT_S = 1.0  # Processor time in seconds of a bound on a common core, by default
PAIRS_PER_S = 2.0e7, 1.5e6
"""Number of box-cell pairs processed per second in a price step, and in the certificate."""
COARSE = 5.0  # Maximum number of coarse cells along the radius of an agent's cell
FINE = 40.0
"""Maximum number of fine cells along that radius, reached in about 30 s per agent. With 36 instead
of 30 cells the gap falls by 0.05 percentage points."""
STEPS = 100  # Number of price steps assumed for the choice of the coarse cells' size
SMOOTHINGS = (0.05, 0.02, 0.01, 0.004, 0.002, 0.001)
"""Relative temperatures of the soft maximum over positions, in sequence."""
MOST_STEPS = 80  # Maximum number of price steps at each temperature
GROWTH = 1.7  # Maximum factor by which a price grows at each temperature
NEAREST = 4  # Number of positions between which prices are interpolated
FINEST = 14  # Number of halvings from the region's extent to the smallest cell
CHUNK = 10_000  # Number of boxes whose pairs with cells are in memory at a time
SPLITS = 3  # Number of times that the boxes with the largest bounds are split
SPLIT_SHARE = 0.03  # Share of the boxes that are split
ROUNDING = 1e-9  # Share by which the bound is reduced for rounding and quadrature errors


@dataclass(frozen=True, eq=False)
class Cells:
    """Mass distribution of the region, divided into m cells."""

    centroids_m: Floats  # (m, 2)
    mass: Floats  # (m,)
    second: Floats  # (m,) second moment about the centroid
    low_m: Floats  # (m, 2) lower left corner of the cell's bounding box
    high_m: Floats  # (m, 2)
    rest: float  # Cost in addition to the integral over the cells


@dataclass(frozen=True, eq=False)
class Prices:
    """Prices in m^2 at scattered positions, interpolated between them on a logarithmic scale."""

    tree: KDTree
    logarithms: Floats  # (m,)

    def at(self, places_m: Floats, most_m2: float) -> Floats:
        """Return the prices (k,) at positions (k, 2), at most `most_m2`."""
        count = min(NEAREST, len(self.logarithms))
        found = self.tree.query(places_m, k=[*range(1, count + 1)])
        distances = np.asarray(found[0], dtype=np.float64)
        numbers = np.asarray(found[1], dtype=np.intp)
        weights = 1.0 / np.maximum(distances, max(1e-9 * float(distances.max()), 1e-150)) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        return np.minimum(np.exp((weights * self.logarithms[numbers]).sum(axis=1)), most_m2)


def cost_bound(ground: Ground, places_m: Floats, effort_s: float = EFFORT_S) -> float:
    """Return a lower bound of the cost of all deployments of equally many agents, or 0.

    Parameters
    ----------
    ground
        The region with its density. With obstacles, distances are bounded by straight lines. A
        density given as a function has no bound.
    places_m
        A good deployment (n, 2), from which the prices start. It does not affect validity.
    effort_s
        Intended processor time in seconds. It sets resolution and iterations; no clock is read.
    """
    if not isinstance(ground, GeodesicGround) and isinstance(ground.density, CallableDensity):
        return 0.0
    most_m2 = math.inf
    if not isinstance(ground, GeodesicGround) and ground.sensing_range_m is not None:
        most_m2 = ground.sensing_range_m**2
    prices, count = _first_prices(ground, places_m), len(places_m)
    # A disc of radius k cells has about pi k^2 of them, as many as boxes per agent.
    each = 0.5 * effort_s / (math.pi**2 * count)
    parts = min((each * PAIRS_PER_S[0] / STEPS) ** 0.25, COARSE)
    middles, sides = _leaves(ground, prices, most_m2, parts)
    cells = _cells(ground, middles, sides)
    values = _optimised(
        cells, middles, count, prices.at(cells.centroids_m, most_m2), most_m2, 0.5 * effort_s
    )
    prices = Prices(KDTree(cells.centroids_m), np.log(values))
    parts = min((each * PAIRS_PER_S[1]) ** 0.25, FINE)
    middles, sides = _leaves(ground, prices, most_m2, parts)
    cells = _cells(ground, middles, sides)
    values = prices.at(cells.centroids_m, most_m2)
    proven = certified(ground, cells, middles, sides, values, count)
    if isinstance(ground, GeodesicGround) or not isinstance(ground.density, UniformDensity):
        return proven
    # Every cell costs at least as much as a disc of equal area, and the sum is least for equal
    # areas. In a convex polygon of at most six sides, regular hexagons of equal area give a tighter
    # bound (Fejes Tóth's moment theorem).
    area, reach = ground.area_m2 / count, math.sqrt(most_m2)
    inner = min(area, math.pi * reach**2)
    least = inner**2 / (2.0 * math.pi) + (reach**2 * (area - inner) if area > inner else 0.0)
    if len(ground.hull.corners_m) <= 6 and math.isinf(reach):
        least = max(least, HEXAGON * area**2)
    return max(proven, count * ground.density.weight_per_m2 * least)


def certified(
    ground: Ground,
    cells: Cells,
    middles_m: Floats,  # (b, 2) of squares that cover all positions of agents
    sides_m: Floats,  # (b,)
    prices_m2: Floats,  # (m,) at most the square of the sensing range
    count: int,
) -> float:
    """Return the lower bound, at least 0, for `prices_m2`; any prices give a valid bound."""
    half, settled = 0.5 * sides_m, 0.0
    gains = _largest_gains(middles_m, half, cells, prices_m2)
    for _ in range(SPLITS):
        near = gains > np.quantile(gains, 1.0 - SPLIT_SHARE)
        near |= gains == gains.max()
        settled = max(settled, float(gains[~near].max(initial=0.0)))
        half = np.repeat(0.5 * half[near], 4)
        shifts = np.tile([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]], (near.sum(), 1))
        middles_m = np.repeat(middles_m[near], 4, axis=0) + shifts * half[:, None]
        kept = _touches(ground, middles_m, 2.0 * half)
        middles_m, half = middles_m[kept], half[kept]
        gains = _largest_gains(middles_m, half, cells, prices_m2)
    paid, gained = float(prices_m2 @ cells.mass), count * max(settled, float(gains.max()))
    return max(cells.rest + paid - gained - ROUNDING * (cells.rest + paid + gained), 0.0)


def _sums(numbers: Indices, values: Floats | Mask, count: int) -> Floats:
    """Return the sums (count,) of `values` with equal index in `numbers`."""
    return np.asarray(np.bincount(numbers, values, count), dtype=np.float64)


def _first_prices(ground: Ground, places_m: Floats) -> Prices:
    """Return initial prices: squared radii of discs with the mean squared distance of the cells."""
    # The second nearest agent, which a single one lacks, is not used.
    agents = np.repeat(places_m, 2, axis=0) if len(places_m) == 1 else places_m
    two, count = ground.two_nearest(agents), len(agents)
    mass = _sums(two.owner, two.mass, count)
    second = _sums(two.owner, two.mass * two.first_m2, count)
    some = (mass > 0.0) & (second > 0.0)
    return Prices(KDTree(agents[some]), np.log(2.0 * second[some] / mass[some]))


def _leaves(ground: Ground, prices: Prices, most_m2: float, parts: float) -> tuple[Floats, Floats]:
    """Return centres (b, 2) and sides (b,) of squares that are smaller where prices are lower."""
    low, high = np.asarray(ground.free.bounds).reshape(2, 2)
    side = float((high - low).max())
    middles, found = low[None] + 0.5 * side, list[tuple[Floats, Floats]]()
    for level in range(FINEST + 1):
        middles = middles[_touches(ground, middles, np.full(len(middles), side))]
        wide = np.sqrt(2.0 * prices.at(middles, most_m2)) < parts * side
        wide &= level < FINEST
        found.append((middles[~wide], np.full(int((~wide).sum()), side)))
        side *= 0.5
        shifts = 0.5 * side * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
        middles = (middles[wide, None] + shifts).reshape(-1, 2)
        if not len(middles):
            break
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


def _squares(middles_m: Floats, sides_m: Floats) -> NDArray[np.object_]:
    """Return squares as polygons."""
    low, high = middles_m - 0.5 * sides_m[:, None], middles_m + 0.5 * sides_m[:, None]
    return np.asarray(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]), dtype=np.object_)


def _touches(ground: Ground, middles_m: Floats, sides_m: Floats) -> Mask:
    """Return a mask (b,) of the squares that intersect the free area."""
    free = ground.free
    shapely.prepare(free)
    return np.asarray(shapely.intersects(free, _squares(middles_m, sides_m)), dtype=np.bool_)


def _cells(ground: Ground, middles_m: Floats, sides_m: Floats) -> Cells:
    """Return the mass distribution of a ground on squares that cover it."""
    if isinstance(ground, GeodesicGround):
        return _cells_of_nodes(ground, middles_m, sides_m)
    free = ground.free
    shapely.prepare(free)
    pieces = _squares(middles_m, sides_m)
    cut = ~np.asarray(shapely.contains(free, pieces), dtype=np.bool_)
    pieces[cut] = shapely.intersection(pieces[cut], free)
    area = np.asarray(shapely.area(pieces))  # pyright: ignore[reportUnknownMemberType]
    pieces = pieces[area > 0.0]
    middles = np.asarray(shapely.get_coordinates(shapely.centroid(pieces)), dtype=np.float64)
    moments = ground.density.moments(polygon_boundaries(pieces, middles))
    some = moments.mass > 0.0
    mass = moments.mass[some]
    offsets = moments.first[some] / mass[:, None]
    second = np.maximum(moments.second[some] - mass * (offsets * offsets).sum(axis=1), 0.0)
    corners = np.asarray(shapely.bounds(pieces[some]), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]
    return Cells(middles[some] + offsets, mass, second, corners[:, :2], corners[:, 2:], 0.0)


def _cells_of_nodes(ground: GeodesicGround, middles_m: Floats, sides_m: Floats) -> Cells:
    """Return the nodes of a ground, merged into one cell per square."""
    places, weight = ground.ends_m, ground.mass
    square = np.asarray(KDTree(middles_m).query(places)[1], dtype=np.intp)
    count = len(middles_m)
    mass = _sums(square, weight, count)
    share = np.maximum(mass, 1e-300)[:, None]
    sums = [_sums(square, weight * places[:, axis], count) for axis in (0, 1)]
    middle = np.stack(sums, axis=1) / share
    offsets = places - middle[square]
    second = _sums(square, weight * (offsets * offsets).sum(axis=1), count)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, square, places)
    np.maximum.at(high, square, places)
    some = mass > 0.0
    return Cells(middle[some], mass[some], second[some], low[some], high[some], ground.spread)


def _pairs(
    middles_m: Floats, half_m: Floats, cells: Cells, prices_m2: Floats
) -> Iterator[tuple[Indices, Indices]]:
    """Yield (box, cell) index pairs, at least those closer than the root of the cell's price."""
    # The price in m^2 is the squared distance up to which an agent gains from the cell.
    radius, middle = np.sqrt(prices_m2), 0.5 * (cells.low_m + cells.high_m)
    extent = 0.5 * np.linalg.norm(cells.high_m - cells.low_m, axis=1)
    # Cells of similar prices share one search radius.
    kinds = np.floor(2.0 * np.log2(radius)).astype(np.intp)
    for kind in np.unique(kinds):
        number = np.flatnonzero(kinds == kind)
        tree = KDTree(middle[number])
        for begin in range(0, len(middles_m), CHUNK):
            boxes = slice(begin, begin + CHUNK)
            cut_m = float((radius[number] + extent[number]).max())
            cut_m += math.sqrt(2.0) * float(half_m[boxes].max())
            near = KDTree(middles_m[boxes]).sparse_distance_matrix(
                tree, cut_m * (1.0 + 1e-9), output_type="coo_matrix"
            )
            yield begin + np.asarray(near.row, dtype=np.intp), number[near.col]


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pairs of an agent's position and a cell that may contribute to the position's gain."""

    count: int  # Number of positions
    box: Indices  # (e,) index of the position
    cell: Indices  # (e,) index of the cell
    away_m2: Floats  # (e,) mean squared distance


def _candidates(cells: Cells, places_m: Floats, most_m2: Floats) -> Candidates:
    """Return pairs of a position and a cell, with mean squared distance below `most_m2` (m,)."""
    found = list(_pairs(places_m, np.zeros(len(places_m)), cells, most_m2))
    box, cell = (np.concatenate([pair[side] for pair in found]) for side in (0, 1))
    offsets = cells.centroids_m[cell] - places_m[box]
    away_m2 = (offsets * offsets).sum(axis=1) + (cells.second / cells.mass)[cell]
    near = away_m2 < most_m2[cell]
    return Candidates(len(places_m), box[near], cell[near], away_m2[near])


def _soft_loss(
    logarithms: Floats, cells: Cells, at: Candidates, count: int, heat: float
) -> tuple[float, Floats]:
    """Return minus the smoothed bound per mass, and its gradient (m,) in `logarithms`."""
    prices, mass = np.exp(logarithms), cells.mass[at.cell]
    room = np.maximum(prices[at.cell] - at.away_m2, 0.0)
    gains = _sums(at.box, mass * room, at.count)
    share = np.exp((gains - gains.max()) / heat)
    soft = float(gains.max()) + heat * math.log(share.sum())
    share /= share.sum()
    drawn = _sums(at.cell, mass * share[at.box] * (room > 0.0), len(prices))
    total = float(cells.mass.sum())
    slope = (count * drawn - cells.mass) * prices
    return (count * soft - float(prices @ cells.mass)) / total, slope / total


def _optimised(
    cells: Cells,
    places_m: Floats,  # (b, 2) candidates for positions of agents
    count: int,
    prices_m2: Floats,  # (m,) initial prices
    most_m2: float,
    effort_s: float,
) -> Floats:
    """Return prices (m,) that maximise the bound for agents at candidate positions."""
    prices, top = prices_m2, 0.0
    for smoothing in SMOOTHINGS:
        limit = np.minimum(GROWTH * prices, most_m2)
        at = _candidates(cells, places_m, limit)
        if top == 0.0:
            room = np.maximum(prices[at.cell] - at.away_m2, 0.0)
            top = float(_sums(at.box, cells.mass[at.cell] * room, at.count).max())
        steps = effort_s * PAIRS_PER_S[0] / (len(SMOOTHINGS) * max(len(at.box), 1))
        solved = cast(
            "Any",
            minimize(
                _soft_loss,
                np.log(prices),
                args=(cells, at, count, smoothing * max(top, 1e-300)),
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(-np.inf, np.log(limit)),
                options={"maxiter": int(min(max(steps, 2.0), MOST_STEPS)), "maxcor": 15},
            ),
        )
        prices = np.minimum(np.exp(np.asarray(solved.x, dtype=np.float64)), limit)
    return prices


def _largest_gains(middles_m: Floats, half_m: Floats, cells: Cells, prices_m2: Floats) -> Floats:
    """Return upper bounds (b,) of the gain G(p) over square boxes of positions p."""
    count = len(middles_m)
    level, linear, square = np.zeros(count), np.zeros((count, 2)), np.zeros(count)
    for box, cell in _pairs(middles_m, half_m, cells, prices_m2):
        price, mass, half = prices_m2[cell], cells.mass[cell], half_m[box]
        below = cells.low_m[cell] - middles_m[box]
        above = cells.high_m[cell] - middles_m[box]
        far = np.maximum(np.abs(below), np.abs(above))
        near = np.maximum(np.maximum(below, -above), 0.0)
        offsets = cells.centroids_m[cell] - middles_m[box]
        centre = mass * (price - (offsets * offsets).sum(axis=1)) - cells.second[cell]
        inside = price >= ((far + half[:, None]) ** 2).sum(axis=1)
        least_m2 = (np.maximum(near - half[:, None], 0.0) ** 2).sum(axis=1)
        crossed = ~inside & (price > least_m2)
        # |2 (q - middle) d| is at most `move` in the box. With the derivative of a disc that
        # contains the cell, the rest is at most max(x, move), without it max(x + move, 0), where x
        # is price - |q - middle|^2.
        move = 2.0 * half * far.sum(axis=1)
        lowest: Floats = price - (far * far).sum(axis=1)
        highest: Floats = price - (near * near).sum(axis=1)
        counted = crossed & (centre > 0.0)
        rest = mass * np.maximum(highest, move)
        whole = lowest >= 0.0
        exact = centre + mass * np.maximum(move - lowest, 0.0)
        rest = np.where(whole, np.minimum(rest, exact), rest)
        without = mass * np.minimum(np.maximum(highest + move, 0.0), price - least_m2)
        rest = np.where(counted, rest, without)
        level += _sums(box, np.where(inside, centre, np.where(crossed, rest, 0.0)), count)
        square += _sums(box, mass * inside, count)
        moved = (mass * (inside | counted))[:, None] * offsets
        for axis in (0, 1):
            linear[:, axis] += _sums(box, moved[:, axis], count)
    best = np.clip(linear / np.maximum(square, 1e-300)[:, None], -half_m[:, None], half_m[:, None])
    return level + (2.0 * linear * best - square[:, None] * best * best).sum(axis=1)
