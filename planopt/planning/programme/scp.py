"""Sequential convex programming in a trust region, an alternative to IPOPT ([NW06], section 18.5).

Clarabel solves each convex step. About a point x with rows g, Jacobian J, objective gradient c and
a positive semidefinite B, the variables are the step d and the violation t >= 0 of each row that x
violates::

    min   c.d + d'B d / 2 + penalty sum t
    s.t.  lower - t <= g + J d <= upper + t        all rows except cones
          |z_k + dz_k| <= R_k                      cones: pairs z_k of variables or of differences
          lowest <= d <= highest

A cone row weight |z|^2 + constant <= upper becomes |z| <= radius without linearisation.
"""

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp

from planopt.arrays import Floats, Indices
from planopt.planning.plan import Termination
from planopt.planning.programme.solver import (
    Bounds,
    NlpFunctions,
    NlpPoint,
    PathShape,
    SolveNlp,
    lost_point,
    nlp_point,
)

NO_VARIABLE = -1  # Column index of a missing variable


@dataclass(frozen=True, eq=False)
class ConeRows:
    """Constraint rows of a programme that are second-order cones."""

    row: Indices  # (k,) row indices
    # (k, 2) columns of the pairs in z, and of subtracted pairs or `NO_VARIABLE`
    own: Indices
    less: Indices
    weight: Floats  # (k,) weight of the row
    constant: Floats

    def __len__(self) -> int:
        return len(self.row)

    def pairs(self, jacobian: Floats) -> Floats:
        """Return the vectors z (k, 2) of the cones from the Jacobian (m, n) of all rows."""
        return jacobian[self.row[:, None], self.own] / (2.0 * self.weight[:, None])

    def radii(self, upper: Floats) -> Floats:
        """Return the cones' radii (k,), the limits of |z|, from upper bounds (m,) of all rows."""
        return np.sqrt((upper[self.row] - self.constant) / self.weight)


def step_cones(horizon: int) -> ConeRows:
    """Return the cones of the speed limits, which are the first rows of the programme."""
    own = [(2 * k, 2 * k + 1) for k in range(horizon)]
    less = [(NO_VARIABLE, NO_VARIABLE), *own[:-1]]
    return _rows(list(range(horizon)), own, less, [1.0] * horizon, [0.0] * horizon)


def motion_cones(shape: PathShape) -> ConeRows:
    """Return the cones of inputs and velocities whose magnitude is bounded."""
    motion = shape.motion
    if motion is None:
        return _rows([], [], [], [], [])
    dynamics, n = motion.dynamics, shape.horizon
    states, inputs = dynamics.state_names, dynamics.input_names
    columns = {name: column for column, name in enumerate((*states[2:], *inputs))}
    limits = len(dynamics.limits((1.0,) * len(inputs), (1.0,) * len(states)))
    first_row = n + 2 * n * shape.lines - shape.lines + n * len(states)
    first_column = 2 * n + shape.slacks
    row, own, weight = list[int](), list[tuple[int, int]](), list[float]()
    for k in range(n):
        for disc in dynamics.discs:
            row.append(first_row + k * limits + disc.limit)
            x, y = (first_column + k * motion.per_step + columns[name] for name in disc.names)
            own.append((x, y))
            weight.append(1.0 / disc.radius**2)
    none = [(NO_VARIABLE, NO_VARIABLE)] * len(row)
    return _rows(row, own, none, weight, [-1.0] * len(row))


def _rows(
    row: list[int],
    own: list[tuple[int, int]],
    less: list[tuple[int, int]],
    weight: list[float],
    constant: list[float],
) -> ConeRows:
    return ConeRows(
        np.array(row, dtype=np.intp),
        np.array(own, dtype=np.intp).reshape(-1, 2),
        np.array(less, dtype=np.intp).reshape(-1, 2),
        np.array(weight, dtype=np.float64),
        np.array(constant, dtype=np.float64),
    )


CLARABEL: Any = clarabel  # Clarabel module, untyped because it has no type stubs

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
"""Termination for every status of Clarabel."""

BIG = 1e12  # Finite replacement of infinite limits
USABLE = (Termination.CONVERGED, Termination.ACCEPTABLE)
"""Terminations of the convex solver whose step the merit function tests."""


@dataclass(frozen=True)
class Model:
    """Convex approximation of a nonlinear programme at a point."""

    rows: Floats
    jacobian: Floats
    gradient: Floats
    curvature: Floats
    row_bounds: Bounds
    cones: ConeRows
    lowest: Floats
    highest: Floats
    penalty: float


