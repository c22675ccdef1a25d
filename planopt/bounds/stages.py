"""Stage problem that bounds one robot's objective, if this is a sum of terms over the steps.

Each term supplies bounds of its own stages. Constraints that only exclude paths are ignored and
listed, except for the workspace, static obstacles and p_min.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
import shapely

from planopt.arrays import Floats, Mask
from planopt.bounds.bound import Design, Tilts
from planopt.bounds.enclosure import PowerEnclosure, PowerModel, VarianceDifference
from planopt.bounds.reach import MOVING, ignored_motion, longest_sag_m, why_not_enclosed
from planopt.bounds.route import grown_by
from planopt.bounds.tube import LARGEST, LONGER_M, Chain, KeepOut, StageProblem
from planopt.channel.gaussian_sites import MIN_NOISE_VARIANCE_DB2
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.posterior import ChannelPosterior, with_repeated
from planopt.objectives.terms.term import TermContext
from planopt.objectives.upper_bounds import (
    Discs,
    Field,
    Makers,
    Measured,
    StageBounds,
    UpperBounds,
    constant_bounds,
    information_bounds,
    no_reward,
)
from planopt.problems.problem import Problem, may_reach_from
from planopt.world.clearance import polygons_of
from planopt.world.motion import NOTHING_MOVES, MovingDiscs

LESS_CHANCE = 1e-5
"""Probability by which a verified step may fall below p_min, for the verifier's tolerance."""
CLOSER_M = 5e-5
"""Distance by which a verified path may fall below the clearance, for the verifier's tolerances."""
LEAST_WEIGHT = 1e-9  # Least weight of a measurement in a reference
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
    alone = sum(term.is_measured and term.weight != 0.0 for term in problem.terms) == 1
    found: list[tuple[float, StageBounds]] = []
    for term in problem.terms:
        if term.weight == 0.0:
            continue
        # A derived class may have another value than the bounds that it inherits.
        own = "stage_bounds" in vars(type(term))
        bounds = term.stage_bounds(at) if own else "without a proven bound"
        if not isinstance(bounds, StageBounds):
            return SummedTerms(reason=f"the term {term.kind} is {bounds}")
        if not alone or (problem.planner.horizon == 1 and bounds.most_steps != 0):
            bounds = replace(bounds, measured=None)
        elif bounds.measured is not None:
            bounds = replace(bounds, most_steps=None)
        if bounds.most_steps is not None and problem.planner.horizon > bounds.most_steps:
            words = f"has a proven bound only up to planner.horizon = {bounds.most_steps}"
            return SummedTerms(reason=f"the term {term.kind} {words}")
        found.append((term.weight, bounds))
    return SummedTerms(tuple(found))


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Upper bound of the information of any path: a constant, and what each position adds."""

    share: float  # Factor of the constant and of all that is added
    constant: float
    # Each position adds what its predecessor does not tell; None: nothing
    chain: Chain | None
    # Each position also adds this difference of variances (equation 9.13); None: nothing
    tangent: VarianceDifference | None
    noise_db2: float  # omega^2

    @classmethod
    def of(cls, measured: Measured, design: Design, weight: float) -> Relaxation:
        """Return the bound of an information objective with a weight, for any design."""
        prior, places, form = measured.posterior, design.places_m, measured.map_form
        own, noise = prior.theta_covariance, prior.parameters.multipath_std_db**2
        # Posteriors have no smaller noise than this.
        most = 0.5 * noise / MIN_NOISE_VARIANCE_DB2
        reference, assumed = np.minimum(design.weights, most).T
        values, vectors = np.linalg.eigh(design.path_loss)
        path_loss = (vectors * np.maximum(values, 0.0)) @ vectors.T
        is_referred = measured.criterion != "map" or bool(reference.any())
        # Both posteriors of the difference have all positions.
        reference = np.maximum(reference, LEAST_WEIGHT) if is_referred else reference
        more, nats, information = repeated(prior, places, reference)
        chain, share = None, weight
        if measured.criterion == "map":
            gain = np.eye(2) + own @ path_loss
            left, given = np.linalg.solve(gain, own), float(np.linalg.slogdet(gain)[1])
            known = replace(prior, theta_covariance=0.5 * (left + left.T))
            assuming, base, _ = repeated(known, places, assumed)
            share, constant = 0.5 * weight, given + base
            chain = Chain(assuming, share, noise)
            less, joint, _ = repeated(known, places, reference + assumed)
            constant -= given + joint - nats if is_referred else 0.0
        else:
            left = more.theta_covariance
            changes = {
                "T": (np.trace(information), np.eye(2)),
                "D": (np.linalg.slogdet(np.eye(2) + own @ information)[1], left),
            }
            other = np.trace(form @ (own - left)), left @ form @ left
            constant, spread = changes.get(measured.criterion, other)
            less = replace(more, theta_covariance=np.zeros((2, 2)))
            more = replace(more, theta_covariance=spread)
        if not is_referred:
            return cls(share, constant, chain, None, noise)
        both = PowerEnclosure(more), PowerEnclosure(less)
        if len(places):
            one, two = (each.over(places, 0.0 * reference).variance_db2 for each in both)
            constant -= float(reference @ (one - two)) / noise
        return cls(share, constant, chain, both[0].less(both[1]), noise)

    def reward(self, stage: int, field: Field) -> UpperBounds:
        """Return upper bounds of what a stage's position adds."""
        total = constant_bounds(field.discs, 0.0 if stage else self.share * self.constant)
        if self.chain is not None:
            own = information_bounds(field["variance_db2"], self.noise_db2)
            total = total.plus(own.scaled(2.0 * self.share))
        if self.tangent is not None:
            total = total.plus(field["tangent"].scaled(self.share / self.noise_db2))
        return total


