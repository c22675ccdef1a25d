"""The pivot: on the way, seen from the path's end, and of consistent cost."""

import numpy as np
import pytest
import shapely
from scenes import small_problem

from planopt.planning.scene import build_scene
from planopt.planning.search.global_search import (
    LATTICE_DETOUR,
    LOOKAHEAD_STEPS,
    Ahead,
    GlobalStart,
    find_pivot,
)
from planopt.planning.tolerances import STEP_PAD_M
from planopt.world import lattice_paths, route_from

WALL = shapely.box(19.0, -1.0, 21.0, 22.0)
BLOCK = shapely.Polygon([(26.0, 8.0), (31.0, 12.0), (27.0, 17.0)])


def start_at(scene, node, ways=None, horizon=4, metre_cost=None):
    """A start path that ends at a node; how it came there does not matter."""
    nodes = np.full(horizon, node)
    return GlobalStart(
        nodes=nodes,
        path_m=scene.road_map.nodes_m[nodes],
        margin_db=np.zeros(horizon),
        route_m=np.zeros((0, 2)),
        beyond_m=np.zeros((0, 2)),
        cost_to_go=scene.cost_to_go if ways is None else ways,
        metre_cost=np.ones(len(scene.road_map.nodes_m)) if metre_cost is None else metre_cost,
        is_blocked=False,
    )


def to_go_m(pivot, place):
    """What a pivot says the way on from a place costs."""
    return pivot.cost_m + pivot.metre_cost * float(np.linalg.norm(pivot.position_m - place))


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
        if not np.isfinite(scene.cost_to_go.cost_m[node]):
            continue
        pivot = find_pivot(scene, start_at(scene, node, None, horizon), None, step, clearance)
        way = route_from(scene.road_map, scene.cost_to_go, node, LOOKAHEAD_STEPS * step)
        on_way = np.flatnonzero((places[way] == pivot.position_m).all(axis=1))
        assert len(on_way) == 1
        index = int(on_way[0])
        assert pivot.cost_m == scene.cost_to_go.cost_m[way[index]]
        ahead = np.linalg.norm(places[way] - places[node], axis=1)
        assert to_go_m(pivot, places[node]) == pytest.approx(
            scene.cost_to_go.cost_m[node], rel=1e-12
        )
        assert 1.0 <= pivot.metre_cost <= (1.0 + LATTICE_DETOUR if index <= 1 else np.inf)
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


def test_from_beside_the_path_the_joining_metres_count_too():
    """Seen from elsewhere: the metres to the path's end, at what they cost there, and the rest."""
    problem = small_problem()
    scene = build_scene(problem)
    places = scene.road_map.nodes_m
    metre_cost = np.where(places[:, 0] < 14.0, 3.0, 1.0)
    ways = lattice_paths(scene.road_map, scene.goal_node, metre_cost)
    node = int(np.argmin(np.linalg.norm(places - [10.0, 15.0], axis=1)))
    start = start_at(scene, node, ways, metre_cost=metre_cost)
    for beside in ([9.3, 15.4], [10.5, 14.0], [8.4, 15.0]):
        pivot = find_pivot(scene, start, None, 2.0, 0.5, np.array(beside))
        joining = 3.0 * np.linalg.norm(places[node] - beside)
        assert to_go_m(pivot, beside) == pytest.approx(joining + ways.cost_m[node], rel=1e-12)


@pytest.mark.parametrize("price", [0.0, 4.0])
def test_the_way_on_against_every_node_within_a_step(price):
    """Cheapest of all nodes seen within a step by hand, unless the pivot is seen and cheaper."""
    problem = small_problem(WALL, BLOCK)
    scene = build_scene(problem)
    places, step = scene.road_map.nodes_m, problem.step_length_m
    metre_cost = 1.0 + price * (np.hypot(places[:, 0] - 12.0, places[:, 1] - 20.0) < 5.0)
    ways = lattice_paths(scene.road_map, scene.goal_node, metre_cost)
    generator, by_pivot, by_node = np.random.default_rng(1), 0, 0
    for around in ([8.0, 16.0], [16.0, 21.0], [24.0, 20.0]):
        node = int(np.argmin(np.linalg.norm(places - around, axis=1)))
        ahead = Ahead(problem, scene, start_at(scene, node, ways, 4, metre_cost), None)
        assert to_go_m(ahead(places[node]), places[node]) <= ways.cost_m[node] + 1e-9
        for end in places[node] + generator.uniform(-3.0, 3.0, (40, 2)):
            length = np.linalg.norm(places - end, axis=1)
            near = [
                k
                for k in np.flatnonzero(length <= step - STEP_PAD_M)
                if sight((WALL, BLOCK), end, places[k]) >= 0.5
            ]
            if not near:
                assert ahead(end) is ahead.pivot
                continue
            nearest = min(near, key=lambda k, length=length: length[k])
            metre = 0.5 * (metre_cost[near] + metre_cost[nearest])
            expected = (metre * length[near] + ways.cost_m[near]).min()
            found, pivot = to_go_m(ahead(end), end), ahead.pivot
            in_view = sight((WALL, BLOCK), end, pivot.position_m) >= 0.5
            if in_view and np.linalg.norm(places[node] - end) <= step:
                by_pivot += to_go_m(pivot, end) < expected
                expected = min(expected, to_go_m(pivot, end))
            else:
                by_node += 1
            assert found == pytest.approx(expected, rel=1e-9)
    assert by_pivot > 5 and by_node > 5


def test_the_leading_pivot_is_ahead_of_a_whole_horizon():
    """It is farther off than a path could come to early, or the goal, and costs what is to go."""
    problem = small_problem(WALL)
    scene = build_scene(problem)
    places, horizon = scene.road_map.nodes_m, 40
    node = int(np.argmin(np.linalg.norm(places - [6.0, 9.0], axis=1)))
    ahead = Ahead(problem, scene, start_at(scene, node, horizon=horizon), None)
    room = LATTICE_DETOUR * horizon * problem.step_length_m
    for end in ([6.3, 9.2], [15.2, 20.1], [25.7, 18.3], [33.1, 15.2]):
        pivot = ahead.leading(np.array(end))
        is_goal = np.allclose(pivot.position_m, problem.robots[0].goal_m)
        assert is_goal or np.linalg.norm(pivot.position_m - end) >= room
        assert to_go_m(pivot, end) == pytest.approx(to_go_m(ahead(np.array(end)), end), rel=0.05)


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
