"""Recursions and sampling against enumeration of all losses, and where the recursion is wrong."""

import itertools

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, drawn

from planopt.channel.connection.sampled_distribution import SampledDistribution
from planopt.channel.kriging import predict
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.tracking import Tracking, delivery, team_tracking_value
from planopt.objectives.tracking_filter import (
    FilteredTracking,
    bounding_information,
    covariance_recursion_m2,
    information_bound,
    riccati_covariances,
    sampled_arrivals,
    sampled_tracking,
)
from planopt.targets.information_filter import (
    TargetModel,
    position_variance_m2,
    predicted_information,
)
from planopt.targets.sensor import Sensor

POSTERIOR = condition(CHANNEL, drawn(15))
MODEL = TargetModel(0.5, 0.02 * np.eye(2))
INFORMATION = np.linalg.inv(np.diag([1.0, 1.0, 0.1, 0.1]) + 0.02)
SENSOR = Sensor(0.008, 0.08, 1.0)
PATHS = [PATH, PATH[::-1] + 1.0]
SETTINGS = FilteredTracking(Tracking(-73.0, SENSOR, PATH + 2.0), MODEL, INFORMATION)


def expectation(arrival, sensing, settings=SETTINGS):
    """E J_k and E P_k of every step by enumeration of all independent losses; dense formulas."""
    steps, robots = arrival.shape
    j_mean, p_mean = np.zeros((steps, 4, 4)), np.zeros((steps, 4, 4))
    a, q = settings.model.transition, settings.model.process_covariance
    for losses in itertools.product((0.0, 1.0), repeat=arrival.size):
        up = np.array(losses).reshape(steps, robots)
        chance = np.where(up > 0.0, arrival, 1.0 - arrival).prod()
        matrix = settings.information
        for k in range(steps):
            matrix = np.linalg.inv(a @ np.linalg.inv(matrix) @ a.T + q)
            matrix[:2, :2] += 0.5 * (up[k] @ sensing[k]) * np.eye(2)
            j_mean[k] += chance * matrix
            p_mean[k] += chance * np.linalg.inv(matrix)
    return j_mean, p_mean


def is_below(lower, upper):
    """Loewner order of batches of matrices, up to rounding."""
    scale = np.abs(upper).max()
    return (np.linalg.eigvalsh(upper - lower)[:, 0] >= -1e-12 * scale).all()


@pytest.mark.parametrize("robots, steps", [(1, 5), (1, 8), (2, 4)])
def test_recursions_enclose_the_enumerated_expectation(robots, steps):
    """MARE >= E P >= J-bar^-1 and J-bar >= E J, as matrices, at every step (equation 4.12)."""
    task = FilteredTracking(
        Tracking(-73.0, SENSOR, np.resize(PATH, (steps, 2)) + 2.0), MODEL, INFORMATION
    )
    paths = [np.resize(path, (steps, 2)) for path in PATHS[:robots]]
    arrival, sensing = delivery([POSTERIOR] * robots, paths, task.tracking)
    assert 0.05 < arrival.min() and arrival.max() < 0.95
    j_mean, p_mean = expectation(arrival, sensing, task)
    bound = bounding_information(arrival, sensing, task)
    riccati = riccati_covariances(arrival, sensing, task)
    assert is_below(j_mean, bound)
    assert is_below(p_mean, riccati)
    assert is_below(np.linalg.inv(bound), p_mean)
    assert np.trace(riccati[-1] - p_mean[-1]) > 1e-4
    # The first step is exact for information, and for one robot's covariance.
    np.testing.assert_allclose(bound[0], j_mean[0], rtol=1e-10)
    if robots == 1:
        np.testing.assert_allclose(riccati[0], p_mean[0], rtol=1e-10, atol=1e-14)


def test_one_step_is_equation_4_plus_a_constant():
    """Tr J-bar_1 = tr J_{t+1|t} + sum_i p_i tr Phi^-1, for one robot and for two."""
    task = Tracking(-73.0, SENSOR, PATH[:1] + 2.0)
    settings = FilteredTracking(task, MODEL, INFORMATION)
    constant = np.trace(predicted_information(MODEL, INFORMATION))
    for robots in (1, 2):
        posteriors, paths = [POSTERIOR] * robots, [path[:1] for path in PATHS[:robots]]
        reward = team_tracking_value(posteriors, paths, task)
        found = information_bound(posteriors, paths, settings)
        assert found == pytest.approx(constant + reward, rel=1e-12)


def test_values_are_weighted_traces():
    """Of J for the bound, of the position's variance for the recursion."""
    weight = np.array([0.0, 1.0, 0.0, 2.0, 1.0])
    task = Tracking(-73.0, SENSOR, PATH + 2.0, weight)
    settings = FilteredTracking(task, MODEL, INFORMATION)
    arrival, sensing = delivery([POSTERIOR], [PATH], task)
    matrices = bounding_information(arrival, sensing, settings)
    covariances = riccati_covariances(arrival, sensing, settings)
    assert information_bound([POSTERIOR], [PATH], settings) == pytest.approx(
        weight @ [np.trace(each) for each in matrices]
    )
    assert covariance_recursion_m2([POSTERIOR], [PATH], settings) == pytest.approx(
        weight @ [each[0, 0] + each[1, 1] for each in covariances]
    )


def test_certain_packets_make_both_the_filter():
    """With p in {0, 1} nothing is averaged: P-bar = J-bar^-1."""
    sensing = np.full((5, 2), 3.0)
    arrival = np.array([[1, 0], [0, 0], [1, 1], [0, 1], [0, 0]], dtype=float)
    np.testing.assert_allclose(
        riccati_covariances(arrival, sensing, SETTINGS),
        np.linalg.inv(bounding_information(arrival, sensing, SETTINGS)),
        rtol=1e-10,
        atol=1e-13,
    )


