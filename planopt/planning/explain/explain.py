"""Explanation of problems without a verified plan, and of plans that cross coverage holes.

Changes of clearance, obstacles, time step or chance constraint may open a path to a goal.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import process_time

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.kriging import connection_probability
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.errors import InputError, NoPlanError
from planopt.parts import part_of
from planopt.planning.certificate import Crossing, Explanation, Relaxation
from planopt.planning.explain.changes import (
    DIGITS,
    EXPLAINED_S,
    Case,
    Key,
    Trials,
    bisected,
    connection_keys,
    constraint_key,
    explain_violated,
    rounded,
    without,
)
from planopt.planning.free_space import is_joined
from planopt.planning.initial_data import prepare
from planopt.planning.loop.results import Solution
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.rule import connectivity_law
from planopt.planning.reservations import discs_to_avoid, others_of, planned_motion
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.solve import solve, solve_on
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.lattice import RoadMap, lattice_paths, route_from


@one_blas_thread()
def explain(result: Solution | Problem, seed: int = 0) -> Explanation:
    """Return changes that would give every robot a verified plan, and reasons for crossed holes.

    If every plan is verified, no change is needed, and ``print(explain(...))`` says so.

    Each change suffices by itself and belongs to one robot. The problem is solved again with each
    proposed value, for a few seconds in total. If a verified plan to a goal crosses coverage holes,
    these are listed with the length of the path that stays connected.

    Parameters
    ----------
    result
        Result of :func:`planopt.solve`, or a problem, which is solved first. If no plan exists, the
        result lists changes that would open a path to the goal.
    seed
        Random seed for planning a problem; a solution has its own.

    Examples
    --------
    >>> import planopt
    >>> print(planopt.explain(planopt.load("open_field")))
    Every plan is verified: it keeps all bounds.
    """
    if not isinstance(result, Problem):
        remedy = "give a Problem, or a result of planopt.solve"
        return _explain_solution(part_of("result", result, Solution, remedy))
    ends_s = process_time() + EXPLAINED_S
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
    ends_s = process_time() + EXPLAINED_S
    for number, plan in enumerate(solution.plans):
        if plan.verdict is not Verdict.VERIFIED:
            moving = discs_to_avoid(problem, 0, others_of(motions, number))
            case = Case(problem, number, belief.posteriors, plan, moving)
            plan_again = partial(_planned, belief=belief, seed=solution.seed, number=number)
            found += explain_violated(case, Trials(plan_again, ends_s))
    crossed = [
        explain_crossing(problem_of_robot(problem, number), belief.posteriors, plan)
        for number, plan in enumerate(solution.plans)
        if plan.verdict is Verdict.VERIFIED
    ]
    entries = (*found, *(one for one in crossed if one is not None))
    return Explanation(entries, _summary(solution.verdict, found))


def _planned(
    problem: Problem,
    *,
    belief: Belief,
    seed: int = 0,
    number: int = 0,
    scenes: Sequence[Scene] | None = None,
) -> Plan | None:
    """Return the plan of robot `number` after all robots have planned; None without a plan."""
    try:
        return solve_on(problem, belief, seed, scenes).plans[number]
    except NoPlanError:
        return None


@one_blas_thread()
def explain_no_plan(
    problem: Problem, seed: int, ends_s: float | None = None
) -> tuple[Relaxation, ...]:
    """Return changes that would open a path to the goal in a problem without a plan."""
    # With several robots, those that have no path even alone are explained.
    ends_s = process_time() + EXPLAINED_S if ends_s is None else ends_s
    try:
        belief = prepare(problem, seed).belief
    except InputError:
        belief = None  # Nothing can be solved, but blocking obstacles can be named.
    found: list[Relaxation] = []
    for number in range(len(problem.robots)):
        own = problem_of_robot(problem, number)
        joined = is_joined(own, own.constraints.clearance_m)
        scene = open_scene(own) if joined else None
        if belief is None:
            if scene is None:
                found += explain_no_path(own, Trials(lambda _: None, ends_s), joined)
            continue
        if len(problem.robots) > 1 and _planned(own, belief=belief) is not None:
            continue
        if scene is None:
            trials = Trials(partial(_planned, belief=belief), ends_s)
            found += explain_no_path(own, trials, joined)
        else:
            # The chance constraint does not affect the scene, which is reused.
            trials = Trials(partial(_planned, belief=belief, scenes=[scene]), ends_s)
            found += explain_blocked(own, scene, belief.posteriors, trials)
    return tuple(found)


CONNECTION_PRICE = 1e4
"""Price of a metre out of contact that makes connection more important than path length."""


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return the coverage holes that a robot's path crosses, with reasons; None without holes."""
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min, everywhere)
    margins.refresh(connectivity_law(problem, posteriors))
    price, start = problem.reach.outage_price, plan.positions_m[0]
    cost_m, _ = _cheapest_path(problem, scene, start, price * margins.outage_share)
    _, path_m = _cheapest_path(
        problem, scene, start, np.where(margins.outside, CONNECTION_PRICE, 0.0)
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
    problem: Problem, scene: Scene, start_m: Floats, surcharge: Floats
) -> tuple[float, Floats]:
    """Return cost and positions (n, 2) of the cheapest path from a position to the goal."""
    # The cost per metre at each node is one plus its `surcharge` (n,).
    road_map = scene.road_map
    paths = lattice_paths(road_map, scene.goal_node, 1.0 + surcharge)
    nodes, lengths = first_moves(scene, problem, start_m)
    first = int(np.argmin(lengths * (1.0 + surcharge[nodes]) + paths.cost_m[nodes]))
    cost_m = float(lengths[first] * (1.0 + surcharge[nodes[first]]) + paths.cost_m[nodes[first]])
    rest = route_from(road_map, paths, int(nodes[first]), np.inf)
    return cost_m, np.vstack([start_m, road_map.nodes_m[rest]])


