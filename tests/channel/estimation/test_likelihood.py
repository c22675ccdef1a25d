"""The restricted likelihood against densities written out; blocks against one factor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal
from simulated_channel import simulated
from varied_measurements import DRIFTING, dense_covariance, varied

from planopt.channel import ChannelParameters, Station
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.likelihood import (
    RestrictedLikelihood,
    likelihood_data,
    profiled_log_likelihood,
)
from planopt.channel.measurements import measured_path_loss_variance_db2
from planopt.channel.neighbours import BLOCK, BLOCK_NEIGHBOURS
from planopt.channel.parameters import Lasting, mean_model

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
POINT = (30.0, 5.0, 25.0)
BOUNDS = (1.0, 300.0)


def data_of(measurements, known=CHANNEL, as_interval=None, n_pl=True, blocks=None):
    """Likelihood data with the full or the one-column mean."""
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, known.station, n_pl)
    return likelihood_data(model, measurements, known, as_interval, blocks)


def evaluate(data, point=POINT):
    """The likelihood at a point, with sites as exact as they become."""
    return RestrictedLikelihood(data).at(point, site_tolerance=1e-7)


def value(data, point=POINT):
    return evaluate(data, point).log_likelihood


def assert_gradient_is_the_slope(data, share=1e-3, atol=3e-6):
    gradient = evaluate(data).gradient
    for i in range(3):
        step = np.zeros(3)
        step[i] = share * POINT[i]
        up, down = (value(data, tuple(POINT + s * step)) for s in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * step[i]), rel=2e-4, abs=atol)


def rounded(measurements, step_db):
    """The measurements rounded to whole steps; the censored ones keep their limits."""
    power = np.round(measurements.power_dbm / step_db) * step_db
    power = np.where(measurements.censored, measurements.power_dbm, power)
    resolution = np.where(measurements.censored, 0.0, step_db)
    return replace(measurements, power_dbm=power, resolution_db=resolution)


def with_intervals(measurements, rows):
    """The data with rows, as well as the censored ones, as intervals."""
    chosen = measurements.censored.copy()
    chosen[rows] = True
    return data_of(measurements, as_interval=chosen)


def covariance_at(measurements, known, point):
    """V of exact measurements, offsets included, written out."""
    channel = replace(known, shadow_std_db=np.sqrt(point[0]), decorrelation_m=point[2])
    noise = measured_path_loss_variance_db2(measurements, known)
    noise += point[1] + measurements.resolution_db**2 / 12.0
    return dense_covariance(channel, measurements) + np.diag(noise)


@pytest.mark.parametrize(
    ("measurements", "known"),
    [
        (simulated(CHANNEL, 0, 40, 200.0), CHANNEL),
        (
            replace(
                simulated(CHANNEL, 0, 40, 200.0), resolution_db=np.repeat([0.0, 1.0, 3.0, 0.5], 10)
            ),
            CHANNEL,
        ),
        (varied(40, 21), DRIFTING),
    ],
    ids=["plain", "finely rounded", "ages, receivers and errors of position"],
)
def test_is_the_density_of_contrasts(measurements, known):
    """Up to log |G'G| / 2, which is constant; the mean is generalised least squares."""
    model = mean_model(measurements.positions_m, ~measurements.censored, known.station, True)
    total = covariance_at(measurements, known, POINT)
    basis = null_space(model.columns.T)
    contrasts = multivariate_normal(np.zeros(38), basis.T @ total @ basis).logpdf(
        basis.T @ measurements.power_dbm
    )
    constant = -0.5 * np.linalg.slogdet(model.columns.T @ model.columns)[1]
    at = evaluate(likelihood_data(model, measurements, known))
    assert at.log_likelihood == pytest.approx(contrasts + constant, rel=1e-9)
    weight = np.linalg.inv(total)
    covariance = np.linalg.inv(model.columns.T @ weight @ model.columns)
    np.testing.assert_allclose(at.coefficient_covariance, covariance, rtol=1e-6)
    expected = covariance @ model.columns.T @ weight @ measurements.power_dbm
    np.testing.assert_allclose(at.coefficients, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("measurements", "known", "n_pl"),
    [
        (simulated(CHANNEL, 2, 60, 200.0), CHANNEL, True),
        (simulated(CHANNEL, 2, 60, 200.0, 0.3), CHANNEL, False),
        (varied(50, 20, censored=0.2), DRIFTING, True),
    ],
)
def test_gradient_is_the_slope(measurements, known, n_pl):
    """With censoring, ages, receivers and errors of position, with and without a slope."""
    assert_gradient_is_the_slope(data_of(measurements, known, n_pl=n_pl), 1e-4, 1e-6)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("blocks", [None, BOUNDS])
