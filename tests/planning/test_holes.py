"""Coverage holes of a path: where they are, how long, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import bad_band, belief_of, small_problem

from planopt.planning.holes import goal_in_words, holes_along, holes_in_words
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene

PROBLEM = small_problem()


def line(*x_m: float) -> np.ndarray:
    """Places along y = 15."""
    return np.array([(x, 15.0) for x in x_m])


def test_lengths_by_hand():
    """Steps within count whole, steps in and out by half; a hole may be at either end."""
    places = line(0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 11.0)
    chance = np.array([0.2, 0.95, 0.5, 0.4, 0.95, 0.95, 0.1])
    first, middle, last = holes_along(places, chance, chance < 0.9)
    assert (first.length_m, middle.length_m, last.length_m) == (1.0, 4.0, 0.5)
    assert middle.from_m == (4.0, 15.0) and middle.to_m == (6.0, 15.0)
    assert middle.least_connectivity == 0.4
    assert [hole.to_end for hole in (first, middle, last)] == [False, False, True]


def test_lengths_add_up_however_a_path_is_cut():
    """Places between places change no total where both ends are alike."""
    generator = np.random.default_rng(3)
    x = np.sort(generator.uniform(0.0, 50.0, 40))
    below = (x > 12.0) & (x < 30.0)
    coarse = holes_along(line(*x), np.where(below, 0.1, 0.95), below)
    between = np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])]))
    inside = np.interp(between, x, below.astype(float)) == 1.0
    edges = (np.interp(between, x, below.astype(float)) > 0.0) & ~inside
    fine = holes_along(line(*between), np.where(inside, 0.1, 0.95), inside)
    gaps = np.diff(x)[np.diff(below.astype(int)) != 0]
    assert len(coarse) == len(fine) == 1 and edges.sum() == 2
    # Half a step in and out of either end becomes a quarter.
    assert coarse[0].length_m - fine[0].length_m == pytest.approx(0.25 * gaps.sum())


def test_no_hole_no_words():
    """Nor about the goal."""
    assert holes_along(line(0.0, 2.0), np.array([0.95, 0.95]), np.array([False, False])) == ()
    assert holes_in_words(PROBLEM, ()) == goal_in_words(PROBLEM, ()) == []


def test_a_plan_names_the_hole_ahead_of_it():
    """Beyond its horizon as well, to the goal where that is in it."""
    for low, high, at_goal in ((18.0, 24.0, False), (30.0, 41.0, True)):
        power = bad_band(low, high)
        plan = ReachPlanner(PROBLEM, build_scene(PROBLEM)).plan(
            belief_of(PROBLEM, power), np.array(PROBLEM.robots[0].start_m)
        )
        assert plan.certificate.relaxed_steps == ()
        [hole] = plan.holes
        assert low - 2.0 <= hole.from_m[0] <= low + 3.0
        assert hole.to_end == at_goal == bool(goal_in_words(PROBLEM, plan.holes))
        assert np.allclose(plan.route_m[-1], PROBLEM.goal_m)
        told = " ".join(holes_in_words(PROBLEM, plan.holes))
        assert f"{hole.length_m:.0f} m" in told and "outage_price 10" in told


def test_of_many_holes_the_longest_are_told():
    """And how many are not."""
    below = np.arange(40) % 4 == 1
    holes = holes_along(line(*range(40)), np.where(below, 0.1, 0.95), below)
    longest = replace(holes[3], length_m=9.0)
    told = holes_in_words(PROBLEM, (*holes[:3], longest, *holes[4:]))
    assert len(told) == 6 and "9 m" in told[3]
    assert told[4].endswith(f"{len(holes) - 4} shorter ones")
