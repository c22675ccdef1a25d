"""Factors of measurements near plans, kept from one step to the next.

A robot's plans change little from step to step: their places lie where those of the last one lay,
and one measurement has come in. Places that lie close together share a group of measurements and
its factor. A group that lacks a few of the measurements nearest to a place takes them in by rows;
one that has more than the nearest is as honest, and never less informed.

Censored and coarsely rounded measurements as Gaussian ones, where there are very many.

The same fixed point as :func:`planopt.channel.intervals.censoring.gaussian_sites`, but for the
measurements left out beside each block, at a cost linear in their number
(:mod:`planopt.channel.nearest.windows`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import FactorBuffer, append_rows
from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2, intervals, needs_site
from planopt.channel.intervals.sites import Sites, rounded_variance_db2
from planopt.channel.measurement_covariance import (
    measured_origins,
    measured_path_loss_variance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.close_places import Rows, close_together
from planopt.channel.nearest.windows import (
    BLOCK,
    SITE_BESIDE,
    IntervalRows,
    WindowSites,
    place_blocks,
    surrounding_windows,
    window_sites,
)
from planopt.channel.parameters import ChannelParameters, regressors

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior

BUILT_SHARE = 1.3
"""Most measurements of a new group, as a multiple of those each place needs; a factor costs their
cube."""

GROWN_SHARE = 1.5
"""The same of a group that has taken more in; beyond, it is forgotten."""

LACKING_SHARE = 0.125
"""A group that lacks no more than this share of what a place needs takes it in."""

MOST_UNUSED = 8
"""Groups kept beside those used last; the one longest unused goes first. Each takes 5 MB at 512
measurements a place."""


@dataclass(eq=False)
class NearGroup:
    """Measurements with their factor."""

    parameters: ChannelParameters  # The channel's, as the factor was made with
    used: NDArray[np.intp]  # (m,) numbers of the measurements, in the order of the factor's rows
    given: NDArray[np.float64]  # (m, 6) what the factor and `columns` rest on, to be recognised by
    columns: NDArray[np.float64]  # (m, 3) L^-1 [y, Gamma]
    buffer: FactorBuffer  # Where L is

    @property
    def lower(self) -> NDArray[np.float64]:
        """L, ``(m, m)``; a view."""
        count = len(self.used)
        return self.buffer.lower[:count, :count]

    def belongs_to(self, posterior: ChannelPosterior) -> bool:
        """Return whether these are measurements of `posterior`, under the same numbers."""
        return (
            self.parameters == posterior.parameters
            and int(self.used.max()) < len(posterior.measurements)
            and np.array_equal(self.given, _given(posterior, self.used))
        )

    def take_in(self, posterior: ChannelPosterior, more: NDArray[np.intp]) -> None:
        """Add the measurements `more` (k,)."""
        self.used = np.concatenate([self.used, more])
        self.given = np.concatenate([self.given, _given(posterior, more)])
        columns = np.empty((len(more), 3))
        columns[:, 0] = posterior.values_db[more]
        at = posterior.measurements.positions_m[more]
        columns[:, 1:] = regressors(at, self.parameters.station)
        self.columns = np.concatenate([self.columns, columns])
        append_rows(
            self.buffer,
            self.parameters,
            posterior.origins.at(self.used).without_offsets(),
            posterior.noise_variance_db2[self.used],
            self.columns,
        )


class NearFactors:
    """Groups of measurements that the last predictions rested on.

    Shared by a posterior and those that extend it. A pickled copy has none.
    """

    def __init__(self) -> None:
        # The one used last stands last.
        self._groups: list[NearGroup] = []
        # Those that belong to the posterior served last.
        self._known: list[NearGroup] = []
        self._last: ChannelPosterior | None = None
        # Of groups that went: memory that was never written to costs as much as a factor.
        self._spare: list[FactorBuffer] = []

    def __len__(self) -> int:
        return len(self._groups)

    def __getstate__(self) -> dict[str, list[NearGroup] | list[FactorBuffer] | None]:
        return {"_groups": [], "_known": [], "_last": None, "_spare": []}

    def serving(
        self, posterior: ChannelPosterior, places_m: NDArray[np.float64], count: int
    ) -> list[tuple[NearGroup, Rows]]:
        """Groups and the places they serve; every place has its `count` nearest in its group."""
        # Shapes: places_m (n, 2).
        near, _ = posterior.index.nearest(places_m, count)
        goes_on = self._last is not None and posterior.continues(self._last)
        known = [
            group
            for group in self._groups
            if (goes_on and group in self._known) or group.belongs_to(posterior)
        ]
        chosen, lacking = _least_lacking(known, near, len(posterior.measurements))
        left = lacking.sum(axis=1) > LACKING_SHARE * count
        found: list[tuple[NearGroup, Rows]] = []
        for number, group in enumerate(known):
            rows = np.flatnonzero((chosen == number) & ~left)
            if not len(rows):
                continue
            more = np.unique(near[rows][lacking[rows]])
            if len(group.used) + len(more) > GROWN_SHARE * count:
                left[rows] = True
                self._forget([group])
                continue
            if len(more):
                group.take_in(posterior, more)
            found.append((group, rows))
        rows = np.flatnonzero(left)
        if len(rows):
            for part in close_together(places_m[rows], near[rows], BUILT_SHARE * count):
                used = np.unique(near[rows[part]])
                group = self._new_group(posterior, used, int(GROWN_SHARE * count))
                found.append((group, rows[part]))
        served = [group for group, _ in found]
        self._groups = [group for group in self._groups if group not in served] + served
        self._forget(self._groups[: -len(served) - MOST_UNUSED])
        self._known = [group for group in self._groups if group in served or group in known]
        self._last = posterior
        return found

    def _forget(self, groups: list[NearGroup]) -> None:
        self._groups = [group for group in self._groups if group not in groups]
        self._spare = [*self._spare, *(group.buffer for group in groups)][-MOST_UNUSED:]

    def _new_group(
        self, posterior: ChannelPosterior, used: NDArray[np.intp], capacity: int
    ) -> NearGroup:
        roomy = [spare for spare in self._spare if len(spare.lower) >= max(capacity, len(used))]
        if roomy:
            buffer = roomy[0]
            self._spare.remove(buffer)
            buffer.used = 0
        else:
            buffer = FactorBuffer(max(capacity, len(used)))
        group = NearGroup(
            posterior.parameters, used[:0], np.zeros((0, 6)), np.zeros((0, 3)), buffer
        )
        group.take_in(posterior, used)
        return group


def _least_lacking(
    groups: list[NearGroup], near: NDArray[np.intp], total: int
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """The group that lacks fewest of `near` (n, count) for each place, and which ones it lacks."""
    chosen = np.zeros(len(near), dtype=np.intp)
    lacking = np.ones(near.shape, dtype=bool)
    fewest = lacking.sum(axis=1)
    for number, group in enumerate(groups):
        outside = np.ones(total, dtype=bool)
        outside[group.used] = False
        lacks = outside[near]
        better = lacks.sum(axis=1) < fewest
        chosen[better] = number
        lacking[better] = lacks[better]
        fewest = lacking.sum(axis=1)
    return chosen, lacking


def _given(posterior: ChannelPosterior, used: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the data behind covariance and columns of the measurements `used` (m,); ``(m, 6)``."""
    measured = posterior.measurements
    return np.column_stack(
        [
            measured.positions_m[used],
            measured.position_std_m[used],
            measured.time_s[used],
            posterior.values_db[used],
            posterior.noise_variance_db2[used],
        ]
    )


