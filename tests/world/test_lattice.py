import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.world.clearance import clearance_m, index_obstacles, swept_clearance_m
from planopt.world.lattice import (
    MOVES,
    Lattice,
    build_lattice,
    moves_from,
    nearest_node,
    node_positions,
)
from planopt.world.workspace import Obstacle, Workspace

ORIGIN = np.zeros(2)
BOUNDS = (-20.0, -12.0, 20.0, 12.0)


def random_world(seed: int) -> Workspace:
    """Overlapping triangles, slivers and a frame within `BOUNDS`."""
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-20, 20, (5, 1, 2)) + rng.uniform(-5, 5, (5, 3, 2))
    frame = shapely.Polygon(
        [(-9, -9), (5, -9), (5, 5), (-9, 5)], [[(-8.9, -8.9), (4.9, -8.9), (4.9, 4.9), (-8.9, 4.9)]]
    )
    polygons = [*map(shapely.Polygon, triangles), frame]
    return Workspace(BOUNDS, tuple(Obstacle("o", polygon) for polygon in polygons))


def brute_force(workspace: Workspace, lattice: Lattice, margin_m: float) -> NDArray[np.bool_]:
    """Every move measured against every obstacle."""
    positions = node_positions(lattice)
    ny, nx = lattice.shape
    world = shapely.union_all([obstacle.polygon for obstacle in workspace.obstacles])
    expected = np.zeros((21, ny, nx), dtype=bool)
    for k, (dx, dy) in enumerate(MOVES):
        for iy in range(max(0, -dy), min(ny, ny - dy)):
            for ix in range(max(0, -dx), min(nx, nx - dx)):
                way = shapely.LineString([positions[iy, ix], positions[iy + dy, ix + dx]])
                near = way.distance(world) < margin_m
                expected[k, iy, ix] = not (near or way.intersects(world))
    return expected


def test_moves_are_all_up_to_a_knights() -> None:
    """21 different moves, the first is staying, and move k + 10 undoes move k."""
    disc = {(x, y) for x in range(-3, 4) for y in range(-3, 4) if x * x + y * y <= 5}
    assert {tuple(move) for move in MOVES.tolist()} == disc
    assert len(MOVES) == len(disc) == 21
    np.testing.assert_array_equal(MOVES[0], [0, 0])
    np.testing.assert_array_equal(MOVES[11:], -MOVES[1:11])
    assert not MOVES.flags.writeable


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.4, 2.0]), st.sampled_from([3.3, 6.0]))
def test_equal_to_brute_force(seed: int, margin_m: float, step_m: float) -> None:
    """Free nodes and open moves are exactly those that GEOS finds clear one by one."""
    workspace = random_world(seed)
    anchor = np.random.default_rng(seed).uniform(-5, 5, 2)
    lattice = build_lattice(workspace, anchor, step_m, margin_m)
    expected = brute_force(workspace, lattice, margin_m)
    np.testing.assert_array_equal(lattice.open_moves, expected)
    np.testing.assert_array_equal(lattice.free, expected[0])


def test_munich_moves_agree_with_the_verifier(munich: Workspace) -> None:
    """In a window of Munich every move is open exactly if its swept clearance is enough."""
    window = Workspace((0.0, -350.0, 120.0, -250.0), munich.obstacles)
    lattice = build_lattice(window, np.array([45.0, -351.0]), 6.0, 2.0)
    index = index_obstacles(munich)
    positions = node_positions(lattice)
    clear = clearance_m(index, positions.reshape(-1, 2)).reshape(lattice.shape) >= 2.0
    np.testing.assert_array_equal(lattice.free, clear)
    assert 0.2 < clear.mean() < 0.8
    ny, nx = lattice.shape
    iy, ix = (grid.ravel() for grid in np.indices((ny - 4, nx - 4)) + 2)
    for k, (dx, dy) in enumerate(MOVES):
        there_and_back = np.stack((positions[iy, ix], positions[iy + dy, ix + dx]), axis=1)
        swept = swept_clearance_m(index, there_and_back.reshape(-1, 2))[::2]
        np.testing.assert_array_equal(lattice.open_moves[k, iy, ix], swept >= 2.0)


def test_nodes_are_strictly_within_the_bounds() -> None:
    """Without obstacles every node is free and only moves off the lattice are closed."""
    anchor = np.array([3.0, 40.0])  # outside: nodes are only counted from it
    lattice = build_lattice(Workspace(BOUNDS, ()), anchor, math.sqrt(5), 2.0)
    positions = node_positions(lattice)
    np.testing.assert_allclose(positions[0, 0], [-19, -11])
    np.testing.assert_allclose(positions[-1, -1], [19, 11])
    assert lattice.shape == (23, 39)
    assert lattice.spacing_m == pytest.approx(1.0)
    assert lattice.free.all()
    for (dx, dy), allowed in zip(MOVES, lattice.open_moves, strict=True):
        assert allowed.sum() == (39 - abs(dx)) * (23 - abs(dy))


