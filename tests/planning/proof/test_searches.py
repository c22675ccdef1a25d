"""The verifier's searches, against networkx, exact geometry and brute force."""

import networkx as nx
import numpy as np
import pytest
import shapely
from scenes import CUP, RING, WALL, small_problem

from planopt.planning.proof.searches import (
    COARSE,
    JOINING_SPACINGS,
    MOVES,
    SPACING_STEPS,
    best_margins_by_step,
    build_goal_grid,
    goal_costs,
    price_path,
)
from planopt.world import index_obstacles

START, GOAL = np.array([5.0, 15.0]), np.array([35.0, 15.0])
"""A path along sixteen headings is at most this many times as long as the straight one."""


def grid_with(problem):
    """The grid, and the index of the obstacles."""
    index = index_obstacles(problem.workspace)
    return build_goal_grid(problem, index), index


def contact(share_at):
    """What the price is charged on, and margins of which some are positive."""
    return lambda places: (share_at(places), 1.0 - 2.0 * share_at(places))


def nowhere_charged(places):
    return np.zeros(len(places))


def band(low, high, open_above=np.inf):
    """Out of contact in an upright band."""
    return lambda q: np.where((q[:, 0] > low) & (q[:, 0] < high) & (q[:, 1] < open_above), 1.0, 0.0)


def priced(problem, share_at, price, path_m):
    """What a path costs and the cheapest that is found."""
    grid, index = grid_with(problem)
    costs = goal_costs(grid, contact(share_at), price)
    path = np.atleast_2d(np.asarray(path_m, dtype=float))
    if len(path) == 1:
        path = np.repeat(path, 2, axis=0)
    return price_path(grid, index, costs, price, path, share_at(path))


def by_networkx(problem, grid, share, price):
    """Cost-to-go of every node: moves written out as numbers, clearance by shapely."""
    spacing = SPACING_STEPS * problem.step_length_m
    obstacles = shapely.union_all([o.polygon for o in problem.workspace.obstacles])
    number = {
        tuple(np.rint((q - GOAL) / spacing).astype(int)): k for k, q in enumerate(grid.nodes_m)
    }
    graph = nx.Graph()
    graph.add_nodes_from(number.values())
    for (column, row), node in number.items():
        for down, right in MOVES:
            other = number.get((column + right, row + down))
            if other is None:
                continue
            line = shapely.LineString(grid.nodes_m[[node, other]])
            if line.distance(obstacles) < problem.constraints.clearance_m:
                continue
            metre = 1.0 + price * (share[node] + share[other]) / 2.0
            graph.add_edge(node, other, weight=line.length * metre)
    goal = number[0, 0]
    lengths = nx.single_source_dijkstra_path_length(graph, goal)
    return np.array([lengths.get(k, np.inf) for k in range(len(grid.nodes_m))])


@pytest.mark.parametrize("price", [0.0, 0.7, 10.0])
@pytest.mark.parametrize("polygons", [(WALL,), (CUP,), (RING,)])
def test_cost_to_go_against_networkx(polygons, price):
    """The cost of every node, with a share that bends over the workspace."""
    problem = small_problem(*polygons)
    grid, _ = grid_with(problem)

    def share_at(places):
        return 0.5 + 0.4 * np.sin(places[:, 0] / 3.0) * np.cos(places[:, 1] / 4.0)

    costs = goal_costs(grid, contact(share_at), price)
    expected = by_networkx(problem, grid, costs.share, price)
    np.testing.assert_allclose(costs.to_goal_m, expected, rtol=1e-12)
    np.testing.assert_array_equal(grid.nodes_m[grid.goal], GOAL)


def test_shares_are_interpolated_between_coarse_places():
    """A linear share is met exactly up to the last coarse row; weights are a mean's."""
    problem = small_problem(CUP)
    grid, _ = grid_with(problem)
    np.testing.assert_allclose(grid.weights.sum(axis=1), 1.0)
    assert (grid.weights >= 0.0).all()
    means = (grid.coarse_m[grid.corners] * grid.weights[..., None]).sum(axis=1)
    last = grid.coarse_m.max(axis=0)
    np.testing.assert_allclose(means, np.minimum(grid.nodes_m, last), atol=1e-9)
    apart = COARSE * SPACING_STEPS * problem.step_length_m
    farthest = np.linalg.norm(grid.coarse_m[grid.corners] - grid.nodes_m[:, None], axis=2)
    assert farthest[grid.weights > 0.0].max() < np.sqrt(2.0) * apart


def test_a_place_is_joined_to_what_it_sees():
    """Beside a wall no node beyond it counts, however near."""
    thin = shapely.box(19.95, -1.0, 20.05, 25.0)
    problem = small_problem(thin, clearance_m=0.1)
    left = priced(problem, nowhere_charged, 0.0, [(19.7, 15.0)])
    right = priced(problem, nowhere_charged, 0.0, [(20.3, 15.0)])
    assert right.best_m == pytest.approx(35.0 - 20.3, abs=1.0)
    assert left.best_m > np.hypot(15.0, 10.0) + 10.0
    assert JOINING_SPACINGS * SPACING_STEPS * problem.step_length_m > 20.3 - 19.7