TOLERANCE = 1e-3
"""Sites have converged when none moves by more than this in units of its posterior: less than what
the measurements left out change. It takes some ten sweeps."""


def neighbour_sites(
    parameters: ChannelParameters, measurements: Measurements, start: Sites | None = None
) -> Sites:
    """Replace censored and rounded measurements like `gaussian_sites`, each by its neighbours."""
    omega2 = parameters.multipath_std_db**2
    values = measurements.power_dbm.astype(np.float64)
    variances = omega2 + rounded_variance_db2(measurements.resolution_db)
    chosen = needs_site(measurements, omega2)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return Sites(values, variances)
    omega2 = max(omega2, MIN_NOISE_VARIANCE_DB2)
    displaced = measured_path_loss_variance_db2(measurements, parameters)
    blocks = place_blocks(measurements.positions_m, BLOCK)
    found = window_sites(
        replace(parameters, multipath_std_db=math.sqrt(omega2)),
        measured_origins(measurements, parameters),
        (values, np.maximum(variances, MIN_NOISE_VARIANCE_DB2) + displaced),
        IntervalRows(
            rows,
            intervals(measurements.take(rows)),
            displaced[rows],
            surrounding_windows(
                measurements.positions_m,
                tuple(own for own in blocks if chosen[own].any()),
                SITE_BESIDE,
            ),
        ),
        regressors(measurements.positions_m, parameters.station)
        @ [parameters.k_pl_db, parameters.n_pl],
        None
        if start is None
        else WindowSites.like(start.values_db[rows], start.noise_variance_db2[rows]),
        TOLERANCE,
    )
    values[rows], variances[rows] = found.values_db, 1.0 / found.precision
    return Sites(values, variances)
