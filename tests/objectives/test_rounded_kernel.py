"""The rounded kernel and path loss: differences, what rounding costs, limits."""

import numpy as np
import pytest
from path_scene import CHANNEL

from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.objectives.stage_power import CUSP_ROUNDING, rounded_kernel, rounded_log_distance

OFFSETS = np.array([[0.0, 0.0], [0.05, -0.02], [0.12, 0.0], [3.0, 4.0], [-20.0, 9.0]])


def check(function, places, h, tolerance):
    """Gradient and Hessian are those of central differences."""
    found = function(places)
    for axis, columns in ((0, [0, 1]), (1, [1, 2])):
        step = h * np.eye(2)[axis]
        more, less = function(places + step), function(places - step)
        np.testing.assert_allclose(
            found.gradient[:, axis], (more.value - less.value) / (2 * h), atol=tolerance
        )
        np.testing.assert_allclose(
            found.hessian[:, columns], (more.gradient - less.gradient) / (2 * h), atol=tolerance
        )


@pytest.mark.parametrize("blur", [0.0, np.array([0.0, 0.1, 0.0, 2.0, 0.5])])
def test_kernel_derivatives(blur):
    """At the cusp, near it and far from it, with and without position errors."""
    check(lambda offset: rounded_kernel(offset, CHANNEL, blur), OFFSETS, 1e-5, 1e-5)


def test_path_loss_derivatives():
    """Also straight under the station."""
    places = OFFSETS + np.array(CHANNEL.station.position_m)
    check(lambda at: rounded_log_distance(at, CHANNEL.station), places, 1e-4, 1e-7)


def test_rounding_costs_what_is_said():
    """At most the share eps / beta at the cusp; at ten roundings a twentieth of it."""
    away = CUSP_ROUNDING * CHANNEL.decorrelation_m * np.array([0.0, 10.0, 100.0])
    places = np.column_stack([away, np.zeros(3)])
    exact = shadow_covariance_db2(places, np.zeros((1, 2)), CHANNEL)[:, 0]
    less = 1.0 - rounded_kernel(places, CHANNEL).value / exact
    assert (less > 0.0).all() and less[0] <= CUSP_ROUNDING
    assert less[0] == pytest.approx(CUSP_ROUNDING, rel=0.01)
    assert less[1] <= CUSP_ROUNDING / 20.0


def test_without_rounding_both_are_exact(monkeypatch):
    """The limits are the channel's own formulas."""
    monkeypatch.setattr("planopt.objectives.stage_power.CUSP_ROUNDING", 0.0)
    monkeypatch.setattr("planopt.objectives.stage_power.MIN_DISTANCE_M", 0.0)
    far, blur = OFFSETS[1:], np.array([0.0, 0.3, 0.0, 1.0])
    np.testing.assert_allclose(
        rounded_kernel(far, CHANNEL, blur).value,
        shadow_covariance_db2(far, np.zeros((1, 2)), CHANNEL, blur[:, None])[:, 0],
        rtol=1e-14,
    )
    np.testing.assert_allclose(
        rounded_log_distance(far, CHANNEL.station).value, regressors(far, CHANNEL.station)[:, 1]
    )