def test_gradient_with_lasting_multipath_is_the_slope(share, blocks):
    """With two receivers, in one window and in several, also with intervals."""
    measurements = simulated(CHANNEL, 2, 120, 200.0, share)
    times, receiver = np.arange(120.0), np.arange(120) % 2
    dated = replace(measurements, time_s=times, receiver=receiver)
    known = replace(CHANNEL, lasting=Lasting(0.6, 8.0))
    atol = 0.02 if share and blocks else 3e-6
    assert_gradient_is_the_slope(data_of(dated, known, blocks=blocks), atol=atol)


@pytest.mark.parametrize("share", [0.0, 0.3])
@pytest.mark.parametrize("rows", [slice(0, 0), slice(0, 60, 3), slice(0, 60)])
@pytest.mark.parametrize("step", [1.0, 8.0])
def test_gradient_of_rounded_powers_is_the_slope(share, rows, step):
    """None, some or all are intervals, in addition to limits."""
    measurements = rounded(simulated(CHANNEL, 2, 60, 200.0, share), step)
    assert_gradient_is_the_slope(with_intervals(measurements, rows))


@pytest.mark.parametrize("step", [0.1, 2.0, 9.0])
def test_one_interval_has_its_exact_probability(step):
    """With a single interval the likelihood is the density integrated over it, by its length."""
    measurements = simulated(CHANNEL, 3, 30, 200.0)
    seventh = np.arange(30) == 7
    data = with_intervals(replace(measurements, resolution_db=np.where(seventh, step, 0.0)), [7])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    moved = 0.5 * step * nodes[:, None] * seventh
    powers = measurements.power_dbm + moved
    logs = np.array([value(data_of(replace(measurements, power_dbm=one))) for one in powers])
    mean = np.log(0.5 * weights @ np.exp(logs - logs.max())) + logs.max()
    assert value(data) == pytest.approx(mean, abs=1e-7)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_narrow_intervals_are_exact_measurements(share):
    """All as intervals, none Gaussian: for r -> 0 value, gradient and mean are the exact ones."""
    measurements = simulated(CHANNEL, 6, 40, 200.0, share)
    exact = evaluate(data_of(measurements))
    resolution = np.where(measurements.censored, 0.0, 1e-4)
    found = evaluate(with_intervals(replace(measurements, resolution_db=resolution), slice(0, 40)))
    assert found.log_likelihood == pytest.approx(exact.log_likelihood, abs=1e-5)
    np.testing.assert_allclose(found.gradient, exact.gradient, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.coefficients, exact.coefficients, rtol=1e-5)
    np.testing.assert_allclose(
        found.coefficient_covariance, exact.coefficient_covariance, rtol=1e-4
    )


def test_sheppard_and_intervals_agree_where_the_rule_switches():
    """At r = 2 omega they differ little, in value and slope."""
    told, point = rounded(simulated(CHANNEL, 7, 200, 200.0), 4.0), (36.0, 4.0, 30.0)
    fine, coarse = (
        evaluate(data, point) for data in (data_of(told), with_intervals(told, slice(0, 200)))
    )
    assert fine.log_likelihood == pytest.approx(coarse.log_likelihood, abs=0.1)
    likelihood = RestrictedLikelihood(data_of(told))
    spread = np.sqrt(np.diag(likelihood.information(point, fine)))
    assert np.abs((fine.gradient - coarse.gradient) / spread).max() < 0.1


def test_information_is_the_spread_of_the_score():
    """Over simulated data the covariance of the gradient is the expected information."""
    measurements = simulated(CHANNEL, 4, 30, 150.0)
    data = data_of(measurements)
    root = np.linalg.cholesky(covariance_at(measurements, CHANNEL, POINT))
    rng = np.random.default_rng(0)
    scores = np.array(
        [
            evaluate(replace(data, values_db=root @ rng.standard_normal(30))).gradient
            for _ in range(1500)
        ]
    )
    likelihood = RestrictedLikelihood(data)
    information = likelihood.information(POINT, likelihood.at(POINT))
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    np.testing.assert_allclose(np.cov(scores.T) / scale, information / scale, atol=0.12)
    assert np.abs(scores.mean(axis=0) / np.sqrt(np.diag(information))).max() < 0.1


