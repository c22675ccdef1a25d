"""Changes that would open a path to a goal: clearance, obstacle, time step, chance constraint."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError, NoPlanError
from planopt.planning.explain.changes import (
    DIGITS,
    Key,
    Trials,
    connection_keys,
    constraint_key,
    rounded,
)
from planopt.planning.explanation import Relaxation
from planopt.planning.free_space import is_joined, widest_clearance_m
from planopt.planning.scene import build_scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB
from planopt.problems.problem import Problem
from planopt.world.lattice import RoadMap

CLEARANCES = 8
"""Number of bisections of the clearance if the lattice misses a narrow gap."""

MOST_OBSTACLES = 60
"""Maximum number of obstacles up to which removing each one is tried."""

SHORTER, STEPS_TRIED = 0.9, 20
"""Refinement factor of the time step, and with it the lattice, and number of refinements."""


def is_open(problem: Problem) -> bool:
    """Return whether obstacles leave the problem's first robot a path to its goal."""
    try:
        build_scene(problem)
    except NoPlanError:
        return False
    return True


def explain_no_path(problem: Problem, trials: Trials, joined: bool) -> tuple[Relaxation, ...]:
    """Return changes, each of which alone would open a path to the goal.

    If start and goal are connected in free space (`joined`), only the lattice is too coarse.
    """
    if joined:
        clearance_m = problem.constraints.clearance_m
        return (*_clearance(problem, trials, clearance_m), *_step(problem, trials))
    widest_m = widest_clearance_m(problem, lambda: trials.are_over)
    found = [] if widest_m is None else _clearance(problem, trials, widest_m)
    return (*found, *_obstacles(problem, trials))


def _clearance(problem: Problem, trials: Trials, widest: float) -> list[Relaxation]:
    """Propose the largest clearance, up to `widest`, for which a path is found."""
    key = constraint_key(problem, "clearance_m", "m", 0.0)
    low, high = 0.0, rounded(max(widest - 1.1 * CLEARANCE_PAD_M, 0.0), DIGITS, down=True)
    if is_open(key.changed(problem, high)):
        return [_opened(problem, trials, key, high)]
    if trials.are_over or not is_open(key.changed(problem, low)):
        return []
    for _ in range(CLEARANCES):
        if trials.are_over:
            break
        middle = rounded(0.5 * (low + high), DIGITS, down=True)
        is_wider = is_open(key.changed(problem, middle))
        low, high = (middle, high) if is_wider else (low, middle)
    return [_opened(problem, trials, key, low)]


def _step(problem: Problem, trials: Trials) -> list[Relaxation]:
    """Propose a shorter time step, which makes the lattice fine enough to find the path."""
    key = Key("planner.step_s", "s", problem.planner.step_s, 0.0)
    for power in range(1, STEPS_TRIED + 1):
        step_s = rounded(key.value * SHORTER**power, DIGITS, down=True)
        try:
            if not trials.are_over and is_open(key.changed(problem, step_s)):
                return [_opened(problem, trials, key, step_s)]
        except InputError:
            break  # the lattice would have too many nodes
    return []


def _opened(problem: Problem, trials: Trials, key: Key, value: float) -> Relaxation:
    verified = trials.is_verified(key.changed(problem, value))
    robot, shortfall = problem.robots[0].name, key.value - value
    return key.relaxation(robot, value, (), shortfall, key.unit, verified=verified)


def _obstacles(problem: Problem, trials: Trials) -> list[Relaxation]:
    """Return every obstacle whose removal opens a path."""
    obstacles = problem.workspace.obstacles
    found: list[Relaxation] = []
    for obstacle in obstacles if len(obstacles) <= MOST_OBSTACLES else ():
        if trials.are_over or not is_joined(problem, problem.constraints.clearance_m, obstacle):
            continue
        rest = tuple(other for other in obstacles if other is not obstacle)
        changed = replace(problem, workspace=replace(problem.workspace, obstacles=rest))
        verified = trials.is_verified(changed)
        if verified or is_open(changed):
            name, robot = f"world.obstacles ({obstacle.name})", problem.robots[0].name
            found.append(Relaxation(name, "", None, (), None, "", None, verified, robot))
    return found


def explain_blocked(
    problem: Problem,
    road_map: RoadMap,
    first: NDArray[np.intp],  # (k,) nodes that the robot can reach first
    goal: int,  # node
    margins: NodeMargins,
    trials: Trials,
) -> tuple[Relaxation, ...]:
    """Return changes of a hard chance constraint that would open a path to the goal."""
    threshold, robot = problem.stations[0].threshold_dbm, problem.robots[0].name
    chance = connection_probability(margins.mean_db, margins.deviation_db, threshold)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    lacking_db = MARGIN_PAD_DB - slack_db - widest(road_map, first, goal, margins.margin_db)
    found: list[Relaxation] = []
    keys = connection_keys(problem)
    for key in keys:
        least = lacking_db
        if key.name == "constraints.p_min":
            least = key.value - widest(road_map, first, goal, chance)
        value = trials.first(problem, key, least) if 0.0 < least <= key.most else None
        if value is not None:
            found.append(key.relaxation(robot, value))
    # Without slack_max_db, the constraint may be violated at a price.
    rule = replace(problem.constraints.rule, slack_max_db=None)
    if trials.is_verified(replace(problem, constraints=replace(problem.constraints, rule=rule))):
        found.append(keys[-1].relaxation(robot, None))
    return tuple(found)


def widest(
    road_map: RoadMap,
    first: NDArray[np.intp],
    goal: int,
    score: NDArray[np.float64],  # (n,)
) -> float:
    """Return the maximum over paths to the goal of the minimum score along the path."""
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
