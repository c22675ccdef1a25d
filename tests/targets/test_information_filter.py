"""The target, and the filter against FilterPy, dense formulas and least squares."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from refusals import refused

from planopt import InputError
from planopt.targets.information_filter import (
    InformationState,
    Sensor,
    TargetModel,
    information_state,
    noise_covariance_m2,
    predict,
    predict_target,
    predicted_information,
    sense,
    simulate_target,
    update,
)

MODEL = TargetModel(0.5, np.array([[0.02, 0.005], [0.005, 0.01]]))
SENSOR = Sensor(0.008, 0.08, 1.0)
MEAN, COVARIANCE = np.array([1.0, 2.0, 0.4, -0.3]), np.diag([1.0, 1.0, 0.1, 0.1])
ROBOTS = np.array([[0.0, 0.0], [4.0, 5.0], [9.0, -3.0]])


def packets(steps, share, seed=0):
    """What three standing robots measure of one target, and which packets arrive."""
    generator = np.random.default_rng(seed)
    states = simulate_target(MODEL, MEAN, steps, generator)[1:]
    measured = np.array([sense(SENSOR, ROBOTS, state[:2], generator) for state in states])
    noise = np.array([noise_covariance_m2(SENSOR, ROBOTS, state[:2]) for state in states])
    return measured, noise, generator.random((steps, 3)) < share


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_equals_filterpy_with_missing_measurements(share):
    """Mean and covariance to 1e-10 over 40 steps; robots one after the other there."""
    reference = KalmanFilter(dim_x=4, dim_z=2)
    reference.x, reference.P = MEAN[:, None].copy(), COVARIANCE.copy()
    reference.F, reference.Q = MODEL.transition, MODEL.process_covariance
    reference.H = np.eye(2, 4)
    state = information_state(MEAN, COVARIANCE)
    for measured, noise, arrived in zip(*packets(40, share), strict=True):
        reference.predict()
        for robot in range(3):
            reference.update(measured[robot] if arrived[robot] else None, R=noise[robot])
        state = update(predict(MODEL, state), measured, noise, arrived)
        np.testing.assert_allclose(state.mean, reference.x[:, 0], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(state.covariance, reference.P, rtol=1e-10, atol=1e-10)


@pytest.mark.filterwarnings("ignore")  # Theirs.
def test_equals_stone_soup_with_missing_measurements():
    """Its information filter, where it is installed: information matrix and vector."""
    pytest.importorskip("stonesoup", reason="Stone Soup is not installed")
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor.information import InformationKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import InformationStatePrediction
    from stonesoup.types.state import InformationState as TheirState
    from stonesoup.updater.information import InformationKalmanUpdater

    motion = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=MODEL.transition, covariance_matrix=MODEL.process_covariance
    )
    predictor = InformationKalmanPredictor(motion)
    state, start = information_state(MEAN, COVARIANCE), datetime(2026, 1, 1)
    theirs = TheirState(state.vector[:, None], state.matrix, timestamp=start)
    arrivals = 0
    for step, (measured, noise, arrived) in enumerate(zip(*packets(40, 0.3), strict=True), 1):
        now = start + timedelta(seconds=step * MODEL.step_s)
        theirs = predictor.predict(theirs, timestamp=now)
        for robot in np.flatnonzero(arrived):
            model = LinearGaussian(4, (0, 1), noise[robot])
            seen = Detection(measured[robot][:, None], timestamp=now, measurement_model=model)
            updater = InformationKalmanUpdater(measurement_model=model)
            found = updater.update(SingleHypothesis(theirs, seen))
            # What is known after one robot's packet is what the next one's is added to.
            theirs = InformationStatePrediction(found.state_vector, found.precision, now)
            arrivals += 1
        state = update(predict(MODEL, state), measured, noise, arrived)
        np.testing.assert_allclose(state.matrix, theirs.precision, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(
            state.vector, np.ravel(theirs.state_vector), rtol=1e-7, atol=1e-7
        )
    assert arrivals > 20


def test_prediction_is_written_out():
    """J- = (A J^-1 A' + B Theta B')^-1 and chi- = J- A J^-1 chi, written out."""
    state = information_state(MEAN, COVARIANCE + 0.05)
    spread = np.linalg.inv(state.matrix)
    expected = np.linalg.inv(
        MODEL.transition @ spread @ MODEL.transition.T + MODEL.process_covariance
    )
    found = predict(MODEL, state)
    np.testing.assert_allclose(found.matrix, expected, rtol=1e-11)
    np.testing.assert_allclose(
        found.vector, expected @ MODEL.transition @ spread @ state.vector, rtol=1e-11
    )
    batch = predicted_information(MODEL, np.stack([state.matrix, 2.0 * state.matrix]))
    np.testing.assert_allclose(batch[0], expected, rtol=1e-11)


def test_a_lost_packet_is_not_read():
    """NaN where nothing arrived changes nothing; a delivered one is refused."""
    measured, noise, _ = packets(1, 1.0)
    state = predict(MODEL, information_state(MEAN, COVARIANCE))
    arrived = np.array([True, False, True])
    torn = measured[0].copy()
    torn[1] = np.nan
    np.testing.assert_array_equal(
        update(state, torn, noise[0], arrived).vector,
        update(state, measured[0], noise[0], arrived).vector,
    )
    with refused():
        update(state, torn, noise[0], np.ones(3, dtype=bool))


def test_from_nothing_it_is_least_squares():
    """A zero information matrix is a start; after packets it equals weighted least squares."""
    still = TargetModel(0.5, np.zeros((2, 2)))
    measured, noise, _ = packets(4, 1.0)
    arrived = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 1], [1, 0, 0]], dtype=bool)
    state = InformationState(np.zeros(4), np.zeros((4, 4)))
    with refused():
        _ = state.mean
    rows, values, weights = [], [], []
    for k in range(4):
        state = update(predict(still, state), measured[k], noise[k], arrived[k])
        # The state at the last step, k = 3, seen from step k.
        back = np.hstack([np.eye(2), (k - 3) * 0.5 * np.eye(2)])
        for robot in np.flatnonzero(arrived[k]):
            rows.append(back)
            values.append(measured[k, robot])
            weights.append(np.linalg.inv(noise[k, robot]))
    information = sum(row.T @ w @ row for row, w in zip(rows, weights, strict=True))
    vector = sum(r.T @ w @ z for r, w, z in zip(rows, weights, values, strict=True))
    np.testing.assert_allclose(state.matrix, information, rtol=1e-11)
    np.testing.assert_allclose(state.mean, np.linalg.solve(information, vector), rtol=1e-10)


def test_enormous_accelerations_cancel_nothing():
    """Joseph's form: with Theta a billion times too large J- stays positive semidefinite."""
    wild = TargetModel(1.0, 1e9 * np.eye(2))
    matrix = predicted_information(wild, np.linalg.inv(COVARIANCE))
    assert np.linalg.eigvalsh(matrix)[0] >= -1e-15


