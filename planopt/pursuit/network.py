"""The radio network of a snapshot service: what a frame carries, what it costs, how long it takes.

Costs are those of the whole network with every mote far from the edges, which is a little more than
a grid with edges sends. Rounds are simulated hop by hop: the heads of the cells of level j - 1 pass
their state to the head of the level-j cell that they are in, which floods the record; the motes of
the cell and of the eight around it send it once, in the frame after they first heard it. A block is
one record; a slot carries some blocks, and the others wait, coarse levels longest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.service import (
    HOPS_PER_ROUND,
    MAX_LEVELS,
    SnapshotService,
    require_count,
    require_number,
    slots_per_frame,
)

Part = tuple[slice, slice, slice, slice]


@dataclass(frozen=True)
class Flooding:
    """The settings by which records spread."""

    # Which mote is the head of a cell. From the first one, at the corner, the farthest mote of the
    # nine cells is 2 * 2^j - 1 hops away, and states come to it in 2^j - 1 hops; for the middle one
    # it is 1.5 * 2^j and 2^(j - 1) hops, which leaves a third of the round to wait in.
    heads: Literal["first", "middle"] = "first"
    # Whether motes at the edge of the nine cells send the record on as well. Nobody beyond them
    # needs it, but with lost hops they help others beside them.
    border_relays: bool = True
    slot_blocks: int | None = None  # Blocks that fit into a slot; None for as many as there are
    repeats: int = 1  # In how many frames a mote sends each record that it floods
    # Share of a round's spare time in which heads wait for states that were not heard, instead of
    # leaving it to the flood
    gather_share: float = 0.0
    # Probability that a neighbour does not hear what a mote sends, each on its own. Hops to a head
    # are repeated until they are heard.
    hop_loss: float = 0.0

    def __post_init__(self) -> None:
        if self.heads not in ("first", "middle"):
            raise InputError(f"{self.heads!r} is neither first nor middle", key="heads")
        if self.slot_blocks is not None:
            require_count(self.slot_blocks, "slot_blocks", 1)
        require_count(self.repeats, "repeats", 1, 100)
        require_number(self.hop_loss, "hop_loss", least=0.0)
        require_number(self.gather_share, "gather_share", least=0.0)
        if self.gather_share > 1.0:
            raise InputError(f"{self.gather_share!r} is no share", key="gather_share")
        if self.hop_loss >= 1.0:
            raise InputError(f"{self.hop_loss!r} is no probability below 1", key="hop_loss")


@dataclass(frozen=True, eq=False)
class FloodingRun:
    """Counts from one start of the coarsest round to the next."""

    frames: int  # How many frames that is
    # (L + 1,) blocks sent by all motes, by level: repeats of lost hops included
    flood_blocks: NDArray[np.int64]
    gather_blocks: NDArray[np.int64]
    # (most + 1,) in how many pairs of mote and frame so many blocks were sent
    motes_by_load: NDArray[np.int64]
    # (L + 1,) pairs of mote and record that a round owed, and those that missed its end
    due: NDArray[np.int64]
    late: NDArray[np.int64]
    # (L + 1,) states of motes sampled, and those that came too late to be flooded
    states: NDArray[np.int64]
    missing: NDArray[np.int64]

    @property
    def mean_load(self) -> float:
        """Blocks a mote sends in a frame, on average."""
        return float(self.motes_by_load @ np.arange(len(self.motes_by_load))) / float(
            self.motes_by_load.sum()
        )

    @property
    def peak_load(self) -> int:
        """The most blocks that any mote sent in any frame."""
        return len(self.motes_by_load) - 1

    @property
    def keeps_rounds(self) -> bool:
        """Return whether every record was whole, and with every mote of its nine cells in time."""
        return not self.late.any() and not self.missing.any()


def mean_blocks_per_frame(border_relays: bool, levels: int | None = None) -> float:
    """Return the blocks that a mote far from the edges floods in a frame, on average.

    A level-j round of ``3 * 2^j`` frames has nine blocks a mote, ``(3 - 2^(1 - j))^2`` without
    those of the border: all levels together ``3 (2 - 2^-L) < 6``, or less than 2.2.
    """
    last = 60 if levels is None else levels
    cell = np.exp2(np.arange(last + 1))
    each = np.full(last + 1, 9.0) if border_relays else (3.0 - 2.0 / cell) ** 2
    return float((each / (HOPS_PER_ROUND * cell)).sum())


def simulate_flooding(
    service: SnapshotService,
    flooding: Flooding,
    generator: np.random.Generator | None = None,
) -> FloodingRun:
    """Run all levels from one common start to the next, frame by frame."""
    if generator is None:
        if flooding.hop_loss > 0.0:
            raise InputError("lost hops need a source of randomness", key="generator")
        generator = np.random.default_rng(0)
    return _Network(service, flooding, generator).run()


class _Network:
    """Buffers of all motes, for one run."""

    def __init__(
        self, service: SnapshotService, flooding: Flooding, generator: np.random.Generator
    ) -> None:
        self._flooding, self._generator = flooding, generator
        side, levels = service.motes_per_side, service.levels
        self._side = side
        self._rounds = [service.hops_per_round << level for level in range(levels + 1)]
        self._periods = [service.rate_divisor * frames for frames in self._rounds]
        self._floods = [_Flood(side, level, flooding) for level in range(levels + 1)]
        self._gathers = [_Gather(service, level, flooding) for level in range(levels + 1)]
        self._sent, self._gathered, self._due, self._late, self._states, self._missing = (
            np.zeros(levels + 1, dtype=np.int64) for _ in range(6)
        )
        self._loads = np.zeros(1, dtype=np.int64)

    def run(self) -> FloodingRun:
        frames = self._periods[-1]
        for frame in range(frames):
            load = np.zeros((self._side, self._side), dtype=np.int64)
            # Hops to heads are few: slots keep room for them first.
            for level, period in enumerate(self._periods):
                self._gather(level, frame % period, load)
            for level, period in enumerate(self._periods):
                self._flood(level, frame % period, load)
            counted = np.bincount(load.ravel(), minlength=len(self._loads))
            counted[: len(self._loads)] += self._loads
            self._loads = counted
        return FloodingRun(
            frames,
            self._sent,
            self._gathered,
            self._loads,
            self._due,
            self._late,
            self._states,
            self._missing,
        )

    def _gather(self, level: int, offset: int, load: NDArray[np.int64]) -> None:
        gather = self._gathers[level]
        if offset == 0:
            gather.reset()
        if level and gather.begins <= offset < gather.ends:
            if offset == gather.begins:
                gather.take_over(self._gathers[level - 1])
            self._gathered[level] += gather.hop(load, self._flooding.hop_loss, self._generator)

    def _flood(self, level: int, offset: int, load: NDArray[np.int64]) -> None:
        flood, gather = self._floods[level], self._gathers[level]
        if offset == 0:
            flood.reset()
        if offset == gather.ends:
            flood.start()
            self._states[level] += self._side**2
            self._missing[level] += int(gather.missing.sum())
        if gather.ends <= offset < self._rounds[level]:
            self._sent[level] += flood.send(load, self._generator)
        if offset == self._rounds[level] - 1:
            self._due[level] += flood.due
            self._late[level] += flood.late


class _Flood:
    """The records of one level in their nine cells: ``(m, m, 3 s, 3 s)``, s motes a cell's side."""

    def __init__(self, side: int, level: int, flooding: Flooding) -> None:
        self._slot, self._loss = flooding.slot_blocks, flooding.hop_loss
        self._repeats = flooding.repeats
        self._cell, self._count = 1 << level, side >> level
        self._head = self._cell + (self._cell // 2 if flooding.heads == "middle" else 0)
        first = np.arange(self._count)[:, None] * self._cell - self._cell
        on_grid = first + np.arange(3 * self._cell)
        on_grid = (on_grid >= 0) & (on_grid < side)
        self._inside = on_grid[:, None, :, None] & on_grid[None, :, None, :]
        self._relays = np.ones((3 * self._cell, 3 * self._cell), dtype=np.bool_)
        if not flooding.border_relays:
            self._relays[[0, -1]] = self._relays[:, [0, -1]] = False
        self.reset()

    @property
    def due(self) -> int:
        """Return how many pairs of mote and record there are."""
        return int(self._inside.sum())

    @property
    def late(self) -> int:
        """Return how many of them have not come together."""
        return int((self._inside & ~self._heard).sum())

    def reset(self) -> None:
        self._heard = np.zeros(self._inside.shape, dtype=np.bool_)
        # In how many more frames each mote sends.
        self._waiting = np.zeros(self._inside.shape, dtype=np.int8)

    def start(self) -> None:
        """The heads know their records."""
        self._heard[:, :, self._head, self._head] = True
        self._waiting[:, :, self._head, self._head] = self._repeats

    def send(self, load: NDArray[np.int64], generator: np.random.Generator) -> int:
        """Send what waits and fits into the slots; the number of blocks."""
        if not self._waiting.any():
            return 0
        sending = self._waiting > 0
        for part, motes in self._parts(load):
            if self._slot is not None:
                sending[part] &= motes < self._slot
            motes += sending[part]
        self._waiting -= sending
        around = _neighbours(sending)
        new = (around > 0) & self._inside & ~self._heard
        if self._loss > 0.0:
            places = np.nonzero(new)
            new[places] = generator.random(len(places[0])) >= self._loss ** around[places]
        self._heard |= new
        self._waiting[new & self._relays] = self._repeats
        return int(sending.sum())

    def _parts(self, load: NDArray[np.int64]) -> Iterator[tuple[Part, NDArray[np.int64]]]:
        """Each of the nine cells of all records, and the load of the motes there, as a view."""
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


class _Gather:
    """States on their way from the heads of level j - 1 to those of level j.

    They set out once that level has gathered, at `begins`, and are flooded from `ends` on.
    """

    def __init__(self, service: SnapshotService, level: int, flooding: Flooding) -> None:
        side, middle = service.motes_per_side, flooding.heads == "middle"
        corners = [(0, 0), (0, 1), (1, 0), (1, 1)]
        # Rows and columns of the parts' heads, from that of the whole, in motes.
        part = (1 << level) // 2
        here, there = ((1 << level) // 2, part // 2) if middle else (0, 0)
        offsets = np.array(corners) * part + there - here if level else np.zeros((0, 2))
        self._offsets = offsets.astype(np.int64).reshape(-1, 2)
        self._hops = np.abs(self._offsets).max(axis=1, initial=0)
        self._steps = np.sign(self._offsets)
        along = (np.arange(side >> level) << level) + here
        self._heads = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1)
        self._part_motes = part * part
        self.begins = _gathered_by(service, level - 1, flooding) if level else 0
        self.ends = _gathered_by(service, level, flooding)
        self.reset()

    def reset(self) -> None:
        count = len(self._heads)
        self._left = np.tile(self._hops, (count, count, 1))
        self._brought = np.zeros(self._left.shape, dtype=np.int64)

    @property
    def missing(self) -> NDArray[np.int64]:
        """Return how many motes' states have not come to each head; ``(m, m)``."""
        return np.where(self._left == 0, self._brought, self._part_motes).sum(axis=-1)

    def take_over(self, finer: _Gather) -> None:
        """Note how many states are missing in the parts that set out."""
        count = len(self._heads)
        parts = finer.missing.reshape(count, 2, count, 2).transpose(0, 2, 1, 3)
        self._brought = parts.reshape(count, count, 4)

    def hop(self, load: NDArray[np.int64], hop_loss: float, generator: np.random.Generator) -> int:
        """Send each state one hop on, again if the last one was not heard; the blocks sent."""
        sent = self._left > 0
        places = self._heads[:, :, None, :] + self._steps * self._left[..., None]
        rows, columns = places[sent].T
        np.add.at(load, (rows, columns), 1)
        self._left[sent] -= generator.random(len(rows)) >= hop_loss
        return len(rows)


def _gathered_by(service: SnapshotService, level: int, flooding: Flooding) -> int:
    """The frame of a round in which heads begin to flood.

    Without losses states need ``2^j - 1`` frames to first heads and ``2^(j - 1)`` to middle ones,
    and floods twice and one and a half times 2^j.
    """
    side = 1 << level
    needed = side // 2 if flooding.heads == "middle" else side - 1
    flood = 2 * side if flooding.heads == "first" else (3 * side + 1) // 2
    spare = service.hops_per_round * side - needed - flood
    return needed + int(flooding.gather_share * spare)


def _neighbours(sending: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Return how many of the eight motes around each one send; over the last two axes."""
    total = sending.astype(np.int8)
    for axis in (-1, -2):
        rest = total.swapaxes(axis, -1)
        wide = rest.copy()
        wide[..., 1:] += rest[..., :-1]
        wide[..., :-1] += rest[..., 1:]
        total = wide.swapaxes(axis, -1)
    return total - sending


@dataclass(frozen=True)
class MoteNetwork:
    """Motes and their radios."""

    levels: int  # L: there are 4^L motes
    mote_spacing_m: float  # Distance between neighbours
    bit_rate_bit_s: float  # R: what a slot carries in its width
    # Bits of a frame beside its blocks, and of a block beside the position in it
    header_bits: float
    record_bits: float
    energy_j_per_bit: float  # What a sent bit costs, with those who hear it
    idle_w: float = 0.0  # What a mote draws all the time
    # eta_s: slots of a TDMA frame, at least those of a colouring
    slots_per_frame: int = slots_per_frame()
    # Blocks that a slot must carry. Six is the mean load; slots so short break rounds
    # (:func:`simulate_flooding`), so that what keeps them is asked for
    # here.
    slot_blocks: int = 6
    border_relays: bool = True  # Whether motes at the border of nine cells send records on

    def __post_init__(self) -> None:
        require_count(self.levels, "levels", 1, MAX_LEVELS)
        for key in ("mote_spacing_m", "bit_rate_bit_s", "energy_j_per_bit"):
            require_number(getattr(self, key), key, above=0.0)
        for key in ("header_bits", "record_bits", "idle_w"):
            require_number(getattr(self, key), key, least=0.0)
        require_count(self.slots_per_frame, "slots_per_frame", slots_per_frame())
        require_count(self.slot_blocks, "slot_blocks", 1)

    @property
    def motes(self) -> int:
        """N."""
        return 4**self.levels

    @property
    def mean_blocks(self) -> float:
        """Blocks that a mote sends in a frame, on average."""
        return mean_blocks_per_frame(self.border_relays, self.levels)

    def block_bits(self, bits_per_axis: float) -> float:
        """Return m = m_0 + 2 c."""
        return self.record_bits + 2.0 * bits_per_axis

    def frame_bits(self, bits_per_axis: float) -> float:
        """Return what a mote sends in a frame on average, header and blocks."""
        return self.header_bits + self.mean_blocks * self.block_bits(bits_per_axis)

    def least_slot_s(self, bits_per_axis: float) -> float:
        """Return the width of a slot that carries header and `slot_blocks` blocks."""
        payload = self.header_bits + self.slot_blocks * self.block_bits(bits_per_axis)
        return payload / self.bit_rate_bit_s

    def power_w(
        self, slot_width_s: float, bits_per_axis: float, rate_divisor: float = 1.0
    ) -> float:
        """Return what the network draws; with r > 1 motes sleep in all but every r-th round."""
        lasts_s = self.slots_per_frame * slot_width_s * rate_divisor
        sent_w = self.energy_j_per_bit * self.frame_bits(bits_per_axis) / lasts_s
        return self.motes * (sent_w + self.idle_w)

    def service(
        self, slot_width_s: float, bits_per_axis: int, rate_divisor: int = 1
    ) -> SnapshotService:
        """Return the service that runs on it."""
        return SnapshotService(
            self.levels,
            self.mote_spacing_m,
            self.slots_per_frame * slot_width_s,
            bits_per_axis,
            HOPS_PER_ROUND,
            rate_divisor,
        )

    def staleness_per_slot(self, evader_speed_m_s: float) -> float:
        """Return x / s_w at r = 1, ``12 eta_s v_e`` a mote spacing; in 1/s."""
        frames = 4.0 * HOPS_PER_ROUND * self.slots_per_frame
        return frames * evader_speed_m_s / self.mote_spacing_m
