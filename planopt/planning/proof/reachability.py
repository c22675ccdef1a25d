"""Whether the connectivity bound can be met within reach: the verifier's own search.

The places searched contain every place that the robot could reach by a step (a disc about it, cut
to the free part connected with it; where that has a good place, the ways round the obstacles are
measured too), so a negative best margin says that the bound cannot be met there. The search is as
good as its grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.planning.proof.detours import Places, best_by_ways
from planopt.planning.proof.grid import grid_of, parts_of
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear

FINE_NODES, COARSE_NODES = 12, 4
"""Grid nodes a step of the search within reach: up to `FINE_STEPS` steps, and beyond."""
FINE_STEPS = 4
REFINED_STEPS = 12
"""How many steps are refined, the first ones; a later one is at least as good as these."""
REFINED_NODES = 24
"""How many of the best nodes each refinement looks around."""
REFINEMENTS = 2
"""How often the grid is refined, each time to a quarter of the spacing."""

MayReach = Callable[[NDArray[np.float64], int, float], NDArray[np.bool_]]
"""Whether a robot may be at places (n, 2) after so many steps, or so many metres from there; never
False where it may."""


def best_margins_by_step(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],
    step_length_m: float,
    steps: NDArray[np.intp],
    clearance: float,
    may_reach: MayReach | None = None,
) -> tuple[float, ...]:
    """Largest connectivity margin (dB) over the places within reach by each of some steps.

    One grid serves all steps, so that more time never gives a worse place, unless the robot cannot
    wait there.

    Parameters
    ----------
    index, bounds_m
        The obstacles and the workspace.
    margin_db
        Positions (n, 2) to margins (n,).
    start_m
        ``(2,)`` where the robot is.
    step_length_m
        How far it gets in a step.
    steps
        ``(k,)`` increasing, the first step being 1.
    clearance
        The clearance that it must keep, in metres.
    may_reach
        Where a robot may be that cannot turn or stop at will; None for any other.
    """
    radius = float(steps[-1]) * step_length_m
    spacing = step_length_m / (FINE_NODES if steps[-1] <= FINE_STEPS else COARSE_NODES)
    grid = grid_of(bounds_m, start_m, spacing, radius)
    from_start = np.linalg.norm(grid - start_m, axis=-1)
    # A path may pass between nodes that are all a little too near to an obstacle, not through one.
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(from_start.shape)
    passable = (away > 0.0) & (away >= clearance - spacing)
    passable |= from_start == 0.0
    parts = parts_of(passable)
    reachable = (parts == parts[from_start == 0.0]) & (from_start <= radius)
    order = np.argsort(from_start[reachable])
    places, distance = grid[reachable][order], from_start[reachable][order]
    margins = margin_db(places)
    best: list[float] = []
    looked: list[Places] = [(places, margins)]
    for k, step in enumerate(steps):
        reach = float(step) * step_length_m
        reached = _reached(start_m, reach, int(step), may_reach)
        within = slice(0, int(np.searchsorted(distance, reach, side="right")))
        if may_reach is not None:
            within = reached(places)
            if not within.any():
                # What it may reach lies between the nodes.
                within = (distance <= reach) & may_reach(places, int(step), spacing)
        here = float(np.max(margins[within], initial=-np.inf))
        if here < 0.0 and k < REFINED_STEPS:
            top = places[within][np.argsort(-margins[within])[:REFINED_NODES]]
            found = _refined(index, bounds_m, margin_db, reached, clearance, top, spacing)
            looked.extend(found)
            here = max([here, *(float(values.max()) for _, values in found)])
        best.append(max(here, best[-1]) if best and may_reach is None else here)
    if best[-1] < 0.0 or may_reach is not None or not index.obstacles:
        return tuple(best)
    reaches = step_length_m * steps.astype(np.float64)
    return best_by_ways(index, bounds_m, margin_db, start_m, clearance, reaches, looked, spacing)


def _reached(
    start_m: NDArray[np.float64], radius_m: float, step: int, may_reach: MayReach | None
) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
    """Whether places (n, 2) are within reach."""

    def reached(places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        near = np.linalg.norm(places_m - start_m, axis=1) <= radius_m
        return near if may_reach is None else near & may_reach(places_m, step, 0.0)

    return reached


def _refined(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    reached: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
    clearance: float,
    top_m: NDArray[np.float64],
    spacing_m: float,
) -> list[Places]:
    """Places near the best nodes, on grids that grow finer."""
    found: list[Places] = []
    fractions = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    lower, upper = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    for _ in range(REFINEMENTS):
        places = (top_m[:, None] + spacing_m * around).reshape(-1, 2)
        places = places[reached(places)]
        places = places[((places >= lower) & (places <= upper)).all(axis=1)]
        places = places[is_clear(clearance_m(index, places), clearance)]
        if len(places) == 0:
            break
        margins = margin_db(places)
        found.append((places, margins))
        top_m = places[np.argsort(-margins)[:REFINED_NODES]]
        spacing_m /= 4.0
    return found
