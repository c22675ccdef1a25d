"""Rician fading against closed forms, the theory's table and its own samples."""

import numpy as np
import pytest
from scipy.special import exp1
from scipy.stats import rice

from planopt.channel.fields.multipath import (
    rician_field_db,
    rician_mean_db,
    rician_std_db,
)


@pytest.mark.parametrize(("k_factor", "expected"), [(5.0, 2.91), (10.0, 1.999), (30.0, 1.131)])
def test_deviations_of_the_theory(k_factor, expected):
    """The exact dB deviations that the theory's errata list."""
    assert rician_std_db(k_factor) == pytest.approx(expected, abs=1e-3)


def test_rayleigh():
    """K = 0: mean -gamma and deviation pi / sqrt(6) in nepers."""
    assert rician_mean_db(0.0) == pytest.approx(-10.0 / np.log(10.0) * np.euler_gamma, rel=1e-12)
    assert rician_std_db(0.0) == pytest.approx(10.0 / np.log(10.0) * np.pi / np.sqrt(6.0))


@pytest.mark.parametrize("k_factor", [0.01, 1.0, 10.0, 200.0])
def test_mean_in_closed_form(k_factor):
    """E ln power = ln(K / (K + 1)) + E1(K)."""
    expected = np.log(k_factor / (k_factor + 1.0)) + exp1(k_factor)
    assert rician_mean_db(k_factor) == pytest.approx(10.0 / np.log(10.0) * expected, rel=1e-9)


@pytest.mark.parametrize("k_factor", [0.5, 10.0])
def test_deviation_by_quadrature(k_factor):
    """Against integrating SciPy's Rice density."""
    scatter = np.sqrt(0.5 / (k_factor + 1.0))
    law = rice(np.sqrt(2.0 * k_factor), scale=scatter)
    amplitude = np.linspace(1e-7, 12.0 * scatter + 1.0, 2_000_001)
    weight = law.pdf(amplitude) * (amplitude[1] - amplitude[0])
    level = 20.0 * np.log10(amplitude)
    mean = weight @ level
    assert rician_mean_db(k_factor) == pytest.approx(mean, abs=1e-5)
    assert rician_std_db(k_factor) == pytest.approx(np.sqrt(weight @ (level - mean) ** 2), abs=1e-5)


def test_nearly_no_scatter():
    """Large K: the deviation tends to 20 / ln 10 / sqrt(2 K)."""
    assert rician_std_db(1e6) == pytest.approx(20.0 / np.log(10.0) / np.sqrt(2e6), rel=1e-5)


def test_field_has_mean_zero_in_db_and_unit_power():
    """Samples within 4 standard errors; undoing the shift gives unit mean power."""
    count = 200_000
    field = rician_field_db((count // 100, 100), 5.0, np.random.default_rng(0))
    assert field.shape == (2000, 100)
    assert abs(field.mean()) < 4.0 * rician_std_db(5.0) / np.sqrt(count)
    assert field.std() == pytest.approx(rician_std_db(5.0), rel=0.02)
    power = 10.0 ** ((field + rician_mean_db(5.0)) / 10.0)
    assert abs(power.mean() - 1.0) < 4.0 * power.std() / np.sqrt(count)


def test_field_is_the_seeds():
    """Same seed, same field."""
    one, two = (rician_field_db((3, 4), 10.0, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
