"""Coverage round obstacles against visibility graphs, closed forms and differences."""

import math

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scattered import scattered

from planopt import Obstacle, Workspace
from planopt.coverage import (
    CallableDensity,
    ConvexGround,
    ConvexRegion,
    GeodesicGround,
    coverage,
    geodesic_cells,
    geodesic_ground,
    geodesic_targets,
    voronoi_cells,
)
from planopt.world import index_obstacles, path_lengths_m
from planopt.world.shortest_paths import shortest_paths

OUTLINE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
OBSTACLES = (
    shapely.box(20, 20, 40, 70),
    shapely.box(60, -5, 65, 60),
    shapely.Polygon([(70, 80), (92, 75), (85, 95), (80, 84)]),
)


def free_places(
    region: GeodesicGround, count: int, generator: np.random.Generator
) -> NDArray[np.float64]:
    drawn = 100.0 * generator.random((10 * count, 2))
    return drawn[np.asarray(shapely.intersects(region.area.polygon, shapely.points(drawn)))][:count]


@pytest.fixture(scope="module")
def region() -> GeodesicGround:
    """A square with three obstacles, one of them at its border and one not convex."""
    return geodesic_ground(OUTLINE, OBSTACLES, 4.0)


def test_distances_by_visibility_graph(region: GeodesicGround) -> None:
    """Distances are those of the world's own shortest paths, found by other code."""
    agents = free_places(region, 6, np.random.default_rng(0))
    cells = geodesic_cells(region, agents)
    named = tuple(Obstacle(str(number), shape) for number, shape in enumerate(OBSTACLES))
    index = index_obstacles(Workspace((0.0, 0.0, 100.0, 100.0), named))
    wanted = np.array(
        [
            path_lengths_m(
                shortest_paths(index, (0.0, 0.0, 100.0, 100.0), agent, 0.0, 500.0, inner=False),
                region.nodes_m,
            )
            for agent in agents
        ]
    )
    assert region.distances_m(agents, region.nodes_m) == pytest.approx(wanted, rel=1e-6)
    assert cells.distance_m == pytest.approx(wanted.min(axis=0), rel=1e-6)
    assert (cells.owner == wanted.argmin(axis=0)).mean() > 0.99


def test_round_one_corner() -> None:
    """Behind a wall the path turns at its end, and leaves toward it."""
    region = geodesic_ground(OUTLINE, [shapely.box(50, 0, 51, 80)], 5.0)
    agent = np.array([[30.0, 20.0]])
    place = np.array([[90.0, 20.0]])
    around = math.hypot(20, 60) + 1.0 + math.hypot(39, 60)
    assert region.distances_m(agent, place)[0, 0] == pytest.approx(around)
    leg = region.steered(agent, place, 1.0)[0] - agent[0]
    assert leg == pytest.approx([20, 60])


def test_masses(region: GeodesicGround) -> None:
    """Nodes are free and stand for the whole free area; a density weighs them."""
    area = shapely.Polygon(OUTLINE).difference(shapely.union_all(OBSTACLES)).area
    assert region.mass.sum() == pytest.approx(area)
    assert shapely.intersects(region.free, shapely.points(region.nodes_m)).all()
    heavy = geodesic_ground(OUTLINE, OBSTACLES, 4.0, CallableDensity(lambda q: q[:, 0], 10.0))
    assert heavy.mass == pytest.approx(region.mass * region.nodes_m[:, 0])


def test_without_obstacles_as_euclidean(square: ConvexRegion) -> None:
    """In a convex free region cost, gradient and targets are those of Voronoi cells."""
    agents = scattered(square, 8, np.random.default_rng(1))
    exact = coverage(voronoi_cells(square, agents))
    region = geodesic_ground(OUTLINE, [], 0.5)
    cells = geodesic_cells(region, agents)
    assert cells.cost == pytest.approx(exact.cost, rel=1e-4)
    assert cells.mass == pytest.approx(exact.mass, rel=1e-2)
    assert geodesic_targets(region, agents, cells) == pytest.approx(exact.targets_m, abs=0.2)
    alone = geodesic_cells(region, agents[:1])
    assert alone.cost == pytest.approx(coverage(voronoi_cells(square, agents[:1])).cost)


def test_gradient_by_differences(region: GeodesicGround) -> None:
    """The gradient is the cost's wherever no path changes."""
    agents = free_places(region, 15, np.random.default_rng(2))
    cells, step = geodesic_cells(region, agents), 1e-5
    for agent in range(15):
        for axis in range(2):
            shift = np.zeros_like(agents)
            shift[agent, axis] = step
            up, down = (geodesic_cells(region, agents + sign * shift) for sign in (1.0, -1.0))
            assert (up.cost - down.cost) / (2.0 * step) == pytest.approx(
                cells.gradient[agent, axis], abs=1e-5 * np.abs(cells.gradient).max()
            )


