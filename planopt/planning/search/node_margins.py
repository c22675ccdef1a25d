"""Connectivity at every lattice node: a cached map, corrected where plans touch it.

The map conditions each tile on the measurements nearest to it, which is fast and slightly off.
Wherever a path is about to rest on a node's value, the exact posterior's value replaces it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.objectives.reach import outage_share
from planopt.planning.proof.broad_prediction import Broad
from planopt.planning.proof.predictions import search_prediction
from planopt.planning.search.lattice_map import LatticeMap
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.world.road_map import RoadMap


class NodeMargins:
    """Margins in dB and probabilities at the nodes of a road map, for one belief at a time.

    Parameters
    ----------
    road_map
        The nodes.
    threshold_dbm, p_min
        The bound: ``mean - z_p deviation - threshold``.
    everywhere
        Whether the outage price is charged where the bound is kept, too.

    Attributes
    ----------
    mean_db, deviation_db, margin_db
        ``(n,)`` of the nodes.
    outage_share
        ``(n,)`` what the outage price is charged on there
        (:func:`planopt.objectives.reach.outage_share`).
    """

    def __init__(
        self, road_map: RoadMap, threshold_dbm: float, p_min: float, everywhere: bool = False
    ) -> None:
        self._road_map = road_map
        self._threshold_dbm = threshold_dbm
        self._p_min = p_min
        self._everywhere = everywhere
        self._map = LatticeMap(road_map.lattice)
        count = len(road_map.nodes_m)
        self.mean_db, self.deviation_db = np.zeros(count), np.zeros(count)
        self.margin_db, self.outage_share = np.zeros(count), np.zeros(count)
        self._exact = np.zeros(len(road_map.nodes_m), dtype=bool)
        self._nodes = road_map.rows * road_map.lattice.shape[1] + road_map.columns
        self._power: Callable[[NDArray[np.float64]], Prediction] | None = None

    @property
    def outside(self) -> NDArray[np.bool_]:
        """``(n,)`` which nodes miss the bound, or keep it by less than planners ask for."""
        return self.margin_db < MARGIN_PAD_DB

    def refresh(
        self,
        posterior: ChannelPosterior,
        broad: Broad | None = None,
        power: Callable[[NDArray[np.float64]], Prediction] | None = None,
    ) -> None:
        """Follow the belief: recompute what its new measurements changed.

        Parameters
        ----------
        posterior
            Of the first station.
        broad
            What counts in its place where it is not the posterior alone.
        power
            Exact values of both at places (n, 2); None to predict them here.
        """
        self._map.refresh(posterior, broad)
        self._power = power or partial(search_prediction, posterior, broad=broad)
        self.mean_db = self._map.mean_db.take(self._nodes)
        self.deviation_db = self._map.deviation_db.take(self._nodes)
        self.margin_db, self.outage_share = self._values(
            Prediction(self.mean_db, self.deviation_db)
        )
        self._exact[:] = False

    def at(self, places_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Margins and outage shares at any places (n, 2), as good as searches need them."""
        return self._values(self._predicted(places_m))

    def correct(self, nodes: NDArray[np.intp]) -> bool:
        """Put exact values at these nodes; true if any of them had not been exact before."""
        new = np.unique(nodes[~self._exact[nodes]])
        if new.size == 0:
            return False
        power = self._predicted(self._road_map.nodes_m[new])
        self.mean_db[new], self.deviation_db[new] = power.mean_db, power.deviation_db
        self.margin_db[new], self.outage_share[new] = self._values(power)
        self._exact[new] = True
        return True

    def _predicted(self, places_m: NDArray[np.float64]) -> Prediction:
        if self._power is None:
            raise AssertionError("refresh first")
        return self._power(places_m)

    def _values(self, power: Prediction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mean, deviation = power.mean_db, power.deviation_db
        margin = bound_margin_db(mean, deviation, self._threshold_dbm, self._p_min)
        probability = connection_probability(mean, deviation, self._threshold_dbm)
        return margin, outage_share(probability, margin < MARGIN_PAD_DB, self._everywhere)
