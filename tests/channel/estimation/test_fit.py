"""The five methods through the one call, on known channels, degenerate cases and real logs."""

import dataclasses
import math

import numpy as np
import pytest
from refusals import refused
from simulated_channel import simulated, subset
from small_cases import assert_usable

from planopt.channel import ChannelParameters, Measurements, Station, fit_channel
from planopt.channel.parameters import PRIOR_N_PL, regressors

METHODS = ("lemma1", "capped", "convex", "nls", "reml")
CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))


def values(fit):
    p = fit.parameters
    return np.array([p.k_pl_db, p.n_pl, p.shadow_std_db, p.decorrelation_m, p.multipath_std_db])


@pytest.mark.parametrize("method", METHODS)
def test_many_measurements_recover_the_channel(method):
    """At a favourable size every method is near the truth, each as near as it can be."""
    measurements = simulated(CHANNEL, 4, 700, 1200.0)
    fit = fit_channel(measurements, CHANNEL.station, method)
    k_pl, n_pl, shadow, beta, multipath = values(fit)
    assert n_pl == pytest.approx(3.0, abs=3.0 * fit.standard_errors["n_pl"])
    assert k_pl == pytest.approx(-40.0, abs=3.0 * fit.standard_errors["k_pl_db"])
    assert np.hypot(shadow, multipath) == pytest.approx(np.hypot(6.0, 2.0), rel=0.2)
    if method == "reml":
        # The places are too far apart to tell omega well.
        assert fit.status == "weak" and "multipath is poorly determined" in fit.warnings[0]
        assert shadow == pytest.approx(6.0, rel=0.15)
        assert beta == pytest.approx(30.0, rel=0.35)
        assert multipath == pytest.approx(2.0, rel=0.4)
    if method == "lemma1":
        # Equation 2.3 as printed keeps positive noise at long lags.
        assert shadow < 4.0
        assert beta > 90.0


def test_censoring_is_a_term_of_the_likelihood():
    """With 30 % at the floor reml is unbiased over channels, and the two simple methods are not."""
    estimates = {"censored": [], "as exact": [], "dropped": []}
    for seed in range(12):
        measurements = simulated(CHANNEL, 100 + seed, 200, 300.0, 0.3)
        as_exact = dataclasses.replace(measurements, censored=np.zeros(200, bool))
        dropped = subset(measurements, ~measurements.censored)
        for name, given in zip(estimates, (measurements, as_exact, dropped), strict=True):
            estimates[name].append(values(fit_channel(given, CHANNEL.station)))
    mean = {name: np.mean(rows, axis=0) for name, rows in estimates.items()}
    truth = np.array([-40.0, 3.0, 6.0])
    errors = {name: np.abs(row[:3] - truth) for name, row in mean.items()}
    assert (errors["censored"] < 0.6 * errors["as exact"]).all()
    assert (errors["censored"] < 0.6 * errors["dropped"]).all()
    assert errors["censored"][1] < 0.25
    assert errors["censored"][2] < 0.6


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [60, 400, 2_100])
def test_the_order_of_rows_does_not_matter(method, count):
    """A permutation of the rows gives the same fit to the last bit, exact or by blocks."""
    measurements = simulated(CHANNEL, 11, count, 20.0 * count**0.5, 0.2)
    shuffled = measurements.take(np.random.default_rng(3).permutation(count))
    first, second = (fit_channel(m, CHANNEL.station, method) for m in (measurements, shuffled))
    assert second.parameters == first.parameters
    assert second.standard_errors == first.standard_errors
    assert second.warnings == first.warnings


def test_all_rows_count():
    """Of many, the fit by blocks is that of one factor: within a tenth of its standard errors."""
    measurements = simulated(CHANNEL, 12, 1000, 600.0, 0.2)
    exact = fit_channel(measurements, CHANNEL.station)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("planopt.channel.estimation.reml.EXACT_ROWS", 800)
        blocks = fit_channel(measurements, CHANNEL.station)
    names = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
    for name in names:
        apart = getattr(blocks.parameters, name) - getattr(exact.parameters, name)
        assert 0.0 < abs(apart) < 0.15 * exact.standard_errors[name]
        assert blocks.standard_errors[name] == pytest.approx(exact.standard_errors[name], rel=0.2)


def test_both_maxima_are_reported():
    """If several sets of parameters explain the powers, the best and the others are reported."""
    fit = fit_channel(simulated(CHANNEL, 4, 150, 1000.0), CHANNEL.station, "reml")
    other, *_ = fit.other_modes
    apart = [fit.log_likelihood - each.log_likelihood for each in fit.other_modes]
    assert 0.0 < min(apart) and apart == sorted(apart) and max(apart) < 2.0
    assert other.parameters.decorrelation_m > 2.0 * fit.parameters.decorrelation_m
    assert other.parameters.multipath_std_db > 3.0 * fit.parameters.multipath_std_db
    assert fit.status in ("weak", "degenerate")
    assert any(text.startswith("another set of parameters") for text in fit.warnings)


