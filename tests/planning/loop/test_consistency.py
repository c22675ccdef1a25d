"""NEES and NIS of the filters of a run: another filter's, and what the law says of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from planopt import load, simulate
from planopt.planning.loop.log import target_log
from planopt.planning.loop.metrics import nis_interval
from planopt.planning.stepping import counted, watch_target
from planopt.targets.information_filter import noise_covariance_m2, sense

STEPS = 150


def watched(first, tracks_m, delivered, generator):
    """The target estimate after each step of robots on tracks (robots, steps + 1, 2)."""
    watches = [first]
    for step, arrived in enumerate(delivered, start=1):
        watch, here = watches[-1], tracks_m[:, step]
        seen = sense(watch.sensor, here, watch.true_m[step], generator)
        watches.append(counted(watch, seen, here, arrived))
    return watches


@pytest.fixture(scope="module")
def log():
    """A target that two robots follow at a distance, and the watches that the log is of."""
    problem = load("outdoor_track")
    target = replace(problem.targets[0], stays_free=False)
    planner = replace(problem.planner, max_steps=STEPS)
    problem = replace(problem, targets=(target,), robots=problem.robots[:2], planner=planner)
    generator = np.random.default_rng(5)
    first = watch_target(problem, generator)
    beside = first.true_m + np.array([[6.0, 0.0]]), first.true_m - np.array([[0.0, 9.0]])
    delivered = np.random.default_rng(6).uniform(size=(STEPS, 2)) < 0.6
    watches = watched(first, np.stack(beside), delivered, generator)
    return target_log(watches, delivered), watches


def test_values_are_those_of_a_covariance_filter(log):
    """Kalman's equations for each robot; the station's error by its own covariance."""
    found, watches = log
    for robot in (0, 1):
        mean, spread = watches[0].robots[robot].mean, watches[0].robots[robot].covariance
        model = watches[0].model
        for step in range(1, 40):
            mean = model.transition @ mean
            spread = model.transition @ spread @ model.transition.T + model.process_covariance
            sent = watches[step].sent[-1]
            place, measured = sent.positions_m[[robot]], sent.measured_m[robot]
            noise = noise_covariance_m2(watches[0].sensor, place, mean[:2])[0]
            expected, error = spread[:2, :2] + noise, measured - mean[:2]
            value = error @ np.linalg.inv(expected) @ error
            assert found.nis[step - 1, robot] == pytest.approx(value, rel=1e-6)
            gain = spread[:, :2] @ np.linalg.inv(expected)
            mean, spread = mean + gain @ error, spread - gain @ spread[:2]
    last = watches[-1].station
    error = last.mean[:2] - found.true_m[-1]
    spread = last.covariance[:2, :2]
    assert found.nees[-1] == pytest.approx(error @ np.linalg.inv(spread) @ error, rel=1e-9)
    assert found.station_determinant_m4[-1] == pytest.approx(
        spread[0, 0] * spread[1, 1] - spread[0, 1] ** 2
    )


def test_a_filter_that_is_right_has_two_in_the_mean(log):
    """NIS of either robot is within its interval, widened by a tenth for the sensor's noise.

    The filter takes that at its own estimate of the distance, the sensor at the true one.
    """
    found, _ = log
    low, high = nis_interval(found.nis.size)
    assert 0.9 * low < found.nis.mean() < 1.1 * high
    assert (found.nis > chi2.ppf(0.95, 2)).mean() == pytest.approx(0.05, abs=0.03)


def test_the_interval_is_that_of_chi_square():
    for count in (1, 300):
        np.testing.assert_allclose(
            nis_interval(count), chi2.ppf([0.025, 0.975], 2 * count) / count, rtol=1e-9
        )


def test_a_wrong_model_is_outside():
    """A target that is pushed five times as hard as the filters believe leaves the interval."""
    problem = load("outdoor_track")
    pushed = replace(problem.targets[0], acceleration_std_m_s2=0.5, stays_free=False)
    problem = replace(problem, robots=problem.robots[:1])
    problem = replace(problem, planner=replace(problem.planner, max_steps=STEPS))
    true = watch_target(replace(problem, targets=(pushed,)), np.random.default_rng(1)).true_m
    first = replace(watch_target(problem, np.random.default_rng(1)), true_m=true)
    delivered = np.ones((STEPS, 1), dtype=bool)
    watches = watched(first, true[None] + 1.0, delivered, np.random.default_rng(2))
    found = target_log(watches, delivered)
    assert found.nis.mean() > 1.5 * nis_interval(STEPS)[1]


def test_a_run_reports_them():
    """Means over the steps, and the interval of as many values as there were measurements."""
    problem = load("outdoor_track")
    planner = replace(problem.planner, max_steps=3, horizon=1, name="lattice")
    run = simulate(replace(problem, planner=planner), seed=0)
    metrics, count = run.metrics, 3 * len(problem.robots)
    assert metrics["nis"] == pytest.approx(run.target.nis.mean())
    assert metrics["nees"] == pytest.approx(run.target.nees[1:].mean())
    assert (metrics["nis_low"], metrics["nis_high"]) == nis_interval(count)
    determinant = (0.5 * run.target.station_variance_m2[1:]) ** 2
    assert metrics["time_averaged_det_p"] == pytest.approx(determinant.mean(), rel=1e-6)
