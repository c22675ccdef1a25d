import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt.world.separation import (
    PackedPieces,
    SeparatingLines,
    lines_for,
    pack_pieces,
    separating_lines,
)
from planopt.world.workspace import Obstacle, Workspace

Array = NDArray[np.float64]
FAR = np.array([7e5, 5.3e6])


def world(*polygons: shapely.Polygon) -> Workspace:
    """A workspace of these obstacles; its bounds play no part here."""
    named = tuple(Obstacle(str(number), polygon) for number, polygon in enumerate(polygons))
    return Workspace((0.0, 0.0, 1.0, 1.0), named)


def random_pieces(rng: np.random.Generator, number: int, offset: Array) -> PackedPieces:
    """Convex hulls of random points."""
    hulls = [
        shapely.MultiPoint(
            offset + rng.uniform(-30, 30, 2) + rng.uniform(-4, 4, (int(rng.integers(3, 12)), 2))
        ).convex_hull
        for _ in range(number)
    ]
    return pack_pieces(world(*hulls))


def signed_distance(piece: Array, start: Array, end: Array) -> float:
    """Distance by GEOS; for an overlap, minus the depth of the Minkowski difference at 0."""
    way = shapely.LineString([start, end])
    polygon = shapely.Polygon(piece)
    if not way.intersects(polygon):
        return float(shapely.distance(way, polygon))
    differences = [corner - place for corner in piece for place in (start, end)]
    hull = shapely.MultiPoint(differences).convex_hull
    return -float(hull.exterior.distance(shapely.Point(0, 0)))


def assert_lines_separate(
    pieces: PackedPieces, lines: SeparatingLines, starts: Array, ends: Array
) -> None:
    """The promised inequalities hold and the gaps are the signed distances."""
    for s, c in np.argwhere(lines.piece >= 0):
        number = lines.piece[s, c]
        piece = pieces.vertices_m[number, : pieces.corners[number]]
        normal, offset, gap = lines.normals[s, c], lines.offsets[s, c], lines.gaps[s, c]
        scale = max(1.0, float(np.abs(piece).max())) * 1e-14
        assert np.hypot(*normal) == pytest.approx(1.0, abs=1e-12)
        assert (piece @ normal <= offset + 10 * scale).all()
        assert min(starts[s] @ normal, ends[s] @ normal) - offset >= gap - 10 * scale
        assert gap == pytest.approx(signed_distance(piece, starts[s], ends[s]), abs=1e-9)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.5, 40.0]), st.booleans())
def test_gaps_and_inequalities(seed: int, length: float, far: bool) -> None:
    """Random pieces and segments, disjoint or not, at the origin and at map coordinates."""
    rng = np.random.default_rng(seed)
    offset = FAR if far else np.zeros(2)
    pieces = random_pieces(rng, 6, offset)
    starts = offset + rng.uniform(-35, 35, (5, 2))
    ends = starts + length * rng.uniform(-1, 1, (5, 2))
    everything = np.tile(np.arange(6), (5, 1))
    lines = lines_for(pieces, starts, ends, everything)
    np.testing.assert_array_equal(lines.piece, everything)
    assert_lines_separate(pieces, lines, starts, ends)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.floats(0.5, 60))
def test_nearest_pieces_are_taken(seed: int, count: int, reach_m: float) -> None:
    """The slots hold the nearest pieces within reach, nearest first, by brute force."""
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12, np.zeros(2))
    starts = rng.uniform(-35, 35, (4, 2))
    ends = starts + rng.uniform(-9, 9, (4, 2))
    lines = separating_lines(pieces, starts, ends, count, reach_m)
    assert_lines_separate(pieces, lines, starts, ends)
    for s in range(4):
        rings = (pieces.vertices_m[k, :m] for k, m in enumerate(pieces.corners))
        distances = np.array([signed_distance(ring, starts[s], ends[s]) for ring in rings])
        order = [k for k in np.argsort(distances) if distances[k] <= reach_m][:count]
        assert lines.piece[s].tolist() == order + [-1] * (count - len(order))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_empty_slots_constrain_nothing(seed: int) -> None:
    """An empty slot is a row that any place fulfils."""
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 3, np.zeros(2))
    starts, ends = rng.uniform(-35, 35, (2, 4, 2))
    for lines in (
        separating_lines(pieces, starts, ends, 5, 10.0),
        separating_lines(pack_pieces(world()), starts, ends, 2, 10.0),
        lines_for(pieces, starts, ends, np.full((4, 2), -1)),
    ):
        empty = lines.piece == -1
        assert empty.any()
        assert (lines.normals[empty] == 0).all()
        assert (lines.offsets[empty] == -1).all()
        assert np.isposinf(lines.gaps[empty]).all()


SQUARE = shapely.box(0, 0, 2, 2)


