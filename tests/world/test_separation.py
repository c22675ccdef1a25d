"""Separating lines from pieces of obstacles and from moving discs."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt import Obstacle, Workspace
from planopt.world import (
    MovingDiscs,
    PackedPieces,
    SeparatingLines,
    closest_approach_m,
    convex_pieces,
    joined_discs,
    lines_for,
    moving_lines,
    pack_pieces,
    passing_gaps_m,
    path_distances_m,
    paths_gap_m,
    separating_lines,
)

Array = NDArray[np.float64]
FAR = np.array([7e5, 5.3e6])


def world(*polygons: shapely.Polygon) -> Workspace:
    """A workspace of these obstacles; its bounds play no part here."""
    named = tuple(Obstacle(str(number), polygon) for number, polygon in enumerate(polygons))
    return Workspace((0.0, 0.0, 1.0, 1.0), named)


def random_pieces(rng: np.random.Generator, number: int, offset: Array) -> PackedPieces:
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
    """Lines from a square that can be read off a drawing, in both directions of the segment."""
    pieces = pack_pieces(world(SQUARE))
    starts, ends = np.array([start, end], dtype=float), np.array([end, start], dtype=float)
    lines = separating_lines(pieces, starts, ends, 1, 10.0)
    assert_lines_separate(pieces, lines, starts, ends)
    np.testing.assert_allclose(lines.gaps, [[gap], [gap]], atol=1e-12)
    if normal is not None:
        np.testing.assert_allclose(lines.normals, [[normal], [normal]], atol=1e-12)
        np.testing.assert_allclose(lines.offsets, [[offset], [offset]], atol=1e-12)


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


def test_cuts_into_convex_pieces() -> None:
    """One reflex corner needs one cut, and rounding is no reflex corner."""
    plain = shapely.Polygon([(0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)])
    written = shapely.Polygon(
        [(0, 0), (1, 0), (2, 0), (2, 0), (2, 1), (1, 1), (1, 1), (1, 2), (1, 3), (0, 3), (0, 1)]
    )
    assert len(convex_pieces(plain)) == 2
    assert_exact_cover(written, convex_pieces(written))
    assert len(convex_pieces(written)) <= 3
    ring = [(0, 0), (1, 1e-10), (2, 0), (2, 1), (0, 1)]
    (piece,) = convex_pieces(shapely.Polygon(ring))
    assert len(piece) == 4


STEPS = 6


def random_discs(generator, count):
    """Discs on random walks, some with their own minimum distance."""
    centres = np.cumsum(generator.normal(size=(count, STEPS + 1, 2)), axis=1) * 2.0
    return MovingDiscs(
        tuple(f"m{k}" for k in range(count)),
        centres,
        generator.uniform(0.1, 1.0, (count, STEPS)),
        generator.uniform(0.2, 1.5, count),
        generator.random(count) < 0.5,
    )


@pytest.mark.parametrize("seed", range(8))
def test_both_rows_keep_the_distance(seed):
    """Random segments that keep the rows keep the distance; the start path keeps its own gap."""
    generator = np.random.default_rng(seed)
    discs = random_discs(generator, 3)
    path = np.cumsum(generator.normal(size=(STEPS + 1, 2)), axis=0)
    clearance = 0.4
    lines = moving_lines(discs, path, clearance, 3, np.inf)
    near = path_distances_m(discs, path)
    kept = 0
    for k in range(STEPS):
        for j in range(3):
            disc, n = lines.piece[k, j], lines.normals[k, j]
            assert np.linalg.norm(n) == pytest.approx(1.0)
            gap = near[disc, k] - discs.apart_m[disc, k] + clearance
            assert lines.gaps[k, j] == pytest.approx(gap)
            assert n @ path[k] - lines.start_offsets[k, j] >= gap - 1e-9
            assert n @ path[k + 1] - lines.offsets[k, j] >= gap - 1e-9
            begins, ends = generator.normal(scale=6.0, size=(2, 400, 2))
            keeps = (begins @ n - lines.start_offsets[k, j] >= clearance) & (
                ends @ n - lines.offsets[k, j] >= clearance
            )
            kept += int(keeps.sum())
            gaps = passing_gaps_m(discs, k, begins[keeps], ends[keeps])[disc]
            assert (gaps >= -1e-9).all()
    assert kept > 100


def test_nearest_discs_have_the_lines():
    """Far discs get none, needed ones always, and a path through the centre one across it."""
    generator = np.random.default_rng(1)
    discs = random_discs(generator, 6)
    path = np.cumsum(generator.normal(size=(STEPS + 1, 2)), axis=0)
    gaps = path_distances_m(discs, path) - discs.apart_m
    lines = moving_lines(discs, path, 0.0, 2, np.inf)
    assert (np.sort(np.argsort(gaps, axis=0)[:2].T) == np.sort(lines.piece)).all()
    none = moving_lines(discs, path, 0.0, 2, -100.0)
    assert (none.piece == -1).all()
    assert np.isinf(none.gaps).all()
    worst = np.zeros(gaps.shape, dtype=bool)
    worst[gaps.argmax(axis=0), np.arange(STEPS)] = True
    needed = moving_lines(discs, path, 0.0, 2, -100.0, worst)
    assert (needed.piece[:, 0] == gaps.argmax(axis=0)).all()
    centres = np.zeros((1, 2, 2))
    one, flag = np.ones((1, 1)), np.zeros(1, dtype=bool)
    disc = MovingDiscs(("m",), centres, one, np.zeros(1), flag)
    through = moving_lines(disc, np.array([[-1.0, 0.0], [1.0, 0.0]]), 0.0, 1, np.inf)
    assert abs(through.normals[0, 0, 1]) == 1.0
    assert through.gaps[0, 0] == -1.0
    shared = moving_lines(disc, np.zeros((2, 2)), 0.0, 1, np.inf)
    assert np.linalg.norm(shared.normals[0, 0]) == 1.0


def test_many_paths_at_once():
    """The least gap of a path is the least over discs and steps, one by one."""
    generator = np.random.default_rng(3)
    discs = joined_discs(random_discs(generator, 2), random_discs(generator, 2))
    ways = np.cumsum(generator.normal(size=(5, STEPS + 1, 2)), axis=1)
    expected = [
        min(
            float(closest_approach_m(way[k], way[k + 1], c[k], c[k + 1])) - discs.apart_m[number, k]
            for number, c in enumerate(discs.centres_m)
            for k in range(STEPS)
        )
        for way in ways
    ]
    np.testing.assert_allclose(paths_gap_m(discs, ways), expected)
