"""Global search for the most rewarding path of N steps: dynamic programming on the lattice.

Exact for rewards that add up over steps, on the lattice. The first move goes from the robot's own
place to any node in reach; every later one is one of the lattice's moves. Stage by stage the best
value of every node in the reachable window is kept, moves being shifted slices of the last stage's,
and :mod:`planopt.planning.search.path_back` finds the path back from these values, so that no
pointers are stored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.search.lattice_window import (
    REACH,
    Window,
    window_around,
    window_shape,
    without_margin,
)
from planopt.planning.search.move_table import MoveTable
from planopt.planning.search.moving_moves import MovingMoves
from planopt.planning.search.stage_frame import StageFrame

StageReward = Callable[[int, Window], NDArray[np.float64]]
"""From the stage k = 1..N and a window to the reward of ending step k at each of its nodes."""


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
