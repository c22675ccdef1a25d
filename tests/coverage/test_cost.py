"""The coverage cost and centroids against closed forms, sampling and differences."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered
from scipy.spatial import KDTree

from planopt.coverage import (
    UNIFORM,
    CallableDensity,
    ConvexRegion,
    Density,
    GaussianMixture,
    RasterDensity,
    UniformDensity,
    convex_region,
    coverage,
    voronoi_cells,
)
from planopt.world import Raster


def bumps(at_m: NDArray[np.float64]) -> GaussianMixture:
    means = at_m + np.array([[-15.0, -10.0], [25.0, 20.0]])
    return GaussianMixture(np.array([1.0, 2.0]), means, np.array([9.0, 6.0]), 1e-5)


def raster(region: ConvexRegion, generator: np.random.Generator) -> RasterDensity:
    """Random values on cells of 7 by 5 m that reach over the region."""
    low, high = region.corners_m.min(axis=0) - 3.0, region.corners_m.max(axis=0) + 8.0
    x, y = np.arange(low[0], high[0], 7.0), np.arange(low[1], high[1], 5.0)
    return RasterDensity(Raster(x, y, generator.random((len(y), len(x)))))


def densities(region: ConvexRegion) -> list[Density]:
    mixture = bumps(region.centre_m)
    line = CallableDensity(lambda q: np.asarray(1.0 + 0.005 * q[:, 0] ** 2), 50.0)
    return [UNIFORM, mixture, CallableDensity(mixture.at, 4.0), line, raster(region, rng(1))]


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("range_m", [None, 9.0])
@pytest.mark.parametrize("kind", range(5))
def test_against_sampling(hexagon: ConvexRegion, kind: int, range_m: float | None) -> None:
    """Cost, masses and centroids are those of places on a fine grid."""
    density = densities(hexagon)[kind]
    agents = scattered(hexagon, 25, rng(2))
    found = coverage(voronoi_cells(hexagon, agents), density, range_m)
    low, high = hexagon.corners_m.min(axis=0), hexagon.corners_m.max(axis=0)
    x, y = (low[k] + (high[k] - low[k]) * (np.arange(997) + 0.5) / 997 for k in range(2))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = places[hexagon.contains(places)]
    weight = density.at(places) * hexagon.area_m2 / len(places)
    distance, nearest = KDTree(agents).query(places)
    limit = math.inf if range_m is None else range_m
    assert found.cost == pytest.approx(float(weight @ np.minimum(distance, limit) ** 2), rel=3e-3)
    weight[distance > limit] = 0.0
    mass = np.bincount(nearest, weight, minlength=25)
    assert found.mass == pytest.approx(mass, rel=0.05)
    for axis in range(2):
        mean = np.bincount(nearest, weight * places[:, axis], minlength=25) / mass
        assert found.targets_m[:, axis] == pytest.approx(mean, abs=0.3)


@pytest.mark.parametrize("range_m", [None, 9.0])
@pytest.mark.parametrize("kind", range(5))
def test_gradient_by_differences(hexagon: ConvexRegion, kind: int, range_m: float | None) -> None:
    """The gradient 2 M (p - C) is the cost's, for every density, with and without range."""
    density, step = densities(hexagon)[kind], 1e-4
    agents = scattered(hexagon, 12, rng(4))
    found = coverage(voronoi_cells(hexagon, agents), density, range_m)
    gradient = 2.0 * found.mass[:, None] * (agents - found.targets_m)
    scale = float(np.abs(gradient).max())
    for agent, axis in ((0, 0), (3, 1), (7, 0)):
        shift = np.zeros_like(agents)
        shift[agent, axis] = step
        up, down = (
            coverage(voronoi_cells(hexagon, agents + sign * shift), density, range_m).cost
            for sign in (1.0, -1.0)
        )
        assert (up - down) / (2.0 * step) == pytest.approx(gradient[agent, axis], abs=1e-6 * scale)


