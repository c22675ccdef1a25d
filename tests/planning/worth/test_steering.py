"""The outer layer of (3): the seed's q* over the region, and the way there round obstacles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from terms_scene import judge_of, situation_of, terms_problem

from planopt.channel.posterior import extend
from planopt.objectives.mapping import Uncertainty, uncertainty_target
from planopt.planning.worth.steering import Steering, nearest_measured_m
from planopt.world.clearance import swept_clearance_m
from planopt.world.workspace import Obstacle

TWO_LAYER = {
    "kind": "mapping",
    "form": "two_layer",
    "variance_threshold_db2": 2.0,
    "closeness_per_m": 0.02,
}


def scene(**changes):
    """Situation, belief, ground and problem with a two-layer term."""
    problem = terms_problem({**TWO_LAYER, **changes})
    situation, belief = situation_of(problem)
    return situation, belief, judge_of(situation, belief)[1], problem


@pytest.mark.parametrize("decay", [0.0, 0.05, 0.5])
def test_straight_steering_is_the_seeds(decay):
    """With all measurements as neighbours the argmax of J_CH over unmeasured places, exactly."""
    situation, _, ground, problem = scene(closeness_per_m=decay)
    places, at = situation.region.grid_m, situation.position_m
    unmeasured = places[nearest_measured_m(situation.posterior, places) >= 0.5]
    best = uncertainty_target(
        situation.posterior,
        unmeasured,
        np.linalg.norm(unmeasured - at, axis=1),
        Uncertainty(2.0, decay),
    )
    found = Steering(problem, ground, problem.terms[0], geodesic=False).find_place(
        situation.posterior, at
    )
    np.testing.assert_allclose(found, unmeasured[best])


def test_nothing_above_the_threshold_steers_nowhere():
    """Straight or round obstacles."""
    situation, _, ground, problem = scene(variance_threshold_db2=1e4)
    for geodesic in (True, False):
        steering = Steering(problem, ground, problem.terms[0], geodesic)
        assert steering.find_place(situation.posterior, situation.position_m) is None


def test_way_leads_round_the_obstacle():
    """From one side of it to the other, in pieces no longer than the plan, until it is there."""
    situation, belief, _, problem = scene()
    problem = replace(problem, planner=replace(problem.planner, horizon=2))
    ground = judge_of(replace(situation, problem=problem), belief)[1]
    steering = Steering(problem, ground, problem.terms[0])
    # Only one place is uncertain: nearer than the rest by far, straight behind the obstacle.
    beyond = np.array([25.0, 20.0])
    chosen = int(np.linalg.norm(situation.region.grid_m - beyond, axis=1).argmin())
    goal = situation.region.grid_m[chosen]
    above = np.zeros(len(situation.region.grid_m))
    above[chosen] = 1.0
    position = np.array([15.0, 20.0])
    for _ in range(20):
        place = steering._round_obstacles(above, position)
        assert np.linalg.norm(place - position) <= 4.0 + 1e-6
        if (place == goal).all():
            break
        # The straight way to the next piece may cut a corner, but leads on.
        assert swept_clearance_m(ground.index, np.vstack([place, place]))[0] >= 0.5
        position = place
    assert (place == goal).all()


def test_measured_places_are_left_out():
    """A place that was just measured is not gone to again."""
    situation, _, ground, problem = scene()
    steering = Steering(problem, ground, problem.terms[0], geodesic=False)
    first = steering.find_place(situation.posterior, situation.position_m)
    measured = situation.posterior.measurements.take(np.array([0]))
    posterior = extend(situation.posterior, replace(measured, positions_m=first[None]))
    second = steering.find_place(posterior, situation.position_m)
    assert np.linalg.norm(second - first) > 0.5


def test_without_measurements_none_is_near():
    """All distances are infinite."""
    situation, *_ = scene()
    nothing = situation.posterior.measurements.take(np.zeros(0, dtype=np.intp))

    class Posterior:
        measurements = nothing

    assert np.isinf(nearest_measured_m(Posterior(), np.zeros((3, 2)))).all()


def test_a_robot_that_cannot_move_is_steered_nowhere():
    """In the middle of the obstacle no first move is open."""
    situation, _, ground, problem = scene()
    steering = Steering(problem, ground, problem.terms[0])
    assert steering.find_place(situation.posterior, np.array([20.0, 20.0])) is None


def test_a_walled_off_part_is_steered_nowhere_near():
    """What cannot be come to counts nothing, also where nearness does not matter."""
    problem = terms_problem({**TWO_LAYER, "closeness_per_m": 0.0})
    wall = Obstacle("wall", shapely.box(25.0, -1.0, 26.0, 41.0))
    problem = replace(problem, workspace=replace(problem.workspace, obstacles=(wall,)))
    situation, belief = situation_of(problem)
    steering = Steering(problem, judge_of(situation, belief)[1], problem.terms[0])
    place = steering.find_place(situation.posterior, situation.position_m)
    assert place is not None and place[0] < 25.0