def test_one_node() -> None:
    """A lattice of one node can only stay."""
    lattice = build_lattice(Workspace((-1, -1, 1, 1), ()), ORIGIN, 6.0, 0.0)
    assert lattice.shape == (1, 1)
    np.testing.assert_array_equal(np.flatnonzero(lattice.open_moves), [0])


def test_thin_wall_closes_moves_across() -> None:
    """Free nodes on both sides, a wall without width to speak of between them."""
    wall = shapely.Polygon([(0.5, -20), (0.500001, -20), (0.500001, 20), (0.5, 20)])
    lattice = build_lattice(Workspace(BOUNDS, (Obstacle("wall", wall),)), ORIGIN, math.sqrt(5), 0.1)
    assert lattice.free.all()
    x = node_positions(lattice)[..., 0]
    for (dx, _), allowed in zip(MOVES, lattice.open_moves, strict=True):
        crosses = (x < 0.5) != (x + dx < 0.5)
        assert not allowed[crosses].any()


@pytest.mark.parametrize("step_m", [500.0, 0.001])
def test_useless_lattices_are_refused(step_m: float) -> None:
    """No node, or more than memory holds, is an error that says what to change."""
    anchor = np.array([100.0, 100.0])
    with pytest.raises(InputError, match=r"nodes within the bounds \(choose bounds and step"):
        build_lattice(Workspace(BOUNDS, ()), anchor, step_m, 2.0)


def test_nearest_node() -> None:
    """Nearest by brute force, and clamped outside."""
    lattice = build_lattice(Workspace(BOUNDS, ()), np.array([0.3, 0.2]), 3.0, 0.0)
    positions = node_positions(lattice)
    for place in np.random.default_rng(0).uniform((-40, -30), (40, 30), (50, 2)):
        iy, ix = nearest_node(lattice, place)
        distance = np.hypot(*np.moveaxis(positions - place, -1, 0))
        assert distance[iy, ix] == distance.min()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_first_moves_by_brute_force(seed: int) -> None:
    """All nodes within reach, each open exactly if the straight way to it is clear."""
    workspace = random_world(seed)
    place = np.random.default_rng(seed + 1).uniform((-21, -13), (21, 13))
    lattice = build_lattice(workspace, ORIGIN, 6.0, 0.5)
    index = index_obstacles(workspace)
    iy, ix, ok = moves_from(index, lattice, place, 6.0, 0.5)
    positions = node_positions(lattice)
    distance = np.hypot(*np.moveaxis(positions - place, -1, 0))
    assert set(zip(iy.tolist(), ix.tolist(), strict=True)) == set(
        map(tuple, np.argwhere(distance <= 6.0).tolist())
    )
    for y, x, open_way in zip(iy, ix, ok, strict=True):
        swept = swept_clearance_m(index, np.stack((place, positions[y, x])))
        assert open_way == (swept[0] >= 0.5)


def test_first_moves_from_a_node_are_its_moves(munich: Workspace) -> None:
    """From a node, with the reach of one step, they are the 21 moves of the lattice."""
    window = Workspace((0.0, -350.0, 120.0, -250.0), munich.obstacles)
    lattice = build_lattice(window, np.array([45.0, -351.0]), 6.0, 2.0)
    index = index_obstacles(munich)
    positions = node_positions(lattice)
    for y, x in [(10, 12), (20, 20), (30, 9)]:
        iy, ix, ok = moves_from(index, lattice, positions[y, x], 6.0, 2.0)
        assert len(ok) == 21
        found = {(b - x, a - y): open_way for a, b, open_way in zip(iy, ix, ok, strict=True)}
        assert all(found[dx, dy] == lattice.open_moves[k, y, x] for k, (dx, dy) in enumerate(MOVES))


def test_first_moves_do_not_change_the_lattice_and_may_be_none() -> None:
    """Free stays as it was; a place with no node in reach has no moves."""
    workspace = random_world(4)
    lattice = build_lattice(workspace, ORIGIN, 6.0, 0.5)
    before = lattice.free.copy()
    index = index_obstacles(workspace)
    for place in (np.array([0.0, 0.0]), np.array([500.0, 0.0])):
        iy, ix, ok = moves_from(index, lattice, place, 6.0, 0.5)
        assert iy.shape == ix.shape == ok.shape
    assert ok.size == 0
    np.testing.assert_array_equal(lattice.free, before)
