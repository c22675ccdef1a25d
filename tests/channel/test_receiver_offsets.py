"""Offsets of receivers: estimates, errors, and predictions that are free of them."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    fit_channel,
    measurements,
    receiver_offsets,
)
from planopt.channel import long_logs as module
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-20.0, 2.5, 5.0, 15.0, 2.0, Station((50.0, 130.0), 5.0))
OFFSETS_DB = np.array([0.0, 7.0, -4.0])
PLACES = np.random.default_rng(9).uniform(0.0, 100.0, (50, 2))
METHODS = ("lemma1", "capped", "convex", "nls", "reml")


def cooperative(seed, count, share=0.0):
    """Measurements of three robots in turn, each with its own receiver."""
    alone = simulated(CHANNEL, seed, count, 100.0, share)
    receiver = np.arange(count) % 3
    return replace(alone, power_dbm=alone.power_dbm + OFFSETS_DB[receiver], receiver=receiver)


def without_offsets(data):
    return Measurements(data.positions_m, data.power_dbm - OFFSETS_DB[data.receiver], data.censored)


def explicit_columns(data, parameters):
    """Generalised least squares with a column for each receiver, offsets under a flat prior."""
    positions = data.positions_m
    covariance = shadow_covariance_db2(positions, positions, parameters)
    covariance += parameters.multipath_std_db**2 * np.eye(len(data))
    weight = np.linalg.inv(covariance)
    indicators = (data.receiver[:, None] == [1, 2]).astype(float)
    columns = np.column_stack([regressors(positions, parameters.station), indicators])
    spread = np.linalg.inv(columns.T @ weight @ columns)
    solution = spread @ columns.T @ weight @ data.power_dbm
    across = shadow_covariance_db2(PLACES, positions, parameters) @ weight
    gamma = np.column_stack([regressors(PLACES, parameters.station), np.zeros((len(PLACES), 2))])
    mean = gamma @ solution + across @ (data.power_dbm - columns @ solution)
    return solution, spread, mean


@pytest.fixture
def wide(monkeypatch):
    monkeypatch.setattr(measurements, "RECEIVER_OFFSET_STD_DB", 3000.0)
    monkeypatch.setattr(module, "RECEIVER_OFFSET_STD_DB", 3000.0)


def test_a_flat_prior_is_explicit_columns(wide):
    """Offsets, their errors and predictions are those of least squares with more columns."""
    data = cooperative(0, 120)
    solution, spread, mean = explicit_columns(data, CHANNEL)
    posterior = condition(CHANNEL, data)
    found = receiver_offsets(posterior)
    assert [offset.receiver for offset in found] == [1, 2]
    np.testing.assert_allclose([o.offset_db for o in found], solution[2:], atol=1e-4)
    np.testing.assert_allclose(
        [o.standard_error_db for o in found], np.sqrt(np.diag(spread)[2:]), atol=1e-4
    )
    np.testing.assert_allclose(posterior.theta, solution[:2], atol=1e-4)
    np.testing.assert_allclose(posterior.predict(PLACES).mean_db, mean, atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("share", [0.0, 0.1])
def test_every_fit_finds_them(method, share):
    """Within three standard errors, with limits too; the other parameters as without offsets."""
    data = cooperative(3, 240)
    if share:
        floor = np.quantile(data.power_dbm, share)
        data = replace(
            data, power_dbm=np.maximum(data.power_dbm, floor), censored=data.power_dbm < floor
        )
    found = fit_channel(data, CHANNEL.station, method)
    for offset in found.receiver_offsets:
        error = offset.offset_db - OFFSETS_DB[offset.receiver]
        assert abs(error) < 3.0 * offset.standard_error_db
        assert offset.standard_error_db < 2.0
    free = fit_channel(without_offsets(cooperative(3, 240)), CHANNEL.station, method)
    assert free.receiver_offsets == ()
    if not share:
        for name in ("shadow_std_db", "multipath_std_db", "decorrelation_m"):
            assert getattr(found.parameters, name) == pytest.approx(
                getattr(free.parameters, name), rel=0.15
            )


def test_standard_errors_are_those_of_estimates():
    """Over 60 simulations the estimates scatter as their errors say."""
    scores = []
    for seed in range(60):
        found = receiver_offsets(condition(CHANNEL, cooperative(100 + seed, 60)))
        scores += [(o.offset_db - OFFSETS_DB[o.receiver]) / o.standard_error_db for o in found]
    assert abs(np.mean(scores)) < 0.3
    assert 0.8 < np.std(scores) < 1.2


def test_no_measurement_by_the_reference():
    """The level is then as uncertain as an offset, and the fit says so."""
    data = cooperative(4, 150)
    data = replace(data, receiver=data.receiver + 1)
    found = fit_channel(data, CHANNEL.station)
    assert any("receiver 0" in warning for warning in found.warnings)
    assert all(offset.standard_error_db > 8.0 for offset in found.receiver_offsets)
    first, second, third = (offset.offset_db for offset in found.receiver_offsets)
    assert second - first == pytest.approx(7.0, abs=2.0)
    assert third - first == pytest.approx(-4.0, abs=2.0)
    assert found.standard_errors["k_pl_db"] > 8.0
    line = fit_channel(data, CHANNEL.station, "capped")
    assert line.standard_errors["k_pl_db"] > 8.0


def test_a_receiver_that_thinning_would_miss():
    """Three measurements among a thousand still give an offset with an honest error."""
    data = cooperative(6, 1000)
    receiver = np.zeros(1000, dtype=np.intp)
    receiver[[10, 500, 900]] = 5
    data = replace(without_offsets(data), receiver=receiver)
    data = replace(data, power_dbm=data.power_dbm + 9.0 * (receiver == 5))
    (found,) = fit_channel(data, CHANNEL.station).receiver_offsets
    assert found.receiver == 5
    assert abs(found.offset_db - 9.0) < 3.0 * found.standard_error_db
    assert found.standard_error_db < 4.0
