"""Dynamic programming over N steps on the lattice: maximise the sum of rewards.

The search is exact for rewards that are additive over steps. The first move leads from the robot's
position to any node within a step; later moves are the lattice's 21 moves. A surcharge on a move
depends on its two ends; a moving obstacle blocks moves only in the steps when it is nearby. Each
stage computes the best value of every node in the reachable window from shifted slices of the
previous stage's values; paths are traced back from these values. A window is a rectangular part of
the lattice. Its padded indices count a margin of blocked nodes around the lattice.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.problems.problem import step_cost_s
from planopt.world.lattice import MOVES, Lattice, RoadMap
from planopt.world.motion import MovingDiscs, passing_gaps_m
from planopt.world.workspace import LONGEST_MOVE


@dataclass(frozen=True)
class MoveTable:
    """Table of the lattice moves that no obstacle blocks."""

    lattice: Lattice
    # (21, ny + 2 REACH, nx + 2 REACH): 0 for an open move from the node, else minus infinity; has a
    # margin of blocked nodes around the lattice
    closed: Floats
    hindered: Mask  # (ny, nx) free nodes that at least one move from a free node cannot reach
    # (ny + 2 REACH, nx + 2 REACH) indices of the free nodes in row-major order, -1 elsewhere
    number: Indices


def move_table(lattice: Lattice) -> MoveTable:
    """Return the table of a lattice's moves."""
    inside = np.where(lattice.open_moves, 0.0, -np.inf)
    margin = ((0, 0), (REACH, REACH), (REACH, REACH))
    closed = np.pad(inside, margin, constant_values=-np.inf)
    free = np.pad(lattice.free, REACH)
    ny, nx = lattice.shape
    hindered = np.zeros(lattice.shape, dtype=np.bool_)
    for move, (dx, dy) in enumerate(MOVES):
        source = (slice(REACH - dy, REACH - dy + ny), slice(REACH - dx, REACH - dx + nx))
        hindered |= free[source] & (closed[move][source] != 0.0)
    number = np.full(free.shape, -1, dtype=np.intp)
    number[free] = np.arange(int(free.sum()))
    return MoveTable(lattice, closed, hindered & lattice.free, number)


Window = tuple[slice, slice]
"""Rows and columns of a part of the lattice."""
REACH = max(max(abs(dx), abs(dy)) for dx, dy in MOVES)
"""Largest number of nodes that a move spans along an axis; also the width of the margin."""


def window_around(low: Indices, high: Indices, grown: int, shape: tuple[int, int]) -> Window:
    """Return the window from `low` to `high`, enlarged by `grown` nodes, in padded indices."""
    rows, columns = (
        slice(
            max(int(low[axis]) - grown, 0) + REACH,
            min(int(high[axis]) + grown, shape[axis] - 1) + REACH + 1,
        )
        for axis in (0, 1)
    )
    return rows, columns


def without_margin(window: Window) -> Window:
    """Return a window in indices of the lattice itself, without padding."""
    rows, columns = window
    return (
        slice(rows.start - REACH, rows.stop - REACH),
        slice(columns.start - REACH, columns.stop - REACH),
    )


def window_shape(window: Window) -> tuple[int, int]:
    """Return the numbers of rows and columns of a window."""
    return window[0].stop - window[0].start, window[1].stop - window[1].start


TINY_M2 = 1e-30  # Squared length below which a relative motion counts as standstill


def first_steps_apart(discs: MovingDiscs, position_m: Floats, ends_m: Floats) -> Mask:
    """Return a mask of collision-free first steps from a position (2,) to `ends_m` (n, 2)."""
    return steps_apart(discs, 0, np.broadcast_to(position_m, ends_m.shape), ends_m)


def steps_apart(discs: MovingDiscs, step: int, starts_m: Floats, ends_m: Floats) -> Mask:
    """Return a mask of straight motions (..., 2) that avoid moving discs in `step` (0-based)."""
    # A first step that begins too close to a disc is allowed if it moves away.
    if not len(discs):
        return np.ones(starts_m.shape[:-1], dtype=np.bool_)
    begin = discs.centres_m[:, step].reshape(-1, *([1] * (starts_m.ndim - 1)), 2)
    apart = discs.apart_m[:, step].reshape(begin.shape[:-1])
    here = np.linalg.norm(starts_m - begin, axis=-1) - apart
    wanted = np.minimum(CLEARANCE_PAD_M, here) if step == 0 else CLEARANCE_PAD_M
    return np.asarray((passing_gaps_m(discs, step, starts_m, ends_m) >= wanted).all(axis=0))


