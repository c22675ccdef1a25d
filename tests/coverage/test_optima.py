"""Several starts against Lloyd's method, and bounds that no deployment is below."""

import math

import numpy as np
import pytest
import shapely

from planopt.coverage import (
    CallableDensity,
    ConvexGround,
    ConvexRegion,
    GaussianMixture,
    RasterDensity,
    UniformDensity,
    best_deployment,
    convex_region,
    cost_bound,
    draw_start,
    geodesic_ground,
    settle,
)
from planopt.world import Raster
from tests.coverage.scattered import scattered


@pytest.mark.parametrize("sides", [3, 4, 6, 9, 40])
def test_bound_holds_and_is_near(sides: int) -> None:
    """The bound is below what is found, and near it with many agents."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ground = ConvexGround(convex_region(50.0 * np.stack((np.cos(turn), np.sin(turn)), axis=1)))
    for count in (1, 2, 25):
        places = draw_start(ground, count, np.random.default_rng(count))
        cost = settle(ground, places)[1]
        assert cost_bound(ground, count) <= cost * (1.0 + 1e-12)
        assert cost_bound(ground, count) > (0.9 if count == 25 else 0.5) * cost


def test_bound_of_one_disc() -> None:
    """A single agent in the middle of what is nearly a disc costs nearly the bound."""
    turn = 2.0 * np.pi * np.arange(400) / 400
    region = convex_region(50.0 * np.stack((np.cos(turn), np.sin(turn)), axis=1))
    middle = np.zeros((1, 2))
    for reach in (None, 30.0, 80.0):
        ground = ConvexGround(region, sensing_range_m=reach)
        assert cost_bound(ground, 1) == pytest.approx(ground.cover(middle).cost, rel=1e-4)
        assert cost_bound(ground, 1) <= ground.cover(middle).cost * (1.0 + 1e-12)
    ring = ConvexGround(region, sensing_range_m=30.0)
    area = math.pi * 900.0
    inside, outside = area**2 / (2.0 * math.pi), 900.0 * (region.area_m2 - area)
    assert cost_bound(ring, 1) == pytest.approx(inside + outside)
    double = ConvexGround(region, UniformDensity(2.0))
    assert cost_bound(double, 3) == pytest.approx(2.0 * cost_bound(ConvexGround(region), 3))


def test_no_bound_is_claimed_without_proof(square: ConvexRegion) -> None:
    """Densities of the user's own, and obstacles, have the trivial bound."""
    own = CallableDensity(lambda places: 1.0 + places[:, 0] ** 2, 5.0)
    assert cost_bound(ConvexGround(square, own), 5) == 0.0
    walled = geodesic_ground(shapely.box(0, 0, 9, 9), [shapely.box(4, 4, 5, 5)], 1.0)
    assert cost_bound(walled, 5) == 0.0


def test_bound_of_other_densities_holds(square: ConvexRegion) -> None:
    """Level by level the bound is below every deployment, and exact for one agent on one bump."""
    rng = np.random.default_rng(8)
    bump = GaussianMixture(np.ones(1), np.array([[50.0, 50.0]]), np.array([10.0]))
    ground, middle = ConvexGround(square, bump), np.array([[50.0, 50.0]])
    cost = ground.cover(middle).cost
    assert 0.9 * cost < cost_bound(ground, 1) < cost
    x = np.linspace(5.0, 95.0, 10)
    values = rng.random((10, 10)) ** 3
    spread = np.array([18.0, 8.0])
    two = GaussianMixture(
        np.array([1.0, 3.0]), np.array([[20.0, 30.0], [70.0, 60.0]]), spread, 1e-4
    )
    for density in (two, RasterDensity(Raster(x, x, values))):
        for count, reach in ((1, None), (4, None), (4, 15.0)):
            ground = ConvexGround(square, density, reach)
            best = min(settle(ground, draw_start(ground, count, rng))[1] for _ in range(2))
            assert 0.2 * best < cost_bound(ground, count) <= best
    # An even raster is the uniform density; hexagons are not counted on.
    turn = 2.0 * np.pi * np.arange(9) / 9
    region = convex_region(50.0 + 40.0 * np.stack((np.cos(turn), np.sin(turn)), axis=1))
    even = ConvexGround(region, RasterDensity(Raster(x, x, np.full((10, 10), 2.0))))
    uniform = ConvexGround(region, UniformDensity(2.0))
    assert cost_bound(even, 6) == pytest.approx(cost_bound(uniform, 6))


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
