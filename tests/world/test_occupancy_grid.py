"""Polygons of occupancy grids: exactly the closed cells, whatever their pattern."""

from __future__ import annotations

import time

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world import occupancy_grid
from planopt.world.occupancy_grid import TILE_CELLS, OccupancyGrid, grid_obstacles

PATTERNS = arrays.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9)))


def grid_of(
    occupied: NDArray[np.bool_], resolution_m: float = 1.0, origin_m: tuple[float, float] = (0, 0)
) -> OccupancyGrid:
    """A grid without unknown cells."""
    return OccupancyGrid(occupied, np.zeros_like(occupied), resolution_m, origin_m)


def polygons_of(occupied: NDArray[np.bool_], **options) -> list[shapely.Polygon]:
    """The polygons of the obstacles."""
    return [obstacle.polygon for obstacle in grid_obstacles(grid_of(occupied, **options), "a")]


def cells_of(occupied: NDArray[np.bool_]) -> shapely.Geometry:
    """All occupied cells, each drawn as a box and joined by GEOS."""
    boxes = [shapely.box(x, y, x + 1, y + 1) for y, x in np.argwhere(occupied)]
    return shapely.union_all(boxes)


@settings(deadline=None)
@given(PATTERNS)
def test_union_is_the_cells(occupied: NDArray[np.bool_]) -> None:
    """Valid polygons that do not overlap and together are the cells, by GEOS's own union."""
    polygons = polygons_of(occupied)
    assert all(shapely.is_valid(polygons))
    assert shapely.area(polygons).sum() == occupied.sum()
    assert shapely.union_all(polygons).equals(cells_of(occupied))
    turns = [shapely.get_num_coordinates(polygon) for polygon in polygons]
    simple = [shapely.get_num_coordinates(shapely.simplify(p, 0.0)) for p in polygons]
    # Simplification keeps the first corner of a ring, so it can only be as short.
    assert turns == simple


@settings(deadline=None)
@given(PATTERNS)
def test_turned_patterns_have_turned_obstacles(occupied: NDArray[np.bool_]) -> None:
    """A quarter of a turn of the grid turns the obstacles."""
    turned = shapely.union_all(polygons_of(np.rot90(occupied)))
    # rot90 with rows upwards turns clockwise about the origin and shifts.
    back = shapely.transform(
        turned, lambda at: np.column_stack([occupied.shape[1] - at[:, 1], at[:, 0]])
    )
    assert back.equals(cells_of(occupied))


@settings(deadline=None)
@given(arrays.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30))))
def test_squares_do_not_change_the_union(occupied: NDArray[np.bool_]) -> None:
    """Cut along squares of four cells, no obstacle leaves its square, and nothing is lost."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(occupancy_grid, "TILE_CELLS", 4)
        polygons = polygons_of(occupied)
    assert all(shapely.is_valid(polygons))
    assert shapely.area(polygons).sum() == occupied.sum()
    for x_min, y_min, x_max, y_max in shapely.bounds(polygons):
        assert x_min // 4 == (x_max - 1) // 4 and y_min // 4 == (y_max - 1) // 4
    assert shapely.union_all(polygons).equals(cells_of(occupied))


def test_place_and_scale() -> None:
    """Row 0 is the smallest y; the origin is the corner of its first cell."""
    occupied = np.zeros((3, 4), dtype=bool)
    occupied[0, 1:3] = True
    (polygon,) = polygons_of(occupied, resolution_m=0.05, origin_m=(-10.0, 7.0))
    assert polygon.equals(shapely.box(-10.0 + 0.05, 7.0, -10.0 + 0.15000000000000002, 7.05))


def test_holes_and_islands_in_them() -> None:
    """A ring of walls has a hole, and what stands in it is another obstacle."""
    occupied = np.ones((7, 7), dtype=bool)
    occupied[1:6, 1:6] = False
    occupied[3, 3] = True
    first, second = sorted(polygons_of(occupied), key=lambda polygon: -polygon.area)
    assert (len(first.interiors), first.area, second.area) == (1, 24.0, 1.0)


def test_unknown_cells_and_names() -> None:
    """Unknown cells are closed or open, as is asked for; several obstacles are numbered."""
    occupied, unknown = np.zeros((2, 5), dtype=bool), np.zeros((2, 5), dtype=bool)
    occupied[0, 0] = unknown[1, 4] = True
    grid = OccupancyGrid(occupied, unknown, 1.0, (0.0, 0.0))
    assert [obstacle.name for obstacle in grid_obstacles(grid, "hall")] == ["hall 1", "hall 2"]
    assert [obstacle.name for obstacle in grid_obstacles(grid, "hall", "free")] == ["hall"]
    assert grid_obstacles(grid_of(np.zeros((3, 3), dtype=bool)), "hall") == ()


def test_too_ragged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pattern of single cells is refused before its polygons are made."""
    monkeypatch.setattr(occupancy_grid, "MOST_EDGES", 100)
    with pytest.raises(InputError, match="200 edges, more than the limit of 100"):
        polygons_of(np.indices((10, 10)).sum(axis=0) % 2 == 0)


def test_a_large_map_takes_seconds() -> None:
    """A thousand by a thousand cells of speckled rooms; CPU time, generously."""
    generator = np.random.default_rng(0)
    occupied = np.zeros((1000, 1000), dtype=bool)
    occupied[::50] = occupied[:, ::50] = True
    occupied |= generator.random(occupied.shape) < 0.02
    begun = time.process_time()
    polygons = polygons_of(occupied)
    assert time.process_time() - begun < 10.0
    assert shapely.area(polygons).sum() == occupied.sum()
    assert len(polygons) > (1000 // TILE_CELLS) ** 2
