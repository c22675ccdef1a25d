"""The global start: a lattice path that keeps the bound wherever one can."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import scipy.stats
from scenes import (
    CUP,
    bad_band,
    bad_disc,
    belief_of,
    context_of,
    good_everywhere,
    kriged,
    search_of,
    small_problem,
    verified,
)

from planopt.planning.plan import BEGINNING
from planopt.planning.search import global_search
from planopt.planning.search.global_search import FORBIDDEN, Ahead, GlobalStart
from planopt.problems.problem import outage_share


def found(problem, power_at=good_everywhere) -> GlobalStart:
    """The start path from the problem's start."""
    search, belief, _ = search_of(problem, power_at)
    start = search.find_start(context_of(problem, belief, np.asarray(problem.robots[0].start_m)))
    assert start is not None
    return start


@pytest.mark.parametrize("cost_to_go", ["geodesic", "connected"])
@pytest.mark.parametrize("horizon", [1, 5, 25])
def test_path_is_one_that_can_be_driven(cost_to_go, horizon):
    """N nodes, and the verifier has nothing against it."""
    problem = small_problem(CUP, cost_to_go=cost_to_go, horizon=horizon, start_m=(18.0, 15.0))
    search, belief, scene = search_of(problem)
    at = np.asarray(problem.robots[0].start_m)
    start = search.find_start(context_of(problem, belief, at))
    assert start.path_m.shape == (horizon, 2)
    assert (scene.road_map.nodes_m[start.nodes] == start.path_m).all()
    path = np.vstack([at, start.path_m])
    found = verified(problem, scene.index, belief.posterior, at, path)
    assert found.certificate.reasons == ()
    assert not start.is_direct and not start.is_blocked


def test_margins_are_exact_along_the_path():
    """Kriging written out, at every node of it."""
    problem, power = small_problem(horizon=10), bad_disc(14.0, 15.0, 3.0)
    start = found(problem, power)
    mean, deviation = kriged(belief_of(problem, power), start.path_m)
    margin = mean - scipy.stats.norm.ppf(0.9) * deviation + 80.0
    assert np.allclose(start.margin_db, margin, atol=1e-6)
    assert (margin >= 0.0).all()


def test_below_the_bound_only_as_long_as_must_be():
    """Out of a hole by the straightest way: no more steps below than the fastest needs."""
    start = found(small_problem(horizon=8), bad_disc(5.0, 15.0, 5.0))
    below = np.nonzero(start.margin_db < 0.0)[0]
    assert list(below) == [0, 1]


def test_geodesic_goes_straight_connected_goes_round():
    """Before a wide hole in the bound the two costs to go part."""
    power = bad_band(18.0, 24.0, open_above_m=20.0)
    ends = {
        cost: found(small_problem(start_m=(12.0, 15.0), cost_to_go=cost, horizon=5), power).path_m[
            -1
        ]
        for cost in ("geodesic", "connected")
    }
    assert ends["connected"][1] > ends["geodesic"][1] + 2.0


@pytest.mark.parametrize(
    ("price", "charge", "slack_max_db"),
    [
        (0.0, "below_p_min", None),
        (0.5, "below_p_min", None),
        (10.0, "below_p_min", None),
        (10.0, "everywhere", None),
        (10.0, "everywhere", 0.0),
    ],
)
def test_cost_to_go_against_networkx(price, charge, slack_max_db):
    """Every node's, with the price of its own P(connected) written out; a hard bound forbids."""
    problem = small_problem(CUP, start_m=(12.0, 15.0), horizon=3)
    problem = replace(problem, objective=replace(problem.objective, outage_price=price))
    problem = replace(problem, objective=replace(problem.objective, outage_charge=charge))
    rule = replace(problem.constraints.rule, slack_max_db=slack_max_db)
    problem = replace(problem, constraints=replace(problem.constraints, rule=rule))
    power = bad_disc(20.0, 4.0, 6.0)
    search, belief, scene = search_of(problem, power)
    start = search.find_start(context_of(problem, belief, np.array([12.0, 15.0])))
    road_map = scene.road_map
    corrected = search.margins
    z = (corrected.mean_db + 80.0) / corrected.deviation_db
    below = z < scipy.stats.norm.ppf(0.9) + 1e-9
    share = outage_share(scipy.stats.norm.cdf(z), below)
    if charge == "everywhere":
        share = scipy.stats.norm.sf(z)
    counted = 1.0 + price * share
    if slack_max_db is not None:
        counted = np.where(below, FORBIDDEN, counted)
    graph = nx.DiGraph()
    for node, sources in enumerate(road_map.sources.tolist()):
        for move, source in enumerate(sources):
            if source < len(share):
                metres = road_map.lengths_m[move] * 0.5 * (counted[source] + counted[node])
                graph.add_edge(node, source, weight=metres)
    lengths = nx.single_source_dijkstra_path_length(graph, scene.goal_node)
    expected = np.array([lengths.get(node, np.inf) for node in range(len(road_map.nodes_m))])
    assert start.cost_to_go.cost_m == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("charge", ["below_p_min", "everywhere"])