MOVING = TargetModel(0.5, np.array([[0.3, 0.1], [0.1, 0.2]]))
ORIGIN = np.array([1.0, 2.0, -0.4, 0.8])


def test_simulation_has_the_predicted_moments():
    """Mean and covariance after 6 steps of 4,000 targets, within 5 standard errors."""
    generator = np.random.default_rng(0)
    ends = np.array([simulate_target(MOVING, ORIGIN, 6, generator)[-1] for _ in range(4000)])
    expected = predict_target(MOVING, ORIGIN, np.zeros((4, 4)), 6)
    spread = expected.covariance[-1]
    error = np.sqrt(np.diag(spread) / 4000)
    assert (np.abs(ends.mean(axis=0) - expected.mean[-1]) < 5.0 * error).all()
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    assert (np.abs(np.cov(ends.T) - spread) < 5.0 * scale * np.sqrt(2.0 / 4000)).all()


def test_without_noise_the_target_goes_straight():
    """Theta = 0: position is start plus time times velocity, in simulation and prediction."""
    still = TargetModel(0.5, np.zeros((2, 2)))
    expected = ORIGIN[:2] + 0.5 * np.arange(1, 5)[:, None] * ORIGIN[2:]
    path = simulate_target(still, ORIGIN, 4, np.random.default_rng(0))
    np.testing.assert_allclose(path[1:, :2], expected)
    predicted = predict_target(still, ORIGIN, np.eye(4), 4)
    np.testing.assert_allclose(predicted.positions_m, expected)
    # The variance of a position k steps on: 1 + (k eps)^2.
    growth = 1.0 + (0.5 * np.arange(1, 5)) ** 2
    covariance_m2 = predicted.covariance[:, :2, :2]
    np.testing.assert_allclose(covariance_m2, growth[:, None, None] * np.eye(2), atol=1e-15)


@pytest.mark.parametrize(
    "make",
    [
        lambda: TargetModel(0.0, np.eye(2)),
        lambda: TargetModel(np.nan, np.eye(2)),
        lambda: TargetModel(1.0, np.eye(3)),
        lambda: TargetModel(1.0, -np.eye(2)),
        lambda: TargetModel(1.0, np.array([[1.0, 0.5], [0.0, 1.0]])),
        lambda: TargetModel(1.0, np.full((2, 2), np.nan)),
        lambda: simulate_target(MOVING, ORIGIN[:3], 2, np.random.default_rng(0)),
        lambda: simulate_target(MOVING, ORIGIN * np.inf, 2, np.random.default_rng(0)),
        lambda: simulate_target(MOVING, ORIGIN, -1, np.random.default_rng(0)),
        lambda: predict_target(MOVING, ORIGIN, np.eye(4), 0),
        lambda: predict_target(MOVING, ORIGIN, np.eye(2), 3),
        lambda: information_state(MEAN[:2], COVARIANCE),
        lambda: information_state(MEAN, np.eye(3)),
        lambda: information_state(MEAN, np.diag([1.0, 1.0, 1.0, 0.0])),
        lambda: update(
            information_state(MEAN, COVARIANCE),
            np.zeros((2, 2)),
            np.zeros((3, 2, 2)),
            np.ones(2, bool),
        ),
    ],
)
def test_bad_input_is_ours(make):
    with pytest.raises(InputError):
        make()