def boxes(rng, count):
    """Boxes of at least 3 m that leave start and goal alone."""
    found = []
    while len(found) < count:
        x, y = rng.uniform((0, -10), (34, 24))
        box = shapely.box(x, y, x + rng.uniform(3, 8), y + rng.uniform(3, 30))
        if min(box.distance(shapely.Point(START)), box.distance(shapely.Point(GOAL))) > 3.0:
            found.append(box)
    return found


def joined(forbidden, grown_m):
    """Whether start and goal are in one part of the workspace less a grown or shrunk geometry."""
    free = shapely.box(0.0, 0.0, 40.0, 30.0).difference(forbidden.buffer(grown_m))
    parts = shapely.get_parts(free)
    here = [k for k, p in enumerate(parts) if p.distance(shapely.Point(START)) < 1e-9]
    there = [k for k, p in enumerate(parts) if p.distance(shapely.Point(GOAL)) < 1e-9]
    return bool(set(here) & set(there))


def test_paths_against_exact_geometry():
    """Parts of the exact free space decide, but for passages as narrow as the grid: 60 scenes."""
    rng = np.random.default_rng(11)
    answers = []
    for _ in range(60):
        obstacles = boxes(rng, 6)
        found = priced(small_problem(*obstacles), nowhere_charged, 10.0, [START])
        forbidden = shapely.union_all(obstacles)
        wide, narrow = joined(forbidden, 1.8), joined(forbidden, 0.49)
        if wide:
            assert np.isfinite(found.best_m)
        if not narrow:
            assert found.best_m == np.inf
        answers.append((wide, narrow))
    assert answers.count((True, True)) >= 10
    assert answers.count((False, False)) >= 5


ORIGIN = np.array([5.0, 15.0])
BOUNDS = (0.0, 0.0, 40.0, 30.0)


def index_of(*polygons):
    return index_obstacles(small_problem(*polygons).workspace)


def best_margin_within_reach(index, margin, start, radius, clearance, bounds=(-60, -60, 100, 90)):
    """The best margin by the first step of this length."""
    return best_margins_by_step(index, bounds, margin, start, radius, np.array([1]), clearance)[0]


def test_best_place_against_a_dense_grid():
    """A rough margin with many peaks: not worse than a grid six times as fine but for a little."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(0.0, 0.6, (8, 2)), rng.uniform(0.0, 6.0, 8)

    def margin(q):
        return np.sin(q @ waves.T + phases).sum(1) - 10.0

    x, y = np.meshgrid(np.linspace(-6, 6, 301), np.linspace(-6, 6, 301))
    places = ORIGIN + np.stack([x, y], -1).reshape(-1, 2)
    places = places[np.linalg.norm(places - ORIGIN, axis=1) <= 6.0]
    best = best_margin_within_reach(index_of(), margin, ORIGIN, 6.0, 0.5)
    assert best == pytest.approx(margin(places).max(), abs=0.05)


def spot(x, y, radius):
    """A margin of 1 dB in a disc, -1 dB about it."""
    return lambda q: np.where(np.hypot(q[:, 0] - x, q[:, 1] - y) <= radius, 1.0, -1.0)


def first_possible(index, margin, start, clearance, step_m=2.0, steps=30):
    """The first step by which the bound could be met; None if none."""
    best = best_margins_by_step(
        index, BOUNDS, margin, start, step_m, np.arange(1, steps + 1), clearance
    )
    return next((step for step, value in enumerate(best, start=1) if value >= 0.0), None)


@pytest.mark.parametrize("clearance", [0.0, 0.1, 0.5])
def test_walls_thinner_than_the_grid_are_walls(clearance):
    """From a courtyard with walls of 2 cm nothing outside is in reach, however long it takes."""
    outer = shapely.box(10, 10, 20, 20)
    yard = index_of(outer.difference(shapely.box(10.02, 10.02, 19.98, 19.98)))
    inside, outside = np.array([15.0, 15.0]), spot(22.0, 15.0, 1.0)
    assert first_possible(yard, outside, inside, clearance) is None
    assert first_possible(index_of(), outside, inside, clearance) == 3


def test_good_places_in_lanes_between_the_nodes():
    """A good lane as narrow as a fifth of the grid's spacing is found between its nodes."""
    lane = index_of(shapely.box(5.6, 15.57, 30, 29), shapely.box(5.6, 1, 30, 15.43))
    found = first_possible(lane, spot(9.0, 15.5, 1.0), ORIGIN, 0.02)
    assert found is not None
    assert 2 <= found <= 3