class MovingMoves:
    """Lattice moves that moving discs (obstacles or robots) block in single steps.

    Relative to a moving disc, a move (dx, dy) is the same vector at every node, so one formula
    applies to all nodes.
    """

    def __init__(self, lattice: Lattice, discs: MovingDiscs) -> None:
        self._lattice = lattice
        self._discs = discs

    def hindered(self, step: int, rows: slice, columns: slice) -> tuple[Indices, Indices, Mask]:
        """Return the nodes of a window where discs block moves, and a mask of the blocked moves."""
        nodes: list[Indices] = []
        moves: list[Mask] = []
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

    def blocked(self, step: int, rows: Indices, columns: Indices) -> Mask:
        """Return a mask (21, n): whether each move to each node collides with a disc in a step."""
        found = np.zeros((len(MOVES), len(rows)), dtype=np.bool_)
        for number in range(len(self._discs)):
            found |= self._blocked_by(step, number, rows, columns)
        return found

    def _about(
        self, step: int, number: int, rows: slice, columns: slice
    ) -> tuple[Indices, Indices]:
        """Return the rows and columns of a window where moves may collide with disc `number`."""
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

    def _blocked_by(self, step: int, number: int, rows: Indices, columns: Indices) -> Mask:
        """Return a mask (21, n): whether each move to each node collides with disc `number`."""
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
        # Fraction of the move, backwards from its end, at which it is closest to the disc.
        share = np.clip((dx * x + dy * y) / square, 0.0, 1.0)
        limit = float(discs.apart_m[number, step]) + CLEARANCE_PAD_M
        return np.asarray((x - share * dx) ** 2 + (y - share * dy) ** 2 < limit**2)


StageReward = Callable[[int, Window], Floats]
"""Function that maps stage k = 1..N and a window to the reward of ending step k at each node."""
Node = tuple[int, int]
"""Node indices (iy, ix)."""
MOVES_BY_NUMBER = tuple((int(dx), int(dy)) for dx, dy in MOVES)
"""Offsets (dx, dy) of the moves, by number."""
STANDING = 0  # Index of the move that stays at its node


@dataclass(frozen=True, eq=False)
class MoveValues:
    """Values and surcharges of lattice moves in a search, and the moves that are not blocked."""

    table: MoveTable  # Open moves
    value: Floats  # (21,)
    # Surcharge of a move: its factor, (21,), times the sum of both nodes' charges, (n,)
    factor: Floats | None = None
    charge: Floats | None = None
    rest: Node | None = None  # Node where waiting is free
    moving: MovingMoves | None = None  # Blocks moves in single steps

    @cached_property
    def are_free(self) -> bool:
        """Return whether every move that is not blocked has value and surcharge zero."""
        return not self.value.any() and self.charge is None

    @cached_property
    def _charges(self) -> Floats | None:
        """Charge of every node of the padded lattice, flattened; None without charges."""
        return None if self.charge is None else self.charge[self.table.number.reshape(-1)]

    def gain(self, rows: Indices, columns: Indices) -> Floats:
        """Return value minus surcharge (21, n) of the moves to nodes at padded indices (n,)."""
        width, places = self.table.number.shape[1], self.table.number.size
        end = rows * width + columns
        source = np.asarray(end - (MOVES[:, 1:] * width + MOVES[:, :1]), dtype=np.intp)
        of_move = source + places * np.arange(len(MOVES))[:, None]
        gain = self.table.closed.reshape(-1).take(of_move)
        gain += self.value[:, None]
        charge = self._charges
        if self.factor is not None and charge is not None:
            both = charge.take(source)
            both += charge[end]
            both *= self.factor[:, None]
            gain -= both
        return gain

    def rests(self, step: int) -> bool:
        """Return whether waiting at the node `rest` is possible during a step."""
        if self.rest is None:
            return False
        row, column = (np.array([part]) for part in self.rest)
        return self.moving is None or not self.moving.blocked(step, row, column)[STANDING].any()


