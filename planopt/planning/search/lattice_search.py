"""Dynamic programming over N steps on the lattice: the path of the largest sum of rewards.

Exact for rewards that add up over steps. The first move leads from the robot's own place to any
node in reach; every later one is one of the lattice's 21 moves. A move has a value, less a
surcharge that depends on its two ends. Stage by stage the best value of every node in the reachable
window is kept, moves being shifted slices of the previous stage's values; paths are traced back
from these values, so that no pointers are stored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import step_cost_s
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
from planopt.world.moving_obstacle import MovingDiscs
from planopt.world.road_map import RoadMap

StageReward = Callable[[int, Window], NDArray[np.float64]]
"""From the stage k = 1..N and a window to the reward of ending step k at each of its nodes."""

Node = tuple[int, int]
"""A node (iy, ix)."""

STANDING = 0
"""The move that leads nowhere."""


@dataclass(frozen=True, eq=False)
class MoveValues:
    """The value of every move."""

    table: MoveTable  # Which moves are open
    value: NDArray[np.float64]  # (21,)
    # In addition a move costs its factor, (21,), times the sum of the charges at both ends; charges
    # (ny + 2 REACH, nx + 2 REACH), with the lattice's margin
    factor: NDArray[np.float64] | None = None
    charge: NDArray[np.float64] | None = None
    rest: Node | None = None  # Where standing still costs nothing
    moving: MovingMoves | None = None  # Closes moves for single steps

    @property
    def are_free(self) -> bool:
        """Return whether open moves cost nothing."""
        return not self.value.any() and self.charge is None

    def surcharge(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return what each move to nodes (n,), margin counted, costs besides its value; (21, n)."""
        from_rows, from_columns = sources_of(rows, columns)
        closed = self.table.closed[np.arange(len(MOVES))[:, None], from_rows, from_columns]
        if self.factor is None or self.charge is None:
            return -closed
        both = self.charge[from_rows, from_columns] + self.charge[rows, columns]
        return self.factor[:, None] * both - closed

    def rests(self, step: int) -> bool:
        """Return whether the robot may stand at `rest` during a step."""
        if self.rest is None:
            return False
        row, column = (np.array([part]) for part in self.rest)
        return self.moving is None or not self.moving.blocked(step, row, column)[STANDING].any()


