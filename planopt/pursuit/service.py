"""Distance-sensitive snapshot service: a grid of motes with more accurate data on near objects.

Motes form a square grid and communicate with their eight neighbours. Level-j cells are squares of
2^j by 2^j motes. A round of level j samples the cells, gathers each cell's state at the cell's
head, and floods it over the cell and its eight neighbours. A mote thus has fresh, exact reports of
near objects and old, coarse reports of far ones. Time is counted in TDMA frames, in which each mote
sends once: one hop takes one frame.

Flooding is also simulated frame by frame, with the load of every mote. A block is one record; each
mote sends it once, in the frame after first receiving it. A slot carries a limited number of
blocks; further blocks wait, longest at coarse levels.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.errors import InputError

MAX_LEVELS = 12
"""Maximum number of levels (4096 x 4096 motes); maps of a larger grid exceed the memory."""
HOPS_PER_ROUND = 3
"""Frames of a level-0 round: 2^j hops to the head and 2 * 2^j hops from it fit into 3 * 2^j."""
SLOTS_PER_FRAME = 9
"""Minimum number of slots per frame: any 3 by 3 motes need distinct ones (distance-2 colouring)."""
ROUNDING = 1e-9  # Rounding tolerance of a round's end time, as a share of the round


@dataclass(frozen=True)
class ServiceBounds:
    """Bounds on age and error of every record in use, for an object at distance d."""

    # The age of a record is at most ``max(age_s_m * d, age_floor_s)``, its error at most
    # ``max(relative_error * d, error_floor_m)``.

    age_s_m: float  # sigma: maximum age per metre, latency plus time since the last round
    relative_error: float  # kappa = 1/k: maximum error per metre
    age_floor_s: float = 0.0  # The same bounds near the object
    error_floor_m: float = 0.0
    # Time between rounds per metre and side of the finest cells, for services with nested rounds
    # like :class:`SnapshotService`; None for others
    period_s_m: float | None = None
    spacing_m: float | None = None
    reach_m: float | None = None  # Distance up to which a record exists; None for no limit

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if value is not None and not 0.0 <= value < math.inf:
                raise InputError(f"is {value!r}, should be a finite number of at least 0", key=key)


@dataclass(frozen=True)
class SnapshotService:
    """Snapshot service on a grid of ``2^levels`` by ``2^levels`` motes."""

    levels: int  # L: the single cell of level L is the whole grid
    # Distance between neighbours; mote (0, 0) is half of it away from both edges
    mote_spacing_m: float
    frame_s: float  # Duration of a TDMA frame: slots per frame times slot width
    bits_per_axis: int  # c: reports resolve 2^-c of the side of a cell, but no less than one mote
    hops_per_round: int = HOPS_PER_ROUND  # Frames of a level-0 round
    rate_divisor: int = 1  # r: rounds of a level start every r round durations
    # Whether the grid continues beyond its edges, for pursuits in open space: then cells of level L
    # have neighbours as well
    endless: bool = False

    @property
    def motes_per_side(self) -> int:
        """Return the number of motes along each side of the grid."""
        return 1 << self.levels

    @property
    def side_m(self) -> float:
        """Return the side of the observed square, whose corner is (0, 0)."""
        return self.motes_per_side * self.mote_spacing_m

    @property
    def bounds(self) -> ServiceBounds:
        """Return the bounds on age and error, which hold for every mote at all times."""
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
            spacing_m=self.mote_spacing_m,
            reach_m=self.side_m if self.endless else None,
        )

    @property
    def rounds_s(self) -> Floats:
        """Return the time from sampling to delivery at the last mote, by level (L + 1,)."""
        return self.hops_per_round * self.frame_s * np.exp2(np.arange(self.levels + 1))

    @property
    def periods_s(self) -> Floats:
        """Return the time between samples, by level (L + 1,)."""
        return self.rate_divisor * self.rounds_s

    def sample_numbers(self, time_s: float) -> NDArray[np.int64]:
        """Return the index (L + 1,) of each level's last round that ended before `time_s`."""
        # Round k of a level samples at k periods. Numbers may be negative because the network has
        # always been running.
        ended = (time_s - self.rounds_s) / self.periods_s
        return np.floor(ended + ROUNDING).astype(np.int64)

    def cells(self, positions_m: Floats, level: int) -> NDArray[np.int64]:
        """Return column and row of the cell of `level` that contains each position (..., 2)."""
        finest = np.floor(positions_m / self.mote_spacing_m).astype(np.int64)
        if not self.endless:
            # The far edges belong to the last motes.
            finest = np.clip(finest, 0, self.motes_per_side - 1)
        return finest >> level

    def reported_m(self, positions_m: Floats, level: int) -> Floats:
        """Return the centres of the sub-cells that level `level` reports for positions (..., 2)."""
        fine = max(0, level - self.bits_per_axis)
        side_m = self.mote_spacing_m * (1 << fine)
        return np.asarray((self.cells(positions_m, fine) + 0.5) * side_m, dtype=np.float64)

    def error_bound_m(self, level: int) -> float:
        """Return half the diagonal of a sub-cell, the error bound of reports of `level`."""
        fine = max(0, level - self.bits_per_axis)
        return math.sqrt(0.5) * self.mote_spacing_m * (1 << fine)


