"""Shadowing at scattered places: exactly by a Cholesky factor, or as an addition to a lattice."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import lower_factor, solve_lower
from planopt.channel.kernel import pairwise_distance_m
from planopt.channel.places import require_places, require_shadowing
from planopt.errors import InputError

MAX_PLACES = 8_000
"""A factor of more rows would not fit the memory of a small machine."""

NUGGET = 1e-8
"""Share of xi^2 that keeps places that nearly coincide from breaking a factor: deviations of 1e-4
xi between them. Places that coincide share their value exactly."""

STENCIL = 4
"""Lattice nodes along a side of the square about a place that its value is drawn from."""

EARLIER = 16
"""Places drawn before that a place's value is drawn from, the nearest ones."""


def scattered_field_db(
    positions_m: ArrayLike,
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw shadowing of covariance xi^2 exp(-d / beta) at any places (equation 1.2).

    Parameters
    ----------
    positions_m
        ``(n, 2)``, repeated ones included.
    shadow_std_db, decorrelation_m
        xi and beta.
    generator
        Source of randomness.

    Returns
    -------
    NDArray
        ``(n,)`` in dB.

    Raises
    ------
    InputError
        A deviation, a distance or a place is none, or there are more than `MAX_PLACES` different
        places.
    """
    require_shadowing(shadow_std_db, decorrelation_m)
    places, back = _distinct(require_places(positions_m, at_least=0))
    if len(places) > MAX_PLACES:
        raise InputError(
            f"{len(places)} places are too many for an exact field",
            remedy=f"use at most {MAX_PLACES}, or a field on a lattice",
        )
    factor = lower_factor(_correlation(places, decorrelation_m))
    return shadow_std_db * (factor @ generator.standard_normal(len(places)))[back]


def added_to_lattice_db(
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    field_db: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    shadow_std_db: float,
    decorrelation_m: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw shadowing at places, given a field already drawn on a lattice.

    Each value is drawn given the lattice nodes about it and the nearest earlier places. With the
    exponential covariance nearer values screen farther ones, so that this is all but exact within
    the lattice; outside it correlation with nodes far from the nearest border is neglected.

    Parameters
    ----------
    x_m, y_m
        ``(nx,)`` and ``(ny,)``, even.
    field_db
        ``(ny, nx)`` of deviation xi.
    positions_m
        ``(n, 2)``, repeated ones included.
    shadow_std_db, decorrelation_m
        xi and beta.
    generator
        Source of randomness.

    Returns
    -------
    NDArray
        ``(n,)`` in dB.
    """
    places, back = _distinct(positions_m)
    columns, rows = _stencil(x_m, places[:, 0]), _stencil(y_m, places[:, 1])
    noise = generator.standard_normal(len(places))
    values = np.empty(len(places))
    for index, place in enumerate(places):
        east, north = np.meshgrid(x_m[columns[index]], y_m[rows[index]])
        nodes = np.column_stack([east.ravel(), north.ravel()])
        near = ((places[:index] - place) ** 2).sum(axis=1).argsort()[:EARLIER]
        there = np.concatenate([nodes, places[near]])
        known = np.concatenate(
            [field_db[np.ix_(rows[index], columns[index])].ravel(), values[near]]
        )
        factor = lower_factor(_correlation(there, decorrelation_m))
        across = np.exp(-pairwise_distance_m(there, place[None]) / decorrelation_m)[:, 0]
        whitened = solve_lower(factor, np.column_stack([known, across]))
        mean = whitened[:, 0] @ whitened[:, 1]
        variance = max(0.0, 1.0 - float(whitened[:, 1] @ whitened[:, 1]))
        values[index] = mean + shadow_std_db * np.sqrt(variance) * noise[index]
    return values[back]


def _distinct(positions_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Each place once, and where every position is among them."""
    places, back = np.unique(
        np.asarray(positions_m, dtype=np.float64).reshape(-1, 2), axis=0, return_inverse=True
    )
    return places, back.reshape(-1)


def _correlation(places_m: NDArray[np.float64], decorrelation_m: float) -> NDArray[np.float64]:
    """exp(-d / beta) with the nugget on its diagonal; (n, n)."""
    correlation = np.exp(-pairwise_distance_m(places_m, places_m) / decorrelation_m)
    correlation[np.diag_indices_from(correlation)] += NUGGET
    return correlation


def _stencil(axis_m: NDArray[np.float64], at_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices of the `STENCIL` nodes about each coordinate; fewer on a short axis, (n, size)."""
    size = min(STENCIL, len(axis_m))
    first = np.searchsorted(axis_m, at_m) - size // 2
    return np.clip(first, 0, len(axis_m) - size)[:, None] + np.arange(size)
