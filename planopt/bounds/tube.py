"""Bounds on sums over the stages of a path: branch and bound over tubes of square cells.

A level divides the plane into squares of one size. Each stage has a set of active cells. A dynamic
programme over pairs of cells within one step gives, for each active cell, an upper bound of all
paths through it. Cells whose bound is below the best known value are dropped, the others are
divided in four. If a stage has no cells left, no path is better than the threshold.

Multipliers m_k tilt the problem: the sum of m_k . (q_k - q_{k-1}) telescopes, so that it may be
added to the moves and subtracted from the stages (equation 9.8). Every choice is valid; those of a
local optimum make the bound exact up to the square of the cell size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import monotonic

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats, Indices, Mask
from planopt.bounds.bound import Tilts
from planopt.bounds.enclosure import PowerEnclosure, prior_covariances
from planopt.channel.parameters import MIN_DISTANCE_M
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.upper_bounds import (
    Discs,
    Field,
    Makers,
    Measured,
    UpperBounds,
    constant_bounds,
)
from planopt.problems.problem import MayReach
from planopt.world.motion import closest_approach_m

Slices = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class Chain:
    """Information that each measurement of a path adds to the preceding one."""

    posterior: ChannelPosterior
    share: float  # Weight of the logarithm of a variance
    noise_db2: float

    def lost(
        self,
        after: UpperBounds,
        before: UpperBounds,
        centre: Floats,
        least: Floats,
        slopes: Sequence[Floats],
    ) -> Floats:
        """Return what measurements lose if the preceding ones are known (equation 9.17).

        `least` and `slopes` bound the covariances from below; `centre` are those of the centres.
        """
        half, by = np.sqrt(0.5) * after.radius_m, np.maximum(centre, 0.0) / before.value
        factor = by[..., None]
        # The explained variance is at least this; its share of the variance is at least `share`.
        explained = 2.0 * by * least - by**2 * before.value
        own, other = 2.0 * factor * slopes[0], factor * (2.0 * slopes[1] - factor * before.slope)
        share = explained / after.value
        fall = np.abs(own - share[..., None] * after.slope) + np.abs(other)
        room = after.value - half * np.abs(after.slope).sum(axis=-1)
        share -= half * fall.sum(axis=-1) / np.maximum(room, self.noise_db2)
        share = np.where(room > self.noise_db2, np.clip(share, 0.0, 1.0 - ROUNDING), 0.0)
        return -self.share * np.log1p(-share)

    def lost_at_least(self, far_m: float, nearest_m: Floats, variance_db2: Floats) -> Floats:
        """Return least losses of positions at most `far_m` apart (equation 9.18).

        `nearest_m` are their least distances from the station, and `variance_db2` the least
        geometric means of their variances.
        """
        parameters, spread = self.posterior.parameters, self.posterior.theta_covariance
        shadow = -np.expm1(-far_m / parameters.decorrelation_m)
        apart = np.sqrt(2.0 * shadow) * parameters.shadow_std_db
        trend = np.sqrt(spread[1, 1]) * (10.0 / np.log(10.0)) * np.log1p(far_m / nearest_m)
        apart = self.noise_db2 + 0.5 * (apart + trend) ** 2
        share = np.maximum(1.0 - apart / variance_db2, 0.0) ** 2
        return -self.share * np.log1p(-np.minimum(share, 1.0 - ROUNDING))


@dataclass(frozen=True, eq=False)
class PairedSteps:
    """Pairs of cells within one step, on a grid that contains the cells of all stages."""

    active: Sequence[Cells]  # Cells of each stage
    corner: Cells  # (2,) lower left cell of the grid
    shape: tuple[int, int]
    # For each offset, slices of earlier and later cells, and what their moves add or lose
    pairs: Sequence[tuple[Slices, Slices, Floats]]

    @classmethod
    def over(cls, level: Level, chain: Chain) -> PairedSteps:
        """Return the pairs of a level's cells."""
        problem, side = level.problem, level.side_m
        cells = np.unique(np.vstack(level.active), axis=0)
        corner = cells.min(axis=0, initial=0)
        rows, columns = (cells.max(axis=0, initial=-1) + 1 - corner).tolist()
        pairs: list[tuple[Slices, Slices, Floats]] = []
        # Cells of the grid that no stage has are never reached, so that their terms do not matter.
        number = np.zeros((rows, columns), dtype=np.intp)
        number[tuple((cells - corner).T)] = np.arange(len(cells))
        field = level.field(cells)
        radius = field.discs.radius_m
        enclosure, centres = PowerEnclosure(chain.posterior), field.discs.centre_m
        whole = enclosure.joint(centres, radius).at(number)
        least_db2 = enclosure.over(centres, np.full(len(cells), radius)).least_variances()[number]
        station = chain.posterior.parameters.station
        across = np.hypot(*(centres - np.asarray(station.position_m)).T) - radius
        near = np.hypot(np.maximum(across, 0.0), station.height_m)[number]
        variance = field["variance_db2"].at(number)
        longest = problem.step_m * (1.0 + ROUNDING)
        count = int(np.ceil(longest / side)) + 1
        for i, j in np.ndindex(count + 1, 2 * count + 1):
            offset = side * np.array([i, j - count])
            away = float(np.hypot(*np.maximum(np.abs(offset) - level.size * side, 0.0)))
            if away > longest or i >= rows or abs(j - count) >= columns:
                continue
            if i == 0 and j < count:
                continue
            one = _shifted(rows, -i), _shifted(columns, count - j)
            two = _shifted(rows, i), _shifted(columns, j - count)
            cost = problem.per_metre * away
            cost += problem.per_move if away > problem.standstill_m else 0.0
            far = min(float(np.hypot(*(np.abs(offset) + level.size * side))), longest)
            prior, bounds = prior_covariances(offset, radius, far, chain.posterior.parameters)
            centre, least, slopes = whole.at(one).covariances(whole.at(two))
            nearest = np.maximum(np.minimum(near[one], near[two]), MIN_DISTANCE_M)
            middle = np.sqrt(least_db2[one] * least_db2[two])
            plain = chain.lost_at_least(far, nearest, middle) if radius else 0.0 * middle
            for before, after, sign in ((one, two, -1), (two, one, 1)):
                # A bound of the shadowing for all distances, and another at distinct positions.
                lost = [
                    chain.lost(
                        variance.at(after),
                        variance.at(before),
                        prior + centre,
                        value + least,
                        (slopes[::sign][0] + sign * slope, slopes[::sign][1] - sign * slope),
                    )
                    for value, slope in bounds[0 if radius else -1 :]
                ]
                pairs.append((before, after, -np.max([*lost, plain], axis=0) - cost))
        return cls(level.active, corner, (rows, columns), pairs)

    def best(self, stage: int, values: Floats, *, ahead: bool) -> Floats:
        """Return, for each cell, the largest sum of a pair's reward and its other cell's value.

        With `ahead`, values are those of the stage before `stage` and the result is for `stage`;
        otherwise the reverse.
        """
        known, wanted = self.active[stage - 1], self.active[stage]
        known, wanted = (known, wanted) if ahead else (wanted, known)
        grid, reached = np.full(self.shape, -np.inf), np.full(self.shape, -np.inf)
        grid[tuple((known - self.corner).T)] = values
        for before, after, gain in self.pairs:
            source, target = (before, after) if ahead else (after, before)
            np.maximum(reached[target], grid[source] + gain, out=reached[target])
        return reached[tuple((wanted - self.corner).T)]