@pytest.mark.parametrize(
    ("start", "end", "normal", "offset", "gap"),
    [
        ((5, 1), (5, 9), (1, 0), 2, 3),  # an edge faces the segment
        ((5, 6), (9, 6), (0.6, 0.8), 2.8, 5),  # two corners are nearest
        ((1, -4), (1, -1), (0, -1), 0, 1),  # the end is nearest
        ((2, 5), (5, 2), (0.5**0.5, 0.5**0.5), 8**0.5, 4.5**0.5),  # the segment faces a corner
        ((2, 3), (2, 1), (1, 0), 2, 0),  # sliding along an edge
        ((3, 3), (2, 2), None, None, 0),  # touching a corner
        ((4, 4), (4, 4), (0.5**0.5, 0.5**0.5), 8**0.5, 8**0.5),  # standing
        ((2, 2), (2, 2), None, None, 0),  # standing on a corner
        ((1, 1.5), (1, 1.5), (0, 1), 2, -0.5),  # standing inside
        ((1.5, -9), (1.5, 9), (1, 0), 2, -0.5),  # driving through
    ],
)
def test_known_lines(
    start: tuple[float, float],
    end: tuple[float, float],
    normal: tuple[float, float] | None,
    offset: float | None,
    gap: float,
) -> None:
    """Lines from a square that can be read off a drawing, both ways along the segment."""
    pieces = pack_pieces(world(SQUARE))
    starts, ends = np.array([start, end], dtype=float), np.array([end, start], dtype=float)
    lines = separating_lines(pieces, starts, ends, 1, 10.0)
    assert_lines_separate(pieces, lines, starts, ends)
    np.testing.assert_allclose(lines.gaps, [[gap], [gap]], atol=1e-12)
    if normal is not None:
        np.testing.assert_allclose(lines.normals, [[normal], [normal]], atol=1e-12)
        np.testing.assert_allclose(lines.offsets, [[offset], [offset]], atol=1e-12)


def test_line_protects_the_whole_segment() -> None:
    """Ends moved anywhere on their side of the line leave the whole way clear by the margin."""
    rng = np.random.default_rng(5)
    pieces = random_pieces(rng, 8, np.zeros(2))
    starts = rng.uniform(-35, 35, (40, 2))
    ends = starts + rng.uniform(-6, 6, (40, 2))
    lines = separating_lines(pieces, starts, ends, 1, 20.0)
    margin = 0.5
    for s in np.flatnonzero((lines.gaps[:, 0] > 0) & (lines.piece[:, 0] >= 0)):
        normal, offset = lines.normals[s, 0], lines.offsets[s, 0]
        moved = starts[s] + rng.normal(0, 8, (2, 2))
        short = np.maximum(margin - (moved @ normal - offset), 0.0)
        moved += short[:, None] * normal
        ring = pieces.vertices_m[lines.piece[s, 0]]
        way = shapely.LineString(moved)
        assert shapely.distance(way, shapely.Polygon(ring)) >= margin - 1e-9


def test_munich_lines(munich: Workspace) -> None:
    """Around Munich the nearest line's gap is the distance to the footprints as they are."""
    pieces = pack_pieces(munich)
    rng = np.random.default_rng(2)
    starts = rng.uniform(-390, 390, (200, 2))
    ends = starts + rng.uniform(-6, 6, (200, 2))
    lines = separating_lines(pieces, starts, ends, 3, 50.0)
    assert_lines_separate(pieces, lines, starts, ends)
    union = shapely.union_all([obstacle.polygon for obstacle in munich.obstacles])
    ways = shapely.linestrings(np.stack((starts, ends), axis=1))
    distance = shapely.distance(ways, union)
    np.testing.assert_allclose(np.maximum(lines.gaps[:, 0], 0.0), distance, atol=1e-9)
    nearest = [munich.obstacles[k].polygon for k in pieces.obstacle[lines.piece[:, 0]]]
    np.testing.assert_allclose(shapely.distance(ways, np.array(nearest)), distance, atol=1e-9)


def test_kept_slots_follow_the_path() -> None:
    """Recomputed for the same pieces, a moved path gets lines in the same slots."""
    pieces = random_pieces(np.random.default_rng(3), 6, np.zeros(2))
    starts, ends = np.array([[0.0, 0.0], [6.0, 0.0]]), np.array([[6.0, 0.0], [9.0, 4.0]])
    lines = separating_lines(pieces, starts, ends, 3, 15.0)
    same = lines_for(pieces, starts, ends, lines.piece)
    np.testing.assert_array_equal(same.normals, lines.normals)
    np.testing.assert_array_equal(same.gaps, lines.gaps)
    moved = lines_for(pieces, starts + 1.0, ends + 1.0, lines.piece)
    np.testing.assert_array_equal(moved.piece, lines.piece)
    assert_lines_separate(pieces, moved, starts + 1.0, ends + 1.0)


def test_no_segments() -> None:
    """No segments, no lines."""
    nothing = np.empty((0, 2))
    lines = separating_lines(pack_pieces(world(SQUARE)), nothing, nothing, 3, 10.0)
    assert lines.gaps.shape == (0, 3)
