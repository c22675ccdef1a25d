"""Robots of one team that weigh the objective's terms by themselves."""

import json
from dataclasses import replace

import numpy as np
import pytest
from terms_scene import ENERGY, LEARNING, TRACKING, terms_problem

from planopt import InputError, check
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.log import Outcome
from planopt.planning.solve import solve
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.problem import check_problem

MAPPING = {"kind": "mapping", "form": "information"}
GOAL = {"kind": "goal", "weight": 5.0}


def team(*terms, weights, **planner):
    """Robots of the small problem, one for each tuple of weights; None is a robot without."""
    problem = terms_problem(*terms, **{"horizon": 3, "max_steps": 3, **planner})
    first = problem.robots[0]
    robots = [
        replace(first, name=f"robot{k}", start_m=(10.0, 15.0 + 3.0 * k), weights=own or ())
        for k, own in enumerate(weights)
    ]
    problem = replace(problem, robots=tuple(robots))
    check_problem(problem)
    return problem


def courier_and_scout(**planner):
    """A robot that goes to its goal, and one that maps the channel until then."""
    tables = problem_to_dict(terms_problem(MAPPING, **{"horizon": 3, "max_steps": 30, **planner}))
    tables["objective"]["terms"].append(GOAL)
    first = tables["robots"][0]
    tables["robots"] = [
        {**first, "name": "courier", "goal_m": [10.0, 24.0], "weights": [0.0, 5.0]},
        {**first, "name": "scout", "start_m": [13.0, 12.0], "weights": [1.0, 0.0]},
    ]
    tables["constraints"]["separation_m"] = 1.0
    return problem_from_dict(tables)


def paths(problem, seed=0):
    """Paths of all robots, of one step."""
    return [plan.positions_m for plan in solve(problem, seed=seed).plans]


@pytest.mark.parametrize("terms", [(LEARNING, ENERGY), (TRACKING, ENERGY), (MAPPING,)])
def test_weights_equal_to_those_of_the_terms_change_nothing(terms):
    """Bit by bit, for some of the robots or for all."""
    weighted = tuple(term.get("weight", 1.0) for term in terms)
    common = paths(team(*terms, weights=[None, None]))
    for weights in ([weighted, weighted], [None, weighted]):
        for one, other in zip(common, paths(team(*terms, weights=weights)), strict=True):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("terms", [(LEARNING, ENERGY), (MAPPING, ENERGY)])
def test_a_term_of_weight_zero_is_not_there(terms):
    """A robot alone plans as in the problem that never had the term, and so do two of a team."""
    (found,) = paths(team(*terms, weights=[(1.0, 0.0)]))
    assert np.array_equal(found, paths(team(terms[0], weights=[None]))[0])
    moves, stands = paths(team(*terms, weights=[(1.0, 0.0), (0.0, 3.0)]))
    assert np.array_equal(moves, found)
    assert np.abs(stands - stands[0]).max() < 1e-9 < np.abs(moves - moves[0]).max()


def test_only_robots_whose_terms_count_the_others_are_told_of_them():
    """A robot that only saves energy is told nothing; what it does counts for the mapping one."""
    solution = solve(team(MAPPING, ENERGY, weights=[(0.0, 1.0), None, (1.0, 0.0)]))
    assert [len(aim.pending.planned_m) for aim in solution.aims] == [0, 1, 2]


def test_a_courier_arrives_while_a_scout_maps(tmp_path):
    """The run ends when the courier has arrived; the saved run is sound, and a changed one not."""
    problem = courier_and_scout()
    run = simulate(problem, seed=1)
    courier, scout = (one.log.positions_m for one in run.runs)
    assert (run.outcome, run.verified_rate) == (Outcome.REACHED, 1.0)
    assert np.linalg.norm(courier[-1] - (10.0, 24.0)) <= problem.constraints.goal_radius_m
    assert np.linalg.norm(np.diff(scout, axis=0), axis=1).sum() > 5.0
    run.save(tmp_path)
    assert check(tmp_path).verdict.value == "verified"
    file = tmp_path / "run.json"
    record = json.loads(file.read_text())
    record["problem_file"]["robots"][1]["weights"] = [2.0, 0.0]
    file.write_text(json.dumps(record))
    assert check(tmp_path).verdict.value != "verified"


def test_weights_are_read_and_saved():
    """As they were given."""
    problem = courier_and_scout()
    assert [robot.weights for robot in problem.robots] == [(0.0, 5.0), (1.0, 0.0)]
    assert problem_from_dict(problem_to_dict(problem)) == problem


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ((1.0,), r"weights has 1 numbers for 2 objective\.terms"),
        ((0.0, 0.0), r"weights are all 0"),
        ((-1.0, 1.0), r"robots\[\]\.weights\[0\]: is -1\.0"),
        ((float("nan"), 1.0), r"robots\[\]\.weights\[0\]: is nan"),
    ],
)
def test_weights_that_say_nothing_are_named(weights, words):
    """With the robot that has them."""
    with pytest.raises(InputError, match=words):
        team(LEARNING, ENERGY, weights=[weights])


def test_goals_and_weights_go_together():
    """A goal without a term that leads there, a term without its goal, and the task reach."""
    tables = problem_to_dict(courier_and_scout())
    courier, scout = tables["robots"]
    for robots, words in (
        ([{**courier, "weights": [1.0, 0.0]}, scout], r"robots\[0\]\.goal_m needs a weight above"),
        ([courier, {**scout, "weights": [1.0, 2.0]}], r"needs robots\[1\]\.goal_m"),
    ):
        with pytest.raises(InputError, match=words):
            problem_from_dict({**tables, "robots": robots})
    reach = {
        **tables,
        "problem": {**tables["problem"], "task": "reach"},
        "robots": [courier],
        "objective": {},
    }
    reach["constraints"]["p_min"] = 0.5
    with pytest.raises(InputError, match=r"task reach has no terms"):
        problem_from_dict(reach)