@dataclass(frozen=True)
class Step:
    """Step of the convex programme, with multipliers of rows (cones in squared form) and bounds."""

    step: Floats
    row_multipliers: Floats
    variable_multipliers: Floats
    termination: Termination

    @property
    def usable(self) -> bool:
        """Return whether the merit function should test the convex solver's step."""
        return self.termination in USABLE


def convex_step(model: Model) -> Step:
    """Return the solution of the convex programme."""
    n, cones = len(model.gradient), model.cones
    plain = np.delete(np.arange(len(model.rows)), cones.row)
    jacobian, values = model.jacobian[plain], model.rows[plain]
    lower, upper = model.row_bounds.lower[plain], model.row_bounds.upper[plain]
    # Fixed variables, and rows that no step can violate, are omitted.
    moving = model.lowest < model.highest
    farthest = np.where(moving, np.maximum(-model.lowest, model.highest), 0.0)
    change = np.abs(jacobian) @ np.minimum(farthest, BIG)
    above = np.nonzero((lower < upper) & (values + change > upper))[0]
    below = np.nonzero((lower < upper) & (values - change < lower))[0]
    equal = np.nonzero(lower == upper)[0]
    high = np.nonzero(moving & np.isfinite(model.highest))[0]
    low = np.nonzero(moving & np.isfinite(model.lowest))[0]
    # Only violated rows need a variable t.
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


def _cone_block(model: Model, missing: int) -> tuple[Floats, Floats, Floats]:
    """Return the cone constraints for Clarabel: coefficients of step and violations, constants."""
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


MAX_ITERATIONS = 60  # Maximum number of convex steps of a solve, rejected ones included
FIRST_PENALTY, LARGEST_PENALTY = 1e2, 1e6  # Initial and maximum penalty of a violated row
PENALTY_FACTOR = 10.0  # Growth factor of the penalty while rows are violated
TAKEN_SHARE, GOOD_SHARE = 0.1, 0.75
"""Shares of the predicted decrease from which a step is accepted, and the trust region grows."""
SHRINK, GROW = 0.25, 2.0  # Factors on the trust-region radius after poor and after good steps
PROMISE_TOLERANCE = 1e-6  # Relative predicted decrease below which a solve has converged
ROW_TOLERANCE = 1e-6  # Tolerance of the rows, equal to IPOPT's
SMALLEST_REGION = 1e-7  # Trust-region radius below which a solve has converged, in longest steps


def scp_solve(functions: NlpFunctions, shape: PathShape, budget_s: float | None = None) -> SolveNlp:
    """Return a function that solves a programme, with a time limit of `budget_s` seconds."""
    horizon, motion = shape.horizon, shape.motion
    cones = step_cones(horizon) if motion is None else motion_cones(shape)

    def solve(
        start: Floats, parameters: Floats, variable_bounds: Bounds, row_bounds: Bounds
    ) -> NlpPoint:
        bounds = (variable_bounds.lower, variable_bounds.upper, row_bounds.lower, row_bounds.upper)
        if any(np.isnan(bound).any() for bound in bounds):
            return lost_point(horizon, len(start), len(row_bounds.lower))
        # The first row of a single integrator is its squared step length.
        longest = np.sqrt(row_bounds.upper[0])
        if motion is not None:
            longest = motion.dynamics.speed_max_m_s * motion.step_s
        climb = _Climb(
            functions,
            horizon,
            cones,
            longest * shape.per_m,
            parameters,
            variable_bounds,
            row_bounds,
        )
        return climb.run(start, np.inf if budget_s is None else perf_counter() + budget_s)

    return solve


