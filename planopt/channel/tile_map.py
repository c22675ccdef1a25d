"""A lattice of predictions that follows the posterior at little cost.

Square tiles of nodes share the measurements nearest to the tile's centre. A new measurement only
touches the tiles that it is near to; a new theta is recombined everywhere from kept parts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.neighbours import local_precision, local_terms, nearest
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import ChannelPosterior, KrigingTerms, combine, kriging_terms

TILES_AT_ONCE = 64
"""Tiles solved together: their matrices fit into a processor's cache."""

DISTANCES_AT_ONCE = 2**20


class TileMap:
    """Predicted power and its deviation on a lattice, refreshed as measurements come in.

    Parameters
    ----------
    x_m, y_m
        ``(nx,)`` and ``(ny,)`` the lattice's coordinates.
    needed
        ``(ny, nx)`` nodes where a prediction is wanted.
    tile
        Nodes along a tile's side.
    neighbours
        Measurements used for a tile; with all of them the prediction is the exact posterior's.

    Attributes
    ----------
    mean_db, deviation_db
        ``(ny, nx)`` as in :class:`planopt.channel.posterior.Prediction`, NaN where not needed or
        not yet computed. The next :meth:`refresh` writes into the same arrays.
    """

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
        count = len(kept)
        # Tiles that stick out of the lattice repeat its last row or column.
        inside = np.arange(tile)
        node_rows = np.minimum((kept // across)[:, None] * tile + inside, len(y_m) - 1)
        node_columns = np.minimum((kept % across)[:, None] * tile + inside, len(x_m) - 1)
        places = np.empty((count, tile, tile, 2))
        places[..., 0] = np.asarray(x_m, dtype=np.float64)[node_columns][:, None, :]
        places[..., 1] = np.asarray(y_m, dtype=np.float64)[node_rows][:, :, None]
        self._places_m = places.reshape(count, tile * tile, 2)
        self._centres_m = self._places_m.mean(axis=1)
        self._lattice_index = rows * needed.shape[1] + columns
        self._tile_index = (
            tile_of_node * tile * tile + (rows % tile) * tile + columns % tile
        )
        self._terms = KrigingTerms(
            np.full((count, tile * tile), np.nan),
            np.full((count, tile * tile, 2), np.nan),
            np.full((count, tile * tile), np.nan),
        )
        self._reach_m2: NDArray[np.float64] = np.full(count, np.inf)
        self._dirty: NDArray[np.bool_] = np.ones(count, dtype=bool)
        self._parameters: ChannelParameters | None = None
        # Position, value and noise variance of every measurement already looked at.
        self._seen: NDArray[np.float64] = np.zeros((0, 4))

    def refresh(
        self,
        posterior: ChannelPosterior,
        window_m: tuple[float, float, float, float] | None = None,
    ) -> int:
        """Bring the lattice up to date with `posterior`.

        Parameters
        ----------
        posterior
            Usually the last one extended; anything else is rebuilt from the start.
        window_m
            ``(x_min, y_min, x_max, y_max)``: tiles whose centre is outside keep their parts and
            are caught up with by a later refresh. None for everywhere.

        Returns
        -------
        int
            Tiles computed anew.
        """
        self._mark(posterior)
        stale = self._dirty
        if window_m is not None:
            x, y = self._centres_m.T
            x_min, y_min, x_max, y_max = window_m
            stale = stale & (x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)
        tiles = np.flatnonzero(stale)
        if len(tiles):
            self._compute(posterior, tiles)
            self._dirty[tiles] = False
        prediction = combine(self._terms, posterior.theta, posterior.theta_covariance)
        self.mean_db.ravel()[self._lattice_index] = prediction.mean_db.ravel()[self._tile_index]
        self.deviation_db.ravel()[self._lattice_index] = prediction.deviation_db.ravel()[
            self._tile_index
        ]
        return len(tiles)

    def _mark(self, posterior: ChannelPosterior) -> None:
        """Mark the tiles that measurements not yet seen come near to."""
        now = np.column_stack(
            [posterior.measurements.positions_m, posterior.values_db, posterior.noise_variance_db2]
        )
        before = len(self._seen)
        if posterior.parameters != self._parameters or not np.array_equal(
            now[:before], self._seen
        ):
            self._dirty[:] = True
        else:
            for x, y in now[before:, :2]:
                dx = self._centres_m[:, 0] - x
                dy = self._centres_m[:, 1] - y
                self._dirty |= dx * dx + dy * dy < self._reach_m2
        self._seen = now
        self._parameters = posterior.parameters

    def _compute(self, posterior: ChannelPosterior, tiles: NDArray[np.intp]) -> None:
        """Compute the parts of `tiles` anew."""
        measured = posterior.measurements.positions_m
        if self._neighbours >= len(measured):
            places = self._places_m[tiles]
            terms = kriging_terms(posterior, places.reshape(-1, 2))
            self._terms.data_db[tiles] = terms.data_db.reshape(places.shape[:2])
            self._terms.trend[tiles] = terms.trend.reshape(places.shape)
            self._terms.variance_db2[tiles] = terms.variance_db2.reshape(places.shape[:2])
            self._reach_m2[tiles] = np.inf
            return
        at_once = min(TILES_AT_ONCE, max(1, DISTANCES_AT_ONCE // len(measured)))
        for start in range(0, len(tiles), at_once):
            part = tiles[start : start + at_once]
            indices, self._reach_m2[part] = nearest(
                measured, self._centres_m[part], self._neighbours
            )
            precision, weighted = local_precision(posterior, indices)
            terms = local_terms(
                posterior.parameters,
                measured[indices],
                precision,
                weighted,
                self._places_m[part],
            )
            self._terms.data_db[part] = terms.data_db
            self._terms.trend[part] = terms.trend
            self._terms.variance_db2[part] = terms.variance_db2
