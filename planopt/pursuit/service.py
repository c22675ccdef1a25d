"""Distance-sensitive snapshot service: a grid of motes with more accurate data on near objects.

Motes form a square grid and communicate with their eight neighbours. Level-j cells are squares of
2^j by 2^j motes. A round of level j samples the cells, gathers each cell's state at the cell's
head, and floods it over the cell and its eight neighbours. A mote thus has fresh, exact reports of
near objects and old, coarse reports of far ones. Time is counted in TDMA frames, in which each mote
sends once: one hop takes one frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

MAX_LEVELS = 12
"""Maximum number of levels (4096 x 4096 motes); maps of a larger grid exceed the memory."""

HOPS_PER_ROUND = 3
"""Frames of a level-0 round: 2^j hops to the head and 2 * 2^j hops from it fit into 3 * 2^j."""

SLOTS_PER_FRAME = 9
"""Minimum number of slots per frame: any 3 by 3 motes need distinct ones (distance-2 colouring)."""

ROUNDING = 1e-9
"""Rounding tolerance at the end of a round, as a share of the round."""


@dataclass(frozen=True)
class ServiceBounds:
    """Bounds of a service on every record in use, at distance d of the object.

    The age of a record is at most ``max(age_s_m * d, age_floor_s)``, its error at most
    ``max(relative_error * d, error_floor_m)``.
    """

    age_s_m: float  # sigma: maximum age per metre, latency plus time since the last round
    relative_error: float  # kappa = 1/k: maximum error per metre
    age_floor_s: float = 0.0  # The same bounds near the object
    error_floor_m: float = 0.0
    # Time between rounds per metre, for services with nested rounds like :class:`SnapshotService`;
    # None for others
    period_s_m: float | None = None

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if value is not None and not 0.0 <= value < math.inf:
                raise InputError(f"{value!r} is not a finite number of at least 0", key=key)


@dataclass(frozen=True)
class SnapshotService:
    """Snapshot service on a grid of ``2^levels`` by ``2^levels`` motes."""

    levels: int  # L: the single cell of level L is the whole grid
    # Distance between neighbours; mote (0, 0) is half of it away from both edges
    mote_spacing_m: float
    frame_s: float  # Duration of a TDMA frame: slots per frame times slot width
    # c: reports resolve 2^-c of the side of a cell, but no less than one mote
    bits_per_axis: int
    hops_per_round: int = HOPS_PER_ROUND  # Frames of a level-0 round
    rate_divisor: int = 1  # r: rounds of a level start every r round durations
    # Whether the grid continues beyond its edges, for pursuits in open space: then cells of level L
    # have neighbours as well
    endless: bool = False

    @property
    def motes_per_side(self) -> int:
        """Return N = 2^L."""
        return 1 << self.levels

    @property
    def side_m(self) -> float:
        """Return the side of the observed square, whose corner is (0, 0)."""
        return self.motes_per_side * self.mote_spacing_m

    @property
    def bounds(self) -> ServiceBounds:
        """Return the bounds that hold for every mote at all times."""
        # If a level j > 0 is used, the object was at least two cells of level j - 1 away when that
        # level sampled it, so that ``2^j < 2 d`` in mote spacings. A round of ``B 2^j`` frames that
        # starts every r lengths implies an age below ``(1 + r) B 2^j < 2 (1 + r) B d`` frames, 12 d
        # for B = 3 and r = 1. Half the diagonal of a sub-cell is ``2^(j - c) / sqrt 2``.
        frame_s_m = 2.0 * self.hops_per_round * self.frame_s / self.mote_spacing_m
        return ServiceBounds(
            age_s_m=(1 + self.rate_divisor) * frame_s_m,
            relative_error=relative_error(self.bits_per_axis),
            age_floor_s=(1 + self.rate_divisor) * self.hops_per_round * self.frame_s,
            error_floor_m=math.sqrt(0.5) * self.mote_spacing_m,
            period_s_m=self.rate_divisor * frame_s_m,
        )

    @property
    def rounds_s(self) -> NDArray[np.float64]:
        """Return the duration of a round from sample to last mote, by level (L + 1,)."""
        return self.hops_per_round * self.frame_s * np.exp2(np.arange(self.levels + 1))

    @property
    def periods_s(self) -> NDArray[np.float64]:
        """Return the time between samples, by level (L + 1,)."""
        return self.rate_divisor * self.rounds_s

    def sample_numbers(self, time_s: float) -> NDArray[np.int64]:
        """Return the numbers (L + 1,) of the last round of each level that ended by `time_s`."""
        # Round k of a level samples at k periods. Numbers may be negative because the network has
        # always been running.
        ended = (time_s - self.rounds_s) / self.periods_s
        return np.floor(ended + ROUNDING).astype(np.int64)

    def cells(self, positions_m: NDArray[np.float64], level: int) -> NDArray[np.int64]:
        """Return the level-j cells (..., 2) as (column, row) of positions (..., 2)."""
        finest = np.floor(positions_m / self.mote_spacing_m).astype(np.int64)
        if not self.endless:
            # The far edges belong to the last motes.
            finest = np.clip(finest, 0, self.motes_per_side - 1)
        return finest >> level

    def reported_m(self, positions_m: NDArray[np.float64], level: int) -> NDArray[np.float64]:
        """Return the centres of the sub-cells reported at level j for positions (..., 2)."""
        fine = max(0, level - self.bits_per_axis)
        side_m = self.mote_spacing_m * (1 << fine)
        return np.asarray((self.cells(positions_m, fine) + 0.5) * side_m, dtype=np.float64)

    def error_bound_m(self, level: int) -> float:
        """Return half the diagonal of the sub-cell of a level-j report."""
        fine = max(0, level - self.bits_per_axis)
        return math.sqrt(0.5) * self.mote_spacing_m * (1 << fine)


def relative_error(bits_per_axis: float) -> float:
    """Return kappa = sqrt 2 * 2^-c: the maximum error per metre of distance, above the floor."""
    return math.sqrt(2.0) * 2.0**-bits_per_axis


@dataclass(frozen=True, eq=False)
class Track:
    """Track of an object: straight at constant speed between times, at rest before and after."""

    times_s: NDArray[np.float64]  # (n,) in ascending order
    positions_m: NDArray[np.float64]  # (n, 2)

    def at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions (..., 2) at times (...)."""
        along = [np.interp(times_s, self.times_s, self.positions_m[:, axis]) for axis in (0, 1)]
        return np.asarray(np.stack(along, axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Last completed round of each level, for one object."""

    service: SnapshotService
    time_s: float  # Time of the snapshot
    sampled_s: NDArray[np.float64]  # (L + 1,) sample time of each level
    sampled_m: NDArray[np.float64]  # (L + 1, 2) position of the object at that time
    reported_m: NDArray[np.float64]  # (L + 1, 2) reported position
    cells: NDArray[np.int64]  # (L + 1, 2) cell of each level at that time, (column, row)

    @property
    def ages_s(self) -> NDArray[np.float64]:
        """Return the age of the record, by level (L + 1,)."""
        return self.time_s - self.sampled_s

    def shown_at(self, mote: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return flags (L + 1,) of the levels that show the object to a mote (column, row)."""
        # A mote uses the report of the finest of them, which is never older than the others.
        own = mote >> np.arange(self.service.levels + 1)[:, None]
        return np.asarray((np.abs(own - self.cells) <= 1).all(axis=1), dtype=np.bool_)

    def level_map(self) -> NDArray[np.int8]:
        """Return the level (n, n) from which each mote takes its report; rows are y."""
        # The level is -1 if none shows the object, which happens only on endless grids.
        side = self.service.motes_per_side
        found = np.full((side, side), -1, dtype=np.int8)
        for level in range(self.service.levels, -1, -1):
            x, y = (
                slice(max(0, (number - 1) << level), max(0, (number + 2) << level))
                for number in self.cells[level].tolist()
            )
            found[y, x] = level
        return found


def snapshot(service: SnapshotService, track: Track, time_s: float) -> Snapshot:
    """Return the snapshot of an object that moved along `track`."""
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
    """Return the position of every mote, ``(n, n, 2)``; rows are y."""
    along = (np.arange(service.motes_per_side) + 0.5) * service.mote_spacing_m
    return np.asarray(np.stack(np.meshgrid(along, along), axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Record:
    """Record of an evader."""

    sampled_s: float  # Sample time
    reported_m: NDArray[np.float64]  # (2,)
    error_m: float  # Maximum error of the reported position


class RecordSource(Protocol):
    """Source of a pursuer's records."""

    def record(
        self, track: Track, place_m: NDArray[np.float64], time_s: float, last: Record | None
    ) -> Record | None:
        """Return the record at a position and time of the evader on `track`, or None."""
        # `last` is the record in use. The track ends at the current time.
        ...


@dataclass(frozen=True, eq=False)
class SnapshotRecords:
    """Records of the pursuer's local mote, from the finest level that shows the evader."""

    service: SnapshotService
    # (L + 1, k) lost reports of the evader by level and round; round n is column n modulo k. None
    # if no report is lost
    lost: NDArray[np.bool_] | None = None

    def record(
        self, track: Track, place_m: NDArray[np.float64], time_s: float, last: Record | None
    ) -> Record | None:
        """Return the report of the finest level that shows the evader to the local mote."""
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
