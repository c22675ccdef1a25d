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

from planopt.world.lattice import MOVES, Lattice

Window = tuple[slice, slice]
"""Rows and columns of a part of the lattice."""

StageReward = Callable[[int, Window], NDArray[np.float64]]
"""From the stage k = 1..N and a window to the reward of ending step k at each of its nodes."""

REACH = max(max(abs(dx), abs(dy)) for dx, dy in MOVES)
"""Nodes that a move leads along either axis at most."""


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
    """

    lattice: Lattice
    closed: NDArray[np.float64]


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
    rewards
        For each stage the reward of its window's nodes.
    """

    table: MoveTable
    move_value: NDArray[np.float64]
    values: tuple[NDArray[np.float64], ...]
    windows: tuple[Window, ...]
    rewards: tuple[NDArray[np.float64], ...]


def move_table(lattice: Lattice) -> MoveTable:
    """Tabulate the moves of a lattice."""
    inside = np.where(lattice.open_moves, 0.0, -np.inf)
    margin = ((0, 0), (REACH, REACH), (REACH, REACH))
    return MoveTable(lattice, np.pad(inside, margin, constant_values=-np.inf))


def search_rewards(
    table: MoveTable,
    first: NDArray[np.intp],
    first_value: NDArray[np.float64],
    move_value: NDArray[np.float64],
    horizon: int,
    reward: StageReward,
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
        What it is worth to be at a node after a step.
    """
    ny, nx = table.lattice.shape
    low, high = first.min(axis=0), first.max(axis=0)
    window = _window(low, high, 0, (ny, nx))
    value = np.full(_shape(window), -np.inf)
    rows, columns = first[:, 0] + REACH - window[0].start, first[:, 1] + REACH - window[1].start
    gained = reward(1, _inner(window))
    value[rows, columns] = first_value + gained[rows, columns]
    values, windows, rewards = [value], [window], [gained]
    for k in range(2, horizon + 1):
        grown = _window(low, high, (k - 1) * REACH, (ny, nx))
        # The last stage's values where this stage's moves may come from.
        before = np.full(tuple(n + 2 * REACH for n in _shape(grown)), -np.inf)
        top = windows[-1][0].start - grown[0].start + REACH
        left = windows[-1][1].start - grown[1].start + REACH
        height, width = _shape(windows[-1])
        before[top : top + height, left : left + width] = values[-1]
        gained = reward(k, _inner(grown))
        best = np.full(_shape(grown), -np.inf)
        for move in range(len(MOVES)):
            np.maximum(best, _arriving(table, before, grown, move, move_value), out=best)
        values.append(best + gained)
        windows.append(grown)
        rewards.append(gained)
    return LatticeValues(table, move_value, tuple(values), tuple(windows), tuple(rewards))


def best_end(found: LatticeValues) -> tuple[int, int] | None:
    """The node (iy, ix) of the highest value after the last step; None if there is no way."""
    last = found.values[-1]
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(last)), last.shape))
    if not np.isfinite(last[row, column]):
        return None
    window = found.windows[-1]
    return row + window[0].start - REACH, column + window[1].start - REACH


def path_to(found: LatticeValues, end: tuple[int, int]) -> NDArray[np.intp]:
    """Nodes (N, 2) as (iy, ix) of the best path that ends at `end`."""
    nodes = np.empty((len(found.values), 2), dtype=np.intp)
    nodes[-1] = end
    moves = np.asarray(MOVES)
    for k in range(len(found.values) - 1, 0, -1):
        sources = nodes[k] - moves[:, [1, 0]]
        nodes[k - 1] = sources[_best_source(found, k - 1, sources)]
    return nodes


def _best_source(found: LatticeValues, stage: int, sources: NDArray[np.intp]) -> int:
    """Which of the 21 `sources` (iy, ix) the best value came from."""
    window, value = found.windows[stage], found.values[stage]
    rows = sources[:, 0] + REACH - window[0].start
    columns = sources[:, 1] + REACH - window[1].start
    there = (rows >= 0) & (rows < value.shape[0]) & (columns >= 0) & (columns < value.shape[1])
    arriving = np.full(len(sources), -np.inf)
    which = np.flatnonzero(there)
    closed = found.table.closed[which, sources[which, 0] + REACH, sources[which, 1] + REACH]
    arriving[which] = value[rows[which], columns[which]] + closed + found.move_value[which]
    return int(np.argmax(arriving))


def _arriving(
    table: MoveTable,
    before: NDArray[np.float64],
    window: Window,
    move: int,
    move_value: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Value with which `move` arrives at each node of the window."""
    dx, dy = MOVES[move]
    height, width = _shape(window)
    source = before[REACH - dy : REACH - dy + height, REACH - dx : REACH - dx + width]
    closed = table.closed[
        move,
        window[0].start - dy : window[0].stop - dy,
        window[1].start - dx : window[1].stop - dx,
    ]
    arriving = source + closed
    if move_value[move]:
        arriving += move_value[move]
    return arriving


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
