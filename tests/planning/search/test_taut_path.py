"""Sampling a way anew: on the way, in equal steps, to its end."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planopt.planning.scene import retime

START = np.array([0.0, 0.0])
NOTHING = np.zeros((0, 2))
POINTS = st.lists(
    st.tuples(st.integers(-4, 4), st.integers(-4, 4)).map(lambda p: (float(p[0]), float(p[1]))),
    min_size=1,
    max_size=7,
)


def along(way, length):
    """Place at a length of way, by walking it."""
    for a, b in pairwise(way):
        leg = float(np.linalg.norm(b - a))
        if length <= leg:
            return a if leg == 0.0 else a + (b - a) * (length / leg)
        length -= leg
    return way[-1]


def length_of(way):
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_an_arrived_path_stays_where_it_arrived():
    """Standing still at the end means arrived: the way beyond is not for it."""
    arrived = np.array([[1.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    beyond = np.array([[9.0, 0.0]])
    np.testing.assert_allclose(retime(START, arrived, beyond, 5.0), np.tile([2.0, 0.0], (3, 1)))
    np.testing.assert_allclose(
        retime(START, arrived, beyond, 1.5), [[1.0, 0.0], [2.0, 0.0], [2.0, 0.0]]
    )


@settings(deadline=None)
@given(POINTS, POINTS, st.floats(0.05, 12.0))
def test_places_are_equally_far_apart_along_the_way(path, beyond, step):
    """Arc lengths are k times one step, which is the longest or divides the way; then its end."""
    path, beyond = np.array(path), np.array(beyond)
    horizon = len(path)
    arrived = horizon > 1 and (path[-1] == path[-2]).all()
    way = np.vstack([START, path] if arrived else [START, path, beyond])
    total = length_of(way)
    found = retime(START, path, beyond, step)
    assert found.shape == path.shape
    if total == 0.0:
        np.testing.assert_array_equal(found, path)
        return
    # The fewest steps within the horizon, or full steps.
    enough = [n for n in range(1, horizon + 1) if (total - 1e-9) / step <= n]
    equal = total / enough[0] if enough else step
    arcs = np.minimum(equal * np.arange(1, horizon + 1), total)
    expected = np.array([along(way, s) for s in arcs])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    steps = np.linalg.norm(np.diff(np.vstack([START, found]), axis=0), axis=1)
    assert (steps <= step + 2e-9).all()
    if enough:
        np.testing.assert_allclose(found[-1], way[-1], atol=1e-12)


@pytest.mark.parametrize("step_length_m", [1.0, 2.0, 2.5, 4.0, 7.5])
@pytest.mark.parametrize("direction", [(2, 1), (1, 2), (-2, 1)])
@pytest.mark.parametrize("count", [1, 3, 6, 7, 10])
def test_a_way_of_longest_moves_takes_as_many_steps(step_length_m, direction, count):
    """Rounding of a lattice path that moves at full speed does not cost it a step more."""
    spacing = step_length_m / np.sqrt(5.0)
    nodes = np.array([35.0, 0.7]) + spacing * np.outer(np.arange(count + 1), direction)
    path = np.vstack([nodes[1:], nodes[-1:], nodes[-1:]])
    np.testing.assert_allclose(retime(nodes[0], path, NOTHING, step_length_m), path, atol=1e-9)
