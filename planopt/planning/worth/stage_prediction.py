"""Predicted power and deviation of every stage with exact derivatives, all stages at once.

From the measurements nearest to each stage and with the uncertainty of theta counted.
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
from planopt.objectives.rounded_kernel import (
    fill_rounded_kernel,
    rounded_log_distance,
    softened_m2,
)
from planopt.targets.rounding import Derivatives

LEAST_VARIANCE_DB2 = float(np.finfo(float).tiny)
"""Rounding alone can leave none."""


class StagePredictor:
    """Predicts stage k from `model`'s k-th neighbour set, again and again.

    With phi the covariances with the m measurements, g = (1, gamma) path loss's regressors, A =
    trend and f = (phi, g), the mean is ``w' f`` and the variance ``xi^2 + omega^2 - phi' P phi +
    b' M b``, b = g - A' phi, is ``xi^2 + omega^2 - f' Q f``: one linear form and one quadratic.

    Parameters
    ----------
    model
        Neighbour sets of the n stages. Not to be changed afterwards.
    """

    def __init__(self, model: NeighbourModel) -> None:
        self._model = model
        n, m = model.weights.shape
        along = model.trend @ model.theta_covariance  # A M, (n, m, 2)
        self._quadratic = np.empty((n, m + 2, m + 2))
        self._quadratic[:, :m, :m] = model.precision - along @ model.trend.swapaxes(1, 2)
        self._quadratic[:, :m, m:] = along
        self._quadratic[:, m:, :m] = along.swapaxes(1, 2)
        self._quadratic[:, m:, m:] = -model.theta_covariance
        self._linear = np.empty((n, m + 2, 1))
        self._linear[:, :m, 0] = model.weights - model.trend @ model.theta
        self._linear[:, m:, 0] = model.theta
        # f by derivative: value, x, y, xx, xy, yy.
        self._f = np.zeros((n, 6, m + 2))
        self._f[:, 0, m] = 1.0
        self._kernel = self._f[:, :, :m].swapaxes(0, 1)
        self._x_m = np.ascontiguousarray(model.positions_m[:, :, 0])
        self._y_m = np.ascontiguousarray(model.positions_m[:, :, 1])
        self._soft_m2 = softened_m2(model.blur_m2, model.parameters)

    def __call__(self, positions_m: NDArray[np.float64]) -> tuple[Derivatives, Derivatives]:
        """Mean and deviation of stage k at ``positions_m[k]``, (n, 2)."""
        f, parameters = self._f, self._model.parameters
        fill_rounded_kernel(
            self._kernel,
            positions_m[:, :1] - self._x_m,
            positions_m[:, 1:] - self._y_m,
            parameters,
            self._soft_m2,
        )
        f[:, :, -1] = rounded_log_distance(positions_m, parameters.station).rows
        mean = (f @ self._linear)[:, :, 0]
        # Of f, f_x and f_y with all six.
        forms = (f[:, :3] @ self._quadratic) @ f.swapaxes(1, 2)
        variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2 - forms[:, 0, 0]
        deviation = np.sqrt(np.maximum(variance, LEAST_VARIANCE_DB2))
        by_deviation = (1.0 / deviation)[:, None]
        # Derivatives of half of the variance, over the deviation.
        rows = forms[:, 0] * -by_deviation
        gradient = rows[:, 1:3]
        crossed = gradient[:, :, None] * gradient[:, None]
        crossed += forms[:, 1:, 1:3]
        crossed *= by_deviation[:, None]
        rows[:, 3:5] -= crossed[:, 0]
        rows[:, 5] -= crossed[:, 1, 1]
        rows[:, 0] = deviation
        return Derivatives.of(mean), Derivatives.of(rows)