def _shifted(size: int, by: int) -> slice:
    """Return the slice of indices below `size` that stay in range after subtracting `by`."""
    return slice(max(by, 0), size + min(by, 0))


Cells = Indices  # (n, 2) indices of cells along x and y

FIRST_SHARE = 0.5  # Side of the cells of the first level, in lengths of the longest step
MOST_LEVELS = 30  # Maximum number of levels of cells
MOST_CELLS = 1_000_000  # Maximum number of cells per level, over all stages
OFFSETS_GROWTH = 2.0  # Factor of a level's time over the preceding level's for the same cells
MOST_TILTS = 3  # Maximum number of tilts that the search uses at a level
GAP, ONE_STEP_GAP = 1e-4, 1e-6
"""Cells are dropped unless they may beat a known value by this share of it; for plans of a step."""
MOST_PAIRS = 2_000_000
"""Maximum number of pairs of cells of successive stages that are evaluated one by one."""
PAIRS_PER_NODE, NODES_PER_OFFSET = 0.25, 2000
"""Cell pairs that take as long as one grid node, and grid nodes that take as long as one offset."""
DISC_SIDES = 128  # Number of sides of the polygons inside discs
WAY_PARTS = 8  # Number of equal parts into which moves are divided to test them for obstacles
ROUNDING = 1e-10  # Relative widening of every bound, far above the rounding errors of its sums
LONGER_M = 8e-5
"""Length by which a verified step may exceed the longest step, for the verifier's tolerances."""
OUTSIDE_M = 3e-6
"""Distance by which a verified position may leave the workspace, for the verifier's tolerance."""
LARGEST = 1e12  # Limit of the multipliers and the value of a saved certificate
MARGIN = 1e-9  # Relative margin of a claimed bound; a proof on another processor rounds differently


