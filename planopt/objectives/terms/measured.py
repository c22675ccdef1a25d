"""Terms whose value is what measurements along a path tell of the channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.information import Gain
from planopt.objectives.moments import KnownPlaces, Moments, Pull, posterior_moments
from planopt.objectives.path_derivatives import PathDerivatives, by_positions
from planopt.objectives.terms.context import (
    NearPath,
    NodeChannel,
    Nodes,
    Part,
    Paths,
    TermContext,
)
from planopt.objectives.terms.term import Term


@dataclass(frozen=True)
class MeasuredTerm(Term):
    """Base of terms that are sums of gains over stations: information of independent ones adds."""

    @property
    def is_measured(self) -> bool:
        """The value is what measurements tell."""
        return True

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return what measurements of one station are worth."""
        raise self._without("gain")

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> NDArray[np.float64]:
        """Return what measuring at each node alone would tell of one station; (ny, nx)."""
        raise self._without("node_gain")

    def _gain(self, at: TermContext, number: int) -> Gain:
        """Return the gain of a station by its number, made once a step."""
        posterior = at.anticipated[number]
        return at.once((MeasuredTerm, self, number), lambda: self.gain(at, posterior))

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return what the measurements along one path tell, by the exact posterior."""
        taken = at.measuring.takes(path_m)
        if not taken.any():
            return 0.0
        known: Sequence[KnownPlaces | None] = [None] * len(at.anticipated)
        region = None
        if self.averages_map:
            known, region = at.near_places, at.near_region
        return sum(
            float(
                self._gain(at, number).value(
                    posterior_moments(station, path_m, taken, region, map_)
                )
            )
            for number, (station, map_) in enumerate(zip(at.anticipated, known, strict=True))
        )

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths, by local channels."""
        each = [self._gain(paths.at, k).value(moments) for k, moments in enumerate(paths.moments)]
        return np.sum(each, axis=0)

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return the derivatives of :meth:`values` by the moments of one station."""
        moments: Moments = paths.moments[number]
        return moments.without_gates(self._gain(paths.at, number).pull(moments))

    def derivatives(self, path: NearPath) -> Part:
        """Return the value of one path near the channel of its start."""
        found = [self._gain(path.at, k).derivatives(local) for k, local in enumerate(path.measured)]
        return by_positions(reduce(PathDerivatives.plus, found), path.gates)

    def node_reward(self, at: TermContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return what measuring at each node alone would tell of all stations; (ny, nx)."""
        near = nodes.grid_m[nodes.window]
        found = np.sum(
            [
                self.node_gain(
                    station if posterior is now else _anticipated(station, posterior, nodes, near),
                    posterior,
                )
                for station, now, posterior in zip(
                    nodes.stations, at.stations, at.anticipated, strict=True
                )
            ],
            axis=0,
        )
        # A node that is measured already brings nothing.
        is_open = np.ones(found.shape, dtype=np.bool_)
        is_open[nodes.window] = at.near_measuring.is_open(near.reshape(-1, 2)).reshape(
            near.shape[:2]
        )
        found[~is_open] = 0.0
        return found


@dataclass(frozen=True, eq=False)
class _Anticipated:
    """A station's predictions at the nodes, the others' measurements counted within reach."""

    mean_db: NDArray[np.float64]
    deviation_db: NDArray[np.float64]
    trend: NDArray[np.float64]


def _anticipated(
    station: NodeChannel,
    posterior: ChannelPosterior,
    nodes: Nodes,
    near_m: NDArray[np.float64],
) -> _Anticipated:
    known = np.isfinite(station.deviation_db[nodes.window])
    spread = np.full(known.shape, np.nan)
    if known.any():
        spread[known] = posterior.predict(near_m[known]).deviation_db
    deviation = station.deviation_db.copy()
    deviation[nodes.window] = spread
    return _Anticipated(station.mean_db, deviation, station.trend)
