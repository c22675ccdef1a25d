"""Target motion, robot sensors, and the information filter of the base station with lost packets.

The prediction inverts neither J, which may be singular, nor B Theta B', which always is. [GM11]
specifies ``tr Phi^-1 = 1 / g(r)`` of the measurement noise but not Phi. Here Phi = 2 g I_2, which
has this trace: the noise is isotropic, and g is half the variance per axis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planopt.arrays import Derivatives, Floats, Mask, radial, rounded_radius
from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class TargetModel:
    """Motion model of a target with normally distributed acceleration (equation 4.7)."""

    step_s: float  # epsilon: the time step
    acceleration_covariance_m2_s4: Floats  # (2, 2) Theta; B Theta B' is singular, of rank 2

    def __post_init__(self) -> None:
        if not (np.isfinite(self.step_s) and self.step_s > 0.0):
            raise InputError(
                f"is {self.step_s!r}, should be a time step in seconds above 0", key="step_s"
            )
        require_covariance(self.acceleration_covariance_m2_s4, 2, "acceleration_covariance_m2_s4")

    @cached_property
    def transition(self) -> Floats:
        """``(4, 4)`` transition matrix of position and velocity over a step."""
        found = np.eye(4)
        found[:2, 2:] = self.step_s * np.eye(2)
        return found

    @cached_property
    def noise_gain(self) -> Floats:
        """``(4, 2)`` gain from acceleration to position and velocity."""
        return np.vstack([0.5 * self.step_s**2 * np.eye(2), self.step_s * np.eye(2)])

    @cached_property
    def process_covariance(self) -> Floats:
        """``(4, 4)`` covariance of the process noise of a step."""
        return self.noise_gain @ self.acceleration_covariance_m2_s4 @ self.noise_gain.T


@dataclass(frozen=True, eq=False)
class TargetPrediction:
    """Prediction of the target over h steps without further measurements."""

    mean: Floats  # (h, 4) x_hat_{t+k|t}, k = 1 .. h: metres and metres per second.
    covariance: Floats  # (h, 4, 4) P_{t+k|t}

    @property
    def positions_m(self) -> Floats:
        """``(h, 2)`` predicted positions of the target."""
        return self.mean[:, :2]


def simulate_target(
    model: TargetModel, start: Floats, steps: int, generator: np.random.Generator
) -> Floats:
    """Return the simulated states (steps + 1, 4) of one target, the start included."""
    # Shapes: start (4,), x_0: position in metres, velocity in metres per second.
    state = require_state(start)
    if steps < 0:
        raise InputError(f"is {steps!r}, should be a number of steps of at least 0", key="steps")
    # For acceleration along a line, Theta is singular and has no Cholesky factor.
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
    model: TargetModel, mean: Floats, covariance: Floats, steps: int
) -> TargetPrediction:
    """Return the prediction of a target over `steps` >= 1 steps without measurements."""
    # Shapes: mean (4,); covariance (4, 4).
    state, spread = require_state(mean), require_covariance(covariance, 4, "covariance")
    if steps < 1:
        raise InputError(
            f"is {steps!r}, should be at least 1",
            key="steps",
            remedy="give a whole number of steps",
        )
    transition, noise = model.transition, model.process_covariance
    means, covariances = np.empty((steps, 4)), np.empty((steps, 4, 4))
    for k in range(steps):
        state = transition @ state
        spread = transition @ spread @ transition.T + noise
        means[k], covariances[k] = state, spread
    return TargetPrediction(means, covariances)


def require_state(state: Floats) -> Floats:
    """Return `state` as four finite floats, or raise an :class:`planopt.errors.InputError`."""
    found = np.asarray(state, dtype=np.float64)
    if found.shape != (4,) or not np.isfinite(found).all():
        raise InputError(
            "the state of a target must have four finite numbers: x and y in m, "
            "and both velocities in m/s"
        )
    return found


def require_covariance(matrix: Floats, size: int, key: str) -> Floats:
    """Return `matrix` as a covariance ``(size, size)`` of floats, or raise an InputError."""
    found = np.asarray(matrix, dtype=np.float64)
    if found.shape != (size, size) or not np.isfinite(found).all():
        raise InputError(f"has shape {found.shape}, should have shape ({size}, {size})", key=key)
    scale = float(np.abs(found).max())
    # The tolerance admits rounding errors of a computed covariance.
    if np.abs(found - found.T).max() > 1e-9 * scale:
        raise InputError("is not symmetric, which a covariance must be", key=key)
    if np.linalg.eigvalsh(found)[0] < -1e-9 * scale:
        raise InputError("has a negative eigenvalue, which a covariance must not have", key=key)
    return found


@dataclass(frozen=True, eq=False)
class InformationState:
    """Target estimate in information form (equation 4.9)."""

    vector: Floats  # (4,) chi = J x_hat
    matrix: Floats  # (4, 4) J = P^-1; zero without prior knowledge

    @property
    def mean(self) -> Floats:
        """``(4,)`` estimated state; raises an InputError while the information is singular."""
        return self.covariance @ self.vector

    @property
    def covariance(self) -> Floats:
        """``(4, 4)`` covariance; raises an InputError while the information is singular."""
        return covariance_of(self.matrix)


def information_state(mean: Floats, covariance: Floats) -> InformationState:
    """Return the information form of mean ``(4,)`` and invertible covariance ``(4, 4)``."""
    state, spread = require_state(mean), require_covariance(covariance, 4, "covariance")
    matrix = covariance_of(spread)
    return InformationState(matrix @ state, matrix)


def predict(model: TargetModel, state: InformationState) -> InformationState:
    """Return the information state predicted for one step ahead."""
    # chi_{t+1|t} = J_{t+1|t} A J^-1 chi = (I - K B') A^-T chi, K as in `predicted_information`.
    _, gain, _ = _moved(model, state.matrix)
    vector = np.linalg.solve(model.transition.T, state.vector)
    return InformationState(
        vector - gain @ (model.noise_gain.T @ vector), predicted_information(model, state.matrix)
    )


def predicted_information(model: TargetModel, matrix: Floats) -> Floats:
    """Return the information predicted one step ahead from matrices (..., 4, 4)."""
    # With M = A^-T J A^-1, T = (I + B' M B Theta)^-1 and K = M B Theta T, it is computed as (I - K
    # B') M (I - K B')' + M B T' Theta T B' M (matrix inversion lemma in Joseph form). Both terms
    # are positive semidefinite, so there is no cancellation.
    moved, gain, inner = _moved(model, matrix)
    rest = np.eye(4) - gain @ model.noise_gain.T
    pushed = moved @ model.noise_gain @ np.swapaxes(inner, -1, -2)
    found = rest @ moved @ np.swapaxes(rest, -1, -2)
    found += pushed @ model.acceleration_covariance_m2_s4 @ np.swapaxes(pushed, -1, -2)
    return 0.5 * (found + np.swapaxes(found, -1, -2))


def update(
    state: InformationState, measured_m: Floats, noise_covariance_m2: Floats, delivered: Mask
) -> InformationState:
    """Return the state after adding the information of the delivered packets."""
    # Shapes: measured_m (n, 2); noise_covariance_m2 (n, 2, 2), Lambda_i; delivered (n,), lambda_i.
    count = len(delivered)
    if measured_m.shape != (count, 2) or noise_covariance_m2.shape != (count, 2, 2):
        raise InputError(
            f"the arrays of the packets do not match: their shapes are {measured_m.shape}, "
            f"{noise_covariance_m2.shape} and {delivered.shape}",
            remedy="give measured_m (n, 2), noise_covariance_m2 (n, 2, 2) and delivered (n,)",
        )
    arrived = np.asarray(delivered, dtype=np.bool_)
    values = measured_m[arrived]
    if not np.isfinite(values).all():
        raise InputError("has a delivered measurement that is NaN or infinite", key="measured_m")
    each = np.asarray(np.linalg.inv(noise_covariance_m2[arrived]), dtype=np.float64)
    vector, matrix = state.vector.copy(), state.matrix.copy()
    vector[:2] += np.einsum("nij,nj->i", each, values)
    matrix[:2, :2] += each.sum(axis=0)
    return InformationState(vector, matrix)


def covariance_of(matrix: Floats) -> Floats:
    """Return the inverse of information matrices ``(..., 4, 4)``, or raise an InputError."""
    smallest = np.linalg.eigvalsh(matrix)[..., 0]
    largest = np.abs(matrix).max(axis=(-1, -2))
    # Below this ratio, rounding errors determine the inverse.
    if not (smallest > 1e-15 * largest).all():
        raise InputError(
            "the estimate is undefined: the information matrix is singular",
            remedy="give a prior, or wait until measurements of two steps have arrived",
        )
    found = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return 0.5 * (found + np.swapaxes(found, -1, -2))


def position_variance_m2(matrix: Floats) -> Floats:
    """Return the trace of the position covariance for information matrices (..., 4, 4)."""
    covariance = covariance_of(matrix)
    return covariance[..., 0, 0] + covariance[..., 1, 1]


def _moved(model: TargetModel, matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the information M after a step without process noise, and the factors K and T."""
    # Shapes: matrix, M (..., 4, 4); K (..., 4, 2); T (..., 2, 2).
    back = model.transition.copy()
    back[:2, 2:] *= -1.0
    moved = back.T @ matrix @ back
    noise_gain, theta = model.noise_gain, model.acceleration_covariance_m2_s4
    seen = noise_gain.T @ moved @ noise_gain
    inner = np.asarray(np.linalg.inv(np.eye(2) + seen @ theta), dtype=np.float64)
    return moved, moved @ noise_gain @ theta @ inner, inner