def test_what_is_hardly_determined_is_said():
    """Few measurements, or shadowing that is forgotten at once: status, and words for why."""
    fit = fit_channel(simulated(CHANNEL, 2, 30, 100.0), CHANNEL.station)
    assert fit.status == "weak"
    words = "the decorrelation distance is poorly determined: "
    assert any(text.startswith(words) and "with standard error" in text for text in fit.warnings)
    rng = np.random.default_rng(1)
    places = rng.uniform(0.0, 100.0, (60, 2))
    power = -60.0 + rng.normal(0.0, 3.0, 60)
    dated = Measurements(places, power, np.zeros(60, bool), time_s=np.arange(60.0))
    fit = fit_channel(dated, Station((50.0, 50.0), 5.0), forgetting_s=1e-9)
    assert math.isinf(fit.standard_errors["shadow_std_db"])
    assert fit.status == "degenerate" and "do not determine" in " ".join(fit.warnings)


@pytest.mark.parametrize("method", METHODS)
def test_one_distance_assumes_the_exponent(method):
    """On a circle about the station n_PL is the prior's, said so, and carried into the errors."""
    angle = np.linspace(0.0, 6.0, 40)
    positions = 100.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    power = -100.0 + np.random.default_rng(0).standard_normal(40)
    circle = Measurements(positions, power, np.zeros(40, bool))
    fit = fit_channel(circle, Station((0.0, 0.0)), method)
    assert_usable(fit)
    assert fit.status == "degenerate"
    assert fit.warnings[0].startswith("n_PL is assumed")
    assert fit.parameters.n_pl == PRIOR_N_PL
    there = regressors(positions[:1], Station((0.0, 0.0))) @ values(fit)[:2]
    assert there[0] == pytest.approx(-100.0, abs=1.0)


@pytest.mark.parametrize("method", METHODS)
def test_few_measurements_assume_the_covariance(method):
    """One to five measurements give a usable, degenerate fit that says what is assumed."""
    for count in range(1, 6):
        fit = fit_channel(simulated(CHANNEL, 8, count, 300.0), CHANNEL.station, method)
        assert_usable(fit)
        assert fit.status == "degenerate"
        assert fit.standard_errors["shadow_std_db"] == math.inf
        assert ("n_PL is assumed" in fit.warnings[0]) == (count < 3)


@pytest.mark.parametrize("method", METHODS)
def test_all_censored_stays_below_every_limit(method):
    """With limits alone the path loss line touches the tightest one and passes none."""
    measurements = dataclasses.replace(simulated(CHANNEL, 9, 30, 300.0), censored=np.ones(30, bool))
    fit = fit_channel(measurements, CHANNEL.station, method)
    assert_usable(fit)
    room = (
        measurements.power_dbm
        - regressors(measurements.positions_m, CHANNEL.station) @ values(fit)[:2]
    )
    assert room.min() == pytest.approx(0.0, abs=1e-9)
    assert any("every measurement is censored" in text for text in fit.warnings)


@pytest.mark.parametrize("method", METHODS)
def test_powers_exactly_on_the_line(method):
    """Zero residual variance: theta exact, the rest assumed or at a bound."""
    positions = np.random.default_rng(0).uniform(0, 100, (20, 2))
    power = regressors(positions, CHANNEL.station) @ [-40.0, 3.0]
    fit = fit_channel(Measurements(positions, power, np.zeros(20, bool)), CHANNEL.station, method)
    assert_usable(fit)
    assert fit.status == "degenerate"
    np.testing.assert_allclose(values(fit)[:2], [-40.0, 3.0], rtol=1e-6)


def test_no_two_lags_to_fit():
    """A log-domain fit without two usable lags falls back and says so."""
    positions = np.array([[0.0, 0], [10, 0], [0, 10], [10, 10], [20, 0], [0, 20]]) * 5.0
    fits = [
        fit_channel(
            Measurements(
                positions, -70.0 + np.random.default_rng(seed).standard_normal(6), np.zeros(6, bool)
            ),
            CHANNEL.station,
            "capped",
        )
        for seed in range(5)
    ]
    assert any("fewer than two lags" in text for fit in fits for text in fit.warnings)


@pytest.mark.parametrize("extent_m", [1e-160, 1e-9])
@pytest.mark.parametrize("method", METHODS)
def test_places_hardly_apart_are_one_place(extent_m, method):
    """Distances of less than a micrometre say nothing of a channel; no dependency's error."""
    rng = np.random.default_rng(0)
    places = 40.0 + extent_m * rng.uniform(0.0, 1.0, (40, 2))
    if extent_m < 1e-100:
        places -= 40.0
    told = Measurements(places, rng.normal(-70.0, 3.0, 40), np.zeros(40, bool))
    with refused():
        fit_channel(told, Station((50.0, 50.0)), method)
