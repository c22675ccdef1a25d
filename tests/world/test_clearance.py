import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt import Obstacle, Workspace
from planopt.world import (
    clearance_m,
    containing_obstacle,
    distances_m,
    index_obstacles,
    inside_bounds,
    is_clear,
    segment_clearance_m,
    segment_lines,
    segments_clear,
    swept_clearance_m,
)

BOUNDS = (-10.0, -10.0, 20.0, 20.0)
YARD = shapely.Polygon(
    [(0, 0), (9, 0), (9, 9), (0, 9)], [[(1, 1), (8, 1), (8, 8), (1, 8)]]
)  # a wall around a courtyard
HOOK = shapely.Polygon([(12, 0), (18, 0), (18, 6), (16, 6), (16, 2), (12, 2)])
WORLD = Workspace(BOUNDS, (Obstacle("yard", YARD), Obstacle("hook", HOOK)))
INDEX = index_obstacles(WORLD)
EMPTY = index_obstacles(Workspace(BOUNDS, ()))
places = st.tuples(st.floats(-10, 20), st.floats(-10, 20))


def test_known_distances() -> None:
    """In the courtyard, between arms, inside, on the border; swept, and past a thin wall."""
    positions = np.array([[4.5, 4.5], [14, 5], [0.5, 0.5], [0, 3], [-3, -4], [1.25, 2]])
    np.testing.assert_allclose(clearance_m(INDEX, positions), [3.5, 2, 0, 0, 5, 0.25])
    path = np.array([[2, 2], [7, 2], [7, 7], [15, 7], [15, 4], [15, 4], [13, 9]])
    np.testing.assert_allclose(
        swept_clearance_m(INDEX, path), [1, 1, 0, 1, 1, np.hypot(*(path[5] - (16, 4)))]
    )
    wall = shapely.Polygon([(0, -5), (0.001, -5), (0.001, 5), (0, 5)])
    index = index_obstacles(Workspace(BOUNDS, (Obstacle("wall", wall),)))
    path = np.array([[-3.0, 0.0], [3.0, 0.1]])
    assert clearance_m(index, path).min() > 2.9
    np.testing.assert_array_equal(swept_clearance_m(index, path), [0.0])


@pytest.mark.parametrize("wanted", [0.0, 0.3, 1.0, 2.5])
def test_segments_clear_as_their_distances(wanted: float) -> None:
    """Random segments, standing ones, touching ones, at the very distance, and not finite ones."""
    rng = np.random.default_rng(5)
    starts = rng.uniform(-10.0, 20.0, (400, 2))
    ends = starts + rng.normal(size=(400, 2)) * 3.0
    ends[:40] = starts[:40]
    ends[40:44] = [[np.nan, 0.0], [np.inf, 0.0], [0.0, -np.inf], [np.nan, np.nan]]
    # Beside the yard's lower border, at 0, 1 and 2.5 m from it.
    starts[50:53], ends[50:53] = [[1, 0], [1, -1], [1, -2.5]], [[5, 0], [5, -1], [5, -2.5]]
    expected = is_clear(segment_clearance_m(INDEX, starts, ends), wanted)
    found = segments_clear(INDEX, starts, ends, wanted)
    np.testing.assert_array_equal(found, expected)
    assert 0 < found.sum() < 400
    np.testing.assert_array_equal(
        segments_clear(EMPTY, starts, ends, wanted), np.isfinite(starts + ends).all(axis=1)
    )


def test_contact_is_never_clear() -> None:
    """Nor is what is no number; what is near enough passes by the tolerance."""
    distance = np.array([0.0, 0.01, 0.5, 0.499, np.nan, np.inf])
    np.testing.assert_array_equal(is_clear(distance, 0.0), [False, True, True, True, False, True])
    np.testing.assert_array_equal(
        is_clear(distance, 0.5, 0.1), [False, False, True, True, False, True]
    )


