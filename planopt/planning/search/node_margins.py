"""Power predictions at the nodes of a lattice, corrected where paths depend on them."""

from collections.abc import Callable
from functools import partial

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.channel_map import TileMap
from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.channel.kriging import Prediction, bound_margin_db, connection_probability
from planopt.channel.measurements import SAME_PLACE_M
from planopt.objectives.terms.term import Nodes
from planopt.planning.proof.rule import search_prediction
from planopt.planning.tolerances import MARGIN_PAD_DB
from planopt.planning.values.context import StepContext
from planopt.problems.problem import outage_share
from planopt.world.lattice import Lattice, RoadMap


class LatticeMap:
    """Tiled maps of each station's predicted power, and a map of the serving power."""

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self.stations = [self._tile_map()]  # Map of each single station's power
        self.mean_db = self.stations[0].mean_db
        self.deviation_db = self.stations[0].deviation_db

    def _tile_map(self) -> TileMap:
        lattice = self._lattice
        ny, nx = lattice.shape
        return TileMap(
            lattice.origin_m[0] + lattice.spacing_m * np.arange(nx),
            lattice.origin_m[1] + lattice.spacing_m * np.arange(ny),
            lattice.free,
        )

    def refresh(
        self, law: ConnectivityLaw, window_m: tuple[float, float, float, float] | None = None
    ) -> None:
        """Update the maps to the current belief, within a window or everywhere."""
        while len(self.stations) < len(law.posteriors):
            self.stations.append(self._tile_map())
        for own, station in zip(self.stations, law.posteriors, strict=True):
            own.refresh(station, window_m)
        if len(self.stations) == 1:
            return
        known = np.isfinite(self.stations[0].mean_db)
        power = law.combined(
            [Prediction(own.mean_db[known], own.deviation_db[known]) for own in self.stations]
        )
        self.mean_db = np.full(known.shape, np.nan)
        self.deviation_db = np.full(known.shape, np.nan)
        self.mean_db[known], self.deviation_db[known] = power.mean_db, power.deviation_db


