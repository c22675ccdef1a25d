"""Multipath of every kind: what m, K and omega mean, and draws against SciPy's laws."""

import math

import numpy as np
import pytest
from scipy.special import exp1, psi
from scipy.stats import kstest, loggamma, norm, rice

from planopt import InputError
from planopt.channel import Lognormal, Nakagami, Rician, multipath_of
from planopt.channel.ground_truth import multipath_field_db, rician_std_db

NEPER_DB = 10.0 / math.log(10.0)


def mean_db(multipath):
    """Closed forms of the mean in dB at unit mean power: E ln of a lognormal, gamma, Rice power."""
    if isinstance(multipath, Lognormal):
        return -(multipath.std_db**2) / (2.0 * NEPER_DB)
    if isinstance(multipath, Nakagami):
        return NEPER_DB * (psi(multipath.m) - math.log(multipath.m))
    k = multipath.k_factor
    return NEPER_DB * (-np.euler_gamma if k == 0.0 else math.log(k / (k + 1.0)) + exp1(k))


GIVEN = [
    ("nakagami", {"m": 0.7}),
    ("nakagami", {"k": 5.0}),
    ("nakagami", {"std_db": 2.78}),
    ("rician", {"k": 5.0}),
    ("rician", {"m": 3.27}),
    ("rician", {"std_db": 2.78}),
    ("rayleigh", {}),
    ("lognormal", {"std_db": 2.78}),
    ("lognormal", {"m": 3.27}),
    ("lognormal", {"k": 5.0}),
]


@pytest.mark.parametrize(("kind", "number"), GIVEN)
def test_draws(kind, number):
    """Within 4 standard errors: mean zero in dB, deviation omega, unit mean power unshifted."""
    multipath = multipath_of(kind, **number)
    count = 200_000
    field = multipath_field_db((500, 400), multipath, np.random.default_rng(4))
    assert field.shape == (500, 400)
    assert abs(field.mean()) < 4.0 * multipath.std_db / math.sqrt(count)
    squares = (field**2).ravel()
    assert abs(squares.mean() - multipath.std_db**2) < 4.0 * squares.std() / math.sqrt(count)
    power = 10.0 ** ((field + mean_db(multipath)) / 10.0)
    assert abs(power.mean() - 1.0) < 4.0 * power.std() / math.sqrt(count)


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
    assert multipath_of("lognormal", k=5.0) == Lognormal(rician_std_db(5.0))


@pytest.mark.parametrize(
    ("kind", "number", "says"),
    [
        ("rician", {}, "given by nothing"),
        ("rician", {"m": 3.0, "k": 2.0}, "given by m and k"),
        ("rayleigh", {"k": 0.0}, "the kind alone"),
        ("rician", {"m": 0.8}, "key m"),
        ("rician", {"k": -1.0}, "key k"),
        ("rician", {"std_db": 6.0}, "deviation of 6"),
        ("nakagami", {"std_db": 9.7}, "deviation of 9"),
        ("nakagami", {"m": math.nan}, "key m"),
        ("lognormal", {"std_db": -1.0}, "key std_db"),
    ],
)
def test_what_does_not_exist(kind, number, says):
    """Errors name the number."""
    with pytest.raises(InputError, match=says):
        multipath_of(kind, **number)
