"""Frame-by-frame flooding of a snapshot service: the load of every mote, and late records.

The heads of level-(j - 1) cells pass their states to the head of their level-j cell, which floods
the record: each mote of the cell and of its eight neighbours sends it once, in the frame after
first receiving it. A block is one record. A slot carries a limited number of blocks; further blocks
wait, those of coarse levels longest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.service import SnapshotService

PEAK_BLOCKS = {
    True: (4, 10, 15, 19, 24, 29, 34, 39),
    False: (2, 5, 7, 11, 15, 20, 25, 30),
}
"""Peak load of a mote in blocks per frame, with and without border relays, for 1, 2, ... levels.

Counted by :func:`simulate_flooding`. A rate divisor above one never raises it.
"""

MOST_SIMULATED_LEVELS = 7
"""Maximum number of levels of a simulated flood; it takes three seconds."""


def peak_blocks_per_frame(border_relays: bool, levels: int) -> int:
    """Return a slot capacity in blocks with which no record waits.

    It is the peak load for up to eight levels. Beyond, it is the bound of eight blocks per level:
    of the nine heads whose records a mote relays, at most eight are at the same hop distance.
    """
    counted = PEAK_BLOCKS[border_relays]
    return counted[levels - 1] if levels <= len(counted) else 8 * (levels + 1)


def late_shares(
    levels: int, border_relays: bool, slot_blocks: int, rate_divisor: int = 1
) -> tuple[float, ...] | None:
    """Return the share of late records by level, exact for lossless links.

    It is None if the slot is narrower than the peak load and the grid too large to simulate.
    """
    if slot_blocks >= peak_blocks_per_frame(border_relays, levels):
        return (0.0,) * (levels + 1)
    if levels > MOST_SIMULATED_LEVELS:
        return None
    service = SnapshotService(levels, 1.0, 1.0, 1, rate_divisor=rate_divisor)
    run = simulate_flooding(service, border_relays=border_relays, slot_blocks=slot_blocks)
    return tuple((run.late / run.due).tolist())


@dataclass(frozen=True, eq=False)
class FloodingRun:
    """Counts over one common period of all rounds."""

    frames: int
    flood_blocks: NDArray[np.int64]  # (L + 1,) blocks sent by all motes, by level
    gather_blocks: NDArray[np.int64]  # (L + 1,) states sent to the heads, by level
    motes_by_load: NDArray[np.int64]  # (most + 1,) number of (mote, frame) pairs, by blocks sent
    due: NDArray[np.int64]  # (L + 1,) number of (mote, record) pairs to be delivered
    late: NDArray[np.int64]  # (L + 1,) number of these that missed the end of their round

    @property
    def mean_load(self) -> float:
        """Return the mean number of blocks that a mote sends per frame."""
        return float(np.average(np.arange(len(self.motes_by_load)), weights=self.motes_by_load))

    @property
    def peak_load(self) -> int:
        """Return the maximum number of blocks that a mote sent in a frame."""
        return len(self.motes_by_load) - 1

    @property
    def keeps_rounds(self) -> bool:
        """Return whether all motes of the nine cells received every record in time."""
        return not self.late.any()


def simulate_flooding(
    service: SnapshotService,
    heads: Literal["first", "middle"] = "first",  # Position of the head in its cell
    border_relays: bool = True,  # Whether motes at the border of the nine cells relay records
    slot_blocks: int | None = None,  # Capacity of a slot in blocks; None for no limit
) -> FloodingRun:
    """Return the counts over one common period of all rounds."""
    side = service.motes_per_side
    rounds = [
        _Round(side, level, service.hops_per_round, heads == "middle", border_relays, slot_blocks)
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
    """One round of a level, with arrays ``(m, m, 3 s, 3 s)`` over m by m cells of s by s motes."""

    def __init__(
        self,
        side: int,
        level: int,
        hops_per_round: int,
        middle: bool,
        border_relays: bool,
        slot_blocks: int | None,
    ) -> None:
        cell, self._slot_blocks = 1 << level, slot_blocks
        self._cell, self._count, self.frames = cell, side >> level, hops_per_round << level
        first = (np.arange(self._count)[:, None] - 1) * cell
        on_grid = first + np.arange(3 * cell)
        on_grid = (on_grid >= 0) & (on_grid < side)
        self.inside = on_grid[:, None, :, None] & on_grid[None, :, None, :]
        self.heard: NDArray[np.bool_] = np.zeros(self.inside.shape, dtype=np.bool_)
        self._waiting = self.heard.copy()
        self._relays = np.ones((3 * cell, 3 * cell), dtype=np.bool_)
        if not border_relays:
            self._relays[[0, -1]] = self._relays[:, [0, -1]] = False
        head, part = (cell // 2, cell // 4) if middle else (0, 0)
        self._head = cell + head
        # A cell's four states come from the heads of its quarters, at most half a cell away.
        corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)] if level else [], dtype=np.int64)
        offsets = corners.reshape(-1, 2) * (cell // 2) + part - head
        self._hops, self._steps = np.abs(offsets).max(axis=1, initial=0), np.sign(offsets)
        along = np.arange(self._count) * cell + head
        self._heads = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        # Frames of a round in which states are sent, and in which heads begin to flood.
        self._ends = cell // 2 if middle else cell - 1
        self._begins = (cell // 4 if middle else cell // 2 - 1) if level else 0

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
            self.heard[:, :, self._head, self._head] = True
            self._waiting[:, :, self._head, self._head] = True
        if not self._ends <= offset < self.frames or not self._waiting.any():
            return 0
        sending = self._waiting.copy()
        for part, motes in self._parts(load):
            if self._slot_blocks is not None:
                sending[part] &= motes < self._slot_blocks
            motes += sending[part]
        new = _heard_next(sending) & self.inside & ~self.heard
        self.heard |= new
        self._waiting = np.asarray((self._waiting & ~sending) | (new & self._relays), np.bool_)
        return int(sending.sum())

    def _parts(
        self, load: NDArray[np.int64]
    ) -> Iterator[tuple[tuple[slice, ...], NDArray[np.int64]]]:
        """Yield each of the nine cells of all records, and a view of the load of its motes."""
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


def _heard_next(sending: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the motes that send or have a sending neighbour, over the last two axes."""
    wide = sending.copy()
    wide[..., 1:] |= sending[..., :-1]
    wide[..., :-1] |= sending[..., 1:]
    high = wide.copy()
    high[..., 1:, :] |= wide[..., :-1, :]
    high[..., :-1, :] |= wide[..., 1:, :]
    return high
