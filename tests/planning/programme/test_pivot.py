"""The pivot: on the way, seen from the path's end, and of consistent cost."""

import numpy as np
import pytest
import shapely
from scenes import small_problem

from planopt.planning.programme.pivot import LATTICE_DETOUR, LOOKAHEAD_STEPS, find_pivot
from planopt.planning.scene import build_scene
from planopt.planning.search.global_search import GlobalStart
from planopt.world.road_map import shortest_ways, way_from

WALL = shapely.box(19.0, -1.0, 21.0, 22.0)
BLOCK = shapely.Polygon([(26.0, 8.0), (31.0, 12.0), (27.0, 17.0)])


def start_at(scene, node, ways=None, horizon=4):
    """A start path that ends at a node; how it came there does not matter."""
    nodes = np.full(horizon, node)
    return GlobalStart(
        nodes=nodes,
        path_m=scene.road_map.nodes_m[nodes],
        margin_db=np.zeros(horizon),
        beyond_m=np.zeros((0, 2)),
        ways=scene.ways if ways is None else ways,
        crossing=False,
    )


def sight(scene_polygons, a, b):
    """Distance of the line of sight from the obstacles."""
    line = shapely.LineString([a, b])
    return min((line.distance(p) for p in scene_polygons), default=np.inf)


@pytest.mark.parametrize("horizon", [4, 40, 200])
@pytest.mark.parametrize("polygons", [(), (WALL,), (WALL, BLOCK)])
def test_from_every_node(polygons, horizon):
    """Everywhere: on the way, of consistent cost, and the last of it seen, if far enough."""
    problem = small_problem(*polygons)
    scene = build_scene(problem)
    clearance, step = problem.constraints.clearance_m, problem.step_length_m
    places = scene.road_map.nodes_m
    room = LATTICE_DETOUR * horizon * step
    hidden = 0
    for node in range(0, len(places), 13):
        if not np.isfinite(scene.ways.cost_m[node]):
            continue
        pivot = find_pivot(scene, start_at(scene, node, None, horizon), None, step, clearance)
        way = way_from(scene.road_map, scene.ways, node, LOOKAHEAD_STEPS * step)
        on_way = np.flatnonzero((places[way] == pivot.position_m).all(axis=1))
        assert len(on_way) == 1
        index = int(on_way[0])
        assert pivot.cost_m == scene.ways.cost_m[way[index]]
        ahead = np.linalg.norm(places[way] - places[node], axis=1)
        assert pivot.cost_m + ahead[index] <= scene.ways.cost_m[node] + 1e-9
        in_sight = [sight(polygons, places[node], p) >= clearance for p in places[way]]
        last_seen = (in_sight.index(False) if False in in_sight else len(way)) - 1
        assert index >= last_seen
        if index > last_seen:
            # Hidden only where nothing seen is far enough ahead; then the first that is.
            hidden += 1
            assert (ahead[:index] < room).all()
            assert ahead[index] >= room or index == len(way) - 1
        else:
            assert ahead[index] >= min(room, ahead.max())
    # Room for a long horizon is more than what some places just before a corner see.
    if horizon == 40 and len(polygons) == 2:
        assert hidden > 0
    if not polygons:
        assert hidden == 0


def test_free_space_looks_as_far_as_allowed():
    """Nothing in the way: the place five steps on, or the goal if that is nearer."""
    problem = small_problem()
    scene = build_scene(problem)
    step = problem.step_length_m
    places = scene.road_map.nodes_m
    far = int(np.argmin(np.linalg.norm(places - [10.0, 15.0], axis=1)))
    pivot = find_pivot(scene, start_at(scene, far), None, step, 0.5)
    ahead = np.linalg.norm(pivot.position_m - places[far])
    assert LOOKAHEAD_STEPS * step / 1.03 <= ahead <= (LOOKAHEAD_STEPS + 1.0) * step
    near = int(np.argmin(np.linalg.norm(places - [32.0, 15.0], axis=1)))
    pivot = find_pivot(scene, start_at(scene, near), None, step, 0.5)
    np.testing.assert_allclose(pivot.position_m, problem.robots[0].goal_m)
    assert pivot.cost_m == 0.0


def test_at_the_goal_the_pivot_is_the_goal():
    """A path that ends there has nothing beyond it."""
    problem = small_problem(WALL)
    scene = build_scene(problem)
    pivot = find_pivot(scene, start_at(scene, scene.goal_node), None, 2.0, 0.5)
    np.testing.assert_allclose(pivot.position_m, problem.robots[0].goal_m)
    assert pivot.cost_m == 0.0