def test_profiling_is_the_maximum_over_scale():
    """The profiled value differs from the best over scales by nothing but the stated constant."""
    data = data_of(simulated(CHANNEL, 5, 40, 200.0))
    for share, beta in ((0.3, 10.0), (0.9, 40.0)):
        found, total = profiled_log_likelihood(data, share, beta)
        scales = total * np.array([0.97, 1.0, 1.03])
        direct = [value(data, (share * s, (1 - share) * s, beta)) for s in scales]
        assert np.argmax(direct) == 1
        assert found == pytest.approx(direct[1], abs=1e-8)


def test_profiling_frees_the_offsets():
    """Starts see the same data whatever constant a receiver adds, also where one is missing."""
    measurements = varied(40, 22, errors=False)
    shift = 50.0 * (measurements.receiver == 2)
    values = [
        profiled_log_likelihood(data_of(given, DRIFTING), 0.7, 10.0)
        for given in (measurements, replace(measurements, power_dbm=measurements.power_dbm + shift))
    ]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-8)
    alone = replace(measurements, receiver=np.full(40, 3))
    assert data_of(alone, DRIFTING).flat_columns().shape == (40, 2)
    assert data_of(measurements.take(slice(6)), DRIFTING).flat_columns().shape == (6, 2)


def both(measurements, known=CHANNEL, n_pl=True):
    """The likelihood in blocks and as a whole, at one point."""
    return [
        RestrictedLikelihood(data_of(measurements, known, n_pl=n_pl, blocks=blocks)).at(POINT)
        for blocks in (BOUNDS, None)
    ]


@pytest.mark.parametrize(
    ("measurements", "known", "n_pl"),
    [
        (simulated(CHANNEL, 1, 3, 200.0), CHANNEL, False),
        (simulated(CHANNEL, 1, BLOCK, 200.0), CHANNEL, True),
        (simulated(CHANNEL, 1, BLOCK_NEIGHBOURS + 20, 200.0), CHANNEL, True),
        (replace(varied(140), resolution_db=np.full(140, 1.0)), DRIFTING, True),
    ],
)
@one_blas_thread()
def test_blocks_that_leave_none_out_are_exact(measurements, known, n_pl):
    """Value, gradient and mean of the factor, with drift, offsets and errors of position too."""
    found, expected = both(measurements, known, n_pl)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)
    np.testing.assert_allclose(found.gradient, expected.gradient, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-6)
    np.testing.assert_allclose(
        found.coefficient_covariance, expected.coefficient_covariance, rtol=1e-6
    )


@pytest.mark.parametrize(
    ("count", "side_m", "share", "off", "slope"),
    [
        (150, 250.0, 0.2, 0.2, 0.4),
        (150, 250.0, 0.7, 0.2, 0.4),
        (700, 500.0, 0.0, 1.0, 0.2),
        (700, 500.0, 0.4, 1.0, 0.2),
    ],
)
@one_blas_thread()
def test_blocks_are_close_to_the_factor(count, side_m, share, off, slope):
    """Of many, and with limits, whose sites leave out theta's own uncertainty."""
    found, expected = both(simulated(CHANNEL, 5, count, side_m, share).by_place())
    assert 0.0 < abs(found.log_likelihood - expected.log_likelihood) < off
    deviation = np.sqrt(np.diag(expected.information))
    np.testing.assert_array_less(np.abs(found.gradient - expected.gradient), slope * deviation)
    errors = np.sqrt(np.diag(expected.coefficient_covariance))
    np.testing.assert_array_less(np.abs(found.coefficients - expected.coefficients), 0.2 * errors)


@pytest.mark.parametrize("share", [0.0, 0.4])
@one_blas_thread()
def test_gradient_and_information_of_blocks(share):
    """In several windows: central differences of the value, and the information of one factor."""
    measurements = simulated(CHANNEL, 4, 500, 400.0, share)
    likelihood = RestrictedLikelihood(data_of(measurements, blocks=BOUNDS))
    at = likelihood.at(POINT)
    for axis in range(3):
        step = 0.01 * np.eye(3)[axis]
        above, below = (
            likelihood.at(tuple(POINT * np.exp(sign * step))).log_likelihood for sign in (1.0, -1.0)
        )
        slope = (above - below) / (0.02 * POINT[axis])
        assert at.gradient[axis] == pytest.approx(slope, rel=0.02, abs=0.05 / POINT[axis])
    whole = RestrictedLikelihood(data_of(measurements))
    errors, expected = (
        np.sqrt(np.diag(np.linalg.inv(each.information(POINT, each.at(POINT)))))
        for each in (likelihood, whole)
    )
    np.testing.assert_allclose(errors, expected, rtol=0.1)
