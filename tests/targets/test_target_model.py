"""The constant-velocity target: matrices by hand, statistics of simulation, prediction."""

import numpy as np
import pytest

from planopt import InputError
from planopt.targets.information_filter import TargetModel, predict_target, simulate_target

MODEL = TargetModel(0.5, np.array([[0.3, 0.1], [0.1, 0.2]]))
START = np.array([1.0, 2.0, -0.4, 0.8])


def test_matrices_are_the_seeds():
    """A, B and the rank of the process noise."""
    np.testing.assert_array_equal(
        MODEL.transition, [[1, 0, 0.5, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    np.testing.assert_array_equal(MODEL.noise_gain, [[0.125, 0], [0, 0.125], [0.5, 0], [0, 0.5]])
    assert np.linalg.matrix_rank(MODEL.process_covariance) == 2
    np.testing.assert_allclose(
        MODEL.process_covariance[2:, 2:], 0.25 * np.array([[0.3, 0.1], [0.1, 0.2]])
    )


def test_simulation_has_the_predicted_moments():
    """Mean and covariance after 6 steps of 4,000 targets, within 5 standard errors."""
    generator = np.random.default_rng(0)
    ends = np.array([simulate_target(MODEL, START, 6, generator)[-1] for _ in range(4000)])
    expected = predict_target(MODEL, START, np.zeros((4, 4)), 6)
    spread = expected.covariance[-1]
    error = np.sqrt(np.diag(spread) / 4000)
    assert (np.abs(ends.mean(axis=0) - expected.mean[-1]) < 5.0 * error).all()
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    assert (np.abs(np.cov(ends.T) - spread) < 5.0 * scale * np.sqrt(2.0 / 4000)).all()


def test_without_noise_the_target_goes_straight():
    """Theta = 0: position is start plus time times velocity, in simulation and prediction."""
    still = TargetModel(0.5, np.zeros((2, 2)))
    expected = START[:2] + 0.5 * np.arange(1, 5)[:, None] * START[2:]
    path = simulate_target(still, START, 4, np.random.default_rng(0))
    np.testing.assert_allclose(path[1:, :2], expected)
    predicted = predict_target(still, START, np.eye(4), 4)
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
        lambda: simulate_target(MODEL, START[:3], 2, np.random.default_rng(0)),
        lambda: simulate_target(MODEL, START * np.inf, 2, np.random.default_rng(0)),
        lambda: simulate_target(MODEL, START, -1, np.random.default_rng(0)),
        lambda: predict_target(MODEL, START, np.eye(4), 0),
        lambda: predict_target(MODEL, START, np.eye(2), 3),
    ],
)
def test_bad_input_is_ours(make):
    """Every check raises InputError."""
    with pytest.raises(InputError):
        make()
