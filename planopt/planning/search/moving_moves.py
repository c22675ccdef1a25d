"""The moves of a lattice as a table, and which come too near to moving obstacles, by stage.

A window is the part of the lattice that is looked at, with a margin of closed nodes around it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.world.lattice import MOVES, Lattice
from planopt.world.moving_discs import MovingDiscs, passing_gaps_m
from planopt.world.workspace import LONGEST_MOVE


@dataclass(frozen=True)
class MoveTable:
    """The moves of a lattice, ready for searching."""

    lattice: Lattice  # Whose moves they are
    # (21, ny + 2 REACH, nx + 2 REACH): 0 where a move from the node is open, else minus infinity;
    # with a margin of closed nodes around the lattice
    closed: NDArray[np.float64]
    # (ny, nx) free nodes that some move from a free node does not lead to
    hindered: NDArray[np.bool_]
    # (ny + 2 REACH, nx + 2 REACH) numbers of the free nodes in reading order, -1 elsewhere
    number: NDArray[np.intp]


def move_table(lattice: Lattice) -> MoveTable:
    """Tabulate the moves of a lattice."""
    inside = np.where(lattice.open_moves, 0.0, -np.inf)
    margin = ((0, 0), (REACH, REACH), (REACH, REACH))
    closed = np.pad(inside, margin, constant_values=-np.inf)
    free = np.pad(lattice.free, REACH)
    ny, nx = lattice.shape
    hindered = np.zeros(lattice.shape, dtype=np.bool_)
    for move, (dx, dy) in enumerate(MOVES):
        source = (
            slice(REACH - dy, REACH - dy + ny),
            slice(REACH - dx, REACH - dx + nx),
        )
        hindered |= free[source] & (closed[move][source] != 0.0)
    number = np.full(free.shape, -1, dtype=np.intp)
    number[free] = np.arange(int(free.sum()))
    return MoveTable(lattice, closed, hindered & lattice.free, number)


Window = tuple[slice, slice]
"""Rows and columns of a part of the lattice."""

REACH = max(max(abs(dx), abs(dy)) for dx, dy in MOVES)
"""Nodes that a move leads along either axis at most, and the margin's width."""


def window_around(
    low: NDArray[np.intp], high: NDArray[np.intp], grown: int, shape: tuple[int, int]
) -> Window:
    """The nodes from `low` to `high`, grown to all sides, in the lattice with its margin."""
    rows, columns = (
        slice(
            max(int(low[axis]) - grown, 0) + REACH,
            min(int(high[axis]) + grown, shape[axis] - 1) + REACH + 1,
        )
        for axis in (0, 1)
    )
    return rows, columns


def without_margin(window: Window) -> Window:
    """A window in the lattice without its margin."""
    rows, columns = window
    return (
        slice(rows.start - REACH, rows.stop - REACH),
        slice(columns.start - REACH, columns.stop - REACH),
    )


def window_shape(window: Window) -> tuple[int, int]:
    """Rows and columns of a window, counted."""
    return window[0].stop - window[0].start, window[1].stop - window[1].start


TINY_M2 = 1e-30
"""A relative move of less than this squared length is a standstill."""


