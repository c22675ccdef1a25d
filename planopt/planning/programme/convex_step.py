# pyright: basic
"""One convex step of sequential convex programming, solved by Clarabel.

About a point x with rows g, their Jacobian J, the objective's gradient c and a positive
semidefinite B, over the step d and what is missing, t >= 0, of each row that is missed at x::

    min   c.d + d'B d / 2 + penalty sum t
    s.t.  lower - t <= g + J d <= upper + t        rows but the cones
          |z_k + dz_k| <= R_k                      cones: pairs z_k of variables or of differences
          lowest <= d <= highest

Cones are convex as they are and not linearised (:mod:`planopt.planning.programme.cone_rows`). Where
lowest and highest are equal they are zero: what is set stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.cone_rows import NO_VARIABLE, ConeRows
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
    cones: ConeRows
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    penalty: float


@dataclass(frozen=True)
class Step:
    """A step and the multipliers of the rows and of the bounds on it.

    Multipliers are positive at upper bounds and negative at lower ones; of cones they
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
    plain = np.delete(np.arange(len(model.rows)), cones.row)
    jacobian, values = model.jacobian[plain], model.rows[plain]
    lower, upper = model.row_bounds.lower[plain], model.row_bounds.upper[plain]
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
        _cone_block(model, count),
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
            *[CLARABEL.SecondOrderConeT(3)] * len(cones),
        ],
        settings,
    ).solve()
    dual = np.split(np.asarray(solution.z), np.cumsum([len(block[2]) for block in blocks])[:-1])
    rows, variables = np.zeros(len(model.rows)), np.zeros(n)
    rows[plain[equal]] = dual[0]
    rows[plain[above]] = dual[1][: len(above)]
    rows[plain[below]] -= dual[1][len(above) :]
    variables[high] = dual[3][: len(high)]
    variables[low] -= dual[3][len(high) :]
    radii = cones.radii(model.row_bounds.upper)
    rows[cones.row] = dual[4].reshape(-1, 3)[:, 0] / (2.0 * cones.weight * radii)
    step = np.zeros(n)
    step[moving] = np.asarray(solution.x)[: int(moving.sum())]
    return Step(step, rows, variables, TERMINATIONS[str(solution.status)])


def _cone_block(
    model: Model, missing: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Cones (R_k, z_k + dz_k)."""
    cones, count = model.cones, len(model.cones)
    every = np.arange(count)
    block, bounds = np.zeros((count, 3, len(model.gradient))), np.zeros((count, 3))
    bounds[:, 0] = cones.radii(model.row_bounds.upper)
    bounds[:, 1:] = cones.pairs(model.jacobian)
    taken = every[cones.less[:, 0] != NO_VARIABLE]
    for axis in range(2):
        block[every, 1 + axis, cones.own[:, axis]] = -1.0
        block[taken, 1 + axis, cones.less[taken, axis]] = 1.0
    return (
        block.reshape(3 * count, len(model.gradient)),
        np.zeros((3 * count, missing)),
        bounds.ravel(),
    )
