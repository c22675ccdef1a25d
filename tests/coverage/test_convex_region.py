"""What is accepted as a region, and what is said of the rest."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from planopt.coverage.voronoi import ConvexRegion, convex_region
from planopt.errors import InputError

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])


def test_corners_of_either_order_and_flat_ones() -> None:
    """Clockwise corners, repeated and collinear ones give the same region."""
    wordy = np.array([[0, 0], [2, 0], [4, 0], [4, 3], [4, 3], [0, 3], [0, 1.5]])[::-1]
    plain, same = convex_region(SQUARE), convex_region(wordy)
    assert {tuple(c) for c in same.corners_m} == {tuple(c) for c in plain.corners_m}
    assert same.area_m2 == pytest.approx(12.0)


def test_half_planes(hexagon: ConvexRegion) -> None:
    """The half-planes hold what shapely says the polygon covers."""
    generator = np.random.default_rng(0)
    places = hexagon.centre_m + 80.0 * generator.uniform(-1.0, 1.0, (500, 2))
    polygon = shapely.Polygon(hexagon.corners_m)
    assert 100 < hexagon.contains(places).sum() < 400
    assert (hexagon.contains(places) == shapely.covers(polygon, shapely.points(places))).all()
    assert hexagon.contains(hexagon.corners_m).all()


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        (np.array([[0, 0], [1, 1], [1, 0], [0, 1.0]]), "not simple"),
        (np.array([[0, 0], [4, 0], [1, 1], [0, 4.0]]), "not convex"),
        (np.array([[0, 0], [1, 1], [2, 2.0]]), "no"),
        (np.array([[0, 0], [1, np.nan], [2, 2.0]]), "not finite"),
        (np.array([[0, 0], [1, 0.0]]), "not a polygon"),
        (np.zeros((4, 3)), "not a polygon"),
        (shapely.Polygon(), "not a polygon"),
        (shapely.box(0, 0, 4, 4).difference(shapely.box(1, 1, 2, 2)), "has holes"),
    ],
)
def test_what_is_no_region(outline: shapely.Polygon | NDArray[np.float64], words: str) -> None:
    """Every fault of an outline gets its message and the key."""
    with pytest.raises(InputError, match=words) as caught:
        convex_region(outline)
    assert caught.value.key == "world.outline_m"


def test_corners_turn_left(hexagon: ConvexRegion) -> None:
    """Corners are counter-clockwise, whatever order they were given in."""
    for region in (hexagon, convex_region(hexagon.corners_m[::-1])):
        x, y = (region.corners_m - region.centre_m).T
        assert 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() == pytest.approx(
            region.area_m2
        )
