"""Tracking over drawn channels: the dense filter, other draws, differences, sets of paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn

from planopt.channel.joint import joint_prediction
from planopt.channel.posterior import condition
from planopt.objectives.axis_filter import removed, removed_derivatives
from planopt.objectives.tracking import Tracking
from planopt.objectives.tracking_filter import FilteredTracking
from planopt.objectives.tracking_scenarios import (
    drawn_errors,
    extended,
    received_from,
    scenario_derivatives,
    scenario_gain,
)
from planopt.targets.information_filter import TargetModel
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import Sensor, sensing_information

POSTERIOR = condition(CHANNEL, drawn(15))
OTHER = condition(CHANNEL, drawn(9))
STATIONS = [(POSTERIOR, -73.0)]
SETTINGS = FilteredTracking(
    Tracking(-73.0, Sensor(0.008, 0.08, 1.0), PATH + 2.0, np.array([1.0, 0.5, 2.0, 1.0, 1.5])),
    TargetModel(0.5, 0.03 * np.eye(2)),
    np.linalg.inv(np.diag([1.0, 1.0, 0.1, 0.1])),
)
BESIDE = [PATH + [1.0, -0.5], PATH[::-1] + 0.4]


MEASURES = {
    "trace": np.trace,
    "determinant": np.linalg.det,
    "norm": lambda matrix: np.linalg.norm(matrix, 2),
}


def dense_cost(received, settings=SETTINGS):
    """sum_k w_k f(P_k) of the position in one draw, with 4 by 4 matrices."""
    a, q = settings.model.transition, settings.model.process_covariance
    spread, total = np.linalg.inv(settings.information), 0.0
    for information, weight in zip(received, settings.tracking.weight, strict=True):
        spread = a @ spread @ a.T + q
        matrix = np.linalg.inv(spread)
        matrix[:2, :2] += information * np.eye(2)
        spread = np.linalg.inv(matrix)
        total += weight * MEASURES[settings.criterion](spread[:2, :2])
    return total


@pytest.mark.parametrize("criterion", list(MEASURES))
def test_one_axis_is_the_whole_filter(criterion):
    """The mean over draws of what the dense filter removes; nothing for nothing."""
    settings = replace(SETTINGS, criterion=criterion)
    received = np.random.default_rng(0).exponential(2.0, (7, 5))
    kept = np.mean([dense_cost(each, settings) for each in received])
    dense = dense_cost(np.zeros(5), settings) - kept
    assert removed(received, settings) == pytest.approx(dense, rel=1e-9)
    assert removed(np.zeros((7, 5)), settings) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("criterion", list(MEASURES))
def test_derivatives_of_the_filter_are_differences(criterion):
    """Of every draw by the information of every step, to second order."""
    settings = replace(SETTINGS, criterion=criterion)
    received, h = np.random.default_rng(1).exponential(2.0, (4, 5)), 1e-5
    value, slope, bend = removed_derivatives(received, settings)
    assert value == pytest.approx(removed(received, settings), rel=1e-12)
    for k in range(5):
        step = h * np.eye(5)[k]
        up, down = received + step, received - step
        each = [
            (removed(a[None], settings) - removed(b[None], settings)) / (2.0 * h)
            for a, b in zip(up, down, strict=True)
        ]
        np.testing.assert_allclose(slope[:, k], each, rtol=1e-6, atol=1e-8)
        turned = removed_derivatives(up, settings)[1] - removed_derivatives(down, settings)[1]
        np.testing.assert_allclose(bend[:, :, k], turned / (2.0 * h), rtol=1e-5, atol=1e-7)


def test_value_is_that_of_joint_losses():
    """Against packets that arrive or not in 4,000 other draws of the joint law."""
    found = scenario_gain(STATIONS, [PATH], SETTINGS)
    power = joint_prediction(POSTERIOR, PATH)
    rng = np.random.default_rng(5)
    up = rng.multivariate_normal(power.mean_db, power.covariance_db2, 4000) >= -73.0
    sensing = sensing_information(SETTINGS.tracking.sensor, PATH, SETTINGS.tracking.target_m)
    each = dense_cost(np.zeros(5)) - np.array(
        [dense_cost(0.5 * sensing * arrived) for arrived in up]
    )
    # A tenth of each variance smooths the draws, and an average packet is worth a little more.
    error = 3.5 * each.std() * np.sqrt(1.0 / 4000 + 1.0 / 128)
    assert found == pytest.approx(each.mean(), abs=error + 0.03 * each.mean())
    independent = rng.uniform(size=up.shape) < up.mean(axis=0)
    alone = dense_cost(np.zeros(5)) - np.mean([dense_cost(0.5 * sensing * a) for a in independent])
    assert abs(found - each.mean()) < abs(found - alone) or abs(alone - each.mean()) < error


def test_a_set_of_paths_has_one_value():
    """Whatever their order; marginal values add up to that of all, in any order."""
    paths = [PATH, *BESIDE]
    whole = scenario_gain(STATIONS, paths, SETTINGS)
    assert scenario_gain(STATIONS, paths[::-1], SETTINGS) == pytest.approx(whole, rel=1e-12)
    less = [scenario_gain(STATIONS, paths[:n], SETTINGS) for n in (1, 2)]
    assert 0.0 < less[0] < less[1] < whole
    # A second packet from the same place shares the fate of the first: worth less than one aside.
    twice = scenario_gain(STATIONS, [PATH, PATH + 1e-9], SETTINGS)
    assert less[0] < twice


def test_shared_shadowing_makes_robots_share_losses():
    """Errors side by side are nearly equal, as their correlation says; far apart they are not."""
    errors = drawn_errors(STATIONS, [PATH, PATH + 1e-6, PATH + 1e5])[0]
    near = np.mean(errors[0] * errors[1], axis=0)
    far = np.mean(errors[0] * errors[2], axis=0)
    power = joint_prediction(POSTERIOR, np.vstack([PATH, PATH + 1e-6]))
    expected = np.diag(power.covariance_db2[:5, 5:]) / np.diag(power.covariance_db2)[:5]
    np.testing.assert_allclose(near, expected, atol=0.3)
    assert near.mean() - far.mean() > 0.5 * expected.mean()


def test_any_station_is_enough():
    """A second station adds packets; one that hears nothing adds none."""
    one = scenario_gain(STATIONS, [PATH], SETTINGS)
    assert scenario_gain([*STATIONS, (OTHER, -73.0)], [PATH], SETTINGS) > one
    assert scenario_gain([*STATIONS, (OTHER, 500.0)], [PATH], SETTINGS) == pytest.approx(one)


def test_steps_beyond_the_horizon():
    """The target goes on at its last velocity, and the robot stands; a single step has none."""
    longer = extended(SETTINGS, 3)
    target = longer.tracking.target_m
    np.testing.assert_allclose(target[5:] - target[4:-1], np.tile(target[4] - target[3], (3, 1)))
    stood = np.vstack([PATH, np.tile(PATH[-1], (3, 1))])
    errors = drawn_errors(STATIONS, [PATH])
    received = received_from(STATIONS, [PATH], errors, longer)
    again = np.concatenate([errors, np.repeat(errors[..., -1:], 3, axis=-1)], axis=-1)
    np.testing.assert_allclose(received, received_from(STATIONS, [stood], again, longer))
    first = replace(
        SETTINGS.tracking,
        target_m=SETTINGS.tracking.target_m[:1],
        weight=SETTINGS.tracking.weight[:1],
    )
    single = replace(SETTINGS, tracking=first)
    assert extended(single, 3) is single


@pytest.mark.parametrize("stations", [1, 2])
@pytest.mark.parametrize("beyond", [0, 3])
def test_derivatives_by_places_are_differences(stations, beyond):
    """With scores that are linear in the place, beside other robots' packets."""
    rng = np.random.default_rng(2)
    slope, errors = rng.normal(size=(stations, 5, 2)), rng.normal(size=(stations, 6, 5))
    settings = extended(SETTINGS, beyond)
    told = rng.exponential(1.0, (6, 5 + beyond))

    def at(places):
        scores = [
            Derivatives(((places - PATH) * each).sum(axis=1) + 0.3, each, np.zeros((5, 3)))
            for each in slope
        ]
        return scenario_derivatives(scores, errors, told, places, settings)

    found, h = at(PATH), 1e-5
    for _ in range(3):
        towards = rng.normal(size=PATH.shape)
        up, down = at(PATH + h * towards), at(PATH - h * towards)
        step = towards.ravel()
        assert found.gradient @ step == pytest.approx((up.value - down.value) / (2.0 * h), rel=1e-5)
        bend = (up.gradient - down.gradient) / (2.0 * h)
        np.testing.assert_allclose(found.hessian @ step, bend, rtol=1e-4, atol=1e-6)
