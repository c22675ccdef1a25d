"""Coverage, PIT and error of predictions whose faults are known."""

import numpy as np
import pytest
from scipy.stats import norm, uniform

from planopt import InputError
from planopt.channel import Measurements, Prediction, calibrate
from planopt.channel.calibration import share_between

COUNT = 20_000


def drawn(spread=1.0, shift=0.0, limit_above=None):
    """Powers drawn from N(-80, 4), some seen only as a limit; and a faulty prediction of them."""
    rng = np.random.default_rng(0)
    power = rng.normal(-80.0, 4.0, COUNT)
    censored = np.zeros(COUNT, dtype=bool)
    if limit_above is not None:
        censored = power < limit_above
        power = np.where(censored, limit_above, power)
    prediction = Prediction(np.full(COUNT, -80.0 + shift), np.full(COUNT, 4.0 * spread))
    return prediction, Measurements(rng.uniform(0.0, 1.0, (COUNT, 2)), power, censored)


def test_right_predictions():
    """Every interval contains its level, the PIT is uniform, the error is the deviation."""
    found = calibrate(*drawn())
    for one in found.coverage:
        assert one.low < one.level < one.high
        assert one.low < one.share < one.high
    np.testing.assert_allclose(found.pit_share, 0.05, atol=0.006)
    assert found.pit_share.sum() == pytest.approx(1.0)
    assert found.rmse_db == pytest.approx(4.0, rel=0.02)
    assert (found.count, found.censored) == (COUNT, 0)


@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_wrong_deviation(spread):
    """A deviation wrong by a factor: coverage is 2 Phi(z factor) - 1."""
    for one in calibrate(*drawn(spread)).coverage:
        expected = 2.0 * norm.cdf(norm.ppf(0.5 + 0.5 * one.level) * spread) - 1.0
        assert one.share == pytest.approx(expected, abs=0.01)


def test_wrong_mean():
    """A mean too high by a deviation puts the PIT low, and into the error."""
    found = calibrate(*drawn(shift=4.0))
    expected = norm.cdf(norm.ppf(np.linspace(0.0, 1.0, 21)) + 1.0)
    np.testing.assert_allclose(found.pit_share, np.diff(expected), atol=0.01)
    assert found.rmse_db == pytest.approx(np.sqrt(32.0), rel=0.02)


@pytest.mark.parametrize("limit", [-84.0, -78.0])
def test_censored_are_counted_in_parts(limit):
    """Right predictions stay right with a floor; only the uncensored are in the error."""
    prediction, held_out = drawn(limit_above=limit)
    found = calibrate(prediction, held_out)
    for one in found.coverage:
        assert one.share == pytest.approx(one.level, abs=0.01)
    np.testing.assert_allclose(found.pit_share, 0.05, atol=0.006)
    exact = ~held_out.censored
    assert found.censored == (~exact).sum()
    assert found.rmse_db == pytest.approx(np.sqrt(np.mean((held_out.power_dbm[exact] + 80.0) ** 2)))


def test_parts_of_a_limit():
    """Shares by hand, the ends of the range included."""
    upper, censored = np.array([0.4]), np.array([True])
    assert share_between(upper, censored, 0.1, 0.2) == pytest.approx(0.25)
    assert share_between(upper, censored, 0.3, 1.0) == pytest.approx(0.25)
    nothing = np.array([0.0])
    assert share_between(nothing, censored, 0.0, 0.1) == 1.0
    assert share_between(nothing, censored, 0.1, 0.2) == 0.0
    exact = np.array([False, False])
    assert share_between(np.array([1.0, 0.5]), exact, 0.95, 1.0) == 0.5
    assert share_between(np.array([0.1, 0.2]), exact, 0.1, 0.2) == 0.5


def test_wilson_interval_covers():
    """Over many small samples the interval holds the true share about 95 times in 100."""
    rng = np.random.default_rng(1)
    held = []
    for _ in range(300):
        pit = uniform.rvs(size=40, random_state=rng)
        prediction = Prediction(np.zeros(40), np.ones(40))
        data = Measurements(np.zeros((40, 2)), norm.ppf(pit), np.zeros(40, dtype=bool))
        (one,) = calibrate(prediction, data, (0.8,)).coverage
        held.append(one.low <= 0.8 <= one.high)
    assert 0.91 <= np.mean(held) <= 0.985


@pytest.mark.parametrize(
    ("mean", "deviation", "levels"),
    [
        (np.zeros(2), np.ones(2), (0.5,)),
        (np.zeros(3), np.zeros(3), (0.5,)),
        (np.zeros(3), np.ones(3), (1.0,)),
    ],
)
def test_bad_input(mean, deviation, levels):
    """Lengths that differ, no deviation, a level out of range."""
    data = Measurements(np.zeros((3, 2)), np.zeros(3), np.zeros(3, dtype=bool))
    with pytest.raises(InputError):
        calibrate(Prediction(mean, deviation), data, levels)
