"""The simulated channel: maps and models clipped at the floor; multipath against SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import exp1, psi
from scipy.stats import kstest, loggamma, norm, rice

from planopt.channel import (
    ChannelParameters,
    Lognormal,
    Nakagami,
    Rician,
    Station,
    measure,
    model_truth,
    multipath_of,
    raster_truth,
    true_power_dbm,
)
from planopt.channel.ground_truth import multipath_field_db
from planopt.channel.parameters import regressors
from planopt.world import Raster

GAINS = np.array([[-80.0, -100.0, np.nan], [-129.0, -131.0, -95.0]])
MAP = Raster(np.array([0.0, 2.0, 4.0]), np.array([10.0, 12.0]), GAINS)
CENTRES = np.array([[x, y] for y in (10.0, 12.0) for x in (0.0, 2.0, 4.0)])
PARAMETERS = ChannelParameters(-40.0, 3.0, 5.0, 20.0, 2.0, Station((-10.0, 5.0), 8.0))


def test_gains_become_powers_clipped_at_the_floor():
    """Transmit power is added; NaN and weak gains are at the floor, and censored."""
    truth = raster_truth(MAP, 30.0, -130.0, None, np.random.default_rng(0))
    np.testing.assert_array_equal(
        true_power_dbm(truth, CENTRES), [-50.0, -70.0, -100.0, -99.0, -100.0, -65.0]
    )
    assert truth.floor_dbm == -100.0
    assert np.isnan(GAINS[0, 2])
    found = measure(raster_truth(MAP, 30.0, -130.0, None, np.random.default_rng(0)), CENTRES)
    np.testing.assert_array_equal(found.censored, [False, False, True, False, True, False])
    np.testing.assert_array_equal(found.positions_m, CENTRES)
    assert found.power_dbm[2] == -100.0


def test_fading_of_places():
    """A seed fixes the fading, which comes before the floor."""
    one, again, other = (
        raster_truth(MAP, 30.0, -130.0, Rician(10.0), np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    first = true_power_dbm(one, CENTRES)
    np.testing.assert_array_equal(first, true_power_dbm(one, CENTRES))
    np.testing.assert_array_equal(first, true_power_dbm(again, CENTRES))
    assert (first != true_power_dbm(other, CENTRES)).any()
    assert first[0] != -50.0
    wide = Raster(np.arange(100.0), np.arange(100.0), np.full((100, 100), -130.5))
    truth = raster_truth(wide, 0.0, -130.0, Rician(10.0), np.random.default_rng(3))
    assert truth.raster.values.min() == -130.0
    assert 0.2 < (truth.raster.values > -130.0).mean() < 0.6


@pytest.mark.parametrize("floor", [None, -100.0])
def test_model_truth_is_the_model(floor):
    """Residuals after path loss have the model's variance; the floor clips and censors."""
    bounds = (0.0, 0.0, 401.0, 300.0)
    truth = model_truth(PARAMETERS, bounds, 4.0, floor, np.random.default_rng(5))
    assert truth.raster.values.shape == (75, 101)
    assert truth.raster.x_m[0] == 2.0
    assert truth.raster.y_m[-1] == 298.0
    xx, yy = np.meshgrid(truth.raster.x_m, truth.raster.y_m)
    centres = np.column_stack([xx.ravel(), yy.ravel()])
    found = measure(truth, centres)
    if floor is None:
        residual = found.power_dbm - regressors(centres, PARAMETERS.station) @ [-40.0, 3.0]
        assert residual.std() == pytest.approx(np.sqrt(29.0), rel=0.15)
        neighbours = np.diff(residual.reshape(75, 101), axis=1)
        expected = 2.0 * (25.0 * (1.0 - np.exp(-4.0 / 20.0)) + 4.0)
        assert neighbours.var() == pytest.approx(expected, rel=0.1)
        assert not found.censored.any()
    else:
        assert found.power_dbm.min() == floor
        np.testing.assert_array_equal(found.censored, found.power_dbm == floor)
        free = model_truth(PARAMETERS, bounds, 4.0, None, np.random.default_rng(5))
        np.testing.assert_array_equal(np.maximum(free.raster.values, floor), truth.raster.values)


def test_model_truth_of_another_multipath():
    """The same shadowing; what differs has the law's deviation, and its skewness to the left."""
    bounds = (0.0, 0.0, 400.0, 400.0)
    law = Nakagami(1.0)
    plain = model_truth(replace(PARAMETERS, multipath_std_db=0.0), bounds, 4.0, None, generator())
    faded = model_truth(PARAMETERS, bounds, 4.0, None, generator(), law)
    fading = (faded.raster.values - plain.raster.values).ravel()
    assert abs(fading.mean()) < 4.0 * law.std_db / 100.0
    assert fading.std() == pytest.approx(law.std_db, rel=0.05)
    assert ((fading / law.std_db) ** 3).mean() < -0.8


def generator():
    return np.random.default_rng(8)


NEPER_DB = 10.0 / math.log(10.0)


def mean_db(multipath):
    """Closed forms of the mean in dB at unit mean power: E ln of a lognormal, gamma, Rice power."""
    if isinstance(multipath, Lognormal):
        return -(multipath.std_db**2) / (2.0 * NEPER_DB)
    if isinstance(multipath, Nakagami):
        return NEPER_DB * (psi(multipath.m) - math.log(multipath.m))
    k = multipath.k_factor
    return NEPER_DB * (-np.euler_gamma if k == 0.0 else math.log(k / (k + 1.0)) + exp1(k))