@settings(deadline=None)
@given(st.lists(places, min_size=2, max_size=8))
def test_swept_clearance_is_the_least_along_the_path(waypoints: list[tuple[float, float]]) -> None:
    """Against dense samples: never more than any of them, and not less than their Lipschitz bound.

    Samples are measured to every boundary edge by hand, without GEOS.
    """
    path = np.array(waypoints)
    swept = swept_clearance_m(INDEX, path)
    share = np.linspace(0, 1, 201)[:, None]
    for (start, end), distance in zip(itertools.pairwise(path), swept, strict=True):
        least = by_hand(start + share * (end - start)).min()
        spacing = np.hypot(*(end - start)) / 200
        assert least - spacing / 2 - 1e-9 <= distance <= least + 1e-9


def by_hand(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of places (n, 2) to the nearest edge; 0 where the crossing number says inside."""
    nearest = np.full(len(at), np.inf)
    for obstacle in WORLD.obstacles:
        inside = np.zeros(len(at), dtype=bool)
        for ring in (obstacle.polygon.exterior, *obstacle.polygon.interiors):
            for a, b in itertools.pairwise(np.array(ring.coords)):
                share = np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[:, None]
                nearest = np.minimum(nearest, np.hypot(*(a + share * (b - a) - at).T))
                spans = (a[1] > at[:, 1]) != (b[1] > at[:, 1])
                rise = b[1] - a[1] or np.inf
                inside ^= spans & (a[0] + (at[:, 1] - a[1]) / rise * (b[0] - a[0]) > at[:, 0])
        nearest[inside] = 0.0
    return nearest


def test_paths_without_length_and_worlds_without_obstacles() -> None:
    """A path of no length is a position; without obstacles the clearance is infinite."""
    path = np.array([[0.0, -2.0], [0.0, -2.0], [1e-200, -2.0]])
    np.testing.assert_array_equal(swept_clearance_m(INDEX, path), [2.0, 2.0])
    walls = np.full(2, YARD)
    ways = segment_lines(path[:-1], path[1:])
    np.testing.assert_array_equal(distances_m(ways, walls), [2.0, 2.0])  # and GEOS warns of nothing
    path = np.array([[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_array_equal(clearance_m(EMPTY, path), [np.inf, np.inf])
    np.testing.assert_array_equal(swept_clearance_m(EMPTY, path), [np.inf])
    assert swept_clearance_m(INDEX, path[:1]).shape == (0,)
    assert clearance_m(INDEX, np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_keeps_no_margin(bad: float) -> None:
    """Only what touches the bad place is NaN, so a comparison with a margin fails there."""
    path = np.array([[-5.0, -5.0], [-6.0, -5.0], [bad, -5.0], [-7.0, -5.0]])
    for index in (INDEX, EMPTY):
        np.testing.assert_array_equal(swept_clearance_m(index, path) >= 2.0, [True, False, False])
        np.testing.assert_array_equal(clearance_m(index, path) >= 2.0, [True, True, False, True])


def test_inside_bounds() -> None:
    """The border belongs to the workspace; NaN does not."""
    positions = np.array([[-10, -10], [20, 20], [20.001, 0], [0, -10.001], [np.nan, 0]])
    np.testing.assert_array_equal(
        inside_bounds(WORLD, positions), [True, True, False, False, False]
    )


def test_containing_obstacle() -> None:
    """Walls and borders contain, courtyards do not; of several obstacles the first is named."""
    assert containing_obstacle(INDEX, np.array([0.5, 0.5])) is WORLD.obstacles[0]
    assert containing_obstacle(INDEX, np.array([18.0, 3.0])) is WORLD.obstacles[1]
    assert containing_obstacle(INDEX, np.array([4.5, 4.5])) is None
    assert containing_obstacle(EMPTY, np.array([0.5, 0.5])) is None
    sizes = np.random.default_rng(0).permutation(np.arange(1, 40))
    nested = tuple(Obstacle(str(size), shapely.box(-size, -size, size, size)) for size in sizes)
    index = index_obstacles(Workspace(BOUNDS, nested))
    assert containing_obstacle(index, np.array([0.5, 0.5])) is nested[0]