class _Climb:
    """State of one solve by sequential convex programming."""

    def __init__(
        self,
        functions: NlpFunctions,
        horizon: int,
        cones: ConeRows,
        reach: Floats,
        parameters: Floats,
        variable_bounds: Bounds,
        row_bounds: Bounds,
    ) -> None:
        self._functions = functions
        self._horizon = horizon
        self._cones = cones
        self._reach = reach
        self._parameters = parameters
        self._variable_bounds = variable_bounds
        self._row_bounds = row_bounds
        self._penalty = FIRST_PENALTY

    def run(self, start: Floats, until: float) -> NlpPoint:
        """Return the solution when the model predicts no decrease or `until` has passed."""
        x = np.clip(start, self._variable_bounds.lower, self._variable_bounds.upper)
        value, rows = self._at(x)
        last = Step(np.zeros(len(x)), np.zeros(len(rows)), np.zeros(len(x)), Termination.STOPPED)
        termination = Termination.ITERATION_LIMIT
        region, iterations = 1.0, 0
        if not np.isfinite(value) or not np.isfinite(rows).all():
            return lost_point(self._horizon, len(x), len(rows))
        model = self._model(x, rows, last.row_multipliers, region)
        while iterations < MAX_ITERATIONS:
            if perf_counter() > until:
                termination = Termination.TIME_LIMIT
                break
            iterations += 1
            found = convex_step(model)
            if not found.usable:
                termination = found.termination
                break
            predicted = self._predicted(model, found.step)
            if predicted <= PROMISE_TOLERANCE * max(1.0, abs(value)) or region < SMALLEST_REGION:
                last = found
                if self._excess(rows).max(initial=0.0) <= ROW_TOLERANCE:
                    termination = Termination.CONVERGED
                    break
                if self._penalty >= LARGEST_PENALTY:
                    termination = Termination.INFEASIBLE
                    break
                self._penalty *= PENALTY_FACTOR
                region = max(region, SHRINK)
                model = self._model(x, rows, last.row_multipliers, region)
                continue
            probed = x + found.step
            new_value, new_rows = self._at(probed)
            merit = self._merit(value, rows)
            share = self._share(merit, new_value, new_rows, predicted)
            if share < TAKEN_SHARE and np.isfinite(new_rows).all():
                # Second-order correction of the rows (section 18.3 of [NW06]).
                there = new_rows - model.jacobian @ found.step
                there[self._cones.row] = model.rows[self._cones.row]
                again = convex_step(replace(model, rows=there))
                if again.usable:
                    probed = x + again.step
                    new_value, new_rows = self._at(probed)
                    share = self._share(merit, new_value, new_rows, predicted)
                    found = again
            if share >= TAKEN_SHARE:
                x, value, rows = probed, new_value, new_rows
                last = found
            region *= GROW if share >= GOOD_SHARE else 1.0 if share >= TAKEN_SHARE else SHRINK
            model = self._model(x, rows, last.row_multipliers, region)
        multipliers = last.row_multipliers, last.variable_multipliers
        return nlp_point(self._horizon, x, *multipliers, termination, iterations)

    def _share(self, merit: float, value: float, rows: Floats, predicted: float) -> float:
        """Return the decrease of the merit function as a fraction of the predicted decrease."""
        gained = merit - self._merit(value, rows)
        return gained / predicted if np.isfinite(gained) else -np.inf

    def _at(self, x: Floats) -> tuple[float, Floats]:
        functions, parameters = self._functions, self._parameters
        return functions.objective(x, parameters), functions.rows(x, parameters)

    def _excess(self, rows: Floats) -> Floats:
        """Return the amount by which each row violates its bounds; cones are left out."""
        lower, upper = self._row_bounds.lower, self._row_bounds.upper
        return np.delete(np.maximum(np.maximum(lower - rows, rows - upper), 0.0), self._cones.row)

    def _merit(self, value: float, rows: Floats) -> float:
        return value + self._penalty * float(self._excess(rows).sum())

    def _predicted(self, model: Model, step: Floats) -> float:
        """Return the decrease of the merit function that the model predicts."""
        slope = float(model.gradient @ step + 0.5 * step @ (model.curvature @ step))
        rows = model.rows + model.jacobian @ step
        before, after = self._excess(model.rows).sum(), self._excess(rows).sum()
        return -slope + self._penalty * float(before - after)

    def _model(self, x: Floats, rows: Floats, multipliers: Floats, region: float) -> Model:
        """Return the convex model at x; `region` is the trust region's width in longest steps."""
        curving = multipliers.copy()
        curving[self._cones.row] = 0.0
        widest = region * self._reach
        gradient, jacobian = self._functions.slopes(x, self._parameters)
        hessian = self._functions.hessian(x, self._parameters, curving)
        return Model(
            rows=rows,
            jacobian=jacobian,
            gradient=gradient,
            curvature=_convex(hessian),
            row_bounds=self._row_bounds,
            cones=self._cones,
            lowest=np.maximum(self._variable_bounds.lower - x, -widest),
            highest=np.minimum(self._variable_bounds.upper - x, widest),
            penalty=self._penalty,
        )


def _convex(hessian: Floats) -> Floats:
    """Return the positive semidefinite matrix nearest to a symmetric one."""
    active = np.nonzero(hessian.any(axis=1))[0]
    convex = np.zeros_like(hessian)
    values, vectors = np.linalg.eigh(hessian[np.ix_(active, active)])
    convex[np.ix_(active, active)] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return convex
