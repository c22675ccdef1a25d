"""Where a map is wanted: the whole workspace, fine where a plan can change anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, terms_problem

from planopt.planning.values.exploration import region_near, workspace_region
from planopt.world import clearance_m, index_obstacles


def regions(step_m=0.5):
    """The problem of a slow robot, the whole region, and the one near its start."""
    problem = terms_problem(TRACKING)
    slow = replace(problem, robots=(replace(problem.robots[0], speed_max_m_s=step_m),))
    whole = workspace_region(slow)
    return slow, whole, region_near(slow, whole, np.array([10.0, 15.0]))


def test_places_are_fine_near_the_robot_and_free():
    """Nine times as many near it; the others stay."""
    problem, whole, near = regions()
    assert near.weight.sum() == pytest.approx(1.0) and (near.weight > 0.0).all()
    around = np.abs(near.grid_m - [10.0, 15.0]).max(axis=1) <= 5.0
    coarse = np.abs(whole.grid_m - [10.0, 15.0]).max(axis=1) <= 5.0
    assert around.sum() > 9 * coarse.sum()
    assert (~around).sum() == (~coarse).sum()
    assert clearance_m(index_obstacles(problem.workspace), near.grid_m).min() > 0.0


def test_averages_of_what_is_smooth_hardly_change():
    """The weights are shares of area."""
    _, whole, near = regions()

    def average(region):
        return region.weight @ np.cos(0.1 * region.grid_m).prod(axis=1)

    assert average(near) == pytest.approx(average(whole), abs=0.02)
