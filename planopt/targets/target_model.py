"""The target that is tracked: constant velocity, pushed about by random acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class TargetModel:
    """The model ``x+ = A x + B w``, ``x = (p, p')``, w of covariance Theta (equation 4.7).

    Attributes
    ----------
    step_s
        epsilon: the time step.
    acceleration_covariance_m2_s4
        ``(2, 2)`` Theta. B Theta B' has rank 2 of 4: it has no inverse.

    Raises
    ------
    InputError
        The step is not positive, or the covariance is none.
    """

    step_s: float
    acceleration_covariance_m2_s4: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.step_s) and self.step_s > 0.0):
            raise InputError(f"{self.step_s!r} is no time step", key="step_s")
        require_covariance(self.acceleration_covariance_m2_s4, 2, "acceleration_covariance_m2_s4")

    @cached_property
    def transition(self) -> NDArray[np.float64]:
        """``(4, 4)`` A."""
        found = np.eye(4)
        found[:2, 2:] = self.step_s * np.eye(2)
        return found

    @cached_property
    def noise_gain(self) -> NDArray[np.float64]:
        """``(4, 2)`` B."""
        return np.vstack([0.5 * self.step_s**2 * np.eye(2), self.step_s * np.eye(2)])

    @cached_property
    def process_covariance(self) -> NDArray[np.float64]:
        """``(4, 4)`` B Theta B'."""
        return self.noise_gain @ self.acceleration_covariance_m2_s4 @ self.noise_gain.T


@dataclass(frozen=True, eq=False)
class TargetPrediction:
    """Where the target is expected, h steps ahead, without further measurements.

    Attributes
    ----------
    mean
        ``(h, 4)`` x_hat_{t+k|t}, k = 1 .. h: metres and metres per second.
    covariance
        ``(h, 4, 4)`` P_{t+k|t}.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """``(h, 2)`` p_hat_{t+k|t}."""
        return self.mean[:, :2]

    @property
    def position_covariance_m2(self) -> NDArray[np.float64]:
        """``(h, 2, 2)``."""
        return self.covariance[:, :2, :2]


def simulate_target(
    model: TargetModel,
    start: NDArray[np.float64],
    steps: int,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """States x_0 .. x_steps of one target; ``(steps + 1, 4)``.

    Parameters
    ----------
    model
        How it moves.
    start
        ``(4,)`` x_0: position in metres, velocity in metres per second.
    steps
        At least 0.
    generator
        Source of the accelerations.

    Raises
    ------
    InputError
        `start` is no state, or `steps` is negative.
    """
    state = require_state(start)
    if steps < 0:
        raise InputError(f"{steps!r} is no number of steps", key="steps")
    # Not a Cholesky factor: Theta may be singular, for a target that is pushed along a line.
    variances, axes = np.linalg.eigh(model.acceleration_covariance_m2_s4)
    spread = model.noise_gain @ (axes * np.sqrt(np.maximum(variances, 0.0)))
    pushes = generator.standard_normal((steps, 2)) @ spread.T
    transition = model.transition
    states = np.empty((steps + 1, 4))
    states[0] = state
    for k in range(steps):
        states[k + 1] = transition @ states[k] + pushes[k]
    return states


def predict_target(
    model: TargetModel, mean: NDArray[np.float64], covariance: NDArray[np.float64], steps: int
) -> TargetPrediction:
    """Predict `steps` >= 1 steps ahead: A^k x_hat, and P+ = A P A' + B Theta B'.

    Parameters
    ----------
    model
        How it moves.
    mean, covariance
        ``(4,)`` x_hat_{t|t} and ``(4, 4)`` P_{t|t}.
    steps
        h.

    Raises
    ------
    InputError
        The estimate is none, or `steps` is below 1.
    """
    state, spread = require_state(mean), require_covariance(covariance, 4, "covariance")
    if steps < 1:
        raise InputError(f"{steps!r} is too few", key="steps", remedy="give at least 1")
    transition, noise = model.transition, model.process_covariance
    means, covariances = np.empty((steps, 4)), np.empty((steps, 4, 4))
    for k in range(steps):
        state = transition @ state
        spread = transition @ spread @ transition.T + noise
        means[k], covariances[k] = state, spread
    return TargetPrediction(means, covariances)


def require_state(state: NDArray[np.float64]) -> NDArray[np.float64]:
    """`state` as four finite floats, or an :class:`planopt.errors.InputError`."""
    found = np.asarray(state, dtype=np.float64)
    if found.shape != (4,) or not np.isfinite(found).all():
        raise InputError("a target's state is x, y in metres and two velocities in m/s, all finite")
    return found


def require_covariance(matrix: NDArray[np.float64], size: int, key: str) -> NDArray[np.float64]:
    """`matrix` as floats if it is a covariance ``(size, size)``, else an InputError."""
    found = np.asarray(matrix, dtype=np.float64)
    if found.shape != (size, size) or not np.isfinite(found).all():
        raise InputError(f"a covariance of shape {found.shape} is not ({size}, {size})", key=key)
    scale = float(np.abs(found).max())
    # Rounding of a computed covariance, not a matrix that is none.
    if np.abs(found - found.T).max() > 1e-9 * scale:
        raise InputError("a covariance is symmetric", key=key)
    if np.linalg.eigvalsh(found)[0] < -1e-9 * scale:
        raise InputError("the matrix has a negative eigenvalue: it is no covariance", key=key)
    return found
