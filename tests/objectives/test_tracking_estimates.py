"""Plans for packets that have estimates: a loop over draws, one arrival by hand, differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from test_tracking_scenarios import BESIDE, MEASURES, OTHER, PATH, SETTINGS, STATIONS

from planopt.objectives.axis_filter import removed
from planopt.objectives.tracking_estimates import Held, counting, log_lost, missing, told_of
from planopt.objectives.tracking_scenarios import (
    DRAWS,
    RHO2,
    drawn_errors,
    extended,
    scenario_derivatives,
    scenario_gain,
    scenario_gains,
)
from planopt.targets.information_filter import covariance_of, predicted_information
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import sensing_information

RNG = np.random.default_rng(0)
HELD = Held(np.diag([1.0, 1.0, 9.0, 9.0]), RNG.exponential(0.3, 3), RNG.exponential(1.0, (3, 3)))
NOTHING_HELD = Held(SETTINGS.information, np.zeros(0), np.zeros((3, 0)))


def filtered(settings, told):
    """The position's covariance after a step for each number of `told`, from 4 by 4 matrices."""
    matrix = settings.held.information
    for information in told:
        matrix = predicted_information(settings.model, matrix)
        matrix[:2, :2] += information * np.eye(2)
    return covariance_of(matrix)[:2, :2]


@pytest.mark.parametrize(
    ("held", "criterion", "beyond"),
    [(NOTHING_HELD, "trace", 0), (HELD, "trace", 2), (HELD, "determinant", 0)],
)
def test_value_is_that_of_a_loop_over_draws(held, criterion, beyond):
    """Every draw, step and robot in turn; what is held comes with the robot's first packet."""
    settings = extended(replace(SETTINGS, held=held, criterion=criterion), beyond)
    paths, stations = [*BESIDE, PATH], [*STATIONS, (OTHER, -73.0)]
    errors, measure, tracking = (
        drawn_errors(stations, paths),
        MEASURES[criterion],
        settings.tracking,
    )
    total = 0.0
    for draw in range(DRAWS):
        lost = np.ones((3, 5))
        for (posterior, threshold), error in zip(stations, errors, strict=True):
            for number, path in enumerate(paths):
                power = posterior.predict(path)
                score = (power.mean_db - threshold) / power.deviation_db
                score += np.sqrt(RHO2) * error[number, draw]
                lost[number] *= norm.cdf(-score / np.sqrt(1.0 - RHO2))
        for k, weight in enumerate(tracking.weight):
            told = held.known.copy()
            for s in range(held.steps):
                told[s] += held.sent[:, s] @ (1.0 - lost[:, : min(k, 4) + 1].prod(axis=1))
            for s in range(k + 1):
                places = np.array([path[min(s, 4)] for path in paths])
                each = sensing_information(tracking.sensor, places, tracking.target_m[s])
                arrives = 1.0 - lost[:, min(s, 4) : min(k, 4) + 1].prod(axis=1)
                told = np.append(told, 0.5 * each @ arrives)
            idle = np.append(held.known, np.zeros(k + 1))
            kept = measure(filtered(settings, told))
            total += weight * (measure(filtered(settings, idle)) - kept) / DRAWS
    assert scenario_gain(stations, paths, settings) == pytest.approx(total, rel=1e-9)


def test_one_packet_tells_what_its_robot_knows():
    """Of three steps the second arrives: predicted, the robot's own filter, predicted again."""
    tracking = replace(
        SETTINGS.tracking,
        target_m=SETTINGS.tracking.target_m[:3],
        weight=np.array([1.0, 10.0, 100]),
    )
    held = Held(HELD.information, np.zeros(1), np.array([[2.0]]))
    settings = replace(SETTINGS, tracking=tracking, held=held)
    which = counting(1, np.arange(3))
    arrives = 1.0 - missing(log_lost(np.array([-40.0, 40.0, -40.0])), which)
    np.testing.assert_allclose(arrives, [[0, 0, 0, 0], [1, 1, 1, 0], [1, 1, 1, 0]], atol=1e-15)
    told = told_of(1.0 - arrives, np.array([4.0, 6.0, 8.0]), held.sent[0])
    known = [[0, 0], [2, 2, 3], [2, 2, 3, 0]]
    expected = sum(
        weight * np.trace(filtered(settings, np.zeros(len(row))) - filtered(settings, row))
        for weight, row in zip(tracking.weight, known, strict=True)
    )
    assert removed(told[None], settings) == pytest.approx(expected, rel=1e-10)


def test_at_certain_contact_packets_of_both_kinds_tell_the_same():
    """An estimate is worth more where packets are lost, and nothing more where none is."""
    estimates = replace(SETTINGS, held=NOTHING_HELD)
    for threshold, same in ((-500.0, True), (-73.0, False)):
        raw, more = (scenario_gain([(OTHER, threshold)], [PATH], s) for s in (SETTINGS, estimates))
        assert more == pytest.approx(raw, rel=1e-9) if same else more > 1.001 * raw


def test_ranking_many_paths_has_their_values():
    """Of one path of independent errors the same as one by one."""
    settings = replace(SETTINGS, held=replace(HELD, sent=HELD.sent[-1:]))
    scores = RNG.normal(size=(4, 5))
    ways = PATH + RNG.normal(size=(4, 1, 2))
    nothing = np.zeros((32, 5, 8))
    found = scenario_gains(scores, np.tile(np.eye(5), (4, 1, 1)), ways, nothing, settings)
    for number in range(4):
        one = slice(number, number + 1)
        alone = scenario_gains(scores[one], np.eye(5)[None], ways[one], nothing, settings)
        assert alone[0] == pytest.approx(found[number], rel=1e-12)
    sure = scenario_gains(scores + 400.0, np.tile(np.eye(5), (4, 1, 1)), ways, nothing, settings)
    raw = replace(settings, held=None, information=HELD.information)
    assert (sure > found).all()
    assert raw.held is None


@pytest.mark.parametrize("stations", [1, 2])
@pytest.mark.parametrize(("beyond", "criterion"), [(0, "trace"), (3, "determinant")])
def test_derivatives_by_places_are_differences(stations, beyond, criterion):
    """With scores that are linear in the place, beside other robots' packets."""
    rng = np.random.default_rng(2)
    slope, errors = rng.normal(size=(stations, 5, 2)), rng.normal(size=(stations, 6, 5))
    settings = extended(replace(SETTINGS, held=HELD, criterion=criterion), beyond)
    told = rng.exponential(0.2, (6, 5 + beyond, 8 + beyond)) * np.tri(5 + beyond, 8 + beyond, 3)

    def at(places):
        scores = [
            Derivatives(((places - PATH) * each).sum(axis=1) - 0.3, each, np.zeros((5, 3)))
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
