"""Fits with priors on the exponent and the decorrelation distance (equations 2.13 and 2.14)."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station, condition, fit_channel
from planopt.channel.held_out import learn_path_loss, learn_plain_process
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.problems.library import library_folder

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
WIDE_DB2 = 1e8


def dense(parameters: ChannelParameters, places_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean and covariance of powers with n_PL ~ N(2, 1) and K_PL of a very wide prior."""
    gamma = regressors(places_m, parameters.station)
    covariance = shadow_covariance_db2(places_m, places_m, parameters)
    covariance += parameters.multipath_std_db**2 * np.eye(len(places_m))
    return 2.0 * gamma[:, 1], covariance + WIDE_DB2 + np.outer(gamma[:, 1], gamma[:, 1])


@pytest.mark.parametrize("exact_limit", [1_000, 10])
def test_path_loss_and_predictions_have_the_prior_of_the_exponent(exact_limit: int) -> None:
    """Against one dense normal distribution of all powers; few readings make the prior matter."""
    parameters = replace(CHANNEL, n_pl_prior=(2.0, 1.0))
    data = simulated(CHANNEL, 3, 12, 60.0)
    posterior = condition(parameters, data, exact_limit=exact_limit)
    places = np.random.default_rng(5).uniform(0.0, 120.0, (7, 2))
    count = len(data)
    mean, covariance = dense(parameters, np.vstack([data.positions_m, places]))
    gain = np.linalg.solve(covariance[:count, :count], covariance[:count, count:]).T
    expected = mean[count:] + gain @ (data.power_dbm - mean[:count])
    spread = np.diag(covariance)[count:] - np.einsum("ij,ij->i", gain, covariance[count:, :count])
    found = posterior.predict(places)
    np.testing.assert_allclose(found.mean_db, expected, atol=1e-3)
    np.testing.assert_allclose(found.deviation_db, np.sqrt(spread), rtol=1e-3)
    flat = condition(CHANNEL, data).theta_covariance[1, 1]
    assert posterior.theta_covariance[1, 1] < min(1.0, flat)


