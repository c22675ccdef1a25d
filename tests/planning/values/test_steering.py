"""The two layers: the place of the highest J_CH, and the way there round obstacles."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from terms_scene import context_of, scorer_of, terms_problem

from planopt import Obstacle
from planopt.objectives.terms.term import SteeringPath
from planopt.planning.search.steering import Steering
from planopt.world import clearance_m, index_obstacles, swept_clearance_m

TWO_LAYER = {
    "kind": "mapping",
    "form": "two_layer",
    "variance_threshold_db2": 2.0,
    "closeness_per_m": 0.02,
}


def scene(obstacles=None, **changes):
    """StepContext, belief, ground and problem with a two-layer term."""
    problem = terms_problem({**TWO_LAYER, **changes})
    if obstacles is not None:
        named = tuple(Obstacle(f"{k}", shape) for k, shape in enumerate(obstacles))
        problem = replace(problem, workspace=replace(problem.workspace, obstacles=named))
    context, belief = context_of(problem)
    return context, belief, scorer_of(context, belief)[1], problem


@pytest.mark.parametrize("decay", [0.0, 0.05, 0.5])
def test_without_obstacles_the_target_is_that_of_the_equation(decay):
    """With all measurements as neighbours the argmax of J_CH over unmeasured places, exactly."""
    context, _, ground, problem = scene((), closeness_per_m=decay)
    places, at = context.region.grid_m, context.position_m
    unmeasured = places[context.measuring.is_open(places)]
    variance = context.posterior.predict(unmeasured).deviation_db ** 2
    near = np.exp(-decay * np.linalg.norm(unmeasured - at, axis=1))
    best = int((np.maximum(0.0, variance - 2.0) * near).argmax())
    way = Steering(problem, ground, problem.terms[0]).find_path(context)
    np.testing.assert_allclose(way.end_m, unmeasured[best])
    np.testing.assert_allclose(way.turns_m, [at, unmeasured[best]])
    # One step ahead the nearest place to it is the best: the inner layer of the equation.
    steps = at + np.random.default_rng(0).normal(size=(50, 1, 2))
    gained = way.gained_m(steps)
    assert gained.argmax() == np.linalg.norm(steps[:, 0] - way.end_m, axis=1).argmin()
    straight = np.linalg.norm(at - way.end_m) - np.linalg.norm(steps[:, 0] - way.end_m, axis=1)
    np.testing.assert_allclose(gained, straight)


def only_place(context, near_m):
    """J_CH of one place alone, the nearest to `near_m`, and that place."""
    chosen = int(np.linalg.norm(context.region.grid_m - np.asarray(near_m), axis=1).argmin())
    above = np.zeros(len(context.region.grid_m))
    above[chosen] = 1.0
    return above, context.region.grid_m[chosen]


U_SHAPE = shapely.Polygon(
    [(16, 8), (24, 8), (24, 32), (16, 32), (16, 30), (22, 30), (22, 10), (16, 10)]
)


@pytest.mark.parametrize(
    ("obstacle", "shortest_m"), [(None, 19.9), (U_SHAPE, 33.0)], ids=["block", "pocket"]
)
def test_one_step_ahead_reaches_its_target_round_obstacles(obstacle, shortest_m):
    """Each step goes where the distance is least within it; no step is lost at a corner."""
    context, _, ground, problem = scene(None if obstacle is None else (obstacle,))
    steering = Steering(problem, ground, problem.terms[0])
    above, goal = only_place(context, (27.0, 20.0))
    position = np.array([13.0, 20.0])
    angle = 2.0 * np.pi * np.arange(72) / 72
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = (np.linspace(0.05, 1.0, 20)[:, None, None] * circle).reshape(-1, 2)
    first = steering.path_to_best(above, position)
    assert swept_clearance_m(ground.index, first.turns_m).min() >= 0.5
    assert first.rest_m[0] >= shortest_m
    left, steps = first.rest_m[0], 0
    while np.linalg.norm(position - goal) > 0.11 and steps < 60:
        way = steering.path_to_best(above, position)
        reach = np.linalg.norm(position - goal)
        ends = position + min(problem.step_length_m, max(reach, 0.1)) * rings
        starts = np.broadcast_to(position, ends.shape)
        clear = [
            swept_clearance_m(ground.index, np.array(pair))[0] >= 0.5
            for pair in zip(starts, ends, strict=True)
        ]
        ends = ends[np.array(clear)]
        position = ends[int(way.gained_m(ends[:, None]).argmax())]
        steps += 1
        now = way.distance_m(position[None])[0]
        assert now < left + 0.3
        left = now
    assert np.linalg.norm(position - goal) <= 0.11
    assert steps <= np.ceil(1.05 * first.rest_m[0] / problem.step_length_m) + 2


def test_distance_is_that_of_the_shortest_way():
    """About one corner: the two straight legs; from behind the obstacle back by the start."""
    wall = Obstacle("wall", shapely.box(5.0, 0.0, 6.0, 9.0))
    index = index_obstacles(replace(terms_problem(TWO_LAYER).workspace, obstacles=(wall,)))
    way = SteeringPath(np.array([[0.0, 5.0], [5.5, 10.0], [10.0, 5.0]]), index, 0.5 - 1e-6)
    legs = [np.hypot(5.5, 5.0), np.hypot(4.5, 5.0)]
    np.testing.assert_allclose(way.rest_m, [sum(legs), legs[1], 0.0])
    places = np.array([[2.0, 8.0], [8.0, 9.0], [1.0, 8.5], [9.0, 1.0]])
    to_corner, to_end = (np.linalg.norm(places - turn, axis=1) for turn in way.turns_m[1:])
    wanted = [to_corner[0] + legs[1], to_end[1], to_corner[2] + legs[1], to_end[3]]
    np.testing.assert_allclose(way.distance_m(places), wanted)
    inside = np.array([[5.5, 4.0]])
    back = np.linalg.norm(inside[0] - way.turns_m[0]) + sum(legs)
    assert way.distance_m(inside)[0] == pytest.approx(back)
    np.testing.assert_allclose(
        way.gained_m(places[:2][None]), [(way.rest_m[0] - np.array(wanted[:2])).sum()]
    )


def test_places_that_the_clearance_keeps_out_are_never_targets():
    """Nearer to an obstacle than the robot may come: it would stand beside them for ever."""
    context, _, ground, problem = scene((shapely.box(16.0, 12.0, 22.0, 28.0),))
    near = clearance_m(ground.index, context.region.grid_m)
    steering = Steering(problem, ground, problem.terms[0])
    assert (near < 0.5).any()
    for place in np.flatnonzero(near < 0.5):
        above = np.zeros(len(near))
        above[place] = 1.0
        assert steering.path_to_best(above, context.position_m) is None