CUSP_SHARE = 0.1
"""Radius within which the cusp at the target is smoothed, as a share of `sweet_spot_m`."""


@dataclass(frozen=True)
class Sensor:
    """Sensor whose noise grows with the squared distance from a sweet spot (equation 4.8)."""

    growth: float  # varpi > 0: growth of the noise away from the sweet spot, m^2 per m^2
    least_noise_m2: float  # nu > 0: g at the sweet spot r_s
    sweet_spot_m: float  # r_s >= 0: distance to the target with the least noise

    def __post_init__(self) -> None:
        for key in ("growth", "least_noise_m2", "sweet_spot_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and (value > 0.0 or (value, key) == (0.0, "sweet_spot_m"))):
                raise InputError(
                    f"is {value!r}, which is out of range", key=key, remedy="give a number above 0"
                )


def sensing_information(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Floats:
    """Return the information 1 / g of a packet in 1/m^2, with g the sensor's noise in m^2."""
    # Shapes: positions_m (..., 2); target_m (..., 2).
    # Computed in place, because searches evaluate all reachable nodes at every step.
    found = np.asarray(positions_m[..., 0] - target_m[..., 0])
    found *= found
    across = np.asarray(positions_m[..., 1] - target_m[..., 1])
    across *= across
    found += across
    found = np.sqrt(found)
    found -= sensor.sweet_spot_m
    found *= found
    found *= sensor.growth
    found += sensor.least_noise_m2
    return 1.0 / found


def noise_covariance_m2(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Floats:
    """Return the isotropic noise covariance (..., 2, 2) of a target measurement."""
    information = sensing_information(sensor, positions_m, target_m)
    return (2.0 / information)[..., None, None] * np.eye(2)


def sense(
    sensor: Sensor, positions_m: Floats, target_m: Floats, generator: np.random.Generator
) -> Floats:
    """Draw a target measurement for each robot, with the sensor's noise at the robot's distance."""
    # Shapes: positions_m (n, 2), positions of the robots; target_m (2,), position of the target.
    deviation = np.sqrt(2.0 / sensing_information(sensor, positions_m, target_m))
    return target_m + deviation[:, None] * generator.standard_normal(positions_m.shape)


def sensing_derivatives(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Derivatives:
    """Return the information of a packet, with gradient and Hessian w.r.t. robot positions."""
    # The result is exact at distances of at least `CUSP_SHARE` r_s from the target. At smaller
    # distances it uses the smoothed distance of `planopt.arrays`; g is then too
    # small by at most 3/4 `CUSP_SHARE` varpi r_s^2.
    offset = positions_m - target_m
    sweet = sensor.sweet_spot_m
    square = np.einsum("...i,...i->...", offset, offset)
    # If r_s = 0, g has no cusp and the factor of the length below is zero.
    width = CUSP_SHARE * sweet if sweet > 0.0 else 1.0
    length, slope, bend = rounded_radius(np.sqrt(square), width)
    growth = 2.0 * sensor.growth
    loss = growth * (0.5 * square - sweet * length + 0.5 * sweet**2) + sensor.least_noise_m2
    information = 1.0 / loss
    # Slope and bend of g, then of 1 / g.
    steep, bent = growth - (growth * sweet) * slope, (-growth * sweet) * bend
    falling = -information * information
    slope = falling * steep
    bend = falling * bent - 2.0 * slope * steep * information
    return radial(offset, information, slope, bend)
