"""Lower bounds on plans to a goal whose first N steps have a fixed duration.

Steps of fixed duration cannot follow every corner at full length. A potential V of
:mod:`planopt.bounds.route` bounds the cost after the last step. The reduced cost of a step is its
cost minus the fall of V; it is at least zero. A dynamic programme over tubes of square cells bounds
the sum of the reduced costs (equation 6.20). Costs are in metres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from time import monotonic

import numpy as np
import shapely

from planopt.arrays import Floats, Indices, Mask
from planopt.bounds.bound import Potential
from planopt.bounds.reach import longest_sag_m, route_problem
from planopt.bounds.route import ROUNDING, RouteProblem, blocked_areas, slopes_of
from planopt.bounds.stages import CLOSER_M, blocked_parts, quantity_makers
from planopt.bounds.tube import (
    FIRST_SHARE,
    LONGER_M,
    MARGIN,
    Cells,
    Level,
    StageProblem,
    core_of,
    divided,
    first_cells,
    never_moved,
    squares,
)
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.upper_bounds import Discs, Field, no_reward
from planopt.problems.problem import Problem, rate_s_m

MOST_LEVELS = 12  # Maximum number of levels of cells
MOST_PAIRS = 6_000_000  # Maximum number of pairs of cells of successive steps
PARTS = 4  # Number of parts of a step whose outage is bounded separately


@dataclass(frozen=True, eq=False)
class SteppedProblem:
    """A route problem whose first N steps have a fixed duration.

    A step of length l costs `constant_m` + `per_m` l^2 and the integral of the outage, in metres.
    """

    route: RouteProblem
    tube: StageProblem  # Positions and moves of the steps
    constant_m: float
    per_m: float


def stepped_problem(
    problem: Problem, posteriors: Sequence[ChannelPosterior]
) -> SteppedProblem | None:
    """Return the stepped problem of a problem's first robot; None if it may arrive in N steps."""
    route, planner = route_problem(problem, posteriors), problem.planner
    longest, rate = problem.step_length_m + LONGER_M, rate_s_m(problem)
    away = float(np.linalg.norm(route.goal_m - route.start_m)) - route.goal_radius_m
    if away <= planner.horizon * longest:
        return None
    tube = StageProblem(
        start_m=route.start_m,
        step_m=longest,
        steps=planner.horizon,
        limits_m=np.tile(route.bounds_m, (planner.horizon, 1)),
        blocked=blocked_parts(problem),
        makers=quantity_makers(posteriors, route.thresholds_dbm, posteriors[0]),
        reward=no_reward,
        sure_m=np.zeros((0, 2)),
        sure_radius_m=0.0,
        sag_m=(longest_sag_m(problem) or 0.0) + CLOSER_M,
    )
    effort = problem.reach.effort_weight_s2_m2 / planner.step_s
    return SteppedProblem(route, tube, planner.step_s / rate, effort / rate)


@dataclass(frozen=True, eq=False)
class Planes:
    """Linear models of a potential over n squares of one size; a point is a square of size zero."""

    centre_m: Floats  # (n, 2)
    value: Floats  # (n,)
    slope: Floats  # (n, 2)
    rest: Floats  # (n,) largest deviation of the potential in free space
    half_m: float  # Half the side of a square

    def at(self, rows: Indices | Mask) -> Planes:
        """Return some of the models."""
        own = self.centre_m[rows], self.value[rows], self.slope[rows], self.rest[rows]
        return Planes(*own, self.half_m)


