"""Proven bounds on every plan's objective, and the better plans that the bounds suggest.

For a goal, :mod:`planopt.bounds.route` supplies the bound and the routes of its mesh, and
:mod:`planopt.bounds.fixed_steps` raises it for steps that cannot follow corners. The bound is
compared with the time and effort of the plan's steps, the cost rate of the route (equation 4.16),
and the outage integrated along both (equation 6.13). For sums over steps,
:mod:`planopt.bounds.tube` supplies it.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from time import monotonic

import numpy as np

from planopt.arrays import Floats
from planopt.bounds.bound import Bound, Design, Potential, Tilts
from planopt.bounds.fixed_steps import stepped_bounds, stepped_problem
from planopt.bounds.multipliers import fitted_parts, local_optimum, tilts_near
from planopt.bounds.one_step import best_place
from planopt.bounds.reach import route_problem, why_unbounded
from planopt.bounds.route import route_bounds
from planopt.bounds.tube import StageProblem, TubeBound, tube_bounds
from planopt.channel.posterior import Belief
from planopt.planning.candidates import Scorer
from planopt.planning.horizon_planner import FallbackCascade
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.proof.bounds import (
    bound_of,
    bound_of_sum,
    connected_steps,
    integrated_cost_s,
    stages_of,
)
from planopt.planning.proof.rule import verifier_context
from planopt.planning.refinement import Refinement
from planopt.planning.reservations import (
    discs_to_avoid,
    others_of,
    planned_motion,
    with_separations,
)
from planopt.planning.route_smoothing import RouteSmoothing
from planopt.planning.scene import build_ground
from planopt.planning.search.guess_search import Guess
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.values.context import (
    Aim,
    StepContext,
    counts_others,
    step_context,
    workspace_region,
)
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import Problem, problem_of_robot, rate_s_m
from planopt.world.clearance import index_obstacles
from planopt.world.motion import MovingDiscs

STEPS_SHARE, STEPS_S, STEPS_PART = 0.35, 4.0, 0.1
"""Share of the time for steps of fixed duration; time, and their share of a plan's cost, from which
on they are considered."""
LIMIT_SHARE = 0.6  # Share of a gap that these steps may close
LEAST_SHARE = 0.3  # Minimum share of the time that is reserved for the bound
DESIGN_SHARE = 0.5  # Share of the time for the design of a bound on information
ALONE_SHARE = 0.2  # Share of the time for the bound that holds whatever the other robots do
SWEEPS, IMPROVING_SHARE = 2, 0.2
"""Searches for better plans of robots that keep apart, before their bounds; time of each."""
SURPLUS = 2e-5
"""Surplus of the probability of connection over the bound's p_min in an improved plan."""


def proven_plans(
    problem: Problem, belief: Belief, plans: Sequence[Plan], aims: Sequence[Aim], seconds: float
) -> tuple[Plan, ...]:
    """Return the plans with proven bounds; better plans that the bounds suggest replace them.

    Each robot gets the same share of the time. An interrupt ends the proofs and keeps the results.
    """
    found = list(plans)
    ever_better = goal_plans if problem.has_goal else sum_plans
    with contextlib.suppress(KeyboardInterrupt):
        for number, plan in ever_better(problem, belief, plans, aims, seconds):
            found[number] = plan
    return tuple(found if problem.has_goal else with_separations(problem, 0, found))


def unproven(problem: Problem, plan: Plan, reason: str) -> Plan:
    """Return the plan without a bound, for a reason."""
    return replace(plan, bound=Bound(None, problem.sense, plan.objective, reason=reason))


def goal_plans(
    problem: Problem, belief: Belief, plans: Sequence[Plan], aims: Sequence[Aim], seconds: float
) -> Iterator[tuple[int, Plan]]:
    """Yield numbers of robots and their plans to a goal, with ever tighter bounds."""
    for number, plan in enumerate(plans):
        own = problem_of_robot(problem, number)
        reason = why_unbounded(own, belief.posteriors)
        if reason:
            yield number, unproven(problem, plan, reason)
            continue
        for better in goal_plan(own, belief, plan, len(plans), seconds / len(plans)):
            yield number, better


