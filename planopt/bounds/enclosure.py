"""Enclosures of the predicted power over discs: certified ranges of mean, variance, probability.

Let phi be the covariances of a position with the measurements. The mean is ``f' theta + phi' w``,
the variance ``omega^2 + xi^2 - phi' U^-1 phi + r' M r``, r = f - A' phi (equation 1.8). Over a disc
of radius rho about c, each phi_l is enclosed by its tangent and a remainder, since distance is
convex; if the disc may hold the measured position, by its range. The quadratic form is enclosed
by ``phi(c)' U^-1 phi(c) + 2 a' delta + [0, D]`` (equation 6.13).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planopt.channel.cholesky import lower_inverse
from planopt.channel.measurements import (
    covariance_db2,
    pairwise_distance_m,
    place_origins,
)
from planopt.channel.parameters import MIN_DISTANCE_M, regressors
from planopt.channel.posterior import ChannelPosterior

Array = NDArray[np.float64]

DISCS_AT_ONCE = 512
"""Number of discs per block; their covariances with the measurements fit into the cache."""

ROUNDING = 1e-9
"""Relative widening of every range, far above the rounding errors of its sums."""


@dataclass(frozen=True)
class AffineBound:
    """Affine upper bounds ``value + slope . (x - centre)`` over n discs."""

    value: Array
    slope: Array


@dataclass(frozen=True)
class PowerModel:
    """Mean and variance of the predicted power over n discs, as tangents plus remainder ranges.

    Every array is ``(n,)``, slopes ``(2, n)``; powers in dB, variances in dB^2.
    """

    radius_m: Array
    mean_db: Array
    mean_slope: Array
    mean_low: Array
    mean_high: Array
    variance_db2: Array
    variance_slope: Array
    variance_low: Array
    variance_high: Array
    least_variance: float

    def probability_above(self, threshold_dbm: float) -> AffineBound:
        """Return upper bounds of P(power >= threshold), affine on each disc (equation 6.15)."""
        value, slope, most = self.probability_bounds(threshold_dbm)
        # Far from the centre, the tangent is looser than the largest value over the disc.
        flat = value + np.hypot(*slope.T) * self.radius_m * 0.5 > most
        return AffineBound(np.where(flat, most, value), np.where(flat[:, None], 0.0, slope))

    def probability_bounds(self, threshold_dbm: float) -> tuple[Array, Array, Array]:
        """Return upper bounds of P(power >= threshold) over each disc: affine, and constant.

        The results are values at the centres (n,), slopes (n, 2) and constant bounds (n,).
        """
        over = self.mean_db - threshold_dbm
        deviation = np.sqrt(self.variance_db2)
        z = over / deviation
        by_variance = -0.5 * z / self.variance_db2
        slope = self.mean_slope / deviation + by_variance * self.variance_slope
        # Largest changes of mean and variance within the disc, and remainder of the tangent of z.
        mean_step = np.hypot(*self.mean_slope) * self.radius_m
        mean_step = mean_step + np.maximum(np.abs(self.mean_low), np.abs(self.mean_high))
        step = np.hypot(*self.variance_slope) * self.radius_m
        step = step + np.maximum(np.abs(self.variance_low), np.abs(self.variance_high))
        least = np.maximum(self.variance_db2 - step, self.least_variance)
        beyond = self.mean_high / deviation + np.maximum(
            by_variance * self.variance_low, by_variance * self.variance_high
        )
        beyond += 0.5 * mean_step * step / least**1.5
        beyond += 0.375 * (np.abs(over) + mean_step) * step**2 / least**2.5
        # Phi lies below its tangent at z, less where it is concave throughout.
        steep = np.hypot(*slope) * self.radius_m
        bend = _largest_bend(z - steep, z + steep)
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        peak = _largest_density(z - steep - np.abs(beyond), z + steep + np.abs(beyond))
        value = ndtr(z) + 0.5 * bend * steep**2
        value += np.where(beyond > 0.0, peak * beyond, 0.0) + ROUNDING
        most = np.minimum(self._largest_probability(threshold_dbm), 1.0)
        return value, (density * slope).T, most

    def probability(self, threshold_dbm: float) -> Array:
        """Return P(power >= threshold) at the centres; (n,)."""
        return ndtr((self.mean_db - threshold_dbm) / np.sqrt(self.variance_db2))

    def _largest_probability(self, threshold_dbm: float) -> Array:
        """Return the largest P(power >= threshold) over each disc by interval arithmetic; (n,)."""
        mean_step = np.hypot(*self.mean_slope) * self.radius_m
        step = np.hypot(*self.variance_slope) * self.radius_m
        over = self.mean_db - threshold_dbm + mean_step + self.mean_high
        least = np.maximum(self.variance_db2 - step + self.variance_low, self.least_variance)
        most = np.maximum(self.variance_db2 + step + self.variance_high, least)
        root = np.sqrt(least) + (np.sqrt(most) - np.sqrt(least)) * (over < 0.0)
        return np.asarray(ndtr(over / root), dtype=np.float64) + ROUNDING


def _largest_bend(low: Array, high: Array) -> Array:
    """Return the maximum of Phi''(x) = ``-x exp(-x^2 / 2) / sqrt(2 pi)`` over [low, high]."""
    at = np.minimum(np.maximum(low, -1.0), high)
    return np.maximum(-at * np.exp(-0.5 * at**2) / np.sqrt(2.0 * np.pi), 0.0)


def _largest_density(low: Array, high: Array) -> Array:
    """Return the largest density of the standard normal distribution over [low, high]."""
    return np.exp(-0.5 * np.minimum(np.maximum(low, 0.0), high) ** 2) / np.sqrt(2.0 * np.pi)


class PowerEnclosure:
    """Certified ranges of the predicted power over discs, from all measurements of a posterior."""

    def __init__(self, posterior: ChannelPosterior) -> None:
        self._posterior = posterior
        # Products with the inverse run several times as fast as triangular solves.
        self._inverse = np.tril(lower_inverse(np.asfortranarray(posterior.factor)))
        columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
        solved = self._inverse.T @ columns  # U^-1 [y, Gamma]
        self._weight = solved[:, 0] - solved[:, 1:] @ posterior.theta
        self._root = _root(posterior.theta_covariance)
        self._sides = self._root @ solved[:, 1:].T  # (2, kappa)

    def over(self, centre_m: Array, radius_m: Array) -> PowerModel:
        """Return ranges of mean and variance over discs about centres (n, 2) with radii (n,)."""
        parts = [
            self._block(centre_m[k : k + DISCS_AT_ONCE], radius_m[k : k + DISCS_AT_ONCE])
            for k in range(0, len(centre_m), DISCS_AT_ONCE)
        ]
        columns = [np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)]
        names = [each.name for each in fields(PowerModel)][1:-1]
        noise = self._posterior.parameters.multipath_std_db**2
        found = dict(zip(names, columns, strict=True))
        return PowerModel(radius_m=radius_m, **found, least_variance=noise)

    def _block(self, centre: Array, radius: Array) -> tuple[Array, ...]:
        """Return values, tangents and remainder ranges of mean and variance for some discs."""
        posterior, root, sides, weight = self._posterior, self._root, self._sides, self._weight
        parameters = posterior.parameters
        shadow, beta = parameters.shadow_std_db**2, parameters.decorrelation_m
        noise, measured = parameters.multipath_std_db**2, posterior.origins
        theta = posterior.theta
        places = place_origins(centre, posterior.now_s, parameters)

        # Covariances (kappa, n), their gradients (2, kappa, n) and the ranges of their remainders.
        phi = covariance_db2(measured, places, parameters)
        blur = None if measured.blur_m2 is None else measured.blur_m2[:, None]
        distance = pairwise_distance_m(measured.positions_m, centre, blur)
        offset = centre.T[:, None, :] - measured.positions_m.T[:, :, None]
        slope = -phi / (beta * np.maximum(distance, 1e-300)) * offset
        bend = np.minimum(2.0 * radius, radius**2 / (2.0 * np.maximum(distance - radius, 1e-300)))
        below = -phi * bend / beta
        above = phi * np.exp(radius / beta) * radius**2 / (2.0 * beta**2)
        # The disc may hold the measured position, where the covariance has a cusp.
        cusp = distance <= radius
        slope[:, cusp] = 0.0
        with np.errstate(over="ignore"):
            peak = phi * np.exp(np.minimum(distance / beta, 700.0))
        below = np.where(cusp, phi * np.expm1(-radius / beta), below)
        above = np.where(cusp, np.minimum(peak, phi * np.exp(radius / beta)) - phi, above)

        gradient, trend_range = _trend(posterior, centre, radius)
        row = regressors(centre, parameters.station)

        mean = row @ theta + weight @ phi
        mean_slope = theta[1] * gradient + weight @ slope
        low, high = _weighted(weight[:, None], below, above)
        trend_low, trend_high = _scaled(theta[1], *trend_range)
        wide = ROUNDING * (1.0 + np.abs(mean))
        mean_low, mean_high = low + trend_low - wide, high + trend_high + wide

        # r = f - A' phi and z = R r with M = R' R, so that r' M r is the square of z.
        z = root @ row.T - sides @ phi
        z_slope = root[:, 1, None, None] * gradient - np.einsum("ik,dkn->idn", sides, slope)
        z_beyond = np.zeros_like(z)
        for i in range(2):
            least, most = _weighted(-sides[i][:, None], below, above)
            trend_low, trend_high = _scaled(root[i, 1], *trend_range)
            z_beyond[i] = np.maximum(np.abs(least + trend_low), np.abs(most + trend_high))
        z_curve = 2.0 * (np.abs(z) * z_beyond).sum(axis=0)
        z_norm = np.sqrt((z_slope**2).sum(axis=(0, 1))) * radius + np.hypot(*z_beyond)

        whitened = self._inverse @ phi
        explained = np.einsum("kn,kn->n", whitened, whitened)
        back = self._inverse.T @ whitened
        variance = noise + np.maximum(shadow - explained, 0.0) + (z**2).sum(axis=0)
        variance_slope = np.einsum("in,idn->dn", z, z_slope) - np.einsum("kn,dkn->dn", back, slope)
        variance_slope *= 2.0
        back_low, back_high = _weighted(back, below, above)
        tail = np.maximum(-below, above)
        rest = _quadratic_rest(self._inverse @ slope, tail, radius, shadow, beta, noise)
        wide = ROUNDING * (noise + shadow)
        variance_low = -2.0 * back_high - rest - z_curve - wide
        variance_high = -2.0 * back_low + z_curve + z_norm**2 + wide
        return (
            *(mean, mean_slope, mean_low, mean_high),
            *(variance, variance_slope, variance_low, variance_high),
        )


def _trend(
    posterior: ChannelPosterior, centre: Array, radius: Array
) -> tuple[Array, tuple[Array, Array]]:
    """Return gradients (2, n) and remainder ranges of -10 log10 of the station's distance."""
    station = posterior.parameters.station
    scale = 10.0 / np.log(10.0)
    offset = (centre - np.asarray(station.position_m)).T
    across = np.hypot(*offset)
    square = across**2 + station.height_m**2
    nearest = np.hypot(np.maximum(across - radius, 0.0), station.height_m)
    farthest = np.hypot(across + radius, station.height_m)
    smooth = nearest > np.maximum(MIN_DISTANCE_M, 0.5 * radius)
    gradient = np.where(smooth, -scale * offset / np.maximum(square, 1e-300), 0.0)
    # The second derivatives of log d are at most 1 / d^2.
    curved = scale * radius**2 / (2.0 * np.maximum(nearest, MIN_DISTANCE_M) ** 2)
    centre_db = -scale * np.log(np.maximum(np.sqrt(square), MIN_DISTANCE_M))
    least = -scale * np.log(np.maximum(farthest, MIN_DISTANCE_M)) - centre_db
    most = -scale * np.log(np.maximum(nearest, MIN_DISTANCE_M)) - centre_db
    low = cast("Array", np.where(smooth, -curved, least))
    high = cast("Array", np.where(smooth, curved, most))
    return np.asarray(gradient), (low, high)


