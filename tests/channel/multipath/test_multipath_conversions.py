"""Conversions of m, K and omega against the theory's errata, inverses and SciPy's moments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import loggamma

from planopt import InputError
from planopt.channel.ground_truth import (
    nakagami_m_of_rician,
    nakagami_m_of_std,
    nakagami_mean_db,
    nakagami_std_db,
    rician_k_of_nakagami,
    rician_k_of_std,
    rician_std_db,
)


@pytest.mark.parametrize(
    ("k_factor", "m", "nakagami", "offset", "rician"),
    [
        (5.0, 3.27, 2.60, -0.70, 2.91),
        (10.0, 5.76, 1.89, -0.39, 1.999),
        (30.0, 15.75, 1.11, -0.14, 1.131),
    ],
)
def test_errata_of_the_theory(k_factor, m, nakagami, offset, rician):
    """The three channels of [GM11]: m of K, both exact deviations, Nakagami's mean."""
    assert nakagami_m_of_rician(k_factor) == pytest.approx(m, abs=5e-3)
    assert nakagami_std_db(m) == pytest.approx(nakagami, abs=6e-3)
    assert nakagami_mean_db(m) == pytest.approx(offset, abs=2e-2)
    assert rician_std_db(k_factor) == pytest.approx(rician, abs=1e-3)
    assert rician_k_of_std(rician) == pytest.approx(k_factor, rel=5e-3)
    assert nakagami_m_of_std(nakagami) == pytest.approx(m, rel=1e-2)


@pytest.mark.parametrize("m", [0.5, 1.0, 3.27, 80.0])
def test_moments_are_those_of_scipys_log_gamma(m):
    """Power is Gamma(m) / m, its logarithm SciPy's loggamma less ln m."""
    law = loggamma(m)
    scale = 10.0 / np.log(10.0)
    assert nakagami_mean_db(m) == pytest.approx(scale * (law.mean() - np.log(m)), rel=1e-9)
    assert nakagami_std_db(m) == pytest.approx(scale * law.std(), rel=1e-9)


@given(st.floats(0.0, 1e4))
def test_m_and_k_are_inverse(k_factor):
    """There and back."""
    back = rician_k_of_nakagami(nakagami_m_of_rician(k_factor))
    assert back == pytest.approx(k_factor, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("omega", [0.01, 1.0, 2.78, 5.5])
def test_deviation_and_back(omega):
    """What is found has the deviation that was asked for."""
    assert nakagami_std_db(nakagami_m_of_std(omega)) == pytest.approx(omega, rel=1e-9)
    assert rician_std_db(rician_k_of_std(omega)) == pytest.approx(omega, rel=1e-9)


def test_worse_than_rayleigh():
    """Nakagami reaches 9.65 dB at m = 1/2, Rician only 5.57 dB."""
    assert nakagami_m_of_std(9.6) == pytest.approx(0.5, abs=5e-3)
    with pytest.raises(InputError, match=r"5\.57"):
        rician_k_of_std(5.6)


@pytest.mark.parametrize(
    ("convert", "value"),
    [
        (nakagami_m_of_rician, -0.1),
        (nakagami_m_of_rician, np.inf),
        (rician_k_of_nakagami, 0.9),
        (rician_k_of_nakagami, np.nan),
        (nakagami_mean_db, 0.4),
        (nakagami_std_db, np.nan),
        (nakagami_m_of_std, 10.0),
        (nakagami_m_of_std, 0.0),
        (rician_k_of_std, np.nan),
    ],
)
def test_out_of_range(convert, value):
    """Refused with the range that is allowed."""
    with pytest.raises(InputError):
        convert(value)
