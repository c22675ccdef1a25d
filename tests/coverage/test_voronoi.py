"""Convex regions and their Voronoi cells against brute force."""

import itertools

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scattered import scattered
from scipy.spatial import Delaunay

from planopt.coverage import (
    Cells,
    ConvexRegion,
    adjacent_cells,
    agent_neighbours,
    convex_region,
    merge_coincident,
    voronoi_cells,
)

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])


def test_corners_of_either_order_and_flat_ones() -> None:
    """Clockwise corners, repeated and collinear ones give the same region."""
    wordy = np.array([[0, 0], [2, 0], [4, 0], [4, 3], [4, 3], [0, 3], [0, 1.5]])[::-1]
    plain, same = convex_region(SQUARE), convex_region(wordy)
    assert {tuple(c) for c in same.corners_m} == {tuple(c) for c in plain.corners_m}
    assert same.area_m2 == pytest.approx(12.0)


def test_half_planes(hexagon: ConvexRegion) -> None:
    """The half-planes hold what shapely says the polygon covers."""
    generator = np.random.default_rng(0)
    places = hexagon.centre_m + 80.0 * generator.uniform(-1.0, 1.0, (500, 2))
    polygon = shapely.Polygon(hexagon.corners_m)
    assert 100 < hexagon.contains(places).sum() < 400
    assert (hexagon.contains(places) == shapely.covers(polygon, shapely.points(places))).all()
    assert hexagon.contains(hexagon.corners_m).all()


def test_corners_turn_left(hexagon: ConvexRegion) -> None:
    """Corners are counter-clockwise, whatever order they were given in."""
    for region in (hexagon, convex_region(hexagon.corners_m[::-1])):
        x, y = (region.corners_m - region.centre_m).T
        assert 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() == pytest.approx(
            region.area_m2
        )


def polygons_of(cells: Cells) -> NDArray[np.object_]:
    first = cells.inside.first
    spans = itertools.pairwise(first)
    return np.array([shapely.Polygon(cells.inside.corners_m[a:b]) for a, b in spans])


def clipped_by_hand(region: ConvexRegion, agents: NDArray[np.float64], one: int) -> shapely.Polygon:
    """One agent's cell: the region less one half-plane for every other agent."""
    cell, size = shapely.Polygon(region.corners_m), 10.0 * region.radius_m
    for other in agents[np.arange(len(agents)) != one]:
        toward = (other - agents[one]) / np.hypot(*(other - agents[one]))
        across, middle = np.array([-toward[1], toward[0]]), 0.5 * (agents[one] + other)
        beyond = [middle + size * across, middle - size * across]
        far = [corner + size * toward for corner in beyond[::-1]]
        cell = cell.difference(shapely.Polygon(beyond + far))
    return cell


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_cells_by_half_planes(hexagon: ConvexRegion, count: int) -> None:
    """Each cell is the intersection of half-planes, found one by one with GEOS."""
    agents = scattered(hexagon, count, np.random.default_rng(count))
    found = polygons_of(voronoi_cells(hexagon, agents))
    for one in range(count):
        wanted = clipped_by_hand(hexagon, agents, one)
        assert found[one].exterior.is_ccw
        assert found[one].symmetric_difference(wanted).area < 1e-9 * hexagon.area_m2


@pytest.mark.parametrize("spread", [1e-2, 1e-5, 1e-8, 1e-9])
def test_clusters(square: ConvexRegion, spread: float) -> None:
    """Agents that nearly coincide get cells that tile the region; each corner is their own."""
    generator = np.random.default_rng(3)
    row = np.array([10.0, 10.0]) + spread * np.stack((np.arange(5.0), np.zeros(5)), axis=1)
    cluster = np.array([37.0, 61.0]) + spread * generator.standard_normal((10, 2))
    agents = np.concatenate((scattered(square, 20, generator), cluster, row))
    cells = voronoi_cells(square, agents)
    assert len(cells.generators_m) == len(agents)
    areas = shapely.area(polygons_of(cells))
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(square.area_m2, rel=1e-12)
    corners = cells.inside.corners_m
    distance = np.linalg.norm(corners[:, None] - cells.generators_m, axis=2)
    own = distance[np.arange(len(corners)), cells.inside.polygon_of]
    assert (own - distance.min(axis=1)).max() < 1e-11