class NodeMargins:
    """Connectivity margins in dB and fractions out of contact at the nodes of a lattice."""

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
        self._power: Callable[[Floats], Prediction] | None = None

    @property
    def outside(self) -> Mask:
        """Return a mask of nodes (n,) whose margin is less than the planners' safety pad."""
        return self.margin_db < MARGIN_PAD_DB

    def refresh(
        self, law: ConnectivityLaw, power: Callable[[Floats], Prediction] | None = None
    ) -> None:
        """Update margins and fractions to the current belief."""
        self._map.refresh(law)
        self._power = power or partial(search_prediction, law)
        self.mean_db = self._map.mean_db.take(self._nodes)
        self.deviation_db = self._map.deviation_db.take(self._nodes)
        self.margin_db, self.outage_share = self._values(
            Prediction(self.mean_db, self.deviation_db)
        )
        self._exact[:] = False

    def at(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Return margins and fractions out of contact at arbitrary positions (n, 2)."""
        return self._values(self._predicted(places_m))

    def correct(self, nodes: Indices) -> bool:
        """Predict the power at `nodes` more accurately; return whether any prediction is new."""
        new = np.unique(nodes[~self._exact[nodes]])
        if new.size == 0:
            return False
        power = self._predicted(self._road_map.nodes_m[new])
        self.mean_db[new], self.deviation_db[new] = power.mean_db, power.deviation_db
        self.margin_db[new], self.outage_share[new] = self._values(power)
        self._exact[new] = True
        return True

    def _predicted(self, places_m: Floats) -> Prediction:
        if self._power is None:
            raise AssertionError("refresh first")
        return self._power(places_m)

    def _values(self, power: Prediction) -> tuple[Floats, Floats]:
        mean, deviation = power.mean_db, power.deviation_db
        margin = bound_margin_db(mean, deviation, self._threshold_dbm, self._p_min)
        probability = connection_probability(mean, deviation, self._threshold_dbm)
        return margin, outage_share(probability, margin < MARGIN_PAD_DB, self._everywhere)


class NodeField(Nodes):
    """Predicted power at the nodes of a lattice."""

    def __init__(self, lattice: Lattice) -> None:
        self._map = LatticeMap(lattice)
        self._exact = np.zeros(lattice.shape, dtype=bool)
        self._lattice = lattice
        self._context: StepContext | None = None
        self.grid_m = lattice.positions_m
        self.stations = self._map.stations  # Without corrections
        self.mean_db = self._map.mean_db
        self.deviation_db = self._map.deviation_db
        self.window = slice(0, 0), slice(0, 0)

    def refresh(self, context: StepContext, reach_m: float) -> None:
        """Update the predictions to the belief, within `reach_m` of the robot along both axes."""
        low, high = context.position_m - reach_m, context.position_m + reach_m
        self._map.refresh(
            context.law, (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        )
        # Copies, as corrections must not change the stations' own predictions.
        self.mean_db, self.deviation_db = self._map.mean_db.copy(), self._map.deviation_db.copy()
        lattice = self._lattice
        first = np.ceil((low - lattice.origin_m) / lattice.spacing_m)
        last = np.floor((high - lattice.origin_m) / lattice.spacing_m)
        columns, rows = (
            slice(max(int(first[axis]), 0), max(int(last[axis]) + 1, 0)) for axis in (0, 1)
        )
        self.window = rows, columns
        self._exact[:] = False
        self._context = context
        if context.problem.constraints.requires_connection:
            self.correct(self._measured_nodes(context))

    def _measured_nodes(self, context: StepContext) -> Indices:
        """Return the free nodes (n, 2) near the robot with readings or packets, as (iy, ix)."""
        lattice, (rows, columns), law = self._lattice, self.window, context.law
        read = [own.measurements.positions_m for own in law.posteriors]
        places = np.vstack([*read, law.proven.positions_m])
        nodes = np.rint((places - lattice.origin_m) / lattice.spacing_m).astype(np.intp)[:, ::-1]
        first, last = (rows.start, columns.start), (rows.stop, columns.stop)
        inside = ((nodes >= first) & (nodes < np.minimum(last, lattice.shape))).all(axis=1)
        nodes, places = nodes[inside], places[inside]
        same = np.abs(self.places_m(nodes) - places).max(axis=1, initial=0.0) <= SAME_PLACE_M
        free = lattice.free[nodes[:, 0], nodes[:, 1]]
        return np.unique(nodes[same & free], axis=0)

    def places_m(self, nodes: Indices) -> Floats:
        """Return the positions of `nodes` (n, 2), given as (iy, ix)."""
        return self.grid_m[nodes[:, 0], nodes[:, 1]]

    def nearest(self, places_m: Floats) -> Prediction:
        """Return the power at each position's nearest node; NaN for a blocked node."""
        lattice, (rows, columns) = self._lattice, self.window
        first = np.array([columns.start, rows.start])
        last = np.array([columns.stop, rows.stop]) - 1
        nodes = np.rint((places_m - lattice.origin_m) / lattice.spacing_m).astype(np.intp)
        column, row = np.clip(nodes, first, np.minimum(last, np.array(lattice.shape[::-1]) - 1)).T
        return Prediction(self._map.mean_db[row, column], self._map.deviation_db[row, column])

    def correct(self, nodes: Indices) -> bool:
        """Predict the power at `nodes` (n, 2) more accurately; return whether any value is new."""
        if self._context is None:
            raise AssertionError("refresh first")
        rows, columns = nodes[:, 0], nodes[:, 1]
        new = nodes[~self._exact[rows, columns]]
        if not len(new):
            return False
        power = self._context.power(self.places_m(new))
        self.mean_db[new[:, 0], new[:, 1]] = power.mean_db
        self.deviation_db[new[:, 0], new[:, 1]] = power.deviation_db
        self._exact[new[:, 0], new[:, 1]] = True
        return True
