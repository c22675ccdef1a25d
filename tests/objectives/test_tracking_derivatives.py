"""The tracking reward's chain rule against differences, with the exact posterior's derivatives."""

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn

from planopt.channel.derivatives import posterior_derivatives
from planopt.channel.posterior import condition
from planopt.objectives.tracking import (
    Tracking,
    connectivity_derivatives,
    tracking_reward,
    tracking_reward_derivatives,
)
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import Sensor, sensing_derivatives

POSTERIOR = condition(CHANNEL, drawn(15))
SENSOR = Sensor(0.03, 0.08, 1.0)
TARGET = PATH + np.array([1.0, -2.0])
WEIGHT = np.array([1.0, 0.5, 2.0, 1.0, 0.7])
TASK = Tracking(-73.0, SENSOR, TARGET, WEIGHT)


def derivatives(path, threshold=-73.0):
    """Rewards of all stages at `path`."""
    found = posterior_derivatives(POSTERIOR, path)
    pairs = [0, 0, 1], [0, 1, 1]
    mean = Derivatives(
        found.mean_db, found.mean_gradient, found.mean_hessian[:, pairs[0], pairs[1]]
    )
    deviation = Derivatives(
        found.deviation_db,
        found.deviation_gradient,
        found.deviation_hessian[:, pairs[0], pairs[1]],
    )
    connectivity = connectivity_derivatives(mean, deviation, threshold)
    return tracking_reward_derivatives(
        connectivity, sensing_derivatives(SENSOR, path, TARGET), WEIGHT
    )


def test_value_is_the_stage_reward():
    """The same number as the objective's, from the exact posterior."""
    chance = POSTERIOR.connectivity(PATH, -73.0)
    expected = [tracking_reward(chance, PATH, k, TASK)[k] for k in range(5)]
    np.testing.assert_allclose(derivatives(PATH).value, expected, rtol=1e-12)


@pytest.mark.parametrize("threshold", [-73.0, -85.0, -60.0])
def test_derivatives_are_those_of_central_differences(threshold):
    """To 1e-6 of the largest, from likely to unlikely connection."""
    h = 1e-4
    found = derivatives(PATH, threshold)
    for axis, columns in ((0, [0, 1]), (1, [1, 2])):
        step = h * np.eye(2)[axis]
        more, less = derivatives(PATH + step, threshold), derivatives(PATH - step, threshold)
        first = (more.value - less.value) / (2 * h)
        second = (more.gradient - less.gradient) / (2 * h)
        scale = np.abs(found.gradient).max(), np.abs(found.hessian).max()
        np.testing.assert_allclose(found.gradient[:, axis], first, atol=1e-6 * scale[0])
        np.testing.assert_allclose(found.hessian[:, columns], second, atol=1e-6 * scale[1])


def test_certain_connection_leaves_the_sensor():
    """Far above the threshold the derivatives are those of 1 / g."""
    found = derivatives(PATH, -400.0)
    sensing = sensing_derivatives(SENSOR, PATH, TARGET)
    np.testing.assert_allclose(found.value, WEIGHT * sensing.value)
    np.testing.assert_allclose(found.gradient, WEIGHT[:, None] * sensing.gradient)
    np.testing.assert_allclose(found.hessian, WEIGHT[:, None] * sensing.hessian)