class OpenPotential:
    """A potential on the triangles of free space."""

    def __init__(self, route: RouteProblem, potential: Potential) -> None:
        nodes, corners = potential.nodes_m, potential.corners
        is_open = blocked_areas(route).is_open(nodes, corners)
        unknown, *slopes = slopes_of(nodes, corners)
        values = np.concatenate([potential.at_nodes, potential.at_sides])[unknown[is_open]]
        along = [np.einsum("tcu,tu->tc", each[is_open], values) for each in slopes]
        gradient, places = np.stack(along, axis=2), nodes[corners[is_open]]
        sides = places[:, 1:] - places[:, :1]
        (ax, ay), (bx, by) = np.moveaxis(sides, 0, 2)
        double = ax * by - ay * bx
        with np.errstate(all="ignore"):
            inverse = np.moveaxis(np.array([[by, -ay], [-bx, ax]]) / double, 2, 0)
            # The gradient is linear: its change along both sides gives its slopes.
            self._bend = inverse @ (gradient[:, 1:] - gradient[:, :1])
            self._height = np.abs(double) / np.hypot(*np.moveaxis(sides, 2, 0)).max(axis=1)
        self._first, self._value, self._slope = places[:, 0], values[:, 0], gradient[:, 0]
        self._most = np.abs(values).max(axis=1)
        self._tree = shapely.STRtree(np.asarray(shapely.polygons(places), dtype=np.object_))

    def over(self, centre_m: Floats, half_m: float) -> Planes:
        """Return models over squares (n, 2); `rest` is -inf for squares outside free space."""
        cell, part = self._tree.query(squares(centre_m - half_m, 2.0 * half_m), "intersects")
        main = self._tree.query_nearest(shapely.points(centre_m), all_matches=False)[1]
        # Any model is valid; that of a triangle without area is zero.
        value, slope = (np.nan_to_num(each) for each in self._model(centre_m, main))
        other, steep = self._model(centre_m[cell], part)
        radius = np.sqrt(2.0) * half_m
        rest = np.abs(other - value[cell]) + np.hypot(*(steep - slope[cell]).T) * radius
        rest += 0.5 * np.linalg.norm(self._bend[part], axis=(1, 2)) * radius**2
        # Quadratic functions amplify rounding errors beyond their triangle.
        rest += ROUNDING * self._most[part] * (1.0 + radius / self._height[part]) ** 2
        most = np.full(len(centre_m), -np.inf)
        np.maximum.at(most, cell, np.nan_to_num(rest, nan=np.inf))
        return Planes(centre_m, value, slope, most, half_m)

    def _model(self, centre_m: Floats, part: Indices) -> tuple[Floats, Floats]:
        offset = centre_m - self._first[part]
        slope = self._slope[part] + np.einsum("nij,ni->nj", self._bend[part], offset)
        return self._value[part] + 0.5 * ((self._slope[part] + slope) * offset).sum(axis=1), slope


def outages(problem: SteppedProblem, before: Planes, after: Planes) -> Floats:
    """Return lower bounds (n,) of the mean outage, times its price, on moves between squares."""
    route, start, longest = problem.route, problem.tube.start_m, problem.tube.step_m
    if route.price == 0.0 or not len(before.value):
        return np.zeros(len(before.value))
    # Discs around the nodes of a grid contain the parts of all moves.
    half, spacing = max(before.half_m, after.half_m), longest / (2.0 * PARTS)
    radius = longest / (2.0 * PARTS) + np.sqrt(2.0) * half + np.sqrt(0.5) * spacing
    share = (np.arange(PARTS) + 0.5)[:, None, None] / PARTS
    places = ((1.0 - share) * before.centre_m + share * after.centre_m).reshape(-1, 2)
    near = np.rint((places - start) / spacing).astype(np.intp)
    low = near.min(axis=0)
    wide = 1 + int((near - low)[:, 1].max())
    keys, number = np.unique((near - low) @ (wide, 1), return_inverse=True)
    nodes = start + spacing * (np.column_stack(np.divmod(keys, wide)) + low)
    chance = Field(Discs(nodes, radius), problem.tube.makers)["chance"]
    least = 1.0 - chance.value[number] - (chance.slope[number] * (places - nodes[number])).sum(1)
    least -= half * np.abs(chance.slope).sum(axis=1)[number]
    least = np.maximum(least, (1.0 - chance.most)[number])
    least[~(chance.most < route.free_above)[number]] = 0.0
    # An undefined enclosure certifies nothing.
    silent = np.nan_to_num(least, nan=0.0, posinf=0.0, neginf=0.0).clip(0.0)
    return route.price * silent.reshape(PARTS, -1).mean(axis=0)


def reduced_costs(
    problem: SteppedProblem, before: Planes, after: Planes, outage: Floats | float = 0.0
) -> Floats:
    """Return lower bounds (n,) of the reduced costs of steps between squares (equation 6.21)."""
    offset, longest = after.centre_m - before.centre_m, problem.tube.step_m
    length = np.hypot(*offset.T)
    ahead = offset / np.maximum(length, 1e-300)[:, None]
    slope = 2.0 * problem.per_m * length + outage
    cost = problem.constant_m + (problem.per_m * length + outage) * length
    steep = 0.5 * (np.hypot(*before.slope.T) + np.hypot(*after.slope.T))
    found = np.full(len(length), -np.inf)
    # Any price >= 0 of the step's length is valid.
    for price in (np.zeros(len(length)), np.maximum(steep - slope, 0.0)):
        pull = (slope + price)[:, None] * ahead
        loss = before.half_m * np.abs(pull + before.slope).sum(axis=1)
        loss += after.half_m * np.abs(pull + after.slope).sum(axis=1)
        found = np.maximum(found, cost + price * (length - longest) - loss)
    # The potential alone bounds the cost of a step, too.
    return np.maximum(found - before.value + after.value, -before.rest - after.rest)


