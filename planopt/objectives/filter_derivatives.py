"""The filter's recursions with exact gradient and Hessian by the path, for solvers.

A value sum_k tr(C_k X_k) of states X_k = f(X_{k-1}, u_k) has, with adjoints Lambda_k and tangents
D_x = dX / dx, the gradient tr(Lambda_k df / du_k) and the Hessian
sum_k tr(Lambda_k d^2 f[D_x, D_y]), D including u_k itself: one pass forwards, one backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.stage_chain import chained
from planopt.objectives.tracking import tracking_reward_derivatives
from planopt.objectives.tracking_filter import (
    FilteredTracking,
    bounding_information,
    covariance_gain,
    with_others,
)
from planopt.targets.information_filter import covariance_of, predicted_information
from planopt.targets.rounding import Derivatives


def information_gain_derivatives(
    chance: Derivatives, sensing: Derivatives, settings: FilteredTracking
) -> PathDerivatives:
    """:func:`planopt.objectives.tracking_filter.information_gain` of one path with derivatives.

    With J-_{k+1} = (A J_k^-1 A' + W)^-1 and G = J- A J^-1: dJ- = G D G', and d^2 J- of D and E is
    -G (D S E + E S D) G', S = J^-1 - G' A J^-1.
    """
    steps, model = len(chance.value), settings.model
    weight = settings.tracking.weight
    # Both coordinates of the position gain this much information.
    received = tracking_reward_derivatives(chance, sensing, np.full(steps, 0.5))
    # With the packets, and without any of its own: both in one pass.
    arrival = np.stack([chance.value, np.zeros(steps)])
    known, without = bounding_information(*with_others(arrival, sensing.value, settings), settings)
    before = np.concatenate([settings.information[None], known[:-1]])
    spread = covariance_of(before)
    pushed = model.transition @ spread
    gain = predicted_information(model, before) @ pushed
    rest = spread - pushed.swapaxes(1, 2) @ gain
    adjoint = np.empty((steps, 4, 4))
    ahead = np.zeros((4, 4))
    for k in range(steps - 1, -1, -1):
        adjoint[k] = weight[k] * np.eye(4) + ahead
        ahead = gain[k].T @ adjoint[k] @ gain[k]
    slope = adjoint[:, 0, 0] + adjoint[:, 1, 1]
    hessian = np.zeros((steps, steps))
    tangent = np.zeros((steps, 4, 4))
    for k in range(steps):
        # Stages up to k - 1 have a say in J_{k-1}.
        now = tangent[:k]
        bent = (gain[k].T @ adjoint[k] @ gain[k]) @ now @ rest[k]
        hessian[:k, :k] -= 2.0 * bent.reshape(k, 16) @ now.reshape(k, 16).T
        tangent[:k] = gain[k] @ now @ gain[k].T
        tangent[k, 0, 0] = tangent[k, 1, 1] = 1.0
    value = float(weight @ np.trace(known - without, axis1=1, axis2=2))
    hessian = 0.5 * (hessian + hessian.T)
    return chained(value, slope[:, None], hessian[:, None, :, None], [received])


def covariance_gain_derivatives(
    chance: Derivatives, sensing: Derivatives, settings: FilteredTracking
) -> PathDerivatives:
    """:func:`planopt.objectives.tracking_filter.covariance_gain` of one path with derivatives.

    With n the variance of a coordinate, E = H P- H' + n I, K = P- H' E^-1 and F = I - K H, the
    update is P+ = P- - p K H P-, and R = P- - K H P- has dR = F D F' + K K' dn. Parameters as
    :func:`information_gain_derivatives`.
    """
    steps, model, weight = len(chance.value), settings.model, settings.tracking.weight
    transition, noise = model.transition, model.process_covariance
    variance = _noise(sensing)
    spread = covariance_of(settings.information)
    seen = np.empty((steps, 4, 4))
    gains, innovations = np.empty((steps, 4, 2)), np.empty((steps, 2, 2))
    theirs: list[list[_Update]] = [[] for _ in range(steps)]
    others = np.zeros((2, steps, 0)) if settings.others is None else settings.others
    for k in range(steps):
        spread = transition @ spread @ transition.T + noise
        # The other robots' packets first: they do not depend on the path.
        for robot in range(others.shape[2]):
            arrives, told = float(others[0, k, robot]), float(others[1, k, robot])
            update = _update(spread, arrives, told)
            theirs[k].append(update)
            spread = spread - arrives * update.gain @ spread[:2]
        seen[k] = spread
        innovations[k] = np.linalg.inv(spread[:2, :2] + variance.value[k] * np.eye(2))
        gains[k] = spread[:, :2] @ innovations[k]
        spread = spread - chance.value[k] * gains[k] @ spread[:2]
    kept = np.tile(np.eye(4), (steps, 1, 1))
    kept[:, :, :2] -= gains
    p = chance.value
    adjoint = np.empty((steps, 4, 4))
    ahead = np.zeros((4, 4))
    for k in range(steps - 1, -1, -1):
        adjoint[k] = ahead
        adjoint[k, [0, 1], [0, 1]] += weight[k]
        own = (1.0 - p[k]) * adjoint[k] + p[k] * kept[k].T @ adjoint[k] @ kept[k]
        for update in reversed(theirs[k]):
            update.adjoint[:] = own
            own = update.pulled_back(own)
        ahead = transition.T @ own @ transition

    gradient = np.empty((steps, 2))
    # Inputs: p_1, n_1, p_2, n_2, ...
    hessian = np.zeros((2 * steps, 2 * steps))
    tangent = np.zeros((2 * steps, 4, 4))
    for k in range(steps):
        K, inner, F, L = gains[k], innovations[k], kept[k], adjoint[k]
        removed, doubt = K @ seen[k][:2], K @ K.T
        gradient[k] = -np.sum(L * removed), p[k] * np.sum(L * doubt)
        before = slice(0, 2 * k)
        now = transition @ tangent[before] @ transition.T
        for update in theirs[k]:
            hessian[before, before] -= update.curvature(now)
            now = update.pushed(now)
        flat = now.reshape(2 * k, 16)
        weighed = F.T @ L @ F
        middle = np.zeros((4, 4))
        middle[:2, :2] = inner
        hessian[before, before] -= 2.0 * p[k] * (weighed @ now @ middle).reshape(2 * k, 16) @ flat.T
        by_chance = flat @ (weighed - L).ravel()
        pull = np.zeros((4, 4))
        pull[:, :2] = F.T @ L @ K @ inner
        by_noise = p[k] * flat @ (pull + pull.T).ravel()
        hessian[before, 2 * k] = hessian[2 * k, before] = by_chance
        hessian[before, 2 * k + 1] = hessian[2 * k + 1, before] = by_noise
        hessian[2 * k, 2 * k + 1] = hessian[2 * k + 1, 2 * k] = np.sum(L * doubt)
        hessian[2 * k + 1, 2 * k + 1] = -2.0 * p[k] * np.sum(L * (K @ inner @ K.T))
        tangent[before] = (1.0 - p[k]) * now + p[k] * F @ now @ F.T
        tangent[2 * k], tangent[2 * k + 1] = -removed, p[k] * doubt
    value = float(covariance_gain(chance.value, sensing.value, settings))
    hessian = 0.5 * (hessian + hessian.T)
    # The gain is what the covariance is less.
    return chained(value, -gradient, -hessian.reshape(steps, 2, steps, 2), [chance, variance])


@dataclass(frozen=True, eq=False)
class _Update:
    """The packet of another robot: P+ = P - p K H P, with F = I - K H and E = H P H' + n I.

    `adjoint` is the derivative of the value by P+, filled in on the way back.
    """

    chance: float
    gain: NDArray[np.float64]
    kept: NDArray[np.float64]
    innovation: NDArray[np.float64]
    adjoint: NDArray[np.float64]

    def pushed(self, tangent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives of P+ from those of P, (..., 4, 4)."""
        return (1.0 - self.chance) * tangent + self.chance * self.kept @ tangent @ self.kept.T

    def pulled_back(self, adjoint: NDArray[np.float64]) -> NDArray[np.float64]:
        """The derivative of the value by P from that by P+."""
        return (1.0 - self.chance) * adjoint + self.chance * self.kept.T @ adjoint @ self.kept

    def curvature(self, tangent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Minus the second derivatives of the value by this update, along tangents (m, 4, 4)."""
        middle = np.zeros((4, 4))
        middle[:2, :2] = self.innovation
        weighed = self.kept.T @ self.adjoint @ self.kept
        flat = tangent.reshape(len(tangent), 16)
        bent = (weighed @ tangent @ middle).reshape(len(tangent), 16)
        return 2.0 * self.chance * bent @ flat.T


def _update(spread: NDArray[np.float64], chance: float, told: float) -> _Update:
    """The update of `spread` by a packet of tr Lambda^-1 `told`."""
    innovation = np.asarray(
        np.linalg.inv(spread[:2, :2] + 2.0 / told * np.eye(2)), dtype=np.float64
    )
    gain = spread[:, :2] @ innovation
    kept = np.eye(4)
    kept[:, :2] -= gain
    return _Update(chance, gain, kept, innovation, np.empty((4, 4)))


def _noise(sensing: Derivatives) -> Derivatives:
    """The variance of a measured coordinate, 2 / tr Lambda^-1, with derivatives."""
    value = 2.0 / sensing.value
    first = -value / sensing.value
    along, across = sensing.gradient.T
    products = np.stack([along * along, along * across, across * across], axis=1)
    return Derivatives(
        value,
        first[:, None] * sensing.gradient,
        first[:, None] * (sensing.hessian - (2.0 / sensing.value)[:, None] * products),
    )
