"""What packets are worth to a filter: enumeration, sampling, one step, exact derivatives."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn

from planopt.channel.posterior import condition
from planopt.objectives.filter_derivatives import (
    covariance_gain_derivatives,
    information_gain_derivatives,
)
from planopt.objectives.tracking import Tracking, tracking_value
from planopt.objectives.tracking_filter import (
    FilteredTracking,
    covariance_gain,
    information_gain,
    sensing_of,
)
from planopt.targets.information_filter import TargetModel
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import Sensor

POSTERIOR = condition(CHANNEL, drawn(15))
SETTINGS = FilteredTracking(
    Tracking(-73.0, Sensor(0.008, 0.08, 1.0), PATH + 2.0, np.array([1.0, 0.5, 2.0, 1.0, 1.5])),
    TargetModel(0.5, np.array([[0.02, 0.01], [0.01, 0.05]])),
    np.linalg.inv(np.diag([1.0, 1.0, 0.1, 0.1]) + 0.02),
)
SENSING = sensing_of(PATH, SETTINGS)


def shortened(steps):
    """The settings of a path of its first steps."""
    tracking = SETTINGS.tracking
    few = replace(tracking, target_m=tracking.target_m[:steps], weight=tracking.weight[:steps])
    return replace(SETTINGS, tracking=few)


def filtered(losses, settings=SETTINGS):
    """sum_k w_k tr J_k and of tr P_k of the position, for losses, by dense formulas."""
    a, q = settings.model.transition, settings.model.process_covariance
    matrix, information, variance = settings.information, 0.0, 0.0
    for k, arrived in enumerate(losses):
        matrix = np.linalg.inv(a @ np.linalg.inv(matrix) @ a.T + q)
        matrix[:2, :2] += 0.5 * arrived * SENSING[k] * np.eye(2)
        information += settings.tracking.weight[k] * np.trace(matrix)
        variance += settings.tracking.weight[k] * np.trace(np.linalg.inv(matrix)[:2, :2])
    return np.array([information, variance])


def test_recursions_bound_the_enumerated_gain_of_independent_losses():
    """More information than expected, less covariance removed; both exact for sure packets."""
    arrival = np.array([0.9, 0.3, 0.6, 0.8, 0.5])
    expected = np.zeros(2)
    for losses in itertools.product((0.0, 1.0), repeat=5):
        chance = np.where(np.array(losses) > 0.0, arrival, 1.0 - arrival).prod()
        expected += chance * filtered(losses)
    nothing = filtered(np.zeros(5))
    assert information_gain(arrival, SENSING, SETTINGS) >= expected[0] - nothing[0]
    assert covariance_gain(arrival, SENSING, SETTINGS) <= nothing[1] - expected[1]
    for losses in ([1, 1, 1, 1, 1], [0, 1, 0, 0, 1], [0, 0, 0, 0, 0]):
        information, variance = filtered(losses) - nothing
        sure = np.array(losses, dtype=float)
        assert information_gain(sure, SENSING, SETTINGS) == pytest.approx(information, abs=1e-9)
        assert covariance_gain(sure, SENSING, SETTINGS) == pytest.approx(-variance, abs=1e-9)


def test_many_paths_at_once_are_each_alone():
    """A batch is its parts."""
    arrival = np.random.default_rng(0).uniform(size=(3, 5))
    sensing = SENSING * np.array([[1.0], [2.0], [0.5]])
    for gain in (information_gain, covariance_gain):
        together = gain(arrival, sensing, SETTINGS)
        alone = [gain(p, s, SETTINGS) for p, s in zip(arrival, sensing, strict=True)]
        np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_one_step_of_information_is_the_seeds():
    """Equation (4), exactly."""
    one = shortened(1)
    arrival = POSTERIOR.connectivity(PATH[:1], -73.0)
    value = tracking_value(POSTERIOR, PATH[:1], one.tracking)
    assert information_gain(arrival, SENSING[:1], one) == pytest.approx(value, rel=1e-10)


@pytest.mark.parametrize(
    "derivatives, gain",
    [
        (information_gain_derivatives, information_gain),
        (covariance_gain_derivatives, covariance_gain),
    ],
)
def test_derivatives_are_differences(derivatives, gain):
    """Of the value by places, with p a logistic and the sensing an exponential of them."""
    rng = np.random.default_rng(1)
    slope, rate = rng.normal(size=(2, 5, 2))
    pairs = [0, 0, 1], [0, 1, 1]

    def at(places):
        p = 1.0 / (1.0 + np.exp(-(slope * places).sum(axis=1)))
        once, twice = p * (1.0 - p), p * (1.0 - p) * (1.0 - 2.0 * p)
        squares = slope[:, pairs[0]] * slope[:, pairs[1]]
        chance = Derivatives(p, once[:, None] * slope, twice[:, None] * squares)
        s = 3.0 * np.exp((rate * places).sum(axis=1))
        squares = rate[:, pairs[0]] * rate[:, pairs[1]]
        return chance, Derivatives(s, s[:, None] * rate, s[:, None] * squares)

    places, step = 0.3 * rng.normal(size=(5, 2)), 1e-5
    found = derivatives(*at(places), SETTINGS)
    chance, sensing = at(places)
    assert found.value == pytest.approx(gain(chance.value, sensing.value, SETTINGS))
    gradient, hessian = np.empty(10), np.empty((10, 10))
    for i in range(10):
        moved = np.zeros(10)
        moved[i] = step
        more, less = (
            derivatives(*at(places + sign * moved.reshape(5, 2)), SETTINGS) for sign in (1, -1)
        )
        gradient[i] = (more.value - less.value) / (2 * step)
        hessian[i] = (more.gradient - less.gradient) / (2 * step)
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-7 * np.abs(gradient).max())
    np.testing.assert_allclose(found.hessian, hessian, atol=1e-7 * np.abs(hessian).max())