class StageFrame:
    """Values of the previous stage at all nodes whose values later stages use.

    Without cost and blocked moves, the maximum over a node's 21 predecessors is a disc-shaped max
    filter: five maxima along rows and columns. At other nodes, predecessors are compared singly.
    """

    def __init__(self, moves: MoveValues, windows: list[Window]) -> None:
        self._moves = moves
        self._windows = windows
        self._top, self._left = windows[-1][0].start - REACH, windows[-1][1].start - REACH
        height, width = window_shape(windows[-1])
        self._value = np.full((height + 2 * REACH, width + 2 * REACH), -np.inf)
        self._listed: Indices | None = None
        self._list_nodes()

    def clear(self) -> None:
        """Reset all values."""
        self._value.fill(-np.inf)

    def put(self, window: Window, value: Floats) -> None:
        """Set the values of the previous stage in a window."""
        self._value[self._at(window)] = value

    def arriving(self, stage: int) -> Floats:
        """Return the best arrival value at each node in the window of `stage`."""
        window = self._windows[stage]
        rows, columns = self._at(window)
        around = self._value[
            rows.start - REACH : rows.stop + REACH, columns.start - REACH : columns.stop + REACH
        ]
        best = np.full(window_shape(window), -np.inf)
        if self._moves.are_free:
            best = _largest_in_disc(around)
        count = self._listed_by_stage[stage]
        rows, columns = self._nodes
        sources = self._value.reshape(-1).take(self._sources[:, :count])
        sources += self._gain[:, :count]
        best[rows[:count] - window[0].start, columns[:count] - window[1].start] = sources.max(
            axis=0, initial=-np.inf
        )
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

    def _pass_by(self, moving: MovingMoves, stage: int, best: Floats) -> None:
        """Recompute the values of nodes to which a moving disc blocks some moves."""
        window = self._windows[stage]
        rows, columns, blocked = moving.hindered(stage, *without_margin(window))
        rows, columns = rows + REACH, columns + REACH
        arriving = self._value.reshape(-1).take(self._sources_of(rows, columns))
        arriving += self._moves.gain(rows, columns)
        arriving[blocked] = -np.inf
        best[rows - window[0].start, columns - window[1].start] = arriving.max(axis=0)

    def _list_nodes(self) -> None:
        """Store the nodes whose predecessors are compared singly, ordered by their first stage."""
        widest, first, table = self._windows[-1], self._windows[0], self._moves.table
        listed = table.hindered if self._moves.are_free else table.lattice.free
        rows, columns = np.nonzero(listed[without_margin(widest)])
        rows, columns = rows + widest[0].start, columns + widest[1].start
        up = np.maximum(first[0].start - rows, rows - first[0].stop + 1)
        sideways = np.maximum(first[1].start - columns, columns - first[1].stop + 1)
        stage = (np.maximum(np.maximum(up, sideways), 0) + REACH - 1) // REACH
        order = np.argsort(stage.astype(np.int16), kind="stable")
        rows, columns = rows[order], columns[order]
        stages = np.arange(len(self._windows))
        self._listed_by_stage = np.searchsorted(stage[order], stages, side="right")
        self._nodes = rows, columns
        self._gain = self._moves.gain(rows, columns)
        self._sources = self._sources_of(rows, columns)

    def _sources_of(self, rows: Indices, columns: Indices) -> Indices:
        """Return flat indices (21, n) of the nodes from which the moves reach nodes (n,)."""
        width = self._value.shape[1]
        end = (rows - self._top) * width + columns - self._left
        return end - (MOVES[:, 1:] * width + MOVES[:, :1])

    def gain(self, row: int, column: int) -> list[float]:
        """Return value minus surcharge of each move to the node at a padded row and column."""
        if self._moves.are_free:
            return self._moves.gain(np.array([row]), np.array([column]))[:, 0].tolist()
        if self._listed is None:
            self._listed = np.zeros(self._value.shape, dtype=np.intp)
            rows, columns = self._nodes
            self._listed[rows - self._top, columns - self._left] = np.arange(len(rows))
        return self._gain[:, self._listed[row - self._top, column - self._left]].tolist()

    def _at(self, window: Window) -> Window:
        """Return the slices of the stored values that belong to a window."""
        rows, columns = window
        return (
            slice(rows.start - self._top, rows.stop - self._top),
            slice(columns.start - self._left, columns.stop - self._left),
        )


