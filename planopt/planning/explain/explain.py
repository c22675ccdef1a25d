"""Explain a problem without verified plan, and plans that cross coverage holes.

If no path leads to the goal, the clearance, an obstacle, steps too long for the lattice, or a hard
bound on connectivity is in the way; each entry is one change of a key that would open a path, tried
by planning again. Plans that are not verified are the subject of
:mod:`planopt.planning.explain.no_verified_plan`. A path that crosses coverage holes is compared
with the one that is out of contact for the fewest metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError, NoPlanError
from planopt.parts import part_of
from planopt.planning.explain.explanation import Case, Crossing, Explanation, Relaxation, towards
from planopt.planning.explain.keys import DIGITS, Key, connection_keys
from planopt.planning.explain.no_verified_plan import explain_no_verified_plan
from planopt.planning.free_space import is_joined, widest_clearance_m
from planopt.planning.given import team_seeds
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Plan, Verdict
from planopt.planning.prepare import prepare
from planopt.planning.proof.predictions import broad_prediction
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.solution import Solution
from planopt.planning.solve import solve, solve_on
from planopt.planning.team.reservations import beside, others_of, planned_motion
from planopt.planning.team.team_step import build_team
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.road_map import RoadMap, shortest_ways, way_from

SolveAgain = Callable[[Problem], Verdict]
"""Solves a changed problem and says what its plan is worth."""


@one_blas_thread()
def explain(asked: Solution | Problem, seed: int = 0) -> Explanation:
    """Return changes that would give every robot a verified plan, and why holes are crossed.

    There are none of a verified plan, which keeps all bounds; ``print(explain(...))`` says so.

    Each change is by itself, and of its robot alone. Problems are solved again with what is
    proposed, which takes some fifty times the plan's own time. For a verified plan the coverage
    holes are told that its way to the goal crosses, and what it would take to keep contact.

    Parameters
    ----------
    asked
        From :func:`planopt.solve`; or a problem, which is solved first. Where that raises a
        `NoPlanError`, what would open a way to the goal is returned.
    seed
        That the problem was planned with; a solution knows its own.

    Examples
    --------
    >>> import planopt
    >>> print(planopt.explain(planopt.load("open_field")))
    Every plan is verified: it keeps all bounds.
    """
    if not isinstance(asked, Problem):
        remedy = "give a Problem, or what planopt.solve returned"
        return _explain_solution(part_of("asked", asked, Solution, remedy))
    try:
        solution = solve(asked, seed=seed)
    except (NoPlanError, InputError) as error:
        # What opens a way can be said without measurements as well.
        found = explain_no_plan(asked, seed)
        if not found and isinstance(error, InputError):
            raise
        return Explanation(found, _summary(Verdict.NONE, found))
    return _explain_solution(solution)


def _summary(verdict: Verdict, found: Sequence[Relaxation]) -> str:
    if verdict is Verdict.VERIFIED:
        return "Every plan is verified: it keeps all bounds."
    said = "There is no plan" if verdict is Verdict.NONE else "Not every plan is verified"
    if found:
        return f"{said}; each of these changes by itself would help, as far as it is verified:"
    return f"{said}; no change of a single key or obstacle that was tried helps."


def _explain_solution(solution: Solution) -> Explanation:
    found: list[Relaxation] = []
    problem = solution.problem
    motions = [planned_motion(problem, plan) for plan in solution.plans]
    for number, plan in enumerate(solution.plans):
        if plan.verdict is Verdict.VERIFIED:
            continue
        moving = beside(problem, 0, others_of(motions, number))
        case = Case(problem, number, solution.belief.posteriors, plan, moving)

        def plan_again(changed: Problem, number: int = number) -> Plan | None:
            return _planned(changed, solution, number)

        found += explain_no_verified_plan(case, plan_again)
    crossed = crossings(problem, solution.plans, solution.belief.posteriors)
    return Explanation((*found, *crossed), _summary(solution.verdict, found))


def _planned(problem: Problem, solution: Solution, number: int) -> Plan | None:
    """Plan a changed problem for one robot; with the others if they keep apart."""
    if problem.task == "reach":
        return _reached(problem, solution.belief, number)
    if problem.constraints.separation_m > 0.0:
        return solve_on(problem, solution.belief, solution.seed).plans[number]
    seeds = team_seeds(problem, solution.seed)
    watch = watch_target(problem, seeds.target)
    watched = aim_of(watch, number, problem.planner.horizon)
    member = build_team(problem, seeds)[number]
    moving = beside(problem, 0, {})
    return member.plan(solution.belief, member.start, watched, None, moving)[0]


@one_blas_thread()
def explain_no_plan(problem: Problem, seed: int) -> tuple[Relaxation, ...]:
    """Return what would open a way to the goal of a problem that has none; each change suffices.

    With several robots, to the goals of those that have no way if they are alone. Parameters are
    those of :func:`explain`.
    """
    try:
        belief = prepare(problem, seed).belief
    except InputError:
        # Without measurements nothing can be solved again; what opens a way can still be said.
        owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]
        shut = [own for own in owns if not _is_open(own)]
        return tuple(one for own in shut for one in explain_no_way(own, lambda _: Verdict.NONE))

    found: list[Relaxation] = []
    for number in range(len(problem.robots)):
        own = problem_of_robot(problem, number)
        if len(problem.robots) == 1 or _reached(own, belief) is None:
            found += _explain_robot(own, belief)
    return tuple(found)


def _explain_robot(problem: Problem, belief: Belief) -> tuple[Relaxation, ...]:
    """Explain why the only robot of a problem has no way to its goal."""
    try:
        scene = build_scene(problem)
    except NoPlanError:
        return explain_no_way(problem, lambda changed: _verdict(_reached(changed, belief)))

    def solve_again(changed: Problem) -> Verdict:
        # No bound on connectivity changes the ground.
        return _verdict(_reached(changed, belief, scenes=(scene,)))

    radio, p_min = problem.stations[0], problem.constraints.p_min
    margins = NodeMargins(scene.road_map, radio.threshold_dbm, p_min)
    margins.refresh(belief.posterior, broad_prediction(problem, belief.posteriors))
    first, _ = first_moves(scene.ground, problem, np.asarray(problem.robots[0].start_m))
    return explain_blocked(problem, scene.road_map, first, scene.goal_node, margins, solve_again)


def _reached(
    problem: Problem, belief: Belief, number: int = 0, scenes: Sequence[Scene] | None = None
) -> Plan | None:
    """Plan a changed problem to its goal, on its ground; None where nothing leads there."""
    try:
        return solve_on(problem, belief, 0, scenes).plans[number]
    except NoPlanError:
        return None


def _verdict(plan: Plan | None) -> Verdict:
    return Verdict.NONE if plan is None else plan.verdict


def _is_open(problem: Problem) -> bool:
    """Return whether obstacles leave the problem's first robot a way to its goal."""
    try:
        build_scene(problem)
    except NoPlanError:
        return False
    return True


