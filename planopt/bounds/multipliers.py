# pyright: basic
"""Multipliers for :mod:`planopt.bounds.tube` from the optimality conditions of a path.

At a local optimum the gradient of stage k is ``m_k - m_{k+1}`` minus those of active chance and
obstacle constraints (solved by least squares). Inaccurate multipliers only loosen the bound. The
tube uses those of the moves only, since its cells end at p_min (equation 9.10).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from time import monotonic
from typing import Any

import numpy as np
import shapely
from scipy.optimize import Bounds, minimize, nnls

from planopt.arrays import Floats, Mask
from planopt.bounds.bound import Design
from planopt.bounds.stages import repeated
from planopt.bounds.tube import (
    FIRST_SHARE,
    KeepOut,
    StageProblem,
    divided,
    evaluated,
    first_cells,
    halved,
    through_bounds,
)
from planopt.objectives.upper_bounds import Discs, Field, Measured

FULL_STEP = 0.99
"""Step length, relative to the longest step, that counts as full; solvers stop short of it."""
LEFT_OUT = 1e-3
"""Weight of stages whose gradient is not determined: at kinks, and next to obstacles."""
MOST_ITERATIONS = 100  # Maximum number of iterations of a local search
ROUNDED = 1e-3  # Smoothing width of step lengths in a local search, relative to the longest step
APART_M = 5e-4
"""Distance that a local search adds to the radius of discs, as its steps are shortened later."""
AT_KINK_M = 0.02  # Distance from a measurement's position at which the gradient is not determined
AT_P_MIN = 0.02  # Surplus of the probability of connection up to which p_min may count as active

MOST_ROUNDS, ROUNDS_OF_PART, ROUNDS_PER_TRIAL = 25, 8, 4
"""Rounds of the search for a design of all paths, of a part of them, and between other shares."""
WHOLE_SHARE, WHOLE_S = 0.8, 4.0  # Largest share and length of the search before the first cut
FIRST_SHARES = 0.01, 0.5
"""First assumed information, in units of the reference's: of the map, and of the path loss."""


def stage_rewards(problem: StageProblem, path_m: Floats) -> tuple[Floats, Floats, Field]:
    """Return rewards (N,) of a path's stages, their gradients (N, 2), and predicted quantities."""
    field = Field(Discs(path_m, 0.0), problem.makers)
    each = [problem.reward(k, field.at(np.array([k]))) for k in range(problem.steps)]
    values = np.concatenate([reward.value for reward in each])
    return values, np.vstack([reward.slope for reward in each]), field


def local_optimum(problem: StageProblem, path_m: Floats, surplus: float = 0.0) -> Floats:
    """Return a nearly optimal path (N, 2) that ignores obstacles; `surplus` is added to p_min.

    Positions of `path_m` at which the connection is known stay.
    """
    shape, scale = path_m.shape, 1.0 / problem.step_m**2
    away_m = np.linalg.norm(path_m[:, None] - problem.sure_m, axis=2).min(axis=1, initial=np.inf)
    is_held = away_m <= problem.sure_radius_m
    least = np.zeros(problem.steps) if problem.p_min is None else problem.p_min
    least = np.where(is_held, 0.0, least)
    free = np.where(is_held[:, None], 0.0, np.inf)
    bounded = np.flatnonzero(least > 0.0)
    known: dict[bytes, tuple[Floats, Floats, Field]] = {}

    def at(flat: Floats) -> tuple[Floats, Floats, Field]:
        key = flat.tobytes()
        if key not in known:
            known.clear()
            known[key] = stage_rewards(problem, flat.reshape(shape))
        return known[key]

    def loss(flat: Floats) -> tuple[float, Floats]:
        values, slopes, _ = at(flat)
        moves = np.diff(np.vstack([problem.start_m, flat.reshape(shape)]), axis=0)
        length = np.sqrt((moves**2).sum(axis=1) + (ROUNDED * problem.step_m) ** 2)
        pull = problem.per_metre * moves / length[:, None]
        pull[:-1] -= pull[1:]
        return float(problem.per_metre * length.sum() - values.sum()), (pull - slopes).ravel()

    def room(flat: Floats) -> Floats:
        path = np.vstack([problem.start_m, flat.reshape(shape)])
        found = [1.0 - scale * (np.diff(path, axis=0) ** 2).sum(axis=1)]
        for each in problem.keep_outs:
            away = (nearest_to(each, path)[0] ** 2).sum(axis=1)
            found.append(scale * (away - np.maximum(each.on_way_m + APART_M, 0.0) ** 2))
        if len(bounded):
            found.append(at(flat)[2]["chance"].value[bounded] - least[bounded] - surplus)
        return np.concatenate(found)

    def room_slope(flat: Floats) -> Floats:
        path = np.vstack([problem.start_m, flat.reshape(shape)])
        moves = 2.0 * scale * np.diff(path, axis=0)
        found = [slopes_of(moves, -moves)]
        for each in problem.keep_outs:
            away, share = nearest_to(each, path)
            away *= 2.0 * scale
            found.append(slopes_of((1.0 - share) * away, share * away))
        if len(bounded):
            found.append(slopes_of(0.0 * moves, at(flat)[2]["chance"].slope)[bounded])
        return np.concatenate(found)

    limits: Any = {"type": "ineq", "fun": room, "jac": room_slope}
    options: Any = {"maxiter": MOST_ITERATIONS, "ftol": 1e-10}
    found = minimize(
        loss,
        path_m.ravel(),
        jac=True,
        method="SLSQP",
        bounds=Bounds((path_m - free).ravel(), (path_m + free).ravel()),
        constraints=limits,
        options=options,
    )
    return np.asarray(found.x, dtype=np.float64).reshape(shape)


