"""Maps of how probably links to base stations fail, learnt from measurements of their power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError

NODES = 120
"""Nodes of a map along the longer side of its bounds."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StationMap:
    """Probabilities that links to stations fail; :func:`station_map` makes it."""

    posteriors: tuple[ChannelPosterior, ...]  # The channel to each of s stations, as learnt
    nodes_m: Floats  # (m, 2) nodes of an even grid
    # Each node stands for a disc of this radius; the discs hold all places within the bounds
    radius_m: float
    # (s, m) the largest probability found about each node: of its neighbours, and of measured
    # places nearby, where the predicted power may have its peaks
    failures: Floats

    def near(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the largest probabilities ``(n, s)`` near lines from starts to ends, (n, 2) each.

        The places are those within the radius of a node whose disc meets the line.
        """
        worst = np.ones((len(starts_m), len(self.posteriors)))
        for row, start, end in zip(worst, starts_m, ends_m, strict=True):
            met = line_distances_m(self.nodes_m, start, end)[1] <= self.radius_m
            row[:] = self.failures[:, met].max(axis=1, initial=0.0) if met.any() else 1.0
        return worst


def line_distances_m(places_m: Floats, start_m: Floats, end_m: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of a line to places, ``(m, 2)``, and distances ``(m,)``."""
    # Shapes: places_m (m, 2); start_m, end_m (2,).
    along, offset = end_m - start_m, places_m - start_m
    square = float(along @ along)
    share = np.clip(offset @ along / (square if square > 0.0 else 1.0), 0.0, 1.0)
    foot = start_m + share[:, None] * along
    return foot, np.linalg.norm(places_m - foot, axis=1)


def station_map(
    posteriors: Sequence[ChannelPosterior],
    threshold_dbm: float,
    bounds_m: tuple[float, float, float, float],  # (x_min, y_min, x_max, y_max)
) -> StationMap:
    """Map how probably the power from each station is below a threshold."""
    x_min, y_min, x_max, y_max = bounds_m
    longest = max(x_max - x_min, y_max - y_min)
    if not posteriors or not (x_min < x_max and y_min < y_max):
        raise InputError("no station, or nothing to map", key="radio.survey")
    side = longest / NODES
    x, y = np.arange(x_min, x_max + side, side), np.arange(y_min, y_max + side, side)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    failures = np.empty((len(posteriors), len(nodes)))
    for row, posterior in zip(failures, posteriors, strict=True):
        fails = 1.0 - posterior.connectivity(nodes, threshold_dbm)
        measured = posterior.measurements.positions_m
        at = np.rint((measured - (x_min, y_min)) / side).astype(np.intp)
        inside = ((at >= 0) & (at < (len(x), len(y)))).all(axis=1)
        cell = at[inside, 1] * len(x) + at[inside, 0]
        np.maximum.at(fails, cell, 1.0 - posterior.connectivity(measured[inside], threshold_dbm))
        image = fails.reshape(len(y), len(x))
        row[:] = np.ravel(cast("Floats", maximum_filter(image, size=3, mode="nearest")))
    return StationMap(tuple(posteriors), nodes, side / np.sqrt(2.0), failures)