def repeated(
    prior: ChannelPosterior, places_m: Floats, weight: Floats
) -> tuple[ChannelPosterior, float, Floats]:
    """Return the posterior of weighted measurements, twice their information, and that on theta.

    A measurement with weight w has the noise variance omega^2 / w.
    """
    used, count = weight > 0.0, len(prior.measurements)
    if not used.any():
        return prior, 0.0, np.zeros((2, 2))
    noise = prior.parameters.multipath_std_db**2 / weight[used]
    found = with_repeated(prior, places_m[used], noise)
    rows = found.whitened_regressors[count:]
    information = rows.T @ rows
    gain = np.linalg.slogdet(np.eye(2) + prior.theta_covariance @ information)[1]
    pivots = np.diagonal(found.factor)[count:]
    return found, float(2.0 * np.log(pivots).sum() - np.log(noise).sum() + gain), information


def stage_problem(
    problem: Problem,
    at: TermContext,
    terms: SummedTerms,
    kept: Mask,
    design: Design,
    moving: MovingDiscs = NOTHING_MOVES,  # Discs that the robot avoids, for instance other robots
) -> StageProblem:
    """Return the first robot's stage problem; p_min applies to steps in the mask `kept` (N,)."""
    measured, relaxation = None, None
    for weight, each in terms.each:
        if each.measured is not None:
            measured, relaxation = (each.measured, Relaxation.of(each.measured, design, weight))

    def reward(stage: int, field: Field) -> UpperBounds:
        total = no_reward(stage, field)
        for weight, bounds in terms.each:
            if relaxation is not None and bounds.measured is not None:
                total = total.plus(relaxation.reward(stage, field))
            else:
                total = total.plus(bounds.reward(stage, field).scaled(weight))
        return total

    return StageProblem(
        start_m=at.position_m,
        step_m=at.step_length_m + LONGER_M,
        steps=len(kept),
        limits_m=np.tile(problem.workspace.bounds_m, (len(kept), 1)),
        blocked=blocked_parts(problem),
        makers=quantity_makers(
            at.law.posteriors, at.law.thresholds_dbm, at.anticipated[0], relaxation
        ),
        reward=reward,
        sure_m=at.connected_m,
        sure_radius_m=1.5 * SAME_PLACE_M,
        per_metre=sum(weight * bounds.per_metre for weight, bounds in terms.each),
        per_move=sum(weight * bounds.per_move for weight, bounds in terms.each),
        standstill_m=at.standstill_m,
        measured=measured,
        chain=None if relaxation is None else relaxation.chain,
        p_min=np.where(kept, problem.constraints.p_min - LESS_CHANCE, 0.0) if kept.any() else None,
        keep_outs=keep_outs(problem, moving, len(kept)),
        sag_m=(longest_sag_m(problem) or 0.0) + CLOSER_M,
        may_reach=may_reach_from(problem, at.state),
    )


