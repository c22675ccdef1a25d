"""Global search for the most rewarding path of N steps: dynamic programming on the lattice.

Exact for rewards that add up over steps, on the lattice. The first move goes from the robot's own
place to any node in reach; every later one is one of the lattice's moves. Stage by stage the best
value of every node in the reachable window is kept, moves being shifted slices of the last stage's,
and the path is found back from these values, so that no pointers are stored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.moving_moves import MovingMoves
from planopt.world.lattice import MOVES, Lattice

Window = tuple[slice, slice]
"""Rows and columns of a part of the lattice."""

StageReward = Callable[[int, Window], NDArray[np.float64]]
"""From the stage k = 1..N and a window to the reward of ending step k at each of its nodes."""

REACH = max(max(abs(dx), abs(dy)) for dx, dy in MOVES)
"""Nodes that a move leads along either axis at most."""


MOVES_BY_NUMBER = tuple((int(dx), int(dy)) for dx, dy in MOVES)
"""(dx, dy) of each move."""


@dataclass(frozen=True)
class MoveTable:
    """The moves of a lattice, ready for searching.

    Attributes
    ----------
    lattice
        Whose moves they are.
    closed
        ``(21, ny + 2 REACH, nx + 2 REACH)``: 0 where a move from the node is open, else minus
        infinity; with a margin of closed nodes around the lattice.
    hindered
        ``(ny, nx)`` free nodes that some move from a free node does not lead to.
    """

    lattice: Lattice
    closed: NDArray[np.float64]
    hindered: NDArray[np.bool_]


@dataclass(frozen=True)
class LatticeValues:
    """Best value of every node at every stage.

    Attributes
    ----------
    table
        The moves that it was found with.
    move_value
        ``(21,)`` what each move is worth.
    values
        For each stage its window's values; the windows grow by `REACH` nodes to each side.
    windows
        The windows, in the lattice with its margin.
    moving
        What moves beside the lattice, and closes moves for a step.
    """

    table: MoveTable
    move_value: NDArray[np.float64]
    values: tuple[NDArray[np.float64], ...]
    windows: tuple[Window, ...]
    moving: MovingMoves | None = None


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
    return MoveTable(lattice, closed, hindered & lattice.free)


def search_rewards(
    table: MoveTable,
    first: NDArray[np.intp],
    first_value: NDArray[np.float64],
    move_value: NDArray[np.float64],
    horizon: int,
    reward: StageReward,
    moving: MovingMoves | None = None,
) -> LatticeValues:
    """Find the best value of every node that N = `horizon` steps can lead to.

    Parameters
    ----------
    table
        The lattice's moves.
    first
        ``(n, 2)`` nodes (iy, ix), at least one, that the first step may end at.
    first_value
        ``(n,)`` what these first steps are worth in themselves.
    move_value
        ``(21,)`` what each later move is worth in itself (its energy, negative).
    horizon
        N.
    reward
        What it is worth to be at a node after a step; minus infinity at nodes that are not free.
    moving
        What moves and closes moves for a step; the first steps are the caller's.
    """
    return RewardSearch(table, first, first_value, move_value, horizon, moving)(reward)


class RewardSearch:
    """:func:`search_rewards` from one place, for one reward after the other.

    Parameters
    ----------
    table, first, first_value, move_value, horizon, moving
        As there.
    """

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
        self._windows = [_window(low, high, k * REACH, shape) for k in range(horizon)]
        self._frame = _Frame(table, move_value, self._windows)

    def __call__(self, reward: StageReward) -> LatticeValues:
        """The best value of every node that N steps can lead to."""
        windows, frame = self._windows, self._frame
        frame.clear()
        window = windows[0]
        value = np.full(_shape(window), -np.inf)
        rows = self._first[:, 0] + REACH - window[0].start
        columns = self._first[:, 1] + REACH - window[1].start
        value[rows, columns] = self._first_value + reward(1, _inner(window))[rows, columns]
        values = [value]
        for k in range(1, len(windows)):
            frame.put(windows[k - 1], values[-1])
            arriving = frame.arriving(k)
            if self._moving is not None:
                frame.pass_by(self._moving, k, arriving)
            values.append(arriving + reward(k + 1, _inner(windows[k])))
        return LatticeValues(
            self._table, self._move_value, tuple(values), tuple(windows), self._moving
        )


class _Frame:
    """The last stage's values, around all nodes that any stage looks at.

    Where moves cost nothing and none is closed, the best of 21 sources is the largest value in a
    disc: five maxima along rows and columns. Hindered nodes, and all nodes where moves cost
    something, look at their sources one by one.

    Parameters
    ----------
    table, move_value
        As :func:`search_rewards`.
    windows
        Of all stages.
    """

    def __init__(
        self, table: MoveTable, move_value: NDArray[np.float64], windows: list[Window]
    ) -> None:
        self._table = table
        self._move_value = move_value
        self._windows = windows
        self._free_moves = not move_value.any()
        self._top, self._left = windows[-1][0].start - REACH, windows[-1][1].start - REACH
        height, width = _shape(windows[-1])
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
            best = np.full(_shape(window), -np.inf)
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
        rows, columns, blocked = moving.hindered(stage, *_inner(window))
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
        rows, columns = np.nonzero(self._table.hindered[_inner(widest)])
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
        height, width = _shape(window)
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


def best_ends(found: LatticeValues, count: int, apart: int) -> list[tuple[int, int]]:
    """The nodes (iy, ix) of the highest values after the last step, best first.

    Parameters
    ----------
    found
        What the search found.
    count
        How many, fewer if there are no more.
    apart
        Nodes along either axis that each is more than away from every better one.
    """
    left = found.values[-1].copy()
    top, beside = (part.start - REACH for part in found.windows[-1])
    ends: list[tuple[int, int]] = []
    while len(ends) < count:
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(left)), left.shape))
        if not np.isfinite(left[row, column]):
            break
        ends.append((row + top, column + beside))
        left[
            max(row - apart, 0) : row + apart + 1, max(column - apart, 0) : column + apart + 1
        ] = -np.inf
    return ends


def path_to(found: LatticeValues, end: tuple[int, int]) -> NDArray[np.intp]:
    """Nodes (N, 2) as (iy, ix) of the best path that ends at `end`."""
    nodes = [end]
    for stage in range(len(found.values) - 2, -1, -1):
        blocked = None
        if found.moving is not None:
            row, column = np.array(nodes[-1]).reshape(2, 1)
            blocked = found.moving.blocked(stage + 1, row, column)[:, 0]
        nodes.append(_best_source(found, stage, nodes[-1], blocked))
    return np.array(nodes[::-1], dtype=np.intp)


def _best_source(
    found: LatticeValues, stage: int, node: tuple[int, int], blocked: NDArray[np.bool_] | None
) -> tuple[int, int]:
    """Which of the 21 nodes (iy, ix) its best value came from, by a move not `blocked`."""
    # One by one: for so few, arrays cost several times as much.
    (rows, columns), value, closed = found.windows[stage], found.values[stage], found.table.closed
    height, width = value.shape
    best, source = -np.inf, node
    for move, (dx, dy) in enumerate(MOVES_BY_NUMBER):
        if blocked is not None and blocked[move]:
            continue
        row, column = node[0] - dy + REACH, node[1] - dx + REACH
        inside_row, inside_column = row - rows.start, column - columns.start
        if 0 <= inside_row < height and 0 <= inside_column < width:
            arriving = value.item(inside_row, inside_column) + closed.item(move, row, column)
            arriving += found.move_value.item(move)
            if arriving > best:
                best, source = arriving, (row - REACH, column - REACH)
    return source


def _window(
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


def _inner(window: Window) -> Window:
    """A window in the lattice without its margin."""
    rows, columns = window
    return (
        slice(rows.start - REACH, rows.stop - REACH),
        slice(columns.start - REACH, columns.stop - REACH),
    )


def _shape(window: Window) -> tuple[int, int]:
    return window[0].stop - window[0].start, window[1].stop - window[1].start