def goal_plan(
    problem: Problem, belief: Belief, plan: Plan, robots: int, seconds: float
) -> Iterator[Plan]:
    """Yield the first robot's plan with ever tighter bounds, and with cheaper routes."""
    begun, posteriors = monotonic(), belief.posteriors
    smoothing = RouteSmoothing(problem, posteriors, robots == 1)
    steps_s = problem.planner.horizon * problem.planner.step_s
    matters = seconds >= STEPS_S and steps_s > STEPS_PART * plan.objective
    stepped = stepped_problem(problem, posteriors) if matters else None
    route_s = seconds if stepped is None else (1.0 - STEPS_SHARE) * seconds

    def bounded(value_m: float, potential: Potential | None) -> Plan:
        bound = bound_of(problem, posteriors, plan, value_m, potential, robots)
        return replace(plan, bound=replace(bound, wall_s=monotonic() - begun))

    value_m, potential = 0.0, None
    # Bounds never get worse.
    for best in route_bounds(route_problem(problem, posteriors), route_s):
        if best.corridor is not None:
            plan = smoothing.improved(plan, best.corridor)
        value_m, potential = best.value_m, best.potential
        yield bounded(value_m, potential)
    if stepped is None or potential is None:
        return
    cost_m = integrated_cost_s(problem, posteriors, plan) / rate_s_m(problem)
    limit_m = value_m + LIMIT_SHARE * (cost_m - value_m)
    left = seconds - (monotonic() - begun)
    for higher_m, levels in stepped_bounds(stepped, potential, limit_m, left):
        if higher_m > value_m:
            value_m = higher_m
            potential = replace(potential, step_levels=levels, step_limit_m=limit_m)
            yield bounded(value_m, potential)


def sum_plans(
    problem: Problem, belief: Belief, plans: Sequence[Plan], aims: Sequence[Aim], seconds: float
) -> Iterator[tuple[int, Plan]]:
    """Yield numbers of robots and their plans, with bounds given the other robots' plans."""
    found, apart = list(plans), problem.has_separation
    share = seconds / len(plans)
    # A better plan would change the values of plans that count its measurements.
    improves = len(plans) == 1 or not counts_others(problem)
    # If robots keep apart, a better plan changes the problems of the others, so it comes first.
    sweeps = SWEEPS if apart and improves else 0
    limits_s = [IMPROVING_SHARE * share] * sweeps
    for limit_s in [*limits_s, share - sum(limits_s)]:
        is_changed, is_last = improves and (not apart or sweeps > 0), sweeps == 0
        sweeps -= 1
        if is_last:
            yield from enumerate(replace(plan, bound=None) for plan in found)
        for number, aim in enumerate(aims):
            motions = [planned_motion(problem, plan) for plan in found]
            moving = discs_to_avoid(problem, 0, others_of(motions, number))
            own = problem_of_robot(problem, number)
            for better in sum_plan(own, belief, found[number], aim, moving, limit_s, is_changed):
                found[number] = better
                if is_last:
                    yield number, better


