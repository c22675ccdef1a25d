"""Global search for the most rewarding path of N steps: dynamic programming on the lattice.

Exact for rewards that add up over steps, on the lattice. The first move goes from the robot's own
place to any node in reach; every later one is one of the lattice's moves. Stage by stage the best
value of every node in the reachable window is kept, moves being shifted slices of the last stage's,
and :mod:`planopt.planning.search.start_search` finds the path back from these values, so that no
pointers are stored.

The best value that a move brings to each node: the last stage's values, shifted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.moving_moves import (
    REACH,
    MoveTable,
    MovingMoves,
    Window,
    window_around,
    window_shape,
    without_margin,
)
from planopt.world.lattice import MOVES


class StageFrame:
    """The last stage's values, around all nodes that any stage looks at.

    Where moves cost nothing and none is closed, the best of 21 sources is the largest value in a
    disc: five maxima along rows and columns. Hindered nodes, and all nodes where moves cost
    something, look at their sources one by one.
    """

    def __init__(
        self, table: MoveTable, move_value: NDArray[np.float64], windows: list[Window]
    ) -> None:
        self._table = table
        self._move_value = move_value
        self._windows = windows
        self._free_moves = not move_value.any()
        self._top, self._left = windows[-1][0].start - REACH, windows[-1][1].start - REACH
        height, width = window_shape(windows[-1])
        self._value = np.full((height + 2 * REACH, width + 2 * REACH), -np.inf)
        if self._free_moves:
            self._find_hindered()

    def clear(self) -> None:
        """Forget all values."""
        self._value.fill(-np.inf)

    def put(self, window: Window, value: NDArray[np.float64]) -> None:
        """These are the last stage's values."""
        self._value[self._at(window)] = value

    def arriving(self, stage: int) -> NDArray[np.float64]:
        """The best value that any move brings to each node of the window of `stage`."""
        window = self._windows[stage]
        rows, columns = self._at(window)
        around = self._value[
            rows.start - REACH : rows.stop + REACH, columns.start - REACH : columns.stop + REACH
        ]
        if not self._free_moves:
            best = np.full(window_shape(window), -np.inf)
            for move in range(len(MOVES)):
                np.maximum(best, self._arriving_by(around, window, move), out=best)
            return best
        best = _largest_in_disc(around)
        count = self._hindered_by_stage[stage]
        rows, columns = self._nodes
        sources = self._value.ravel()[self._sources[:, :count]]
        sources += self._closed[:, :count]
        best[rows[:count] - window[0].start, columns[:count] - window[1].start] = sources.max(
            axis=0, initial=-np.inf
        )
        return best

    def pass_by(self, moving: MovingMoves, stage: int, best: NDArray[np.float64]) -> None:
        """Correct the best values at nodes that some move comes too near to a moving disc for."""
        window = self._windows[stage]
        rows, columns, blocked = moving.hindered(stage, *without_margin(window))
        rows, columns = rows + REACH, columns + REACH
        moves = np.arange(len(MOVES))[:, None]
        from_row, from_column = rows - MOVES[:, 1:], columns - MOVES[:, :1]
        arriving = self._value[from_row - self._top, from_column - self._left]
        arriving = arriving + self._table.closed[moves, from_row, from_column]
        arriving += self._move_value[:, None]
        arriving[blocked] = -np.inf
        best[rows - window[0].start, columns - window[1].start] = arriving.max(axis=0)

    def _find_hindered(self) -> None:
        """List the hindered nodes of all windows by the stage that first looks at them."""
        widest = self._windows[-1]
        rows, columns = np.nonzero(self._table.hindered[without_margin(widest)])
        rows, columns = rows + widest[0].start, columns + widest[1].start
        stage = np.zeros(len(rows), dtype=np.intp)
        for window in self._windows[:-1]:
            stage += (rows < window[0].start) | (rows >= window[0].stop)
            stage += (
                (rows >= window[0].start)
                & (rows < window[0].stop)
                & ((columns < window[1].start) | (columns >= window[1].stop))
            )
        order = np.argsort(stage, kind="stable")
        rows, columns = rows[order], columns[order]
        self._hindered_by_stage = np.searchsorted(
            stage[order], np.arange(len(self._windows)), side="right"
        )
        self._nodes = rows, columns
        moves = np.arange(len(MOVES))[:, None]
        from_row, from_column = rows - MOVES[:, 1:], columns - MOVES[:, :1]
        self._closed = self._table.closed[moves, from_row, from_column]
        self._sources = (from_row - self._top) * self._value.shape[1] + from_column - self._left

    def _arriving_by(
        self, around: NDArray[np.float64], window: Window, move: int
    ) -> NDArray[np.float64]:
        """Value with which `move` arrives at each node of the window."""
        dx, dy = MOVES[move]
        height, width = window_shape(window)
        source = around[REACH - dy : REACH - dy + height, REACH - dx : REACH - dx + width]
        closed = self._table.closed[
            move,
            window[0].start - dy : window[0].stop - dy,
            window[1].start - dx : window[1].stop - dx,
        ]
        return source + closed + self._move_value[move]

    def _at(self, window: Window) -> Window:
        """A window of the lattice with its margin, in the frame."""
        rows, columns = window
        return (
            slice(rows.start - self._top, rows.stop - self._top),
            slice(columns.start - self._left, columns.stop - self._left),
        )


