import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt.world.separation import convex_pieces
from planopt.world.workspace import Workspace


@st.composite
def star_polygons(draw: st.DrawFn) -> shapely.Polygon:
    """Random star polygons, some with a star-shaped hole, some far from the origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    corners = draw(st.integers(3, 25))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.8, corners)) / corners
    ring = rng.uniform(3, 20, corners)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    hole = rng.uniform(0.1, 0.4) * ring[:: draw(st.integers(1, 2))]
    centre = np.array(draw(st.sampled_from([(0.0, 0.0), (7e5, 5.3e6)])))
    with_hole = draw(st.booleans()) and len(hole) >= 3
    polygon = shapely.Polygon(ring + centre, [hole + centre] if with_hole else [])
    return polygon if polygon.is_valid else shapely.Polygon(ring + centre).convex_hull


def turns(piece: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products at the corners: all positive for a convex counter-clockwise ring."""
    before = np.roll(piece, 1, axis=0) - piece
    after = np.roll(piece, -1, axis=0) - piece
    return after[:, 0] * before[:, 1] - after[:, 1] * before[:, 0]


def assert_exact_cover(polygon: shapely.Polygon, pieces: tuple[NDArray[np.float64], ...]) -> None:
    """Pieces are strictly convex, do not overlap, and cover the polygon and nothing else."""
    parts = [shapely.Polygon(piece) for piece in pieces]
    assert all((turns(piece) > 0).all() for piece in pieces)
    assert sum(part.area for part in parts) == pytest.approx(polygon.area, rel=1e-9)
    union = shapely.union_all(parts, grid_size=0)
    assert shapely.symmetric_difference(union, polygon).area <= 1e-8 * polygon.length
    assert {tuple(corner) for piece in pieces for corner in piece} <= set(
        map(tuple, shapely.get_coordinates(polygon))
    )


@settings(deadline=None)
@given(star_polygons())
def test_pieces_are_exactly_the_polygon(polygon: shapely.Polygon) -> None:
    """Convex, disjoint, same union, and no new corners, for random stars with and without holes."""
    assert_exact_cover(polygon, convex_pieces(polygon))


def test_munich_footprints(munich: Workspace) -> None:
    """All 742 footprints are covered exactly, half of them by themselves."""
    pieces = [convex_pieces(obstacle.polygon) for obstacle in munich.obstacles]
    for obstacle, cut in zip(munich.obstacles, pieces, strict=True):
        assert_exact_cover(obstacle.polygon, cut)
        if obstacle.polygon.equals(obstacle.polygon.convex_hull):
            assert len(cut) == 1
    assert sum(map(len, pieces)) < 1800  # the triangles are 3737


@pytest.mark.parametrize(
    "ring",
    [
        [(0, 0), (2, 0), (2, 1), (0, 1)],
        [(0, 0), (0, 1), (2, 1), (2, 0)],
        [(0, 0), (1, 0), (1, 0), (2, 0), (2, 0.5), (2, 1), (2, 1), (0, 1), (0, 0.25)],
    ],
)
def test_convex_is_one_piece(ring: list[tuple[float, float]]) -> None:
    """A rectangle is one piece with four corners, however it is written."""
    (piece,) = convex_pieces(shapely.Polygon(ring))
    assert {tuple(corner) for corner in piece} == {(0, 0), (2, 0), (2, 1), (0, 1)}
    assert (turns(piece) > 0).all()


def test_letter_l_is_two_pieces() -> None:
    """One reflex corner needs one cut, also with repeated and collinear corners."""
    plain = shapely.Polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)])
    written = shapely.Polygon(
        [(0, 0), (1, 0), (2, 0), (2, 0), (2, 1), (1, 1), (1, 1), (1, 2), (1, 3), (0, 3), (0, 1)]
    )
    assert len(convex_pieces(plain)) == 2
    assert_exact_cover(written, convex_pieces(written))
    assert len(convex_pieces(written)) <= 3


def test_frame_with_touching_hole() -> None:
    """A frame is cut around its hole; the hole may touch the outline."""
    outline = [(0, 0), (9, 0), (9, 9), (0, 9)]
    frame = shapely.Polygon(outline, [[(3, 3), (6, 3), (6, 6), (3, 6)]])
    assert_exact_cover(frame, convex_pieces(frame))
    assert len(convex_pieces(frame)) <= 6
    touching = shapely.Polygon(outline, [[(0, 0), (6, 3), (3, 6)]])
    assert touching.is_valid
    assert_exact_cover(touching, convex_pieces(touching))


def test_rounding_is_not_a_reflex_corner() -> None:
    """A corner that rounding put a tenth of a nanometre inside its side costs no extra piece."""
    ring = [(0, 0), (1, 1e-10), (2, 0), (2, 1), (0, 1)]
    (piece,) = convex_pieces(shapely.Polygon(ring))
    assert len(piece) == 4
