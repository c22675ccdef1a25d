"""Derivatives of the posterior, and its error with wrong parameters."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    mean_squared_error_db2,
    posterior_derivatives,
    sensitivity_curves,
)
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import MIN_DISTANCE_M, regressors
from planopt.channel.sensitivity import perturbed

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))
AROUND = np.random.default_rng(4).uniform(-60.0, 60.0, (30, 2))


def measured(count=20, censored=0):
    """Random measurements, the last ones censored."""
    rng = np.random.default_rng(0)
    return Measurements(
        rng.uniform(-60.0, 60.0, (count, 2)),
        rng.normal(-90.0, 8.0, count),
        np.arange(count) >= count - censored,
    )


def differences(function, places, step):
    """Central differences of a function of places (n, 2), along a new last axis."""
    return np.stack(
        [
            (function(places + step * way) - function(places - step * way)) / (2.0 * step)
            for way in np.eye(2)
        ],
        axis=-1,
    )


@pytest.mark.parametrize("theta", ["estimated", "known"])
@pytest.mark.parametrize("censored", [0, 5])
def test_central_differences(theta, censored):
    """Gradients of the prediction, Hessians of the gradients."""
    posterior = condition(PARAMETERS, measured(censored=censored), theta=theta)
    found = posterior_derivatives(posterior, AROUND)
    prediction = posterior.predict(AROUND)
    np.testing.assert_allclose(found.mean_db, prediction.mean_db, rtol=1e-12)
    np.testing.assert_allclose(found.deviation_db, prediction.deviation_db, rtol=1e-12)
    for name in ("mean", "deviation"):
        gradient = differences(
            lambda at, name=name: getattr(posterior.predict(at), f"{name}_db"), AROUND, 1e-4
        )
        hessian = differences(
            lambda at, name=name: getattr(posterior_derivatives(posterior, at), f"{name}_gradient"),
            AROUND,
            1e-4,
        )
        np.testing.assert_allclose(getattr(found, f"{name}_gradient"), gradient, atol=1e-7)
        np.testing.assert_allclose(getattr(found, f"{name}_hessian"), hessian, atol=1e-6)


def test_casadi():
    """Universal kriging written as the extended linear system, differentiated by CasADi."""
    data = measured()
    p = PARAMETERS
    place = ca.MX.sym("q", 2)

    def loss(at):
        dx, dy = at[0] - p.station.position_m[0], at[1] - p.station.position_m[1]
        return -5.0 * ca.log10(dx**2 + dy**2 + p.station.height_m**2)

    def kernel(a, b):
        return p.shadow_std_db**2 * ca.exp(
            -ca.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) / p.decorrelation_m
        )

    # [U G; G' 0] [w; m] = [phi; gamma]: mean w'y, variance xi^2 + omega^2 - w'phi - m'gamma.
    count = len(data)
    system = np.zeros((count + 2, count + 2))
    for i, a in enumerate(data.positions_m):
        for j, b in enumerate(data.positions_m):
            system[i, j] = float(kernel(a, b)) + (i == j) * p.multipath_std_db**2
        system[i, count:] = system[count:, i] = [1.0, float(loss(a))]
    right = ca.vertcat(*[kernel(place, b) for b in data.positions_m], 1.0, loss(place))
    solution = ca.mtimes(np.linalg.inv(system), right)
    mean = ca.dot(solution[:count], data.power_dbm)
    deviation = ca.sqrt(p.shadow_std_db**2 + p.multipath_std_db**2 - ca.dot(solution, right))
    found = posterior_derivatives(condition(p, data), AROUND)
    for name, expression in (("mean", mean), ("deviation", deviation)):
        hessian, gradient = ca.hessian(expression, place)
        oracle = ca.Function("f", [place], [expression, gradient, hessian])
        for k, at in enumerate(AROUND):
            value, slope, bend = (np.array(part) for part in oracle(at))
            np.testing.assert_allclose(getattr(found, f"{name}_db")[k], value[0, 0], rtol=1e-9)
            np.testing.assert_allclose(
                getattr(found, f"{name}_gradient")[k], slope[:, 0], rtol=1e-7, atol=1e-9
            )
            np.testing.assert_allclose(
                getattr(found, f"{name}_hessian")[k], bend, rtol=1e-7, atol=1e-9
            )


def test_measured_place_is_an_error(monkeypatch):
    """At the cusp there is no derivative; the error counts over all blocks."""
    data = measured()
    monkeypatch.setattr("planopt.channel.sensitivity.ELEMENTS", 20 * 4)
    places = np.concatenate([AROUND[:9], data.positions_m[3:4], AROUND[9:]])
    with pytest.raises(InputError, match="position 9 is where measurement 3 was taken"):
        posterior_derivatives(condition(PARAMETERS, data), places)


def test_station():
    """Path loss is flat within its least distance and steep outside; shadowing goes on."""
    low = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 0.0))
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    posterior = condition(low, nothing, theta="known")
    outside = 2.0 * MIN_DISTANCE_M
    found = posterior_derivatives(
        posterior,
        np.array([[5.0, -10.0], [5.0 + 0.5 * MIN_DISTANCE_M, -10.0], [5.0 + outside, -10.0]]),
    )
    np.testing.assert_array_equal(found.mean_gradient[:2], 0.0)
    np.testing.assert_array_equal(found.mean_hessian[:2], 0.0)
    slope = -30.0 / np.log(10.0) / outside
    np.testing.assert_allclose(found.mean_gradient[2], [slope, 0.0], rtol=1e-9)
    np.testing.assert_allclose(
        found.mean_hessian[2], np.diag([-slope / outside, slope / outside]), rtol=1e-9
    )
    np.testing.assert_array_equal(found.deviation_gradient, 0.0)


def test_no_derivative_at_bad_places():
    """Positions that cannot be used."""
    with pytest.raises(InputError):
        posterior_derivatives(condition(PARAMETERS, measured()), np.array([[np.nan, 0.0]]))


TRUE = ChannelParameters(-10.0, 2.0, 4.0, 8.0, 1.5, Station((12.0, 9.0), 2.0))
WRONG = ChannelParameters(-13.0, 2.4, 5.5, 4.0, 2.5, TRUE.station)
MEASURED = np.random.default_rng(1).uniform(0.0, 30.0, (25, 2))
PLACES = np.random.default_rng(2).uniform(0.0, 30.0, (40, 2))


def path_loss(parameters, places):
    """Mean power."""
    return regressors(places, parameters.station) @ [parameters.k_pl_db, parameters.n_pl]


def predicted(assumed, power):
    """The posterior with known theta at the places (equation 1.6)."""
    data = Measurements(MEASURED, power, np.zeros(len(power), dtype=bool))
    return condition(assumed, data, theta="known").predict(PLACES)


@pytest.mark.parametrize(
    "assumed",
    [WRONG, replace(WRONG, station=Station((15.0, 5.0), 0.0)), replace(TRUE, n_pl=2.2)],
    ids=["all", "station", "n_pl"],
)
def test_simulation(assumed):
    """The squared error of the posterior's mean over fields of the true channel, to 5 sigma."""
    everywhere = np.concatenate([MEASURED, PLACES])
    covariance = shadow_covariance_db2(everywhere, everywhere, TRUE)
    covariance += TRUE.multipath_std_db**2 * np.eye(len(everywhere))
    draws = 4000
    power = path_loss(TRUE, everywhere)[:, None] + np.linalg.cholesky(
        covariance
    ) @ np.random.default_rng(3).standard_normal((len(everywhere), draws))
    # The posterior mean is affine in the data: its weights from unit measurements.
    constant = predicted(assumed, np.zeros(25)).mean_db
    weights = np.stack([predicted(assumed, row).mean_db - constant for row in np.eye(25)], axis=1)
    squares = (constant[:, None] + weights @ power[:25] - power[25:]) ** 2
    delta = mean_squared_error_db2(TRUE, assumed, MEASURED, PLACES)
    error = squares.std(axis=1) / np.sqrt(draws)
    assert (np.abs(squares.mean(axis=1) - delta) < 5.0 * error).all()


