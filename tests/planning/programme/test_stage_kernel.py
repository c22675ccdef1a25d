"""The chance constraint's value and derivatives against CasADi, differences and the posterior."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planopt import Measurements
from planopt.arrays import Derivatives
from planopt.channel import ChannelParameters, Station, condition
from planopt.channel.kriging import LocalChannel, bound_margin_db, bound_quantile, predict
from planopt.objectives.stage_power import CUSP_ROUNDING, StagePredictor
from planopt.planning.programme.goal_value import margins_of

PARAMETERS = ChannelParameters(-35.0, 2.8, 5.0, 12.0, 2.0, Station((3.0, -4.0), 6.0))
THRESHOLD, P_MIN = -85.0, 0.9
Z = bound_quantile(P_MIN)


def posterior_of(count, theta="estimated", censored_share=0.0, parameters=PARAMETERS, seed=0):
    """Random data on a 60 m square; the weakest are only known to be below a floor."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.0, 60.0, (count, 2))
    power = -80.0 + 5.0 * np.sin(positions[:, 0] / 9.0) + generator.standard_normal(count)
    floor = np.quantile(power, censored_share) if censored_share else -np.inf
    measurements = Measurements(positions, np.maximum(power, floor), power < floor)
    return condition(parameters, measurements, theta=theta)


POSTERIORS = {
    "theta estimated": posterior_of(40),
    "theta known": posterior_of(40, theta="known"),
    "censored sites": posterior_of(40, censored_share=0.4),
    "few": posterior_of(3),
    "none": posterior_of(0),
    "fewer than asked for": posterior_of(6, theta="known"),
    "no multipath": posterior_of(40, parameters=replace(PARAMETERS, multipath_std_db=0.0)),
    "station on the ground": posterior_of(
        40, parameters=replace(PARAMETERS, station=Station((30.0, 30.0)))
    ),
}
CENTRES = np.array([[12.0, 20.0], [31.0, 29.0], [50.0, 8.0], [22.0, 55.0]])
PLACES = CENTRES + np.array([[0.7, -0.4], [-0.9, 0.2], [0.0, 1.1], [0.3, 0.3]])


def model_of(name, count=12):
    return LocalChannel.around_each(POSTERIORS[name], CENTRES, count)


def unrounded_margin(model, places):
    """The margin with next to no rounding, which a test below compares to exact kriging."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("planopt.objectives.stage_power.CUSP_ROUNDING", 1e-9)
        patch.setattr("planopt.objectives.stage_power.MIN_DISTANCE_M", 0.0)
        return stage_margins(model, places, THRESHOLD, Z).value


def casadi_margin(posterior, used):
    """The margin as universal kriging from the measurements `used`, for CasADi to differentiate.

    Written from the covariance matrix itself: nothing of the neighbour model is used.
    """
    parameters, station = posterior.parameters, posterior.parameters.station
    variance, beta = parameters.shadow_std_db**2, parameters.decorrelation_m
    at = posterior.measurements.positions_m[used]
    between = np.sqrt(((at[:, None] - at[None]) ** 2).sum(-1))
    u = variance * np.exp(-between / beta) + np.diag(posterior.noise_variance_db2[used])
    distance = np.sqrt(((at - station.position_m) ** 2).sum(1) + station.height_m**2)
    gamma_m = np.column_stack([np.ones(len(at)), -10.0 * np.log10(np.maximum(distance, 0.1))])

    q = ca.SX.sym("q", 2)
    d = ca.sqrt(ca.sumsqr(q - ca.DM(station.position_m)) + station.height_m**2 + 0.1**2)
    gamma = ca.vertcat(1.0, -10.0 * ca.log10(d))
    mean = ca.dot(gamma, posterior.theta)
    b, explained = gamma, 0.0
    if len(at):
        r = [ca.sqrt(ca.sumsqr(q - ca.DM(p)) + (CUSP_ROUNDING * beta) ** 2) for p in at]
        phi = variance * ca.exp(-ca.vertcat(*r) / beta)
        mean += ca.dot(
            np.linalg.solve(u, posterior.values_db[used] - gamma_m @ posterior.theta), phi
        )
        b = gamma - ca.DM(np.linalg.solve(u, gamma_m)).T @ phi
        explained = phi.T @ ca.DM(np.linalg.inv(u)) @ phi
    total = variance + parameters.multipath_std_db**2 - explained
    total += b.T @ ca.DM(posterior.theta_covariance) @ b
    margin = mean - Z * ca.sqrt(total) - THRESHOLD
    hessian, gradient = ca.hessian(margin, q)
    return ca.Function("margin", [q], [margin, gradient, hessian])


def stage_margins(
    model: LocalChannel, positions_m: np.ndarray, threshold_dbm: float, z: float | np.ndarray
) -> Derivatives:
    """Margin of each stage k at ``positions_m[k]``, from the model's k-th neighbour set."""
    return margins_of(*StagePredictor(model)(positions_m), threshold_dbm, z)