@pytest.mark.parametrize(
    ("k", "m", "nakagami", "offset", "rician"),
    [
        (5.0, 3.27, 2.60, -0.70, 2.91),
        (10.0, 5.76, 1.89, -0.39, 1.999),
        (30.0, 15.75, 1.11, -0.14, 1.131),
    ],
)
def test_errata_of_the_theory(k, m, nakagami, offset, rician):
    """The three channels of [GM11]: m of K, both exact deviations, Nakagami's mean."""
    assert multipath_of("nakagami", k=k).m == pytest.approx(m, abs=5e-3)
    assert Nakagami(m).std_db == pytest.approx(nakagami, abs=6e-3)
    assert Nakagami(m).mean_db == pytest.approx(offset, abs=2e-2)
    assert Rician(k).std_db == pytest.approx(rician, abs=1e-3)
    assert multipath_of("rician", std_db=rician).k_factor == pytest.approx(k, rel=5e-3)
    assert multipath_of("nakagami", std_db=nakagami).m == pytest.approx(m, rel=1e-2)


@pytest.mark.parametrize("m", [0.5, 1.0, 3.27, 80.0])
def test_nakagami_moments(m):
    """Power is Gamma(m) / m, its logarithm SciPy's loggamma less ln m."""
    assert Nakagami(m).mean_db == pytest.approx(mean_db(Nakagami(m)), rel=1e-9)
    assert Nakagami(m).std_db == pytest.approx(NEPER_DB * loggamma(m).std(), rel=1e-9)


@pytest.mark.parametrize("k", [0.01, 0.5, 10.0, 200.0])
def test_rician_moments(k):
    """The mean in closed form, and both moments by integrating SciPy's Rice density."""
    assert Rician(k).mean_db == pytest.approx(mean_db(Rician(k)), rel=1e-9)
    scatter = np.sqrt(0.5 / (k + 1.0))
    amplitude = np.linspace(1e-7, 12.0 * scatter + 1.0, 2_000_001)
    weight = rice(np.sqrt(2.0 * k), scale=scatter).pdf(amplitude) * (amplitude[1] - amplitude[0])
    level = 20.0 * np.log10(amplitude)
    mean = weight @ level
    assert Rician(k).mean_db == pytest.approx(mean, abs=1e-5)
    assert Rician(k).std_db == pytest.approx(np.sqrt(weight @ (level - mean) ** 2), abs=1e-5)


@given(st.floats(0.0, 1e4))
def test_m_and_k_are_inverse(k):
    """Converting K to m and back returns K."""
    back = multipath_of("rician", m=multipath_of("nakagami", k=k).m).k_factor
    assert back == pytest.approx(k, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("omega", [0.01, 1.0, 2.78, 5.5])
def test_fading_of_a_standard_deviation(omega):
    """The law found has the required standard deviation; only Nakagami exceeds Rayleigh's 5.57."""
    assert multipath_of("nakagami", std_db=omega).std_db == pytest.approx(omega, rel=1e-9)
    assert multipath_of("rician", std_db=omega).std_db == pytest.approx(omega, rel=1e-9)
    assert multipath_of("nakagami", std_db=9.6).m == pytest.approx(0.5, abs=5e-3)


@pytest.mark.parametrize(
    ("multipath", "law"),
    [
        (Rician(5.0), lambda power: rice(math.sqrt(10.0), scale=math.sqrt(1 / 12)).cdf(power**0.5)),
        (Rician(0.0), lambda power: -np.expm1(-power)),
        (Nakagami(3.0), lambda power: loggamma(3.0).cdf(np.log(3.0 * power))),
        (
            Lognormal(2.0),
            lambda power: norm(-0.5 * (2 / NEPER_DB) ** 2, 2 / NEPER_DB).cdf(np.log(power)),
        ),
    ],
)
def test_laws(multipath, law):
    """The power's distribution function takes the draws to uniform numbers (fixed seed)."""
    field = multipath_field_db((20_000,), multipath, np.random.default_rng(5))
    assert kstest(law(10.0 ** ((field + mean_db(multipath)) / 10.0)), "uniform").pvalue > 1e-3


def test_what_the_numbers_mean():
    """A number of its own kind is taken as it is; others by the conversions of the theory."""
    assert multipath_of("nakagami", m=3.27) == Nakagami(3.27)
    assert multipath_of("nakagami", k=5.0) == Nakagami(36.0 / 11.0)
    assert multipath_of("nakagami", std_db=2.6).std_db == pytest.approx(2.6)
    assert multipath_of("rician", k=10.0) == Rician(10.0)
    assert multipath_of("rician", m=36.0 / 11.0).k_factor == pytest.approx(5.0)
    assert multipath_of("rician", std_db=2.0).std_db == pytest.approx(2.0)
    assert multipath_of("rayleigh") == Rician(0.0)
    assert multipath_of("lognormal", std_db=2.78) == Lognormal(2.78)
    assert multipath_of("lognormal", m=3.27).std_db == pytest.approx(2.60, abs=0.006)
    assert multipath_of("lognormal", k=5.0) == Lognormal(Rician(5.0).std_db)
