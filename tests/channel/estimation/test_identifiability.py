"""What measurements can tell, and what is refused."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import Measurements, Station
from planopt.channel.estimation.least_squares import examine

ORIGIN = Station((0.0, 0.0))


def at(positions, censored=None):
    """Measurements of -70 dBm at positions."""
    positions = np.asarray(positions, dtype=float).reshape(-1, 2)
    count = len(positions)
    flags = np.zeros(count, bool) if censored is None else np.asarray(censored)
    return Measurements(positions, np.full(count, -70.0), flags)


def test_nothing_measured():
    """No measurements at all is bad input."""
    with pytest.raises(InputError, match="no measurements"):
        examine(at([]), ORIGIN)


def test_a_measurement_at_the_station_is_named():
    """The error carries the index of the measurement; a height makes it usable."""
    measurements = at([[1, 0], [2, 0], [0, 0], [5, 5]])
    with pytest.raises(InputError, match="log of zero distance") as caught:
        examine(measurements, ORIGIN)
    assert caught.value.row == 2
    examine(measurements, Station((0.0, 0.0), 3.0))


def test_a_circle_about_the_station_does_not_tell_the_exponent():
    """At one distance n_PL is not identifiable, but the covariance is."""
    angle = np.linspace(0, 6, 20)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) * 30.0
    found = examine(at(circle), ORIGIN)
    assert "one distance" in (found.n_pl_reason or "")
    assert found.covariance_reason is None
    assert examine(at(circle + np.array([5.0, 0.0])), ORIGIN).n_pl_reason is None


def test_censored_measurements_do_not_count():
    """Only exact values identify; few or crowded ones do not identify the covariance."""
    line = np.arange(1, 21)[:, None] * np.array([[1.0, 0.0]])
    assert examine(at(line), ORIGIN).covariance_reason is None
    few = examine(at(line, np.arange(20) > 4), ORIGIN)
    assert "5 uncensored" in (few.covariance_reason or "")
    crowded = examine(at([[1, 0]] * 5 + [[2, 0]] * 5), ORIGIN)
    assert "three places" in (crowded.covariance_reason or "")


def test_bounds_of_beta_follow_spacing_and_extent():
    """On a lattice the bounds are a third of its pitch and the diagonal, at any offset."""
    lattice = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * 6.0
    for offset in (1.0, 3e6):
        found = examine(at(np.repeat(lattice, 2, axis=0) + offset), ORIGIN)
        assert found.decorrelation_bounds_m == pytest.approx((2.0, np.hypot(24.0, 18.0)))
