"""Baselines, strategies of communication, and bounds on tracking."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt import InputError, Verdict, load, simulate
from planopt.channel import condition, true_power_dbm
from planopt.extend import Rung, free_ends
from planopt.planning.initial_data import prepare
from planopt.planning.planners import (
    RINGS,
    LawnmowerPlanner,
    OneStepPlanner,
    RandomPlanner,
    best_nodes,
    clairvoyant_paths,
    lane_rows,
    oracle_paths,
    planner_for,
)
from planopt.planning.scene import build_ground
from planopt.targets.information_filter import sensing_information

INFORMATION = {"kind": "mapping", "form": "information"}
PATH = {"kind": "mapping", "form": "path", "variance_threshold_db2": 2.0, "closeness_per_m": 0.02}


def scene(*terms, **planner):
    problem = terms_problem(*terms, **planner)
    situation, belief = context_of(problem)
    scorer, ground = scorer_of(situation, belief)
    return problem, situation, scorer, ground


def moved(situation, scorer, position_m):
    moved = replace(situation, state=position_m)
    return moved, replace(scorer, context=moved)


@pytest.mark.parametrize("name", ["auto", "lattice", "one_step", "random", "lawnmower"])
@pytest.mark.parametrize("horizon", [1, 5])
def test_every_planner_gives_verified_plans(name, horizon):
    """Of the right length, and worth what the scorer says."""
    problem, situation, scorer, ground = scene(LEARNING, name=name, horizon=horizon)
    plan = planner_for(problem, ground, np.random.default_rng(0)).plan(situation, scorer)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.positions_m.shape == (horizon + 1, 2)
    assert plan.objective == pytest.approx(scorer.objective(plan.positions_m[1:]))


@pytest.mark.parametrize(
    "terms",
    [
        (TRACKING,),
        ({"kind": "mapping", "form": "two_layer"},),
        *[({**LEARNING, "criterion": kind},) for kind in "TDAV"],
        (INFORMATION,),
        ({"kind": "mapping", "form": "average"},),
        (PATH,),
        (CONNECT,),
        (TRACKING, LEARNING, ENERGY),
    ],
)
def test_one_step_ahead_is_the_dense_search(terms):
    """The horizon planner finds what a dense search of the places within a step finds."""
    problem, situation, scorer, ground = scene(*terms, horizon=1)
    dense = OneStepPlanner(problem, ground).plan(situation, scorer).objective
    auto = planner_for(problem, ground, np.random.default_rng(0)).plan(situation, scorer).objective
    assert auto >= dense - 1e-4 * abs(dense)
    # A search for connection pays for its way, and the places of the dense one are rings apart.
    ring_m = problem.step_length_m / RINGS if terms == (CONNECT,) else 0.0
    assert auto <= dense + 0.02 * abs(dense) + ring_m


@pytest.mark.parametrize("terms", [(LEARNING,), (INFORMATION,), (PATH,)])
@pytest.mark.parametrize("seed", range(3))
def test_never_below_the_greedy_rollout(terms, seed):
    """Nor below what the same planner finds on the lattice alone."""
    problem = terms_problem(*terms)
    situation, belief = context_of(problem, seed)
    scorer, ground = scorer_of(situation, belief)
    auto, lattice, greedy = (
        planner_for(
            replace(problem, planner=replace(problem.planner, name=name)),
            ground,
            np.random.default_rng(0),
        )
        .plan(situation, scorer)
        .objective
        for name in ("auto", "lattice", "one_step")
    )
    assert auto >= lattice - 1e-9
    assert auto >= greedy - 1e-9


def test_greedy_steps_do_not_come_back_to_a_place():
    """Measured places, and those of the plan itself, are left out; for tracking they are not."""
    problem, situation, scorer, ground = scene(INFORMATION, horizon=6)
    plan = OneStepPlanner(problem, ground).plan(situation, scorer)
    path = plan.positions_m[1:]
    apart = np.linalg.norm(path[:, None] - path, axis=2)[np.triu_indices(len(path), 1)]
    assert apart.min() >= problem.channel.measure_spacing_m
    still = {**TRACKING, "sweet_spot_m": 0.0}
    problem, situation, scorer, ground = scene(still, horizon=3)
    aim = replace(situation.aim, target_m=np.tile(situation.position_m, (3, 1)))
    here = replace(situation, aim=aim)
    plan = OneStepPlanner(problem, ground).plan(here, scorer)
    np.testing.assert_allclose(plan.positions_m, np.tile(situation.position_m, (4, 1)))


def test_a_robot_that_is_shut_in_leaves():
    """No baseline finds a step that is free; leaving the obstacle is what is left."""
    problem, situation, scorer, ground = scene(LEARNING)
    inside = np.array([20.0, 20.0])
    situation, scorer = moved(situation, scorer, inside)
    for planner in (
        OneStepPlanner(problem, ground),
        RandomPlanner(problem, ground, np.random.default_rng(0)),
        LawnmowerPlanner(problem, ground),
    ):
        plan = planner.plan(situation, scorer)
        assert plan.rung is Rung.LEAVE and plan.verdict is not Verdict.VERIFIED
        step = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
        assert 0.0 < step[0] <= problem.step_length_m and step[1:].max(initial=0.0) == 0.0


def test_random_walks():
    """Full steps in all directions alike, the same for a seed; persistent walks turn little."""
    problem, situation, scorer, ground = scene(LEARNING, horizon=1)
    situation, scorer = moved(situation, scorer, np.array([8.0, 20.0]))
    planner = RandomPlanner(problem, ground, np.random.default_rng(3))
    steps = np.array(
        [np.diff(planner.plan(situation, scorer).positions_m, axis=0)[0] for _ in range(80)]
    )
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 2.0, atol=1e-5)
    quadrant = np.bincount((steps[:, 0] > 0) + 2 * (steps[:, 1] > 0), minlength=4)
    # Four standard deviations of 80 draws in four equal parts.
    assert (np.abs(quadrant - 20) < 4.0 * np.sqrt(80 * 0.25 * 0.75)).all()
    again = RandomPlanner(problem, ground, np.random.default_rng(3)).plan(situation, scorer)
    np.testing.assert_array_equal(again.positions_m[1] - again.positions_m[0], steps[0])
    problem, situation, scorer, ground = scene(LEARNING, horizon=4)
    situation, scorer = moved(situation, scorer, np.array([8.0, 20.0]))
    turns = []
    for seed in range(40):
        planner = RandomPlanner(problem, ground, np.random.default_rng(seed), "persistent")
        plan = planner.plan(situation, scorer)
        steps = np.diff(plan.positions_m, axis=0)
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 2.0, atol=1e-5)
        later, beside = moved(situation, scorer, plan.positions_m[1])
        following = np.diff(planner.plan(later, beside, plan).positions_m, axis=0)
        for one, other in ((steps[1], steps[2]), (steps[0], following[0])):
            turns.append(np.arctan2(np.cross(np.r_[one, 0], np.r_[other, 0])[2], one @ other))
    # Some meet the bounds and turn round; the middle half of the others is that of the law.
    assert np.quantile(np.abs(turns), 0.5) == pytest.approx(0.6745 * 0.4, rel=0.4)
    stood = replace(plan, positions_m=np.tile(plan.positions_m[0], (5, 1)))
    assert planner.plan(later, beside, stood).verdict is Verdict.VERIFIED


def test_lawnmower_comes_near_every_free_place():
    """Followed to its end, every lattice node is within a lane of it; then the robot stands."""
    problem, situation, scorer, ground = scene(LEARNING, horizon=20)
    planner = LawnmowerPlanner(problem, ground)
    driven = [situation.position_m]
    for _ in range(60):
        situation, scorer = moved(situation, scorer, driven[-1])
        plan = planner.plan(situation, scorer)
        assert plan.verdict is Verdict.VERIFIED
        driven += list(plan.positions_m[1:])
        if np.ptp(plan.positions_m, axis=0).max() == 0.0:
            break
    else:
        pytest.fail("the tour does not end")
    nodes, row = ground.road_map.nodes_m, ground.road_map.lattice.spacing_m
    lane = min(situation.posterior.parameters.decorrelation_m, 40.0 / 3.0)
    assert lane > 3.0 * row
    near = np.linalg.norm(nodes[:, None] - np.asarray(driven), axis=2).min(axis=1)
    assert near.max() <= 0.5 * lane + 1.5 * row
    # To and fro: hardly longer than the area asks for.
    length = np.linalg.norm(np.diff(driven, axis=0), axis=1).sum()
    assert length < 1.5 * len(nodes) * row**2 / lane + 2.0 * 40.0


@pytest.mark.parametrize("apart", [0.3, 1.0, 2.6, 7.0, 19.0, 1e3])
def test_lanes_are_apart_as_the_channel_asks(apart):
    """Every row is within half of it, rounded; no two lanes are one; and never fewer than three."""
    low, high = -4, 35
    lanes = np.array(lane_rows(low, high, apart))
    assert (np.diff(lanes) > 0).all() and lanes[0] >= low and lanes[-1] <= high
    rows = np.arange(low, high + 1)
    beside = np.abs(rows[:, None] - lanes).min(axis=1)
    assert beside.max() <= 0.5 * max(min(apart, 40.0 / 3.0), 1.0) + 0.5
    assert len(lanes) == max(3, min(40, int(np.ceil(40.0 / apart))))
    assert lane_rows(2, 3, 5.0) == [2, 3]


STRATEGIES = ("path_loss_only", "informed_disk", "unaware")


def plan_of(name, problem, situation, belief, start_m=None):
    """The plan of a strategy, from another place if one is given."""
    if start_m is not None:
        problem = replace(problem, robots=(replace(problem.robots[0], start_m=start_m),))
        situation = replace(situation, problem=problem, state=np.asarray(start_m))
    problem = replace(problem, planner=replace(problem.planner, name=name))
    scorer, ground = scorer_of(replace(situation, problem=problem), belief)
    planner = planner_for(problem, ground, np.random.default_rng(0))
    return planner.plan(situation, scorer)


@pytest.mark.parametrize("name", STRATEGIES)
def test_plans_are_verified_by_what_is_known(name):
    """Connectivity in the plan is that of all measurements, not what the strategy assumes."""
    problem = terms_problem(TRACKING, horizon=3)
    situation, belief = context_of(problem)
    plan = plan_of(name, problem, situation, belief)
    assert plan.verdict is Verdict.VERIFIED
    path = plan.positions_m[1:]
    np.testing.assert_allclose(
        plan.connectivity[1:], belief.posterior.connectivity(path, -40.0), atol=1e-12
    )


def test_path_loss_only_does_not_look_at_measured_powers():
    """Shadows move the plan of `auto`; with theta held, not that of `path_loss_only`."""
    problem = terms_problem(TRACKING, horizon=3)
    situation, belief = context_of(problem)
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
    situation, belief = context_of(problem)
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
    _, ground = scorer_of(*context_of(problem))
    with pytest.raises(InputError, match="ground truth of a whole run"):
        planner_for(problem, ground, np.random.default_rng(0))
    apart = replace(
        problem,
        robots=(problem.robots[0], replace(problem.robots[0], name="b", start_m=(12.0, 8.0))),
        constraints=replace(problem.constraints, separation_m=1.0),
    )
    with pytest.raises(InputError, match="no separation_m"):
        simulate(apart, seed=0)
    learning = terms_problem(LEARNING, name="unaware")
    with pytest.raises(InputError, match="needs a tracking term"):
        planner_for(learning, ground, np.random.default_rng(0))


def test_the_first_step_has_the_largest_deviation() -> None:
    """Of places as far as a step, by the exact posterior, up to the density of the search."""
    problem = load("fig3")
    planner = replace(problem.planner, name="largest_deviation", horizon=1, max_steps=1)
    problem = replace(problem, planner=planner)
    run = simulate(problem, seed=3)
    start, end = run.run.log.positions_m
    posterior = prepare(problem, 3).belief.posterior
    angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = problem.step_length_m * np.linspace(0.05, 0.999, 20)
    places = start + (reach[:, None, None] * circle).reshape(-1, 2)
    free = free_ends(problem, build_ground(problem, start), start, places)
    best = posterior.predict(places[free]).deviation_db.max()
    assert posterior.predict(end[None]).deviation_db[0] >= 0.995 * best
