"""Where a search for connection is steered to, and that it ends."""

from dataclasses import replace

import networkx
import numpy as np
import pytest
from scipy.stats import norm
from terms_scene import CONNECT, context_of, scorer_of, terms_problem

from planopt import Measurements
from planopt.channel import condition
from planopt.channel.kriging import predict
from planopt.objectives.terms.until_connected import charged_distance_m, search_length_m
from planopt.planning.loop.log import Outcome
from planopt.planning.scene import build_ground
from planopt.planning.search.steering import ConnectionSteering
from planopt.planning.solve import simulate
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.world import is_clear, swept_clearance_m

THRESHOLD_DBM = -33.0
"""Far above what is received where the robot of the small problem starts."""


def search_problem(start_m=(32.0, 34.0), threshold_dbm=THRESHOLD_DBM, **planner):
    """The small problem of finding connection, behind a wall and far from the station."""
    problem = terms_problem(CONNECT, **planner)
    robot = replace(problem.robots[0], start_m=start_m)
    stations = tuple(replace(own, threshold_dbm=threshold_dbm) for own in problem.stations)
    return replace(problem, robots=(robot,), stations=stations)


def known(problem, count=20):
    """StepContext and ground with few measurements, so that every prediction rests on all."""
    context, belief = context_of(problem)
    few = context.posterior
    kept = measured(few.measurements.positions_m[:count], few.measurements.power_dbm[:count])
    posterior = condition(few.parameters, kept)
    _, ground = scorer_of(context, belief)
    return replace(context, posteriors=(posterior,), steering=None), ground


def measured(places_m, power_dbm):
    """Measurements, none of them at a floor."""
    return Measurements(places_m, power_dbm, np.zeros(len(places_m), dtype=bool))


def steered(context, ground):
    """The way that a search is steered along."""
    problem = context.problem
    return ConnectionSteering(problem, ground, problem.terms[0]).find_path(context)


def oracle(context, ground):
    """Nodes, and by networkx and the formula written out how long a search by each is."""
    problem, road_map = context.problem, ground.road_map
    graph = networkx.DiGraph()
    for begin, end, length in zip(
        road_map.edge_from, road_map.edge_to, road_map.edge_length_m, strict=True
    ):
        graph.add_edge(int(begin), int(end), weight=float(length))
    nodes = road_map.nodes_m
    here = int(np.linalg.norm(nodes - context.position_m, axis=1).argmin())
    offset = float(np.linalg.norm(nodes[here] - context.position_m))
    ways = networkx.single_source_dijkstra_path_length(graph, here)
    length = np.array([ways.get(number, np.inf) + offset for number in range(len(nodes))])
    power = predict(context.posterior, nodes)
    score = (power.mean_db - problem.stations[0].threshold_dbm) / power.deviation_db
    chance = norm.cdf(score)
    apart = context.posterior.parameters.decorrelation_m
    found = length + apart / 3.0 * (1.0 - chance) / np.maximum(chance, 1e-12)
    spacing = 1.25 * problem.channel.measure_spacing_m
    measured_m = context.posterior.measurements
    failed = measured_m.power_dbm < problem.stations[0].threshold_dbm
    places = np.vstack([context.position_m, measured_m.positions_m[failed]])
    away = np.linalg.norm(nodes[:, None] - places, axis=2).min(axis=1)
    found[away < spacing] = np.inf
    return nodes, found


@pytest.mark.parametrize(
    ("start", "threshold"), [((32.0, 34.0), -33.0), ((32.0, 20.0), -36.0), ((8.0, 30.0), -30.0)]
)
def test_the_end_makes_for_the_shortest_search(start, threshold):
    """Of all nodes, by another shortest path and the formula written out."""
    context, ground = known(search_problem(start, threshold))
    way = steered(context, ground)
    nodes, lengths = oracle(context, ground)
    end = int(np.linalg.norm(nodes - way.end_m, axis=1).argmin())
    np.testing.assert_allclose(nodes[end], way.end_m)
    assert lengths[end] == pytest.approx(lengths.min(), rel=1e-6)
    away = swept_clearance_m(ground.index, way.turns_m)
    assert is_clear(away, context.problem.constraints.clearance_m).all()


