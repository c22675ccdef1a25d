"""Places where a robot knows whether its packets arrive, because it has been there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.channel.neighbours import PlaceTree
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.measuring import SAME_PLACE_M


@dataclass(frozen=True, eq=False)
class KnownLinks:
    """Places where connection was found, and those where it was missed.

    Multipath stays what it is at a place. A robot that was connected there will be again; a little
    beside it is predicted as anywhere else. Nearer than the spacing of measurements to a place
    without connection there is none: a robot does not try what it would not measure either.
    """

    connected_m: NDArray[np.float64]  # (n, 2) places with connection
    lost_m: NDArray[np.float64]  # (m, 2) places without
    spacing_m: float  # Nearer than this to a place without connection there is none

    def chances(
        self, places_m: NDArray[np.float64], predicted: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the probability of connection at places; unobserved ones keep `predicted`."""
        # Shapes: places_m (..., 2); predicted (...).
        flat, found = places_m.reshape(-1, 2), predicted.reshape(-1).copy()
        for tree, within_m, chance in self._trees:
            _, away = tree.nearest(flat, 1, within_m)
            found[np.isfinite(away[:, 0])] = chance
        return found.reshape(predicted.shape)

    @cached_property
    def _trees(self) -> list[tuple[PlaceTree, float, float]]:
        """Places with how far they reach and the chance there; what comes later counts."""
        known = (self.lost_m, self.spacing_m, 0.0), (self.connected_m, SAME_PLACE_M, 1.0)
        return [
            (PlaceTree(places), reach, chance) for places, reach, chance in known if len(places)
        ]


def known_links(
    stations: Sequence[ChannelPosterior],
    thresholds_dbm: Sequence[float],
    missed_m: NDArray[np.float64],  # (k, 2) where steps ended without connection
    here_m: NDArray[np.float64],  # (2,) where the robot is
    is_connected: bool | None,
    spacing_m: float,
) -> KnownLinks:
    """Return what measurements and the run so far tell of connection."""
    up: list[NDArray[np.float64]] = []
    down = [missed_m]
    for station, threshold in zip(stations, thresholds_dbm, strict=True):
        measured = station.measurements
        places = measured.positions_m
        # Of a censored power only an upper limit is known.
        arrives = (measured.power_dbm >= threshold) & ~measured.censored
        up.append(places[arrives])
        if len(stations) == 1:
            # Of several stations another one may serve the place.
            down.append(places[measured.power_dbm < threshold])
    if is_connected is not None:
        (up if is_connected else down).append(here_m[None])
    return KnownLinks(np.vstack(up), np.vstack(down), max(spacing_m, SAME_PLACE_M))
