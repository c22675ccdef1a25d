"""Occupancy grids, and the polygons of what is closed in them, with the exact edges of the cells.

Cells that share an edge are one obstacle, within squares of `TILE_CELLS` cells a side: with walls
that run through a whole building each distance would be one to thousands of corners. Obstacles meet
along the sides of these squares, and single cells at their corners; no robot passes there, since it
would touch both.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from planopt.errors import InputError
from planopt.short_repr import short_repr
from planopt.world.workspace import Obstacle

UnknownCells = Literal["occupied", "free"]
"""What cells of which the grid knows nothing are taken for."""

MOST_CELLS = 16_000_000
"""Cells of a grid: 200 x 200 m at 5 cm."""

MOST_EDGES = 2_000_000
"""Sides of cells on the outlines of obstacles. A map of a building has some tens of thousands."""


TILE_CELLS = 32
"""Side of the squares that obstacles are cut along."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """An occupancy grid: a map of square cells.

    Attributes
    ----------
    occupied, unknown
        ``(ny, nx)`` which cells are known to be occupied, and of which nothing is known; row 0 at
        the smallest y. All others are free.
    resolution_m
        Side of a cell.
    origin_m
        ``(x, y)`` of the corner of cell [0, 0] with the smallest coordinates.
    grey_free_cells
        Number of free cells whose pixel has the grey 205 of unknown cells.
    """

    occupied: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    resolution_m: float
    origin_m: tuple[float, float]
    grey_free_cells: int = 0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for key in ("occupied", "unknown"):
            cells = np.asarray(getattr(self, key))
            if cells.dtype.kind != "b" or cells.ndim != 2:
                raise InputError(
                    f"has the shape {cells.shape} and the type {cells.dtype}",
                    key=key,
                    remedy="give an array of bool (ny, nx), such as probabilities > 0.65",
                )
            object.__setattr__(self, key, cells)
        if self.unknown.shape != self.occupied.shape:
            raise InputError(
                f"has the shape {self.unknown.shape}, occupied has {self.occupied.shape}",
                key="unknown",
                remedy="give one for each cell; numpy.zeros_like(occupied) if all are known",
            )
        try:
            numbers = np.array([self.resolution_m, *self.origin_m], dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.full(3, np.nan)
        if numbers.shape != (3,) or not (np.isfinite(numbers).all() and numbers[0] > 0.0):
            raise InputError(
                f"resolution_m is {self.resolution_m!r}, origin_m is {self.origin_m!r}",
                key="world.obstacles",
                remedy="give metres: the side of a cell above 0, and the corner (x, y)",
            )


def grid_obstacles(
    grid: OccupancyGrid, name: str, unknown: UnknownCells = "occupied"
) -> tuple[Obstacle, ...]:
    """Return the obstacles of a grid: all cells that are closed to robots, and no place beside."""
    closed = grid.occupied | grid.unknown if unknown == "occupied" else grid.occupied
    if not closed.any():
        return ()
    polygons = _polygons(closed, grid.resolution_m, np.array(grid.origin_m))
    return tuple(
        Obstacle(name if len(polygons) == 1 else f"{name} {number}", polygon)
        for number, polygon in enumerate(polygons, start=1)
    )


@dataclass(frozen=True)
class _Edges:
    """Edges between a component and what is beside it, each with its closed cell on its left."""

    end: NDArray[np.intp]  # (e, 2) column and row of the corner that each ends at
    label: NDArray[np.intp]  # (e,) which component its closed cell belongs to, from 1 on
    following: NDArray[np.intp]  # (e,) the next edge along the outline
    turns: NDArray[np.bool_]  # (e,) whether that has another direction


def _edges(closed: NDArray[np.bool_]) -> _Edges:
    """Return all edges of the outlines.

    At a corner where two closed cells touch, the outline stays with its cell if the other is of
    another component; else it goes on along the other, so that no outline meets itself.
    """
    labels = _components(closed)
    around = np.pad(labels, 1)
    columns = closed.shape[1] + 1
    sides: list[tuple[NDArray[np.intp], ...]] = []
    # Directions 0 to 3 are right, up, left and down: below, right of, above and left of the cell.
    for direction, (beside, start, end) in enumerate(
        (
            (around[:-2, 1:-1], (0, 0), (0, 1)),
            (around[1:-1, 2:], (0, 1), (1, 1)),
            (around[2:, 1:-1], (1, 1), (1, 0)),
            (around[1:-1, :-2], (1, 0), (0, 0)),
        )
    ):
        row, column = np.nonzero(closed & (labels != beside))
        sides.append(
            (
                (row + start[0]) * columns + column + start[1],
                (row + end[0]) * columns + column + end[1],
                np.full(row.size, direction, dtype=np.intp),
                labels[row, column],
            )
        )
    start, end, direction, owner = (np.concatenate(side) for side in zip(*sides, strict=True))
    if start.size > MOST_EDGES:
        raise InputError(
            f"the outlines of obstacles have {start.size:,} edges, more than the limit of "
            f"{MOST_EDGES:,}",
            remedy="remove single cells from the map, or use larger cells",
        )
    key = 4 * start + direction
    by_key = np.argsort(key)
    left, ahead, right = (
        _found(key, by_key, 4 * end + (direction + turn) % 4) for turn in (1, 0, 3)
    )
    following = np.where(left >= 0, left, np.where(ahead >= 0, ahead, right))
    pinched = (left >= 0) & (right >= 0)
    pinched[pinched] = owner[right[pinched]] == owner[pinched]
    following[pinched] = right[pinched]
    place = np.column_stack([end % columns, end // columns])
    return _Edges(place, owner, following, direction[following] != direction)


def _found(
    key: NDArray[np.intp], by_key: NDArray[np.intp], wanted: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Return where each wanted key stands among the keys, -1 for those that do not."""
    at = by_key[np.minimum(np.searchsorted(key, wanted, sorter=by_key), key.size - 1)]
    return np.where(key[at] == wanted, at, -1)


