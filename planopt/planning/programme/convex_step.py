# pyright: basic
"""One convex step of sequential convex programming, solved by Clarabel.

About a point x with rows g, their Jacobian J, the objective's gradient c and a positive
semidefinite B, over the step d and what is missing, t >= 0, of each row that is missed at x::

    min   c.d + d'B d / 2 + penalty sum t
    s.t.  lower - t <= g + J d <= upper + t        rows but the first K
          |u_k + d_k - d_{k-1}| <= L_k             the first K rows, |u_k|^2 <= L_k^2
          lowest <= d <= highest

with u_k the k-th step of the path; that row is convex as it is and is not linearised. Where lowest
and highest are equal they are zero: what is set stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.kkt import Bounds

CLARABEL: Any = clarabel
"""It has no type stubs."""

TERMINATIONS: dict[str, Termination] = {
    "Solved": Termination.CONVERGED,
    "AlmostSolved": Termination.ACCEPTABLE,
    "PrimalInfeasible": Termination.INFEASIBLE,
    "AlmostPrimalInfeasible": Termination.INFEASIBLE,
    "DualInfeasible": Termination.NUMERICAL_FAILURE,
    "AlmostDualInfeasible": Termination.NUMERICAL_FAILURE,
    "MaxIterations": Termination.ITERATION_LIMIT,
    "MaxTime": Termination.TIME_LIMIT,
    "NumericalError": Termination.NUMERICAL_FAILURE,
    "InsufficientProgress": Termination.NUMERICAL_FAILURE,
    "CallbackTerminated": Termination.STOPPED,
    "Unsolved": Termination.NUMERICAL_FAILURE,
}
"""Every status of Clarabel."""

BIG = 1e12
"""Stands for no limit where sums are taken."""

USABLE = (Termination.CONVERGED, Termination.ACCEPTABLE)
"""A step that is not quite exact is judged by what it brings, as any other."""


@dataclass(frozen=True)
class Model:
    """What is known of a programme at a point; see the module."""

    rows: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    gradient: NDArray[np.float64]
    curvature: NDArray[np.float64]
    row_bounds: Bounds
    cones: int
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    penalty: float


@dataclass(frozen=True)
class Step:
    """A step and the multipliers of the rows and of the bounds on it.

    Multipliers are positive at upper bounds and negative at lower ones; of the first K rows they
    are those of the squared form.
    """

    step: NDArray[np.float64]
    row_multipliers: NDArray[np.float64]
    variable_multipliers: NDArray[np.float64]
    termination: Termination

    @property
    def usable(self) -> bool:
        """Whether the step may be tried."""
        return self.termination in USABLE


def convex_step(model: Model) -> Step:
    """Solve the convex programme."""
    n, cones = len(model.gradient), model.cones
    jacobian, values = model.jacobian[cones:], model.rows[cones:]
    lower, upper = model.row_bounds.lower[cones:], model.row_bounds.upper[cones:]
    # What no step can change by enough is left out, as are variables that cannot move.
    moving = model.lowest < model.highest
    farthest = np.where(moving, np.maximum(-model.lowest, model.highest), 0.0)
    change = np.abs(jacobian) @ np.minimum(farthest, BIG)
    above = np.nonzero((lower < upper) & (values + change > upper))[0]
    below = np.nonzero((lower < upper) & (values - change < lower))[0]
    equal = np.nonzero(lower == upper)[0]
    high = np.nonzero(moving & np.isfinite(model.highest))[0]
    low = np.nonzero(moving & np.isfinite(model.lowest))[0]
    # Only rows that are missed here need t: the others leave room for no step at all.
    sides = np.concatenate([jacobian[above], -jacobian[below]])
    room = np.concatenate([upper[above] - values[above], values[below] - lower[below]])
    short = np.nonzero(room < 0.0)[0]
    off = np.nonzero(values[equal] != upper[equal])[0]
    missing = np.eye(len(short) + 2 * len(off))
    count = len(missing)
    equal_missing, side_missing = np.zeros((len(equal), count)), np.zeros((len(room), count))
    side_missing[short] = -missing[: len(short)]
    plus, minus = np.split(missing[len(short) :], 2)
    equal_missing[off] = plus - minus
    # Blocks [d, t], in the order of their cones.
    eye = np.eye(n)
    limits = np.concatenate([eye[high], -eye[low]])
    blocks = [
        (jacobian[equal], equal_missing, upper[equal] - values[equal]),
        (sides, side_missing, room),
        (np.zeros((count, n)), -missing, np.zeros(count)),
        (
            limits,
            np.zeros((len(limits), count)),
            np.append(model.highest[high], -model.lowest[low]),
        ),
        _speed_block(model, count),
    ]
    keep = np.append(moving, np.ones(count, dtype=bool))
    curvature = np.zeros((n + count, n + count))
    curvature[:n, :n] = np.triu(model.curvature)
    settings = CLARABEL.DefaultSettings()
    settings.verbose = False
    solution = CLARABEL.DefaultSolver(
        sp.csc_matrix(curvature[np.ix_(keep, keep)]),
        np.append(model.gradient, np.full(count, model.penalty))[keep],
        sp.csc_matrix(np.concatenate([np.hstack(block[:2])[:, keep] for block in blocks])),
        np.concatenate([block[2] for block in blocks]),
        [
            CLARABEL.ZeroConeT(len(equal)),
            CLARABEL.NonnegativeConeT(len(room) + count + len(limits)),
            *[CLARABEL.SecondOrderConeT(3)] * cones,
        ],
        settings,
    ).solve()
    dual = np.split(np.asarray(solution.z), np.cumsum([len(block[2]) for block in blocks])[:-1])
    rows, variables = np.zeros(len(model.rows)), np.zeros(n)
    inner = rows[cones:]
    inner[equal] = dual[0]
    inner[above] = dual[1][: len(above)]
    inner[below] -= dual[1][len(above) :]
    variables[high] = dual[3][: len(high)]
    variables[low] -= dual[3][len(high) :]
    longest = np.sqrt(model.row_bounds.upper[:cones])
    rows[:cones] = dual[4].reshape(-1, 3)[:, 0] / (2.0 * longest)
    step = np.zeros(n)
    step[moving] = np.asarray(solution.x)[: int(moving.sum())]
    return Step(step, rows, variables, TERMINATIONS[str(solution.status)])


def _speed_block(
    model: Model, missing: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Cones (L_k, u_k + d_k - d_{k-1}); the gradients of the rows |u_k|^2 have u_k."""
    count = model.cones
    stage = np.arange(count)
    block, bounds = np.zeros((count, 3, len(model.gradient))), np.zeros((count, 3))
    bounds[:, 0] = np.sqrt(model.row_bounds.upper[:count])
    for axis in range(2):
        bounds[:, 1 + axis] = 0.5 * model.jacobian[stage, 2 * stage + axis]
        block[stage, 1 + axis, 2 * stage + axis] = -1.0
        block[stage[1:], 1 + axis, 2 * stage[:-1] + axis] = 1.0
    return (
        block.reshape(3 * count, len(model.gradient)),
        np.zeros((3 * count, missing)),
        bounds.ravel(),
    )
