"""What many ways are worth at once, from the measurements near them all: for choosing among them.

The terms are those of :mod:`planopt.planning.worth.path_worth`, by the same formulae, batched over
ways. One set of measurements serves them all, so that the cost grows neither with their number nor,
by much, with that of the ways. Where the set is all there are, nothing but rounding is between the
two, the largest products being in single precision; what is chosen here is valued again there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.local_channel import (
    LocalChannel,
    LocalGrid,
    local_channel,
    local_grid,
)
from planopt.planning.search.ranked_terms import RankedWays, ranked_value
from planopt.planning.search.way_batch import WayBatch
from planopt.planning.search.ways_missing import ways_missing
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import MappingTerm

ANCHORS = 64
"""Places among those of all ways that measurements are chosen near to."""

LEAST_NEIGHBOURS, STEP_NEIGHBOURS, MOST_NEIGHBOURS = 96, 16, 384
"""Measurements shared by all ways: so many, so many more for each step, and never more. They cover
all that can be reached, so that they are more than a polish needs about one way: with 128 of 400,
the ways of 20 steps that were chosen lost a tenth of the best worth."""

RANKED_PLACES = 300
"""Of the places where a map is wanted, about so many are looked at, evenly among them."""

MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest worth of the ways first valued."""


class LocalRanking:
    """Values ways of one situation.

    Parameters
    ----------
    situation
        What is known.
    about_m
        ``(c, N, 2)`` ways like those that will be valued: measurements near them are used.
    """

    def __init__(self, situation: Situation, about_m: NDArray[np.float64]) -> None:
        self._situation = situation
        count = min(LEAST_NEIGHBOURS + STEP_NEIGHBOURS * int(about_m.shape[1]), MOST_NEIGHBOURS)
        self._missing_db_cost: float | None = None
        averages = any(
            isinstance(t, MappingTerm) and t.form == "average" for t in situation.problem.terms
        )
        self._stations = [
            self._station(posterior, _anchors(about_m), count, averages=averages)
            for posterior in situation.stations
        ]

    def _station(
        self,
        posterior: ChannelPosterior,
        anchors_m: NDArray[np.float64],
        count: int,
        *,
        averages: bool,
    ) -> tuple[LocalChannel, NDArray[np.float32], LocalGrid | None]:
        """One station's channel near the ways, its precision, and where its map is wanted."""
        channel, grid = local_channel(posterior, anchors_m, count), None
        if averages:
            region = self._situation.near_region
            every = max(1, round(len(region.weight) / RANKED_PLACES))
            grid = local_grid(channel, region.grid_m[::every], every * region.weight[::every])
        return channel, channel.precision.astype(np.float32), grid

    def __call__(self, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weighted sum of the terms of each way ``(c, N, 2)``, near its exact worth; ``(c,)``.

        Where connectivity is bounded, ways that miss the bound come after all others.
        """
        at = self._situation
        ways = RankedWays(
            at,
            ways_m,
            [WayBatch(channel, precision, ways_m) for channel, precision, _ in self._stations],
            [grid for _, _, grid in self._stations],
        )
        worth = np.zeros(len(ways_m))
        for term in at.problem.terms:
            worth += term.weight * ranked_value(term, ways)
        if not at.problem.constraints.asks_connection:
            return worth
        if self._missing_db_cost is None:
            self._missing_db_cost = MISSING_DB_SHARE * float(np.abs(worth).max())
        missing = ways_missing(at, ways.legs_m, ways.power)
        return worth - self._missing_db_cost * missing


def _anchors(ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Up to `ANCHORS` of the ways' places, evenly among them; (a, 2)."""
    places = ways_m.reshape(-1, 2)
    return places[np.linspace(0, len(places) - 1, min(ANCHORS, len(places))).astype(np.intp)]
