"""Where a map is wanted: the whole workspace, fine where a plan can change anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, situation_of, terms_problem

from planopt.planning.values.exploration import region_along, region_near, workspace_region
from planopt.world.clearance import clearance_m, index_obstacles


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


def test_a_long_reach_has_the_whole_region():
    """Where the fine grid would be no finer."""
    problem, whole, _ = regions()
    far = replace(problem, planner=replace(problem.planner, horizon=200))
    near = region_near(far, whole, np.array([10.0, 15.0]))
    assert near is whole or len(near.weight) > len(whole.weight)


def test_places_along_a_path_are_those_near_it():
    """With the weights that they have."""
    situation, _ = situation_of(terms_problem(TRACKING))
    problem, _, near = regions()
    path = situation.position_m + np.arange(1, 6)[:, None] * [0.3, 0.2]
    along = region_along(problem, near, path)
    away = np.linalg.norm(near.grid_m[:, None] - path, axis=2).min(axis=1)
    assert 0 < len(along.weight) < len(near.weight)
    assert along.weight.sum() == pytest.approx(near.weight[away <= 2.5].sum())
