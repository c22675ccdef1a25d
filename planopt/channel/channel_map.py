"""Posterior maps of received power, on a user's grid or on a planner's lattice.

In :class:`TileMap` the nodes of a square tile share the measurements nearest to its centre. A new
measurement changes only nearby tiles: two rank-one updates put it in place of the farthest one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.connectivity_law import above_thresholds_db, any_probability, serving_power_dbm
from planopt.channel.kriging import (
    KrigingTerms,
    LocalChannel,
    Prediction,
    combine,
    connection_probability,
    kriging_terms,
    predict_nearby,
)
from planopt.channel.long_logs import offsets_given_theta
from planopt.channel.measurements import (
    Measurements,
    covariance_db2,
    own_variance_db2,
    place_origins,
)
from planopt.channel.parameters import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError, path_of
from planopt.parts import part_of
from planopt.short_repr import short_repr
from planopt.world.geodesy import Origin, require_origin
from planopt.world.raster import Raster, cell_centres_m
from planopt.world.raster_files import write_rasters

TILES_AT_ONCE = 64  # Number of tiles solved together, such that their matrices fit into cache
REPLACEMENTS_BEFORE_REBUILD = 32
"""Maximum number of updates before a tile is recomputed, to limit rounding errors."""


class TileMap:
    """Map of predicted power and standard deviation on a lattice, updated by measurements."""

    # Memory is about ``8 neighbours (neighbours + tile**2)`` bytes per tile.

    def __init__(
        self, x_m: Floats, y_m: Floats, needed: Mask, tile: int = 5, neighbours: int = 32
    ) -> None:
        self._neighbours = neighbours
        self.mean_db: Floats = np.full(needed.shape, np.nan)
        self.deviation_db: Floats = np.full(needed.shape, np.nan)
        rows, columns = np.nonzero(needed)
        across = -(-needed.shape[1] // tile)
        kept, tile_of_node = np.unique(
            (rows // tile) * across + columns // tile, return_inverse=True
        )
        # Tiles that exceed the lattice repeat its last row or column.
        inside = np.arange(tile)
        tile_rows = np.minimum((kept // across)[:, None] * tile + inside, len(y_m) - 1)
        tile_columns = np.minimum((kept % across)[:, None] * tile + inside, len(x_m) - 1)
        places = np.empty((len(kept), tile, tile, 2))
        places[..., 0] = np.asarray(x_m, dtype=np.float64)[tile_columns][:, None, :]
        places[..., 1] = np.asarray(y_m, dtype=np.float64)[tile_rows][:, :, None]
        self._places_m = places.reshape(len(kept), tile * tile, 2)
        self._centres_m = self._places_m.mean(axis=1)
        self._lattice_index = rows * needed.shape[1] + columns
        self._tile_index = (tile_of_node * tile + rows % tile) * tile + columns % tile
        # Each term is a contiguous plane: without new data, a refresh mostly combines terms.
        planes = np.full((4, len(kept), tile * tile), np.nan)
        self._terms = KrigingTerms(planes[0], np.moveaxis(planes[1:3], 0, -1), planes[3])
        self._reach_m2: Floats = np.full(len(kept), np.inf)
        self._dirty: Mask = np.ones(len(kept), dtype=bool)
        self._replacements: Indices = np.zeros(len(kept), dtype=np.intp)
        self._indices: Indices = np.zeros((0, 0), dtype=np.intp)
        self._precision: Floats = np.zeros((0, 0, 0))
        self._across: Floats = np.zeros((0, 0, 0))
        # The posterior of the last refresh.
        self._last: ChannelPosterior | None = None

    def refresh(
        self,
        posterior: ChannelPosterior,
        window_m: tuple[float, float, float, float] | None = None,  # (x_min, y_min, x_max, y_max)
    ) -> int:
        """Update all tiles, or those that meet a window; return the number of updated tiles."""
        wanted = np.ones(len(self._dirty), dtype=bool)
        if window_m is not None:
            x_min, y_min, x_max, y_max = window_m
            first_x, first_y = self._places_m[:, 0].T
            last_x, last_y = self._places_m[:, -1].T
            wanted = (x_min <= last_x) & (first_x <= x_max) & (y_min <= last_y) & (first_y <= y_max)
        replaceable, newcomers = self._mark(posterior, wanted)
        stale = np.flatnonzero(self._dirty & wanted)
        if self._neighbours >= len(posterior.measurements):
            self._put(stale, kriging_terms(posterior, self._places_m[stale].reshape(-1, 2)))
            self._reach_m2[stale] = np.inf
        elif len(stale):
            self._build(posterior, stale)
        self._dirty[stale] = False
        for start in range(0, len(replaceable), TILES_AT_ONCE):
            part = slice(start, start + TILES_AT_ONCE)
            self._replace(posterior, replaceable[part], newcomers[part])
        prediction = combine(self._terms, posterior.theta, posterior.theta_covariance)
        np.put(self.mean_db, self._lattice_index, prediction.mean_db.take(self._tile_index))
        np.put(
            self.deviation_db, self._lattice_index, prediction.deviation_db.take(self._tile_index)
        )
        return len(stale) + len(replaceable)

    @property
    def trend(self) -> Floats:
        """Derivative varphi of the mean with respect to theta at every node, ``(ny, nx, 2)``."""
        trend = np.full((self.mean_db.size, 2), np.nan)
        trend[self._lattice_index] = self._terms.trend.reshape(-1, 2)[self._tile_index]
        return trend.reshape(*self.mean_db.shape, 2)

    def _mark(self, posterior: ChannelPosterior, wanted: Mask) -> tuple[Indices, Indices]:
        """Return the tiles affected by exactly one new measurement, and its index for each."""
        # All other affected tiles are marked dirty.
        measured, last = posterior.measurements, self._last
        before = 0 if last is None else len(last.measurements)
        hits = np.zeros(len(self._dirty), dtype=np.intp)
        newcomer = np.zeros(len(self._dirty), dtype=np.intp)
        forgets = not math.isinf(posterior.parameters.forgetting_s)
        if (
            last is None
            or not posterior.continues(last)
            or (forgets and posterior.now_s != last.now_s)
        ):
            self._dirty[:] = True
        elif measured.receiver.any():
            self._dirty |= len(measured) > before
        else:
            for index in range(before, len(measured)):
                dx = self._centres_m[:, 0] - measured.positions_m[index, 0]
                dy = self._centres_m[:, 1] - measured.positions_m[index, 1]
                near = dx * dx + dy * dy < self._reach_m2
                hits += near
                newcomer[near] = index
        self._last = posterior
        replaceable = (
            (hits == 1)
            & wanted
            & ~self._dirty
            & np.isfinite(self._reach_m2)
            & (self._replacements < REPLACEMENTS_BEFORE_REBUILD)
        )
        self._dirty |= (hits > 0) & ~replaceable
        tiles = np.flatnonzero(replaceable)
        return tiles, newcomer[tiles]

    def _put(self, tiles: Indices, terms: KrigingTerms) -> None:
        """Store the kriging terms of `tiles`, reshaped to one row per tile."""
        shape = len(tiles), self._places_m.shape[1]
        self._terms.data_db[tiles] = terms.data_db.reshape(shape)
        self._terms.trend[tiles] = terms.trend.reshape(*shape, 2)
        self._terms.variance_db2[tiles] = terms.variance_db2.reshape(shape)

    def _build(self, posterior: ChannelPosterior, stale: Indices) -> None:
        """Recompute the stale tiles from the measurements nearest to their centres."""
        if not len(self._indices):
            count, places, size = *self._places_m.shape[:2], self._neighbours
            self._indices = np.zeros((count, size), dtype=np.intp)
            self._precision = np.zeros((count, size, size))
            self._across = np.zeros((count, places, size))
        offsets = offsets_given_theta(posterior)
        for start in range(0, len(stale), TILES_AT_ONCE):
            tiles = stale[start : start + TILES_AT_ONCE]
            indices, self._reach_m2[tiles] = posterior.index.nearest(
                self._centres_m[tiles], self._neighbours
            )
            channel = LocalChannel.of(posterior, indices, offsets)
            across = channel.rows_db2(self._places_m[tiles])
            self._put(tiles, channel.terms(self._places_m[tiles], across))
            self._indices[tiles] = indices
            self._precision[tiles] = channel.inverse
            self._across[tiles] = across
            self._replacements[tiles] = 0

    def _replace(
        self,
        posterior: ChannelPosterior,
        tiles: Indices,  # (k,)
        newcomers: Indices,  # (k,)
    ) -> None:
        """Replace each tile's farthest measurement by its new measurement."""
        # Removing measurement j from P = U^-1 subtracts w w' with w = P e_j / sqrt(P_jj). Adding
        # one with covariance c to the others adds v v' with v = [1; -P c] / sqrt(delta), delta its
        # variance given the others. The kriging terms change along the same directions.
        parameters = posterior.parameters
        origins = posterior.origins
        measured = origins.positions_m
        each = np.arange(len(tiles))
        indices, precision = self._indices[tiles], self._precision[tiles]
        across, centres = self._across[tiles], self._centres_m[tiles][:, None]
        leaving = ((measured[indices] - centres) ** 2).sum(axis=2).argmax(axis=1)

        out = precision[each, :, leaving]
        out /= np.sqrt(out[each, leaving])[:, None]
        self._add_direction(tiles, across, out, _columns(posterior, indices), -1.0)
        precision -= out[:, :, None] * out[:, None, :]
        precision[each, :, leaving] = 0.0
        precision[each, leaving, :] = 0.0

        indices[each, leaving] = newcomers
        arriving = origins.at(newcomers[:, None])
        places = place_origins(self._places_m[tiles], posterior.now_s, parameters)
        across[each, :, leaving] = covariance_db2(places, arriving, parameters)[:, :, 0]
        shared = covariance_db2(arriving, origins.at(indices), parameters)[:, 0]
        own = own_variance_db2(arriving, parameters)[:, 0]
        own += posterior.noise_variance_db2[newcomers]
        shared[each, leaving] = 0.0
        into = -(precision @ shared[:, :, None])[:, :, 0]
        delta = own + (shared * into).sum(axis=1)
        into[each, leaving] = 1.0
        into /= np.sqrt(delta)[:, None]
        precision += into[:, :, None] * into[:, None, :]
        self._add_direction(tiles, across, into, _columns(posterior, indices), 1.0)

        # Rounding errors can make the latent variance negative.
        self._terms.variance_db2[tiles] = np.maximum(
            self._terms.variance_db2[tiles], parameters.multipath_std_db**2
        )
        self._indices[tiles], self._precision[tiles] = indices, precision
        self._across[tiles] = across
        self._reach_m2[tiles] = ((measured[indices] - centres) ** 2).sum(axis=2).max(axis=1)
        self._replacements[tiles] += 1

    def _add_direction(
        self,
        tiles: Indices,
        across: Floats,
        direction: Floats,  # (k, m)
        columns: Floats,
        sign: float,
    ) -> None:
        """Update the kriging terms for a rank-one change of the inverse covariance."""
        seen = (across @ direction[:, :, None])[:, :, 0]
        projected = sign * (direction[:, None, :] @ columns)
        self._terms.data_db[tiles] += seen * projected[:, :, 0]
        self._terms.trend[tiles] -= seen[:, :, None] * projected[:, :, 1:]
        self._terms.variance_db2[tiles] -= sign * seen**2


