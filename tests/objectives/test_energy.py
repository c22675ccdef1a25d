"""Energy: closed forms, the expectation by simulation, scaling."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, drawn

from planopt.channel.joint import sample_power
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.terms.motion_energy import MotionEnergyTerm
from planopt.objectives.terms.transmission_energy import (
    Radio,
    expected_transmit_power_w,
    transmission_derivatives,
    transmission_energy_j,
    transmission_stage_costs_j,
)
from planopt.targets.rounding import Derivatives

POSTERIOR = condition(CHANNEL, drawn(15))
MOTION = MotionEnergyTerm(weight=1.0, per_metre_j_m=3.5, power_w=0.3)
RADIO = Radio(2.0, 1e-6, -100.0, 20.0, 0.5)


def test_motion_by_hand():
    """Steps of 2 s: 3.5 J a metre and 0.3 W while moving; standing still costs nothing."""
    spent = -MOTION.move_reward(np.array([1.0, 2.0, 0.0]), 2.0)
    np.testing.assert_allclose(spent, [3.5 + 0.6, 7.0 + 0.6, 0.0])


def test_motion_at_constant_speed_costs_the_rate():
    """A metre costs k_1 + k_2 / v."""
    for speed in (0.5, 0.75, 2.0):
        spent = -MOTION.move_reward(np.array([2.0 * speed]), 2.0)
        np.testing.assert_allclose(spent / (2.0 * speed), 3.5 + 0.3 / speed)


def test_power_for_a_known_channel_keeps_the_bit_error_rate():
    """BER = 1/5 exp(-1.5 snr / (2^R - 1)) is the one asked for at the power returned."""
    mean = np.array([-80.0, -60.0])
    watts = expected_transmit_power_w(mean, np.zeros(2), RADIO)
    received_dbm = mean - 20.0 + 10.0 * np.log10(watts / 1e-3)
    snr = 10.0 ** ((received_dbm - -100.0) / 10.0)
    np.testing.assert_allclose(0.2 * np.exp(-1.5 * snr / 3.0), 1e-6, rtol=1e-9)


def test_expectation_by_simulation():
    """Mean of the power over 100,000 draws of every place, within 5 standard errors."""
    sampled = sample_power(POSTERIOR, PATH, 100_000, np.random.default_rng(0))
    each = 0.5 * expected_transmit_power_w(sampled, np.zeros_like(sampled), RADIO).sum(axis=1)
    found = transmission_energy_j(POSTERIOR, PATH, RADIO)
    assert abs(each.mean() - found) < 5.0 * each.std() / np.sqrt(100_000)


def test_stages_add_up_and_scale():
    """Sum over places; 10 dB more noise or less reference power cost ten times as much."""
    stages = transmission_stage_costs_j(POSTERIOR, PATH, RADIO)
    assert stages.shape == (5,) and (stages > 0.0).all()
    total = transmission_energy_j(POSTERIOR, PATH, RADIO)
    assert total == pytest.approx(stages.sum())
    noisy = dataclasses.replace(RADIO, noise_dbm=-90.0)
    assert transmission_energy_j(POSTERIOR, PATH, noisy) == pytest.approx(10.0 * total)
    strong = dataclasses.replace(RADIO, reference_transmit_dbm=30.0)
    assert transmission_energy_j(POSTERIOR, PATH, strong) == pytest.approx(10.0 * total)
    fast = dataclasses.replace(RADIO, bits_per_symbol=4.0)
    assert transmission_energy_j(POSTERIOR, PATH, fast) == pytest.approx(5.0 * total)


@pytest.mark.parametrize("rates", [(0.0, 1e-6), (2.0, 0.2), (2.0, 0.0), (2.0, np.nan)])
def test_rates_out_of_range(rates):
    """Each is refused."""
    with pytest.raises(InputError):
        Radio(rates[0], rates[1], -100.0, 20.0, 0.5)


def test_derivatives_of_sending_are_differences():
    """Of mean and deviation that are quadratic in the place."""
    rng = np.random.default_rng(3)
    slope, bend = rng.normal(size=(2, 4, 2)), 0.3 * rng.normal(size=(2, 4, 3))
    level = np.array([np.full(4, -70.0), np.full(4, 4.0)])

    def at(place):
        squares = np.stack([place[:, 0] ** 2, 2 * place[:, 0] * place[:, 1], place[:, 1] ** 2], 1)
        powers = []
        for number in range(2):
            a, b = slope[number], bend[number]
            value = level[number] + (a * place).sum(axis=1) + 0.5 * (b * squares).sum(axis=1)
            turned = np.stack([b[:, 0] * place[:, 0] + b[:, 1] * place[:, 1]] * 2, axis=1)
            turned[:, 1] = b[:, 1] * place[:, 0] + b[:, 2] * place[:, 1]
            powers.append(Derivatives(value, a + turned, b))
        return transmission_derivatives(*powers, RADIO)

    place, step = 0.5 * rng.normal(size=(4, 2)), 1e-5
    found = at(place)
    for axis in range(2):
        moved = step * np.eye(2)[axis]
        more, less = at(place + moved), at(place - moved)
        change = (more.value - less.value) / (2 * step)
        np.testing.assert_allclose(found.gradient[:, axis], change, rtol=1e-7)
        change = (more.gradient - less.gradient) / (2 * step)
        np.testing.assert_allclose(found.hessian[:, axis : axis + 2], change, rtol=1e-6)
