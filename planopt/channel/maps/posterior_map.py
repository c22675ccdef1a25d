"""The posterior on a grid, computed once, and at fixed places, updated with each measurement.

Kriging on a grid is sooner than place by place, because rows and columns share their coordinate
differences.

At fixed places a new measurement adds one more row of L^-1 Phi. The rows so far are kept, so that a
row costs one product with them, and no factor and no earlier row is touched. The price is memory,
``8 kappa n`` bytes; :class:`planopt.channel.maps.tile_map.TileMap` needs less and is faster, but
uses the nearest measurements only. If the channel forgets, the rows are those of the time when they
were begun: all measurements age by the same factor, so that a later time is a multiple of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import spacious, whiten
from planopt.channel.kriging import MANY_PLACES, predict
from planopt.channel.maps.many_places import PLACES_AT_ONCE, RowWhitener
from planopt.channel.measurement_covariance import (
    covariance_db2,
    covariance_over_db2,
    fading,
    place_origins,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.nearby import predict_nearby
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import regressors
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine, connection_probability
from planopt.errors import InputError
from planopt.parts import part_of
from planopt.short_repr import short_repr
from planopt.world.raster import Raster, cell_centres_m


def predict_grid(
    posterior: ChannelPosterior, x_m: NDArray[np.float64], y_m: NDArray[np.float64]
) -> Prediction:
    """Mean and deviation at all places of a grid; what `predict` gives, sooner."""
    # Shapes: x_m, y_m (nx,); returns (ny, nx).
    shape = (len(y_m), len(x_m))
    places = np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)
    known = len(posterior.measurements)
    if len(places) < MANY_PLACES or not known or not posterior.has_factor:
        found = predict(posterior, places)
        return Prediction(found.mean_db.reshape(shape), found.deviation_db.reshape(shape))
    parameters, measured = posterior.parameters, posterior.origins
    # All are of the same time and have no position error; which one it is does not matter.
    anywhere = place_origins(places[:1], posterior.now_s, parameters)
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    whitener = RowWhitener(posterior.factor, columns)
    square_x = (np.asarray(x_m)[:, None] - measured.positions_m[:, 0]) ** 2
    square_y = (np.asarray(y_m)[:, None] - measured.positions_m[:, 1]) ** 2
    if measured.blur_m2 is not None:
        square_y += measured.blur_m2
    projected, explained = np.empty((3, *shape)), np.empty(shape)
    across = min(shape[1], PLACES_AT_ONCE)
    along = max(1, PLACES_AT_ONCE // across)
    spare = np.empty((along, across, known))
    for left in range(0, shape[1], across):
        for low in range(0, shape[0], along):
            part = np.s_[low : low + along, left : left + across]
            size = explained[part].shape
            square = np.add(
                square_y[part[0], None], square_x[None, part[1]], out=spare[: size[0], : size[1]]
            )
            # A last block that is narrower is copied, the others are not.
            distance = np.sqrt(square, out=square).reshape(-1, known)
            rows = covariance_over_db2(distance, anywhere, measured, parameters)
            found, said = whitener.reduce(rows)
            projected[:, *part], explained[part] = found.reshape(3, *size), said.reshape(size)
    trend = regressors(places, parameters.station).reshape(*shape, 2)
    trend -= np.moveaxis(projected[1:], 0, -1)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    terms = KrigingTerms(projected[0], trend, latent + parameters.multipath_std_db**2)
    return combine(terms, posterior.theta, posterior.theta_covariance)


Bounds = tuple[float, float, float, float]

CELLS_ALONG = 200
"""Cells along the longer side of a map whose cell is not given."""

MAX_CELLS = 4_000_000

EXACT_OPERATIONS = 2e11
"""All measurements are used while their squared number times the cells is below this: seconds."""

NEIGHBOURS = 256
"""Beyond that each cell uses at least this many of the nearest. On the three campus logs (4,193 to
5,006 measurements, up to 869 of them censored) the mean is then off by 0.003 dB on average and
0.25 dB at most, the deviation by 0.06 % at most; without a factor, where theta and sites are from
neighbours too, by 0.022 dB, 0.26 dB and 0.6 %. The deviation is some 7.5 dB."""


@dataclass(frozen=True, eq=False)
class PosteriorMap:
    """Predicted power on a grid.

    Attributes
    ----------
    mean_db
        Predicted power in dBm.
    deviation_db
        Its deviation, as in :class:`planopt.channel.prediction.Prediction`.
    connectivity
        P(power >= `threshold_dbm`).
    threshold_dbm
        Upsilon_TH.
    posterior
        ``exact``, or ``neighbours:256`` where the nearest measurements were used.
    """

    mean_db: Raster
    deviation_db: Raster
    connectivity: Raster
    threshold_dbm: float
    posterior: str

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return the map as an ``xarray.Dataset`` with the coordinates ``y_m`` and ``x_m``.

        The variables are ``mean_dbm``, ``deviation_db`` and ``connectivity``, with their units; the
        threshold and the kind of posterior are attributes of the dataset.

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
            "mean_dbm": (self.mean_db, "dBm", "predicted received power"),
            "deviation_db": (self.deviation_db, "dB", "standard deviation of the prediction"),
            "connectivity": (self.connectivity, "1", "probability of connection"),
        }
        return xarray.Dataset(
            {
                name: (axes, raster.values, {"units": units, "long_name": words})
                for name, (raster, units, words) in layers.items()
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
    """Predict on a grid (equation 1.8).

    Parameters
    ----------
    posterior
        The channel given measurements.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left.
    cell_m
        Cell side.
    threshold_dbm
        Upsilon_TH.

    Raises
    ------
    InputError
        The posterior is none, the bounds are not ordered, the cell is not positive, there would be
        too many cells, or the threshold is not finite.
    """
    remedy = "give a ChannelPosterior, such as run.belief.posterior"
    part_of("posterior", posterior, ChannelPosterior, remedy)
    bounds_m = _bounds(bounds_m)
    x_min, y_min, x_max, y_max = bounds_m
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
    if exact:
        prediction = predict_grid(posterior, x, y)
    else:
        cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        prediction = predict_nearby(posterior, cells, NEIGHBOURS)
    mean = prediction.mean_db.reshape(y.size, x.size)
    deviation = prediction.deviation_db.reshape(y.size, x.size)
    return PosteriorMap(
        Raster(x, y, mean),
        Raster(x, y, deviation),
        Raster(x, y, connection_probability(mean, deviation, threshold_dbm)),
        threshold_dbm,
        "exact" if exact else f"neighbours:{NEIGHBOURS}",
    )


def _bounds(given: object) -> Bounds:
    """Return bounds as four numbers."""
    try:
        x_min, y_min, x_max, y_max = np.asarray(given, dtype=np.float64).tolist()
    except (TypeError, ValueError):
        raise InputError(
            f"is {given!r}",
            key="bounds_m",
            remedy="give (x_min, y_min, x_max, y_max), such as problem.workspace.bounds_m",
        ) from None
    return x_min, y_min, x_max, y_max


def default_cell_m(bounds_m: Bounds) -> float:
    """Cell side with `CELLS_ALONG` cells along the longer side, of two digits."""
    x_min, y_min, x_max, y_max = bounds_m
    return float(f"{max(x_max - x_min, y_max - y_min) / CELLS_ALONG:.2g}")


def measured_bounds_m(measurements: Measurements) -> Bounds:
    """The box around the measurements, widened where they stand on a line along an axis."""
    low, high = measurements.positions_m.min(axis=0), measurements.positions_m.max(axis=0)
    least = 2.0 * (high - low).max() / CELLS_ALONG
    widening = np.maximum(least - (high - low), 0.0) / 2.0
    (x_min, y_min), (x_max, y_max) = low - widening, high + widening
    return float(x_min), float(y_min), float(x_max), float(y_max)


COLUMNS = 4096
"""Places worked on at once."""

LEAST_FADING = 1e-3
"""Rows are computed anew, for the present, once they have faded to this share."""


class CachedMap:
    """Predictions at fixed places that follow a growing posterior exactly.

    Parameters
    ----------
    positions_m
        ``(n, 2)`` where to predict.

    Raises
    ------
    InputError
        Positions are not ``(n, 2)`` and finite.
    """

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        self._places_m = require_places(positions_m)
        # All its measurements are counted.
        self._last: ChannelPosterior | None = None
        self._rows: NDArray[np.float64] = np.zeros((0, len(self._places_m)))
        self._path_loss: NDArray[np.float64] = np.zeros((2, 0))
        self._begun_s = 0.0
        # What the rows, of the time when they were begun, say of y, of Gamma and of the variance.
        self._data: NDArray[np.float64] = np.zeros(0)
        self._projected: NDArray[np.float64] = np.zeros((2, 0))
        self._explained: NDArray[np.float64] = np.zeros(0)

    def refresh(self, posterior: ChannelPosterior) -> Prediction:
        """Predict from `posterior`, as :func:`planopt.channel.kriging.predict` does.

        Parameters
        ----------
        posterior
            Usually the last one extended, which costs O(kappa n) for each new measurement;
            anything else is computed from nothing, O(kappa^2 n).
        """
        parameters = posterior.parameters
        before = 0 if self._last is None else len(self._last.measurements)
        faded = fading(
            posterior.measurements.time_s[:before], self._begun_s, posterior.now_s, parameters
        )
        if (
            self._last is None
            or faded is None
            or faded < LEAST_FADING
            or not posterior.continues(self._last)
        ):
            before, faded = 0, 1.0
            self._start(posterior)
        self._append(posterior, before, faded)
        self._last = posterior
        variance = float(parameters.shadow_std_db) ** 2 - faded**2 * self._explained
        terms = KrigingTerms(
            faded * self._data,
            (self._path_loss - faded * self._projected).T,
            # Rounding alone can make the latent variance negative, at a place known exactly.
            np.maximum(variance, 0.0) + parameters.multipath_std_db**2,
        )
        return combine(terms, posterior.theta, posterior.theta_covariance)

    def _start(self, posterior: ChannelPosterior) -> None:
        """Begin without measurements."""
        count = len(self._places_m)
        self._begun_s = posterior.now_s
        station = posterior.parameters.station
        self._path_loss = np.ascontiguousarray(regressors(self._places_m, station).T)
        self._data = np.zeros(count)
        self._projected = np.zeros((2, count))
        self._explained = np.zeros(count)

    def _append(self, posterior: ChannelPosterior, before: int, faded: float) -> None:
        """Add the rows of L^-1 Phi from `before` on, and what they tell.

        `faded` is what kept rows have to be multiplied by to be of the present.
        """
        count = len(posterior.measurements)
        if len(self._rows) < count:
            grown = np.empty((spacious(count), len(self._places_m)))
            grown[:before] = self._rows[:before]
            self._rows = grown
        lower = posterior.factor
        across, within = lower[before:, :before], lower[before:, before:]
        values = posterior.whitened_values[before:]
        columns = posterior.whitened_regressors[before:].T
        origins = posterior.origins.at(slice(before, None))
        for start in range(0, len(self._places_m) if count > before else 0, COLUMNS):
            part = slice(start, start + COLUMNS)
            places = place_origins(self._places_m[part], posterior.now_s, posterior.parameters)
            new = covariance_db2(origins, places, posterior.parameters)
            if faded != 1.0:
                new /= faded
            new -= across @ self._rows[:before, part]
            new = whiten(within, new)
            self._rows[before:count, part] = new
            self._data[part] += values @ new
            self._projected[:, part] += columns @ new
            self._explained[part] += np.einsum("ij,ij->j", new, new)
