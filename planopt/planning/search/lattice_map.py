"""Predictions at all nodes of a lattice, of one station or of the serving one of several."""

from __future__ import annotations

import numpy as np

from planopt.channel.maps.tile_map import TileMap
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.serving import Serving
from planopt.world.lattice import Lattice


class LatticeMap:
    """A tile map for each station, combined where there are several.

    Parameters
    ----------
    lattice
        Its nodes.

    Attributes
    ----------
    mean_db, deviation_db
        ``(ny, nx)`` as in :class:`planopt.channel.maps.tile_map.TileMap`; after a refresh they may
        be other arrays.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._maps = [self._tile_map()]
        self.mean_db = self._maps[0].mean_db
        self.deviation_db = self._maps[0].deviation_db

    def _tile_map(self) -> TileMap:
        lattice = self._lattice
        ny, nx = lattice.shape
        return TileMap(
            lattice.origin_m[0] + lattice.spacing_m * np.arange(nx),
            lattice.origin_m[1] + lattice.spacing_m * np.arange(ny),
            lattice.free,
        )

    def refresh(
        self,
        posterior: ChannelPosterior,
        broad: Broad | None = None,
        window_m: tuple[float, float, float, float] | None = None,
    ) -> None:
        """Follow what is believed, within a window or everywhere.

        Parameters
        ----------
        posterior
            Of the first station.
        broad
            All stations, where there are several.
        window_m
            As for :meth:`planopt.channel.maps.tile_map.TileMap.refresh`.
        """
        if not isinstance(broad, Serving):
            self._maps[0].refresh(posterior, window_m)
            return
        while len(self._maps) < len(broad.posteriors):
            self._maps.append(self._tile_map())
        for own, station in zip(self._maps, broad.posteriors, strict=True):
            own.refresh(station, window_m)
        known = np.isfinite(self._maps[0].mean_db)
        law = broad.law(
            [Prediction(own.mean_db[known], own.deviation_db[known]) for own in self._maps]
        )
        self.mean_db = np.full(known.shape, np.nan)
        self.deviation_db = np.full(known.shape, np.nan)
        self.mean_db[known], self.deviation_db[known] = law.mean_db, law.deviation_db

    @property
    def stations(self) -> list[TileMap]:
        """Each station's own predictions."""
        return self._maps
