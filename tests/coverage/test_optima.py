"""Several starts against Lloyd's method."""

import numpy as np
import pytest
import shapely

from planopt.coverage import (
    ConvexGround,
    ConvexRegion,
    GaussianMixture,
    best_deployment,
    convex_region,
    geodesic_ground,
    settle,
)
from tests.coverage.scattered import scattered


def test_several_starts_reach_the_best(square: ConvexRegion) -> None:
    """Ten starts do as well as the best of many runs from uniform places, and moving pays."""
    ground, rng = ConvexGround(square), np.random.default_rng(7)
    runs = [settle(ground, scattered(square, 7, rng))[1] for _ in range(25)]
    found = best_deployment(ground, 7, 10, rng)
    assert found.cost <= 1.002 * min(runs)
    assert found.cost <= found.costs.min() and len(found.costs) == 10
    assert max(runs) > 1.005 * min(runs)
    assert found.cost == pytest.approx(ground.cover(found.places_m).cost)
    targets = ground.cover(found.places_m).targets_m
    assert np.linalg.norm(targets - found.places_m, axis=1).max() < 0.5


def test_poor_start_is_mended() -> None:
    """Agents that Lloyd's method leaves in one of two far clusters are moved to the other."""
    means = np.array([[12.0, 15.0], [88.0, 15.0]])
    density = GaussianMixture(np.ones(2), means, np.full(2, 10.0))
    ground = ConvexGround(convex_region(shapely.box(0, 0, 100, 30)), density)
    poor = np.array([[8.0, 12.0], [16.0, 12.0], [12.0, 20.0], [88.0, 15.0]])
    stuck = settle(ground, poor)[1]
    found = best_deployment(ground, 4, 1, np.random.default_rng(0), first_m=poor)
    assert found.costs[0] == pytest.approx(stuck)
    assert found.cost < 0.92 * stuck
    assert (found.places_m[:, 0] > 50.0).sum() == 2


def test_obstacles_and_repetition() -> None:
    """Deployments among obstacles are free, and the same for the same generator."""
    ground = geodesic_ground(shapely.box(0, 0, 30, 20), [shapely.box(10, 5, 20, 15)], 2.0)
    one, other = (best_deployment(ground, 4, 2, np.random.default_rng(3)) for _ in range(2))
    assert ground.allows(one.places_m).all()
    np.testing.assert_array_equal(one.places_m, other.places_m)
    assert one.cost <= settle(ground, ground.nodes_m[:4])[1]
