"""Coverage in one and three dimensions against closed forms, sampling and differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull, KDTree

from planopt.coverage.line_and_space import line_coverage, space_coverage
from planopt.errors import InputError

CUBE = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 1.0) for z in (0.0, 3.0)])


def test_interval() -> None:
    """Three agents, one at the end, against integrals by hand."""
    found = line_coverage(0.0, 10.0, np.array([[6.0], [0.0], [2.0]]))
    assert found.mass == pytest.approx([6.0, 1.0, 3.0])
    assert found.centroids_m[:, 0] == pytest.approx([7.0, 0.5, 2.5])
    # From 4 to 10 about 6, from 0 to 1 about 0, from 1 to 4 about 2.
    assert found.cost == pytest.approx((64 + 8) / 3 + 1 / 3 + (8 + 1) / 3)
    assert found.gradient[:, 0] == pytest.approx([2 * 6 * -1.0, 2 * -0.5, 2 * 3 * -0.5])


def test_interval_reaches_its_optimum() -> None:
    """The law on a line ends at the middles of n equal parts: H = L^3 / (12 n^2)."""
    agents = np.random.default_rng(0).random((5, 1)) * 3.0
    for _ in range(3000):
        agents = agents + 0.9 * (line_coverage(0.0, 3.0, agents).centroids_m - agents)
    assert np.sort(agents[:, 0]) == pytest.approx([0.3, 0.9, 1.5, 2.1, 2.7])
    assert line_coverage(0.0, 3.0, agents).cost == pytest.approx(27.0 / 12.0 / 25.0)


def test_box() -> None:
    """One agent in a box off its middle: a b c (a^2 + b^2 + c^2) / 12 and Steiner."""
    found = space_coverage(CUBE, np.array([[1.0, 0.5, 0.5]]))
    assert found.mass == pytest.approx([6.0])
    assert found.centroids_m == pytest.approx(np.array([[1.0, 0.5, 1.5]]))
    assert found.cost == pytest.approx(6.0 * (4.0 + 1.0 + 9.0) / 12.0 + 6.0)


def test_space_by_sampling() -> None:
    """A polyhedron of many faces, agents on its border and coincident ones among them."""
    generator = np.random.default_rng(1)
    corners = generator.standard_normal((14, 3))
    hull = ConvexHull(corners)
    places = generator.uniform(corners.min(axis=0), corners.max(axis=0), (900_000, 3))
    inside = (places @ hull.equations[:, :3].T + hull.equations[:, 3] <= 0.0).all(axis=1)
    places = places[inside]
    agents = np.concatenate((places[:8], places[:1], corners[hull.vertices[:1]]))
    found = space_coverage(corners, agents)
    assert found.mass[:8].sum() + found.mass[9] == pytest.approx(hull.volume)
    assert found.mass[8] == found.mass[0]
    distance, nearest = KDTree(np.delete(agents, 8, axis=0)).query(places)
    assert found.cost == pytest.approx(hull.volume * np.mean(distance**2), rel=1e-2)
    middle = np.array([places[nearest == k].mean(axis=0) for k in range(9)])
    assert found.centroids_m[[0, 1, 2, 3, 4, 5, 6, 7, 9]] == pytest.approx(middle, abs=0.02)


def test_space_gradient_and_fall() -> None:
    """The gradient is the cost's, and steps toward the centroids lower the cost."""
    agents = np.random.default_rng(2).random((12, 3)) * np.array([2.0, 1.0, 3.0])
    found = space_coverage(CUBE, agents)
    for agent, axis in ((0, 0), (5, 1), (11, 2)):
        shift = np.zeros_like(agents)
        shift[agent, axis] = 1e-5
        change = (
            space_coverage(CUBE, agents + shift).cost - space_coverage(CUBE, agents - shift).cost
        )
        assert change / 2e-5 == pytest.approx(found.gradient[agent, axis], rel=1e-5)
    cost = found.cost
    for _ in range(20):
        agents = space_coverage(CUBE, agents).centroids_m
        now = space_coverage(CUBE, agents).cost
        assert now <= cost * (1.0 + 1e-12)
        cost = now


def test_bad_input() -> None:
    """Intervals, polyhedra and agents that are none."""
    for low, high in ((1.0, 1.0), (2.0, 1.0), (0.0, np.inf), (np.nan, 1.0)):
        with pytest.raises(InputError, match="not an interval"):
            line_coverage(low, high, np.array([[1.0]]))
    for agents in (np.zeros((0, 1)), np.zeros(3), np.array([[2.0]]), np.array([[np.nan]])):
        with pytest.raises(InputError):
            line_coverage(0.0, 1.0, agents)
    for corners in (CUBE[:4] * np.array([1.0, 1.0, 0.0]), CUBE[:3], np.full((5, 3), np.nan)):
        with pytest.raises(InputError):
            space_coverage(corners, np.array([[0.5, 0.5, 0.5]]))
    with pytest.raises(InputError, match="not in the region"):
        space_coverage(CUBE, np.array([[0.5, 0.5, 3.5]]))


def test_space_far_off_and_large() -> None:
    """Kilometres far from the origin give what metres at it do."""
    agents = np.random.default_rng(3).random((6, 3)) * np.array([2.0, 1.0, 3.0])
    shift = np.array([5e6, -3e6, 1e5])
    near, far = (
        space_coverage(CUBE, agents),
        space_coverage(1e3 * CUBE + shift, 1e3 * agents + shift),
    )
    assert far.cost == pytest.approx(1e15 * near.cost, rel=1e-7)
    assert far.centroids_m - shift == pytest.approx(1e3 * near.centroids_m, abs=1e-4)