@pytest.mark.parametrize("name", POSTERIORS)
def test_value_and_derivatives_are_those_of_automatic_differentiation(name):
    """The same universal kriging, written anew and differentiated by CasADi."""
    posterior = POSTERIORS[name]
    found = stage_margins(model_of(name), PLACES, THRESHOLD, Z)
    for k, place in enumerate(PLACES):
        away = np.linalg.norm(posterior.measurements.positions_m - CENTRES[k], axis=1)
        value, gradient, hessian = casadi_margin(posterior, np.argsort(away)[:12])(place)
        hessian = np.asarray(hessian)
        assert found.value[k] == pytest.approx(float(value), abs=1e-8)
        np.testing.assert_allclose(found.gradient[k], np.asarray(gradient).ravel(), atol=1e-8)
        np.testing.assert_allclose(
            found.hessian[k], [hessian[0, 0], hessian[0, 1], hessian[1, 1]], atol=1e-8
        )


def test_derivatives_at_a_measured_place():
    """The cusp is rounded: on a measurement all is finite and the gradient has no jump."""
    posterior = POSTERIORS["theta estimated"]
    centres = posterior.measurements.positions_m[:5]
    model = LocalChannel.around_each(posterior, centres, 12)
    here = stage_margins(model, centres, THRESHOLD, Z)
    assert all(np.isfinite(part).all() for part in (here.value, here.gradient, here.hessian))
    h = 1e-5
    east = stage_margins(model, centres + np.array([h, 0.0]), THRESHOLD, Z)
    west = stage_margins(model, centres - np.array([h, 0.0]), THRESHOLD, Z)
    np.testing.assert_allclose(
        here.gradient[:, 0], (east.value - west.value) / (2.0 * h), atol=1e-5
    )
    # What the rounding costs: the mean there follows the measurement a little less.
    assert np.abs(here.value - unrounded_margin(model, centres)).max() < 0.2


@pytest.mark.parametrize("name", POSTERIORS)
def test_far_from_measurements_the_value_is_the_local_prediction(name):
    """Eight roundings from every measurement, and off the station, it is so to 0.05 dB."""
    rounding = CUSP_ROUNDING * PARAMETERS.decorrelation_m
    away = np.linalg.norm(model_of(name).positions_m - PLACES[:, None], axis=2)
    away = away.min(axis=1, initial=np.inf)
    far = away > 8.0 * rounding
    assert far.sum() >= 2
    places = PLACES[far]
    model = LocalChannel.around_each(POSTERIORS[name], CENTRES[far], 12)
    found = stage_margins(model, places, THRESHOLD, Z).value
    np.testing.assert_allclose(found, unrounded_margin(model, places), atol=0.05)


def test_without_rounding_it_is_the_local_prediction(monkeypatch):
    """With both roundings gone the value is the exact universal kriging of all measurements."""
    monkeypatch.setattr("planopt.objectives.stage_power.CUSP_ROUNDING", 0.0)
    monkeypatch.setattr("planopt.objectives.stage_power.MIN_DISTANCE_M", 0.0)
    for name, posterior in POSTERIORS.items():
        model = LocalChannel.around_each(posterior, CENTRES, 40)
        power = predict(posterior, PLACES)
        margin = bound_margin_db(power.mean_db, power.deviation_db, THRESHOLD, P_MIN)
        found = stage_margins(model, PLACES, THRESHOLD, Z).value
        np.testing.assert_allclose(found, margin, atol=1e-8, err_msg=name)
