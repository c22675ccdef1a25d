"""Value many ways at once, from the measurements near them all, to choose among them.

The terms are those of :mod:`planopt.planning.values.objective_value`, by the same formulae, batched
over ways. One set of measurements serves them all, so that the cost grows neither with their number
nor, by much, with that of the ways. Where the set is all there are, nothing but rounding is between
the two, the largest products being in single precision; what is chosen here is valued again there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.moments import LocalPaths, Pull
from planopt.objectives.terms.context import Paths
from planopt.objectives.terms.term import Term
from planopt.parts import calling, returned
from planopt.planning.values.context import StepContext
from planopt.planning.values.exploration import region_along
from planopt.planning.values.rule_rows import missing, missing_slope
from planopt.problems.problem import Problem

ANCHORS, REGION_ANCHORS = 24, 64
"""Places among those of all ways that measurements are chosen near to, and places of a map."""

LEAST_NEIGHBOURS, STEP_NEIGHBOURS, MOST_NEIGHBOURS = 96, 16, 256
"""Measurements shared by all ways: so many, so many more for each step, and never more. They cover
all that can be reached, so that they are more than a refinement needs about one way."""

MAPPED_NEIGHBOURS = 384
"""Never more than these where a map is averaged, which is wanted beyond the ways: with 256 the best
ways of 20 steps seemed to be those at the edge of what was measured."""

RANKED_PLACES, CLIMBED_PLACES = 300, 1000
"""Of the places where a map is wanted, about so many are looked at, evenly among them: when ways
are ranked, and when they climb, which would lead them from one place to the next if these were
few."""

MISSING_DB_SHARE = 10.0
"""What a missing dB costs, in units of the largest worth of the ways first valued."""


def can_climb(problem: Problem) -> bool:
    """Return whether :meth:`LocalRanking.slopes` knows all terms of a problem."""
    return all(type(term).slope is not Term.slope for term in problem.terms)


@dataclass(frozen=True, eq=False)
class _Station:
    """One station's channel near the ways, and where its map is wanted: to climb, and to rank."""

    channel: LocalChannel
    precision: NDArray[np.float32]
    fine: LocalGrid | None
    coarse: LocalGrid | None


