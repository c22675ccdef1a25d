# pyright: basic
"""Multipliers for :mod:`planopt.bounds.tube` from the optimality conditions of a path.

At a local optimum the gradient of stage k is ``m_k - m_{k+1}`` minus those of active chance and
obstacle constraints (solved by least squares). Inaccurate multipliers only loosen the bound.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from scipy.optimize import minimize, nnls

from planopt.arrays import Floats, Mask
from planopt.bounds.tube import StageProblem
from planopt.objectives.upper_bounds import Discs, Field

Array = Floats

FULL_STEP = 0.99
"""Step length, relative to the longest step, that counts as full; solvers stop short of it."""
LEFT_OUT = 1e-3
"""Weight of stages whose gradient is not determined: at kinks, and next to obstacles."""
MOST_ITERATIONS = 100
"""Maximum number of iterations of a local search."""
ROUNDED = 1e-3
"""Smoothing width of step lengths in a local search, relative to the longest step."""
AT_KINK_M = 0.02
"""Distance from a position of a measurement at which the gradient is not determined."""
AT_P_MIN = 0.02
"""Surplus of the probability of connection up to which p_min may count as active."""


def stage_rewards(problem: StageProblem, path_m: Array) -> tuple[Array, Array, Field]:
    """Return rewards (N,) of a path's stages, their gradients (N, 2), and predicted quantities."""
    field = Field(Discs(path_m, 0.0), problem.makers)
    each = [problem.reward(k, field.at(np.array([k]))) for k in range(problem.steps)]
    values = np.concatenate([reward.value for reward in each])
    return values, np.vstack([reward.slope for reward in each]), field


def local_optimum(problem: StageProblem, path_m: Array, surplus: float = 0.0) -> Array:
    """Return a nearly optimal path (N, 2) that ignores obstacles; `surplus` is added to p_min."""
    shape, scale = path_m.shape, 1.0 / problem.step_m**2
    stage = np.arange(problem.steps)
    least = np.zeros(problem.steps) if problem.p_min is None else problem.p_min
    bounded = np.flatnonzero(least > 0.0)
    known: dict[bytes, tuple[Array, Array, Field]] = {}

    def at(flat: Array) -> tuple[Array, Array, Field]:
        key = flat.tobytes()
        if key not in known:
            known.clear()
            known[key] = stage_rewards(problem, flat.reshape(shape))
        return known[key]

    def loss(flat: Array) -> tuple[float, Array]:
        values, slopes, _ = at(flat)
        moves = np.diff(np.vstack([problem.start_m, flat.reshape(shape)]), axis=0)
        length = np.sqrt((moves**2).sum(axis=1) + (ROUNDED * problem.step_m) ** 2)
        pull = problem.per_metre * moves / length[:, None]
        pull[:-1] -= pull[1:]
        return float(problem.per_metre * length.sum() - values.sum()), (pull - slopes).ravel()

    def room(flat: Array) -> Array:
        moves = np.diff(np.vstack([problem.start_m, flat.reshape(shape)]), axis=0)
        rest = 1.0 - scale * (moves**2).sum(axis=1)
        if not len(bounded):
            return rest
        chance = at(flat)[2]["chance"].value[bounded] - least[bounded] - surplus
        return np.concatenate([rest, chance])

    def room_slope(flat: Array) -> Array:
        moves = np.diff(np.vstack([problem.start_m, flat.reshape(shape)]), axis=0)
        found = np.zeros((len(stage) + len(bounded), *shape))
        found[stage, stage] = -2.0 * scale * moves
        found[stage[1:], stage[:-1]] = 2.0 * scale * moves[1:]
        if len(bounded):
            found[len(stage) + np.arange(len(bounded)), bounded] = at(flat)[2]["chance"].slope[
                bounded
            ]
        return found.reshape(len(found), -1)

    limits: Any = {"type": "ineq", "fun": room, "jac": room_slope}
    options: Any = {"maxiter": MOST_ITERATIONS, "ftol": 1e-10}
    found = minimize(
        loss, path_m.ravel(), jac=True, method="SLSQP", constraints=limits, options=options
    )
    return np.asarray(found.x, dtype=np.float64).reshape(shape)


def tilts_near(
    problem: StageProblem, paths_m: Sequence[Array], kinks_m: Array
) -> list[tuple[Array, Array]]:
    """Return multipliers fitted to each path, with little weight at obstacles and at `kinks_m`."""
    found: list[tuple[Array, Array]] = []
    for path in paths_m:
        is_free = np.ones(len(path), dtype=np.bool_)
        if len(kinks_m):
            is_free &= np.linalg.norm(path[:, None] - kinks_m, axis=2).min(axis=1) > AT_KINK_M
        for area in problem.blocked:
            is_free &= shapely.distance(area, shapely.points(path)) > AT_KINK_M
        found.append(multipliers_of(problem, path, is_free))
    return found


def multipliers_of(problem: StageProblem, path_m: Array, is_free: Mask) -> tuple[Array, Array]:
    """Return multipliers of the steps (N, 2) and of p_min (N,), from stages with `is_free`."""
    steps = problem.steps
    _, gradient, field = stage_rewards(problem, path_m)
    moves = np.diff(np.vstack([problem.start_m, path_m]), axis=0)
    length = np.linalg.norm(moves, axis=1)
    ahead = moves / np.maximum(length, 1e-12)[:, None]
    moving = length > max(problem.standstill_m, 1e-6 * problem.step_m)
    fixed = np.where(moving[:, None], problem.per_metre * ahead, 0.0)
    weight = np.where(is_free, 1.0, LEFT_OUT)
    columns: list[Array] = []
    kinds: list[tuple[int, Array | None]] = []

    def add(stage: int, direction: Array) -> None:
        column = np.zeros((steps, 2))
        column[stage] += direction
        if stage:
            column[stage - 1] -= direction
        columns.append(column)
        kinds.append((stage, direction))

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
            kinds.append((k, None))
    wanted = gradient - fixed + np.vstack([fixed[1:], np.zeros((1, 2))])
    found, of_p_min = fixed.copy(), np.zeros(steps)
    if columns:
        matrix = (np.array(columns) * weight[:, None]).reshape(len(columns), -1).T
        amounts, _ = nnls(matrix, (wanted * weight[:, None]).ravel())
        for (k, direction), amount in zip(kinds, amounts, strict=True):
            if direction is None:
                of_p_min[k] = amount
            else:
                found[k] += amount * direction
    return found, of_p_min