def sum_plan(
    problem: Problem,
    belief: Belief,
    plan: Plan,
    aim: Aim,
    moving: MovingDiscs,
    seconds: float,
    improves: bool,
) -> Iterator[Plan]:
    """Yield the first robot's plan, or a better plan nearby, with ever tighter bounds."""
    begun, index = monotonic(), index_obstacles(problem.workspace)
    start = plan.positions_m[0] if plan.drive is None else plan.drive.states[0]
    base = verifier_context(problem, index, belief.posteriors, start, moving=moving)
    at = step_context(base, workspace_region(problem), aim)
    problem_of = stages_of(problem, at, plan, moving)
    if isinstance(problem_of, str):
        yield unproven(problem, plan, problem_of)
        return
    stages = problem_of(Design())
    parts, designs, cuts, guesses = [stages], [Design()], np.zeros((0, 4)), list[Floats]()
    if stages.measured is not None:
        optimum = plan.positions_m[1:]
        fits, cuts = fitted_parts(
            problem_of, stages.measured, optimum, plan.objective, DESIGN_SHARE * seconds
        )
        designs, guesses = [each.design for each in fits], [each.paths_m[-1] for each in fits]
        parts = [replace(problem_of(each.design), limits_m=each.limits_m) for each in fits]
        stages = parts[0]
    elif stages.steps == 1:
        exact = replace(stages, step_m=at.step_length_m)
        optimum = best_place(exact, 0.3 * seconds).place_m[None]
    else:
        optimum = local_optimum(stages, plan.positions_m[1:], SURPLUS)
    improves, connected = improves and plan.drive is None, connected_steps(problem, at, plan)

    def replaced(better: Plan) -> Plan:
        # The bound holds for plans that satisfy p_min at the same steps.
        misses = connected & ~connected_steps(problem, at, better)
        return plan if misses.any() else better

    plan = replaced(better_of(at, plan, optimum)) if improves else plan
    refinement = None
    if improves and stages.steps > 1:
        ground = build_ground(problem, at.position_m)
        refinement = FallbackCascade(problem, ground).refinement
    nearer = replace(stages, step_m=at.step_length_m - 2.0 * STEP_PAD_M)
    kinks = np.vstack([each.measurements.positions_m for each in belief.posteriors])
    tilts = tilts_near(stages, [optimum, plan.positions_m[1:]], kinks)

    def improved(path_m: Floats) -> float:
        nonlocal plan
        if refinement is None:
            return plan.objective
        better = plan
        if at.law.is_connected(path_m).any():
            nearer_m = local_optimum(nearer, path_m, SURPLUS)
            better = refined(refinement, at, better_of(at, plan, nearer_m), nearer_m)
        elif stages.keep_outs:
            # The refinement alone does not find a way round discs that the path crosses.
            path_m = local_optimum(stages, path_m, SURPLUS)
            better = better_of(at, plan, path_m)
        better = replaced(refined(refinement, at, better, path_m))
        if better is not plan:
            plan = better
            tilts.extend(tilts_near(stages, [plan.positions_m[1:]], kinks))
        return plan.objective

    left = max(LEAST_SHARE * seconds, seconds - (monotonic() - begun))
    alone, alone_s = stages.alone(), 0.0
    if len(alone.keep_outs) < len(stages.keep_outs) and not improves:
        alone_s = ALONE_SHARE * left
    for guess in guesses:
        improved(guess)

    def bounded(best: TubeBound, free: TubeBound) -> Plan:
        tilted = Tilts(
            *(np.array(tilts), best.levels, best.value, free.levels, free.value),
            places_m=np.concatenate([each.places_m for each in designs]),
            weights=np.concatenate([each.weights for each in designs]),
            path_loss=np.concatenate([each.path_loss for each in designs]),
            owner=np.repeat(np.arange(len(designs)), [len(each.places_m) for each in designs]),
            cuts=cuts,
        )
        bound = bound_of_sum(problem, at, plan, moving, tilted)
        return replace(plan, bound=replace(bound, wall_s=monotonic() - begun))

    search = improved if stages.measured is None else None
    best = None
    for best in largest_bounds(parts, plan.objective, tilts, left - alone_s, search):
        if not alone_s:
            yield bounded(best, best)
    if best is not None and alone_s:
        solos = [each.alone() for each in parts]
        for free in largest_bounds(solos, plan.objective, tilts, alone_s):
            yield bounded(best, free)


def largest_bounds(
    parts: Sequence[StageProblem],
    known: float,
    tilts: Sequence[Floats],
    seconds: float,
    improved: Callable[[Floats], float] | None = None,
) -> Iterator[TubeBound]:
    """Yield the largest of the bounds of parts of the paths, each refined while it is largest."""
    runs = [tube_bounds(each, known, tilts, seconds, improved) for each in parts]
    found = [next(each) for each in runs]
    while True:
        worst = int(np.argmax([each.value for each in found]))
        yield replace(found[worst], levels=max(each.levels for each in found))
        after = next(runs[worst], None)
        if after is None:
            return
        found[worst] = after


def refined(refinement: Refinement, at: StepContext, plan: Plan, path_m: Floats) -> Plan:
    """Return the plan refined from a path (N, 2) if it is verified and better, else `plan`."""
    scorer = Scorer(at, ObjectiveValue(at))
    held = at.law.is_connected(path_m)
    guess = Guess(path_m, scorer.objective(path_m), 0.0, clear=False, held=held)
    for found in refinement.candidates(at, scorer, guess, Rung.PLAN):
        if found.verdict is Verdict.VERIFIED and found.objective > plan.objective:
            plan = scorer.plan_from(found, plan.wall_s)
    return plan


def better_of(at: StepContext, plan: Plan, path_m: Floats) -> Plan:
    """Return a verified plan along a path (N, 2) if it is better than `plan`, else `plan`."""
    if plan.drive is not None:
        return plan
    path, here = path_m.copy(), plan.positions_m[0]
    longest = at.step_length_m - STEP_PAD_M
    for k, place in enumerate(path_m):
        move = place - here
        here = here + move * min(1.0, longest / max(float(np.hypot(*move)), longest))
        path[k] = here
    scorer = Scorer(at, ObjectiveValue(at))
    found = scorer.assessed(scorer.candidate(path, plan.rung, Termination.LATTICE_ONLY))
    if found.verdict is not Verdict.VERIFIED or not found.objective > plan.objective:
        return plan
    return scorer.plan_from(found, plan.wall_s)
