"""What is predicted at the nodes of a lattice, kept up to date around the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.maps.tile_map import TileMap
from planopt.planning.search.lattice_map import LatticeMap
from planopt.planning.worth.situation import Situation
from planopt.world.lattice import Lattice, node_positions


class NodeField:
    """Predicted power on a lattice, corrected where plans touch it.

    The map conditions each tile on the measurements nearest to it, which is fast and slightly off.
    Wherever a path is about to rest on a node's value, that of more measurements replaces it.

    Parameters
    ----------
    lattice
        Its nodes.

    Attributes
    ----------
    grid_m
        ``(ny, nx, 2)`` positions of the nodes.
    mean_db, deviation_db
        ``(ny, nx)``; NaN at nodes that are not free, or were never within reach.
    window
        Rows and columns of the nodes that the last refresh was for.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._map = LatticeMap(lattice)
        self._exact = np.zeros(lattice.shape, dtype=bool)
        self._lattice = lattice
        self._situation: Situation | None = None
        self.grid_m = node_positions(lattice)
        self.mean_db = self._map.mean_db
        self.deviation_db = self._map.deviation_db
        self.window = slice(0, 0), slice(0, 0)

    def refresh(self, situation: Situation, reach_m: float) -> None:
        """Follow the belief within `reach_m` of the robot along both axes."""
        low, high = situation.position_m - reach_m, situation.position_m + reach_m
        self._map.refresh(
            situation.posterior,
            situation.circumstances.broad,
            (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        )
        self.mean_db, self.deviation_db = self._map.mean_db, self._map.deviation_db
        lattice = self._lattice
        first = np.ceil((low - lattice.origin_m) / lattice.spacing_m)
        last = np.floor((high - lattice.origin_m) / lattice.spacing_m)
        columns, rows = (
            slice(max(int(first[axis]), 0), max(int(last[axis]) + 1, 0)) for axis in (0, 1)
        )
        self.window = rows, columns
        self._exact[:] = False
        self._situation = situation

    def places_m(self, nodes: NDArray[np.intp]) -> NDArray[np.float64]:
        """Positions of `nodes` (n, 2), given as (iy, ix)."""
        return self.grid_m[nodes[:, 0], nodes[:, 1]]

    def correct(self, nodes: NDArray[np.intp]) -> bool:
        """Put better values at `nodes` (n, 2); true if any of them had not been corrected."""
        if self._situation is None:
            raise AssertionError("refresh first")
        rows, columns = nodes[:, 0], nodes[:, 1]
        new = nodes[~self._exact[rows, columns]]
        if not len(new):
            return False
        power = self._situation.power(self.places_m(new))
        self.mean_db[new[:, 0], new[:, 1]] = power.mean_db
        self.deviation_db[new[:, 0], new[:, 1]] = power.deviation_db
        self._exact[new[:, 0], new[:, 1]] = True
        return True

    @property
    def stations(self) -> list[TileMap]:
        """Each station's own predictions; those of several are not corrected."""
        return self._map.stations