def _largest_in_disc(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest of the 21 values (dx, dy), dx^2 + dy^2 <= 5, about each node.

    `around` (h + 4, w + 4) is two nodes wider to each side than the result (h, w).
    """
    height, width = around.shape[0] - 2 * REACH, around.shape[1] - 2 * REACH
    three = np.maximum(around[:, 1 : width + 1], around[:, 2 : width + 2])
    np.maximum(three, around[:, 3 : width + 3], out=three)
    five = np.maximum(around[1:-1, :width], around[1:-1, 4 : width + 4])
    np.maximum(five, three[1:-1], out=five)
    best = np.maximum(three[:height], three[4 : height + 4])
    for row in range(3):
        np.maximum(best, five[row : row + height], out=best)
    return best


StageReward = Callable[[int, Window], NDArray[np.float64]]
"""From the stage k = 1..N and a window to the reward of ending step k at each of its nodes."""


@dataclass(frozen=True)
class LatticeValues:
    """Best value of every node at every stage."""

    table: MoveTable  # The moves that it was found with
    move_value: NDArray[np.float64]  # (21,) what each move is worth
    # For each stage its window's values; the windows grow by `REACH` nodes to each side
    values: tuple[NDArray[np.float64], ...]
    windows: tuple[Window, ...]  # The windows, in the lattice with its margin
    moving: MovingMoves | None = None  # What moves beside the lattice, and closes moves for a step


def search_rewards(
    table: MoveTable,
    first: NDArray[np.intp],  # (n, 2) nodes (iy, ix), at least one, that the first step may end at
    first_value: NDArray[np.float64],  # (n,) what these first steps are worth in themselves
    move_value: NDArray[np.float64],  # (21,)
    horizon: int,
    reward: StageReward,
    moving: MovingMoves | None = None,
) -> LatticeValues:
    """Find the best value of every node that N = `horizon` steps can lead to."""
    return RewardSearch(table, first, first_value, move_value, horizon, moving)(reward)


class RewardSearch:
    """:func:`search_rewards` from one place, for one reward after the other."""

    def __init__(
        self,
        table: MoveTable,
        first: NDArray[np.intp],
        first_value: NDArray[np.float64],
        move_value: NDArray[np.float64],
        horizon: int,
        moving: MovingMoves | None = None,
    ) -> None:
        shape = table.lattice.shape
        low, high = first.min(axis=0), first.max(axis=0)
        self._table, self._move_value, self._moving = table, move_value, moving
        self._first, self._first_value = first, first_value
        self._windows = [window_around(low, high, k * REACH, shape) for k in range(horizon)]
        self._frame = StageFrame(table, move_value, self._windows)

    def __call__(self, reward: StageReward) -> LatticeValues:
        """The best value of every node that N steps can lead to."""
        windows, frame = self._windows, self._frame
        frame.clear()
        window = windows[0]
        value = np.full(window_shape(window), -np.inf)
        rows = self._first[:, 0] + REACH - window[0].start
        columns = self._first[:, 1] + REACH - window[1].start
        value[rows, columns] = self._first_value + reward(1, without_margin(window))[rows, columns]
        values = [value]
        for k in range(1, len(windows)):
            frame.put(windows[k - 1], values[-1])
            arriving = frame.arriving(k)
            if self._moving is not None:
                frame.pass_by(self._moving, k, arriving)
            values.append(arriving + reward(k + 1, without_margin(windows[k])))
        return LatticeValues(
            self._table, self._move_value, tuple(values), tuple(windows), self._moving
        )