def test_one_more_connected_place_never_makes_the_search_longer():
    """Nor does a higher chance anywhere, or a nearer place; whatever it is, by drawing tries."""
    generator = np.random.default_rng(0)
    chance, length = generator.uniform(0.05, 1.0, 50), generator.uniform(1.0, 80.0, 50)
    found = search_length_m(length, chance, 10.0)
    assert (search_length_m(length, np.minimum(chance + 0.1, 1.0), 10.0) <= found).all()
    assert (search_length_m(0.5 * length, chance, 10.0) < found).all()
    np.testing.assert_allclose(search_length_m(length, np.ones(50), 10.0), length)
    tries = generator.geometric(chance, (40_000, 50))
    drawn = length + (tries - 1) * 10.0 / 3.0
    error = 5.0 * drawn.std(axis=0) / 200.0
    assert (abs(drawn.mean(axis=0) - found) < error + 1e-9).all()


def test_a_plan_is_charged_the_way_that_is_left():
    """And after it what a failed try is expected to cost; more, the farther it ends away."""
    problem = search_problem(horizon=3)
    context, ground = known(problem)
    way = steered(context, ground)
    context = replace(context, steering=way)
    path = way.path_m(3, problem.step_length_m)
    legs = np.linalg.norm(np.diff(np.vstack([context.position_m, path]), axis=0), axis=1)
    assert (legs <= problem.step_length_m + 1e-9).all()
    term = problem.terms[0]
    power = predict(context.posterior, way.end_m[None])
    chance = norm.cdf((power.mean_db[0] - THRESHOLD_DBM) / power.deviation_db[0])
    whole = float(np.linalg.norm(np.diff(way.turns_m, axis=0), axis=1).sum())
    apart = context.posterior.parameters.decorrelation_m
    search = whole + apart / 3.0 * (1.0 - chance) / chance
    search = min(search, whole + np.hypot(40.0, 40.0))
    after = search - legs.sum()
    expected = charged_distance_m(
        context.posteriors, path, replace(term.search(context), beyond_m=after)
    )
    assert ObjectiveValue(context)(path) == pytest.approx(-expected, rel=1e-6)
    still = np.tile(context.position_m, (3, 1))
    assert ObjectiveValue(context)(path) > ObjectiveValue(context)(still)


@pytest.mark.parametrize("horizon", [1, 5])
@pytest.mark.parametrize(
    ("name", "stations"), [("auto", 1), ("auto", 2), ("lattice", 1), ("one_step", 1)]
)
def test_every_planner_arrives_and_never_stands(name, stations, horizon):
    """Round the wall, from 36 m away, whatever the planner and however many stations.

    Tries near each other are worth short steps, but no two in a row that are hardly any.
    """
    problem = search_problem(
        horizon=horizon, max_steps=60, name=name, stations=stations, threshold_dbm=-31.0
    )
    run = simulate(problem, seed=3).runs[0]
    assert run.outcome is Outcome.COMPLETED, run.reason
    steps = np.linalg.norm(np.diff(run.log.positions_m, axis=0), axis=1)
    assert (steps[1:] + steps[:-1]).min() > 0.2 * problem.step_length_m


def test_a_mirrored_scene_steers_to_the_mirrored_place():
    """The wall is its own mirror image; station, measurements and start are mirrored."""

    def mirror(places):
        return np.asarray(places) * [-1.0, 1.0] + [40.0, 0.0]

    context, ground = known(search_problem((32.0, 20.0), -36.0))
    way = steered(context, ground)
    parameters, taken = context.posterior.parameters, context.posterior.measurements
    station = replace(parameters.station, position_m=tuple(mirror(parameters.station.position_m)))
    posterior = condition(
        replace(parameters, station=station), measured(mirror(taken.positions_m), taken.power_dbm)
    )
    there = tuple(float(part) for part in mirror(context.position_m))
    problem = search_problem(there, -36.0)
    other = replace(
        context, problem=problem, posteriors=(posterior,), state=mirror(context.position_m)
    )
    found = steered(other, build_ground(problem, other.position_m))
    np.testing.assert_allclose(mirror(found.turns_m), way.turns_m, atol=1e-9)