def level_bound(
    problem: SteppedProblem, potential: OpenPotential, level: Level, limit_m: float
) -> float | None:
    """Return a lower bound on the reduced costs of plans; None if there are too many pairs.

    The level keeps the cells that plans below the limit may visit.
    """
    tube, steps = problem.tube, list[tuple[Indices, Indices, Floats]]()
    near_m = tube.step_m / level.side_m * (1.0 + ROUNDING)
    planes = [potential.over(tube.start_m[None], 0.0)]
    costs = [np.zeros(1)]
    for k in range(tube.steps):
        own = potential.over(tube.start_m + level.offsets_m(k), 0.5 * level.side_m)
        level.active[k], own = level.active[k][own.rest > -np.inf], own.at(own.rest > -np.inf)
        if len(costs[k]) * len(own.value) > MOST_PAIRS:
            return None
        near = np.ones((1, len(own.value)), dtype=np.bool_)
        if k:
            apart = np.abs(level.active[k] - level.active[k - 1][:, None]) - 1
            near = (np.maximum(apart, 0) ** 2).sum(axis=2) <= near_m**2
            near &= ~never_moved(level, k, near)
        one, other = np.nonzero(near)
        # The bounds of outage take longest.
        for is_priced in (False, True):
            ends = planes[k].at(one), own.at(other)
            step = reduced_costs(problem, *ends, outages(problem, *ends) if is_priced else 0.0)
            useful = ~(costs[k][one] + step - own.rest[other] >= limit_m)
            one, other, step = one[useful], other[useful], step[useful]
        cost = np.full(len(own.value), np.inf)
        np.minimum.at(cost, other, costs[k][one] + step)
        kept = ~(cost - own.rest >= limit_m)
        level.active[k] = level.active[k][kept]
        place, used = np.cumsum(kept) - 1, kept[other]
        steps.append((one[used], place[other[used]], step[used]))
        planes.append(own.at(kept))
        costs.append(np.maximum(cost, -own.rest)[kept])
    # The potential bounds the cost after the last step.
    rest, least = -planes[-1].rest, -np.inf
    for k in range(tube.steps, 0, -1):
        through = costs[k] + rest
        least = max(least, float(through.min(initial=np.inf)))
        level.active[k - 1] = level.active[k - 1][~(through >= limit_m)]
        one, other, step = steps[k - 1]
        after, rest = rest[other] + step, np.full(len(costs[k - 1]), np.inf)
        np.minimum.at(rest, one, after)
    return min(least, limit_m)


def stepped_bounds(
    problem: SteppedProblem, potential: Potential, limit_m: float, seconds: float = np.inf
) -> Iterator[tuple[float, int]]:
    """Yield lower bounds in metres, at most `limit_m`, on the cost of all plans, and their levels.

    The potential must satisfy (6.14).
    """
    begun, tube, field = monotonic(), problem.tube, OpenPotential(problem.route, potential)
    base = float(potential.at_nodes[0])
    side, active = FIRST_SHARE * tube.step_m, first_cells(tube)
    for number in range(1, MOST_LEVELS + 1):
        turn = monotonic()
        level = Level(tube, side, list[Cells](active), [], [], core_of(tube, side), [])
        value = level_bound(problem, field, level, limit_m - base)
        if value is None:
            return
        yield (base + value) * (1.0 - MARGIN), number
        ahead = 3.0 * (monotonic() - turn)
        if base + value >= limit_m or monotonic() - begun + ahead > seconds:
            return
        side *= 0.5
        active = [divided(tube, each, side, k) for k, each in enumerate(level.active, 1)]


def stepped_value(problem: SteppedProblem, potential: Potential) -> float:
    """Return the bound that a certificate's levels of cells prove, in metres; 0 without levels."""
    found = islice(
        stepped_bounds(problem, potential, potential.step_limit_m), potential.step_levels
    )
    return max((value for value, _ in found), default=0.0)
