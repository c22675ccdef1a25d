"""Strategies of communication and bounds: what they assume, and what nobody exceeds."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from terms_scene import LEARNING, TRACKING, judge_of, situation_of, terms_problem

from planopt import simulate
from planopt.channel.ground_truth import true_power_dbm
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.planning.foresight import best_nodes, clairvoyant_paths, oracle_paths
from planopt.planning.initial_data import prepare
from planopt.planning.plan import Verdict
from planopt.planning.planners import StrategyPlanner, planner_for
from planopt.planning.scene import build_ground
from planopt.targets.sensor import sensing_information

STRATEGIES = ("path_loss_only", "informed_disk", "unaware")


def plan_of(name, problem, situation, belief, start_m=None):
    """The plan of a strategy, from another place if one is given."""
    if start_m is not None:
        problem = replace(problem, robots=(replace(problem.robots[0], start_m=start_m),))
        situation = replace(situation, problem=problem, state=np.asarray(start_m))
    problem = replace(problem, planner=replace(problem.planner, name=name))
    judge, ground = judge_of(replace(situation, problem=problem), belief)
    planner = planner_for(problem, ground, np.random.default_rng(0))
    return planner.plan(situation, judge)


@pytest.mark.parametrize("name", STRATEGIES)
def test_plans_are_verified_by_what_is_known(name):
    """Connectivity in the plan is that of all measurements, not what the strategy assumes."""
    problem = terms_problem(TRACKING, horizon=3)
    situation, belief = situation_of(problem)
    plan = plan_of(name, problem, situation, belief)
    assert plan.verdict is Verdict.VERIFIED
    path = plan.positions_m[1:]
    np.testing.assert_allclose(
        plan.connectivity[1:], belief.posterior.connectivity(path, -40.0), atol=1e-12
    )


def test_unaware_plans_as_if_the_threshold_were_nothing():
    """With a threshold far below all powers the planner that knows the channel does the same."""
    problem = terms_problem(TRACKING, horizon=3)
    situation, belief = situation_of(problem)
    unaware = plan_of("unaware", problem, situation, belief)
    deaf = (replace(problem.stations[0], threshold_dbm=-400.0),)
    lossless = replace(problem, stations=deaf)
    auto = plan_of("auto", lossless, replace(situation, problem=lossless), belief)
    assert np.abs(unaware.positions_m - auto.positions_m).max() < 1e-3


def test_path_loss_only_does_not_look_at_measured_powers():
    """Shadows move the plan of `auto`; with theta held, not that of `path_loss_only`."""
    problem = terms_problem(TRACKING, horizon=3)
    situation, belief = situation_of(problem)
    parameters, measured = belief.posterior.parameters, belief.posterior.measurements
    paths = {"auto": [], "path_loss_only": []}
    for powers in (measured.power_dbm, measured.power_dbm[::-1] - 10.0):
        posterior = condition(parameters, replace(measured, power_dbm=powers), theta="known")
        seen, known = (
            replace(situation, posteriors=(posterior,)),
            replace(belief, posterior=posterior),
        )
        for name, found in paths.items():
            found.append(plan_of(name, problem, seen, known).positions_m)
    np.testing.assert_array_equal(*paths["path_loss_only"])
    assert np.abs(np.subtract(*paths["auto"])).max() > 0.1


def test_a_robot_outside_the_disc_comes_back():
    """From where no place in reach is inside the robot drives full steps towards the station."""
    problem = terms_problem(TRACKING, horizon=2)
    situation, belief = situation_of(problem)
    theta = np.array([-20.0, 2.0])
    # A disc of 10 m; the robot is 30 m off.
    parameters = replace(belief.posterior.parameters, k_pl_db=-20.0, n_pl=2.0)
    posterior = replace(belief.posterior, theta=theta, parameters=parameters)
    seen = replace(situation, posteriors=(posterior,))
    start = np.array([4.0, 34.0])
    plan = plan_of("informed_disk", problem, seen, belief, tuple(start))
    away = np.linalg.norm(plan.positions_m - np.array([4.0, 4.0]), axis=1)
    np.testing.assert_allclose(np.diff(away), -2.0, atol=0.1)
    inside = plan_of("informed_disk", problem, seen, belief, (5.0, 8.0))
    slant = np.hypot(np.linalg.norm(inside.positions_m - 4.0, axis=1), 2.0)
    assert slant.max() <= 10.0 * 1.02


def test_best_nodes_are_the_best_of_all_walks():
    """Enumerated on a small lattice with random rewards."""
    problem = terms_problem(TRACKING)
    problem = replace(
        problem,
        workspace=replace(problem.workspace, bounds_m=(8.0, 13.0, 12.5, 17.0), obstacles=()),
    )
    road_map = build_ground(problem, np.array([10.0, 15.0])).road_map
    count = len(road_map.nodes_m)
    first = int(np.linalg.norm(road_map.nodes_m - [10.0, 15.0], axis=1).argmin())
    rewards = np.random.default_rng(1).uniform(size=(3, count))
    ends = [
        {int(n) for n in np.flatnonzero((road_map.sources == node).any(axis=1))}
        for node in range(count)
    ]
    walks = (
        walk
        for walk in product(range(count), repeat=3)
        if all(b in ends[a] for a, b in zip((first, *walk), walk, strict=False))
    )
    best = max(walks, key=lambda walk: sum(rewards[k, n] for k, n in enumerate(walk)))
    assert tuple(best_nodes(road_map, first, rewards)) == best


@pytest.fixture(scope="module")
def foreseen():
    """A problem, its truth, a target's path, and the information that a walk brings truly."""
    problem = terms_problem(TRACKING, horizon=2, max_steps=12)
    truth = prepare(problem, 0).truths[0]
    target = np.array([14.0, 18.0]) + np.arange(13)[:, None] * np.array([0.9, 0.2])
    sensor = problem.terms[0].sensor

    def arriving(path):
        up = true_power_dbm(truth, path) >= -40.0
        return float(
            sum(
                sensing_information(sensor, path[k : k + 1], target[k + 1])[0] * up[k]
                for k in range(len(path))
            )
        )

    return problem, truth, target, arriving


