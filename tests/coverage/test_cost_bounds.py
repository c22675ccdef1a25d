"""Lower bounds of the coverage cost: no deployment is below, and good ones are near."""

import math

import numpy as np
import pytest
import shapely

from planopt import load, solve
from planopt.coverage import (
    CallableDensity,
    ConvexGround,
    ConvexRegion,
    GaussianMixture,
    GeodesicGround,
    RasterDensity,
    UniformDensity,
    convex_region,
    cost_bound,
    draw_start,
    geodesic_ground,
    settle,
)
from planopt.coverage.cost_bounds import certified
from planopt.tasks import coverage
from planopt.world import Raster


def disc(radius_m: float = 50.0, sides: int = 400) -> ConvexRegion:
    turn = 2.0 * np.pi * np.arange(sides) / sides
    return convex_region(radius_m * np.stack((np.cos(turn), np.sin(turn)), axis=1))


def drawn_ground(rng: np.random.Generator) -> ConvexGround | GeodesicGround:
    """A region with a random outline, density, sensing range and obstacle."""
    outline = shapely.box(0.0, 0.0, *rng.uniform(40.0, 120.0, 2))
    low, high = np.array(outline.bounds).reshape(2, 2)
    bumps = int(rng.integers(1, 4))
    means = rng.uniform(low, high, (bumps, 2))
    mixture = GaussianMixture(rng.uniform(0.1, 2.0, bumps), means, rng.uniform(8, 40, bumps), 1e-4)
    x = np.linspace(-20.0, 130.0, 16)
    raster = RasterDensity(Raster(x, x, rng.random((16, 16)) ** 3))
    density = (UniformDensity(2.0), mixture, raster)[rng.integers(3)]
    if rng.random() < 0.4:
        wall = shapely.box(*(0.3 * high), *(0.3 * high + rng.uniform(4.0, 25.0, 2)))
        return geodesic_ground(outline, [wall], 4.0, density=density)
    reach = float(rng.uniform(8.0, 40.0)) if rng.random() < 0.3 else None
    return ConvexGround(convex_region(outline), density, reach)


def test_no_deployment_is_below() -> None:
    """Random regions, densities, obstacles and numbers of agents, settled and not."""
    rng, shares = np.random.default_rng(11), list[float]()
    for _ in range(8):
        ground, count = drawn_ground(rng), int(rng.integers(1, 14))
        start = draw_start(ground, count, rng)
        cost = settle(ground, start)[1]
        bound = cost_bound(ground, start, 0.3)
        assert bound <= min(cost, ground.cover(start).cost) * (1.0 + 1e-9)
        assert bound == cost_bound(ground, start, 0.3)
        shares.append(bound / cost)
    print(f"{len(shares)} comparisons, bound / cost: median {np.median(shares):.3f}")
    assert np.median(shares) > 0.75 and min(shares) > 0.3


@pytest.mark.slow
def test_no_deployment_is_below_in_many_regions() -> None:
    """Ten thousand random regions; the number of comparisons is printed."""
    rng, compared, least = np.random.default_rng(5), 0, math.inf
    for _ in range(10_000):
        ground = drawn_ground(rng)
        start = draw_start(ground, int(rng.integers(1, 14)), rng)
        cost = settle(ground, start)[1]
        bound = cost_bound(ground, start, 0.02)
        compared, least = compared + 1, min(least, (cost - bound) / cost)
    print(f"{compared} comparisons, smallest gap {least:.4f}")
    assert compared == 10_000 and least >= -1e-9


def test_wrong_prices_only_loosen(square: ConvexRegion) -> None:
    from planopt.coverage.cost_bounds import _cells, _first_prices, _leaves

    rng, ground = np.random.default_rng(3), ConvexGround(square)
    places, cost = settle(ground, draw_start(ground, 6, rng))
    prices = _first_prices(ground, places)
    middles, sides = _leaves(ground, prices, math.inf, 6.0)
    cells = _cells(ground, middles, sides)
    good = prices.at(cells.centroids_m, math.inf)
    bounds = [
        certified(ground, cells, middles, sides, good * factor, 6)
        for factor in (0.01, 0.5, 1.0, 2.0, *np.exp(rng.normal(0.0, 0.5, (2, len(good)))))
    ]
    assert max(bounds) <= cost
    assert bounds[2] > 0.5 * cost