def first_steps_apart(
    discs: MovingDiscs, position_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether first steps from a place (2,) to `ends_m` (n, 2) keep from discs; (n,).

    From a place that is nearer than planners keep, they may lead away.
    """
    return steps_apart(discs, 0, np.broadcast_to(position_m, ends_m.shape), ends_m)


def steps_apart(
    discs: MovingDiscs, step: int, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether straight ways (..., 2) in one step, 0 the first, keep from discs; (...).

    A way that begins nearer than planners keep may lead away.
    """
    if not len(discs):
        return np.ones(starts_m.shape[:-1], dtype=np.bool_)
    begin = discs.centres_m[:, step].reshape(-1, *([1] * (starts_m.ndim - 1)), 2)
    apart = discs.apart_m[:, step].reshape(begin.shape[:-1])
    here = np.linalg.norm(starts_m - begin, axis=-1) - apart
    wanted = np.minimum(CLEARANCE_PAD_M, here) if step == 0 else CLEARANCE_PAD_M
    return np.asarray((passing_gaps_m(discs, step, starts_m, ends_m) >= wanted).all(axis=0))


class MovingMoves:
    """The moves of a lattice beside what moves.

    Seen from a disc, a move along (dx, dy) is the same vector wherever it ends, so that one formula
    serves all nodes.
    """

    def __init__(self, lattice: Lattice, discs: MovingDiscs) -> None:
        self._lattice = lattice
        self._discs = discs

    def hindered(
        self, step: int, rows: slice, columns: slice
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Nodes of a window that some one-step move does not reach, and these moves."""
        nodes: list[NDArray[np.intp]] = []
        moves: list[NDArray[np.bool_]] = []
        for number in range(len(self._discs)):
            high, wide = self._about(step, number, rows, columns)
            blocked = self._blocked_by(step, number, high[:, None], wide)
            row, column = np.nonzero(blocked.any(axis=0))
            nodes.append(high[row] * self._lattice.shape[1] + wide[column])
            moves.append(blocked[:, row, column])
        found, place = np.unique(np.concatenate(nodes), return_inverse=True)
        together = np.zeros((len(MOVES), len(found)), dtype=np.bool_)
        begin = 0
        for blocked in moves:
            end = begin + int(blocked.shape[1])
            together[:, place[begin:end]] |= blocked
            begin = end
        return found // self._lattice.shape[1], found % self._lattice.shape[1], together

    def blocked(
        self, step: int, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Return whether each move to nodes (n,) in one step comes too near; ``(21, n)``."""
        found = np.zeros((len(MOVES), len(rows)), dtype=np.bool_)
        for number in range(len(self._discs)):
            found |= self._blocked_by(step, number, rows, columns)
        return found

    def _about(
        self, step: int, number: int, rows: slice, columns: slice
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of a window where a move could come too near to a disc."""
        lattice, discs = self._lattice, self._discs
        before, centre = discs.centres_m[number, step], discs.centres_m[number, step + 1]
        reach = (
            float(discs.apart_m[number, step])
            + CLEARANCE_PAD_M
            + LONGEST_MOVE * lattice.spacing_m
            + float(np.linalg.norm(centre - before))
        )
        (left, right), (low, high) = (
            (
                (float(centre[axis] - lattice.origin_m[axis]) - reach) / lattice.spacing_m,
                (float(centre[axis] - lattice.origin_m[axis]) + reach) / lattice.spacing_m,
            )
            for axis in (0, 1)
        )
        return (
            np.arange(max(int(rows.start), math.floor(low)), min(int(rows.stop), high + 1)).astype(
                np.intp
            ),
            np.arange(
                max(int(columns.start), math.floor(left)), min(int(columns.stop), right + 1)
            ).astype(np.intp),
        )

    def _blocked_by(
        self, step: int, number: int, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Return whether moves to nodes, by rows and columns that broadcast, meet one disc."""
        lattice, discs = self._lattice, self._discs
        before, centre = discs.centres_m[number, step], discs.centres_m[number, step + 1]
        x = lattice.origin_m[0] + lattice.spacing_m * columns - centre[0]
        y = lattice.origin_m[1] + lattice.spacing_m * rows - centre[1]
        across = lattice.spacing_m * MOVES - (centre - before)
        square = np.maximum((across * across).sum(axis=1), TINY_M2)
        shape = (len(MOVES), *([1] * max(x.ndim, y.ndim)))
        dx, dy, square = (
            across[:, 0].reshape(shape),
            across[:, 1].reshape(shape),
            square.reshape(shape),
        )
        # Backwards from the end: the way is nearest to the disc at this share of it.
        share = np.clip((dx * x + dy * y) / square, 0.0, 1.0)
        limit = float(discs.apart_m[number, step]) + CLEARANCE_PAD_M
        return np.asarray((x - share * dx) ** 2 + (y - share * dy) ** 2 < limit**2)
