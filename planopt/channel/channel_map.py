"""Map of the posterior: mean, standard deviation and probability of connection on a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

import numpy as np

from planopt.channel.cholesky import one_blas_thread
from planopt.channel.kriging import predict_nearby
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.parts import part_of
from planopt.short_repr import short_repr
from planopt.world.raster import Raster, cell_centres_m

Bounds = tuple[float, float, float, float]

CELLS_ALONG = 200
"""Default number of cells along the longer side."""

MAX_CELLS = 4_000_000

EXACT_OPERATIONS = 2e11
"""Maximum product of squared number of measurements and cells for an exact map."""

NEIGHBOURS = 256
"""Minimum number of nearest measurements per cell of an approximate map. On the three campus logs
(4,193 to 5,006 measurements, up to 869 censored) the mean's error is 0.003 dB on average and at
most 0.25 dB, that of the standard deviation (7.5 dB) at most 0.06 %. Without a factor, with theta
and sites from neighbours too, they are 0.022 dB, 0.26 dB and 0.6 %."""


@dataclass(frozen=True, eq=False)
class PosteriorMap:
    """Predicted power and probability of connection on a grid.

    Attributes
    ----------
    mean_db
        Predicted power in dBm.
    deviation_db
        Standard deviation of the power, as in :class:`planopt.channel.Prediction`.
    connectivity
        Probability of connection, P(power >= `threshold_dbm`).
    threshold_dbm
        Minimum power Upsilon_TH for a connection.
    posterior
        Kind of posterior: ``exact``, or ``neighbours:256`` if it used the nearest measurements.
    """

    mean_db: Raster
    deviation_db: Raster
    connectivity: Raster
    threshold_dbm: float
    posterior: str

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return the map as an ``xarray.Dataset`` with the coordinates ``y_m`` and ``x_m``.

        The variables ``mean_dbm``, ``deviation_db`` and ``connectivity`` have units. The threshold
        and the kind of posterior are attributes of the dataset.

        Raises
        ------
        InputError
            xarray is not installed.
        """
        try:
            xarray = import_module("xarray")
        except ImportError:
            raise InputError(
                "xarray is not installed", remedy="install it, or planopt[xarray]"
            ) from None
        axes = ("y_m", "x_m")
        layers = {
            "mean_dbm": self.mean_db,
            "deviation_db": self.deviation_db,
            "connectivity": self.connectivity,
        }
        return xarray.Dataset(
            {
                name: (axes, each.values, {"units": each.unit, "long_name": each.quantity})
                for name, each in layers.items()
            },
            coords={
                "x_m": ("x_m", self.mean_db.x_m, {"units": "m"}),
                "y_m": ("y_m", self.mean_db.y_m, {"units": "m"}),
            },
            attrs={"threshold_dbm": self.threshold_dbm, "posterior": self.posterior},
        )


@one_blas_thread()
def posterior_map(
    posterior: ChannelPosterior, bounds_m: Bounds, cell_m: float, threshold_dbm: float
) -> PosteriorMap:
    """Predict power and connectivity on a grid (equation 1.8).

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left corner.
    cell_m
        Cell side in metres.
    threshold_dbm
        Minimum power Upsilon_TH for a connection.

    Raises
    ------
    InputError
        The posterior is not a ChannelPosterior, the bounds are not ordered, the cell side is not
        positive, there are too many cells, or the threshold is not finite.

    Examples
    --------
    >>> from planopt.channel import ChannelParameters, Measurements, Station
    >>> from planopt.channel import condition, posterior_map
    >>> channel = ChannelParameters(-40.0, 2.0, 4.0, 10.0, 1.0, Station((0.0, 0.0)))
    >>> measured = Measurements([[10.0, 5.0], [20.0, 9.0]], [-61.0, -70.0])
    >>> found = posterior_map(condition(channel, measured), (0, 0, 40, 20), 1.0, -65.0)
    >>> found.mean_db.values.shape
    (20, 40)
    """
    remedy = "give a ChannelPosterior, such as run.belief.posterior"
    part_of("posterior", posterior, ChannelPosterior, remedy)
    try:
        x_min, y_min, x_max, y_max = np.asarray(bounds_m, dtype=np.float64).tolist()
    except (TypeError, ValueError):
        raise InputError(
            f"is {bounds_m!r}",
            key="bounds_m",
            remedy="give (x_min, y_min, x_max, y_max), such as problem.workspace.bounds_m",
        ) from None
    bounds_m = x_min, y_min, x_max, y_max
    for key, value in (("cell_m", cell_m), ("threshold_dbm", threshold_dbm)):
        real = isinstance(cast("object", value), int | float | np.integer | np.floating)
        if not real or isinstance(cast("object", value), bool):
            raise InputError(f"is {value!r}", key=key, remedy="give a number, e.g. 1.0 or -80.0")
    if not (np.isfinite(bounds_m).all() and x_min < x_max and y_min < y_max):
        raise InputError(f"{bounds_m} are not bounds", key="bounds_m", remedy="write x0,y0,x1,y1")
    if not (cell_m > 0.0 and math.isfinite(cell_m)):
        raise InputError(
            f"{cell_m:g} is not a cell side", key="cell_m", remedy="use metres above 0"
        )
    if max(1.0, (x_max - x_min) / cell_m) * max(1.0, (y_max - y_min) / cell_m) > MAX_CELLS:
        raise InputError(
            f"cells of {cell_m:g} m would be more than {MAX_CELLS:,}",
            key="cell_m",
            remedy="use larger cells or smaller bounds",
        )
    if not math.isfinite(threshold_dbm):
        raise InputError(f"{threshold_dbm:g} is not a power", key="threshold_dbm", remedy="use dBm")
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    count = len(posterior.measurements)
    few = count <= NEIGHBOURS or count**2 * x.size * y.size <= EXACT_OPERATIONS
    exact = posterior.has_factor and few
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    prediction = posterior.predict(cells) if exact else predict_nearby(posterior, cells, NEIGHBOURS)
    mean = prediction.mean_db.reshape(y.size, x.size)
    deviation = prediction.deviation_db.reshape(y.size, x.size)
    connected = connection_probability(mean, deviation, threshold_dbm)
    return PosteriorMap(
        Raster(x, y, mean, "predicted received power", "dBm"),
        Raster(x, y, deviation, "standard deviation of the prediction", "dB"),
        Raster(x, y, connected, "probability of connection", "1"),
        threshold_dbm,
        "exact" if exact else f"neighbours:{NEIGHBOURS}",
    )


def default_cell_m(bounds_m: Bounds) -> float:
    """Return the cell side, rounded to two digits, for `CELLS_ALONG` cells on the longer side."""
    x_min, y_min, x_max, y_max = bounds_m
    return float(f"{max(x_max - x_min, y_max - y_min) / CELLS_ALONG:.2g}")


def measured_bounds_m(measurements: Measurements) -> Bounds:
    """Return the bounding box of the measurements, widened if they lie on a line."""
    low, high = measurements.positions_m.min(axis=0), measurements.positions_m.max(axis=0)
    least = 2.0 * (high - low).max() / CELLS_ALONG
    widening = np.maximum(least - (high - low), 0.0) / 2.0
    (x_min, y_min), (x_max, y_max) = low - widening, high + widening
    return float(x_min), float(y_min), float(x_max), float(y_max)