def _largest_in_disc(around: Floats) -> Floats:
    """Return, for each node, the maximum over its neighbours with dx^2 + dy^2 <= 5."""
    # `around` (h + 4, w + 4) is two nodes wider on each side than the result (h, w).
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
    """Result of a lattice search: the best value of every node at every stage."""

    moves: MoveValues  # Moves of the search
    # Values of each stage's window; windows grow by `REACH` nodes on each side per stage
    values: tuple[Floats, ...]
    windows: tuple[Window, ...]  # Windows in the lattice with its margin
    # Value minus surcharge of each move to a node of the last window, indexed with margin
    gain: Callable[[int, int], list[float]]

    def best_path(self, cost: Floats | float = 0.0) -> Indices | None:
        """Return the nodes (N, 2) of the path with largest value minus `cost`; None if blocked."""
        total = self.values[-1] - cost
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(total)), total.shape))
        if not np.isfinite(total[row, column]):
            return None
        rows, columns = without_margin(self.windows[-1])
        nodes = [(row + rows.start, column + columns.start)]
        for stage in range(len(self.values) - 2, -1, -1):
            nodes.append(self._best_source(stage, nodes[-1]))
        return np.array(nodes[::-1], dtype=np.intp)

    def _best_source(self, stage: int, node: Node) -> Node:
        """Return the predecessor (iy, ix) that gave a node its best value."""
        # A scalar loop over the 21 moves is several times faster than arrays.
        moves, (rows, columns), value = self.moves, self.windows[stage], self.values[stage]
        row, column = node[0] + REACH, node[1] + REACH
        gain = self.gain(row, column)
        if moves.moving is not None:
            blocked = moves.moving.blocked(stage + 1, *np.array(node).reshape(2, 1))[:, 0]
            gain = np.where(blocked, -np.inf, gain).tolist()
        if node == moves.rest and moves.rests(stage + 1):
            gain[STANDING] = 0.0
        height, width = value.shape
        best, source = -np.inf, node
        for move, (dx, dy) in enumerate(MOVES_BY_NUMBER):
            at, sideways = row - dy - rows.start, column - dx - columns.start
            if 0 <= at < height and 0 <= sideways < width:
                arriving = value.item(at, sideways) + gain[move]
                if arriving > best:
                    best, source = arriving, (node[0] - dy, node[1] - dx)
        return source


class LatticeSearch:
    """Lattice search from one position, for any number of reward functions."""

    def __init__(
        self, moves: MoveValues, first: Indices, first_value: Floats, horizon: int
    ) -> None:
        # Shapes: first (n, 2), end nodes (iy, ix) of the first step, n > 0; first_value (n,), value
        # of the first step to each node.
        shape = moves.table.lattice.shape
        low, high = first.min(axis=0), first.max(axis=0)
        self._moves, self._first, self._first_value = moves, first, first_value
        self._windows = [window_around(low, high, k * REACH, shape) for k in range(horizon)]
        self._frame = StageFrame(moves, self._windows)

    def __call__(self, reward: StageReward) -> LatticeValues:
        """Return the best value of every node that is reachable within N steps."""
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
        return LatticeValues(self._moves, tuple(values), tuple(windows), frame.gain)


def search_cheapest(
    road_map: RoadMap,
    table: MoveTable,
    first_nodes: Indices,
    first_length_m: Floats,
    horizon: int,
    step_s: float,
    effort_weight_s2_m2: float,
    goal_node: int,
    node_penalty_s: Floats,  # (n,) or (N, n)
    terminal_cost_s: Floats,  # (n,) cost of the last node
    surcharge_s_m: Floats | None = None,  # (n + 1,) per metre at nodes and robot
    moving: MovingDiscs | None = None,
) -> Indices | None:
    """Return the nodes (N,) of the cheapest path, or None; waiting at the goal costs nothing."""
    if first_nodes.size == 0:
        return None
    rows, columns, number = road_map.rows, road_map.columns, road_map.number
    half = None if surcharge_s_m is None else 0.5 * surcharge_s_m
    cost = step_cost_s(first_length_m, step_s, effort_weight_s2_m2)
    if half is not None:
        cost = cost + first_length_m * (half[first_nodes] + half[-1])
    moves = MoveValues(
        table,
        -step_cost_s(road_map.lengths_m, step_s, effort_weight_s2_m2),
        None if half is None else road_map.lengths_m,
        half,
        (int(rows[goal_node]), int(columns[goal_node])) if goal_node >= 0 else None,
        MovingMoves(road_map.lattice, moving) if moving is not None and len(moving) else None,
    )
    # Blocked nodes have value minus infinity, so the last entries do not matter.
    penalties = np.atleast_2d(node_penalty_s)
    first = np.stack([rows[first_nodes], columns[first_nodes]], axis=1)
    found = LatticeSearch(moves, first, -cost, horizon)(
        lambda stage, window: -penalties[min(stage, len(penalties)) - 1][number[window]]
    )
    terminal = terminal_cost_s[number[without_margin(found.windows[-1])]]
    path = found.best_path(terminal)
    return None if path is None else number[path[:, 0], path[:, 1]]
