# pyright: basic
"""Minimisers with types: the boundary to SciPy's optimisers, which ship none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Vector = NDArray[np.float64]


def minimise_in_box(
    objective: Callable[[Vector], tuple[float, Vector]], start: Vector, lower: Vector, upper: Vector
) -> tuple[float, Vector]:
    """L-BFGS-B: the least value found and where.

    Parameters
    ----------
    objective
        Value and gradient at a point (k,).
    start
        ``(k,)``; moved into the box.
    lower, upper
        ``(k,)`` corners of the box.
    """
    found = minimize(
        objective,
        np.clip(start, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(lower, upper, strict=True)),
        options={"ftol": 1e-9, "gtol": 1e-4, "maxiter": 100},
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)


def minimise_from_simplex(
    objective: Callable[[Vector], float], simplex: Vector, tolerance: float
) -> tuple[float, Vector]:
    """Nelder-Mead: the least value found and where.

    Parameters
    ----------
    objective
        Value at a point (k,).
    simplex
        ``(k + 1, k)`` corners of the first simplex.
    tolerance
        In the point's units.
    """
    found = minimize(
        objective,
        simplex[0],
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": tolerance, "fatol": 1e-3},
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)
