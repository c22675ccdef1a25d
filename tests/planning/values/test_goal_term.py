"""A goal among other terms: the way there, its worth, arrival, and what keeps it from arriving."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from terms_scene import LEARNING, context_of, scorer_of, terms_problem

from planopt import InputError, check, load, load_result, simulate
from planopt.objectives.terms.term import SteeringPath
from planopt.planning.proof.rule import search_prediction
from planopt.planning.search.steering import GoalSteering
from planopt.problems import problem_to_dict
from planopt.problems.problem import problem_from_tables
from planopt.world import index_obstacles

GOAL = {"kind": "goal"}


def to_goal(*terms, goal=(30.0, 15.0), p_min=0.0, **planner):
    """The small problem with a goal on the other side of its block."""
    tables = problem_to_dict(terms_problem(LEARNING, p_min=p_min, **planner))
    tables["problem"]["task"] = "custom" if terms[0]["kind"] == "goal" else "learn"
    tables["objective"] = {"terms": [dict(term) for term in terms]}
    tables["robots"][0]["goal_m"] = list(goal)
    return problem_from_tables(tables, folder=Path(), file=None)


def with_obstacles(problem, *shapes):
    return replace(problem, workspace=replace(problem.workspace, obstacles=shapes))


def scene(problem):
    """What is known at the start, and what steers."""
    situation, belief = context_of(problem)
    ground = scorer_of(situation, belief)[1]
    return situation, ground, GoalSteering(problem, ground, problem.terms[0])


def test_the_way_round_an_obstacle_is_the_shortest():
    """By two corners, 0.5 m away; the lattice costs 4 % at most."""
    problem = to_goal(GOAL)
    situation, ground, steering = scene(problem)
    way = steering.find_path(situation)
    # Below the block: its corners, and the start and the goal 3 m above them.
    shortest = 2 * np.hypot(8.0, 3.5) + 4.0
    assert shortest <= way.rest_m[0] <= 1.04 * shortest
    assert way.lattice_m is not None and way.lattice_m.shape == ground.road_map.lattice.shape


def metre_cost(situation, places_m, p_min, price=10.0):
    """What a metre counts, from all measurements."""
    power = search_prediction(situation.law, places_m)
    margin = power.mean_db - situation.problem.stations[0].threshold_dbm
    chance = norm.cdf(margin / power.deviation_db)
    return 1.0 + price * np.where(chance < p_min, 1.0 - chance, 0.0)


def test_the_way_goes_round_a_hole():
    """It is longer than the geodesic way, and hardly any metre of it is out of contact."""
    problem = load("open_field")
    tables = problem_to_dict(problem)
    tables["problem"]["task"] = "custom"
    tables["objective"] = {"terms": [GOAL]}
    tables["robots"][0] |= {"start_m": [50.0, 60.0], "goal_m": [70.0, 60.0]}
    problem = problem_from_tables(tables, folder=Path(), file=None)
    situation, _, steering = scene(problem)

    def out_m(turns_m):
        total = 0.0
        for start, end in pairwise(turns_m):
            share = (np.arange(200) + 0.5)[:, None] / 200
            below = metre_cost(situation, start + share * (end - start), 0.8) > 1.0
            total += below.mean() * np.linalg.norm(end - start)
        return total

    found = steering.find_path(situation)
    ground = scorer_of(*context_of(problem))[1]
    unasked = replace(problem, constraints=replace(problem.constraints, p_min=0.0))
    short = GoalSteering(unasked, ground, problem.terms[0]).find_path(situation)
    assert short.rest_m[0] < found.rest_m[0]
    assert out_m(found.turns_m) < 0.7 * out_m(short.turns_m)


def test_places_go_on_in_the_order_of_the_turns():
    """The last turn is in sight from everywhere, and across the hole."""
    index = index_obstacles(with_obstacles(to_goal(GOAL)).workspace)
    turns = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 0.0]])
    way = SteeringPath(turns, index, 0.5 - 1e-6, in_order=True)
    places = np.array([[0.0, 0.0], [1.0, 4.0], [5.0, 9.0], [9.5, 3.0]])
    np.testing.assert_array_equal(way.next_turns(places), [1, 1, 2, 3])
    np.testing.assert_array_equal(replace(way, in_order=False).next_turns(places), [3] * 4)
    assert way.distance_m(places[:1])[0] == pytest.approx(30.0)


@pytest.mark.parametrize("horizon", [1, 5])
def test_a_robot_arrives(horizon):
    """Along about the shortest way, and the run says when."""
    run = simulate(to_goal(GOAL, max_steps=40), horizon=horizon, seed=1)
    shortest = 2 * np.hypot(8.0, 3.5) + 4.0
    assert run.outcome.value == "reached"
    assert run.metrics["path_m"] <= 1.15 * shortest
    assert run.metrics["goal_time_s"] == len(run.runs[0].log.t_s) - 1


def test_it_learns_on_the_way(tmp_path):
    """More than one that only drives, with the same measurements before; the files say it all."""
    both = []
    for weight in (1.0, 0.005):
        problem = to_goal({**GOAL, "weight": weight}, LEARNING, max_steps=60)
        both.append(simulate(problem, horizon=5, seed=2))
    plain, learnt = both
    assert {run.outcome.value for run in both} == {"reached"}
    assert learnt.metrics["log_det_m"] < plain.metrics["log_det_m"]
    assert learnt.metrics["path_m"] >= plain.metrics["path_m"]
    learnt.save(tmp_path)
    assert check(tmp_path).verdict.value == "verified"
    assert load_result(tmp_path).outcome.value == "reached"


def test_each_robot_has_a_goal_of_its_own():
    """The run ends when both are there, apart all the way."""
    tables = problem_to_dict(to_goal(GOAL, max_steps=40))
    second = {**tables["robots"][0], "name": "second", "start_m": [30.0, 17.0]}
    tables["robots"].append(second | {"goal_m": [10.0, 17.5]})
    tables["constraints"]["separation_m"] = 1.5
    run = simulate(problem_from_tables(tables, folder=Path(), file=None), horizon=4, seed=0)
    assert run.outcome.value == "reached" and run.metrics["min_separation_m"] >= 1.5


def test_what_is_wrong_is_said():
    """The goal and its term go together; one thing steers."""
    with pytest.raises(InputError, match=r'"goal" needs robots\[0\]\.goal_m'):
        terms_problem(GOAL)
    with pytest.raises(InputError, match=r"robots\[0\]\.goal_m has no effect"):
        to_goal(LEARNING)
    steering = {"kind": "mapping", "form": "two_layer"}
    with pytest.raises(InputError, match=r"only one may steer it"):
        to_goal(GOAL, steering)