BISECTIONS = 12
"""Of the clearance, where the lattice needs more room than there is."""


MOST_OBSTACLES = 60
"""With more, it is not tried which of them could go."""


SHORTER = 0.9


STEPS_TRIED = 20
"""The lattice is made finer by this factor, so many times at most."""


def explain_no_way(problem: Problem, solve_again: SolveAgain) -> tuple[Relaxation, ...]:
    """Return changes that would open a way to the goal, each by itself."""
    found = [_clearance(problem, solve_again)]
    if is_joined(problem, problem.constraints.clearance_m):
        found.append(_step(problem, solve_again))
    else:
        found += _obstacles(problem, solve_again)
    return tuple(relaxation for relaxation in found if relaxation is not None)


def _clearance(problem: Problem, solve_again: SolveAgain) -> Relaxation | None:
    """The largest clearance with which a way is found."""
    widest = widest_clearance_m(problem)
    asked = problem.constraints.clearance_m
    if widest is None:
        return None
    fits = towards(max(widest - 1.1 * CLEARANCE_PAD_M, 0.0), DIGITS, down=True)
    if not _is_open(_with_clearance(problem, fits)):
        low, high = 0.0, fits
        if not _is_open(_with_clearance(problem, low)):
            return None
        for _ in range(BISECTIONS):
            middle = towards(0.5 * (low + high), DIGITS, down=True)
            low, high = (
                (middle, high) if _is_open(_with_clearance(problem, middle)) else (low, middle)
            )
        fits = low
    return Relaxation(
        "constraints.clearance_m",
        "m",
        asked,
        (),
        asked - fits,
        "m",
        fits,
        solve_again(_with_clearance(problem, fits)) is Verdict.VERIFIED,
        problem.robots[0].name,
    )


