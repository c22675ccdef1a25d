"""Connectivity margin at every lattice node: a cached map, corrected where plans touch it.

The map conditions each tile on the measurements nearest to it, which is fast and slightly off.
Wherever a path is about to rest on a node's value, the exact posterior's value replaces it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity import bound_margin_db
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.search.lattice_map import LatticeMap
from planopt.planning.search.road_map import RoadMap


class NodeMargins:
    """Margins in dB at the nodes of a road map, for one belief at a time.

    Parameters
    ----------
    road_map
        The nodes.
    threshold_dbm, p_min
        The bound: ``mean - z_p deviation - threshold``.
    """

    def __init__(self, road_map: RoadMap, threshold_dbm: float, p_min: float) -> None:
        lattice = road_map.lattice
        self._road_map = road_map
        self._threshold_dbm = threshold_dbm
        self._p_min = p_min
        self._map = LatticeMap(lattice)
        self.margin_db = np.zeros(len(road_map.nodes_m))
        self._exact = np.zeros(len(road_map.nodes_m), dtype=bool)
        self._posterior: ChannelPosterior | None = None
        self._broad: Broad | None = None

    def refresh(self, posterior: ChannelPosterior, broad: Broad | None = None) -> None:
        """Follow the belief: recompute what its new measurements changed.

        Exact values are those of `broad`, where it is not the posterior alone that counts.
        """
        self._map.refresh(posterior, broad)
        self._broad = broad
        self._posterior = posterior
        rows, columns = self._road_map.rows, self._road_map.columns
        self.margin_db = bound_margin_db(
            self._map.mean_db[rows, columns],
            self._map.deviation_db[rows, columns],
            self._threshold_dbm,
            self._p_min,
        )
        self._exact[:] = False

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Margins at any places (n, 2), as good as searches need them."""
        if self._posterior is None:
            raise AssertionError("refresh first")
        power = search_prediction(self._posterior, places_m, self._broad)
        return bound_margin_db(power.mean_db, power.deviation_db, self._threshold_dbm, self._p_min)

    def correct(self, nodes: NDArray[np.intp]) -> bool:
        """Put exact values at these nodes; true if any of them had not been exact before."""
        if self._posterior is None:
            raise AssertionError("refresh first")
        new = np.unique(nodes[~self._exact[nodes]])
        if new.size == 0:
            return False
        self.margin_db[new] = self.at(self._road_map.nodes_m[new])
        self._exact[new] = True
        return True
