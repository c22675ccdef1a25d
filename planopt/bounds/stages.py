"""Stage problem that bounds one robot's objective, if this is a sum of terms over the steps.

Each term supplies bounds of its own stages. Constraints that only exclude paths are ignored and
listed, except for the workspace, static obstacles and p_min.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.bounds.enclosure import PowerEnclosure
from planopt.bounds.reach import ignored_motion, why_not_enclosed
from planopt.bounds.route import INNER_SHARE
from planopt.bounds.tube import StageProblem
from planopt.channel.measurements import SAME_PLACE_M
from planopt.objectives.terms.context import TermContext
from planopt.objectives.terms.term import Term
from planopt.objectives.upper_bounds import Discs, StageBounds, UpperBounds, no_reward
from planopt.problems.problem import Problem

Array = NDArray[np.float64]

LONGER_M = 3e-5
"""Length by which a verified step may exceed the longest step, for the verifier's tolerance."""

LESS_CHANCE = 1e-5
"""Probability by which a verified step may fall below p_min, for the verifier's tolerance."""

CLOSER_M = 1e-6
"""Distance by which a verified path may fall below the clearance, for the verifier's tolerance."""

MOST_MEASUREMENTS = 1000
"""Maximum number of measurements for which objectives are computed from all of them."""


@dataclass(frozen=True, eq=False)
class SummedTerms:
    """Bounds of all terms of a robot's objective, or the reason why there are none."""

    each: tuple[tuple[float, StageBounds], ...] = ()  # Weights and bounds
    reason: str = ""


def summed_terms(problem: Problem, at: TermContext) -> SummedTerms:
    """Return the bounds of the terms of a problem's first robot."""
    reason = why_not_enclosed(problem, at.stations)
    if reason:
        return SummedTerms(reason=reason)
    if any(len(station.measurements) > MOST_MEASUREMENTS for station in at.stations):
        return SummedTerms(
            reason=f"no bound of this objective is implemented beyond {MOST_MEASUREMENTS:,} "
            "measurements"
        )
    found: list[tuple[float, StageBounds]] = []
    for term in problem.terms:
        if term.weight == 0.0:
            continue
        bounds = term.stage_bounds(at) if bounds_own_value(term) else "without a proven bound"
        if not isinstance(bounds, StageBounds):
            return SummedTerms(reason=f"the term {term.kind} is {bounds}")
        found.append((term.weight, bounds))
    return SummedTerms(tuple(found))


def bounds_own_value(term: Term) -> bool:
    """Return whether the class that defines a term's value defines its bounds as well."""
    homes = [
        next(home for home in type(term).__mro__ if name in vars(home))
        for name in ("value", "stage_bounds")
    ]
    return homes[0] is homes[1]


def stage_problem(
    problem: Problem, at: TermContext, terms: SummedTerms, kept: NDArray[np.bool_]
) -> StageProblem:
    """Return the stage problem of a problem's first robot; p_min holds at the steps `kept` (N,)."""
    enclosures = [PowerEnclosure(station) for station in at.stations]

    def chance(discs: Discs) -> UpperBounds:
        if not len(discs.centre_m):
            return no_reward(0, discs)
        radius = np.full(len(discs.centre_m), discs.radius_m)
        silent: UpperBounds | None = None
        for enclosure, threshold in zip(enclosures, at.thresholds_dbm, strict=True):
            model = enclosure.over(discs.centre_m, radius)
            own = UpperBounds(*model.probability_bounds(threshold), discs.radius_m)
            silent = own if silent is None else either(silent, own)
        if silent is None:
            raise AssertionError("a problem has stations")
        return silent

    def reward(stage: int, discs: Discs, chance: UpperBounds) -> UpperBounds:
        total = no_reward(stage, discs)
        for weight, bounds in terms.each:
            total = total.plus(bounds.reward(stage, discs, chance).scaled(weight))
        return total

    return StageProblem(
        start_m=at.position_m,
        step_m=at.step_length_m + LONGER_M,
        steps=len(kept),
        bounds_m=problem.workspace.bounds_m,
        blocked=blocked_parts(problem),
        chance=chance,
        reward=reward,
        sure_m=at.connected_m,
        sure_radius_m=1.5 * SAME_PLACE_M,
        per_metre=sum(weight * bounds.per_metre for weight, bounds in terms.each),
        per_move=sum(weight * bounds.per_move for weight, bounds in terms.each),
        standstill_m=at.standstill_m,
        p_min=np.where(kept, problem.constraints.p_min - LESS_CHANCE, 0.0) if kept.any() else None,
    )


def either(one: UpperBounds, other: UpperBounds) -> UpperBounds:
    """Return bounds of the probability of at least one of two independent connections.

    It is ``P + Q - P Q``, at most the sum of both tangents minus a product of lower bounds; here
    ``1 - (1 - P)(1 - Q)`` with the tangents' complements, if these are >= 0 (equation 9.4).
    """
    radius = one.radius_m
    steep, other_steep = np.hypot(*one.slope.T), np.hypot(*other.slope.T)
    fits = (one.value + radius * steep <= 1.0) & (other.value + radius * other_steep <= 1.0)
    along = np.einsum("nd,nd->n", one.slope, other.slope)
    value = one.value + other.value - one.value * other.value
    value += 0.5 * radius**2 * (steep * other_steep - along)
    slope = (1.0 - other.value)[:, None] * one.slope + (1.0 - one.value)[:, None] * other.slope
    most = one.most + other.most - one.most * other.most
    return UpperBounds(
        np.where(fits, value, most), np.where(fits[:, None], slope, 0.0), most, radius
    )


def blocked_parts(problem: Problem) -> list[shapely.Polygon]:
    """Return areas that no position of a plan enters: lasting obstacles grown by the clearance."""
    # GEOS grows polygons by up to a hundredth too much.
    by_m = max(0.0, INNER_SHARE * problem.constraints.clearance_m - CLOSER_M)
    grown = [obstacle.polygon.buffer(by_m) for obstacle in problem.workspace.lasting]
    parts = shapely.get_parts(shapely.union_all(grown)).tolist()
    return [part for part in parts if isinstance(part, shapely.Polygon)]


def ignored_constraints(problem: Problem, robots: int) -> tuple[str, ...]:
    """Return the constraints that the bound of a robot ignores, in words."""
    rule = problem.constraints.rule
    found = () if rule.is_plain else (f"the rule {rule.connectivity}",)
    if len(problem.workspace.lasting):
        found = (*found, "obstacles between the ends of a step")
    return (*found, *ignored_motion(problem, robots))
