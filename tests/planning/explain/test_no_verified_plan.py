"""A bound that cannot be met: by how much, and what would let it be met."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from scenes import BAD, THRESHOLD_DBM, bad_everywhere, belief_of, kriged, small_problem

from planopt import Problem, Solution, Verdict, explain
from planopt.objectives.terms.term import Aim
from planopt.planning.explain.changes import rounded
from planopt.planning.proof.searches import build_goal_grid
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.world import index_obstacles


def solved(problem: Problem, power_at) -> Solution:
    belief = belief_of(problem, power_at)
    start = np.asarray(problem.robots[0].start_m)
    plan = ReachPlanner(problem, build_scene(problem)).plan(belief, start)
    return Solution(problem, 0, belief, (plan,), (Aim(),))


def changed(problem: Problem, key: str, value: float) -> Problem:
    """The problem with another value of a key."""
    if key == "constraints.p_min":
        return replace(problem, constraints=replace(problem.constraints, p_min=value))
    assert key == "stations[0].threshold_dbm"
    return replace(problem, stations=(replace(problem.stations[0], threshold_dbm=value),))


def slope(places_m: np.ndarray) -> np.ndarray:
    """Better and better to the right, below the threshold to the end of the workspace."""
    return THRESHOLD_DBM - 10.5 + 0.25 * places_m[:, 0]


# Nodes of the lattice 1 m apart, so that the readings, where power is known best, are nodes.
STEP_M = 5.0**0.5
PROBLEM = small_problem(start_m=(15.0, 15.0), horizon=4, speed_max_m_s=STEP_M)


@pytest.fixture(scope="module")
def said():
    """What is said of the slope, by key."""
    solution = solved(PROBLEM, slope)
    assert solution.plan.verdict is Verdict.VIOLATED
    return {relaxation.constraint: relaxation for relaxation in explain(solution)}


def everywhere() -> np.ndarray:
    """Mean and deviation at the verifier's places in the workspace, by kriging written out."""
    places = build_goal_grid(PROBLEM, index_obstacles(PROBLEM.workspace)).nodes_m
    mean, deviation = kriged(belief_of(PROBLEM, slope), places)
    return mean, np.maximum(deviation, 1e-9)


def test_largest_probability_anywhere(said):
    """The largest p_min that a place of the workspace keeps, by plain kriging and SciPy."""
    mean, deviation = everywhere()
    best = scipy.stats.norm.sf(THRESHOLD_DBM, mean, deviation).max()
    entry = said["constraints.p_min"]
    assert entry.value == 0.9 and entry.stages == (1, 2, 3, 4)
    assert best - 0.01 <= entry.relaxed_value <= best + 1e-3


def test_missing_decibels_anywhere(said):
    """The threshold lowered by what the best place lacks, and by little more."""
    mean, deviation = everywhere()
    margin = mean - scipy.stats.norm.ppf(0.9) * deviation - THRESHOLD_DBM
    entry = said["stations[0].threshold_dbm"]
    assert entry.shortfall == pytest.approx(-margin.max(), abs=0.05)
    assert entry.shortfall_unit == "dB" and entry.unit == "dBm"
    assert margin.max() - 0.05 <= entry.relaxed_value - THRESHOLD_DBM <= margin.max() + 1e-3


@pytest.mark.parametrize("key", ["constraints.p_min", "stations[0].threshold_dbm"])
def test_relaxed_value_is_the_least(key, said):
    """Solved again with it the plan is verified, with 5 % less relaxation it is not."""
    entry = said[key]
    assert entry.verified
    almost = entry.value - 0.95 * (entry.value - entry.relaxed_value)
    assert solved(changed(PROBLEM, key, entry.relaxed_value), slope).plan.verdict is (
        Verdict.VERIFIED
    )
    assert solved(changed(PROBLEM, key, almost), slope).plan.verdict is Verdict.VIOLATED


def test_nothing_to_explain():
    """A verified plan, also one that misses the bound where it must."""
    assert explain(solved(PROBLEM, lambda places: slope(places) + 30.0)) == ()


def test_a_threshold_is_named_where_nothing_is_connected():
    found = {r.constraint: r for r in explain(solved(PROBLEM, bad_everywhere))}
    lowered = found["stations[0].threshold_dbm"]
    assert lowered.verified and BAD - 5.0 < lowered.relaxed_value < BAD


def test_numbers_that_can_be_typed_in():
    assert rounded(0.123456, 4, down=True) == 0.1234
    assert rounded(0.123456, 4, down=False) == 0.1235
    assert rounded(-83.4567, 4, down=True) == -83.46
    assert rounded(2.0, 4, down=True) == 2.0
    assert rounded(0.0, 4, down=True) == 0.0
