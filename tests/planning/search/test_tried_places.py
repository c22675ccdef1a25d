"""Ways to places that are tried: free, within the step length, and round obstacles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, judge_of, situation_of, terms_problem

from planopt import solve
from planopt.errors import InputError
from planopt.planning.plan import Verdict
from planopt.planning.planners import planner_for
from planopt.planning.search.tried_places import TRIED, TriedPlaces
from planopt.robots.double_integrator import DoubleIntegrator

RECOURSE = {**TRACKING, "form": "recourse"}


@pytest.fixture(scope="module")
def step():
    """A situation with its judge and ground."""
    problem = terms_problem(RECOURSE, horizon=6)
    situation, belief = situation_of(problem)
    judge, ground = judge_of(situation, belief)
    return problem, situation, judge, ground


def test_ways_keep_the_step_length_and_end_at_rest(step):
    """All of them start where the robot is; the best come first by the value of the term."""
    problem, situation, _, ground = step
    ways = TriedPlaces(problem, ground).find_ways(situation)
    assert len(ways) == TRIED
    for way in ways:
        legs = np.linalg.norm(np.diff(np.vstack([situation.position_m, way]), axis=0), axis=1)
        assert legs.max() <= problem.step_length_m


def test_plans_try_what_is_worth_it(step):
    """The released plan is verified, and worth no less than any way of the search."""
    problem, situation, judge, ground = step
    plan = planner_for(problem, ground, np.random.default_rng(0)).plan(situation, judge)
    assert plan.verdict is Verdict.VERIFIED
    for way in TriedPlaces(problem, ground).find_ways(situation):
        assert plan.objective >= judge.objective(way) - 1e-12


def test_known_connection_draws_the_robot(step):
    """A measurement with connection beside the target is where the plan ends."""
    problem, situation, _, ground = step
    here = situation.position_m
    beside = here + np.array([1.1 * problem.step_length_m, 0.0])
    links = replace(situation.links, connected_m=beside[None], lost_m=np.zeros((0, 2)))
    known = replace(situation, target_m=np.tile(beside + (1.0, 0.0), (6, 1)))
    object.__setattr__(known, "links", links)
    ends = [way[-1] for way in TriedPlaces(problem, ground).find_ways(known)]
    np.testing.assert_array_equal(ends[0], beside)


def test_robots_with_inertia_do_not_turn_back_at_will():
    """The form is refused, in words."""
    problem = terms_problem(RECOURSE, horizon=3)
    robot = replace(problem.robots[0], dynamics=DoubleIntegrator(1.0, 0.5))
    with pytest.raises(InputError, match="turn and stop at will"):
        solve(replace(problem, robots=(robot,)))
