"""Path loss: the mean of the received power, linear in theta = (K_PL, n_PL)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import Station

MIN_DISTANCE_M = 0.1
"""Distances to the station are not taken below this, so that the logarithm stays finite."""


def station_distance_m(positions_m: NDArray[np.float64], station: Station) -> NDArray[np.float64]:
    """Three-dimensional distance to the station, at least `MIN_DISTANCE_M`; (n, 2) -> (n,)."""
    offset = positions_m - np.asarray(station.position_m)
    square = np.einsum("...i,...i->...", offset, offset)
    return np.sqrt(np.maximum(square + station.height_m**2, MIN_DISTANCE_M**2))


def regressors(positions_m: NDArray[np.float64], station: Station) -> NDArray[np.float64]:
    """Return the rows gamma(q) = [1, -10 log10 d(q)] of equation 1.1; (n, 2) -> (n, 2)."""
    rows = np.ones(np.shape(positions_m))
    rows[..., 1] = -10.0 * np.log10(station_distance_m(positions_m, station))
    return rows
