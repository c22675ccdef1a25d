"""One step, random, lawnmower: what they promise, and that all of it is verified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, judge_of, situation_of, terms_problem

from planopt.planning.plan import Rung, Verdict
from planopt.planning.planners import (
    RINGS,
    LawnmowerPlanner,
    OneStepPlanner,
    RandomPlanner,
    lane_rows,
    planner_for,
)

INFORMATION = {"kind": "mapping", "form": "information"}
PATH = {"kind": "mapping", "form": "path", "variance_threshold_db2": 2.0, "closeness_per_m": 0.02}


def scene(*terms, **planner):
    """Problem, situation, judge and ground."""
    problem = terms_problem(*terms, **planner)
    situation, belief = situation_of(problem)
    judge, ground = judge_of(situation, belief)
    return problem, situation, judge, ground


def moved(situation, judge, position_m):
    """The same with the robot elsewhere."""
    moved = replace(situation, state=position_m)
    return moved, replace(judge, context=moved)


@pytest.mark.parametrize("name", ["auto", "lattice", "one_step", "random", "lawnmower"])
@pytest.mark.parametrize("horizon", [1, 5])
def test_every_planner_gives_verified_plans(name, horizon):
    """Of the right length, and worth what the judge says."""
    problem, situation, judge, ground = scene(LEARNING, name=name, horizon=horizon)
    plan = planner_for(problem, ground, np.random.default_rng(0)).plan(situation, judge)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.positions_m.shape == (horizon + 1, 2)
    assert plan.objective == pytest.approx(judge.objective(plan.positions_m[1:]))


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
    problem, situation, judge, ground = scene(*terms, horizon=1)
    dense = OneStepPlanner(problem, ground).plan(situation, judge).objective
    auto = planner_for(problem, ground, np.random.default_rng(0)).plan(situation, judge).objective
    assert auto >= dense - 1e-4 * abs(dense)
    # A search for connection pays for its way, and the places of the dense one are rings apart.
    ring_m = problem.step_length_m / RINGS if terms == (CONNECT,) else 0.0
    assert auto <= dense + 0.02 * abs(dense) + ring_m


@pytest.mark.parametrize("terms", [(LEARNING,), (INFORMATION,), (PATH,)])
@pytest.mark.parametrize("seed", range(3))
def test_never_below_the_greedy_rollout(terms, seed):
    """Nor below what the same planner finds on the lattice alone."""
    problem = terms_problem(*terms)
    situation, belief = situation_of(problem, seed)
    judge, ground = judge_of(situation, belief)
    auto, lattice, greedy = (
        planner_for(
            replace(problem, planner=replace(problem.planner, name=name)),
            ground,
            np.random.default_rng(0),
        )
        .plan(situation, judge)
        .objective
        for name in ("auto", "lattice", "one_step")
    )
    assert auto >= lattice - 1e-9
    assert auto >= greedy - 1e-9


def test_dense_search_is_the_best_of_its_places():
    """Of random places within the step none is much better."""
    problem, situation, judge, ground = scene(LEARNING, horizon=1)
    plan = OneStepPlanner(problem, ground).plan(situation, judge)
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 150), 2.0 * np.sqrt(rng.uniform(0, 1, 150))
    places = situation.position_m + radius[:, None] * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    best = max(judge.objective(place[None]) for place in places)
    assert plan.objective >= 0.99 * best


def test_greedy_steps_do_not_come_back_to_a_place():
    """Measured places, and those of the plan itself, are left out; for tracking they are not."""
    problem, situation, judge, ground = scene(INFORMATION, horizon=6)
    plan = OneStepPlanner(problem, ground).plan(situation, judge)
    path = plan.positions_m[1:]
    apart = np.linalg.norm(path[:, None] - path, axis=2)[np.triu_indices(len(path), 1)]
    assert apart.min() >= problem.channel.measure_spacing_m
    still = {**TRACKING, "sweet_spot_m": 0.0}
    problem, situation, judge, ground = scene(still, horizon=3)
    here = replace(situation, target_m=np.tile(situation.position_m, (3, 1)))
    plan = OneStepPlanner(problem, ground).plan(here, judge)
    np.testing.assert_allclose(plan.positions_m, np.tile(situation.position_m, (4, 1)))


def test_a_robot_that_is_shut_in_leaves():
    """No baseline finds a step that is free; leaving the obstacle is what is left."""
    problem, situation, judge, ground = scene(LEARNING)
    inside = np.array([20.0, 20.0])
    situation, judge = moved(situation, judge, inside)
    for planner in (
        OneStepPlanner(problem, ground),
        RandomPlanner(problem, ground, np.random.default_rng(0)),
        LawnmowerPlanner(problem, ground),
    ):
        plan = planner.plan(situation, judge)
        assert plan.rung is Rung.LEAVE and plan.verdict is not Verdict.VERIFIED
        step = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
        assert 0.0 < step[0] <= problem.step_length_m and step[1:].max(initial=0.0) == 0.0


def test_random_steps_are_full_and_uniform():
    """In all directions alike, the same for the same seed."""
    problem, situation, judge, ground = scene(LEARNING, horizon=1)
    situation, judge = moved(situation, judge, np.array([8.0, 20.0]))
    planner = RandomPlanner(problem, ground, np.random.default_rng(3))
    steps = np.array(
        [np.diff(planner.plan(situation, judge).positions_m, axis=0)[0] for _ in range(80)]
    )
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 2.0, atol=1e-5)
    quadrant = np.bincount((steps[:, 0] > 0) + 2 * (steps[:, 1] > 0), minlength=4)
    # Four standard deviations of 80 draws in four equal parts.
    assert (np.abs(quadrant - 20) < 4.0 * np.sqrt(80 * 0.25 * 0.75)).all()
    again = RandomPlanner(problem, ground, np.random.default_rng(3)).plan(situation, judge)
    np.testing.assert_array_equal(again.positions_m[1] - again.positions_m[0], steps[0])


def test_persistent_walk_turns_little():
    """Within a plan and from one plan to the next; a new direction after standing still."""
    problem, situation, judge, ground = scene(LEARNING, horizon=4)
    situation, judge = moved(situation, judge, np.array([8.0, 20.0]))
    turns = []
    for seed in range(40):
        planner = RandomPlanner(problem, ground, np.random.default_rng(seed), "persistent")
        plan = planner.plan(situation, judge)
        steps = np.diff(plan.positions_m, axis=0)
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 2.0, atol=1e-5)
        later, beside = moved(situation, judge, plan.positions_m[1])
        following = np.diff(planner.plan(later, beside, plan).positions_m, axis=0)
        for one, other in ((steps[1], steps[2]), (steps[0], following[0])):
            turns.append(np.arctan2(np.cross(np.r_[one, 0], np.r_[other, 0])[2], one @ other))
    # Some meet the bounds and turn round; the middle half of the others is that of the law.
    assert np.quantile(np.abs(turns), 0.5) == pytest.approx(0.6745 * 0.4, rel=0.4)
    stood = replace(plan, positions_m=np.tile(plan.positions_m[0], (5, 1)))
    assert planner.plan(later, beside, stood).verdict is Verdict.VERIFIED


def test_lawnmower_comes_near_every_free_place():
    """Followed to its end, every lattice node is within a lane of it; then the robot stands."""
    problem, situation, judge, ground = scene(LEARNING, horizon=20)
    planner = LawnmowerPlanner(problem, ground)
    driven = [situation.position_m]
    for _ in range(60):
        situation, judge = moved(situation, judge, driven[-1])
        plan = planner.plan(situation, judge)
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