@pytest.mark.parametrize("measure", ["information", "covariance"])
def test_sampling_agrees_with_enumeration_where_losses_are_independent(measure):
    """A decorrelation distance far below the steps; within three of the interval's halves."""
    white = ChannelParameters(-35.0, 2.8, 5.0, 1e-3, 2.0, Station((3.0, -4.0), 6.0))
    posterior = condition(white, NOTHING, theta="known")
    arrival, sensing = delivery([posterior], [PATH], SETTINGS.tracking)
    matrices, covariances = expectation(arrival, sensing)
    expected = {
        "information": np.trace(matrices, axis1=1, axis2=2).sum(),
        "covariance": np.trace(covariances[:, :2, :2], axis1=1, axis2=2).sum(),
    }[measure]
    drawn_values = sampled_tracking(
        [posterior], [PATH], SETTINGS, measure, 20_000, np.random.default_rng(0)
    )
    assert isinstance(drawn_values, SampledDistribution) and drawn_values.count == 20_000
    found = drawn_values.mean()
    assert abs(found.value - expected) < 3.0 * (found.high - found.value)


def test_the_information_bound_survives_shadowing():
    """Losses that belong together lower E J, never raise it above the bound."""
    found = sampled_tracking(
        [POSTERIOR, POSTERIOR], PATHS, SETTINGS, "information", 20_000, np.random.default_rng(1)
    ).mean()
    assert found.high <= information_bound([POSTERIOR, POSTERIOR], PATHS, SETTINGS)


def test_the_covariance_recursion_is_no_bound_under_shadowing():
    """The outdoor channel of [GM11], p = 0.6, 1 m steps: it claims less than half, then less."""
    outdoor = ChannelParameters(-10.0, 2.0, 4.0, 20.0, 1.13, Station((0.0, 0.0)))
    posterior = condition(outdoor, NOTHING, theta="known")
    previous = 1.0
    for steps in (5, 10, 20):
        # On a circle about the station p is the same everywhere.
        angle = np.arange(1, steps + 1) / 30.0
        path = 30.0 * np.column_stack([np.cos(angle), np.sin(angle)])
        power = predict(posterior, path[:1])
        threshold = float(power.mean_db[0] - 0.2533471 * power.deviation_db[0])
        last = np.zeros(steps)
        last[-1] = 1.0
        task = Tracking(threshold, SENSOR, path * (31.0 / 30.0), last)
        settings = FilteredTracking(
            task, TargetModel(0.5, np.eye(2)), np.linalg.inv(np.diag([1.0, 1.0, 0.1, 0.1]))
        )
        arrival, _ = delivery([posterior], [path], task)
        np.testing.assert_allclose(arrival, 0.6, atol=1e-6)
        claimed = covariance_recursion_m2([posterior], [path], settings)
        found = sampled_tracking(
            [posterior], [path], settings, "covariance", 4000, np.random.default_rng(2)
        ).mean()
        ratio = claimed / found.low
        assert ratio < 0.6 and ratio < previous
        previous = ratio
    assert previous < 0.1


def test_robots_that_share_a_posterior_share_the_field():
    """Side by side they fail together; with separate posteriors independently."""
    beside = [PATH, PATH + 0.01]
    task = SETTINGS.tracking
    twin = condition(CHANNEL, drawn(15))
    for other, together in ((POSTERIOR, True), (twin, False)):
        up = sampled_arrivals([POSTERIOR, other], beside, task, 20_000, np.random.default_rng(0))
        correlation = np.corrcoef(up[:, 0, 0], up[:, 0, 1])[0, 1]
        assert (correlation > 0.4) == together
        arrival, _ = delivery([POSTERIOR, other], beside, task)
        np.testing.assert_allclose(up.mean(axis=0), arrival, atol=0.02)


def test_the_same_generator_state_gives_the_same_draws():
    """Sample average approximation: the objective is a fixed function of the path."""
    one, two = (
        sampled_tracking(
            [POSTERIOR], [PATH], SETTINGS, "covariance", 50, np.random.default_rng(7)
        ).draws
        for _ in range(2)
    )
    np.testing.assert_array_equal(one, two)
    assert (one > 0.0).all()


def test_covariance_draws_are_the_filters():
    """Every draw is the weighted position variance of its own losses."""
    rng = np.random.default_rng
    found = sampled_tracking([POSTERIOR], [PATH], SETTINGS, "covariance", 20, rng(3)).draws
    up = sampled_arrivals([POSTERIOR], [PATH], SETTINGS.tracking, 20, rng(3)).astype(float)
    _, sensing = delivery([POSTERIOR], [PATH], SETTINGS.tracking)
    for draw, losses in zip(found, up, strict=True):
        matrices = bounding_information(losses, sensing, SETTINGS)
        assert draw == pytest.approx(position_variance_m2(matrices).sum())


@pytest.mark.parametrize(
    "make",
    [
        lambda: FilteredTracking(SETTINGS.tracking, MODEL, -np.eye(4)),
        lambda: FilteredTracking(SETTINGS.tracking, MODEL, np.eye(2)),
        lambda: sampled_tracking(
            [POSTERIOR], [PATH], SETTINGS, "spread", 5, np.random.default_rng(0)
        ),
        lambda: sampled_tracking(
            [POSTERIOR], [PATH], SETTINGS, "covariance", 1, np.random.default_rng(0)
        ),
        lambda: covariance_recursion_m2(
            [POSTERIOR], [PATH], FilteredTracking(SETTINGS.tracking, MODEL, np.zeros((4, 4)))
        ),
    ],
)
def test_bad_input_is_ours(make):
    """Every check raises InputError."""
    with pytest.raises(InputError):
        make()
