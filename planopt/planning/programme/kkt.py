"""Unscaled first-order residual of the reach programme, from closed forms in NumPy.

Nothing here comes from CasADi: gradients are written out again, so that a wrong derivative in the
programme shows as a residual. Sign convention: with rows g between bounds and variables x between
bounds, ``grad f + J' lambda_g + lambda_x = 0``, multipliers positive at an active upper bound and
negative at an active lower bound.

Multipliers of a programme's rows by the names of the rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of rows or variables."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


def kkt_residual(
    gradient: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    rows: NDArray[np.float64],
    row_bounds: Bounds,
    row_multipliers: NDArray[np.float64],
    variables: NDArray[np.float64],
    variable_bounds: Bounds,
    variable_multipliers: NDArray[np.float64],
) -> float:
    """Largest of stationarity, primal violation, wrong sign and complementarity, unscaled.

    Infinite where any of them is not a number.

    Parameters
    ----------
    gradient, jacobian
        Of the objective ``(n,)`` and of the rows ``(m, n)`` at the point.
    rows, row_bounds, row_multipliers
        Values ``(m,)``, their bounds, their multipliers.
    variables, variable_bounds, variable_multipliers
        The same for the variables; fixed ones (equal bounds) are left out of stationarity, because
        their multiplier is free.
    """
    free = variable_bounds.lower < variable_bounds.upper
    stationarity = gradient + jacobian.T @ row_multipliers + variable_multipliers
    parts = [np.abs(stationarity[free])]
    for value, bounds, multiplier in (
        (rows, row_bounds, row_multipliers),
        (variables, variable_bounds, variable_multipliers),
    ):
        below, above = value - bounds.lower, bounds.upper - value
        parts += [np.maximum(-below, 0.0), np.maximum(-above, 0.0)]
        # A multiplier may only push against the bound that it touches.
        parts += [np.maximum(multiplier, 0.0) * _gap(above)]
        parts += [np.maximum(-multiplier, 0.0) * _gap(below)]
    # NumPy's maximum: Python's would lose a NaN, and a point without a residual would look exact.
    worst = float(np.concatenate(parts).max(initial=0.0))
    return worst if np.isfinite(worst) else float("inf")


def _gap(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance to a bound; a missing bound counts as one unit away, so that 0 * inf is no NaN."""
    return np.where(np.isfinite(distance), np.abs(distance), 1.0)


def named_multipliers(
    rows: NDArray[np.float64], horizon: int, lines: int, bounds: int
) -> dict[str, NDArray[np.float64]]:
    """Those of :mod:`~planopt.planning.programme.path_rows`, which come first, and of connectivity.

    Parameters
    ----------
    rows
        Of all rows, in the programme's order.
    horizon, lines
        N, and separating lines a segment.
    bounds
        How many rows bound connectivity, the last ones.
    """
    speed, line_end, line_start = np.split(
        rows[: horizon * (1 + 2 * lines) - lines], [horizon, horizon * (1 + lines)]
    )
    found = {
        "speed": speed,
        "line_end": line_end.reshape(horizon, lines),
        "line_start": line_start.reshape(horizon - 1, lines),
    }
    return found | ({"connectivity": rows[len(rows) - bounds :]} if bounds else {})