def _columns(posterior: ChannelPosterior, indices: Indices) -> Floats:
    """Return the columns [power, regressors] (k, m, 3) of measurements with `indices` (k, m)."""
    columns = np.empty((*indices.shape, 3))
    columns[..., 0] = posterior.values_db[indices]
    at = posterior.measurements.positions_m[indices]
    columns[..., 1:] = regressors(at, posterior.parameters.station)
    return columns


Bounds = tuple[float, float, float, float]

MAP_VARIABLES = ("mean_db", "deviation_db", "connectivity")
"""Variables of a map, as named in its files."""
CELLS_ALONG = 200  # Default number of cells along the longer side of a map

MAX_CELLS = 4_000_000

EXACT_OPERATIONS = 2e11  # Maximum n^2 c for an exact map of c cells from n measurements
NEIGHBOURS = 256
"""Minimum number of nearest measurements per cell of an approximate map. On the three campus logs
(4,193 to 5,006 measurements, up to 869 censored) the mean's error is 0.003 dB on average and at
most 0.25 dB, that of the standard deviation (7.5 dB) at most 0.06 %. For logs without a Cholesky
factor, theta and sites are approximate too, and the errors are 0.022 dB, 0.26 dB and 0.6 %."""


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

    def _repr_html_(self) -> str:
        """Return an HTML view for notebooks: picture and key figures."""
        return import_module("planopt.report.page_content").map_html(self)

    def save(self, file: Path | str, *, origin_deg: Origin | None = None) -> None:
        """Write the map in the format of the file extension: ``.csv``, ``.npz``, ``.nc``, ``.tif``.

        Parameters
        ----------
        file
            File to write, atomically. GeoTIFF needs the extra ``maps``.
        origin_deg
            Latitude and longitude of (0, 0), and the angle from east to the x axis if it is not 0,
            in degrees. If given, GeoTIFF has a reference system, NetCDF and CSV the longitude and
            latitude of each cell.

        Raises
        ------
        InputError
            The ending is unknown, the origin is invalid, or rasterio is not installed.
        OutputError
            The file cannot be written.
        """
        place = None if origin_deg is None else require_origin(tuple(origin_deg), "origin_deg")
        rasters = {name: getattr(self, name) for name in MAP_VARIABLES}
        write_rasters(path_of("file", file, "give a file name"), rasters, place)

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
                "xarray is not installed", remedy="pip install 'planopt[xarray]'"
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
            f"is {bounds_m!r}, should be four numbers",
            key="bounds_m",
            remedy="give (x_min, y_min, x_max, y_max) in metres, such as "
            "problem.workspace.bounds_m",
        ) from None
    bounds_m = x_min, y_min, x_max, y_max
    for key, value in (("cell_m", cell_m), ("threshold_dbm", threshold_dbm)):
        real = isinstance(cast("object", value), int | float | np.integer | np.floating)
        if not real or isinstance(cast("object", value), bool):
            raise InputError(
                f"is {value!r}, should be a finite number",
                key=key,
                remedy="give a number, e.g. 1.0 or -80.0",
            )
    if not (np.isfinite(bounds_m).all() and x_min < x_max and y_min < y_max):
        raise InputError(
            f"is {bounds_m}, should have x_min < x_max and y_min < y_max",
            key="bounds_m",
            remedy="give x_min, y_min, x_max, y_max in metres",
        )
    if not (cell_m > 0.0 and math.isfinite(cell_m)):
        raise InputError(
            f"is {cell_m:g}, should be above 0",
            key="cell_m",
            remedy="give the side of a cell in metres",
        )
    if max(1.0, (x_max - x_min) / cell_m) * max(1.0, (y_max - y_min) / cell_m) > MAX_CELLS:
        raise InputError(
            f"is {cell_m:g} m, which makes more than {MAX_CELLS:,} cells",
            key="cell_m",
            remedy="use larger cells or smaller bounds",
        )
    if not math.isfinite(threshold_dbm):
        raise InputError(
            f"is {threshold_dbm:g}, should be a finite power",
            key="threshold_dbm",
            remedy="give dBm, e.g. -80",
        )
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