def _components(closed: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return which component each cell belongs to, from 1 on; 0 for open cells."""
    ny, nx = closed.shape
    # An open line between all squares, for the time of labelling.
    row, column = _spread(ny), _spread(nx)
    apart = np.zeros((row[-1] + 1, column[-1] + 1), dtype=np.bool_)
    apart[np.ix_(row, column)] = closed
    labels = np.zeros(apart.shape, dtype=np.intp)
    ndimage.label(apart, output=labels)  # pyright: ignore[reportUnknownMemberType]
    return labels[np.ix_(row, column)]


def _spread(size: int) -> NDArray[np.intp]:
    """Return where each of so many lines comes to lie, with an empty one between squares."""
    line = np.arange(size, dtype=np.intp)
    return line + line // TILE_CELLS


def _polygons(
    closed: NDArray[np.bool_], resolution_m: float, origin_m: NDArray[np.float64]
) -> NDArray[np.object_]:
    """Return a polygon for each component, corners where its outline turns, holes included."""
    edges = _edges(closed)
    order, first = _outlines(edges)
    corners = edges.end[order]
    ring = np.repeat(np.arange(first.size), np.diff(np.append(first, order.size)))
    following = np.arange(1, order.size + 1)
    following[np.append(first[1:], order.size) - 1] = first
    across = corners[:, 0] * corners[following, 1] - corners[following, 0] * corners[:, 1]
    # Whole numbers, so that signs are exact: outlines turn left, holes right.
    outer = np.bincount(ring, across) > 0.0
    component = edges.label[order[first]]
    rings = cast(
        "NDArray[np.object_]",
        shapely.linearrings(origin_m + resolution_m * corners, indices=ring),
    )
    shells = rings[outer][np.argsort(component[outer])]
    polygons = cast("NDArray[np.object_]", shapely.polygons(shells))
    inner, of = rings[~outer], component[~outer] - 1
    by_component = np.argsort(of, kind="stable")
    bounds = np.flatnonzero(np.diff(of[by_component], prepend=-1, append=-1))
    for begin, stop in itertools.pairwise(bounds):
        holes = by_component[begin:stop]
        polygons[of[holes[0]]] = shapely.polygons(shells[of[holes[0]]], inner[holes])
    return polygons


def _outlines(edges: _Edges) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the edges before turns, outline after outline, and where each outline begins."""
    turning = edges.following.copy()
    while (straight := ~edges.turns[turning]).any():
        # Each round doubles how far straight edges see ahead.
        turning[straight] = turning[turning[straight]]
    after: list[int] = turning.tolist()
    done = bytearray(turning.size)
    order: list[int] = []
    first: list[int] = []
    for edge in np.flatnonzero(edges.turns).tolist():
        if not done[edge]:
            first.append(len(order))
        while not done[edge]:
            done[edge] = 1
            order.append(edge)
            edge = after[edge]
    return np.array(order, dtype=np.intp), np.array(first, dtype=np.intp)