def test_a_single_agent(square: ConvexRegion) -> None:
    """For one agent the bound approaches the cost at the centroid, also with a sensing range."""
    for reach in (None, 30.0):
        ground, middle = ConvexGround(disc(), sensing_range_m=reach), np.zeros((1, 2))
        cost = ground.cover(middle).cost
        assert cost_bound(ground, middle, 0.2) == pytest.approx(cost, rel=1e-4)
    bump = GaussianMixture(np.ones(1), np.array([[50.0, 50.0]]), np.array([10.0]))
    ground, middle = ConvexGround(square, bump), np.array([[50.0, 50.0]])
    cost = ground.cover(middle).cost
    assert 0.97 * cost < cost_bound(ground, middle + 1.0) <= cost


def test_scaling_and_shape() -> None:
    """The bound is proportional to the density and to the fourth power of lengths."""
    means, stds = np.array([[20.0, 30.0], [70.0, 60.0]]), np.array([18.0, 8.0])
    places = np.array([[20.0, 30.0], [70.0, 60.0], [80.0, 20.0]])
    one = ConvexGround(
        convex_region(shapely.box(0, 0, 100, 100)), GaussianMixture(np.ones(2), means, stds)
    )
    double = ConvexGround(one.hull, GaussianMixture(np.full(2, 2.0), means, stds))
    large = ConvexGround(
        convex_region(shapely.box(0, 0, 1000, 1000)),
        GaussianMixture(np.ones(2), 10.0 * means, 10.0 * stds),
    )
    bound = cost_bound(one, places)
    assert bound > 0.8 * settle(one, places)[1]
    assert cost_bound(double, places) == pytest.approx(2.0 * bound, rel=0.02)
    assert cost_bound(large, 10.0 * places) == pytest.approx(100.0 * bound, rel=0.02)


def test_more_effort_is_tighter_among_obstacles() -> None:
    """The bound among obstacles approaches the best deployment."""
    scene = load("coverage_obstacles").scene
    rng = np.random.default_rng(0)
    places, cost = settle(scene.ground, draw_start(scene.ground, 20, rng))
    quick, thorough = (cost_bound(scene.ground, places, effort) for effort in (0.5, 4.0))
    assert 0.5 * cost < quick < thorough <= cost
    assert thorough > 0.9 * cost


def test_no_bound_is_claimed_without_proof(square: ConvexRegion) -> None:
    """A density given as a function has the trivial bound."""
    own = CallableDensity(lambda places: 1.0 + places[:, 0] ** 2, 5.0)
    assert cost_bound(ConvexGround(square, own), np.full((5, 2), 50.0)) == 0.0


def test_solutions_state_the_bound() -> None:
    """More seconds tighten the bound of a solution, which states its method."""
    problem = load("coverage_obstacles")
    quick, slow = solve(problem), solve(problem, prove_s=3.0)
    assert quick.data["objective"] == slow.data["objective"]
    assert quick.data["bound"] < slow.data["bound"] <= slow.data["objective"]
    assert slow.data["gap"] == pytest.approx(1.0 - slow.data["bound"] / slow.data["objective"])
    assert "relaxation" in slow.data["bound_method"] and slow.data["prove_s"] == 3.0


def test_an_interrupt_ends_a_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound of the least time is reported."""

    def interrupted(ground: GeodesicGround, places_m: np.ndarray, effort_s: float) -> float:
        if effort_s > 1.0:
            raise KeyboardInterrupt
        return cost_bound(ground, places_m, effort_s)

    monkeypatch.setattr(coverage, "cost_bound", interrupted)
    problem = load("coverage_obstacles")
    found = solve(problem, prove_s=20.0).data
    assert found["prove_s"] == 1.0 and found["bound"] == solve(problem).data["bound"]