def test_fit_maximises_the_posterior_density() -> None:
    """Against an independent search over the dense density times the prior of beta."""
    data = simulated(CHANNEL, 7, 60, 200.0)
    found = fit_channel(data, CHANNEL.station).parameters
    extent = float(np.hypot(*np.ptp(data.positions_m, axis=0)))

    def loss(logs: np.ndarray) -> float:
        xi, beta, omega = np.exp(logs)
        trial = replace(CHANNEL, shadow_std_db=xi, decorrelation_m=beta, multipath_std_db=omega)
        density = multivariate_normal.logpdf(data.power_dbm, *dense(trial, data.positions_m))
        return -density - norm.logpdf(logs[1], math.log(extent / 6.0), 0.7)

    start = np.log([found.shadow_std_db, found.decorrelation_m, found.multipath_std_db])
    best = minimize(loss, start + 0.2, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    np.testing.assert_allclose(start, best.x, atol=5e-3)
    assert found.n_pl_prior == (2.0, 1.0)


def test_rows_in_any_order_and_lengths_in_any_unit() -> None:
    """The same estimate to the last bit, and beta in proportion to all lengths."""
    data = simulated(CHANNEL, 8, 80, 200.0)
    fit = fit_channel(data, CHANNEL.station).parameters
    shuffled = data.take(np.random.default_rng(0).permutation(len(data)))
    assert fit_channel(shuffled, CHANNEL.station).parameters == fit
    longer = Measurements(10.0 * data.positions_m, data.power_dbm)
    other = fit_channel(longer, Station((500.0, 500.0), 100.0)).parameters
    assert other.decorrelation_m == pytest.approx(10.0 * fit.decorrelation_m, rel=1e-3)
    assert other.n_pl == pytest.approx(fit.n_pl, rel=1e-3)


def test_frame_of_any_rotation() -> None:
    """A log along a street gives one fit, with the street along an axis or not."""
    data = simulated(CHANNEL, 8, 80, 200.0)
    places = data.positions_m * (1.0, 0.1)
    mast = np.array([50.0, 30.0])
    fits = []
    for angle in (0.0, 0.7):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        station = Station(tuple((turn @ mast).tolist()), 10.0)
        found = fit_channel(Measurements(places @ turn.T, data.power_dbm), station).parameters
        fits.append((found.n_pl, found.decorrelation_m, found.shadow_std_db))
    np.testing.assert_allclose(fits[1], fits[0], rtol=1e-3)


def test_prior_without_a_spread_is_refused() -> None:
    """A standard deviation of zero is no prior."""
    with refused():
        replace(CHANNEL, n_pl_prior=(2.0, 0.0))


def test_later_drive_is_predicted_with_honest_intervals() -> None:
    """With times, multipath that lasts is no shadowing, and white multipath changes nothing."""
    channel = ChannelParameters(-40.0, 3.0, 3.0, 20.0, 4.0, Station((50.0, 50.0), 10.0))
    errors = {"dated": [], "undated": []}
    for seed in range(6):
        generator = np.random.default_rng(seed)
        along, later = np.arange(300.0), generator.uniform(0.0, 100.0, (300, 2))
        drive = 50.0 + 50.0 * np.column_stack([np.sin(along / 17.0), np.sin(along / 23.0)])
        covariance = shadow_covariance_db2(*[np.vstack([drive, later])] * 2, channel)
        covariance[:300, :300] += 14.0 * np.exp(-np.abs(along[:, None] - along) / 8.0)
        covariance += np.diag(np.repeat([2.0, 16.0], 300))
        mean = regressors(np.vstack([drive, later]), channel.station) @ [-40.0, 3.0]
        power = mean + np.linalg.cholesky(covariance) @ generator.standard_normal(600)
        for name, times in (("dated", along), ("undated", np.zeros(300))):
            log = Measurements(drive, power[:300], time_s=times)
            fit = fit_channel(log, channel.station)
            assert any("lasts" in each for each in fit.warnings) == (name == "dated")
            predicted = condition(fit.parameters, log).predict(later)
            errors[name].append((power[300:] - predicted.mean_db) / predicted.deviation_db)
    covered = {name: (np.abs(np.array(each)) < 1.96).mean() for name, each in errors.items()}
    assert 0.92 < covered["dated"] < 0.97
    assert covered["undated"] < covered["dated"]
    white = simulated(CHANNEL, 8, 80, 200.0)
    dated = replace(white, time_s=np.arange(80.0))
    fits = [fit_channel(each, CHANNEL.station) for each in (white, dated)]
    assert fits[0].parameters == fits[1].parameters


def test_flat_is_predicted_no_worse_than_without_radio() -> None:
    """The third drive from 150 readings of the others: path loss, plain process, intervals."""
    file = Path(library_folder()) / "data" / "flat_log.csv"
    rows = np.genfromtxt(file, delimiter=",", names=True, dtype=None, encoding="utf-8")
    anchors = np.genfromtxt(file.with_name("flat_anchors.csv"), delimiter=",", skip_header=1)
    scores = np.empty((len(anchors), 4))
    for score, (anchor, x, y, height) in zip(scores, anchors, strict=True):
        own = rows[rows["anchor"] == anchor]
        places = np.column_stack([own["x_m"], own["y_m"]])
        out = own["drive"] == 3
        known = np.random.default_rng(int(anchor)).permutation(np.flatnonzero(~out))[:150]
        learnt = Measurements(places[known], own["power_dbm"][known])
        held_out = Measurements(places[out], own["power_dbm"][out])
        station = Station((x, y), height)
        fit = fit_channel(learnt, station)
        predicted = condition(fit.parameters, learnt).predict(places[out])
        error = held_out.power_dbm - predicted.mean_db
        rivals = (learn_path_loss(learnt, station), learn_plain_process(learnt))
        others = [held_out.power_dbm - rival(held_out).mean_db for rival in rivals]
        score[:3] = [np.sqrt((each**2).mean()) for each in (error, *others)]
        score[3] = (np.abs(error) < 1.96 * predicted.deviation_db).mean()
    channel, path_loss, plain_process, covered = scores.mean(axis=0)
    assert channel < 1.005 * min(path_loss, plain_process)
    assert 0.90 < covered < 0.98
