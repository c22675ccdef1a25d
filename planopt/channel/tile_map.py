"""Lattice of predictions that is updated with each measurement.

The nodes of a square tile share the measurements nearest to its centre. A new measurement affects
only nearby tiles, where it replaces the farthest one by two rank-one updates; a new theta is
combined with stored terms. All tiles are recomputed if the channel varies in time, or with several
receivers, whose offsets change with every measurement.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import LocalChannel, kriging_terms
from planopt.channel.long_logs import offsets_given_theta
from planopt.channel.measurement_covariance import covariance_db2, own_variance_db2, place_origins
from planopt.channel.parameters import regressors
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, combine

TILES_AT_ONCE = 64
"""Number of tiles solved together, such that their matrices fit into cache."""

REPLACEMENTS_BEFORE_REBUILD = 32
"""Maximum number of updates before a tile is recomputed, to limit rounding errors."""


class TileMap:
    """Map of predicted power and standard deviation on a lattice, updated by measurements."""

    # Memory is about ``8 neighbours (neighbours + tile**2)`` bytes per tile.

    def __init__(
        self,
        x_m: NDArray[np.float64],
        y_m: NDArray[np.float64],
        needed: NDArray[np.bool_],
        tile: int = 5,
        neighbours: int = 32,
    ) -> None:
        self._neighbours = neighbours
        self.mean_db: NDArray[np.float64] = np.full(needed.shape, np.nan)
        self.deviation_db: NDArray[np.float64] = np.full(needed.shape, np.nan)
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
        # One contiguous plane per term, because combining them dominates an idle refresh.
        planes = np.full((4, len(kept), tile * tile), np.nan)
        self._terms = KrigingTerms(planes[0], np.moveaxis(planes[1:3], 0, -1), planes[3])
        self._reach_m2: NDArray[np.float64] = np.full(len(kept), np.inf)
        self._dirty: NDArray[np.bool_] = np.ones(len(kept), dtype=bool)
        self._replacements: NDArray[np.intp] = np.zeros(len(kept), dtype=np.intp)
        self._indices: NDArray[np.intp] = np.zeros((0, 0), dtype=np.intp)
        self._precision: NDArray[np.float64] = np.zeros((0, 0, 0))
        self._across: NDArray[np.float64] = np.zeros((0, 0, 0))
        # The posterior of the last refresh.
        self._last: ChannelPosterior | None = None

    def refresh(
        self,
        posterior: ChannelPosterior,
        window_m: tuple[float, float, float, float] | None = None,  # (x_min, y_min, x_max, y_max)
    ) -> int:
        """Update the lattice, or the tiles in a window, and return the number of tiles updated."""
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
    def trend(self) -> NDArray[np.float64]:
        """Derivative varphi of the mean with respect to theta at every node, ``(ny, nx, 2)``."""
        trend = np.full((self.mean_db.size, 2), np.nan)
        trend[self._lattice_index] = self._terms.trend.reshape(-1, 2)[self._tile_index]
        return trend.reshape(*self.mean_db.shape, 2)

    def _mark(
        self, posterior: ChannelPosterior, wanted: NDArray[np.bool_]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the tiles where one new measurement replaces one neighbour, and its index."""
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

    def _put(self, tiles: NDArray[np.intp], terms: KrigingTerms) -> None:
        """Store the terms of `tiles`; arrays may have any leading shape."""
        shape = len(tiles), self._places_m.shape[1]
        self._terms.data_db[tiles] = terms.data_db.reshape(shape)
        self._terms.trend[tiles] = terms.trend.reshape(*shape, 2)
        self._terms.variance_db2[tiles] = terms.variance_db2.reshape(shape)

    def _build(self, posterior: ChannelPosterior, stale: NDArray[np.intp]) -> None:
        """Compute the tiles `stale` from their nearest measurements."""
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
        tiles: NDArray[np.intp],  # (k,)
        newcomers: NDArray[np.intp],  # (k,)
    ) -> None:
        """Replace the farthest neighbour of each tile by a new measurement."""
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
        tiles: NDArray[np.intp],
        across: NDArray[np.float64],
        direction: NDArray[np.float64],  # (k, m)
        columns: NDArray[np.float64],
        sign: float,
    ) -> None:
        """Update the kriging terms for a rank-one change `sign` v v' of P, v = `direction`."""
        seen = (across @ direction[:, :, None])[:, :, 0]
        projected = sign * (direction[:, None, :] @ columns)
        self._terms.data_db[tiles] += seen * projected[:, :, 0]
        self._terms.trend[tiles] -= seen[:, :, None] * projected[:, :, 1:]
        self._terms.variance_db2[tiles] -= sign * seen**2


def _columns(posterior: ChannelPosterior, indices: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return values and Gamma of the measurements `indices` (k, m); ``(k, m, 3)``."""
    columns = np.empty((*indices.shape, 3))
    columns[..., 0] = posterior.values_db[indices]
    at = posterior.measurements.positions_m[indices]
    columns[..., 1:] = regressors(at, posterior.parameters.station)
    return columns
