"""Fits and predictions from powers in whole steps, over simulated channels."""

import dataclasses
import math

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Station, condition, fit_channel
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import covariance_bounds
from planopt.channel.estimation.likelihood import RestrictedLikelihood, likelihood_data
from planopt.channel.estimation.reml import reml_fit
from planopt.channel.gaussian_sites import needs_site
from planopt.channel.parameters import mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 20.0, 1.0, Station((50.0, 50.0), 10.0))
STEP_DB = 3.0
COUNT = 180
SEEDS = 30


def in_steps(measurements, step_db, told=True):
    """Powers in whole steps; `told` says whether the measurements know."""
    resolution = np.full(len(measurements), step_db if told else 0.0)
    power = np.round(measurements.power_dbm / step_db) * step_db
    return dataclasses.replace(measurements, power_dbm=power, resolution_db=resolution)


def first(measurements, count):
    """The first of the measurements, the others being held out."""
    return measurements.take(slice(0, count)), measurements.take(slice(count, None))


@pytest.fixture(scope="module")
def fits():
    """For each seed: held-out powers, rounded measurements, and fits that know of it or not."""
    found = []
    for seed in range(SEEDS):
        raw, held_out = first(simulated(CHANNEL, seed, COUNT + 30, 45.0), COUNT)
        told, untold = in_steps(raw, STEP_DB), in_steps(raw, STEP_DB, told=False)
        station = CHANNEL.station
        fits = (fit_channel(each, station, "reml") for each in (told, untold))
        found.append((held_out, told, *fits))
    return found


def estimates(fits):
    found = [fit.parameters for fit in fits]
    return np.array([[p.shadow_std_db, p.multipath_std_db, p.decorrelation_m] for p in found])


def test_omega_is_biased_only_if_rounding_is_unknown(fits):
    """Near the truth if rounding is known, else near sqrt(omega^2 + r^2 / 12)."""
    told = estimates([fit for *_, fit, _ in fits])
    untold = estimates([fit for *_, fit in fits])
    error = told.std(axis=0) / math.sqrt(SEEDS)
    assert told[:, 1].mean() == pytest.approx(1.0, abs=3.0 * error[1])
    biased = math.sqrt(1.0 + STEP_DB**2 / 12.0)
    assert untold[:, 1].mean() == pytest.approx(biased, abs=3.0 * error[1])
    assert untold[:, 1].mean() > 1.0 + 3.0 * error[1]
    assert told[:, 0].mean() == pytest.approx(6.0, abs=3.0 * error[0])
    # Its distribution has a long tail.
    assert np.median(told[:, 2]) == pytest.approx(20.0, abs=3.0 * 1.25 * error[2])
    omegas = estimates([fit for *_, fit, _ in fits])[:, 1]
    errors = [fit.standard_errors["multipath_std_db"] for *_, fit, _ in fits]
    assert np.std(omegas) == pytest.approx(np.median(errors), rel=0.5)


@one_blas_thread()
def test_prediction_intervals_cover(fits):
    """95 % intervals of exact powers at other places cover, with estimated parameters."""
    inside = []
    for held_out, told, fit, _ in fits:
        found = condition(fit.parameters, told).predict(held_out.positions_m)
        inside.append(np.abs(held_out.power_dbm - found.mean_db) < 1.96 * found.deviation_db)
    assert 0.92 < np.mean(inside) < 0.98


@one_blas_thread()
def test_the_refit_with_intervals_is_an_optimum():
    """No step from the optimum, in any parameter, raises the likelihood with intervals."""
    told = in_steps(simulated(CHANNEL, 3, 80, 40.0), 6.0)
    station = CHANNEL.station
    model = mean_model(told.positions_m, ~told.censored, station, True)
    bounds = covariance_bounds(40.0, (1.0, 60.0))
    found = reml_fit(model, told, bounds, CHANNEL)
    estimate = found.covariance
    assert needs_site(told, estimate.multipath_variance_db2).all()
    data = likelihood_data(model, told, CHANNEL, np.ones(80, dtype=bool))
    top = np.array(estimate.values)
    assert RestrictedLikelihood(data).at(tuple(top)).log_likelihood == pytest.approx(
        found.best.at.log_likelihood, abs=1e-6
    )
    ranges = (bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m)
    for i, (low, high) in enumerate(ranges):
        for factor in (0.8, 1.25):
            moved = top.copy()
            moved[i] = np.clip(factor * moved[i], low, high)
            assert (
                RestrictedLikelihood(data).at(tuple(moved)).log_likelihood
                < found.best.at.log_likelihood + 1e-6
            )


@pytest.mark.parametrize("method", ["lemma1", "capped", "convex", "nls"])
def test_other_methods_take_rounding_out_of_omega(method):
    """omega^2 = alpha - xi^2 without the r^2 / 12 that rounding adds to alpha."""
    channel = dataclasses.replace(CHANNEL, multipath_std_db=3.0)
    raw = simulated(channel, 6, 300, 150.0)
    told, untold = in_steps(raw, 4.0), in_steps(raw, 4.0, told=False)
    alphas = []
    for each in (told, untold):
        found = fit_channel(each, CHANNEL.station, method).parameters
        alphas.append(found.shadow_std_db**2 + found.multipath_std_db**2)
    assert alphas[1] - alphas[0] == pytest.approx(16.0 / 12.0, abs=0.2)
