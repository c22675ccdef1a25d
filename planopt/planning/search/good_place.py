"""The last start: straight to a place that meets the bound, where the verifier says there is one.

A lattice is slower than the robot in most directions and has no nodes between its nodes, so that it
may miss a place that the robot reaches just in time. Where the verifier objects to that, such a
place is looked for here, and the shortest way there taken; the robot waits there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.judge import Candidate, Judge
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.search.taut_way import retime
from planopt.planning.tolerances import CLEARANCE_PAD_M, MARGIN_PAD_DB, STEP_PAD_M
from planopt.world.clearance import clearance_m, inside_bounds, is_clear, segments_clear
from planopt.world.lattice import REACH_TOLERANCE_M
from planopt.world.shortest_paths import ShortestPaths, path_lengths_m, shortest_paths, turns_m

FINE_NODES, COARSE_NODES = 12, 4
"""Places a step that are looked at: up to `FINE_STEPS` steps, and beyond."""
FINE_STEPS = 4
MEASURED = 400
"""Ways are measured to so many of the best places."""
KEPT = 24
"""Places about which is looked more finely, the best within reach."""
STEP_PLACES = 12
"""Places a step along a way at which steps may end."""
REFINEMENTS = 3
"""How often, each time at a quarter of the spacing."""


def ways_to_good_place(judge: Judge, tried: Sequence[Candidate]) -> list[NDArray[np.float64]]:
    """Paths (N, 2) to a place within reach by the first step that could meet the bound."""
    problem, index = judge.problem, judge.index
    sound = [candidate for candidate in tried if candidate.sound]
    step = min((step for candidate in sound for step in candidate.avoidable), default=None)
    if step is None:
        return []
    length = problem.step_length_m - STEP_PAD_M
    clear = problem.constraints.clearance_m + CLEARANCE_PAD_M
    bounds = problem.workspace.bounds_m
    ways = shortest_paths(index, bounds, judge.position_m, clear, step * length, inner=False)
    place = _good_place(judge, ways, step, clear)
    turns = None if place is None else turns_m(ways, place)
    if turns is None:
        return []
    horizon = problem.planner.horizon
    driven = _padded(_in_fewest_steps(judge, turns, length), horizon)
    if len(turns) == 1:
        return [driven]
    cutting = retime(judge.position_m, _padded(turns, max(horizon, len(turns))), turns[:0], length)
    return [driven, cutting[:horizon]]


def _good_place(
    judge: Judge, ways: ShortestPaths, step: int, clear_m: float
) -> NDArray[np.float64] | None:
    """The nearest place (2,) that meets the bound, by way; None if there is none in reach.

    Where none meets it with what is planned for, the best of those that meet it at all.
    """
    nodes = FINE_NODES if step <= FINE_STEPS else COARSE_NODES
    spacing = judge.problem.step_length_m / nodes
    offsets = spacing * np.arange(-nodes * step, nodes * step + 1)
    places = judge.position_m + np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    fractions = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    found: list[NDArray[np.float64]] = []
    for _ in range(REFINEMENTS + 1):
        places, margins, length = _reached(judge, ways, places, clear_m)
        if not len(places):
            break
        found.append(np.column_stack([places, margins, length]))
        places = (places[:KEPT, None] + spacing * around).reshape(-1, 2)
        spacing /= 4.0
    if not found:
        return None
    x_y, margins, length = np.split(np.concatenate(found), [2, 3], axis=1)
    best = int(_promise(margins[:, 0], length[:, 0])[0])
    return x_y[best] if margins[best, 0] >= 0.0 else None


def _reached(
    judge: Judge, ways: ShortestPaths, places_m: NDArray[np.float64], clear_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return which places (n, 2) a way leads to, their margins and lengths, best first."""
    away = np.linalg.norm(places_m - ways.start_m, axis=1)
    places = places_m[(away <= ways.radius_m) & inside_bounds(judge.problem.workspace, places_m)]
    places = places[is_clear(clearance_m(judge.index, places), clear_m)]
    if not len(places):
        return places, np.zeros(0), np.zeros(0)
    margins = judge.margins_db(search_prediction(judge.context.law, places))
    tried = _promise(margins, np.linalg.norm(places - ways.start_m, axis=1))[:MEASURED]
    length = path_lengths_m(ways, places[tried])
    tried, length = tried[np.isfinite(length)], length[np.isfinite(length)]
    order = _promise(margins[tried], length)
    return places[tried[order]], margins[tried[order]], length[order]