def test_behind_a_wall_the_pivot_is_before_its_corner():
    """The goal is hidden: the pivot is this side of the wall's end, and seen."""
    problem = small_problem(WALL)
    scene = build_scene(problem)
    places = scene.road_map.nodes_m
    node = int(np.argmin(np.linalg.norm(places - [17.0, 15.0], axis=1)))
    pivot = find_pivot(scene, start_at(scene, node), None, 2.0, 0.5)
    assert pivot.position_m[0] < 19.0
    assert sight((WALL,), places[node], pivot.position_m) >= 0.5
    assert pivot.cost_m > np.linalg.norm(pivot.position_m - problem.robots[0].goal_m)


def test_weighted_ways_keep_the_cost_consistent():
    """With factors of 1 and more on the nodes the pivot's cost plus distance is still no more."""
    problem = small_problem(BLOCK)
    scene = build_scene(problem)
    places = scene.road_map.nodes_m
    factor = 1.0 + 4.0 * (places[:, 1] > 12.0)
    ways = shortest_ways(scene.road_map, scene.goal_node, factor)
    for node in range(5, len(places), 101):
        pivot = find_pivot(scene, start_at(scene, node, ways), None, 2.0, 0.5)
        ahead = float(np.linalg.norm(pivot.position_m - places[node]))
        assert pivot.cost_m + ahead <= ways.cost_m[node] + 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_pivot_beyond_a_change_of_connectivity(sign):
    """With the bound to be kept, the pivot is on the same side of it as the path's end."""
    problem = small_problem()
    scene = build_scene(problem)
    places = scene.road_map.nodes_m
    node = int(np.argmin(np.linalg.norm(places - [10.0, 15.0], axis=1)))
    margin = sign * (14.0 - places[:, 0])
    pivot = find_pivot(scene, start_at(scene, node), margin, 2.0, 0.5)
    assert 12.0 <= pivot.position_m[0] <= 14.0
    free = find_pivot(scene, start_at(scene, node), None, 2.0, 0.5)
    assert free.position_m[0] > 18.0
    same = find_pivot(scene, start_at(scene, node), np.full(len(places), sign), 2.0, 0.5)
    np.testing.assert_array_equal(same.position_m, free.position_m)


def test_an_end_cut_off_by_the_bound_is_its_own_pivot():
    """Where the very next place of the way changes sides, the pivot is the end itself."""
    problem = small_problem()
    scene = build_scene(problem)
    places = scene.road_map.nodes_m
    node = int(np.argmin(np.linalg.norm(places - [10.0, 15.0], axis=1)))
    margin = np.full(len(places), -1.0)
    margin[node] = 1.0
    pivot = find_pivot(scene, start_at(scene, node), margin, 2.0, 0.5)
    np.testing.assert_array_equal(pivot.position_m, places[node])
    assert pivot.cost_m == scene.ways.cost_m[node]


def test_a_mirrored_scene_keeps_the_costs():
    """Turning the world upside down keeps the cost to go, which bounds the pivot's in both."""
    flip = [shapely.transform(p, lambda xy: xy * [1.0, -1.0] + [0.0, 30.0]) for p in (WALL, BLOCK)]
    here, there = build_scene(small_problem(WALL, BLOCK)), build_scene(small_problem(*flip))
    a, b = here.road_map.nodes_m, there.road_map.nodes_m
    for place in ([6.0, 9.0], [16.0, 23.0], [23.0, 24.0]):
        one = int(np.argmin(np.linalg.norm(a - place, axis=1)))
        two = int(np.argmin(np.linalg.norm(b - (a[one] * [1.0, -1.0] + [0.0, 30.0]), axis=1)))
        first = find_pivot(here, start_at(here, one), None, 2.0, 0.5)
        second = find_pivot(there, start_at(there, two), None, 2.0, 0.5)
        to_go = [
            p.cost_m + np.linalg.norm(p.position_m - at)
            for p, at in ((first, a[one]), (second, b[two]))
        ]
        # Among ways of equal length either may be taken, and they differ in what they see.
        assert here.ways.cost_m[one] == pytest.approx(there.ways.cost_m[two])
        assert max(to_go) <= here.ways.cost_m[one] + 1e-9