def nearest_to(each: KeepOut, path_m: Floats) -> tuple[Floats, Floats]:
    """Return where a path's steps are nearest to a disc's centre (N, 2), and shares (N, 1)."""
    first, last = path_m[:-1] - each.centre_m[:-1], path_m[1:] - each.centre_m[1:]
    square = np.maximum(((last - first) ** 2).sum(axis=1), 1e-300)
    share = np.clip(-((last - first) * first).sum(axis=1) / square, 0.0, 1.0)[:, None]
    return first + share * (last - first), share


def slopes_of(before: Floats, after: Floats) -> Floats:
    """Return derivatives (N, 2 N) by all positions from those by the ends of each step (N, 2)."""
    stage = np.arange(len(after))
    found = np.zeros((len(after), *after.shape))
    found[stage, stage] = after
    found[stage[1:], stage[:-1]] = before[1:]
    return found.reshape(len(found), -1)


def tilts_near(problem: StageProblem, paths_m: Sequence[Floats], kinks_m: Floats) -> list[Floats]:
    """Return multipliers fitted to each path, with little weight at obstacles and at `kinks_m`."""
    found: list[Floats] = []
    for path in paths_m:
        is_free = np.ones(len(path), dtype=np.bool_)
        if len(kinks_m):
            is_free &= np.linalg.norm(path[:, None] - kinks_m, axis=2).min(axis=1) > AT_KINK_M
        for k, place in enumerate(map(shapely.Point, path)):
            is_free[k] &= all(area.distance(place) > AT_KINK_M for area in problem.areas(k))
        found.append(multipliers_of(problem, path, is_free))
    return found


def multipliers_of(problem: StageProblem, path_m: Floats, is_free: Mask) -> Floats:
    """Return multipliers of the steps (N, 2), from stages with `is_free`."""
    steps = problem.steps
    _, gradient, field = stage_rewards(problem, path_m)
    moves = np.diff(np.vstack([problem.start_m, path_m]), axis=0)
    length = np.linalg.norm(moves, axis=1)
    ahead = moves / np.maximum(length, 1e-12)[:, None]
    moving = length > max(problem.standstill_m, 1e-6 * problem.step_m)
    fixed = np.where(moving[:, None], problem.per_metre * ahead, 0.0)
    weight = np.where(is_free, 1.0, LEFT_OUT)
    columns: list[Floats] = []
    pushes: list[tuple[int, Floats]] = []

    def add(stage: int, direction: Floats) -> None:
        column = np.zeros((steps, 2))
        column[stage] += direction
        if stage:
            column[stage - 1] -= direction
        columns.append(column)
        pushes.append((stage, direction))

    for k in range(steps):
        if length[k] >= FULL_STEP * problem.step_m:
            add(k, ahead[k])
        elif not moving[k] and problem.per_metre > 0.0:
            for direction in np.vstack([np.eye(2), -np.eye(2)]):
                add(k, direction)
        least = 0.0 if problem.p_min is None else float(problem.p_min[k])
        if least > 0.0 and field["chance"].value[k] <= least + AT_P_MIN:
            column = np.zeros((steps, 2))
            column[k] = -field["chance"].slope[k]
            columns.append(column)
            pushes.append((k, np.zeros(2)))
    wanted = gradient - fixed + np.vstack([fixed[1:], np.zeros((1, 2))])
    found = fixed.copy()
    if columns:
        matrix = (np.array(columns) * weight[:, None]).reshape(len(columns), -1).T
        amounts, _ = nnls(matrix, (wanted * weight[:, None]).ravel())
        for (k, direction), amount in zip(pushes, amounts, strict=True):
            found[k] += amount * direction
    return found