def test_no_walk_brings_more_than_the_clairvoyants(foreseen):
    """Random walks on its lattice bring less, and so does the oracle."""
    problem, truth, target, arriving = foreseen
    (best,) = clairvoyant_paths(problem, truth, target)
    (fair,) = oracle_paths(problem, truth, target)
    assert arriving(best) > arriving(fair)
    road_map = build_ground(problem, np.asarray(problem.robots[0].start_m)).road_map
    generator = np.random.default_rng(0)
    start = int(np.linalg.norm(road_map.nodes_m - problem.robots[0].start_m, axis=1).argmin())
    for _ in range(100):
        nodes = [start]
        for _ in range(12):
            to = np.flatnonzero((road_map.sources == nodes[-1]).any(axis=1))
            nodes.append(int(generator.choice(to)))
        assert arriving(road_map.nodes_m[nodes[1:]]) <= arriving(best) + 1e-9


@pytest.mark.parametrize("name", ["oracle", "oracle_log", "clairvoyant", "clairvoyant_log"])
def test_a_bound_is_driven_by_the_closed_loop(name):
    """Two robots keep to their lattice, and what is driven is verified as any plan."""
    problem = terms_problem(TRACKING, horizon=2, max_steps=6, name=name)
    second = replace(problem.robots[0], name="second", start_m=(12.0, 8.0))
    problem = replace(problem, robots=(*problem.robots, second))
    run = simulate(problem, seed=3)
    assert run.verified_rate == 1.0
    for robot in run.runs:
        steps = np.linalg.norm(np.diff(robot.log.positions_m, axis=0), axis=1)
        assert len(steps) == 6
        assert steps.max() <= 2.0
    other = simulate(problem, seed=3, horizon=1)
    np.testing.assert_array_equal(run.runs[0].log.positions_m, other.runs[0].log.positions_m)


def test_what_the_planners_do_not_plan_is_refused():
    """A bound without a run, a bound on robots that keep apart, a strategy that tracks nothing."""
    problem = terms_problem(TRACKING, name="clairvoyant")
    _, ground = judge_of(*situation_of(problem))
    with pytest.raises(InputError, match="ground truth of a whole run"):
        planner_for(problem, ground, np.random.default_rng(0))
    apart = replace(
        problem,
        robots=(problem.robots[0], replace(problem.robots[0], name="b", start_m=(12.0, 8.0))),
        constraints=replace(problem.constraints, separation_m=1.0),
    )
    with pytest.raises(InputError, match="without separation_m"):
        simulate(apart, seed=0)
    learning = terms_problem(LEARNING, name="unaware")
    with pytest.raises(InputError, match="tracks a target"):
        planner_for(learning, ground, np.random.default_rng(0))
    assert isinstance(
        planner_for(
            replace(problem, planner=replace(problem.planner, name="unaware")),
            ground,
            np.random.default_rng(0),
        ),
        StrategyPlanner,
    )
