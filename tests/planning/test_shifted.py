"""The last plan as a start: only if it was verified and can be driven today."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import belief_of, small_problem

from planopt import Verdict
from planopt.planning.plan import shifted_path
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.world import index_obstacles

PROBLEM = small_problem(horizon=5)


@pytest.fixture(scope="module")
def last():
    """A plan from the start."""
    planner = ReachPlanner(PROBLEM, build_scene(PROBLEM))
    return planner.plan(belief_of(PROBLEM), np.asarray(PROBLEM.robots[0].start_m))


def shifted(last, problem=PROBLEM, at=None):
    """What is left of the plan, from its second place or another."""
    at = last.positions_m[1] if at is None else at
    return shifted_path(problem, index_obstacles(problem.workspace), np.asarray(at), last)


def test_rest_and_a_stand(last):
    """Everything after the first step, and the end once more."""
    rest = shifted(last)
    np.testing.assert_array_equal(rest[:-1], last.positions_m[2:])
    np.testing.assert_array_equal(rest[-1], last.positions_m[-1])


def test_no_plan_or_an_unverified_one(last):
    """Nothing starts from such."""
    index = index_obstacles(PROBLEM.workspace)
    assert shifted_path(PROBLEM, index, last.positions_m[1], None) is None
    for verdict in (Verdict.VIOLATED, Verdict.FEASIBLE_UNVERIFIED, Verdict.NONE):
        assert shifted(replace(last, verdict=verdict)) is None


def test_what_cannot_be_driven_today(last):
    """An obstacle on it, a robot elsewhere, a slower one, narrower bounds, another horizon."""
    x, y = 0.5 * (last.positions_m[3] + last.positions_m[4])
    robot = PROBLEM.robots[0]
    slow = replace(PROBLEM, robots=(replace(robot, speed_max_m_s=0.9 * robot.speed_max_m_s),))
    assert shifted(last, small_problem(shapely.Point(x, y).buffer(0.1), horizon=5)) is None
    assert shifted(last, at=last.positions_m[1] + (0.0, 3.0)) is None
    assert shifted(last, slow) is None
    narrow = replace(PROBLEM.workspace, bounds_m=(0.0, 0.0, float(x), 30.0))
    assert shifted(last, replace(PROBLEM, workspace=narrow)) is None
    assert shifted(last, small_problem(horizon=4)) is None
