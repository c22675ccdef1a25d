"""Lattice nodes in passages that are narrower than the spacing."""

import math

import numpy as np
import pytest
import shapely

from planopt import Obstacle, Workspace
from planopt.world.clearance import index_obstacles, segments_clear
from planopt.world.lattice import (
    MOVES,
    Lattice,
    build_lattice,
    build_road_map,
    lattice_paths,
    narrow_passages,
    node_at,
)

STEP_M, CLEARANCE_M = 4.0, 1.0
BOUNDS = (-30.0, -20.0, 30.0, 20.0)


def wall(angle: float, door_m: tuple[float, float], wide_m: float, thick_m: float) -> Workspace:
    """A wall through the whole workspace at an angle, with one door."""
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    sides: list[Obstacle] = []
    for side in (1.0, -1.0):
        near, far = (np.array(door_m) + side * away * along for away in (wide_m / 2, 100.0))
        corners = [each + share * thick_m * across for each in (near, far) for share in (-0.5, 0.5)]
        sides.append(Obstacle("wall", shapely.MultiPoint(corners).convex_hull))
    return Workspace(BOUNDS, tuple(sides))


def crosses(workspace: Workspace, angle: float, door_m: tuple[float, float]) -> Lattice:
    """The lattice, after a check that its moves lead through the door."""
    across = 12.0 * np.array([-math.sin(angle), math.cos(angle)])
    goal = np.array(door_m) + across
    lattice = build_lattice(workspace, goal, STEP_M, CLEARANCE_M)
    road_map = build_road_map(lattice)
    cost = lattice_paths(road_map, node_at(road_map, goal)).cost_m
    start = cost[node_at(road_map, np.array(door_m) - across)]
    assert 24.0 - 2 * STEP_M < start < 1.2 * 24.0 + 2 * STEP_M
    return lattice


@pytest.mark.parametrize("share", [1.05, 1.2, 1.5, 2.0])
@pytest.mark.parametrize("angle", [0.0, 0.3, 0.8, 1.5, 2.2])
def test_lattice_passes_doors(angle: float, share: float) -> None:
    """Doors a little wider than twice the clearance, at many angles."""
    for number, thick in enumerate([0.3, 2.0]):
        door = (0.7 + number, -0.4)
        lattice = crosses(wall(angle, door, 2 * share * CLEARANCE_M, thick), angle, door)
        assert share > 1.2 or len(lattice.moved)


def test_moves_of_moved_nodes_are_clear_and_short() -> None:
    """Every move from and to a moved node keeps the clearance, takes a step, and is reversible."""
    workspace = wall(0.4, (0.3, 0.2), 2.2 * CLEARANCE_M, 3.0)
    lattice, index = crosses(workspace, 0.4, (0.3, 0.2)), index_obstacles(workspace)
    compared = 0
    for iy, ix in lattice.moved:
        here = lattice.positions_m[iy, ix]
        regular = lattice.origin_m + lattice.spacing_m * np.array([ix, iy])
        assert np.abs(here - regular).max() <= 0.5 * lattice.spacing_m + 1e-9
        for move, (dx, dy) in enumerate(MOVES):
            if lattice.open_moves[move, iy, ix]:
                there = lattice.positions_m[iy + dy, ix + dx]
                assert np.linalg.norm(there - here) <= STEP_M + 1e-6
                assert segments_clear(index, here[None], there[None], CLEARANCE_M).all()
                back = (move + 9) % 20 + 1 if move else 0
                assert lattice.open_moves[back, iy + dy, ix + dx]
                compared += 1
    assert compared > 10


def test_anchor_stays_in_a_passage() -> None:
    """A goal in a door keeps its node."""
    goal = np.array([0.25, 0.1])
    lattice = build_lattice(wall(0.0, (0.2, 0.0), 2.5, 6.0), goal, STEP_M, CLEARANCE_M)
    assert len(lattice.moved)
    assert np.linalg.norm(lattice.positions_m - goal, axis=2).min() < 1e-9


@pytest.mark.parametrize(("wide_m", "found"), [(1.9, 0), (2.2, 1), (6.0, 0)])
def test_closed_and_wide_doors_are_no_passages(wide_m: float, found: int) -> None:
    """Only doors wider than twice the clearance and narrower than the disc are passages."""
    workspace = wall(0.5, (0.0, 0.0), wide_m, 1.0)
    index = index_obstacles(workspace)
    assert len(narrow_passages(workspace, index, 0.9, CLEARANCE_M)) == found


def test_corners_and_niches_are_no_passages() -> None:
    """The corners of a room and a niche lead nowhere; without obstacles there is nothing."""
    room = shapely.box(-15, -10, 15, 10).difference(shapely.box(-14, -9, 14, 9))
    niche = shapely.box(3, -9, 8, 0).difference(shapely.box(4.4, -4, 6.6, 1))
    workspace = Workspace(BOUNDS, (Obstacle("room", room), Obstacle("niche", niche)))
    assert not len(narrow_passages(workspace, index_obstacles(workspace), 0.9, CLEARANCE_M))
    empty = Workspace(BOUNDS, ())
    assert not len(narrow_passages(empty, index_obstacles(empty), 0.9, CLEARANCE_M))