def test_two_nearest(region: GeodesicGround, square: ConvexRegion) -> None:
    """The two least of all distances, with and without obstacles; beyond the range it counts."""
    agents = free_places(region, 7, np.random.default_rng(12))
    found = region.two_nearest(agents)
    every = np.sort(region.distances_m(agents, region.ends_m), axis=0) ** 2
    np.testing.assert_allclose(found.first_m2, every[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.second_m2, every[1], rtol=1e-9, atol=1e-9)
    assert found.mass @ found.first_m2 + region.spread == pytest.approx(region.cover(agents).cost)
    ground = ConvexGround(square, sensing_range_m=30.0)
    found = ground.two_nearest(agents)
    away = np.linalg.norm(found.samples_m[:, None] - agents, axis=2)
    every = np.minimum(np.sort(away, axis=1), 30.0) ** 2
    np.testing.assert_allclose(found.first_m2, every[:, 0])
    np.testing.assert_allclose(found.second_m2, every[:, 1])
    assert found.mass @ found.first_m2 == pytest.approx(ground.cover(agents).cost, rel=2e-3)


@pytest.mark.parametrize("clearance_m", [0.0, 1.5])
def test_targets_are_free_and_lower_the_cost(clearance_m: float) -> None:
    """Every target is allowed, in sight, and moving there never raises the cost."""
    region = geodesic_ground(OUTLINE, OBSTACLES, 4.0, clearance_m=clearance_m)
    keep = shapely.union_all(OBSTACLES).buffer(clearance_m - 1e-6, join_style="mitre")
    for seed in range(4):
        agents = free_places(region, 12, np.random.default_rng(seed))
        cells = geodesic_cells(region, agents)
        first = cells.cost
        for _ in range(25):
            targets = geodesic_targets(region, agents, cells)
            moves = shapely.linestrings(np.stack((agents, targets), axis=1))
            assert not shapely.relate_pattern(keep, moves, "T********").any()
            assert (targets >= clearance_m - 1e-6).all() and (
                targets <= 100.001 - clearance_m
            ).all()
            after = geodesic_cells(region, targets)
            assert after.cost <= cells.cost * (1.0 + 1e-12)
            agents, cells = targets, after
        assert cells.cost < 0.8 * first


def test_two_rooms_are_shared() -> None:
    """Two agents in one of two equal rooms end with one in each."""
    wall = [shapely.box(49, 0, 51, 45), shapely.box(49, 55, 51, 100)]
    region = geodesic_ground(OUTLINE, wall, 4.0)
    agents = np.array([[10.0, 50.0], [30.0, 52.0]])
    for _ in range(200):
        agents = geodesic_targets(region, agents, geodesic_cells(region, agents))
    assert np.sort(agents[:, 0]) == pytest.approx([24.5, 75.5], abs=1.0)
    assert agents[:, 1] == pytest.approx([50.0, 50.0], abs=1.0)


def test_agent_at_a_corner() -> None:
    """An agent that stands on a corner of an obstacle still knows where to go."""
    region = geodesic_ground(OUTLINE, [shapely.box(40, 40, 60, 67)], 4.0)
    agents = np.array([[40.0, 40.0]])
    cells = geodesic_cells(region, agents)
    others = geodesic_cells(region, agents - 1e-4)
    assert np.isfinite(cells.gradient).all()
    assert cells.cost == pytest.approx(others.cost, rel=1e-4)
    assert cells.gradient == pytest.approx(others.gradient, rel=2e-2)
    assert geodesic_cells(region, geodesic_targets(region, agents, cells)).cost < cells.cost


def test_borders_of_agents_that_rounding_puts_into_an_obstacle() -> None:
    """A run that ends at an obstacle can be drawn: agents count at the nearest free position."""
    ground = geodesic_ground(shapely.Polygon(OUTLINE), OBSTACLES, 4.0)
    corner = np.array([[92.0, 75.0], [10.0, 10.0]])
    inside = corner + [[-1e-3, 1e-3], [0.0, 0.0]]
    assert not ground.allows(inside).all()
    assert np.array_equal(ground.borders(inside), ground.borders(ground.nearest(inside)))


def test_borders_are_equally_far_from_two_agents() -> None:
    """Cell borders lie in the free area, where the two nearest agents are equally far."""
    walls = [shapely.box(20, 20, 40, 70), shapely.Polygon([(60, 10), (90, 30), (70, 60)])]
    region = geodesic_ground(OUTLINE, walls, 2.0)
    agents = free_places(region, 9, np.random.default_rng(5))
    lines = region.borders(agents)
    drawn = shapely.linestrings(lines)
    assert shapely.length(drawn).sum() > 200.0
    assert shapely.length(shapely.difference(drawn, shapely.buffer(region.free, 1e-9))).sum() < 1e-6
    ends = lines.reshape(-1, 2)
    nearest = np.sort(region.distances_m(agents, ends), axis=0)[:2]
    gaps = nearest[1] - nearest[0]
    assert np.quantile(gaps, 0.9) < 0.3 and gaps.max() < 2.0 * region.spacing_m
