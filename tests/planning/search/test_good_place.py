"""The last start: places just in reach that the lattice comes to too late."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import bad_where, belief_of, context_of, small_problem
from scipy.optimize import brentq
from terms_scene import SENDING, scorer_of, terms_problem

from planopt import Verdict
from planopt.channel.kriging import bound_margin_db, predict
from planopt.extend import Rung, Termination
from planopt.planning.candidates import Scorer
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.proof.rule import VerifierContext
from planopt.planning.search.place_paths import paths_to_good_place
from planopt.world import index_obstacles, swept_clearance_m

LEFT_BAD = bad_where(lambda x, _: x < 20.0)
SHARE = 0.97
"""Three steps are so much of a step longer than the way: too little for the lattice's moves along
an axis, which are two thirds of the root of five shorter than a step."""


def edge_m(problem):
    """Where x meets the bound at y = 15, by the posterior."""
    posterior = belief_of(problem, LEFT_BAD).posterior

    def margin(x):
        power = predict(posterior, np.array([[x, 15.0]]))
        threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
        return bound_margin_db(power.mean_db, power.deviation_db, threshold, p_min)[0]

    return brentq(margin, 17.0, 23.0)


def just_in_reach(*polygons, planner="lattice", **more):
    """A robot three steps left of where the bound is met, that only sends."""
    problem = small_problem(*polygons, planner=planner, horizon=5, **more)
    start = (edge_m(problem) - 3.0 * SHARE * problem.step_length_m, 15.0)
    robot = replace(problem.robots[0], start_m=start, goal_m=None)
    problem = replace(problem, robots=(robot,), objective=terms_problem(SENDING).objective)
    return problem, np.array(start)


def planned(problem, start):
    belief = belief_of(problem, LEFT_BAD)
    situation = context_of(problem, belief, start)
    scorer, ground = scorer_of(situation, belief)
    return HorizonPlanner(problem, ground).plan(situation, scorer)


@pytest.mark.parametrize("planner", ["lattice", "auto"])
def test_a_place_that_the_lattice_comes_to_too_late(planner):
    """Two steps cannot meet the bound, the third and all after it do."""
    plan = planned(*just_in_reach(planner=planner))
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.relaxed_steps == (1, 2)
    if planner == "lattice":
        assert plan.rung is Rung.COLD_RETRY


def standing(problem, start, steps):
    """The scorer of a step, and a candidate that stands still."""
    index = index_obstacles(problem.workspace)
    posteriors = belief_of(problem, LEFT_BAD).posteriors
    scorer = Scorer(VerifierContext(problem, index, posteriors, start), lambda *_: 0.0)
    path = np.tile(start, (steps, 1))
    return scorer, scorer.assessed(scorer.candidate(path, Rung.STOP, Termination.NO_PATH))


def test_the_way_leads_round_an_obstacle():
    """Clear all along, steps no longer than a step, and the good place in as few as can be."""
    post = shapely.box(16.4, 14.6, 17.0, 15.9)
    problem, start = just_in_reach(post)
    scorer, still = standing(problem, start, 5)
    assert still.avoidable[0] in (3, 4)
    paths = paths_to_good_place(scorer, [still])
    assert paths
    way = np.vstack([start, paths[0]])
    assert way.shape == (6, 2)
    assert swept_clearance_m(scorer.index, way).min() >= problem.constraints.clearance_m
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() <= problem.step_length_m
    margins = scorer.margins_db(predict(scorer.context.posterior, way[1:]))
    assert (margins >= 0.0).tolist() == [False, False, False, True, True]