def _promise(margins_db: NDArray[np.float64], length_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the order of places: the nearest that meets the bound, else the best."""
    meets = margins_db >= MARGIN_PAD_DB
    return np.lexsort((np.where(meets, length_m, -margins_db), ~meets))


def _in_fewest_steps(
    judge: Judge, turns_m: NDArray[np.float64], length_m: float
) -> NDArray[np.float64]:
    """Places (n, 2) after each step of a way, in as few straight clear steps as it can be driven.

    Steps end at places along the way, at its turns, and where its legs would cross: a way round a
    corner turns often, and one step end beside it is enough.
    """
    way = np.vstack([judge.position_m, turns_m])
    driven = np.concatenate([[0.0], np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum()])
    between = np.arange(0.0, driven[-1], length_m / STEP_PLACES)
    at = np.unique(np.concatenate([driven, between]))
    places = np.stack([np.interp(at, driven, way[:, axis]) for axis in (0, 1)], axis=1)
    beside, beside_at = _crossings(way, driven, length_m)
    order = np.argsort(np.concatenate([at, beside_at]), kind="stable")
    places = np.concatenate([places, beside])[order]
    steps = np.full(len(places), np.inf)
    steps[0] = 0.0
    came = np.zeros(len(places), dtype=np.intp)
    for here in range(len(places) - 1):
        away = np.linalg.norm(places - places[here], axis=1)
        there = np.flatnonzero((away <= length_m + REACH_TOLERANCE_M) & (steps > steps[here] + 1.0))
        there = there[there > here]
        begin = np.broadcast_to(places[here], (len(there), 2))
        wanted = judge.problem.constraints.clearance_m
        there = there[segments_clear(judge.index, begin, places[there], wanted)]
        steps[there], came[there] = steps[here] + 1.0, here
    path = [len(places) - 1]
    while came[path[-1]] > 0:
        path.append(int(came[path[-1]]))
    return places[path[::-1]]


def _crossings(
    way_m: NDArray[np.float64], driven_m: NDArray[np.float64], length_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where a leg meets a later one, driven back: places (n, 2), how far along (n,)."""
    legs = np.diff(way_m, axis=0)
    places, along = [np.zeros((0, 2))], [np.zeros(0)]
    for one in range(len(legs)):
        for other in range(one + 2, len(legs)):
            if driven_m[other] - driven_m[one + 1] > length_m:
                break
            cross = legs[one, 0] * legs[other, 1] - legs[one, 1] * legs[other, 0]
            gap = way_m[other] - way_m[one + 1]
            if abs(cross) < 1e-9 * np.linalg.norm(legs[one]) * np.linalg.norm(legs[other]):
                continue
            on = (gap[0] * legs[other, 1] - gap[1] * legs[other, 0]) / cross
            back = (gap[0] * legs[one, 1] - gap[1] * legs[one, 0]) / cross
            if on > 0.0 > back:
                places.append((way_m[one + 1] + on * legs[one])[None])
                along.append(np.array([0.5 * (driven_m[one + 1] + driven_m[other])]))
    return np.concatenate(places), np.concatenate(along)


def _padded(path_m: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The first `count` places of a path (n, 2), its last repeated where it has fewer."""
    return path_m[np.minimum(np.arange(count), len(path_m) - 1)]