def _obstacles(problem: Problem, solve_again: SolveAgain) -> list[Relaxation | None]:
    """Every obstacle without which there is a way."""
    obstacles = problem.workspace.obstacles
    if len(obstacles) > MOST_OBSTACLES:
        return []
    found: list[Relaxation | None] = []
    for obstacle in obstacles:
        rest = tuple(other for other in obstacles if other is not obstacle)
        changed = replace(problem, workspace=replace(problem.workspace, obstacles=rest))
        if is_joined(changed, problem.constraints.clearance_m) and _is_open(changed):
            verified = solve_again(changed) is Verdict.VERIFIED
            key = f"world.obstacles ({obstacle.name})"
            name = problem.robots[0].name
            found.append(Relaxation(key, "", None, (), None, "", None, verified, name))
    return found


def _step(problem: Problem, solve_again: SolveAgain) -> Relaxation | None:
    """A shorter step, which makes the lattice fine enough for a way that there is."""
    asked = problem.planner.step_s
    for power in range(1, STEPS_TRIED + 1):
        step_s = towards(asked * SHORTER**power, DIGITS, down=True)
        changed = replace(problem, planner=replace(problem.planner, step_s=step_s))
        try:
            if not _is_open(changed):
                continue
        except InputError:
            return None  # the lattice would have too many nodes
        verified = solve_again(changed) is Verdict.VERIFIED
        name = problem.robots[0].name
        return Relaxation(
            "planner.step_s", "s", asked, (), asked - step_s, "s", step_s, verified, name
        )
    return None


def _with_clearance(problem: Problem, clearance_m: float) -> Problem:
    return replace(problem, constraints=replace(problem.constraints, clearance_m=clearance_m))


EXTRA = (1e-3, 0.02, 0.1, 0.3)
"""Shares by which a bit more than the widest path asks for is tried, one after the other."""


def explain_blocked(
    problem: Problem,
    road_map: RoadMap,
    first: NDArray[np.intp],
    goal: int,
    margins: NodeMargins,
    solve_again: SolveAgain,
) -> tuple[Relaxation, ...]:
    """Return changes that would open a path to the goal, each by itself."""
    threshold = problem.stations[0].threshold_dbm
    chance = connection_probability(margins.mean_db, margins.deviation_db, threshold)
    lacking_db = MARGIN_PAD_DB - widest(road_map, first, goal, margins.margin_db)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    found: list[Relaxation] = []
    for key in connection_keys(problem):
        amount = lacking_db - slack_db
        if key.name == "constraints.p_min":
            amount = key.asked - widest(road_map, first, goal, chance)
        value = _least(key, amount, problem, solve_again)
        if value is not None:
            found.append(_about(problem, key, value))
    [slack] = [key for key in connection_keys(problem) if key.name == "constraints.slack_max_db"]
    if solve_again(_with_priced_bound(problem)) is Verdict.VERIFIED:
        found.append(_about(problem, slack, None))
    return tuple(found)