BISECTIONS, CLEARANCES = 16, 8
"""Numbers of bisections of the clearance in free space, and on the lattice."""
MOST_OBSTACLES = 60  # Number of obstacles up to which the removal of each is tried
SHORTER, STEPS_TESTED = 0.9, 20
"""Factor on the time step, and thus the lattice spacing, per refinement; number of refinements."""


def open_scene(problem: Problem) -> Scene | None:
    """Return the geometry of a problem's first robot; None if obstacles leave it no path."""
    try:
        return build_scene(problem)
    except NoPlanError:
        return None


def explain_no_path(problem: Problem, trials: Trials, joined: bool) -> tuple[Relaxation, ...]:
    """Return changes, each of which alone would open a path around obstacles to the goal."""
    # If free space connects start and goal (`joined`), only the lattice is too coarse.
    if joined:
        clearance_m = problem.constraints.clearance_m
        return (*_clearance(problem, trials, clearance_m), *_step(problem, trials))
    widest_m = widest_clearance_m(problem, lambda: trials.are_over)
    found = [] if widest_m is None else _clearance(problem, trials, widest_m)
    return (*found, *_obstacles(problem, trials))


def widest_clearance_m(
    problem: Problem, is_over: Callable[[], bool] = lambda: False
) -> float | None:
    """Return the largest clearance for which a path to the goal exists, or None."""
    if not is_joined(problem, 0.0):
        return None

    def joins(value: float) -> bool:
        return not is_over() and is_joined(problem, value)

    return bisected(joins, problem.constraints.clearance_m, 0.0, BISECTIONS)


def _clearance(problem: Problem, trials: Trials, widest: float) -> list[Relaxation]:
    """Return a relaxation to the largest clearance, up to `widest`, for which a path exists."""
    key = constraint_key(problem, "clearance_m", "m", 0.0)
    high = rounded(max(widest - 1.1 * CLEARANCE_PAD_M, 0.0), DIGITS, down=True)

    def opens(value: float) -> bool:
        return not trials.are_over and open_scene(key.changed(problem, value)) is not None

    if open_scene(key.changed(problem, high)) is not None:
        return [_opened(problem, trials, key, high)]
    if not opens(0.0):
        return []
    value = bisected(opens, high, 0.0, CLEARANCES)
    return [_opened(problem, trials, key, rounded(value, DIGITS, down=True))]


