"""Tracking: equation 4.11 by hand, additivity, invariances."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn, moved
from scipy.stats import norm

from planopt.channel.kriging import predict
from planopt.channel.parameters import Station
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.tracking import (
    Tracking,
    tracking_reward,
    tracking_value,
)
from planopt.targets.sensor import Sensor, sensing_information

POSTERIOR = condition(CHANNEL, drawn(15))
SENSOR = Sensor(0.008, 0.08, 1.0)
TARGET = PATH + np.array([3.0, -4.0])
TASK = Tracking(-73.0, SENSOR, TARGET, np.array([1.0, 0.5, 2.0, 0.0, 1.0]))


def test_one_step_is_the_seeds_equation_4():
    """Q((TH - mean) / deviation) / g(r), with SciPy's normal tail and g written out."""
    task = Tracking(-73.0, SENSOR, TARGET[:1])
    power = predict(POSTERIOR, PATH[:1])
    tail = norm.sf((-73.0 - power.mean_db[0]) / power.deviation_db[0])
    expected = tail / (0.008 * (5.0 - 1.0) ** 2 + 0.08)
    assert tracking_value(POSTERIOR, PATH[:1], task) == pytest.approx(expected, rel=1e-12)
    assert 0.01 < tail < 0.99


def test_value_is_the_weighted_sum_of_stage_rewards():
    """Stage by stage, many places at once."""
    chance = POSTERIOR.connectivity(PATH, -73.0)
    rewards = np.array([tracking_reward(chance, PATH, k, TASK) for k in range(5)])
    assert rewards.shape == (5, 5)
    assert tracking_value(POSTERIOR, PATH, TASK) == pytest.approx(np.trace(rewards))
    plain = Tracking(-73.0, SENSOR, TARGET)
    each = [tracking_reward(chance, PATH, k, plain) for k in range(5)]
    np.testing.assert_allclose(rewards, TASK.weight[:, None] * np.array(each))


def test_reward_takes_a_connectivity_from_anywhere():
    """From a map: certain connection gives the sensing alone."""
    found = tracking_reward(np.ones(5), PATH, 2, TASK)
    np.testing.assert_allclose(found, 2.0 * sensing_information(SENSOR, PATH, TARGET[2]))


def test_a_lower_threshold_is_never_worth_less():
    """From no connection at all to certain connection."""
    values = [
        tracking_value(POSTERIOR, PATH, dataclasses.replace(TASK, threshold_dbm=level))
        for level in (300.0, -70.0, -80.0, -90.0, -300.0)
    ]
    assert (np.diff(values) > 0.0).all() and values[0] == 0.0
    sensing = sensing_information(SENSOR, PATH, TARGET)
    assert values[-1] == pytest.approx(TASK.weight @ sensing)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_moving_the_scene_and_another_unit_change_nothing(mirror, scale):
    """Turned, mirrored, shifted; in another unit information is per its square."""
    turn, shift = np.array([[0.6, -0.8 * mirror], [0.8, 0.6 * mirror]]), 7.0
    x, y = scale * turn @ np.array(CHANNEL.station.position_m) + shift
    other = dataclasses.replace(
        CHANNEL,
        decorrelation_m=scale * CHANNEL.decorrelation_m,
        station=Station((x, y), scale * CHANNEL.station.height_m),
    )
    posterior = condition(other, moved(drawn(15), turn, shift, scale))
    path, target = (scale * places @ turn.T + shift for places in (PATH, TARGET))
    sensor = Sensor(0.008, scale**2 * 0.08, scale * 1.0)
    task = Tracking(-73.0, sensor, target, TASK.weight)
    expected = tracking_value(POSTERIOR, PATH, TASK) / scale**2
    assert tracking_value(posterior, path, task) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Tracking(np.nan, SENSOR, TARGET),
        lambda: Tracking(-73.0, SENSOR, TARGET[:, :1]),
        lambda: Tracking(-73.0, SENSOR, TARGET, np.ones(4)),
        lambda: Tracking(-73.0, SENSOR, TARGET, -np.ones(5)),
        lambda: tracking_value(POSTERIOR, PATH[:4], TASK),
        lambda: tracking_value(POSTERIOR, PATH * np.nan, TASK),
    ],
)
def test_bad_input_is_ours(make):
    """Every check raises InputError."""
    with pytest.raises(InputError):
        make()
