"""Each mote's knowledge of an object: its level, the age and the exactness of the report.

A mote takes the report of the finest level whose last completed round shows the object in its own
cell of that level or in one around it. Finer levels are never older, so that this is the freshest
report as well.
"""

from __future__ import annotations

from dataclasses import dataclass

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
