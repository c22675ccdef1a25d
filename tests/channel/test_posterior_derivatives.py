"""Derivatives of the posterior against differences, CasADi, and what must hold at its kinks."""

import casadi as ca
import numpy as np
import pytest

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    posterior_derivatives,
)
from planopt.channel.parameters import MIN_DISTANCE_M

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))
PLACES = np.random.default_rng(4).uniform(-60.0, 60.0, (30, 2))


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
    found = posterior_derivatives(posterior, PLACES)
    prediction = posterior.predict(PLACES)
    np.testing.assert_allclose(found.mean_db, prediction.mean_db, rtol=1e-12)
    np.testing.assert_allclose(found.deviation_db, prediction.deviation_db, rtol=1e-12)
    for name in ("mean", "deviation"):
        gradient = differences(
            lambda at, name=name: getattr(posterior.predict(at), f"{name}_db"), PLACES, 1e-4
        )
        hessian = differences(
            lambda at, name=name: getattr(posterior_derivatives(posterior, at), f"{name}_gradient"),
            PLACES,
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
    found = posterior_derivatives(condition(p, data), PLACES)
    for name, expression in (("mean", mean), ("deviation", deviation)):
        hessian, gradient = ca.hessian(expression, place)
        oracle = ca.Function("f", [place], [expression, gradient, hessian])
        for k, at in enumerate(PLACES):
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
    places = np.concatenate([PLACES[:9], data.positions_m[3:4], PLACES[9:]])
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


def test_bad_places():
    """Positions that cannot be used."""
    with pytest.raises(InputError):
        posterior_derivatives(condition(PARAMETERS, measured()), np.array([[np.nan, 0.0]]))
