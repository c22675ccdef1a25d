"""Costs of reaching a goal and of motion, against brute force over speeds and sums by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planopt.objectives import MotionEnergyTerm
from planopt.problems.problem import (
    cost_rate_s_m,
    cruising_speed_m_s,
    outage_share,
    path_cost_s,
    step_cost_s,
)

WEIGHTS = st.floats(0.0, 50.0).filter(lambda w: w == 0.0 or w > 1e-6)
SPEEDS = st.floats(0.05, 50.0)
GOAL = np.array([100.0, 0.0])


def test_the_price_is_charged_below_the_bound_or_everywhere():
    """1 - P, of places that keep the bound only where everything is charged."""
    chance, below = np.array([0.2, 0.7, 0.9]), np.array([True, True, False])
    assert outage_share(chance, below) == pytest.approx([0.8, 0.3, 0.0])
    assert outage_share(chance, below, everywhere=True) == pytest.approx([0.8, 0.3, 0.1])


@settings(deadline=None)
@given(WEIGHTS, SPEEDS)
def test_cost_rate_is_the_minimum_over_speeds(weight, speed_max):
    """No speed allowed costs less a metre, and the cruising speed costs exactly the rate."""
    speeds = speed_max * np.linspace(1e-3, 1.0, 20_001)
    brute = (1.0 + weight * speeds**2) / speeds
    rate = cost_rate_s_m(weight, speed_max)
    assert rate <= brute.min() * (1.0 + 1e-12)
    cruising = cruising_speed_m_s(weight, speed_max)
    assert 0.0 < cruising <= speed_max
    assert rate == pytest.approx((1.0 + weight * cruising**2) / cruising)
    # The grid's best speed is within a cell of the cruising speed (or both are its first cell).
    assert abs(speeds[brute.argmin()] - max(cruising, speeds[0])) <= speed_max * 1e-3


def test_closed_forms():
    """Without effort the rate is 1 / v_max; with a free speed it is 2 sqrt(w)."""
    assert cost_rate_s_m(0.0, 4.0) == 0.25
    assert cruising_speed_m_s(0.0, 4.0) == 4.0
    assert cruising_speed_m_s(0.25, 10.0) == 2.0
    assert cost_rate_s_m(0.25, 10.0) == 1.0
    assert cost_rate_s_m(0.25, 1.0) == 1.25


@settings(deadline=None)
@given(WEIGHTS, SPEEDS, st.floats(0.01, 10.0), st.floats(0.001, 1.0))
def test_step_costs_at_least_its_length_at_the_rate(weight, speed_max, step_s, share):
    """The rate is a lower bound of a moving step's cost: the cost to go never overestimates."""
    length = share * speed_max * step_s
    cost = float(step_cost_s(np.array(length), step_s, weight))
    assert cost >= cost_rate_s_m(weight, speed_max) * length * (1.0 - 1e-12)


def test_cost_of_a_path_by_hand():
    """Steps of 3 and 4 m of 2 s each: 2 + 0.1 9 / 2 + 2 + 0.1 16 / 2."""
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])
    assert path_cost_s(path, GOAL, 1.0, 2.0, 0.1) == pytest.approx(4.0 + 0.05 * 25.0)


def test_only_steps_that_start_short_of_the_goal_cost():
    """Arriving costs; the border of the goal's disc is the goal; standing there is free."""
    path = np.array([[97.0, 0.0], [99.0, 0.0], [100.0, 0.0], [100.0, 0.0]])
    assert path_cost_s(path, GOAL, 1.0, 1.0, 0.5) == 1.0 + 0.5 * 4.0
    assert path_cost_s(path, GOAL, 0.5, 1.0, 0.5) == 2.0 + 0.5 * (4.0 + 1.0)
    assert path_cost_s(np.tile(GOAL, (5, 1)), GOAL, 1.0, 1.0, 0.5) == 0.0
    assert path_cost_s(np.array([[0.0, 0.0]]), GOAL, 1.0, 1.0, 0.5) == 0.0


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=8),
    st.floats(0.0, 2.0 * np.pi),
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
def test_moving_and_turning_the_world_changes_nothing(points, angle, shift):
    """The cost depends on distances only, and splits into the costs of the path's parts."""
    path = np.array(points)
    goal = np.array([10.0, 5.0])
    distance = np.linalg.norm(path - goal, axis=1)
    radius = 3.0
    if np.abs(distance - radius).min() < 1e-6:  # rounding could move a place over the border
        return
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cost = path_cost_s(path, goal, radius, 0.7, 0.3)
    moved = path_cost_s(path @ turn.T + shift, turn @ goal + shift, radius, 0.7, 0.3)
    assert moved == pytest.approx(cost, rel=1e-9, abs=1e-9)
    parts = [path_cost_s(path[k : k + 2], goal, radius, 0.7, 0.3) for k in range(len(path) - 1)]
    assert cost == pytest.approx(sum(parts), rel=1e-12, abs=1e-12)
    assert path_cost_s(2.0 * path, 2.0 * goal, 2.0 * radius, 1.4, 0.3) == pytest.approx(2.0 * cost)


MOTION = MotionEnergyTerm(weight=1.0, per_metre_j_m=3.5, power_w=0.3)


def test_motion_by_hand():
    """Steps of 2 s: 3.5 J a metre and 0.3 W while moving; standing still costs nothing."""
    spent = -MOTION.move_reward(np.array([1.0, 2.0, 0.0]), 2.0)
    np.testing.assert_allclose(spent, [3.5 + 0.6, 7.0 + 0.6, 0.0])