def sources_of(
    rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns, (21, n), from which each move leads to nodes (n,)."""
    return rows - MOVES[:, 1:], columns - MOVES[:, :1]


class StageFrame:
    """The previous stage's values, around all nodes that any stage looks at.

    If moves are free and unblocked, the maximisation over a node's 21 predecessors is a disc-shaped
    max filter: five maxima along rows and columns. Hindered nodes then look at their sources one by
    one.
    """

    def __init__(self, moves: MoveValues, windows: list[Window]) -> None:
        self._moves = moves
        self._windows = windows
        self._top, self._left = windows[-1][0].start - REACH, windows[-1][1].start - REACH
        height, width = window_shape(windows[-1])
        self._value = np.full((height + 2 * REACH, width + 2 * REACH), -np.inf)
        if moves.are_free:
            self._find_hindered()
        else:
            self._surcharge = self._widest_surcharge()

    def clear(self) -> None:
        """Forget all values."""
        self._value.fill(-np.inf)

    def put(self, window: Window, value: NDArray[np.float64]) -> None:
        """Take the previous stage's values."""
        self._value[self._at(window)] = value

    def arriving(self, stage: int) -> NDArray[np.float64]:
        """Return the best value that any move brings to each node of the window of `stage`."""
        window = self._windows[stage]
        rows, columns = self._at(window)
        around = self._value[
            rows.start - REACH : rows.stop + REACH, columns.start - REACH : columns.stop + REACH
        ]
        if self._moves.are_free:
            best = _largest_in_disc(around)
            count = self._hindered_by_stage[stage]
            rows, columns = self._nodes
            sources = self._value.ravel()[self._sources[:, :count]]
            sources -= self._hindered_surcharge[:, :count]
            best[rows[:count] - window[0].start, columns[:count] - window[1].start] = sources.max(
                axis=0, initial=-np.inf
            )
        else:
            best = self._best_move(around, window)
        if self._moves.moving is not None:
            self._pass_by(self._moves.moving, stage, best)
        if self._moves.rest is not None and self._moves.rests(stage):
            row, column = (
                part + REACH - side.start
                for part, side in zip(self._moves.rest, window, strict=True)
            )
            if 0 <= row < best.shape[0] and 0 <= column < best.shape[1]:
                best[row, column] = max(best[row, column], around[row + REACH, column + REACH])
        return best

    def _best_move(self, around: NDArray[np.float64], window: Window) -> NDArray[np.float64]:
        """Return the best value of 21 shifted slices of the values `around` a window."""
        height, width = window_shape(window)
        best, arriving = np.full((height, width), -np.inf), np.empty((height, width))
        top = window[0].start - self._windows[-1][0].start
        left = window[1].start - self._windows[-1][1].start
        for move, (dx, dy) in enumerate(MOVES):
            source = around[REACH - dy : REACH - dy + height, REACH - dx : REACH - dx + width]
            np.add(source, self._moves.value[move], out=arriving)
            arriving -= self._surcharge[move, top : top + height, left : left + width]
            np.maximum(best, arriving, out=best)
        return best

    def _pass_by(self, moving: MovingMoves, stage: int, best: NDArray[np.float64]) -> None:
        """Correct the best values at nodes that some move comes too near to a moving disc for."""
        window = self._windows[stage]
        rows, columns, blocked = moving.hindered(stage, *without_margin(window))
        rows, columns = rows + REACH, columns + REACH
        from_rows, from_columns = sources_of(rows, columns)
        arriving = self._value[from_rows - self._top, from_columns - self._left]
        arriving = arriving + self._moves.value[:, None]
        arriving -= self._moves.surcharge(rows, columns)
        arriving[blocked] = -np.inf
        best[rows - window[0].start, columns - window[1].start] = arriving.max(axis=0)

    def _find_hindered(self) -> None:
        """List the hindered nodes of all windows by the stage that first looks at them."""
        widest = self._windows[-1]
        rows, columns = np.nonzero(self._moves.table.hindered[without_margin(widest)])
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
        self._hindered_surcharge = self._moves.surcharge(rows, columns)
        from_rows, from_columns = sources_of(rows, columns)
        self._sources = (from_rows - self._top) * self._value.shape[1] + from_columns - self._left

    def _widest_surcharge(self) -> NDArray[np.float64]:
        """Return what each move to the nodes of the widest window costs besides its value."""
        moves, (rows, columns) = self._moves, self._windows[-1]
        found = np.empty((len(MOVES), *window_shape(self._windows[-1])))
        for move, (dx, dy) in enumerate(MOVES):
            source = (
                slice(rows.start - dy, rows.stop - dy),
                slice(columns.start - dx, columns.stop - dx),
            )
            if moves.factor is not None and moves.charge is not None:
                np.add(moves.charge[source], moves.charge[rows, columns], out=found[move])
                found[move] *= moves.factor[move]
                found[move] -= moves.table.closed[move][source]
            else:
                np.negative(moves.table.closed[move][source], out=found[move])
        return found

    def _at(self, window: Window) -> Window:
        """Return a window of the lattice with its margin, in the frame."""
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


@dataclass(frozen=True)
class LatticeValues:
    """Best value of every node at every stage."""

    moves: MoveValues  # The moves that it was found with
    # For each stage its window's values; the windows grow by `REACH` nodes to each side
    values: tuple[NDArray[np.float64], ...]
    windows: tuple[Window, ...]  # The windows, in the lattice with its margin

    def best_ends(self, count: int, apart: int) -> list[Node]:
        """Return the nodes of the highest values after the last step, best first."""
        left = self.values[-1].copy()
        top, beside = (part.start - REACH for part in self.windows[-1])
        ends: list[Node] = []
        while len(ends) < count:
            row, column = (int(i) for i in np.unravel_index(int(np.argmax(left)), left.shape))
            if not np.isfinite(left[row, column]):
                break
            ends.append((row + top, column + beside))
            left[
                max(row - apart, 0) : row + apart + 1, max(column - apart, 0) : column + apart + 1
            ] = -np.inf
        return ends

    def path_to(self, end: Node) -> NDArray[np.intp]:
        """Return the nodes (N, 2) as (iy, ix) of the best path that ends at `end`."""
        nodes = [end]
        for stage in range(len(self.values) - 2, -1, -1):
            nodes.append(self._best_source(stage, nodes[-1]))
        return np.array(nodes[::-1], dtype=np.intp)

    def _best_source(self, stage: int, node: Node) -> Node:
        """Return which of the 21 nodes (iy, ix) its best value came from."""
        moves, (rows, columns), value = self.moves, self.windows[stage], self.values[stage]
        row, column = np.array(node).reshape(2, 1) + REACH
        from_rows, from_columns = sources_of(row, column)
        inside_rows, inside_columns = from_rows - rows.start, from_columns - columns.start
        inside = (inside_rows >= 0) & (inside_rows < len(value))
        inside &= (inside_columns >= 0) & (inside_columns < value.shape[1])
        arriving = np.full(inside.shape, -np.inf)
        arriving[inside] = value[inside_rows[inside], inside_columns[inside]]
        standing = arriving[STANDING].copy()
        arriving += moves.value[:, None]
        arriving -= moves.surcharge(row, column)
        if node == moves.rest and moves.rests(stage + 1):
            arriving[STANDING] = standing
        if moves.moving is not None:
            blocked = moves.moving.blocked(stage + 1, row - REACH, column - REACH)
            arriving[blocked] = -np.inf
        best = int(arriving.argmax())
        return int(from_rows[best, 0]) - REACH, int(from_columns[best, 0]) - REACH


class LatticeSearch:
    """Searches from one place, for one reward after the other."""

    def __init__(
        self,
        moves: MoveValues,
        first: NDArray[np.intp],  # (n, 2) nodes (iy, ix), n > 0, that the first step may end at
        first_value: NDArray[np.float64],  # (n,) value of these first steps in themselves
        horizon: int,
    ) -> None:
        shape = moves.table.lattice.shape
        low, high = first.min(axis=0), first.max(axis=0)
        self._moves, self._first, self._first_value = moves, first, first_value
        self._windows = [window_around(low, high, k * REACH, shape) for k in range(horizon)]
        self._frame = StageFrame(moves, self._windows)

    def __call__(self, reward: StageReward) -> LatticeValues:
        """Find the best value of every node that N steps can lead to."""
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
            values.append(frame.arriving(k) + reward(k + 1, without_margin(windows[k])))
        return LatticeValues(self._moves, tuple(values), tuple(windows))


@dataclass(frozen=True)
class LatticePath:
    """The cheapest path found."""

    nodes: NDArray[np.intp]  # (N,) node after each step
    cost_s: float  # Its cost, penalties and cost-to-go included


def search_cheapest(
    road_map: RoadMap,
    table: MoveTable,
    first_nodes: NDArray[np.intp],
    first_length_m: NDArray[np.float64],
    horizon: int,
    step_s: float,
    effort_weight_s2_m2: float,
    goal_node: int,
    node_penalty_s: NDArray[np.float64],  # (n,) or (N, n)
    terminal_cost_s: NDArray[np.float64],  # (n,) added for the last node
    surcharge_s_m: NDArray[np.float64] | None = None,  # (n + 1,) of a metre at nodes, and here
    moving: MovingDiscs | None = None,
) -> LatticePath | None:
    """Find the cheapest path of `horizon` steps, or None if no node can be reached at all.

    Standing at the goal costs nothing.
    """
    if first_nodes.size == 0:
        return None
    rows, columns, shape = road_map.rows, road_map.columns, road_map.lattice.shape
    half = None if surcharge_s_m is None else 0.5 * surcharge_s_m
    cost = step_cost_s(first_length_m, step_s, effort_weight_s2_m2)
    charge: NDArray[np.float64] | None = None
    if half is not None:
        cost = cost + first_length_m * (half[first_nodes] + half[-1])
        charge = np.zeros(table.closed.shape[1:])
        charge[rows + REACH, columns + REACH] = half[:-1]
    moves = MoveValues(
        table,
        -step_cost_s(road_map.lengths_m, step_s, effort_weight_s2_m2),
        None if charge is None else road_map.lengths_m,
        charge,
        (int(rows[goal_node]), int(columns[goal_node])) if goal_node >= 0 else None,
        MovingMoves(road_map.lattice, moving) if moving is not None and len(moving) else None,
    )
    reward = np.zeros((horizon if node_penalty_s.ndim > 1 else 1, *shape))
    reward[:, rows, columns] -= node_penalty_s
    first = np.stack([rows[first_nodes], columns[first_nodes]], axis=1)
    found = LatticeSearch(moves, first, -cost, horizon)(
        lambda stage, window: reward[min(stage, len(reward)) - 1][window]
    )
    to_go = np.full(shape, np.inf)
    to_go[rows, columns] = terminal_cost_s
    total = found.values[-1] - to_go[without_margin(found.windows[-1])]
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(total)), total.shape))
    if not np.isfinite(total[row, column]):
        return None
    top, left = (part.start - REACH for part in found.windows[-1])
    path = found.path_to((row + top, column + left))
    return LatticePath(road_map.number[path[:, 0], path[:, 1]], -float(total[row, column]))