def quantity_makers(
    stations: Sequence[ChannelPosterior],
    thresholds_dbm: Sequence[float],
    measured: ChannelPosterior,
    relaxation: Relaxation | None = None,
) -> Makers:
    """Return, by name, functions that bound the predicted quantities over discs."""
    if relaxation is not None and relaxation.chain is not None:
        measured = relaxation.chain.posterior
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

    def tangent(discs: Discs) -> UpperBounds:
        if relaxation is None or relaxation.tangent is None:
            return constant_bounds(discs, 0.0)
        bounds = relaxation.tangent.bounds(discs.centre_m, discs.radius_m)
        return UpperBounds(*bounds, discs.radius_m)

    return {"chance": chance, "variance_db2": variance, "tangent": tangent, "trend": trend}


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
    obstacles = [obstacle.polygon for obstacle in problem.workspace.lasting]
    return polygons_of(grown_by(obstacles, problem.constraints.clearance_m, CLOSER_M))


def keep_outs(problem: Problem, moving: MovingDiscs, steps: int) -> list[KeepOut]:
    """Return the discs that the first robot's positions and motions may not enter."""
    sag_m = longest_sag_m(problem) or 0.0
    centres_m, bulges_m = moving.centres_m[:, : steps + 1], moving.bulges_m[:, :steps]
    radii_m = moving.radius_m[:, :steps] + moving.least_m[:, None] - 2.0 * CLOSER_M
    return [
        KeepOut(centre, radius, radius - bulge - sag_m, is_robot)
        for centre, radius, bulge, is_robot in zip(
            centres_m, radii_m, bulges_m, moving.is_robot.tolist(), strict=True
        )
    ]


def ignored_constraints(problem: Problem) -> tuple[str, ...]:
    """Return descriptions of the constraints that the bound of a robot ignores."""
    rule = problem.constraints.rule
    found = () if rule.is_plain else (f"the rule {rule.connectivity}",)
    if len(problem.workspace.lasting):
        found = (*found, "some obstacles between the ends of a step")
    return (*found, *(words for words in ignored_motion(problem, 1) if words != MOVING))


def are_designs(tilts: Tilts, steps: int) -> bool:
    """Return whether the saved designs and cuts may occur in a proof."""
    weights, known, cuts = tilts.weights, tilts.path_loss, tilts.cuts
    part, stage, axis, at_m = cuts.T
    return (
        len(weights) == len(tilts.places_m) == len(tilts.owner)
        and len(known) == 2 * len(cuts) + 2
        and bool(((part >= 0) & (part <= np.arange(len(cuts)))).all())
        and bool(((stage >= 0) & (stage < steps) & (axis >= 0) & (axis < 2)).all())
        and bool((np.abs(at_m) < LARGEST).all())
        and float(np.abs(tilts.places_m).max(initial=0.0)) < LARGEST
        and float(np.abs(known).max()) < LARGEST
        and bool(((weights >= 0.0) & (weights < LARGEST)).all())
    )