def test_a_place_that_keeps_the_bound_is_free_or_charged(charge):
    """A band of P about 0.3 with p_min 0.05: only who is charged everywhere goes round it."""
    problem = small_problem(start_m=(12.0, 15.0), goal_m=(35.0, 15.0), horizon=10)
    problem = replace(
        problem,
        constraints=replace(problem.constraints, p_min=0.05),
        objective=replace(problem.objective, outage_charge=charge),
    )

    def power(places):
        x, y = places.T
        return np.where((x > 18.0) & (x < 24.0) & (y < 20.0), -81.0, -60.0)

    start = found(problem, power)
    way = np.vstack([start.path_m, start.route_m])
    assert bool((way[:, 1] > 18.0).any()) == (charge == "everywhere")


def test_a_hard_bound_is_never_crossed():
    """Where slack is bounded at each step a start that leads across says that it is blocked."""
    problem = small_problem(start_m=(9.0, 15.0))
    rule = replace(problem.constraints.rule, slack_max_db=0.0)
    problem = replace(problem, constraints=replace(problem.constraints, rule=rule))
    assert found(problem, bad_band(18.0, 24.0)).is_blocked
    assert not found(problem, bad_band(18.0, 24.0, open_above_m=20.0)).is_blocked


def test_who_has_wandered_drives_the_shortest_path():
    """After as many steps as the dearest direct path has, and after going in circles."""
    problem = small_problem(start_m=(9.0, 15.0), horizon=5)
    power = bad_band(18.0, 24.0, open_above_m=20.0)
    search, belief, _ = search_of(problem, power)
    here = np.array([9.0, 15.0])
    most = int(11.0 * 26.0 / problem.step_length_m)
    for history, direct in (
        (BEGINNING, False),
        (replace(BEGINNING, steps=most - 1), False),
        (replace(BEGINNING, steps=most + 2), True),
        (replace(BEGINNING, has_circled=True), True),
    ):
        start = search.find_start(context_of(problem, belief, here, history))
        assert start.is_direct == direct
    assert start.path_m[:, 1] == pytest.approx(15.0, abs=2.0)


@pytest.mark.parametrize("jump", [False, True])
def test_nodes_far_behind_are_left_out_and_change_no_path(jump, monkeypatch):
    """A search that looked before finds what a fresh one finds, even if the robot is elsewhere."""
    monkeypatch.setattr(global_search, "BACK_STEPS", 3)
    problem = small_problem(horizon=5)
    search, belief, scene = search_of(problem)
    nodes_m = scene.road_map.nodes_m
    away = np.linalg.norm(nodes_m - np.asarray(problem.goal_m), axis=1)
    near, far = nodes_m[np.argsort(away)[3]], nodes_m[np.argmax(away)]
    search.find_start(context_of(problem, belief, near))
    context = context_of(problem, belief, far if jump else near)
    again, fresh = search.find_start(context), search_of(problem)[0].find_start(context)
    assert again is not None and fresh is not None
    assert (again.nodes == fresh.nodes).all() and (again.route_m == fresh.route_m).all()
    known = np.isfinite(again.cost_to_go.cost_m)
    assert known.all() == jump and known[away <= 3.0 * problem.step_length_m].all()
    assert (again.cost_to_go.cost_m[known] == fresh.cost_to_go.cost_m[known]).all()
    ahead = [Ahead(problem, scene, start, None)(far) for start in (again, fresh)]
    assert ahead[0].cost_m == ahead[1].cost_m
    assert (ahead[0].position_m == ahead[1].position_m).all()