class LocalRanking:
    """Values ways of one situation."""

    def __init__(self, situation: StepContext, about_m: NDArray[np.float64]) -> None:
        self._situation = situation
        most = MAPPED_NEIGHBOURS if _averages_map(situation.problem) else MOST_NEIGHBOURS
        count = min(LEAST_NEIGHBOURS + STEP_NEIGHBOURS * int(about_m.shape[1]), most)
        anchors = _anchors(about_m, ANCHORS)
        self._missing_db_cost: float | None = None
        self._measures = any(term.is_measured for term in situation.problem.terms)

        def near(posterior: ChannelPosterior) -> _Station:
            channel = LocalChannel.around(posterior, anchors, count)
            fine = self._grid(channel, _anchors(about_m, REGION_ANCHORS))
            coarse = None if fine is None else _thinned(fine)
            return _Station(channel, channel.precision.astype(np.float32), fine, coarse)

        self._told = [near(posterior) for posterior in situation.anticipated]
        # Power is predicted from what is known now, whatever the others will have measured.
        same = situation.anticipated == situation.stations
        self._stations = self._told if same else [near(each) for each in situation.stations]

    def _grid(self, channel: LocalChannel, about_m: NDArray[np.float64]) -> LocalGrid | None:
        """Return about `CLIMBED_PLACES` of the map that ways about `about_m` (a, 2) can change.

        None where none is averaged. Of places farther away the measurements at hand know too
        little, and ways would seem to tell much of them.
        """
        at = self._situation
        if not _averages_map(at.problem):
            return None
        region = region_along(at.problem, at.near_region, about_m)
        every = max(1, round(len(region.weight) / CLIMBED_PLACES))
        return LocalGrid.of(channel, region.grid_m[::every], every * region.weight[::every])

    def __call__(self, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weighted sum of the terms of each way ``(c, N, 2)``, near its exact worth; ``(c,)``.

        Where connectivity is bounded, ways that miss the bound come after all others.
        """
        gate = None
        if self._measures:
            taken = self._situation.near_measuring.takes(ways_m)
            gate = None if taken.all() else taken.astype(np.float64)
        measured = self._along(self._told, ways_m, climbed=False)
        return self._value(self._ways(measured, gate, climbed=False))

    def slopes(
        self, ways_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values with smooth gates, and their derivatives by the places ``(c, N, 2)``.

        The same values where gates are open or closed, and lower ones between.
        """
        at = self._situation
        gates = at.near_measuring.gates(ways_m) if self._measures else None
        measured = self._along(self._told, ways_m, climbed=True)
        ways = self._ways(measured, None if gates is None else gates.value, climbed=True)
        value = self._value(ways)
        slopes: list[NDArray[np.float64]] = []
        for number, paths in enumerate(measured):
            pull = Pull()
            for term in at.problem.terms:
                if number and not term.is_measured:
                    continue  # it was counted with the first
                with calling(term, "slope", key="objective.terms"):
                    pull = pull.plus(term.slope(ways, number), term.weight)
            if self._missing_db_cost is not None and len(at.stations) == 1:
                # With several, a way climbs as if there were no bound, but takes no step that
                # misses more.
                own = ways.stations[0]
                lacking = Pull().plus(missing_slope(at, own), -self._missing_db_cost)
                if own is paths:
                    pull = pull.plus(lacking)
                else:
                    slopes.append(own.slopes(lacking))
            slopes.append(paths.slopes(pull, gates))
        return value, slopes[0] if len(slopes) == 1 else np.sum(slopes, axis=0)

    def _along(
        self, stations: Sequence[_Station], ways_m: NDArray[np.float64], *, climbed: bool
    ) -> list[LocalPaths]:
        """Return each station's power along the ways."""
        return [
            LocalPaths(own.channel, own.precision, ways_m, own.fine if climbed else own.coarse)
            for own in stations
        ]

    def _ways(
        self, measured: list[LocalPaths], gate: NDArray[np.float64] | None, *, climbed: bool
    ) -> Paths:
        ways_m, stations = measured[0].paths_m, measured
        if self._stations is not self._told:
            stations = self._along(self._stations, ways_m, climbed=climbed)
        return Paths(self._situation, ways_m, stations, [own.moments(gate) for own in measured])

    def _value(self, ways: Paths) -> NDArray[np.float64]:
        at = self._situation
        worth = np.zeros(len(ways.paths_m))
        for term in at.problem.terms:
            with calling(term, "values", key="objective.terms"):
                found = term.values(ways)
            worth += term.weight * returned(
                term, "values", found, worth.shape, words="one number for each path", unbounded=True
            )
        if not at.problem.constraints.asks_connection:
            return worth
        if self._missing_db_cost is None:
            self._missing_db_cost = MISSING_DB_SHARE * float(np.abs(worth).max())
        return worth - self._missing_db_cost * missing(at, ways.legs_m, ways.power)


def _averages_map(problem: Problem) -> bool:
    """Return whether a term is the spatial average of the map."""
    return any(term.averages_map for term in problem.terms)


def _thinned(grid: LocalGrid) -> LocalGrid:
    """Return about `RANKED_PLACES` of a grid, evenly among them, for all."""
    every = max(1, round(len(grid.root_weight) / RANKED_PLACES))
    return LocalGrid(
        grid.positions_m[::every],
        math.sqrt(every) * grid.root_weight[::every],
        grid.solved[:, ::every],
        grid.trend[::every],
    )


def _anchors(ways_m: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return up to `count` of the ways' places, evenly among them; (a, 2)."""
    places = ways_m.reshape(-1, 2)
    return places[np.linspace(0, len(places) - 1, min(count, len(places))).astype(np.intp)]
