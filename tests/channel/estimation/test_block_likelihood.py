"""The likelihood of blocks against that of one factor."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_channel import simulated
from varied_measurements import DRIFTING, varied

from planopt.channel.estimation.block_likelihood import BlockLikelihood, block_data, exact_part
from planopt.channel.estimation.likelihood_data import likelihood_data
from planopt.channel.estimation.restricted_likelihood import evaluate
from planopt.channel.nearest.windows import BESIDE, BLOCK
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station, mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
POINT = (30.0, 5.0, 25.0)
BOUNDS = (1.0, 300.0)


def both(measurements, known=CHANNEL, as_interval=None, n_pl=True):
    """The likelihood of blocks, and the data of the dense one."""
    measurements = measurements.by_place()
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, known.station, n_pl)
    if as_interval is not None:
        as_interval = as_interval(measurements)
    return (
        BlockLikelihood(block_data(model, measurements, known, BOUNDS, as_interval)),
        likelihood_data(model, measurements, known, as_interval),
    )


def coarse(measurements):
    """Which are rounded, or censored."""
    return (measurements.resolution_db > 0.0) | measurements.censored


@pytest.mark.parametrize("n_pl", [True, False])
@pytest.mark.parametrize("count", [3, BLOCK, BESIDE + 20])
@one_blas_thread()
def test_where_nobody_is_left_out_it_is_exact(count, n_pl):
    """Of few more than stand beside a block: value, gradient and mean of the factor."""
    blocks, data = both(simulated(CHANNEL, 1, count, 200.0), n_pl=n_pl)
    found, expected = blocks.at(POINT), evaluate(data, POINT)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-10)
    np.testing.assert_allclose(found.gradient, expected.gradient, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-8)
    np.testing.assert_allclose(
        found.coefficient_covariance, expected.coefficient_covariance, rtol=1e-7
    )


@one_blas_thread()
def test_receivers_ages_positions_and_steps():
    """Offsets as coefficients, drift, errors of position and fine rounding: the same density."""
    measurements = replace(varied(140), resolution_db=np.full(140, 1.0))
    blocks, data = both(measurements, DRIFTING)
    found, expected = blocks.at(POINT), evaluate(data, POINT)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)
    np.testing.assert_allclose(found.gradient, expected.gradient, rtol=1e-6)
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-6)
    assert len(found.coefficients) == 2


@pytest.mark.parametrize("share", [0.2, 0.7])
@one_blas_thread()
def test_limits_are_those_of_joint_sites(share):
    """With censored ones it is expectation propagation's value, but for theta's own uncertainty."""
    blocks, data = both(simulated(CHANNEL, 2, 150, 250.0, share))
    found, expected = blocks.at(POINT), evaluate(data, POINT)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, abs=0.2)
    scale = np.array(POINT)
    np.testing.assert_allclose(found.gradient * scale, expected.gradient * scale, atol=0.4)
    errors = np.sqrt(np.diag(expected.coefficient_covariance))
    np.testing.assert_array_less(np.abs(found.coefficients - expected.coefficients), 0.1 * errors)


@one_blas_thread()
def test_coarse_steps_are_intervals():
    """Powers in steps of 8 dB, some censored: near the dense value, up to the same constant."""
    exact = simulated(CHANNEL, 3, 150, 250.0, 0.2)
    told = replace(
        exact,
        power_dbm=np.where(exact.censored, exact.power_dbm, 8.0 * np.round(exact.power_dbm / 8.0)),
        resolution_db=np.where(exact.censored, 0.0, 8.0),
    )
    blocks, data = both(told, as_interval=coarse)
    found, expected = blocks.at(POINT), evaluate(data, POINT)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, abs=0.5)


@pytest.mark.parametrize("share", [0.0, 0.4])
@one_blas_thread()
def test_gradient_is_the_slope(share):
    """Of many, in several windows: central differences of the value."""
    blocks, _ = both(simulated(CHANNEL, 4, 500, 400.0, share))
    gradient = blocks.at(POINT).gradient
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 0.01
        above, below = (
            blocks.at(tuple(POINT * np.exp(way * step))).log_likelihood for way in (1.0, -1.0)
        )
        slope = (above - below) / (0.02 * POINT[axis])
        assert gradient[axis] == pytest.approx(slope, rel=0.02, abs=0.05 / POINT[axis])


@pytest.mark.parametrize("share", [0.0, 0.4])
@one_blas_thread()
def test_close_to_the_factor_of_many(share):
    """Of 700 the value is within one unit, and the slopes within a tenth of their deviation."""
    blocks, data = both(simulated(CHANNEL, 5, 700, 500.0, share))
    found, expected = blocks.at(POINT), evaluate(data, POINT)
    assert 0.0 < abs(found.log_likelihood - expected.log_likelihood) < 1.0
    deviation = np.sqrt(np.diag(expected.information))
    np.testing.assert_array_less(np.abs(found.gradient - expected.gradient), 0.2 * deviation)


@one_blas_thread()
def test_information_is_the_curvature():
    """The observed information, by differences of values."""
    blocks, _ = both(simulated(CHANNEL, 6, 500, 400.0))
    information = blocks.information(POINT, blocks.at(POINT))
    np.testing.assert_array_equal(information, information.T)

    def value(logs):
        return blocks.at(tuple(np.exp(logs))).log_likelihood

    logs, scale = np.log(POINT), np.array(POINT)
    gradient = blocks.at(POINT).gradient * scale
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 0.1
        bend = (2.0 * value(logs) - value(logs + step) - value(logs - step)) / 0.01
        assert information[axis, axis] * scale[axis] ** 2 == pytest.approx(bend, rel=0.1)
    assert np.isfinite(gradient).all()


@one_blas_thread()
def test_a_sample_of_blocks_is_a_likelihood_of_its_own():
    """The exact ones of the first blocks, beside them none of others."""
    measurements = simulated(CHANNEL, 7, 600, 400.0, 0.3).by_place()
    model = mean_model(measurements.positions_m, ~measurements.censored, CHANNEL.station, True)
    data = block_data(model, measurements, CHANNEL, BOUNDS)
    sample = exact_part(data, 3)
    taken = np.sort(np.concatenate([window.own for window in data.windows[:3]]))
    taken = taken[~measurements.censored[taken]]
    np.testing.assert_array_equal(sample.values_db, measurements.power_dbm[taken])
    part = measurements.take(taken)
    model = mean_model(part.positions_m, ~part.censored, CHANNEL.station, True)
    expected = evaluate(likelihood_data(model, part, CHANNEL), POINT)
    assert BlockLikelihood(sample).at(POINT).log_likelihood == pytest.approx(
        expected.log_likelihood, rel=1e-9
    )
