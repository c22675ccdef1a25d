"""Rician fading against closed forms, the theory's table and its own samples."""

import numpy as np
import pytest
from scipy.special import exp1
from scipy.stats import rice

from planopt.channel.ground_truth import (
    rician_mean_db,
    rician_std_db,
)


@pytest.mark.parametrize(("k_factor", "expected"), [(5.0, 2.91), (10.0, 1.999), (30.0, 1.131)])
def test_deviations_of_the_theory(k_factor, expected):
    """The exact dB deviations that the theory's errata list."""
    assert rician_std_db(k_factor) == pytest.approx(expected, abs=1e-3)


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
