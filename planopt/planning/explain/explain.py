"""Explanation of problems without verified plan, and of plans that cross coverage holes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import one_blas_thread
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.errors import InputError, NoPlanError
from planopt.parts import part_of
from planopt.planning.explain.changes import Trials, deadline_s
from planopt.planning.explain.no_path import explain_blocked, explain_no_path, is_open
from planopt.planning.explain.violations import Case, explain_violated
from planopt.planning.explanation import Crossing, Explanation, Relaxation
from planopt.planning.free_space import is_joined
from planopt.planning.initial_data import prepare
from planopt.planning.loop.results import Solution
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.context import connectivity_law
from planopt.planning.reservations import beside, others_of, planned_motion
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.solve import solve, solve_on
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.lattice import lattice_paths, route_from


@one_blas_thread()
def explain(result: Solution | Problem, seed: int = 0) -> Explanation:
    """Return changes that would give every robot a verified plan, and why holes are crossed.

    If every plan is verified, no change is needed, and ``print(explain(...))`` says so.

    Each change suffices by itself and belongs to one robot. The problem is solved again with each
    proposed value, for a few seconds in total. For a verified plan that crosses coverage holes on
    its path to a goal, these are listed with the length of the path that stays connected.

    Parameters
    ----------
    result
        Result of :func:`planopt.solve`, or a problem, which is solved first. If that raises a
        `NoPlanError`, changes that would open a path to the goal are returned.
    seed
        Random seed for planning a problem; a solution has its own.

    Examples
    --------
    >>> import planopt
    >>> print(planopt.explain(planopt.load("open_field")))
    Every plan is verified: it keeps all bounds.
    """
    if not isinstance(result, Problem):
        remedy = "give a Problem, or what planopt.solve returned"
        return _explain_solution(part_of("result", result, Solution, remedy))
    ends_s = deadline_s()
    try:
        solution = solve(result, seed=seed)
    except (NoPlanError, InputError) as error:
        # A blocked path can be explained even without measurements.
        found = explain_no_plan(result, seed, ends_s)
        if not found and isinstance(error, InputError):
            raise
        return Explanation(found, _summary(Verdict.NONE, found))
    return _explain_solution(solution)


def _summary(verdict: Verdict, found: Sequence[Relaxation]) -> str:
    if verdict is Verdict.VERIFIED:
        return "Every plan is verified: it keeps all bounds."
    start = "There is no plan" if verdict is Verdict.NONE else "Not every plan is verified"
    if found:
        return f"{start}; each of these changes by itself would help, as far as it is verified:"
    return f"{start}; no single change of a key or obstacle gives a plan."


def _explain_solution(solution: Solution) -> Explanation:
    found: list[Relaxation] = []
    problem, belief = solution.problem, solution.belief
    motions = [planned_motion(problem, plan) for plan in solution.plans]
    ends_s = deadline_s()
    for number, plan in enumerate(solution.plans):
        if plan.verdict is not Verdict.VERIFIED:
            moving = beside(problem, 0, others_of(motions, number))
            case = Case(problem, number, belief.posteriors, plan, moving)
            plan_again = partial(_planned, belief=belief, seed=solution.seed, number=number)
            found += explain_violated(case, Trials(plan_again, ends_s))
    crossed = crossings(problem, solution.plans, belief.posteriors)
    return Explanation((*found, *crossed), _summary(solution.verdict, found))


def _planned(
    problem: Problem,
    *,
    belief: Belief,
    seed: int = 0,
    number: int = 0,
    scenes: Sequence[Scene] | None = None,
) -> Plan | None:
    """Plan a changed problem with all robots; return the plan of one."""
    try:
        return solve_on(problem, belief, seed, scenes).plans[number]
    except NoPlanError:
        return None


@one_blas_thread()
def explain_no_plan(
    problem: Problem, seed: int, ends_s: float | None = None
) -> tuple[Relaxation, ...]:
    """Return changes that would open a path to the goal of a problem without plan.

    With several robots, each one that has no path on its own is considered.
    """
    owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]
    ends_s = deadline_s() if ends_s is None else ends_s
    try:
        belief = prepare(problem, seed).belief
    except InputError:
        # Without measurements nothing can be solved, but blocking obstacles can be named.
        nothing = Trials(lambda _: None, ends_s)
        return tuple(
            one
            for own in owns
            if not is_open(own)
            for one in explain_no_path(own, nothing, is_joined(own, own.constraints.clearance_m))
        )
    found: list[Relaxation] = []
    for own in owns:
        if len(owns) == 1 or _planned(own, belief=belief) is None:
            found += _explain_robot(own, belief, ends_s)
    return tuple(found)


def _explain_robot(problem: Problem, belief: Belief, ends_s: float) -> tuple[Relaxation, ...]:
    """Explain why the only robot of a problem has no path to its goal."""
    trials = Trials(partial(_planned, belief=belief), ends_s)
    if not is_joined(problem, problem.constraints.clearance_m):
        return explain_no_path(problem, trials, joined=False)
    try:
        scene = build_scene(problem)
    except NoPlanError:
        return explain_no_path(problem, trials, joined=True)
    # The chance constraint does not affect the scene, which is reused.
    trials = Trials(partial(_planned, belief=belief, scenes=[scene]), ends_s)
    radio, p_min = problem.stations[0], problem.constraints.p_min
    margins = NodeMargins(scene.road_map, radio.threshold_dbm, p_min)
    margins.refresh(connectivity_law(problem, belief.posteriors))
    first, _ = first_moves(scene.ground, problem, np.asarray(problem.robots[0].start_m))
    return explain_blocked(problem, scene.road_map, first, scene.goal_node, margins, trials)


CONNECTION_PRICE = 1e4
"""Price per metre out of contact at which connection dominates length."""


def crossings(
    problem: Problem, plans: Sequence[Plan], posteriors: Sequence[ChannelPosterior]
) -> tuple[Crossing, ...]:
    """Return the holes that verified plans to goals cross, with the reason, by robot."""
    found = [
        explain_crossing(problem_of_robot(problem, number), posteriors, plan)
        for number, plan in enumerate(plans)
        if plan.verdict is Verdict.VERIFIED
    ]
    return tuple(one for one in found if one is not None)


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return the holes on a robot's path to its goal and the reason; None without holes."""
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min, everywhere)
    margins.refresh(connectivity_law(problem, posteriors))
    price, start = problem.reach.outage_price, plan.positions_m[0]
    cost_m, _ = _cheapest_path(problem, scene, margins, start, price * margins.outage_share)
    _, path_m = _cheapest_path(
        problem, scene, margins, start, np.where(margins.outside, CONNECTION_PRICE, 0.0)
    )
    lengths = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
    outside = margins.at(path_m)[0] < 0.0
    return Crossing(
        plan.robot,
        plan.holes,
        cost_m,
        price,
        float(lengths.sum()),
        float(0.5 * lengths @ (outside[:-1].astype(float) + outside[1:])),
        constraints.p_min,
    )


def _cheapest_path(
    problem: Problem,
    scene: Scene,
    margins: NodeMargins,
    start_m: NDArray[np.float64],
    surcharge: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Return cost and positions (n, 2) of the cheapest path from a position to the goal.

    The cost per metre at each node is one plus its `surcharge` (n,).
    """
    road_map = scene.road_map
    paths = lattice_paths(road_map, scene.goal_node, 1.0 + surcharge)
    nodes, lengths = first_moves(scene.ground, problem, start_m)
    first = int(np.argmin(lengths * (1.0 + surcharge[nodes]) + paths.cost_m[nodes]))
    cost_m = float(lengths[first] * (1.0 + surcharge[nodes[first]]) + paths.cost_m[nodes[first]])
    rest = route_from(road_map, paths, int(nodes[first]), np.inf)
    return cost_m, np.vstack([start_m, road_map.nodes_m[rest]])
