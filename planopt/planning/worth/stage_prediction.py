"""Predicted power and deviation of every stage with exact derivatives, all stages at once.

From the measurements nearest to each stage (design 4.1) and with the uncertainty of theta counted.
Two things differ from the exact posterior, both only here: the kernel's cusp at a measured position
is rounded (:mod:`planopt.objectives.rounded_kernel`), and fewer measurements are used. The verifier
uses neither.

A solver asks some twenty times a step. Kernel values and derivatives of all stages are therefore
one array, which two products with matrices prepared once turn into everything else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.neighbours import NeighbourModel
from planopt.objectives.rounded_kernel import rounded_kernel, rounded_log_distance
from planopt.targets.rounding import Derivatives


class StagePredictor:
    """Predicts stage k from `model`'s k-th neighbour set, again and again.

    With g = (1, gamma) path loss's regressors, phi the covariances with the m measurements and
    A = trend, the variance ``xi^2 + omega^2 - phi' P phi + b' M b``, b = g - A' phi, is expanded to
    ``xi^2 + omega^2 + g' M g - 2 g' M A' phi - phi' (P - A M A') phi``: one quadratic form, and
    linear ones.

    Parameters
    ----------
    model
        Neighbour sets of the n stages. Not to be changed afterwards.
    """

    def __init__(self, model: NeighbourModel) -> None:
        self._model = model
        n, m = model.weights.shape
        along = model.trend @ model.theta_covariance  # A M, (n, m, 2)
        self._quadratic = model.precision - along @ model.trend.swapaxes(1, 2)
        # Rows: weights of the mean, both columns of A M, and phi' times the quadratic form.
        self._linear = np.empty((n, 4, m))
        self._linear[:, 0] = model.weights - model.trend @ model.theta
        self._linear[:, 1:3] = along.swapaxes(1, 2)
        self._kernel = np.empty((n, 6, m))

    def __call__(self, positions_m: NDArray[np.float64]) -> tuple[Derivatives, Derivatives]:
        """Mean and deviation of stage k at ``positions_m[k]``, (n, 2)."""
        model = self._model
        parameters, m_theta = model.parameters, model.theta_covariance
        kernel, linear = self._kernel, self._linear
        near = rounded_kernel(positions_m[:, None] - model.positions_m, parameters, model.blur_m2)
        kernel[:, 0] = near.value
        kernel[:, 1:3] = near.gradient.swapaxes(1, 2)
        kernel[:, 3:] = near.hessian.swapaxes(1, 2)
        half = kernel[:, :3] @ self._quadratic
        linear[:, 3] = half[:, 0]
        # By kind of derivative and row of `linear`: value, x, y, xx, xy, yy.
        products = kernel @ linear.swapaxes(1, 2)
        crossed = half[:, 1:] @ kernel[:, 1:3].swapaxes(1, 2)
        gamma = _joined(rounded_log_distance(positions_m, parameters.station))

        mean = products[:, :, 0] + model.theta[1] * gamma
        mean[:, 0] += model.theta[0]
        u0, u1, q = products[:, :, 1], products[:, :, 2], products[:, :, 3]
        g, gamma1, u1_1 = gamma[:, 0], gamma[:, 1:3], u1[:, 1:3]
        pull = m_theta[0, 1] + m_theta[1, 1] * g - u1[:, 0]
        # Half of the variance and of its derivatives.
        s = gamma * pull[:, None] - q - u0 - g[:, None] * u1
        s[:, 3:5] -= crossed[:, 0]
        s[:, 5] -= crossed[:, 1, 1]
        _add_products(s[:, 3:], gamma1, 0.5 * m_theta[1, 1] * gamma1 - u1_1)
        variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2 - q[:, 0]
        variance += m_theta[0, 0] + g * (2.0 * m_theta[0, 1] + g * m_theta[1, 1])
        variance -= 2.0 * (u0[:, 0] + g * u1[:, 0])

        deviation = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        s /= deviation[:, None]
        d1, d2 = s[:, 1:3], s[:, 3:]
        _add_products(d2, d1, d1 * (-0.5 / deviation)[:, None])
        return _split(mean), Derivatives(deviation, d1, d2)


def stage_prediction(
    model: NeighbourModel, positions_m: NDArray[np.float64]
) -> tuple[Derivatives, Derivatives]:
    """:class:`StagePredictor` for a single evaluation at ``positions_m`` (n, 2)."""
    return StagePredictor(model)(positions_m)


def _add_products(
    hessian: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> None:
    """Add a b' + b a' to `hessian` (n, 3); `a` and `b` are (n, 2)."""
    crossed = a[:, :, None] * b[:, None]
    hessian[:, 0] += 2.0 * crossed[:, 0, 0]
    hessian[:, 1] += crossed[:, 0, 1] + crossed[:, 1, 0]
    hessian[:, 2] += 2.0 * crossed[:, 1, 1]


def _joined(parts: Derivatives) -> NDArray[np.float64]:
    """Value, gradient and Hessian in one array, (n, 6)."""
    return np.concatenate([parts.value[:, None], parts.gradient, parts.hessian], axis=1)


def _split(parts: NDArray[np.float64]) -> Derivatives:
    return Derivatives(parts[:, 0], parts[:, 1:3], parts[:, 3:])