def _weighted(weight: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return lower and upper bounds (n,) of weighted sums of intervals over measurements."""
    one, other = weight * low, weight * high
    return np.minimum(one, other).sum(axis=0), np.maximum(one, other).sum(axis=0)


def _scaled(factor: float, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the interval [low, high] times a factor of either sign."""
    return (factor * low, factor * high) if factor >= 0.0 else (factor * high, factor * low)


def _root(covariance: Array) -> Array:
    """Return R with R' R = M for a covariance M (2, 2), which may be zero."""
    values, vectors = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _quadratic_rest(
    whitened: Array,  # (2, kappa, n) L^-1 times the gradients
    beyond: Array,  # (kappa, n) largest remainder of each covariance
    radius: Array,
    shadow: float,
    beta: float,
    noise: float,
) -> Array:
    """Return an upper bound D of delta' U^-1 delta over each disc; (n,).

    It is the smaller of ``2 xi^2 (1 - exp(-rho / beta))``, from the kernel's own norm, and the
    triangle inequality in the norm of U^-1, as the smallest eigenvalue of U is at least omega^2.
    """
    by_kernel = -2.0 * shadow * np.expm1(-radius / beta)
    if noise <= 0.0:
        return by_kernel
    x, y = whitened
    xx, yy = np.einsum("kn,kn->n", x, x), np.einsum("kn,kn->n", y, y)
    xy = np.einsum("kn,kn->n", x, y)
    largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    tail = np.sqrt((beyond**2).sum(axis=0) / noise)
    return np.minimum(by_kernel, (radius * np.sqrt(largest) + tail) ** 2)