def test_kinds_of_density_agree(hexagon: ConvexRegion) -> None:
    """The same density in two forms has the same integrals, to nine digits."""
    cells = voronoi_cells(hexagon, scattered(hexagon, 30, rng(5)))
    flat = raster(hexagon, rng(0)).raster
    flat = RasterDensity(Raster(flat.x_m, flat.y_m, np.full(flat.values.shape, 2.5)))
    pairs: list[tuple[Density, Density]] = [
        (UniformDensity(2.5), flat),
        (UniformDensity(2.5), CallableDensity(lambda q: np.full(len(q), 2.5), 100.0)),
        (bumps(hexagon.centre_m), CallableDensity(bumps(hexagon.centre_m).at, 1.0)),
    ]
    for one, other in pairs:
        for range_m in (None, 9.0):
            a, b = coverage(cells, one, range_m), coverage(cells, other, range_m)
            assert a.cost == pytest.approx(b.cost, rel=1e-9)
            assert a.mass == pytest.approx(b.mass, rel=1e-9)
            assert a.targets_m == pytest.approx(b.targets_m, abs=1e-7)


def test_closed_forms(square: ConvexRegion) -> None:
    """A square about its middle and off it, discs within cells, and other units of length."""
    middle = coverage(voronoi_cells(square, np.array([[50.0, 50.0]])))
    assert middle.cost == pytest.approx(1e8 / 6.0)
    off = coverage(voronoi_cells(square, np.array([[20.0, 90.0]])))
    assert off.cost == pytest.approx(1e8 / 6.0 + 1e4 * (30.0**2 + 40.0**2))
    assert off.targets_m[0] == pytest.approx([50.0, 50.0])
    agents = np.array([[30.0, 30.0], [80.0, 100.0]])
    found = coverage(voronoi_cells(square, agents), UNIFORM, 10.0)
    assert found.mass == pytest.approx([100.0 * math.pi, 50.0 * math.pi])
    assert found.targets_m == pytest.approx(
        np.array([[30.0, 30.0], [80.0, 100.0 - 40.0 / (3.0 * math.pi)]])
    )
    inner = 0.5 * math.pi * 10.0**4 * 1.5
    assert found.cost == pytest.approx(inner + 100.0 * (1e4 - 150.0 * math.pi))


def test_agents_in_special_places(square: ConvexRegion) -> None:
    """Coincident agents share a centroid; an agent whose cell has no mass stays."""
    agents = np.array([[20.0, 30.0], [20.0, 30.0], [70.0, 60.0]])
    found = coverage(voronoi_cells(square, agents))
    alone = coverage(voronoi_cells(square, agents[1:]))
    assert found.cost == pytest.approx(alone.cost)
    assert found.targets_m[[0, 2]] == pytest.approx(alone.targets_m)
    x = np.arange(5.0, 100.0, 10.0)
    values = np.zeros((10, 10))
    values[:, 0] = 1.0
    found = coverage(
        voronoi_cells(square, np.array([[10.0, 50.0], [90.0, 40.0]])),
        RasterDensity(Raster(x, x, values)),
    )
    assert found.mass[1] == pytest.approx(0.0, abs=1e-9)
    assert found.targets_m[1].tolist() == [90.0, 40.0]
    assert found.targets_m[0] == pytest.approx([5.0, 50.0])


@pytest.mark.parametrize("gain", [1.0, 0.3])
@pytest.mark.parametrize("range_m", [None, 12.0])
@pytest.mark.parametrize("kind", range(5))
def test_cost_falls_along_the_law(
    hexagon: ConvexRegion, kind: int, range_m: float | None, gain: float
) -> None:
    """Steps toward the centroids never raise H, and lower it by at least gain M |p - C|^2."""
    density = densities(hexagon)[kind]
    agents = scattered(hexagon, 15, rng(7))
    before = coverage(voronoi_cells(hexagon, agents), density, range_m)
    for _ in range(12):
        offset = before.targets_m - agents
        agents = agents + gain * offset
        after = coverage(voronoi_cells(hexagon, agents), density, range_m)
        promised = gain * (2.0 - gain) * float(before.mass @ (offset * offset).sum(axis=1))
        assert after.cost <= before.cost - promised + 1e-9 * before.cost
        before = after


def test_scaling(hexagon: ConvexRegion) -> None:
    """Lengths in other units scale H by the fourth power and turn the rest with them."""
    agents = scattered(hexagon, 20, rng(8))
    one = coverage(voronoi_cells(hexagon, agents), UNIFORM, 15.0)
    larger = convex_region(hexagon.corners_m * 1e3)
    other = coverage(voronoi_cells(larger, agents * 1e3), UNIFORM, 15e3)
    assert other.cost == pytest.approx(one.cost * 1e12, rel=1e-10)
    assert other.targets_m == pytest.approx(one.targets_m * 1e3, rel=1e-10)
