"""Records: what the motes know of an object, and the records that a pursuer gets from them.

A mote takes the report of the finest level whose last completed round shows the object in its own
cell of that level or in one around it. Finer levels are never older, so that this is the freshest
report as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.service import SnapshotService


@dataclass(frozen=True, eq=False)
class Track:
    """The track of an object: straight and even between the given times.

    Before the first time it stood at its first position, after the last it stands at the last.
    """

    times_s: NDArray[np.float64]  # (n,) ascending
    positions_m: NDArray[np.float64]  # (n, 2)

    def at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the position at each time (...); ``(..., 2)``."""
        along = [np.interp(times_s, self.times_s, self.positions_m[:, axis]) for axis in (0, 1)]
        return np.asarray(np.stack(along, axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The last completed round of each level, for one object."""

    service: SnapshotService
    time_s: float  # When it is asked for
    sampled_s: NDArray[np.float64]  # (L + 1,) when each level sampled
    sampled_m: NDArray[np.float64]  # (L + 1, 2) where the object was then, and what is reported
    reported_m: NDArray[np.float64]
    cells: NDArray[np.int64]  # (L + 1, 2) the object's cell of each level then, column and row

    @property
    def ages_s(self) -> NDArray[np.float64]:
        """``(L + 1,)``."""
        return self.time_s - self.sampled_s

    @property
    def errors_m(self) -> NDArray[np.float64]:
        """``(L + 1,)`` distance from what is reported to where the object was."""
        return np.linalg.norm(self.reported_m - self.sampled_m, axis=1)

    def shown_at(self, mote: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which levels show the object to a mote (2,), column and row; ``(L + 1,)``."""
        own = mote >> np.arange(self.service.levels + 1)[:, None]
        return np.asarray((np.abs(own - self.cells) <= 1).all(axis=1), dtype=np.bool_)

    def level_map(self) -> NDArray[np.int8]:
        """Return the level that every mote takes its report from; ``(n, n)``, rows being y.

        It is -1 where no level shows the object, which may be on endless grids alone.
        """
        side = self.service.motes_per_side
        found = np.full((side, side), -1, dtype=np.int8)
        for level in range(self.service.levels, -1, -1):
            column, row = (int(number) for number in self.cells[level])
            x, y = (
                slice(max(0, (number - 1) << level), max(0, (number + 2) << level))
                for number in (column, row)
            )
            found[y, x] = level
        return found


def snapshot(service: SnapshotService, track: Track, time_s: float) -> Snapshot:
    """Return what the motes know at `time_s` of the object that moved along `track`."""
    sampled_s = service.sample_numbers(time_s) * service.periods_s
    sampled_m = track.at(sampled_s)
    on_grid = (sampled_m >= 0.0) & (sampled_m <= service.side_m)
    if not (service.endless or on_grid.all()):
        raise InputError(
            "the object left the grid of motes",
            key="positions_m",
            remedy=f"keep it in the square from (0, 0) to {service.side_m:g} m",
        )
    levels = range(service.levels + 1)
    return Snapshot(
        service,
        time_s,
        sampled_s,
        sampled_m,
        np.array([service.reported_m(sampled_m[level], level) for level in levels]),
        np.array([service.cells(sampled_m[level], level) for level in levels]),
    )


def mote_centres_m(service: SnapshotService) -> NDArray[np.float64]:
    """Return the position of every mote, ``(n, n, 2)``, rows being y."""
    along = (np.arange(service.motes_per_side) + 0.5) * service.mote_spacing_m
    return np.asarray(np.stack(np.meshgrid(along, along), axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Record:
    """The record of an evader."""

    sampled_s: float  # When it was seen
    reported_m: NDArray[np.float64]  # (2,) where, as far as is told
    error_m: float  # How far off that is at most


class RecordSource(Protocol):
    """The source of a pursuer's records."""

    def record(
        self,
        track: Track,
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return what is known at a place and time of the evader on `track`; None for nothing.

        `last` is the record in use. The track ends now.
        """
        ...


@dataclass(frozen=True, eq=False)
class SnapshotRecords:
    """Records of the mote that the pursuer stands at: the freshest level that shows the evader."""

    service: SnapshotService  # The grid
    # (L + 1, k) which rounds of each level have no report of the evader at the pursuer's mote,
    # because it was missed or hops were lost; round n is column n modulo k. None if none are.
    lost: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        rows = self.service.levels + 1
        if self.lost is not None and (self.lost.ndim != 2 or len(self.lost) != rows):
            raise InputError(f"lost rounds need {rows} rows, one a level", key="lost")

    def record(
        self,
        track: Track,
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the report of the finest level that shows the evader to the mote here."""
        now = snapshot(self.service, track, time_s)
        shown = now.shown_at(self.service.cells(place_m, 0))
        if self.lost is not None:
            rounds = self.service.sample_numbers(time_s) % self.lost.shape[1]
            shown &= ~self.lost[np.arange(len(rounds)), rounds]
        if not shown.any():
            return None
        level = int(shown.argmax())
        return Record(
            float(now.sampled_s[level]), now.reported_m[level], self.service.error_bound_m(level)
        )


def draw_lost_rounds(
    service: SnapshotService, probability: float, rounds: int, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Draw which rounds are lost, each on its own, for :class:`SnapshotRecords`."""
    return generator.random((service.levels + 1, rounds)) < probability
