"""What is built once: obstacles, lattice, ways; and when there is provably no plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import CUP, RING, WALL, small_problem

from planopt.errors import NoPlanError
from planopt.planning.scene import build_scene, first_moves
from planopt.world.workspace import Obstacle

ROOM = shapely.Polygon(
    [(30, 10), (39, 10), (39, 20), (30, 20)], [[(31, 11), (38, 11), (38, 19), (31, 19)]]
)


def test_ways_are_as_long_as_round_the_wall():
    """Round the end of a thin wall: the taut string's length and at most the lattice's 3 %."""
    scene = build_scene(small_problem(WALL, start_m=(19.0, 15.0), goal_m=(21.0, 15.0)))
    nodes = scene.road_map.nodes_m
    there = int(np.argmin(np.linalg.norm(nodes - (19.0, 15.0), axis=1)))
    taut = 2.0 * 10.0
    assert taut - 1.5 <= scene.ways.cost_m[there] <= 1.1 * taut + 3.0


def test_first_moves_keep_speed_and_clearance():
    """Every node within one clear step and no other, by brute force."""
    problem = small_problem(CUP)
    scene, at = build_scene(problem), np.array([13.1, 9.7])
    found, lengths = first_moves(scene.ground, problem, at)
    nodes = scene.road_map.nodes_m
    expected = [
        k
        for k, node in enumerate(nodes)
        if np.linalg.norm(node - at) <= 2.0 - 1e-6
        and shapely.LineString([at, node]).distance(CUP) >= 0.5
    ]
    assert 0 < len(expected) < (np.linalg.norm(nodes - at, axis=1) < 2.0).sum()
    assert sorted(found) == expected
    assert np.allclose(lengths, np.linalg.norm(nodes[found] - at, axis=1))


@pytest.mark.parametrize(
    ("polygons", "options"),
    [
        ((ROOM,), {}),
        ((shapely.box(15, 0, 25, 30),), {}),
        ((WALL, shapely.box(18, -1, 22, 5), shapely.box(18, 25, 22, 31)), {}),
        ((RING,), {"start_m": (20.0, 15.0)}),
        # A gate as wide as the robot needs, less a hair.
        ((shapely.box(15, 0, 25, 14.5), shapely.box(15, 15.49, 25, 30)), {}),
    ],
)
def test_goal_cut_off(polygons, options):
    """It is said which keys are at odds."""
    with pytest.raises(NoPlanError) as caught:
        build_scene(small_problem(*polygons, **options))
    for key in ("robots[0].goal_m", "start_m", "constraints.clearance_m"):
        assert key in str(caught.value)


def test_boxed_in_start():
    """Walls about the start nearer than any node."""
    pen = shapely.Polygon(
        [(3, 13), (7, 13), (7, 17), (3, 17)],
        [[(4.45, 14.45), (5.55, 14.45), (5.55, 15.55), (4.45, 15.55)]],
    )
    with pytest.raises(NoPlanError, match="start_m"):
        build_scene(small_problem(pen))


def test_goal_too_near_to_an_obstacle():
    """Nearer than the clearance: the goal can never be stood on."""
    problem = small_problem()
    beside = (Obstacle("beside", shapely.box(35.2, 14, 37, 16)),)
    near = replace(problem, workspace=replace(problem.workspace, obstacles=beside))
    with pytest.raises(NoPlanError, match=r"robots\[0\]\.goal_m .* constraints\.clearance_m 0\.5"):
        build_scene(near)


def test_a_way_that_the_lattice_misses_is_not_called_cut_off():
    """A slot a little wider than twice the clearance: there is a way, and the message says so."""
    walls = shapely.box(19.0, 0.0, 21.0, 14.31), shapely.box(19.0, 15.33, 21.0, 30.0)
    with pytest.raises(NoPlanError, match=r"although there is one .* planner\.step_s"):
        build_scene(small_problem(*walls))
    closed = shapely.box(19.0, 0.0, 21.0, 14.31), shapely.box(19.0, 15.29, 21.0, 30.0)
    with pytest.raises(NoPlanError, match="obstacles cut off"):
        build_scene(small_problem(*closed))
