"""Predicted power at the stages of a path, with exact derivatives of a smoothed kernel.

The distance d to a measurement becomes ``sqrt(d^2 + eps^2)``, with eps a hundredth of the
decorrelation distance; the relative error of the kernel is at most 0.01. Each stage is predicted
from its nearest measurements. The serving power of several stations has the mean ``t_1 + c z``, z
the any-station score, with its standard deviation c fixed to its value along the initial guess.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from planopt.arrays import Derivatives, Floats, add_products, radial
from planopt.channel.connectivity_law import (
    LEAST_DEVIATION_DB,
    ConnectivityLaw,
    any_score_derivatives,
)
from planopt.channel.kriging import LocalChannel, Prediction, score_probability
from planopt.channel.parameters import MIN_DISTANCE_M, ChannelParameters, Station
from planopt.channel.posterior import ChannelPosterior

CUSP_ROUNDING = 0.01  # Smoothing width of the kernel's cusp in decorrelation distances


def softened_m2(added_m2: Floats | float, parameters: ChannelParameters) -> Floats | float:
    """Return the term in m^2 that the smoothed kernel adds to squared distances."""
    return added_m2 + (CUSP_ROUNDING * parameters.decorrelation_m) ** 2


def fill_rounded_kernel(
    rows: Floats, x: Floats, y: Floats, parameters: ChannelParameters, soft_m2: Floats | float
) -> None:
    """Fill `rows` with the kernel at offsets (...) and its first and second derivatives."""
    # `rows` (6, ...): value, d/dx, d/dy, d2/dx2, d2/dxdy, d2/dy2, or the first one or three; a
    # buffer that solvers reuse. `soft_m2` comes from `softened_m2`.
    beta, value = parameters.decorrelation_m, rows[0]
    r = x * x
    r += y * y
    r += soft_m2
    np.sqrt(r, out=r)
    np.multiply(r, -1.0 / beta, out=value)
    np.exp(value, out=value)
    value *= parameters.shadow_std_db**2
    if len(rows) == 1:
        return
    # fall = -1 / (beta r); the slope is fall times the value.
    fall = np.divide(-1.0 / beta, r, out=r)
    slope = value * fall
    np.multiply(slope, x, out=rows[1])
    np.multiply(slope, y, out=rows[2])
    if len(rows) == 3:
        return
    by_xx, by_xy, by_yy = rows[3:]
    # bend = -slope (1 / (beta r) + 1 / r^2)
    bend = fall * (-(beta**2))
    bend += 1.0
    bend *= fall
    bend *= slope
    bent = bend * x
    np.multiply(bent, y, out=by_xy)
    bent *= x
    np.add(bent, slope, out=by_xx)
    bend *= y
    bend *= y
    np.add(bend, slope, out=by_yy)


def rounded_log_distance(positions_m: Floats, station: Station) -> Derivatives:
    """Return -10 log10 sqrt(d^2 + MIN_DISTANCE_M^2) with derivatives at positions (n, 2)."""
    offset = positions_m - np.asarray(station.position_m)
    square = np.einsum("ni,ni->n", offset, offset) + (station.height_m**2 + MIN_DISTANCE_M**2)
    slope = (-10.0 / math.log(10.0)) / square
    return radial(offset, -5.0 * np.log10(square), slope, -2.0 * slope / square)


LEAST_VARIANCE_DB2 = float(np.finfo(float).tiny)
"""Minimum variance in dB^2, in case rounding errors make it zero or negative."""


StagePower = tuple[Derivatives, Derivatives]
"""Mean and standard deviation of the power at every stage, with derivatives."""


class StagePredictor:
    """Power predictor of all stages; stage k uses the k-th neighbour set of `model`."""

    # Sums over stages need no covariances between positions. For 20 steps this class takes 0.07 ms,
    # a fifth of the time of `LocalPaths`.
    # Let phi be the covariances with the m measurements, g = (1, gamma) the path-loss regressors, A
    # = trend and f = (phi, g). The mean is the linear form ``w' f``. The variance ``xi^2 + omega^2
    # - phi' P phi + b' M b``, b = g - A' phi, is the quadratic form ``xi^2 + omega^2 - f' Q f``.

    def __init__(self, model: LocalChannel) -> None:
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
        # Rows of f and its derivatives: value, x, y, xx, xy, yy.
        self._f = np.zeros((n, 6, m + 2))
        self._f[:, 0, m] = 1.0
        self._kernel = self._f[:, :, :m].swapaxes(0, 1)
        self._x_m = np.ascontiguousarray(model.positions_m[:, :, 0])
        self._y_m = np.ascontiguousarray(model.positions_m[:, :, 1])
        self._soft_m2 = softened_m2(model.added_m2, model.parameters)

    def __call__(self, positions_m: Floats) -> StagePower:
        """Return mean and standard deviation of the power at positions (n, 2), one per stage."""
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
        # Bilinear forms of f, f_x and f_y with all six rows.
        forms = (f[:, :3] @ self._quadratic) @ f.swapaxes(1, 2)
        variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2 - forms[:, 0, 0]
        deviation = np.sqrt(np.maximum(variance, LEAST_VARIANCE_DB2))
        by_deviation = (1.0 / deviation)[:, None]
        # Derivatives of half the variance, divided by the standard deviation.
        rows = forms[:, 0] * -by_deviation
        gradient = rows[:, 1:3]
        crossed = gradient[:, :, None] * gradient[:, None]
        crossed += forms[:, 1:, 1:3]
        crossed *= by_deviation[:, None]
        rows[:, 3:5] -= crossed[:, 0]
        rows[:, 5] -= crossed[:, 1, 1]
        rows[:, 0] = deviation
        return Derivatives.of(mean), Derivatives.of(rows)


class ServingStages:
    """Predictor of the serving power at every stage of a path."""

    def __init__(
        self,
        posteriors: Sequence[ChannelPosterior],
        thresholds_dbm: Sequence[float],
        law: Callable[[Sequence[Prediction]], Prediction],  # Combines station powers
        path_m: Floats,  # (N, 2)
        neighbours: int,
    ) -> None:
        self._thresholds_dbm = thresholds_dbm
        self._stations = [
            StagePredictor(LocalChannel.around_each(posterior, path_m, neighbours))
            for posterior in posteriors
        ]
        powers = [predict(path_m) for predict in self._stations]
        about = [Prediction(mean.value, deviation.value) for mean, deviation in powers]
        self._scale_db = law(about).deviation_db

    def __call__(self, positions_m: Floats) -> StagePower:
        """Return mean and standard deviation of the serving power at positions (n, 2)."""
        powers = [predict(positions_m) for predict in self._stations]
        return serving_derivatives(powers, self._thresholds_dbm, self._scale_db)


def serving_derivatives(
    powers: Sequence[StagePower],
    thresholds_dbm: Sequence[float],  # (m,)
    scale_db: Floats,  # (N,) c
) -> StagePower:
    """Return the mean serving power of m stations, with standard deviation `scale_db`."""
    # dz = sum_i w_i dz_i and d2z = sum_i w_i d2z_i + sum_ij W_ij dz_i dz_j'.
    scores = [
        scores_of(mean, deviation, threshold)
        for (mean, deviation), threshold in zip(powers, thresholds_dbm, strict=True)
    ]
    z, weight, bend = any_score_derivatives(np.stack([score.value for score in scores]))
    gradient = np.stack([score.gradient for score in scores])
    first = np.einsum("in,ina->na", weight, gradient)
    second = np.einsum("in,ina->na", weight, np.stack([score.hessian for score in scores]))
    pulled = 0.5 * np.einsum("ijn,jna->ina", bend, gradient)
    for own, other in zip(gradient, pulled, strict=True):
        add_products(second, own, other)
    by_scale = scale_db[:, None]
    mean = Derivatives(thresholds_dbm[0] + scale_db * z, by_scale * first, by_scale * second)
    return mean, Derivatives(scale_db, np.zeros_like(first), np.zeros_like(second))


def scores_of(mean: Derivatives, deviation: Derivatives, threshold_dbm: float) -> Derivatives:
    """Return each stage's score (mean - threshold) / deviation, with gradient and Hessian."""
    by_sigma = 1.0 / np.maximum(deviation.value, LEAST_DEVIATION_DB)
    z = (mean.value - threshold_dbm) * by_sigma
    rows = mean.rows - z[:, None] * deviation.rows
    rows *= by_sigma[:, None]
    add_products(rows[:, 3:], rows[:, 1:3], -deviation.gradient * by_sigma[:, None])
    rows[:, 0] = z
    return Derivatives.of(rows)


def connectivity_derivatives(
    mean_db: Derivatives, deviation_db: Derivatives, threshold_dbm: float
) -> Derivatives:
    """Return each stage's probability of connection, with gradient and Hessian."""
    # dP = n(z) dz and d2P = n(z) (d2z - z dz dz'), n the standard normal density.
    rows = scores_of(mean_db, deviation_db, threshold_dbm).rows
    z = rows[:, 0].copy()
    # Contribution of the slope of the normal density.
    add_products(rows[:, 3:], rows[:, 1:3], (-0.5 * z)[:, None] * rows[:, 1:3])
    rows *= (np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))[:, None]
    rows[:, 0] = score_probability(z)
    return Derivatives.of(rows)


def stage_predictor(
    law: ConnectivityLaw, path_m: Floats, neighbours: int
) -> StagePredictor | ServingStages:
    """Return the stage predictor near a path (N, 2), for one station or several."""
    first, *others = law.posteriors
    if others:
        return ServingStages(law.posteriors, law.thresholds_dbm, law.combined, path_m, neighbours)
    return StagePredictor(LocalChannel.around_each(first, path_m, neighbours))