@dataclass(frozen=True, eq=False)
class Part:
    """Paths within limits, and a mixture of such paths whose measurements are the reference."""

    limits_m: Floats  # (N, 4) of the positions, as in `StageProblem`
    paths_m: Floats  # (p, N, 2)
    weight: Floats  # (p,)
    share: Floats  # (3,) reference, assumed measurements and path loss, relative to the mixture
    design: Design = field(default_factory=Design)
    value: float = -np.inf  # Bound on a lattice

    def halves(self) -> tuple[Sequence[Part], Floats]:
        """Return two parts cut where the mixture's positions vary most, and step, axis and cut."""
        mean = np.average(self.paths_m, axis=0, weights=self.weight)
        spread = np.average((self.paths_m - mean) ** 2, axis=0, weights=self.weight)
        step, axis = divmod(int(spread.argmax()), 2)
        at_m = mean[step, axis]
        is_low = self.paths_m[:, step, axis] <= at_m
        both = zip(halved(self.limits_m, step, axis, at_m), (is_low, ~is_low), strict=True)
        parts = [
            replace(self, limits_m=limits, paths_m=self.paths_m[kept], weight=self.weight[kept])
            for limits, kept in both
            if kept.any()
        ]
        return parts, np.array([step, axis, at_m])


def fitted_parts(
    problem_of: Callable[[Design], StageProblem],
    measured: Measured,
    path_m: Floats,
    known: float,
    seconds: float,
) -> tuple[list[Part], Floats]:
    """Return parts of all paths with fitted designs, and the cuts (c, 4) between them.

    The part with the largest bound is cut until no bound exceeds `known`. The search begins at
    measurements along a path (N, 2).
    """
    begun, whole = monotonic(), problem_of(Design()).limits_m
    fits = [
        fitted(
            problem_of,
            measured,
            Part(whole, path_m[None], np.ones(1), np.array([is_referred, *FIRST_SHARES])),
            MOST_ROUNDS,
            min(WHOLE_SHARE * seconds, WHOLE_S) / (1 + (measured.criterion == "map")),
        )
        for is_referred in ((1.0, 0.0) if measured.criterion == "map" else (1.0,))
    ]
    parts, cuts = [min(fits, key=lambda each: each.value)], list[Floats]()
    while monotonic() - begun < seconds:
        worst = int(np.argmax([each.value for each in parts]))
        halves, cut = parts[worst].halves()
        if parts[worst].value <= known or len(halves) < 2:
            break
        cuts.append(np.append(worst, cut))
        parts[worst], last = (
            fitted(problem_of, measured, each, ROUNDS_OF_PART, seconds) for each in halves
        )
        parts.append(last)
    return parts, np.reshape(cuts, (-1, 4))


def fitted(
    problem_of: Callable[[Design], StageProblem],
    measured: Measured,
    part: Part,
    rounds: int,
    seconds: float,
) -> Part:
    """Return a part with the design of the least bound that a search on a lattice finds.

    Each round moves the mixture towards the path at which the bound is attained (Frank and Wolfe's
    method); some rounds try more and less assumed information.
    """
    problem = replace(problem_of(Design()), limits_m=part.limits_m)
    is_map = measured.criterion == "map"
    side, grid = 0.5 * FIRST_SHARE * problem.step_m, first_cells(problem)
    grid = [divided(problem, each, side, k) for k, each in enumerate(grid, 1)]
    if not all(map(len, grid)):
        return replace(part, value=-np.inf)

    def bounded(part: Part) -> tuple[Part, Floats]:
        places, owner = np.unique(part.paths_m.reshape(-1, 2), axis=0, return_inverse=True)
        each = np.repeat(part.weight, problem.steps)
        weight = np.asarray(np.bincount(owner.ravel(), each), dtype=np.float64)
        known = part.share[2] * repeated(measured.posterior, places, weight)[2]
        weights = np.outer(weight, part.share[:2])
        design = Design(places_m=places, weights=weights, path_loss=known)
        level = evaluated(replace(problem_of(design), limits_m=part.limits_m), side, grid, 0.0)
        through = through_bounds(level, [])
        best = [cells[each.argmax()] for cells, each in zip(level.active, through, strict=True)]
        path = level.field(np.array(best)).discs.centre_m
        value = min(float(each.max()) for each in through)
        return replace(part, design=design, value=value), path

    part = replace(part, weight=part.weight / part.weight.sum())
    best, step, until = None, 3.0, monotonic() + seconds
    for number in range(rounds):
        (now, path), better = bounded(part), False
        tried = is_map and number % ROUNDS_PER_TRIAL == 0
        for k, power in product((1, 2), (1.0, -1.0)) if tried else ():
            share = np.where(np.arange(3) == k, step**power, 1.0) * now.share
            other = bounded(replace(now, share=share))
            if other[0].value < now.value:
                (now, path), better = other, True
        step = step if better or not tried else step**0.6
        best = now if best is None or now.value < best.value else best
        if monotonic() > until:
            break
        moved = 1.0 / (number + 3)
        paths = np.concatenate([now.paths_m, path[None]])
        part = replace(now, paths_m=paths, weight=np.append((1.0 - moved) * now.weight, moved))
    return part if best is None else best