def relative_error(bits_per_axis: float) -> float:
    """Return the maximum error of a report per metre of distance, above the floor."""
    return math.sqrt(2.0) * 2.0**-bits_per_axis


@dataclass(frozen=True, eq=False)
class Track:
    """Track of an object: straight at constant speed between times, at rest before and after."""

    times_s: Floats  # (n,) in ascending order
    positions_m: Floats  # (n, 2)

    def at(self, times_s: Floats) -> Floats:
        """Return the positions (..., 2) at times (...)."""
        along = [np.interp(times_s, self.times_s, self.positions_m[:, axis]) for axis in (0, 1)]
        return np.asarray(np.stack(along, axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Reports on one object from the last completed round of each level."""

    service: SnapshotService
    time_s: float  # Time of the snapshot
    sampled_s: Floats  # (L + 1,) sample time of each level
    sampled_m: Floats  # (L + 1, 2) position of the object at that time
    reported_m: Floats  # (L + 1, 2) reported position
    cells: NDArray[np.int64]  # (L + 1, 2) cell of each level at that time, (column, row)

    @property
    def ages_s(self) -> Floats:
        """Return the age (L + 1,) of the report of each level."""
        return self.time_s - self.sampled_s

    def shown_at(self, mote: NDArray[np.int64]) -> Mask:
        """Return a mask (L + 1,) of the levels that show the object to a mote."""
        # A mote uses the report of the finest of them, which is never older than the others.
        own = mote >> np.arange(self.service.levels + 1)[:, None]
        return np.asarray((np.abs(own - self.cells) <= 1).all(axis=1), dtype=np.bool_)

    def level_map(self) -> NDArray[np.int8]:
        """Return the level (n, n) of the report that each mote uses; the first axis is y."""
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
    """Return the service's latest reports on an object that moved along `track`."""
    sampled_s = service.sample_numbers(time_s) * service.periods_s
    sampled_m = track.at(sampled_s)
    on_grid = (sampled_m >= 0.0) & (sampled_m <= service.side_m)
    if not (service.endless or on_grid.all()):
        raise InputError(
            "has a position outside the mote grid",
            key="positions_m",
            remedy=f"keep all positions in the square from (0, 0) to ({service.side_m:g}, "
            f"{service.side_m:g}) m",
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


@dataclass(frozen=True, eq=False)
class Record:
    """Reported position of an evader with sample time and maximum error."""

    sampled_s: float  # Sample time
    reported_m: Floats  # (2,)
    error_m: float  # Maximum error of the reported position


Pair = tuple[int, int]
"""Indices of a pursuer and an evader."""


@dataclass(frozen=True, eq=False)
class SnapshotRecords:
    """Records of the pursuer's local mote, from the finest level that shows the evader."""

    service: SnapshotService
    # (L + 1, k) lost reports of the evader by level and round; round n is column n modulo k. None
    # if no report is lost
    lost: Mask | None = None

    def record(
        self,
        tracks: Sequence[Track],
        pair: Pair,
        place_m: Floats,
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the report of the finest level that shows the evader to the local mote."""
        # `last` is the record in use. The tracks of all evaders end at the current time.
        now = snapshot(self.service, tracks[pair[1]], time_s)
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


UpdateRule = Literal["full", "sparse", "directed"]


def record_floods(
    service: SnapshotService,
    track: Track,
    duration_s: float,
    rule: UpdateRule,
    receivers: Sequence[tuple[Track, float]] = (),  # Tracks and speeds of pursuers, for directed
) -> Iterator[tuple[int, int, NDArray[np.int64], bool, NDArray[np.int64]]]:
    """Yield level, round index, cell, presence of the object and area of motes of each flood."""
    # An area (2, 2) has first and last column and row; each of its motes sends the report once.
    # Directed updates also send an unchanged report if it serves motes that have not received it.
    # All receivers of a report learn that the object left its cell.
    for level in range(service.levels + 1):
        count = math.floor(duration_s / service.periods_s[level] + ROUNDING) + 1
        sampled_s = service.periods_s[level] * np.arange(count, dtype=np.float64)
        places_m = track.at(sampled_s)
        cells = service.cells(places_m, level)
        fine = service.cells(places_m, max(0, level - service.bits_per_axis))
        areas = np.stack([(cells - 1) << level, ((cells + 2) << level) - 1], axis=1)
        if not service.endless:
            areas = np.clip(areas, 0, service.motes_per_side - 1)
        if rule == "directed":
            areas = _served(service, level, areas, cells << level, sampled_s, receivers)
        reached = ever = None
        for number, (cell, area) in enumerate(zip(cells, areas, strict=True)):
            if number and (cell != cells[number - 1]).any():
                if ever is not None:
                    yield level, number, cells[number - 1], False, ever
                reached = ever = None
            if rule == "full" or (number and (fine[number] != fine[number - 1]).any()):
                reached = None
            nobody = (area[0] > area[1]).any()
            if nobody or (reached is not None and (area == np.clip(area, *reached)).all()):
                continue
            reached = area
            whole = area if ever is None else np.concatenate([area, ever])
            ever = np.stack([whole.min(axis=0), whole.max(axis=0)])
            yield level, number, cell, True, area


def _served(
    service: SnapshotService,
    level: int,
    areas: NDArray[np.int64],
    heads: NDArray[np.int64],
    sampled_s: Floats,
    receivers: Sequence[tuple[Track, float]],
) -> NDArray[np.int64]:
    """Return the smallest parts (k, 2, 2) of areas with the head and all possible receivers."""
    # Receivers announce their positions at each sample, and a report is used until the next round
    # ends. The first mote of a part is beyond its last mote if no receiver is in it.
    lasts_s = service.rounds_s[level] + service.periods_s[level]
    low, high = np.full((2, *heads.shape), [[[1 << 62]], [[-(1 << 62)]]])
    for track, speed_m_s in receivers:
        place_m, reach_m = track.at(sampled_s), speed_m_s * lasts_s
        first = np.maximum(areas[:, 0], service.cells(place_m - reach_m, 0))
        last = np.minimum(areas[:, 1], service.cells(place_m + reach_m, 0))
        served = (first <= last).all(axis=1, keepdims=True)
        low = np.where(served, np.minimum(low, np.minimum(first, heads)), low)
        high = np.where(served, np.maximum(high, np.maximum(last, heads)), high)
    return np.stack([low, high], axis=1)


PEAK_BLOCKS = {True: (4, 10, 15, 19, 24, 29, 34, 39), False: (2, 5, 7, 11, 15, 20, 25, 30)}
"""Peak load of a mote in blocks per frame, with and without border relays, for 1, 2, ... levels.

Counted by :func:`simulate_flooding`. A rate divisor above one never raises it.
"""
MOST_SIMULATED_LEVELS = 7
"""Maximum number of levels in a simulation of flooding, which then takes three seconds."""


def peak_blocks_per_frame(border_relays: bool, levels: int, sparse: bool = False) -> int:
    """Return a slot capacity in blocks with which no record has to wait."""
    # One evader changes two cells of a level at most, whose reports a mote sends once each.
    if sparse:
        return 2 * (levels + 1)
    # For up to eight levels this is the peak load, beyond it the bound of eight blocks per level:
    # of the nine heads whose records a mote relays, at most eight are at the same hop distance.
    counted = PEAK_BLOCKS[border_relays]
    return counted[levels - 1] if levels <= len(counted) else 8 * (levels + 1)


def late_shares(
    levels: int, border_relays: bool, slot_blocks: int, rate_divisor: int = 1, sparse: bool = False
) -> tuple[float, ...] | None:
    """Return the share of late records by level, exact if no message is lost."""
    # The result is None if slots are below the peak load and floods are not simulated: with sparse
    # updates, and on large grids.
    if slot_blocks >= peak_blocks_per_frame(border_relays, levels, sparse):
        return (0.0,) * (levels + 1)
    if sparse or levels > MOST_SIMULATED_LEVELS:
        return None
    service = SnapshotService(levels, 1.0, 1.0, 1, rate_divisor=rate_divisor)
    run = simulate_flooding(service, border_relays=border_relays, slot_blocks=slot_blocks)
    return tuple((run.late / run.due).tolist())


@dataclass(frozen=True, eq=False)
class FloodingRun:
    """Counts of blocks and late records over one common period of all rounds."""

    frames: int
    flood_blocks: NDArray[np.int64]  # (L + 1,) blocks sent by all motes, by level
    gather_blocks: NDArray[np.int64]  # (L + 1,) states sent to the heads, by level
    motes_by_load: NDArray[np.int64]  # (most + 1,) number of (mote, frame) pairs, by blocks sent
    due: NDArray[np.int64]  # (L + 1,) number of (mote, record) pairs to be delivered
    late: NDArray[np.int64]  # (L + 1,) number of these that missed the end of their round


def simulate_flooding(
    service: SnapshotService,
    border_relays: bool = True,  # Whether motes at the border of the nine cells relay records
    slot_blocks: int | None = None,  # Capacity of a slot in blocks; None for no limit
) -> FloodingRun:
    """Simulate flooding frame by frame over one common period of all rounds."""
    side = service.motes_per_side
    rounds = [
        _Round(side, level, service.hops_per_round, border_relays, slot_blocks)
        for level in range(service.levels + 1)
    ]
    periods = [service.rate_divisor * each.frames for each in rounds]
    flooded, gathered, due, late = np.zeros((4, len(rounds)), dtype=np.int64)
    loads = np.zeros(1, dtype=np.int64)
    for frame in range(periods[-1]):
        load = np.zeros((side, side), dtype=np.int64)
        # States on their paths to the heads are few, so they have priority in the slots.
        for level, each in enumerate(rounds):
            gathered[level] += each.gather(frame % periods[level], load)
        for level, each in enumerate(rounds):
            offset = frame % periods[level]
            flooded[level] += each.flood(offset, load)
            if offset == each.frames - 1:
                due[level] += each.inside.sum()
                late[level] += (each.inside & ~each.heard).sum()
        counted = np.bincount(load.ravel(), minlength=len(loads))
        counted[: len(loads)] += loads
        loads = counted
    return FloodingRun(periods[-1], flooded, gathered, loads, due, late)


class _Round:
    """Flooding in one round of a level: m by m cells of s by s motes, arrays (m, m, 3 s, 3 s)."""

    def __init__(
        self,
        side: int,
        level: int,
        hops_per_round: int,
        border_relays: bool,
        slot_blocks: int | None,
    ) -> None:
        cell, self._slot_blocks = 1 << level, slot_blocks
        self._cell, self._count, self.frames = cell, side >> level, hops_per_round << level
        first = (np.arange(self._count)[:, None] - 1) * cell
        on_grid = first + np.arange(3 * cell)
        on_grid = (on_grid >= 0) & (on_grid < side)
        self.inside = on_grid[:, None, :, None] & on_grid[None, :, None, :]
        self.heard: Mask = np.zeros(self.inside.shape, dtype=np.bool_)
        self._waiting = self.heard.copy()
        self._relays = np.ones((3 * cell, 3 * cell), dtype=np.bool_)
        if not border_relays:
            self._relays[[0, -1]] = self._relays[:, [0, -1]] = False
        # A cell's four states come from the heads of its quarters, at most half a cell away.
        corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)] if level else [], dtype=np.int64)
        offsets = corners.reshape(-1, 2) * (cell // 2)
        self._hops, self._steps = np.abs(offsets).max(axis=1, initial=0), np.sign(offsets)
        along = np.arange(self._count) * cell
        self._heads = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        # Frames of a round in which states are sent, and in which heads begin to flood.
        self._ends = cell - 1
        self._begins = cell // 2 - 1 if level else 0

    def gather(self, offset: int, load: NDArray[np.int64]) -> int:
        """Send every state one hop further; return the number of blocks sent."""
        left = self._hops - (offset - self._begins)
        if not self._begins <= offset < self._ends or not (left > 0).any():
            return 0
        moving = left > 0
        places = self._heads[:, :, None] + self._steps[moving] * left[moving, None]
        np.add.at(load, (places[..., 0], places[..., 1]), 1)
        return places[..., 0].size

    def flood(self, offset: int, load: NDArray[np.int64]) -> int:
        """Send the waiting records that fit into the slots; return the number of blocks sent."""
        if offset == 0:
            self.heard[:] = False
            self._waiting[:] = False
        if offset == self._ends:
            self.heard[:, :, self._cell, self._cell] = True
            self._waiting[:, :, self._cell, self._cell] = True
        if not self._ends <= offset < self.frames or not self._waiting.any():
            return 0
        sending = self._waiting.copy()
        for part, motes in self._parts(load):
            if self._slot_blocks is not None:
                sending[part] &= motes < self._slot_blocks
            motes += sending[part]
        wide = sending.copy()
        wide[..., 1:] |= sending[..., :-1]
        wide[..., :-1] |= sending[..., 1:]
        new = wide.copy()
        new[..., 1:, :] |= wide[..., :-1, :]
        new[..., :-1, :] |= wide[..., 1:, :]
        new &= self.inside & ~self.heard
        self.heard |= new
        self._waiting = np.asarray((self._waiting & ~sending) | (new & self._relays), np.bool_)
        return int(sending.sum())

    def _parts(
        self, load: NDArray[np.int64]
    ) -> Iterator[tuple[tuple[slice, ...], NDArray[np.int64]]]:
        """Yield the index of each of the nine cells around a head, and its motes' load."""
        cell, count = self._cell, self._count
        motes = load.reshape(count, cell, count, cell).transpose(0, 2, 1, 3)
        ranges = [
            (
                slice(max(0, -shift), count - max(0, shift)),
                slice(max(0, shift), count + min(0, shift)),
                slice((shift + 1) * cell, (shift + 2) * cell),
            )
            for shift in (-1, 0, 1)
        ]
        for rows, there_rows, down in ranges:
            for columns, there_columns, right in ranges:
                yield (rows, columns, down, right), motes[there_rows, there_columns]
