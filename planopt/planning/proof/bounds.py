"""Verification of proven bounds on the objective, and the plan's cost to compare with a bound.

A bound holds for the cost with the outage integrated along the route (equation 6.13).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.bounds.bound import Bound, Design, Potential, Tilts
from planopt.bounds.fixed_steps import stepped_problem, stepped_value
from planopt.bounds.reach import relaxed_constraints, route_problem, why_unbounded
from planopt.bounds.route import proven_value, route_bounds, valid_potential
from planopt.bounds.stages import are_designs, ignored_constraints, stage_problem, summed_terms
from planopt.bounds.tube import LONGER_M, StageProblem, cut_limits, proves
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.terms.term import TermContext
from planopt.planning.certificate import required_margins_db
from planopt.planning.plan import Plan
from planopt.planning.proof.rule import connectivity_law
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.problems.problem import (
    Problem,
    integrated_cost_m,
    outage_share,
    rate_s_m,
    steps_cost_s,
)
from planopt.world.motion import MovingDiscs


def bound_of(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    plan: Plan,
    value_m: float,
    potential: Potential | None,
    robots: int,
) -> Bound:
    """Return the bound on the first robot's objective for a bound `value_m` on its route cost."""
    triangles = 0 if potential is None else len(potential.corners)
    method = f"potential on a mesh of {triangles} triangles" if triangles else "distance to goal"
    if potential is not None and potential.step_levels:
        method += f", levels of cells around the first steps: {potential.step_levels}"
    # Steps may be longer by the verifier's tolerance, and begin that far from the start.
    longer_m = (problem.planner.horizon + 1) * LONGER_M
    value_s = rate_s_m(problem) * max(0.0, value_m - longer_m)
    return Bound(
        value_s,
        problem.sense,
        integrated_cost_s(problem, posteriors, plan),
        method,
        relaxed=relaxed_constraints(problem, robots),
        alone=value_s,
        certificate=potential,
    )


def verified_bound(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    plan: Plan,
    potential: Potential | None,
    robots: int,
) -> Bound:
    """Return the bound that a saved certificate proves for the first robot's plan."""
    reason = why_unbounded(problem, posteriors)
    if reason:
        return Bound(None, problem.sense, plan.objective, reason=reason)
    route = route_problem(problem, posteriors)
    if potential is None:
        value_m = next(iter(route_bounds(route, 0.0))).value_m
    else:
        valid = valid_potential(route, potential)
        value_m, stepped = proven_value(valid), stepped_problem(problem, posteriors)
        if valid is not None and stepped is not None and valid.step_levels > 0:
            value_m = max(value_m, stepped_value(stepped, valid))
    return bound_of(problem, posteriors, plan, value_m, potential, robots)


def stages_of(
    problem: Problem, at: TermContext, plan: Plan, moving: MovingDiscs
) -> Callable[[Design], StageProblem] | str:
    """Return the first robot's stage problem by design, or the reason why there is no bound.

    The bound holds for plans that satisfy p_min after the same steps as `plan`.
    """
    terms = summed_terms(problem, at)
    if terms.reason:
        return terms.reason
    kept = connected_steps(problem, at, plan)
    return partial(stage_problem, problem, at, terms, kept, moving=moving)


def connected_steps(problem: Problem, at: TermContext, plan: Plan) -> Mask:
    """Return a mask (N,) of the steps after which a plan satisfies p_min, as the verifier does."""
    path = plan.positions_m[1:]
    if problem.constraints.p_min <= 0.0 or not problem.constraints.rule.is_plain:
        return np.zeros(len(path), dtype=np.bool_)
    return np.asarray(required_margins_db(problem, at.power(path)) >= -MARGIN_TOLERANCE_DB)


def bound_of_sum(
    problem: Problem, at: TermContext, plan: Plan, moving: MovingDiscs, tilts: Tilts
) -> Bound:
    """Return the bound that a certificate proves for the first robot's sum of terms."""
    given = moving.is_robot.any() or len(at.aim.pending.planned_m) > 0
    words = ", given the other robots' plans" if given else ""
    return Bound(
        tilts.value,
        problem.sense,
        plan.objective,
        f"branch and bound, levels of cells: {tilts.levels}{words}",
        relaxed=ignored_constraints(problem),
        # The value of other robots' planned measurements depends on their plans.
        alone=None if len(at.aim.pending.planned_m) else tilts.alone_value,
        certificate=tilts,
    )


def verified_sum(
    problem: Problem, at: TermContext, plan: Plan, moving: MovingDiscs, tilts: Tilts | None
) -> Bound:
    """Return the bound that a saved certificate proves for the first robot's sum of terms."""
    problem_of = stages_of(problem, at, plan, moving)
    if isinstance(problem_of, str):
        return Bound(None, problem.sense, plan.objective, reason=problem_of)
    stages = problem_of(Design())
    if tilts is not None and are_designs(tilts, stages.steps):
        limits = cut_limits(stages.limits_m, tilts.cuts)
        parts = [
            replace(problem_of(design), limits_m=each)
            for design, each in zip(tilts.designs(), limits, strict=True)
        ]
        alone = replace(tilts, levels=tilts.alone_levels, value=tilts.alone_value)
        solos = [each.alone() for each in parts]
        is_same = len(solos[0].keep_outs) == len(stages.keep_outs) and alone.value == tilts.value
        if all(proves(each, tilts) for each in parts) and (
            is_same or all(proves(each, alone) for each in solos)
        ):
            return bound_of_sum(problem, at, plan, moving, tilts)
    return Bound(
        None, problem.sense, plan.objective, reason="the certificate does not prove its bound"
    )


def metre_cost_of(
    problem: Problem, posteriors: Sequence[ChannelPosterior]
) -> Callable[[Floats], Floats]:
    """Return a function that maps positions (n, 2) to the cost per metre there (equation 4.17)."""
    law, reach = connectivity_law(problem, posteriors), problem.reach
    slack_db = problem.constraints.rule.slack_max_db or 0.0

    def metre_cost(places_m: Floats) -> Floats:
        chance = law.probability(places_m, slack_db)
        below = chance < problem.constraints.p_min
        return 1.0 + reach.outage_price * outage_share(chance, below, reach.charges_everywhere)

    return metre_cost


def integrated_cost_s(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> float:
    """Return the objective of a plan with the outage integrated along its steps.

    For a robot with dynamics, the route is driven from its last position.
    """
    if plan.pivot is None:
        return plan.objective
    places, pivot = plan.positions_m, plan.pivot
    metre_cost = metre_cost_of(problem, posteriors)
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    outage_m = integrated_cost_m(metre_cost, places) - float(lengths.sum())
    own_s = steps_cost_s(problem, places)
    if plan.drive is not None and len(plan.route_m):
        # The cost-to-go of a moving robot is that of its rest position, which is nearer.
        route = np.vstack([places[-1:], plan.route_m])
        return own_s + rate_s_m(problem) * (outage_m + integrated_cost_m(metre_cost, route))
    to_pivot = float(np.linalg.norm(places[-1] - pivot.position_m))
    ahead_m = outage_m + pivot.metre_cost * to_pivot + pivot.cost_m
    return own_s + rate_s_m(problem) * ahead_m
