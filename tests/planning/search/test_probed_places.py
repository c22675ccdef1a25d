"""Ways to places that are tried: free, within the step length, and round obstacles."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, context_of, scorer_of, terms_problem

from planopt import Verdict
from planopt.channel import Measurements
from planopt.planning.planners import planner_for
from planopt.planning.search import place_paths
from planopt.planning.search.node_margins import NodeField
from planopt.planning.search.place_paths import PROBED, ProbedPlaces
from planopt.planning.values.objective_value import ObjectiveValue

RECOURSE = {**TRACKING, "form": "recourse"}


@pytest.fixture(scope="module")
def step():
    """A situation with its scorer and ground."""
    problem = terms_problem(RECOURSE, horizon=6)
    context, belief = context_of(problem)
    scorer, ground = scorer_of(context, belief)
    return problem, context, scorer, ground


def found_ways(problem, context, ground):
    """The ways of a search whose field knows what the situation does."""
    field = NodeField(ground.road_map.lattice)
    field.refresh(context, problem.planner.horizon * problem.step_length_m)
    return ProbedPlaces(problem, ground).find_paths(context, field)


def test_ways_keep_the_step_length_and_end_at_rest(step):
    """All of them start where the robot is; the best come first by the value of the term."""
    problem, context, _, ground = step
    ways = found_ways(problem, context, ground)
    assert len(ways) == PROBED
    for way in ways:
        legs = np.linalg.norm(np.diff(np.vstack([context.position_m, way]), axis=0), axis=1)
        assert legs.max() <= problem.step_length_m


def test_plans_try_what_is_worth_it(step):
    """The released plan is verified, and worth no less than any way of the search."""
    problem, context, scorer, ground = step
    plan = planner_for(problem, ground, np.random.default_rng(0)).plan(context, scorer)
    assert plan.verdict is Verdict.VERIFIED
    for way in found_ways(problem, context, ground):
        assert plan.objective >= scorer.objective(way) - 1e-12


def test_known_connection_draws_the_robot(step):
    """A measurement with connection beside the target is where the plan ends."""
    problem, context, _, ground = step
    here = context.position_m
    beside = here + np.array([1.1 * problem.step_length_m, 0.0])
    reading = Measurements(beside[None], np.array([context.law.thresholds_dbm[0] + 1.0]))
    known = replace(
        context,
        posteriors=(context.posterior.extend(reading),),
        aim=replace(context.aim, target_m=np.tile(beside + (1.0, 0.0), (6, 1))),
    )
    ends = [way[-1] for way in found_ways(problem, known, ground)]
    np.testing.assert_array_equal(ends[0], beside)


@pytest.mark.parametrize("seed", range(6))
def test_the_best_of_all_places_is_among_the_compared(seed, monkeypatch):
    """Predicting the ends of all ways instead finds nothing that is worth a hundredth more."""
    problem = terms_problem(RECOURSE, horizon=6)
    context, belief = context_of(problem, seed)
    _, ground = scorer_of(context, belief)
    worth = ObjectiveValue(context)
    best = max(worth(way) for way in found_ways(problem, context, ground))
    monkeypatch.setattr(place_paths, "COMPARED", 10**6)
    assert best >= 0.99 * max(worth(way) for way in found_ways(problem, context, ground))
