"""Stage problem that bounds one robot's objective, if this is a sum of terms over the steps.

Each term supplies bounds of its own stages. Constraints that only exclude paths are ignored and
listed, except for the workspace, static obstacles and p_min.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce

import numpy as np
import shapely

from planopt.arrays import Floats, Mask
from planopt.bounds.enclosure import PowerEnclosure, PowerModel
from planopt.bounds.reach import ignored_motion, why_not_enclosed
from planopt.bounds.route import INNER_SHARE
from planopt.bounds.tube import StageProblem
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.terms.term import TermContext
from planopt.objectives.upper_bounds import (
    Discs,
    Field,
    Makers,
    Quantity,
    StageBounds,
    UpperBounds,
    constant_bounds,
    no_reward,
)
from planopt.problems.problem import Problem

Array = Floats

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
    """Bounds of all terms of a robot's objective, or the reason for missing bounds."""

    each: tuple[tuple[float, StageBounds], ...] = ()  # Weights and bounds
    reason: str = ""


def summed_terms(problem: Problem, at: TermContext) -> SummedTerms:
    """Return the bounds of the terms of a problem's first robot."""
    reason = why_not_enclosed(problem, at.law.posteriors)
    if reason:
        return SummedTerms(reason=reason)
    if any(len(station.measurements) > MOST_MEASUREMENTS for station in at.law.posteriors):
        return SummedTerms(
            reason=f"no bound of this objective is implemented beyond {MOST_MEASUREMENTS:,} "
            "measurements"
        )
    found: list[tuple[float, StageBounds]] = []
    for term in problem.terms:
        if term.weight == 0.0:
            continue
        # A derived class may have another value than the bounds that it inherits.
        own = "stage_bounds" in vars(type(term))
        bounds = term.stage_bounds(at) if own else "without a proven bound"
        if not isinstance(bounds, StageBounds):
            return SummedTerms(reason=f"the term {term.kind} is {bounds}")
        if bounds.most_steps is not None and problem.planner.horizon > bounds.most_steps:
            words = f"has a proven bound only up to planner.horizon = {bounds.most_steps}"
            return SummedTerms(reason=f"the term {term.kind} {words}")
        found.append((term.weight, bounds))
    return SummedTerms(tuple(found))


def stage_problem(
    problem: Problem, at: TermContext, terms: SummedTerms, kept: Mask, path_m: Array | None = None
) -> StageProblem:
    """Return the first robot's stage problem; p_min applies to steps in the mask `kept` (N,).

    A path (N, 2) that measures makes the bound of mapped information tighter (equation 9.14).
    """
    paired, measured = None, at.anticipated[0]
    mapped = [(weight, each.paired) for weight, each in terms.each if each.paired is not None]
    if len(kept) > 1 and len(mapped) == sum(term.is_measured for term in problem.terms) == 1:
        [(weight, own)] = mapped
        paired = replace(own, weight=weight).informed(path_m)
        measured = paired.posterior

    def reward(stage: int, field: Field) -> UpperBounds:
        total = no_reward(stage, field)
        for weight, bounds in terms.each:
            own = bounds.reward(stage, field)
            if paired is not None and bounds.paired is not None:
                most = own.most + (0.0 if stage else paired.given_nats)
                own = replace(own, value=most, slope=np.zeros_like(own.slope), most=most)
            total = total.plus(own.scaled(weight))
        return total

    return StageProblem(
        start_m=at.position_m,
        step_m=at.step_length_m + LONGER_M,
        steps=len(kept),
        bounds_m=problem.workspace.bounds_m,
        blocked=blocked_parts(problem),
        makers=quantity_makers(at.law.posteriors, at.law.thresholds_dbm, measured),
        reward=reward,
        sure_m=at.connected_m,
        sure_radius_m=1.5 * SAME_PLACE_M,
        per_metre=sum(weight * bounds.per_metre for weight, bounds in terms.each),
        per_move=sum(weight * bounds.per_move for weight, bounds in terms.each),
        standstill_m=at.standstill_m,
        paired=paired,
        p_min=np.where(kept, problem.constraints.p_min - LESS_CHANCE, 0.0) if kept.any() else None,
    )


def quantity_makers(
    stations: Sequence[ChannelPosterior],
    thresholds_dbm: Sequence[float],
    measured: ChannelPosterior,
) -> Makers:
    """Return, by name, functions that bound the predicted quantities over discs."""
    shared = replace(measured, theta_covariance=np.zeros((2, 2)))
    trended = replace(measured, theta_covariance=np.eye(2))
    enclosures: dict[int, PowerEnclosure] = {}

    def model(posterior: ChannelPosterior, discs: Discs) -> PowerModel:
        if id(posterior) not in enclosures:
            enclosures[id(posterior)] = PowerEnclosure(posterior)
        radius = np.full(len(discs.centre_m), discs.radius_m)
        return enclosures[id(posterior)].over(discs.centre_m, radius)

    def chance(discs: Discs) -> UpperBounds:
        each = [
            UpperBounds(*model(station, discs).probability_bounds(threshold), discs.radius_m)
            for station, threshold in zip(stations, thresholds_dbm, strict=True)
        ]
        return reduce(either, each)

    def variance(discs: Discs) -> UpperBounds:
        return UpperBounds(*model(measured, discs).variance_bounds(), discs.radius_m)

    def trend(discs: Discs) -> UpperBounds:
        # With M = I, the variance exceeds that for known path loss by the squared norm of phi.
        whole = UpperBounds(*model(trended, discs).variance_bounds(), discs.radius_m)
        share = UpperBounds(*model(shared, discs).precision_bounds(), discs.radius_m)
        return whole.times(share).plus(constant_bounds(discs, -1.0))

    def minus_variance(discs: Discs) -> UpperBounds:
        return UpperBounds(*model(measured, discs).minus_variance_bounds(), discs.radius_m)

    makers: dict[Quantity, Callable[[Discs], UpperBounds]] = {
        "chance": chance,
        "variance_db2": variance,
        "minus_variance_db2": minus_variance,
        "trend": trend,
    }
    return {name: partial(or_nothing, make) for name, make in makers.items()}


def or_nothing(make: Callable[[Discs], UpperBounds], discs: Discs) -> UpperBounds:
    """Return the upper bounds of `make` over discs; empty without discs."""
    return make(discs) if len(discs.centre_m) else constant_bounds(discs, 0.0)


def either(one: UpperBounds, other: UpperBounds) -> UpperBounds:
    """Return upper bounds of P(at least one of two independent connections) (equation 9.4)."""
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
    """Return descriptions of the constraints that the bound of a robot ignores."""
    rule = problem.constraints.rule
    found = () if rule.is_plain else (f"the rule {rule.connectivity}",)
    if len(problem.workspace.lasting):
        found = (*found, "obstacles between the ends of a step")
    return (*found, *ignored_motion(problem, robots))
