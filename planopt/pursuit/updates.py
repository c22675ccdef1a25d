"""Two savings of the snapshot service: sparse updates and directed dissemination.

Event driven, a record is flooded only when it has changed since the last round; silence means that
the state of that round is as before. Directed, it is flooded only towards where a pursuer may
be until the next round has ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit.knowledge import Track
from planopt.pursuit.service import SnapshotService, require_count, require_number

NOBODY = np.array([[0, 0], [-1, -1]])
"""The area of a flood that serves no mote."""


@dataclass(frozen=True)
class Receiver:
    """A pursuer that records are directed to."""

    track: Track  # Where it is: it announces its position at each sample
    speed_max_m_s: float  # How far from there it may be until the record is replaced


@dataclass(frozen=True, eq=False)
class Floods:
    """Records of one object and level that are flooded."""

    rounds: int  # How many rounds were looked at
    sampled_s: NDArray[np.float64]  # (k,) when each was sampled
    cells: NDArray[np.int64]  # (k, 2) column and row of the cell whose record it is
    # (k,) whether it tells that the object is in the cell, else that it left
    occupied: NDArray[np.bool_]
    # (k, 2, 2) first and last column and row of the motes that send it once each
    areas: NDArray[np.int64]

    @property
    def blocks(self) -> int:
        """Blocks sent by all motes."""
        return int((self.areas[:, 1] - self.areas[:, 0] + 1).prod(axis=1).sum())


def record_floods(
    service: SnapshotService,
    track: Track,
    duration_s: float,
    *,
    refresh_rounds: int | None = None,
    receiver: Receiver | None = None,
) -> list[Floods]:
    """Return the floods of one object's records by level, if only changes are flooded.

    A record changes where the object's sub-cell does; where its cell does, that of the cell that it
    left changes too. Directed, it is also flooded where somebody is to be served who was not when
    it changed, and that the object left goes to all who were told that it was there.
    """
    require_number(duration_s, "duration_s", above=0.0)
    if refresh_rounds is not None:
        require_count(refresh_rounds, "refresh_rounds", 1)
    found: list[Floods] = []
    for level, period_s in enumerate(service.periods_s):
        rounds = np.arange(math.floor(duration_s / period_s))
        sampled_s = rounds * period_s
        positions_m = track.at(np.append(-period_s, sampled_s))
        cells = service.cells(positions_m, level)
        fine = service.cells(positions_m, max(0, level - service.bits_per_axis))
        told = (fine[1:] != fine[:-1]).any(axis=1)
        told[:1] = True
        if refresh_rounds is not None:
            told |= rounds % refresh_rounds == 0
        left = (cells[1:] != cells[:-1]).any(axis=1)
        if receiver is None:
            here, before = (_nine_cells(service, level, each) for each in (cells[1:], cells[:-1]))
        else:
            here = served_areas(service, level, cells[1:], sampled_s, receiver)
            before = _direct(here, told, left)
        found.append(
            Floods(
                len(rounds),
                np.concatenate([sampled_s[left], sampled_s[told]]),
                np.concatenate([cells[:-1][left], cells[1:][told]]),
                np.repeat([False, True], [int(left.sum()), int(told.sum())]),
                np.concatenate([before[left], here[told]]),
            )
        )
    return found


def change_probability(share: float) -> float:
    """Return the probability that an object leaves its square in a straight move.

    Place and direction are uniform. For moves no longer than a side it is
    ``(4 share - share^2) / pi``.
    """
    angles = (np.arange(4096) + 0.5) * (0.5 * np.pi / 4096)
    stays = np.maximum(0.0, 1.0 - share * np.cos(angles))
    stays *= np.maximum(0.0, 1.0 - share * np.sin(angles))
    return float(1.0 - stays.mean())


def expected_blocks_per_frame(service: SnapshotService, speed_m_s: float) -> float:
    """Return what an object far from the grid's edges costs in a frame, event driven.

    The object moves straight within each round. Nine cells of ``4^j`` motes are flooded where the
    sub-cell changes, and again where the cell does. Where sub-cells are larger than a mote, this
    has the same probability at every level, so that the cost doubles from level to level: it grows
    as the square root of the number of motes.
    """
    side_m = service.mote_spacing_m * np.exp2(np.arange(service.levels + 1))
    fine_m = np.maximum(service.mote_spacing_m, side_m * 2.0**-service.bits_per_axis)
    moved_m = speed_m_s * service.periods_s
    floods = [
        change_probability(moved / fine) + change_probability(moved / side)
        for moved, fine, side in zip(moved_m, fine_m, side_m, strict=True)
    ]
    motes = 9.0 * 4.0 ** np.arange(service.levels + 1)
    return float((floods * motes * service.frame_s / service.periods_s).sum())


def served_areas(
    service: SnapshotService,
    level: int,
    cells: NDArray[np.int64],  # (k, 2) cells of the records, column and row
    sampled_s: NDArray[np.float64],  # (k,) when they are sampled
    receiver: Receiver,
) -> NDArray[np.int64]:
    """Return the motes that directed records of a level reach, as rectangles.

    A rectangle spans the head of the cell, its first mote, and those of the nine cells' motes where
    the receiver may be until the next round has ended. Paths in it are as short as on the grid.
    """
    lasts_s = service.rounds_s[level] + service.periods_s[level]
    reach_m = receiver.speed_max_m_s * lasts_s
    here_m = receiver.track.at(sampled_s)
    wanted = np.stack(
        [service.cells(here_m - reach_m, 0), service.cells(here_m + reach_m, 0)], axis=1
    )
    nine = _nine_cells(service, level, cells)
    low, high = np.maximum(wanted[:, 0], nine[:, 0]), np.minimum(wanted[:, 1], nine[:, 1])
    head = cells << level
    areas = np.stack([np.minimum(low, head), np.maximum(high, head)], axis=1)
    areas[(low > high).any(axis=1)] = NOBODY
    return areas


def _direct(
    areas: NDArray[np.int64], told: NDArray[np.bool_], left: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Mark rounds that serve somebody anew in `told`; the areas that a left cell was told to.

    `areas` (n, 2, 2) are those to be served in each round.
    """
    nobody = np.array([[np.iinfo(np.int64).max] * 2, [-1] * 2])
    last, ever = nobody, nobody
    before = np.tile(NOBODY, (len(told), 1, 1))
    for number, area in enumerate(areas):
        if left[number]:
            if ever[1, 0] >= 0:
                before[number] = ever
            last, ever = nobody, nobody
        served = (area[0] <= area[1]).all()
        told[number] |= served and not ((area[0] >= last[0]) & (area[1] <= last[1])).all()
        if told[number] and served:
            last = area
            ever = np.stack([np.minimum(ever[0], area[0]), np.maximum(ever[1], area[1])])
        elif told[number]:
            last = nobody
    return before


def _nine_cells(
    service: SnapshotService, level: int, cells: NDArray[np.int64]
) -> NDArray[np.int64]:
    """First and last column and row of the cells around cells (k, 2), on the grid; (k, 2, 2)."""
    first = np.maximum(0, (cells - 1) << level)
    last = np.minimum(service.motes_per_side, (cells + 2) << level) - 1
    return np.stack([first, last], axis=1)
