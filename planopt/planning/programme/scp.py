"""Sequential convex programming: the same programmes as IPOPT's, by convex steps in a trust region.

Speeds, and discs of inputs and states, are kept as second-order cones; every other row is
linearised and may be missed at a price (exact penalty), so that a step always exists; the curvature
of the Lagrangian is made positive semidefinite. A step is taken for what it brings of what the
model promised (trust region and penalty as in section 18.5 of [NW06]).
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Termination
from planopt.planning.programme.cone_rows import ConeRows
from planopt.planning.programme.convex_step import Model, Step, convex_step
from planopt.planning.programme.kkt import Bounds
from planopt.planning.programme.nlp_functions import NlpFunctions
from planopt.planning.programme.nlp_point import NlpPoint, SolveNlp, lost_point, nlp_point

MAX_ITERATIONS = 60
"""Convex steps of a solve, those not taken included."""

FIRST_PENALTY, LARGEST_PENALTY = 1e2, 1e6
"""What a missing unit of a row counts at first, and when the rows are given up."""

PENALTY_FACTOR = 10.0
"""Growth of that price where the rows are not met."""

TAKEN_SHARE, GOOD_SHARE = 0.1, 0.75
"""A step is taken that brings the first share of what was promised; from the second on the region
grows."""

SHRINK, GROW = 0.25, 2.0
"""What the region is then multiplied by."""

PROMISE_TOLERANCE = 1e-6
"""Converged where the model promises no more than this share of the objective (or of 1)."""

ROW_TOLERANCE = 1e-6
"""Rows are met to this, as IPOPT's."""

SMALLEST_REGION = 1e-7
"""Converged where the region is smaller, in longest steps."""


def scp_solve(
    functions: NlpFunctions,
    horizon: int,
    cones: ConeRows,
    per_m: NDArray[np.float64],
    longest_m: float | None = None,
    budget_s: float | None = None,
) -> SolveNlp:
    """Solve a programme whose first variables are the positions of `horizon` stages.

    Parameters
    ----------
    functions
        Of the programme.
    horizon
        N.
    cones
        Which of its rows are cones.
    per_m
        ``(n,)`` how far each variable may go in a convex step for each metre of a place; infinite
        where it follows from others.
    longest_m
        Of the path's steps; None where the first row has it, squared, as its upper bound.
    budget_s
        Seconds after which no new convex step begins; None for no limit.
    """

    def solve(
        start: NDArray[np.float64],
        parameters: NDArray[np.float64],
        variable_bounds: Bounds,
        row_bounds: Bounds,
    ) -> NlpPoint:
        bounds = (variable_bounds.lower, variable_bounds.upper, row_bounds.lower, row_bounds.upper)
        if any(np.isnan(bound).any() for bound in bounds):
            return lost_point(horizon, len(start), len(row_bounds.lower))
        longest = float(np.sqrt(row_bounds.upper[0])) if longest_m is None else longest_m
        reach = longest * per_m
        climb = _Climb(functions, horizon, cones, reach, parameters, variable_bounds, row_bounds)
        return climb.run(start, np.inf if budget_s is None else perf_counter() + budget_s)

    return solve


class _Climb:
    """One solve: where it is, and what it knows there."""

    def __init__(
        self,
        functions: NlpFunctions,
        horizon: int,
        cones: ConeRows,
        reach: NDArray[np.float64],
        parameters: NDArray[np.float64],
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

    def run(self, start: NDArray[np.float64], until: float) -> NlpPoint:
        """Step until nothing is promised any more, or until a time of `perf_counter`."""
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
            promised = self._promised(model, found.step)
            if promised <= PROMISE_TOLERANCE * max(1.0, abs(value)) or region < SMALLEST_REGION:
                last = found
                if self._missing(rows) <= ROW_TOLERANCE:
                    termination = Termination.CONVERGED
                    break
                if self._penalty >= LARGEST_PENALTY:
                    termination = Termination.INFEASIBLE
                    break
                self._penalty *= PENALTY_FACTOR
                region = max(region, SHRINK)
                model = self._model(x, rows, last.row_multipliers, region)
                continue
            tried = x + found.step
            new_value, new_rows = self._at(tried)
            merit = self._merit(value, rows)
            share = self._share(merit, new_value, new_rows, promised)
            if share < TAKEN_SHARE and np.isfinite(new_rows).all():
                again = self._corrected(model, found.step, new_rows)
                if again.usable:
                    tried = x + again.step
                    new_value, new_rows = self._at(tried)
                    share = self._share(merit, new_value, new_rows, promised)
                    found = again
            if share >= TAKEN_SHARE:
                x, value, rows = tried, new_value, new_rows
                last = found
            region *= GROW if share >= GOOD_SHARE else 1.0 if share >= TAKEN_SHARE else SHRINK
            model = self._model(x, rows, last.row_multipliers, region)
        multipliers = last.row_multipliers, last.variable_multipliers
        return nlp_point(self._horizon, x, *multipliers, termination, iterations)

    def _share(
        self, merit: float, value: float, rows: NDArray[np.float64], promised: float
    ) -> float:
        """How much of what was promised a point brings."""
        gained = merit - self._merit(value, rows)
        return gained / promised if np.isfinite(gained) else -np.inf

    def _corrected(
        self, model: Model, step: NDArray[np.float64], rows: NDArray[np.float64]
    ) -> Step:
        """The step again, with how far rows curve away from their linear models on it.

        Along curved rows that the solution lies on, plain steps would all be refused (second-order
        correction against the effect of Maratos, Nocedal and Wright 18.3).
        """
        there = rows - model.jacobian @ step
        there[self._cones.row] = model.rows[self._cones.row]
        return convex_step(replace(model, rows=there))

    def _at(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        return self._functions.values(x, self._parameters)

    def _excess(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """By how much each row but the cones misses its bounds."""
        lower, upper = self._row_bounds.lower, self._row_bounds.upper
        return np.delete(np.maximum(np.maximum(lower - rows, rows - upper), 0.0), self._cones.row)

    def _missing(self, rows: NDArray[np.float64]) -> float:
        return float(self._excess(rows).max(initial=0.0))

    def _merit(self, value: float, rows: NDArray[np.float64]) -> float:
        return value + self._penalty * float(self._excess(rows).sum())

    def _promised(self, model: Model, step: NDArray[np.float64]) -> float:
        """How much less the merit is at the end of a step, if the model is right."""
        slope = float(model.gradient @ step + 0.5 * step @ (model.curvature @ step))
        rows = model.rows + model.jacobian @ step
        before, after = self._excess(model.rows).sum(), self._excess(rows).sum()
        return -slope + self._penalty * float(before - after)

    def _model(
        self,
        x: NDArray[np.float64],
        rows: NDArray[np.float64],
        multipliers: NDArray[np.float64],
        region: float,
    ) -> Model:
        """What is known at x, within a region in longest steps."""
        curving = multipliers.copy()
        curving[self._cones.row] = 0.0
        widest = region * self._reach
        gradient, jacobian, hessian = self._functions.derivatives(x, self._parameters, curving)
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


def _convex(hessian: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest positive semidefinite matrix; zero rows are left out of its eigenvectors."""
    active = np.nonzero(hessian.any(axis=1))[0]
    convex = np.zeros_like(hessian)
    values, vectors = np.linalg.eigh(hessian[np.ix_(active, active)])
    convex[np.ix_(active, active)] = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return convex