@dataclass(frozen=True, eq=False)
class KeepOut:
    """Disc that no path enters; its centre moves straight at constant speed during each step."""

    centre_m: Floats  # (N + 1, 2) at the start and after each step
    radius_m: Floats  # (N,) after each step
    on_way_m: Floats  # (N,) during each step; the difference allows for curved motions
    is_robot: bool

    def polygon(self, stage: int) -> shapely.Polygon:
        """Return a polygon inside the disc after a stage (from 0)."""
        radius = max(0.0, float(self.radius_m[stage]))
        return shapely.Point(self.centre_m[stage + 1]).buffer(radius, DISC_SIDES // 4)


@dataclass(frozen=True, eq=False)
class StageProblem:
    """Maximisation of a sum over N positions, each at most one step from its predecessor."""

    start_m: Floats  # (2,)
    step_m: float  # Length of the longest step, with the verifier's tolerance
    steps: int
    limits_m: Floats  # (N, 4) least x and y, largest x and y after each step
    blocked: Sequence[shapely.Polygon]  # Areas that contain no position of any path
    makers: Makers
    # Maps a stage (from 0) and bounds of predicted quantities to bounds of the stage's reward
    reward: Callable[[int, Field], UpperBounds]
    sure_m: Floats  # (p, 2) positions at which the connection is certain
    sure_radius_m: float  # Radius within which it is
    per_metre: float = 0.0  # Cost of a metre
    per_move: float = 0.0  # Cost of a step longer than `standstill_m`
    standstill_m: float = 0.0
    # (N,) least probability of connection at the end of each step; 0 if there is none
    p_min: Floats | None = None
    measured: Measured | None = None  # Information that a design bounds
    chain: Chain | None = None
    keep_outs: Sequence[KeepOut] = ()
    sag_m: float = 0.0  # Largest distance of a motion from the straight move of the step
    may_reach: MayReach | None = None  # For a robot with inertia or a heading

    def alone(self) -> StageProblem:
        """Return the problem without the other robots."""
        return replace(self, keep_outs=[each for each in self.keep_outs if not each.is_robot])

    def areas(self, stage: int) -> list[shapely.Polygon]:
        """Return the areas that no path visits after a stage (from 0)."""
        return [*(each.polygon(stage) for each in self.keep_outs), *self.blocked]


@dataclass(frozen=True)
class TubeBound:
    """Upper bound on the value of all paths, with the size of its proof."""

    value: float
    levels: int


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one size, and bounds of their rewards."""

    problem: StageProblem
    side_m: float
    active: list[Cells]
    rewards: list[UpperBounds]
    # For each stage, pairs (s, 2) of a cell and a surely connected position in it, and rewards (s,)
    sure: list[tuple[Cells, Floats]]
    core: shapely.Geometry  # Part of the blocked areas: a move between centres may not enter it
    # For each stage, rows (v,) of cells that blocked areas or p_min cut, and corners (v, 2) of what
    # is left relative to the centre
    cut: list[list[tuple[Indices, Floats]]]
    # Size of the cells in their sides; 0 stands for one point in each, whose bound proves nothing
    size: float = 1.0

    def field(self, cells: Cells) -> Field:
        """Return bounds of predicted quantities over cells (n, 2)."""
        radius = self.size * self.side_m * np.sqrt(0.5) * (1.0 + 1e-12)
        centres = self.problem.start_m + (cells + 0.5) * self.side_m
        measured, half = self.problem.measured, 0.5 * self.side_m
        if measured is not None and self.size == 0.0:
            # The information is largest next to the station.
            station = np.asarray(measured.posterior.parameters.station.position_m)
            centres += np.clip(station - centres, -half, half)
        return Field(Discs(centres, radius), self.problem.makers)

    def offsets_m(self, stage: int) -> Floats:
        """Return the centres of the active cells relative to the start as an array (n, 2)."""
        return (self.active[stage].astype(np.float64) + 0.5) * self.side_m


def tube_bounds(
    problem: StageProblem,
    known: float,
    tilts: Sequence[Floats],
    seconds: float,
    improved: Callable[[Floats], float] | None = None,
) -> Iterator[TubeBound]:
    """Yield ever tighter upper bounds on the value of all paths until the time limit.

    `improved` maps the positions (N, 2) of the relaxed problem's best path to the value of the best
    known path, and may append multipliers to `tilts`, of which the search uses the last ones.
    """
    begun, best = monotonic(), np.inf
    gap = ONE_STEP_GAP if problem.steps == 1 else GAP
    threshold = known + gap * abs(known)
    side, active = FIRST_SHARE * problem.step_m, first_cells(problem)
    for number in range(1, MOST_LEVELS + 1):
        level_begun = monotonic()
        level = evaluated(problem, side, active)
        through = through_bounds(level, tilts[-MOST_TILTS:])
        took_s = monotonic() - level_begun
        if improved is not None and min(map(len, through)):
            known = improved(best_path(level, through))
            threshold = known + gap * abs(known)
        highest = max(threshold, min(float(each.max(initial=-np.inf)) for each in through))
        best = min(best, highest + MARGIN * abs(highest))
        yield TubeBound(best, number)
        active = kept_cells(level, through, threshold)
        cells, left = (sum(map(len, each)) for each in (level.active, active))
        # The next level has more cells, and more offsets within a step.
        growth = max(1.0, left / max(cells, 1))
        ahead = took_s * (OFFSETS_GROWTH * growth if problem.chain is None else growth**2)
        late = monotonic() - begun + ahead > seconds
        if highest <= threshold or left > MOST_CELLS or late:
            return
        side *= 0.5


def best_path(level: Level, through: Sequence[Floats]) -> Floats:
    """Return the path (N, 2) through the best cells: known connections, or centres of cells.

    Known connections are visited if they are within reach of the preceding one.
    """
    problem = level.problem
    found, held = np.empty((len(through), 2)), (problem.start_m, -1)
    for stage, each in enumerate(through):
        cell, (pairs, values) = int(each.argmax()), level.sure[stage]
        found[stage] = problem.start_m + level.offsets_m(stage)[cell]
        places = problem.sure_m[pairs[:, 1]]
        near = np.hypot(*(places - held[0]).T) < (stage - held[1]) * problem.step_m
        inside = np.flatnonzero(near & (pairs[:, 0] == cell))
        if len(inside):
            found[stage] = places[inside[values[inside].argmax()]]
            held = found[stage], stage
    return found


def proves(problem: StageProblem, tilts: Tilts) -> bool:
    """Return whether the stored multipliers prove the value of a certificate."""
    if tilts.of_steps.shape[1:] != (problem.steps, 2):
        return False
    if not all((np.abs(each) < LARGEST).all() for each in (tilts.of_steps, tilts.value)):
        return False
    limit = tilts.value - 0.5 * MARGIN * abs(tilts.value)
    side, active = FIRST_SHARE * problem.step_m, first_cells(problem)
    for _ in range(min(tilts.levels, MOST_LEVELS)):
        level = evaluated(problem, side, active)
        active = kept_cells(level, through_bounds(level, tilts.of_steps), limit)
        if min(map(len, active)) == 0:
            return True
        if sum(map(len, active)) > MOST_CELLS:
            return False
        side *= 0.5
    return False


def halved(limits_m: Floats, stage: int, axis: int, at_m: float) -> tuple[Floats, Floats]:
    """Return limits (N, 4) of paths whose coordinate after a stage is at most, at least `at_m`."""
    low, high = limits_m.copy(), limits_m.copy()
    low[stage, 2 + axis] = min(at_m, low[stage, 2 + axis])
    high[stage, axis] = max(at_m, high[stage, axis])
    return low, high


def cut_limits(limits_m: Floats, cuts: Floats) -> list[Floats]:
    """Return the limits (N, 4) of all parts after cuts (c, 4)."""
    found = [limits_m]
    for part, stage, axis, at_m in cuts.tolist():
        found[int(part)], last = halved(found[int(part)], int(stage), int(axis), at_m)
        found.append(last)
    return found


def kept_cells(level: Level, through: Sequence[Floats], limit: float) -> list[Cells]:
    """Return the next level's cells: the quarters of cells whose bound exceeds `limit`."""
    return [
        divided(level.problem, cells[~(bound <= limit)], 0.5 * level.side_m, stage)
        for stage, (cells, bound) in enumerate(zip(level.active, through, strict=True), 1)
    ]


def first_cells(problem: StageProblem) -> list[Cells]:
    """Return the cells of the first level within reach of the start, for each stage."""
    found: list[Cells] = []
    side = FIRST_SHARE * problem.step_m
    for stage in range(1, problem.steps + 1):
        count = int(np.ceil(stage * problem.step_m / side)) + 1
        line = np.arange(-count, count)
        cells = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
        found.append(open_cells(problem, cells, side, stage))
    return found


def divided(problem: StageProblem, cells: Cells, side: float, stage: int) -> Cells:
    """Return the quarters of `cells`, with sides `side`, that a feasible path may visit."""
    quarters = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    return open_cells(problem, (2 * cells[:, None] + quarters).reshape(-1, 2), side, stage)


def open_cells(problem: StageProblem, cells: Cells, side: float, stage: int) -> Cells:
    """Return the cells within a stage's reach and the workspace that no blocked area covers."""
    low = cells * side
    nearest = np.clip(0.0, low, low + side)
    inside = np.hypot(*nearest.T) <= stage * problem.step_m * (1.0 + ROUNDING)
    x0, y0, x1, y1 = problem.limits_m[stage - 1]
    corner = problem.start_m + low
    inside &= (corner <= np.array([x1, y1]) + OUTSIDE_M).all(axis=1)
    inside &= (corner + side >= np.array([x0, y0]) - OUTSIDE_M).all(axis=1)
    cells, corner = cells[inside], corner[inside]
    if problem.may_reach is not None:
        # Tolerances of speed and heading add up over the steps.
        slack_m = np.sqrt(0.5) * side + 2.0 * LONGER_M * stage**2
        inside = problem.may_reach(corner + 0.5 * side, stage, slack_m)
        cells, corner = cells[inside], corner[inside]
    areas = problem.areas(stage - 1)
    if not areas or not len(cells):
        return cells
    boxes = squares(corner, side)
    hidden, _ = shapely.STRtree(areas).query(boxes, predicate="covered_by")
    return np.delete(cells, hidden, axis=0)


def squares(corner: Floats, side: float) -> NDArray[np.object_]:
    """Return the squares with lower left corners (n, 2) as an array of geometries (n,)."""
    (x0, y0), (x1, y1) = corner.T, corner.T + side
    return np.asarray(shapely.box(x0, y0, x1, y1), dtype=np.object_)


def evaluated(
    problem: StageProblem, side: float, active: Sequence[Cells], size: float = 1.0
) -> Level:
    """Return a level of the active cells, with bounds of the reward of each cell."""
    cells, place = np.unique(np.vstack(active), axis=0, return_inverse=True)
    level = Level(problem, side, [], [], [], core_of(problem, side), [], size)
    field = level.field(cells)
    centres = field.discs.centre_m
    ends = np.cumsum([len(each) for each in active])[:-1]
    for stage, rows in enumerate(np.split(place.ravel(), ends)):
        own, (pairs, values) = active[stage], sure_rewards(problem, stage, active[stage], side)
        connected: list[tuple[Indices, Floats]] = []
        if problem.p_min is not None:
            chance = field["chance"].at(rows)
            missed, owner, corners = connected_corners(chance, problem.p_min[stage], size * side)
            kept = ~missed & (chance.most >= problem.p_min[stage])
            kept[pairs[:, 0]] = True
            number = np.cumsum(kept) - 1
            pairs[:, 0] = number[pairs[:, 0]]
            own, rows = own[kept], rows[kept]
            connected = [(number[owner[kept[owner]]], corners[kept[owner]])]
        level.active.append(own)
        level.rewards.append(problem.reward(stage, field.at(rows)))
        level.sure.append((pairs, values))
        blocked = cut_corners(problem.areas(stage), centres[rows], side)
        level.cut.append([blocked, *connected])
    return level


def core_of(problem: StageProblem, side: float) -> shapely.Geometry:
    """Return the part of the blocked areas that no move between centres of cells enters."""
    # GEOS shrinks polygons by up to a hundredth too little.
    inset = 1.02 * (np.sqrt(0.5) * side + problem.sag_m)
    core = shapely.MultiPolygon(problem.blocked).buffer(-inset)
    shapely.prepare(core)
    return core


def connected_corners(
    chance: UpperBounds, p_min: float, side: float
) -> tuple[Mask, Indices, Floats]:
    """Return where cells miss p_min (n,), cells (v,) that it cuts, and corners (v, 2) of the rest.

    The rest is where the tangent of the probability's bound is at least p_min (equation 9.10).
    """
    ring = 0.5 * side * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    after = np.roll(ring, -1, axis=0)
    surplus = chance.value[:, None] + chance.slope @ ring.T - p_min + ROUNDING
    beyond, inside = np.roll(surplus, -1, axis=1), np.asarray(surplus >= 0.0)
    missed, whole = np.asarray(~inside.any(axis=1)), np.asarray(inside.all(axis=1))
    owner, corner = np.nonzero(inside & ~whole[:, None])
    crossed, edge = np.nonzero(inside != (beyond >= 0.0))
    one, other = surplus[crossed, edge], beyond[crossed, edge]
    crossings = ring[edge] + (one / (one - other))[:, None] * (after - ring)[edge]
    corners = np.vstack([ring[corner], crossings])
    return missed, np.concatenate([owner, crossed]), corners


def cut_corners(
    areas: Sequence[shapely.Polygon], centres: Floats, side: float
) -> tuple[Indices, Floats]:
    """Return cells (v,) cut by blocked areas, and corners (v, 2) of the cells' free parts."""
    if not areas:
        return np.zeros(0, dtype=np.intp), np.zeros((0, 2))
    boxes = squares(centres - 0.5 * side, side)
    cells, cutters = shapely.STRtree(areas).query(boxes, predicate="intersects")
    parts = shapely.difference(boxes[cells], np.array(areas)[cutters])
    # A cell that two areas cut is cut by the first only.
    places, owner = shapely.get_coordinates(parts, return_index=True)
    first = np.concatenate([[True], cells[1:] != cells[:-1]])
    kept = first[owner]
    owner = cells[owner[kept]]
    return owner, places[kept] - centres[owner]


def sure_rewards(
    problem: StageProblem, stage: int, cells: Cells, side: float
) -> tuple[Cells, Floats]:
    """Return index pairs (cell, position) of known connections in cells, and their rewards (s,)."""
    places = problem.sure_m
    if not len(places) or not len(cells):
        return np.zeros((0, 2), dtype=np.intp), np.zeros(0)
    # A position on a side belongs to all cells that touch it.
    around = problem.sure_radius_m * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    holds = np.floor((places[:, None] + around - problem.start_m) / side).astype(np.intp)
    low, high = cells.min(axis=0), cells.max(axis=0)
    width = 1 + int((high - low)[1])
    inside = np.asarray(((holds >= low) & (holds <= high)).all(axis=2), dtype=np.bool_)
    keys: Cells = (cells[:, 0] - low[0]) * width + cells[:, 1] - low[1]
    order = np.argsort(keys)
    wanted: Cells = (holds[..., 0] - low[0]) * width + holds[..., 1] - low[1]
    found = np.searchsorted(keys[order], wanted)
    at = np.minimum(found, len(cells) - 1)
    inside &= keys[order][at] == wanted
    number = np.broadcast_to(np.arange(len(places))[:, None], inside.shape)
    both = np.column_stack([order[at][inside], number[inside]])
    pairs = np.asarray(np.unique(both, axis=0), dtype=np.intp)
    held = places[pairs[:, 1]]
    makers: Makers = {**problem.makers, "chance": partial(constant_bounds, value=1.0)}
    return pairs, problem.reward(stage, Field(Discs(held, problem.sure_radius_m), makers)).most


def through_bounds(level: Level, tilts: Iterable[Floats]) -> list[Floats]:
    """Return, for each stage, upper bounds on the value of paths through each active cell."""
    best, chain = [np.full(len(each), np.inf) for each in level.active], level.problem.chain
    steps = [Step.between(level, k) for k in range(1, len(best)) if chain is None]
    pairs = None if chain is None else PairedSteps.over(level, chain)
    # Losses between successive stages have no multipliers.
    for of_steps in [np.zeros((len(best), 2)), *(tilts if pairs is None else ())]:
        own = [tilted(level, k, of_steps) for k in range(len(best))]
        moves = [step.moves(level, of_steps[k]) for k, step in enumerate(steps, 1)]

        def ends(k: int, values: Floats, *, ahead: bool, moves: list[Floats] = moves) -> Floats:
            if pairs is not None:
                return pairs.best(k, values, ahead=ahead)
            return steps[k - 1].best(moves[k - 1], values, ahead=ahead)

        forward = [own[0] + first_moves(level, of_steps[0])]
        for k in range(1, len(best)):
            forward.append(own[k] + ends(k, forward[-1], ahead=True))
        back = np.zeros(len(own[-1]))
        for k in range(len(own) - 1, -1, -1):
            size = np.abs(forward[k]) + np.abs(back)
            found = forward[k] + back
            widened = found + ROUNDING * np.where(np.isfinite(size), size, 0.0)
            best[k] = np.minimum(best[k], widened)
            if k:
                back = ends(k, own[k] + back, ahead=False)
    # An undefined bound proves nothing.
    return [np.nan_to_num(each, nan=np.inf, posinf=np.inf, neginf=-np.inf) for each in best]


def tilted(level: Level, stage: int, of_steps: Floats) -> Floats:
    """Return bounds (n,) of a stage's reward minus the tilt, over each active cell."""
    reward, half = level.rewards[stage], 0.5 * level.side_m
    (pairs, certain), problem = level.sure[stage], level.problem
    tilt = of_steps[stage] - (of_steps[stage + 1] if stage + 1 < problem.steps else 0.0)
    slope, centres = reward.slope - tilt, level.offsets_m(stage)
    # A cell that crosses the border of the workspace ends there.
    low, high = np.reshape(problem.limits_m[stage], (2, 2)) - problem.start_m
    least = np.maximum(-half, low - OUTSIDE_M - centres)
    most = np.minimum(half, high + OUTSIDE_M - centres)
    fallen = np.broadcast_to(-tilt, slope.shape)
    rise, fall = (np.maximum(each * least, each * most).sum(axis=1) for each in (slope, fallen))
    for rows, corners in level.cut[stage]:
        # Rounding of the corners
        slack = ROUNDING * (1.0 + np.abs(problem.start_m).sum()) * np.abs(slope[rows]).sum(axis=1)
        highest = np.full((2, len(rise)), np.inf)
        highest[:, rows] = -np.inf
        np.maximum.at(highest[0], rows, np.einsum("vd,vd->v", corners, slope[rows]) + slack)
        np.maximum.at(highest[1], rows, -corners @ tilt + ROUNDING)
        rise, fall = np.minimum(rise, highest[0]), np.minimum(fall, highest[1])
    found = np.minimum(reward.value + rise, reward.most + fall)
    found -= centres @ tilt
    if len(pairs):
        offset = problem.sure_m[pairs[:, 1]] - problem.start_m
        spread = problem.sure_radius_m * float(np.abs(tilt).sum())
        np.maximum.at(found, pairs[:, 0], certain - offset @ tilt + spread)
    return found


def first_moves(level: Level, multiplier: Floats) -> Floats:
    """Return bounds (n,) of the step from the start to each active cell (equation 9.11)."""
    problem, centres, half = level.problem, level.offsets_m(0), 0.5 * level.side_m
    away = np.hypot(*np.maximum(np.abs(centres) - level.size * half, 0.0).T)
    found = move_bounds(problem, multiplier, centres, half, away)
    if not shapely.is_empty(level.core):
        ends = np.stack(
            [np.broadcast_to(problem.start_m, centres.shape), problem.start_m + centres], 1
        )
        found[shapely.intersects(level.core, shapely.linestrings(ends))] = -np.inf
    return np.where(away <= problem.step_m * (1.0 + ROUNDING), found, -np.inf)


@dataclass(frozen=True, eq=False)
class Step:
    """Pairs of active cells, of two successive stages, that are at most one step apart."""

    cells: tuple[Cells, Cells]  # (n, 2) of the earlier and (m, 2) of the later stage
    low: Cells  # (2,) least offset from an earlier to a later cell
    offsets: Cells  # (o, 2) offsets within one step, minus `low`
    away_m: Floats  # (o,) distances of cells with these offsets
    shape: tuple[int, int]  # Shape of a table over all offsets
    places: Indices | None  # (n, m) place of each pair in the table; None: too many

    @classmethod
    def between(cls, level: Level, stage: int) -> Step:
        """Return the pairs of active cells of a stage and its predecessor."""
        side, longest = level.side_m, level.problem.step_m * (1.0 + ROUNDING)
        before, after = level.active[stage - 1], level.active[stage]
        nothing = np.zeros((0, 2), dtype=np.intp)
        if not len(before) or not len(after):
            return cls((before, after), nothing, nothing, np.zeros(0), (0, 0), None)
        count = int(np.ceil(longest / side)) + 2  # Offsets of this size are out of reach
        low = np.maximum(after.min(axis=0) - before.max(axis=0), -count)
        high = np.minimum(after.max(axis=0) - before.min(axis=0), count)
        high = np.maximum(high, low)
        x, y = (np.arange(low[i], high[i] + 1, dtype=np.intp) for i in (0, 1))
        grid: Cells = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        away = np.hypot(*np.moveaxis(np.maximum(np.abs(grid) - 1, 0) * side, -1, 0))
        near = away <= longest
        rows, columns = len(x), len(y)
        offsets = np.argwhere(near)
        size = before.max(axis=0) - before.min(axis=0) + 1
        places: Indices | None = None
        if len(before) * len(after) <= min(
            MOST_PAIRS, PAIRS_PER_NODE * len(offsets) * (int(size.prod()) + NODES_PER_OFFSET)
        ):
            right, up = (after[:, i] - before[:, i, None] - low[i] for i in (0, 1))
            outside = (right < 0) | (right >= rows) | (up < 0) | (up >= columns)
            outside |= never_moved(level, stage, ~outside)
            places = np.where(outside, rows * columns, right * columns + up).astype(np.intp)
        return cls((before, after), low, offsets, away[near], (rows, columns), places)

    def moves(self, level: Level, multiplier: Floats) -> Floats:
        """Return an upper bound (o,) of the move term for each offset (equation 9.11)."""
        offset = level.side_m * (self.offsets + self.low).astype(np.float64)
        return move_bounds(level.problem, multiplier, offset, level.side_m, self.away_m)

    def best(self, moves: Floats, values: Floats, *, ahead: bool) -> Floats:
        """Return the best sum of a move and its other end's value; `ahead`: the earlier end."""
        before, after = self.cells
        known, wanted = (before, after) if ahead else (after, before)
        if not len(self.offsets):
            return np.full(len(wanted), -np.inf)
        if self.places is not None:
            table = np.full(self.shape[0] * self.shape[1] + 1, -np.inf)
            table[self.offsets[:, 0] * self.shape[1] + self.offsets[:, 1]] = moves
            sums = table[self.places]
            sums += values[:, None] if ahead else values
            return sums.max(axis=0 if ahead else 1)
        offsets = (self.offsets + self.low) * (1 if ahead else -1)
        corner, end = wanted.min(axis=0), wanted.max(axis=0) + 1
        margin = int(np.abs(offsets).max())
        rows, columns = (end - corner).tolist()
        grid = np.full((rows + 2 * margin, columns + 2 * margin), -np.inf)
        at = known - corner + margin
        inside = ((at >= 0) & (at < grid.shape)).all(axis=1)
        grid[tuple(at[inside].T)] = values[inside]
        reached = np.full((rows, columns), -np.inf)
        for (i, j), move in zip((margin - offsets).tolist(), moves.tolist(), strict=True):
            np.maximum(reached, grid[i : i + rows, j : j + columns] + move, out=reached)
        return reached[tuple((wanted - corner).T)]


def never_moved(level: Level, stage: int, near: Mask) -> Mask:
    """Return a mask (n, m) of pairs of cells near each other that no path moves between."""
    # A point of a move is within half a diagonal of the same point of the centres' move.
    problem, margin_m = level.problem, np.sqrt(0.5) * level.side_m
    found, (one, other) = np.zeros_like(near), np.nonzero(near)
    before, after = (problem.start_m + level.offsets_m(stage - 1 + k) for k in (0, 1))
    for each in problem.keep_outs:
        centres = each.centre_m[stage : stage + 2]
        nearest_m = closest_approach_m(before[one], after[other], centres[:1], centres[1:])
        found[one, other] |= nearest_m < each.on_way_m[stage] - margin_m
    core = level.core
    if shapely.is_empty(core):
        return found
    ends_m = [np.asarray(shapely.points(each)) for each in (before, after)]
    # The stubs of shapely leave the type of keyword arguments open.
    away = [shapely.distance(core, each) for each in ends_m]  # pyright: ignore[reportUnknownMemberType]
    close = away[0][one] + away[1][other] <= np.hypot(*(after[other] - before[one]).T)
    one, other = one[close], other[close]
    if len(one):
        ends, hit = (level.active[stage - 1][one], level.active[stage][other]), False
        for share in range(1, WAY_PARTS):
            place = (WAY_PARTS - share) * ends[0] + share * ends[1]
            low = place.min(axis=0)
            inside = np.zeros(place.max(axis=0) + 1 - low, dtype=np.bool_)
            at = tuple((place - low).T)
            inside[at] = True
            visited = np.argwhere(inside)
            there = problem.start_m + ((visited + low) / WAY_PARTS + 0.5) * level.side_m
            inside[tuple(visited.T)] = shapely.contains_xy(core, *there.T)
            hit |= inside[at]
        found[one, other] |= hit
    return found


def move_bounds(
    problem: StageProblem, multiplier: Floats, offset: Floats, half: float, away: Floats
) -> Floats:
    """Return upper bounds of the tilted move term over boxes of moves of at most one step."""
    size, price = float(np.hypot(*multiplier)), problem.per_metre
    length = np.hypot(*offset.T)
    along = offset @ multiplier
    ahead = multiplier / size if size else np.zeros(2)
    # Supergradients of -|x|; at zero every vector of length at most one is.
    resting = ahead * min(1.0, size / price) if price else ahead
    unit = np.where(length[:, None] > 0.0, offset / np.maximum(length, 1e-300)[:, None], resting)
    bent = np.abs(unit - ahead).sum(axis=1)
    behind = np.maximum(length - offset @ ahead - half * bent, 0.0) if size else 0.0
    by_step = problem.step_m * max(size - price, 0.0) - size * behind
    slope = np.abs(multiplier - price * unit).sum(axis=1)
    tangent = along - price * length + half * slope
    moving = np.where(away > problem.standstill_m, problem.per_move, 0.0)
    return np.minimum(by_step, tangent) - moving
