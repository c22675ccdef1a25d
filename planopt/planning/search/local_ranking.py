"""Ranking of many paths by the objective, with a shared set of measurements near all of them.

The shared set makes the cost almost independent of the number of paths. If the set contains all
measurements, ranking and objective value differ only by single-precision rounding.
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
"""Numbers of path positions and map positions near which measurements are selected."""

LEAST_NEIGHBOURS, STEP_NEIGHBOURS, MOST_NEIGHBOURS = 96, 16, 256
"""Number of measurements shared by all paths: minimum, increment per step, maximum."""

MAPPED_NEIGHBOURS = 384
"""Number of shared measurements for map averages: with 256, 20-step paths along the edge of the
measured area were overrated."""

RANKED_PLACES, CLIMBED_PLACES = 300, 1000
"""Approximate number of map positions evaluated for ranking, and for climbing."""

MISSING_DB_SHARE = 10.0
"""Cost of a missing dB relative to the largest value in the first batch of ranked paths."""


def can_climb(problem: Problem) -> bool:
    """Return whether :meth:`LocalRanking.slopes` supports all terms of a problem."""
    return all(type(term).slope is not Term.slope for term in problem.terms)


@dataclass(frozen=True, eq=False)
class _Station:
    """Local channel model of one station, with map grids for climbing and for ranking."""

    channel: LocalChannel
    precision: NDArray[np.float32]
    fine: LocalGrid | None
    coarse: LocalGrid | None


class LocalRanking:
    """Ranking of paths in one step context."""

    def __init__(self, context: StepContext, about_m: NDArray[np.float64]) -> None:
        self._context = context
        most = MAPPED_NEIGHBOURS if _averages_map(context.problem) else MOST_NEIGHBOURS
        count = min(LEAST_NEIGHBOURS + STEP_NEIGHBOURS * int(about_m.shape[1]), most)
        anchors = _anchors(about_m, ANCHORS)
        self._missing_db_cost: float | None = None
        self._measures = any(term.is_measured for term in context.problem.terms)

        def near(posterior: ChannelPosterior) -> _Station:
            channel = LocalChannel.around(posterior, anchors, count)
            fine = self._grid(channel, _anchors(about_m, REGION_ANCHORS))
            coarse = None if fine is None else _thinned(fine)
            return _Station(channel, channel.precision.astype(np.float32), fine, coarse)

        self._expected = [near(posterior) for posterior in context.anticipated]
        # The predicted power excludes the other robots' future measurements.
        same = context.anticipated == context.stations
        self._stations = self._expected if same else [near(each) for each in context.stations]

    def _grid(self, channel: LocalChannel, about_m: NDArray[np.float64]) -> LocalGrid | None:
        """Return the part of the map that paths near `about_m` (a, 2) change, if any."""
        at = self._context
        if not _averages_map(at.problem):
            return None
        region = region_along(at.problem, at.near_region, about_m)
        every = max(1, round(len(region.weight) / CLIMBED_PLACES))
        return LocalGrid.of(channel, region.grid_m[::every], every * region.weight[::every])

    def __call__(self, paths_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the objective values of paths (c, N, 2), minus the penalty of a violated bound."""
        gate = None
        if self._measures:
            taken = self._context.near_measuring.takes(paths_m)
            gate = None if taken.all() else taken.astype(np.float64)
        measured = self._along(self._expected, paths_m, climbed=False)
        return self._value(self._paths(measured, gate, climbed=False))

    def slopes(
        self, paths_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the smoothed values of paths, and their gradients by position ``(c, N, 2)``."""
        at = self._context
        gates = at.near_measuring.gates(paths_m) if self._measures else None
        measured = self._along(self._expected, paths_m, climbed=True)
        paths = self._paths(measured, None if gates is None else gates.value, climbed=True)
        value = self._value(paths)
        slopes: list[NDArray[np.float64]] = []
        for number, along in enumerate(measured):
            pull = Pull()
            for term in at.problem.terms:
                if number and not term.is_measured:
                    continue  # Already counted with the first station.
                with calling(term, "slope", key="objective.terms"):
                    pull = pull.plus(term.slope(paths, number), term.weight)
            if self._missing_db_cost is not None and len(at.stations) == 1:
                # With several stations the gradient of the connectivity bound is omitted.
                own = paths.stations[0]
                lacking = Pull().plus(missing_slope(at, own), -self._missing_db_cost)
                if own is along:
                    pull = pull.plus(lacking)
                else:
                    slopes.append(own.slopes(lacking))
            slopes.append(along.slopes(pull, gates))
        return value, slopes[0] if len(slopes) == 1 else np.sum(slopes, axis=0)

    def _along(
        self, stations: Sequence[_Station], paths_m: NDArray[np.float64], *, climbed: bool
    ) -> list[LocalPaths]:
        """Return each station's predicted power along the paths."""
        return [
            LocalPaths(own.channel, own.precision, paths_m, own.fine if climbed else own.coarse)
            for own in stations
        ]

    def _paths(
        self, measured: list[LocalPaths], gate: NDArray[np.float64] | None, *, climbed: bool
    ) -> Paths:
        paths_m, stations = measured[0].paths_m, measured
        if self._stations is not self._expected:
            stations = self._along(self._stations, paths_m, climbed=climbed)
        return Paths(self._context, paths_m, stations, [own.moments(gate) for own in measured])

    def _value(self, paths: Paths) -> NDArray[np.float64]:
        at = self._context
        value = np.zeros(len(paths.paths_m))
        for term in at.problem.terms:
            with calling(term, "values", key="objective.terms"):
                found = term.values(paths)
            value += term.weight * returned(
                term, "values", found, value.shape, words="one number for each path", unbounded=True
            )
        if not at.problem.constraints.asks_connection:
            return value
        if self._missing_db_cost is None:
            self._missing_db_cost = MISSING_DB_SHARE * float(np.abs(value).max())
        return value - self._missing_db_cost * missing(at, paths.legs_m, paths.power)


def _averages_map(problem: Problem) -> bool:
    """Return whether any term is a spatial average of the map."""
    return any(term.averages_map for term in problem.terms)


def _thinned(grid: LocalGrid) -> LocalGrid:
    """Return every k-th position of a grid, about `RANKED_PLACES` in total."""
    every = max(1, round(len(grid.root_weight) / RANKED_PLACES))
    return LocalGrid(
        grid.positions_m[::every],
        math.sqrt(every) * grid.root_weight[::every],
        grid.solved[:, ::every],
        grid.trend[::every],
    )


def _anchors(paths_m: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return up to `count` evenly selected positions of the paths; (a, 2)."""
    places = paths_m.reshape(-1, 2)
    return places[np.linspace(0, len(places) - 1, min(count, len(places))).astype(np.intp)]
