"""Energy of motion: closed forms."""

import numpy as np

from planopt.objectives.terms.distance import MotionEnergyTerm

MOTION = MotionEnergyTerm(weight=1.0, per_metre_j_m=3.5, power_w=0.3)


def test_motion_by_hand():
    """Steps of 2 s: 3.5 J a metre and 0.3 W while moving; standing still costs nothing."""
    spent = -MOTION.move_reward(np.array([1.0, 2.0, 0.0]), 2.0)
    np.testing.assert_allclose(spent, [3.5 + 0.6, 7.0 + 0.6, 0.0])


def test_motion_at_constant_speed_costs_the_rate():
    """A metre costs k_1 + k_2 / v."""
    for speed in (0.5, 0.75, 2.0):
        spent = -MOTION.move_reward(np.array([2.0 * speed]), 2.0)
        np.testing.assert_allclose(spent / (2.0 * speed), 3.5 + 0.3 / speed)
