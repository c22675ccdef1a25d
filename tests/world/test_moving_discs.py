"""Lines from moving discs, and predicted discs that cover what they predict."""

from dataclasses import replace

import numpy as np
import pytest

from planopt import MovingObstacle
from planopt.world import centres_at, growth_m, predicted_discs

TURNING = MovingObstacle("cart", 1.5, (2.0, 3.3, 7.0), ((0.0, 0.0), (4.0, 1.0), (4.0, -6.0)))
STRAIGHT = MovingObstacle("van", 2.0, (0.0,), ((3.0, 4.0),), (1.0, -0.5))


def test_centres_follow_the_trajectory():
    """Before, at, between and after what is given."""
    found = centres_at(TURNING, np.array([0.0, 2.0, 2.65, 3.3, 7.0, 9.0]))
    expected = [[0, 0], [0, 0], [2, 0.5], [4, 1], [4, -6], [4, -6]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    found = centres_at(STRAIGHT, np.array([0.0, 4.0]))
    np.testing.assert_allclose(found, [[3, 4], [7, 2]])


@pytest.mark.parametrize("obstacle", [TURNING, STRAIGHT])
@pytest.mark.parametrize("now_s", [0.0, 1.7])
def test_discs_cover_the_true_disc_at_all_times(obstacle, now_s):
    """The true centre is never farther from the straight path than the radius is enlarged."""
    step_s, steps = 0.8, 9
    discs = predicted_discs((obstacle,), now_s, step_s, steps, 0.3)
    shares = np.linspace(0.0, 1.0, 401)
    tight = True
    for k in range(steps):
        true = centres_at(obstacle, now_s + step_s * (k + shares))
        centres = discs.centres_m[0]
        chord = (1 - shares)[:, None] * centres[k] + shares[:, None] * centres[k + 1]
        away = np.linalg.norm(true - chord, axis=1).max()
        grown = discs.radius_m[0, k] - obstacle.radius_m
        assert away <= grown + 1e-9
        tight = tight and grown <= away + 0.05
    assert tight
    np.testing.assert_allclose(discs.apart_m, discs.radius_m + 0.3)


def test_no_step_is_larger_where_turns_are_at_their_ends():
    whole = replace(TURNING, times_s=(2.0, 3.0, 7.0))
    assert (predicted_discs((whole,), 0.0, 0.1, 80, 0.0).radius_m == 1.5).all()
    assert (predicted_discs((STRAIGHT,), 0.3, 0.7, 9, 0.0).radius_m == 2.0).all()


def test_growth_keeps_its_probability():
    """Errors drawn from the model stay within it all the step at least as often as it says."""
    probability, step_s, draws = 0.9, 0.5, 20_000
    obstacle = replace(
        STRAIGHT, position_std_m=0.2, acceleration_std_m_s2=0.4, probability=probability
    )
    generator = np.random.default_rng(4)
    at_first = 0.2 * generator.normal(size=(draws, 1, 2))
    acceleration = 0.4 * generator.normal(size=(draws, 1, 2))
    for k in range(6):
        times = step_s * np.linspace(k, k + 1, 11)[:, None]
        error = np.linalg.norm(at_first + 0.5 * acceleration * times**2, axis=2)
        grown = growth_m(obstacle, np.array([step_s * (k + 1)]))[0]
        kept = float((error.max(axis=1) <= grown).mean())
        # Both ends are charged, although the error hardly changes in one step.
        assert probability <= kept + 0.01
        assert kept <= (1.0 + probability) / 2.0 + 0.01
    assert growth_m(STRAIGHT, np.arange(5.0)).max() == 0.0
