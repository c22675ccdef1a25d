"""The additive form of tracking: equation 4.11 by hand, invariances, derivatives."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn, moved
from scipy.stats import norm

from planopt import InputError
from planopt.channel import Station, condition
from planopt.channel.kriging import LocalChannel, predict
from planopt.objectives import TrackingTerm
from planopt.objectives.stage_power import StagePredictor
from planopt.objectives.tracking import Tracking
from planopt.targets.information_filter import Sensor, sensing_derivatives, sensing_information

POSTERIOR = condition(CHANNEL, drawn(15))
TARGET = PATH + np.array([3.0, -4.0])
WEIGHT = (1.0, 0.5, 2.0, 0.0, 1.0)
TERM = TrackingTerm(0.008, 0.08, 1.0, form="additive", step_weights=WEIGHT)


def context(posterior=POSTERIOR, target=TARGET, threshold=-73.0):
    return SimpleNamespace(
        aim=SimpleNamespace(target_m=target),
        law=SimpleNamespace(thresholds_dbm=(threshold,)),
        power=posterior.predict,
        once=lambda key, make: make(),
    )


def test_one_step_is_equation_4_of_the_paper():
    """Q((TH - mean) / deviation) / g(r), with SciPy's normal tail and g written out."""
    power = predict(POSTERIOR, PATH[:1])
    tail = norm.sf((-73.0 - power.mean_db[0]) / power.deviation_db[0])
    expected = tail / (0.008 * (5.0 - 1.0) ** 2 + 0.08)
    assert TERM.value(context(target=TARGET[:1]), PATH[:1]) == pytest.approx(expected, rel=1e-12)
    assert 0.01 < tail < 0.99


def test_values_of_many_paths_are_sums_of_stage_rewards():
    """Stage by stage, many places at once, with the weight of each step."""
    at, chance = context(), POSTERIOR.connectivity(PATH, -73.0)
    rewards = np.array([TERM.stage_reward(at, PATH, k, chance) for k in range(5)])
    assert TERM.value(at, PATH) == pytest.approx(np.trace(rewards))
    plain = dataclasses.replace(TERM, step_weights=())
    each = [plain.stage_reward(at, PATH, k, chance) for k in range(5)]
    np.testing.assert_allclose(rewards, np.array(WEIGHT)[:, None] * np.array(each))
    paths = SimpleNamespace(
        at=at, paths_m=np.stack([PATH, PATH]), chance=np.stack([chance, chance])
    )
    np.testing.assert_allclose(TERM.values(paths), np.trace(rewards))


def test_lower_threshold_never_lowers_the_objective():
    """From no connection at all to certain connection."""
    values = [
        TERM.value(context(threshold=level), PATH) for level in (300.0, -70.0, -80.0, -90.0, -300.0)
    ]
    assert (np.diff(values) > 0.0).all() and values[0] == 0.0
    sensing = sensing_information(TERM.sensor, PATH, TARGET)
    assert values[-1] == pytest.approx(np.array(WEIGHT) @ sensing)


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
    term = dataclasses.replace(TERM, noise_floor_m2=scale**2 * 0.08, sweet_spot_m=scale)
    expected = TERM.value(context(), PATH) / scale**2
    assert term.value(context(posterior, target), path) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Tracking(np.nan, Sensor(0.008, 0.08, 1.0), TARGET),
        lambda: Tracking(-73.0, Sensor(0.008, 0.08, 1.0), TARGET[:, :1]),
        lambda: Tracking(-73.0, Sensor(0.008, 0.08, 1.0), TARGET, np.ones(4)),
        lambda: Tracking(-73.0, Sensor(0.008, 0.08, 1.0), TARGET, -np.ones(5)),
    ],
)
def test_bad_input_is_ours(make):
    with pytest.raises(InputError):
        make()


def derivatives(path, threshold=-73.0):
    """Rewards of all stages at `path`, with derivatives of the exact posterior."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("planopt.objectives.stage_power.CUSP_ROUNDING", 1e-9)
        patch.setattr("planopt.objectives.stage_power.MIN_DISTANCE_M", 0.0)
        power = StagePredictor(LocalChannel.around_each(POSTERIOR, path, 15))(path)
    at = context(threshold=threshold)
    return TERM.derivatives(SimpleNamespace(at=at, places_m=path, stage_power=power))


@pytest.mark.parametrize("threshold", [-73.0, -85.0, -60.0])
def test_derivatives_are_those_of_central_differences(threshold):
    """To 1e-6 of the largest, from likely to unlikely connection; the value is the reward's."""
    h = 1e-4
    found = derivatives(PATH, threshold)
    assert found.value.sum() == pytest.approx(TERM.value(context(threshold=threshold), PATH))
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
    found, weight = derivatives(PATH, -400.0), np.array(WEIGHT)[:, None]
    sensing = sensing_derivatives(TERM.sensor, PATH, TARGET)
    np.testing.assert_allclose(found.value, WEIGHT * sensing.value)
    np.testing.assert_allclose(found.gradient, weight * sensing.gradient)
    np.testing.assert_allclose(found.hessian, weight * sensing.hessian)
