"""Changes that would open a way to a goal: clearance, an obstacle, the step, or a hard bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError, NoPlanError
from planopt.planning.explain.explanation import Relaxation, towards
from planopt.planning.explain.keys import DIGITS, Key, connection_keys
from planopt.planning.explain.no_verified_plan import Deadline
from planopt.planning.free_space import is_joined, widest_clearance_m
from planopt.planning.plan import Verdict
from planopt.planning.scene import build_scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB
from planopt.problems.problem import Problem
from planopt.world.road_map import RoadMap

SolveAgain = Callable[[Problem], Verdict]
"""From a changed problem to the verdict of its plan."""


def is_open(problem: Problem) -> bool:
    """Return whether obstacles leave the problem's first robot a way to its goal."""
    try:
        build_scene(problem)
    except NoPlanError:
        return False
    return True


CLEARANCES = 8
"""Bisections of the clearance, where the lattice needs more room than there is."""

MOST_OBSTACLES = 60
"""With more, it is not tried which of them could go."""

SHORTER, STEPS_TRIED = 0.9, 20
"""The lattice is made finer by this factor, so many times at most."""


def explain_no_way(
    problem: Problem, solve_again: SolveAgain, deadline: Deadline
) -> tuple[Relaxation, ...]:
    """Return changes that would open a way to the goal, each by itself."""
    found = [_clearance(problem, solve_again, deadline)]
    if is_joined(problem, problem.constraints.clearance_m):
        found.append(_step(problem, solve_again, deadline))
    else:
        found += _obstacles(problem, solve_again, deadline)
    return tuple(relaxation for relaxation in found if relaxation is not None)


def _clearance(problem: Problem, solve_again: SolveAgain, deadline: Deadline) -> Relaxation | None:
    """The largest clearance with which a way is found."""

    def changed(value: float) -> Problem:
        return replace(problem, constraints=replace(problem.constraints, clearance_m=value))

    asked, widest = problem.constraints.clearance_m, widest_clearance_m(problem)
    if widest is None:
        return None
    fits = towards(max(widest - 1.1 * CLEARANCE_PAD_M, 0.0), DIGITS, down=True)
    if not is_open(changed(fits)):
        low, high = 0.0, fits
        if deadline.over or not is_open(changed(low)):
            return None
        for _ in range(CLEARANCES):
            if deadline.over:
                break
            middle = towards(0.5 * (low + high), DIGITS, down=True)
            low, high = (middle, high) if is_open(changed(middle)) else (low, middle)
        fits = low
    verified = solve_again(changed(fits)) is Verdict.VERIFIED
    return _opened(problem, "constraints.clearance_m", "m", asked, fits, verified)


def _obstacles(
    problem: Problem, solve_again: SolveAgain, deadline: Deadline
) -> list[Relaxation | None]:
    """Every obstacle without which there is a way."""
    obstacles = problem.workspace.obstacles
    found: list[Relaxation | None] = []
    for obstacle in obstacles if len(obstacles) <= MOST_OBSTACLES else ():
        if deadline.over or not is_joined(problem, problem.constraints.clearance_m, obstacle):
            continue
        rest = tuple(other for other in obstacles if other is not obstacle)
        changed = replace(problem, workspace=replace(problem.workspace, obstacles=rest))
        verdict = solve_again(changed)
        if verdict is not Verdict.NONE or is_open(changed):
            key, verified = f"world.obstacles ({obstacle.name})", verdict is Verdict.VERIFIED
            found.append(_opened(problem, key, "", None, None, verified))
    return found


def _step(problem: Problem, solve_again: SolveAgain, deadline: Deadline) -> Relaxation | None:
    """A shorter step, which makes the lattice fine enough for a way that there is."""
    asked = problem.planner.step_s
    for power in range(1, STEPS_TRIED + 1):
        step_s = towards(asked * SHORTER**power, DIGITS, down=True)
        changed = replace(problem, planner=replace(problem.planner, step_s=step_s))
        try:
            if deadline.over or not is_open(changed):
                continue
        except InputError:
            return None  # the lattice would have too many nodes
        verified = solve_again(changed) is Verdict.VERIFIED
        return _opened(problem, "planner.step_s", "s", asked, step_s, verified)
    return None


def _opened(
    problem: Problem,
    key: str,
    unit: str,
    asked: float | None,
    value: float | None,
    verified: bool,
) -> Relaxation:
    """Return the entry of a key that opens a way."""
    short = None if asked is None or value is None else asked - value
    return Relaxation(key, unit, asked, (), short, unit, value, verified, problem.robots[0].name)


EXTRA = (1e-3, 0.02, 0.2)
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
