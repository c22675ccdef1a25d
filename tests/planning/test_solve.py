"""One plan of a problem, its scene, and clear answers if there is no good one."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import CUP, RING, WALL, small_problem

from planopt import NoPlanError, Obstacle, Solution, Verdict, load
from planopt.planning.scene import build_scene, first_moves
from planopt.planning.solve import solve


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(load("open_field"))


@pytest.mark.parametrize("horizon", [1, 10])
def test_threshold_that_cannot_be_met(horizon):
    """No place on earth: violated, with numbers, and exit code 3."""
    problem = load("open_field")
    radio = replace(problem.stations[0], threshold_dbm=40.0)
    found = solve(replace(problem, stations=(radio,)), horizon=horizon)
    assert found.plan.verdict is Verdict.VIOLATED
    assert found.exit_code == 3
    assert "constraints.p_min 0.8" in found.plan.message
    assert "dB" in found.plan.message
    assert len(found.plan.certificate.relaxed_steps) == horizon


@pytest.mark.parametrize(
    ("verdict", "code"),
    [
        (Verdict.VERIFIED, 0),
        (Verdict.FEASIBLE_UNVERIFIED, 3),
        (Verdict.VIOLATED, 3),
        (Verdict.NONE, 4),
    ],
)
def test_exit_codes(solution, verdict, code):
    assert replace(solution, plans=(replace(solution.plan, verdict=verdict),)).exit_code == code


ROOM = shapely.Polygon(
    [(30, 10), (39, 10), (39, 20), (30, 20)], [[(31, 11), (38, 11), (38, 19), (31, 19)]]
)


def test_first_moves_keep_speed_and_clearance():
    """Every node within one clear step and no other, by brute force."""
    problem = small_problem(CUP)
    scene, at = build_scene(problem), np.array([13.1, 9.7])
    found, lengths = first_moves(scene, problem, at)
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
    for key in ("robots[0].goal_m", "the start [", "constraints.clearance_m"):
        assert key in str(caught.value)


def test_starts_and_goals_that_are_shut_in():
    """Walls nearer than any node, a goal within the clearance, slots that the lattice misses."""
    pen = shapely.Polygon(
        [(3, 13), (7, 13), (7, 17), (3, 17)],
        [[(4.45, 14.45), (5.55, 14.45), (5.55, 15.55), (4.45, 15.55)]],
    )
    with pytest.raises(NoPlanError, match="the start"):
        build_scene(small_problem(pen))
    problem = small_problem()
    beside = (Obstacle("beside", shapely.box(35.2, 14, 37, 16)),)
    near = replace(problem, workspace=replace(problem.workspace, obstacles=beside))
    with pytest.raises(
        NoPlanError, match=r"robots\[0\]\.goal_m .* constraints\.clearance_m = 0\.5"
    ):
        build_scene(near)
    walls = shapely.box(19.0, 0.0, 21.0, 14.31), shapely.box(19.0, 15.3101, 21.0, 30.0)
    with pytest.raises(NoPlanError, match=r"too coarse.* planner\.step_s"):
        build_scene(small_problem(*walls))
    closed = shapely.box(19.0, 0.0, 21.0, 14.31), shapely.box(19.0, 15.29, 21.0, 30.0)
    with pytest.raises(NoPlanError, match="obstacles separate"):
        build_scene(small_problem(*closed))
