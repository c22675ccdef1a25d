"""Bounds, the fallback, and omega from equation 2.3."""

import math

import pytest

from planopt.channel.estimation.channel_fit import (
    covariance_bounds,
    fallback_fit,
    from_correlation,
)

BOUNDS = covariance_bounds(20.0, (1.0, 100.0))


def test_inside_the_bounds_nothing_is_changed():
    """omega^2 = alpha - xi^2, and errors follow by the delta method."""
    found = from_correlation(16.0, 0.1, (2.0, 0.01), 20.0, 50, BOUNDS)
    assert found.warnings == ()
    assert found.shadow_variance_db2 + found.multipath_variance_db2 == pytest.approx(20.0)
    assert found.decorrelation_m == pytest.approx(10.0)
    expected = (2.0 / (2.0 * 4.0), math.hypot(2.0, 4.0) / (2.0 * 2.0), 0.01 * 100.0)
    assert found.standard_errors == pytest.approx(expected)


@pytest.mark.parametrize(("rate", "beta"), [(-0.5, 100.0), (0.0, 100.0), (50.0, 1.0)])
def test_a_rate_outside_its_range_is_reported(rate, beta):
    """A correlation that grows, stays or falls at once puts beta at a bound."""
    found = from_correlation(16.0, rate, (2.0, 0.01), 20.0, 50, BOUNDS)
    assert found.decorrelation_m == pytest.approx(beta)
    assert found.standard_errors[2] == math.inf
    assert any("beta is at a bound" in text for text in found.warnings)


def test_negative_multipath_is_reported():
    """xi^2 above alpha leaves omega at its floor, unknown, with the value in the warning."""
    found = from_correlation(25.0, 0.1, (2.0, 0.01), 20.0, 50, BOUNDS)
    assert found.multipath_variance_db2 == pytest.approx(0.2)
    assert found.standard_errors[1] == math.inf
    assert any("-5 dB^2" in text for text in found.warnings)


def test_no_shadowing_is_reported():
    """xi^2 = 0 is moved to the least value."""
    found = from_correlation(0.0, 0.1, (2.0, 0.01), 20.0, 50, BOUNDS)
    assert found.shadow_variance_db2 == pytest.approx(0.01)
    assert any("xi is at a bound" in text for text in found.warnings)


def test_the_fallback_keeps_the_total_variance():
    """Total variance is split; beta stands within its range even if that is a point."""
    found = fallback_fit(20.0, (1.0, 100.0), "because")
    assert found.shadow_variance_db2 + found.multipath_variance_db2 == pytest.approx(20.0)
    assert found.decorrelation_m == 25.0
    assert "because" in found.warnings[0]
    assert fallback_fit(0.0, (10.0, 10.0), "because").decorrelation_m == 10.0