def test_agents_on_the_border_and_on_a_grid(square: ConvexRegion) -> None:
    """A grid with agents on the border: four cells meet in each corner, none is lost."""
    x = np.linspace(0.0, 100.0, 6)
    agents = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    cells = voronoi_cells(square, agents)
    areas = shapely.area(polygons_of(cells)).reshape(6, 6)
    edge = np.array([0.5, 1.0, 1.0, 1.0, 1.0, 0.5])
    assert areas == pytest.approx(400.0 * np.outer(edge, edge))
    # Cells that touch in a corner only are not neighbours.
    assert len(adjacent_cells(cells)) == 2 * 5 * 6


def test_collinear_agents(square: ConvexRegion) -> None:
    """Agents in a row get strips, and each has the two next to it as neighbours."""
    agents = np.stack((np.linspace(1.0, 99.0, 50), np.full(50, 30.0)), axis=1)
    cells = voronoi_cells(square, agents)
    widths = np.diff(np.concatenate(([0.0], 0.5 * (agents[1:, 0] + agents[:-1, 0]), [100.0])))
    assert shapely.area(polygons_of(cells)) == pytest.approx(100.0 * widths)
    pairs = {(int(i), int(j)) for i, j in adjacent_cells(cells)}
    assert pairs == {(i, i + 1) for i in range(49)}


def test_coincident_agents_share_a_cell(square: ConvexRegion) -> None:
    """Three agents at one place have one cell, are neighbours, and share their neighbours."""
    apart = scattered(square, 7, np.random.default_rng(5))
    agents = np.concatenate((apart[:3], apart[2:3], apart[3:], apart[2:3]))
    cells, plain = voronoi_cells(square, agents), voronoi_cells(square, apart)
    assert sorted(cells.multiplicity.tolist()) == [1] * 6 + [3]
    assert cells.cell_of[2] == cells.cell_of[3] == cells.cell_of[8]
    for agent, place in ((2, 2), (8, 2), (5, 4)):
        found, alone = polygons_of(cells), polygons_of(plain)
        cell, own = found[cells.cell_of[agent]], alone[plain.cell_of[place]]
        assert shapely.get_coordinates(cell) == pytest.approx(shapely.get_coordinates(own))
    names = np.array([0, 1, 2, 2, 3, 4, 5, 6, 2])
    pairs = {(int(i), int(j)) for i, j in agent_neighbours(cells)}
    plain_pairs = {(int(i), int(j)) for i, j in agent_neighbours(plain)}
    assert pairs == {
        (i, j)
        for i in range(9)
        for j in range(i + 1, 9)
        if names[i] == names[j] or (min(names[i], names[j]), max(names[i], names[j])) in plain_pairs
    }


def test_neighbours_are_those_of_delaunay_in_the_region(hexagon: ConvexRegion) -> None:
    """Adjacent cells are Delaunay neighbours whose common edge meets the region."""
    agents = scattered(hexagon, 60, np.random.default_rng(7))
    cells = voronoi_cells(hexagon, agents)
    pairs = {(int(i), int(j)) for i, j in adjacent_cells(cells)}
    triangles = Delaunay(agents).simplices
    edges = {tuple(sorted(map(int, pair))) for t in triangles for pair in (t[:2], t[1:], t[::2])}
    shapes = polygons_of(cells)
    touching = {(i, j) for i, j in edges if shapes[i].distance(shapes[j]) < 1e-7}
    assert pairs == touching
    assert pairs < edges


def test_mirroring_and_order(square: ConvexRegion) -> None:
    """Cells follow their agents when these are renumbered and mirrored."""
    generator = np.random.default_rng(9)
    agents = scattered(square, 30, generator)
    order = generator.permutation(30)
    mirrored = np.array([100.0, 0.0]) + agents[order] * np.array([-1.0, 1.0])
    before = shapely.area(polygons_of(voronoi_cells(square, agents)))
    after = shapely.area(polygons_of(voronoi_cells(square, mirrored)))
    assert after == pytest.approx(before[order])


def test_merging_over_a_chain() -> None:
    """Places that are linked over others are one group, led by the first of them."""
    places = np.array([[0.0], [5.0], [0.9], [1.8], [5.5]])
    merged, group = merge_coincident(places, 1.0)
    assert merged.tolist() == [[0.0], [5.0]]
    assert group.tolist() == [0, 1, 0, 0, 1]