def serving_map(
    posteriors: Sequence[ChannelPosterior],
    bounds_m: Bounds,
    cell_m: float,
    thresholds_dbm: Sequence[float],
) -> PosteriorMap:
    """Predict the power of the best server and P(connected to any station) on a grid.

    Mean and standard deviation are those of the station with the largest margin above its
    threshold. The mean is shifted so that the first station's threshold applies to it.

    Parameters
    ----------
    posteriors, thresholds_dbm
        Posterior and threshold of each station, at least one.
    bounds_m, cell_m
        Bounds and cell side, as for :func:`posterior_map`.

    Raises
    ------
    InputError
        Errors of :func:`posterior_map`.
    """
    maps = [
        posterior_map(posterior, bounds_m, cell_m, threshold)
        for posterior, threshold in zip(posteriors, thresholds_dbm, strict=True)
    ]
    first = maps[0]
    if len(maps) == 1:
        return first
    shape = first.mean_db.values.shape
    predictions = [
        Prediction(each.mean_db.values.ravel(), each.deviation_db.values.ravel()) for each in maps
    ]
    above, deviation = above_thresholds_db(predictions, thresholds_dbm)
    server: Indices = above.argmax(axis=0)
    own = deviation[server, np.arange(server.size)]
    serving = serving_power_dbm(np.stack([each.mean_db for each in predictions]), thresholds_dbm)
    connected = any_probability(predictions, thresholds_dbm)
    return PosteriorMap(
        replace(first.mean_db, values=serving.reshape(shape)),
        replace(first.deviation_db, values=own.reshape(shape)),
        replace(first.connectivity, values=connected.reshape(shape)),
        first.threshold_dbm,
        first.posterior,
    )


def default_cell_m(bounds_m: Bounds) -> float:
    """Return a cell side, rounded to two digits, for `CELLS_ALONG` cells on the longer side."""
    x_min, y_min, x_max, y_max = bounds_m
    return float(f"{max(x_max - x_min, y_max - y_min) / CELLS_ALONG:.2g}")


def measured_bounds_m(measurements: Measurements) -> Bounds:
    """Return the bounding box of the measurements, widened if they lie on a line."""
    low, high = measurements.positions_m.min(axis=0), measurements.positions_m.max(axis=0)
    least = 2.0 * (high - low).max() / CELLS_ALONG
    widening = np.maximum(least - (high - low), 0.0) / 2.0
    (x_min, y_min), (x_max, y_max) = low - widening, high + widening
    return float(x_min), float(y_min), float(x_max), float(y_max)