def test_no_error_is_the_posterior_variance():
    """With right parameters Delta^2 is the posterior variance."""
    deviation = predicted(TRUE, np.zeros(25)).deviation_db
    delta = mean_squared_error_db2(TRUE, TRUE, MEASURED, PLACES)
    np.testing.assert_allclose(delta, deviation**2, rtol=1e-10)


def test_curves_perturb_what_they_say():
    """Each curve's factor on the parameter it is named after."""
    for name, attribute, factor in [
        ("k_pl_db", "k_pl_db", 1.5),
        ("n_pl", "n_pl", 1.5),
        ("shadow_variance_db2", "shadow_std_db", np.sqrt(1.5)),
        ("decorrelation_m", "decorrelation_m", 1.5),
        ("multipath_std_db", "multipath_std_db", 1.5),
    ]:
        expected = replace(TRUE, **{attribute: getattr(TRUE, attribute) * factor})
        assert perturbed(TRUE, name, 0.5) == expected
        curve = sensitivity_curves(TRUE, MEASURED, PLACES, [0.5])[name]
        direct = mean_squared_error_db2(TRUE, expected, MEASURED, PLACES).mean()
        assert curve == pytest.approx([direct])


@pytest.mark.parametrize(("name", "error"), [("beta", 0.1), ("n_pl", -1.0), ("n_pl", np.nan)])
def test_bad_perturbation(name, error):
    """An unknown name, or an error that leaves nothing."""
    with pytest.raises(InputError):
        perturbed(TRUE, name, error)


def test_too_many_measurements_are_refused():
    """Before memory is asked for: 60,000 would take 29 GB a matrix."""
    with pytest.raises(InputError, match="60,000 are more than"):
        mean_squared_error_db2(TRUE, TRUE, np.zeros((60_000, 2)), PLACES)