def widest(
    road_map: RoadMap, first: NDArray[np.intp], goal: int, score: NDArray[np.float64]
) -> float:
    """Return the largest score that all nodes of some path to the goal have."""
    # Shapes: score (n,).
    count = len(score)
    end, move = np.nonzero(road_map.sources < count)
    begin = road_map.sources[end, move]
    least = np.minimum(score[begin], score[end])
    levels = np.unique(score)
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high + 1) // 2
        kept = least >= levels[middle]
        graph = csr_matrix((np.ones(int(kept.sum())), (begin[kept], end[kept])), (count, count))
        _, part = cast("tuple[int, NDArray[np.int32]]", connected_components(graph, directed=False))
        open_ = first[score[first] >= levels[middle]]
        joined = score[goal] >= levels[middle] and bool((part[open_] == part[goal]).any())
        low, high = (middle, high) if joined else (low, middle - 1)
    return float(levels[low])


def _least(key: Key, amount: float, problem: Problem, solve_again: SolveAgain) -> float | None:
    """The value that is looser by an amount, or by little more, with which there is a plan."""
    for extra in EXTRA:
        wanted = amount * (1.0 + extra)
        if not 0.0 < wanted <= key.most:
            return None
        value = key.loosened(wanted)
        if solve_again(key.changed(problem, value)) is Verdict.VERIFIED:
            return value
    return None


def _with_priced_bound(problem: Problem) -> Problem:
    """The problem with a bound that may be missed at a price."""
    rule = replace(problem.constraints.rule, slack_max_db=None)
    return replace(problem, constraints=replace(problem.constraints, rule=rule))


def _about(problem: Problem, key: Key, value: float | None) -> Relaxation:
    return Relaxation(
        key.name, key.unit, key.asked, (), None, "", value, True, problem.robots[0].name
    )


BY_ALL_MEANS = 1e4
"""Price at which contact counts first and length second."""


def crossings(
    problem: Problem, plans: Sequence[Plan], posteriors: Sequence[ChannelPosterior]
) -> tuple[Crossing, ...]:
    """Return what verified plans to goals cross and why, one for each robot that crosses a hole."""
    found = [
        explain_crossing(problem_of_robot(problem, number), posteriors, plan)
        for number, plan in enumerate(plans)
        if plan.verdict is Verdict.VERIFIED
    ]
    return tuple(one for one in found if one is not None)


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return what a robot's way to its goal crosses and why; None where it keeps the bound."""
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min, everywhere)
    margins.refresh(posteriors[0], broad_prediction(problem, posteriors))
    price, start = problem.reach.outage_price, plan.positions_m[0]
    cost_m, _ = _way(problem, scene, margins, start, price * margins.outage_share)
    _, way = _way(problem, scene, margins, start, np.where(margins.outside, BY_ALL_MEANS, 0.0))
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    outside = margins.at(way)[0] < 0.0
    return Crossing(
        plan.robot,
        plan.holes,
        cost_m,
        price,
        float(lengths.sum()),
        float(0.5 * lengths @ (outside[:-1].astype(float) + outside[1:])),
        constraints.p_min,
    )


def _way(
    problem: Problem,
    scene: Scene,
    margins: NodeMargins,
    start_m: NDArray[np.float64],
    surcharge: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Cost and places (n, 2) of the cheapest way from a place to the goal.

    A metre at each node costs one and its `surcharge` (n,).
    """
    road_map = scene.road_map
    ways = shortest_ways(road_map, scene.goal_node, 1.0 + surcharge)
    nodes, lengths = first_moves(scene.ground, problem, start_m)
    first = int(np.argmin(lengths * (1.0 + surcharge[nodes]) + ways.cost_m[nodes]))
    cost_m = float(lengths[first] * (1.0 + surcharge[nodes[first]]) + ways.cost_m[nodes[first]])
    rest = way_from(road_map, ways, int(nodes[first]), np.inf)
    return cost_m, np.vstack([start_m, road_map.nodes_m[rest]])