def _step(problem: Problem, trials: Trials) -> list[Relaxation]:
    """Return a relaxation to a time step that is short enough for a path on the lattice."""
    key = Key("planner.step_s", "s", problem.planner.step_s, 0.0)
    for power in range(1, STEPS_TESTED + 1):
        step_s = rounded(key.value * SHORTER**power, DIGITS, down=True)
        try:
            if not trials.are_over and open_scene(key.changed(problem, step_s)) is not None:
                return [_opened(problem, trials, key, step_s)]
        except InputError:
            break  # the lattice would have too many nodes
    return []


def _opened(problem: Problem, trials: Trials, key: Key, value: float) -> Relaxation:
    verified = trials.is_verified(key.changed(problem, value))
    robot, shortfall = problem.robots[0].name, key.value - value
    return key.relaxation(robot, (), shortfall, key.unit, value, verified=verified)


def _obstacles(problem: Problem, trials: Trials) -> list[Relaxation]:
    """Return a relaxation for each obstacle whose removal opens a path."""
    clearance_m, found = problem.constraints.clearance_m, list[Relaxation]()
    obstacles = problem.workspace.obstacles
    for obstacle in obstacles if len(obstacles) <= MOST_OBSTACLES else ():
        if trials.are_over or not is_joined(problem, clearance_m, obstacle):
            continue
        removed, changed = without(problem, "obstacles", obstacle)
        verified = trials.is_verified(changed)
        if verified or open_scene(changed) is not None:
            robot = problem.robots[0].name
            found.append(removed.relaxation(robot, (), None, "", None, verified=verified))
    return found


def explain_blocked(
    problem: Problem, scene: Scene, posteriors: Sequence[ChannelPosterior], trials: Trials
) -> tuple[Relaxation, ...]:
    """Return changes of a hard chance constraint that would open a path to the goal."""
    threshold, robot = problem.stations[0].threshold_dbm, problem.robots[0].name
    road_map, goal = scene.road_map, scene.goal_node
    margins = NodeMargins(road_map, threshold, problem.constraints.p_min)
    margins.refresh(connectivity_law(problem, posteriors))
    first, _ = first_moves(scene, problem, np.asarray(problem.robots[0].start_m))
    chance = connection_probability(margins.mean_db, margins.deviation_db, threshold)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    lacking_db = MARGIN_PAD_DB - slack_db - _widest(road_map, first, goal, margins.margin_db)
    found: list[Relaxation] = []
    keys = connection_keys(problem)
    for key in keys:
        least = lacking_db
        if key.name == "constraints.p_min":
            least = key.value - _widest(road_map, first, goal, chance)
        value = trials.first(problem, key, least) if 0.0 < least <= key.most else None
        if value is not None:
            found.append(key.relaxation(robot, (), None, "", value))
    # Without slack_max_db, the constraint may be violated at a price.
    rule = replace(problem.constraints.rule, slack_max_db=None)
    free = replace(problem, constraints=replace(problem.constraints, rule=rule))
    if all(one.constraint != keys[-1].name for one in found) and trials.is_verified(free):
        found.append(keys[-1].relaxation(robot, (), None, "", None))
    return tuple(found)


def _widest(road_map: RoadMap, first: Indices, goal: int, score: Floats) -> float:
    """Return the maximum, over all paths to the goal, of the minimum score along the path."""
    # Shapes: score (n,).
    levels = np.unique(score)
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high + 1) // 2
        kept = score >= levels[middle]
        cost_m = lattice_paths(road_map, goal, np.where(kept, 1.0, np.inf)).cost_m
        joined = bool((np.isfinite(cost_m[first]) & kept[first]).any()) and bool(kept[goal])
        low, high = (middle, high) if joined else (low, middle - 1)
    return float(levels[low])
