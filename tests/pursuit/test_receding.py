"""The predicting pursuer: its filter against dense algebra, its plan against closed forms."""

from functools import partial

import numpy as np
import pytest
from pursuit_scene import ExactRecords, pursue
from scipy.linalg import expm

from planopt.pursuit import Estimate, RecedingHorizon, Record, Wandering, predicted, updated


@pytest.mark.parametrize("lasts_s", [0.01, 3.0, 200.0])
def test_prediction(lasts_s):
    """Transition and process noise are those of Van Loan's matrix exponential."""
    speed, manoeuvre_s = 1.7, 12.0
    drift = np.array([[0.0, 1.0], [0.0, -1.0 / manoeuvre_s]])
    diffusion = np.diag([0.0, speed**2 / manoeuvre_s])
    block = np.block([[-drift, diffusion], [np.zeros((2, 2)), drift.T]])
    found = expm(block * lasts_s) if lasts_s < 50 else None
    mean, covariance = np.array([[1.0, 2.0], [0.5, -0.7]]), np.array([[2.0, 0.3], [0.3, 1.0]])
    ahead = predicted(Estimate(4.0, mean, covariance), 4.0 + lasts_s, speed, manoeuvre_s)
    step = expm(drift * lasts_s)
    np.testing.assert_allclose(ahead.mean, step @ mean, rtol=1e-9)
    if found is not None:
        noise = found[2:, 2:].T @ found[:2, 2:]
        np.testing.assert_allclose(ahead.covariance, step @ covariance @ step.T + noise, rtol=1e-6)
    else:
        assert ahead.covariance[1, 1] == pytest.approx(0.5 * speed**2)
        assert abs(ahead.mean[1]).max() < 1e-6
    assert ahead.time_s == 4.0 + lasts_s


def test_update():
    """In information form: precisions add, and positions are weighted by them."""
    mean, covariance = np.array([[1.0, 2.0], [0.5, -0.7]]), np.array([[2.0, 0.3], [0.3, 1.0]])
    record = Record(0.0, np.array([3.0, 1.0]), 1.2)
    found = updated(Estimate(0.0, mean, covariance), record)
    side_m = record.error_m * np.sqrt(2)
    seen = np.array([[1.0, 0.0]])
    precision = np.linalg.inv(covariance) + seen.T @ seen / (side_m**2 / 12.0)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-10)
    information = np.linalg.inv(covariance) @ mean + seen.T * record.reported_m / (side_m**2 / 12)
    np.testing.assert_allclose(found.mean, np.linalg.inv(precision) @ information, rtol=1e-10)


def test_crossing_evader_is_met_ahead():
    """An evader that drives straight is met; who drives to reports runs behind it."""
    straight = Wandering(turn_std_rad=0.0)
    times = {}
    for horizon in (1, 40):
        policy = partial(RecedingHorizon, horizon=horizon, plan_step_s=1.0, manoeuvre_s=1e5)
        runs = [pursue(ExactRecords(), straight, seed, policy=policy) for seed in range(8)]
        assert all(each.outcome == "captured" for each in runs)
        times[horizon] = [each.capture_time_s for each in runs]
    assert np.mean(times[40]) < np.mean(times[1])
    for seed, caught_s in enumerate(times[40]):
        # The soonest capture possible: the evader's path within reach plus the radius.
        policy = partial(RecedingHorizon, horizon=1, plan_step_s=1.0, manoeuvre_s=1e5)
        run = pursue(ExactRecords(), straight, seed, policy=policy)
        start, track = run.pursuers[0][0], run.evaders_m[0]
        velocity = (track[1] - track[0]) / run.times_s[1]
        dense_s = np.linspace(0.0, 120.0, 120_001)
        away = np.linalg.norm(track[0] + dense_s[:, None] * velocity - start, axis=1)
        best_s = dense_s[np.argmax(away <= 2.0 * dense_s + 3.0)]
        assert best_s - 1e-3 <= caught_s <= best_s + 1.5
