"""Enclosures of the predicted power over discs: certified ranges of mean, variance, probability.

Let phi be the covariances of a position with the measurements. The mean is ``f' theta + phi' w``,
the variance ``omega^2 + xi^2 - phi' U^-1 phi + r' M r``, r = f - A' phi (equation 1.8). Over a
disc of radius rho about c, a Taylor polynomial of degree two and a remainder enclose each phi_l
(equation 6.16). Near the measured position, a tangent is tighter. If the disc holds that position,
where phi_l has a kink, a range encloses phi_l. Sums keep quadratic terms, many of which cancel.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import cast

import numpy as np
from scipy.special import ndtr

from planopt.arrays import Floats
from planopt.channel.cholesky import lower_inverse
from planopt.channel.measurements import covariance_db2, pairwise_distance_m, place_origins
from planopt.channel.parameters import MIN_DISTANCE_M, ChannelParameters, regressors
from planopt.channel.posterior import ChannelPosterior

DISCS_AT_ONCE = 512
"""Number of discs per block; their covariances with the measurements fit into the cache."""
MIXED = 2.0 / np.sqrt(3.0)
"""Three times the maximum of c (1 - c^2) for a cosine c, in third derivatives of distances."""
NEGLIGIBLE = 1e-13
"""Eigenvalues that may be neglected, relative to the largest; their bound is added."""
ROUNDING = 1e-9  # Relative widening of every range, far above the rounding errors of its sums


@dataclass(frozen=True)
class PowerModel:
    """Mean and variance of the predicted power over n discs: quadratic functions and remainders.

    Arrays are ``(n,)``, slopes ``(2, n)``, quadratic forms ``(3, n)``: coefficients of x^2, xy and
    y^2. Powers are in dB, variances in dB^2.
    """

    radius_m: Floats
    mean_db: Floats
    mean_slope: Floats
    mean_form: Floats
    mean_low: Floats
    mean_high: Floats
    variance_db2: Floats
    variance_slope: Floats
    variance_form: Floats
    variance_low: Floats
    variance_high: Floats
    least_variance: float

    def probability_above(self, threshold_dbm: float, corners_m: Floats) -> Floats:
        """Return corner values (n, k) whose interpolation bounds P(connected) (equation 6.17)."""
        value, slope, form, most = self._taylor(threshold_dbm)
        # A concave form is at most zero, a convex one at most its interpolation.
        at = np.moveaxis(corners_m, 2, 0)
        xx, xy, yy = _convex_part(form)[:, :, None]
        bound = value[:, None] + np.einsum("dnk,dn->nk", at, slope)
        bound += xx * at[0] ** 2 + xy * at[0] * at[1] + yy * at[1] ** 2
        # Far from the centre, the Taylor polynomial is looser than the largest value.
        return np.where((bound.mean(axis=1) <= most)[:, None], bound, most[:, None])

    def probability_bounds(self, threshold_dbm: float) -> tuple[Floats, Floats, Floats]:
        """Return an affine and a constant upper bound of P(connected) over each disc."""
        value, slope, form, most = self._taylor(threshold_dbm)
        return value + _range_of_form(form, self.radius_m)[1], slope.T, most

    def _taylor(self, threshold_dbm: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return a quadratic and a constant upper bound of P(connected) (equation 6.17)."""
        over, variance, radius = self.mean_db - threshold_dbm, self.variance_db2, self.radius_m
        deviation = np.sqrt(variance)
        z = over / deviation
        # Relative to the variance: slope and quadratic form, their sizes, and the remainder's.
        relative, bent = self.variance_slope / variance, self.variance_form / variance
        mean_linear = np.hypot(*self.mean_slope) * radius
        mean_rest = np.maximum(np.abs(self.mean_low), np.abs(self.mean_high))
        mean_bent = _largest_form(self.mean_form, radius) + mean_rest
        linear = np.hypot(*relative) * radius
        rest = np.maximum(np.abs(self.variance_low), np.abs(self.variance_high)) / variance
        bent_size = _largest_form(bent, radius) + rest
        step = linear + bent_size
        least = np.maximum(1.0 - step, self.least_variance / variance)
        # z is the product of over + mean's change and (1 + change of variance)^-1/2.
        slope = (self.mean_slope - 0.5 * over * relative) / deviation
        form = self.mean_form - 0.5 * over * bent - 0.5 * _product(self.mean_slope, relative)
        form = (form + 0.375 * over * _product(relative, relative)) / deviation
        beyond = mean_rest + 0.5 * np.abs(over) * rest
        beyond += 0.5 * (mean_linear * bent_size + mean_bent * step)
        beyond += 0.375 * np.abs(over) * (2.0 * linear + bent_size) * bent_size
        beyond += 0.375 * (mean_linear + mean_bent) * step**2
        beyond += 0.3125 * (np.abs(over) + mean_linear + mean_bent) * step**3 / least**3.5
        beyond /= deviation
        # Phi(z) lies within 0.399 |y|^3 / 6 of its Taylor polynomial of degree two in y.
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        steep = np.hypot(*slope) * radius
        bent_size = _largest_form(form, radius) + beyond
        whole = density * form - 0.5 * z * density * _product(slope, slope)
        value = ndtr(z) + density * beyond
        value += 0.5 * np.abs(z) * density * (2.0 * steep + bent_size) * bent_size
        value += 0.3990 / 6.0 * (steep + bent_size) ** 3 + ROUNDING
        most = np.minimum(self._largest_probability(threshold_dbm), 1.0)
        return value, density * slope, whole, most

    def variance_bounds(self) -> tuple[Floats, Floats, Floats]:
        """Return an affine and a constant upper bound of the variance over each disc."""
        bent = _range_of_form(self.variance_form, self.radius_m)[1]
        value, slope = self.variance_db2 + self.variance_high + bent, self.variance_slope
        return value, slope.T, value + np.hypot(*slope) * self.radius_m

    def least_variances(self) -> Floats:
        """Return lower bounds (n,) of the variance."""
        bent = _range_of_form(self.variance_form, self.radius_m)[0] + self.variance_low
        steep = np.hypot(*self.variance_slope) * self.radius_m
        return np.maximum(self.variance_db2 + bent - steep, self.least_variance)

    def precision_bounds(self) -> tuple[Floats, Floats, Floats]:
        """Return an affine and a constant upper bound of 1 / variance (equation 9.5)."""
        variance, slope = self.variance_db2, self.variance_slope
        step = np.hypot(*slope) * self.radius_m
        low, high = _range_of_form(self.variance_form, self.radius_m)
        low, high = low + self.variance_low, high + self.variance_high
        least = np.maximum(variance - step + low, self.least_variance)
        widest = np.maximum(step + high, step - low)
        value = 1.0 / variance - low / variance**2 + widest**2 / least**3
        return value, (-slope / variance**2).T, 1.0 / least

    def probability(self, threshold_dbm: float) -> Floats:
        """Return P(power >= threshold) at the centre of each disc as an array (n,)."""
        return ndtr((self.mean_db - threshold_dbm) / np.sqrt(self.variance_db2))

    def _largest_probability(self, threshold_dbm: float) -> Floats:
        """Return the largest P(power >= threshold) over each disc by interval arithmetic."""
        low, high = _range_of_form(self.variance_form, self.radius_m)
        step = np.hypot(*self.variance_slope) * self.radius_m
        over = self.mean_db - threshold_dbm + np.hypot(*self.mean_slope) * self.radius_m
        over += _range_of_form(self.mean_form, self.radius_m)[1] + self.mean_high
        least = self.variance_db2 - step + low + self.variance_low
        least = np.maximum(least, self.least_variance)
        most = np.maximum(self.variance_db2 + step + high + self.variance_high, least)
        root = np.sqrt(least) + (np.sqrt(most) - np.sqrt(least)) * (over < 0.0)
        return np.asarray(ndtr(over / root), dtype=np.float64) + ROUNDING


def _product(one: Floats, other: Floats) -> Floats:
    """Return the products of linear functions with slopes (2, n) as quadratic forms (3, n)."""
    return np.array([one[0] * other[0], one[0] * other[1] + one[1] * other[0], one[1] * other[1]])


def _range_of_form(form: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Return the ranges of quadratic forms (3, n) over discs about the origin."""
    middle = 0.5 * (form[0] + form[2])
    apart = 0.5 * np.hypot(form[0] - form[2], form[1])
    square = radius**2
    low = np.minimum(middle - apart, 0.0) * square
    return low, np.maximum(middle + apart, 0.0) * square


def _convex_part(form: Floats) -> Floats:
    """Return the positive semidefinite parts (3, n) of quadratic forms."""
    middle = 0.5 * (form[0] + form[2])
    apart = np.maximum(0.5 * np.hypot(form[0] - form[2], form[1]), 1e-300)
    low, high = middle - apart, middle + apart
    mixed = form.copy()
    mixed[[0, 2]] -= low
    mixed *= high / (2.0 * apart)
    return np.where(low >= 0.0, form, np.where(high <= 0.0, 0.0, mixed))


def _largest_form(form: Floats, radius: Floats) -> Floats:
    """Return the largest absolute value (n,) of each quadratic form over a disc."""
    low, high = _range_of_form(form, radius)
    return np.maximum(-low, high)


@dataclass(frozen=True, eq=False)
class JointModel:
    """Terms of the covariances between discs, less that of the shadowing (equation 9.17).

    `own` has the terms whose products, the first two less the others, are the covariances.
    """

    own: Floats  # (..., 2 + kappa)
    pull: Floats  # (..., kappa + 1) derivatives by the terms of the other disc
    slope: Floats  # (..., 2, kappa + 1) gradients of the terms
    rest: Floats  # (..., kappa + 1) remainders of the terms
    change: Floats  # (...) norms of the largest changes of `own`

    def at(self, rows: object) -> JointModel:
        """Return the terms of some of the discs, by an index of their array."""
        return JointModel(*(getattr(self, each.name)[rows] for each in fields(self)))

    def covariances(self, other: JointModel) -> tuple[Floats, Floats, list[Floats]]:
        """Return centres' covariances, least ones less the slopes, and both discs' slopes."""
        joint = 2.0 * _dots(self.own[..., :2], other.own[..., :2]) - _dots(self.own, other.own)
        if not self.change.any():
            return joint, joint, [np.zeros((*joint.shape, 2))] * 2
        one = _dots(other.pull[..., None, :], self.slope)
        two = _dots(self.pull[..., None, :], other.slope)
        rest = _dots(np.abs(other.pull), self.rest) + _dots(np.abs(self.pull), other.rest)
        rest += self.change * other.change + ROUNDING * (1.0 + np.abs(joint))
        return joint, joint - rest, [one, two]


def prior_covariances(
    offset_m: Floats, radius_m: float, far_m: float, parameters: ChannelParameters
) -> tuple[float, list[tuple[float, Floats]]]:
    """Return the shadowing's covariance of two centres, and affine bounds from below over discs.

    A bound is a value and the slope of the first disc; the second has its negative. The positions
    are at most `far_m` apart.
    """
    shadow, beta = parameters.shadow_std_db**2, parameters.decorrelation_m
    distance, wide = float(np.hypot(*offset_m)), 2.0 * radius_m
    centre = shadow * np.exp(-distance / beta)
    found = [(shadow * np.exp(-far_m / beta), np.zeros(2))]
    if distance > wide:
        bend = distance - np.sqrt(distance**2 - wide**2)
        found.append((centre * (1.0 - bend / beta), offset_m * (centre / (beta * distance))))
    return centre, found


def _dots(one: Floats, other: Floats) -> Floats:
    """Return the inner products over the last axis."""
    return np.einsum("...k,...k->...", one, other)


@dataclass(frozen=True, eq=False)
class VarianceDifference:
    """Difference of two variances, the squared norm of a linear function of the covariances."""

    enclosure: PowerEnclosure
    root: Floats  # (r, kappa + 2)
    neglected: float  # Largest neglected eigenvalue

    def bounds(self, centre_m: Floats, radius_m: float) -> tuple[Floats, Floats, Floats]:
        """Return an affine and a constant upper bound over discs (equation 9.16)."""
        radius = np.full(len(centre_m), radius_m)
        term, slope, rest = self.enclosure.terms(centre_m, radius)
        own, steep = self.root @ term, self.root @ slope
        change = radius * np.sqrt((steep**2).sum(axis=(0, 1)))
        change += np.sqrt(((np.abs(self.root) @ rest) ** 2).sum(axis=0))
        value = (own**2).sum(axis=0) + 2.0 * (np.abs(self.root.T @ own) * rest).sum(axis=0)
        value += change**2 + self.neglected * ((np.abs(term) + rest) ** 2).sum(axis=0)
        value += ROUNDING * (1.0 + value)
        tangent = 2.0 * np.einsum("rn,drn->dn", own, steep)
        return value, tangent.T, value + radius * np.hypot(*tangent)


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
        noise = posterior.parameters.multipath_std_db**2
        self._least_noise = float(posterior.noise_variance_db2.min(initial=noise))
        self._sides = self._root @ solved[:, 1:].T  # (2, kappa)

    def over(self, centre_m: Floats, radius_m: Floats) -> PowerModel:
        """Return ranges of the power's mean and variance over discs with centres (n, 2)."""
        parts = [
            self._block(centre_m[k : k + DISCS_AT_ONCE], radius_m[k : k + DISCS_AT_ONCE])
            for k in range(0, len(centre_m), DISCS_AT_ONCE)
        ]
        columns = [np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)]
        names = [each.name for each in fields(PowerModel)][1:-1]
        noise = self._posterior.parameters.multipath_std_db**2
        found = dict(zip(names, columns, strict=True))
        return PowerModel(radius_m=radius_m, **found, least_variance=noise)

    def joint(self, centre_m: Floats, radius_m: float) -> JointModel:
        """Return terms of the posterior covariances between discs with centres (n, 2)."""
        posterior, root, sides = self._posterior, self._root, self._sides
        parameters, radius = posterior.parameters, np.full(len(centre_m), radius_m)
        phi, slope, form, below, above = self._covariances(centre_m, radius)
        gradient, trend_form, trend_range = _trend(posterior, centre_m, radius)
        rest, trend_rest = np.maximum(-below, above), np.abs(trend_range).max(axis=0)
        square, beyond = self._square_of_change(slope, form, rest, radius)
        square = _largest_form(square, radius) + beyond
        by_kernel = (
            -2.0 * parameters.shadow_std_db**2 * np.expm1(-radius / parameters.decorrelation_m)
        )
        rest = rest + _largest_form(form, radius)
        trend_rest += _largest_form(trend_form, radius)
        z = root @ regressors(centre_m, parameters.station).T - sides @ phi
        whitened = self._inverse @ phi
        z_slope = root[:, 1, None, None] * gradient - np.einsum("ik,dkn->idn", sides, slope)
        z_change = np.sqrt((z_slope**2).sum(axis=(0, 1))) * radius
        z_change += np.hypot(*(np.abs(root[:, 1, None]) * trend_rest + np.abs(sides) @ rest))
        back = -(self._inverse.T @ whitened + sides.T @ z)
        return JointModel(
            np.vstack([z, whitened]).T,
            np.vstack([back, root[:, 1] @ z]).T,
            np.moveaxis(np.concatenate([slope, gradient[:, None]], axis=1), 2, 0),
            np.vstack([rest, trend_rest]).T,
            np.sqrt(z_change**2 + np.minimum(square, by_kernel)),
        )

    def less(self, other: PowerEnclosure) -> VarianceDifference:
        """Return the variance less that of `other`, which has the same measured positions."""
        forms: list[Floats] = []
        for each in (self, other):
            rows = np.hstack([-each._sides, each._root])
            forms.append(rows.T @ rows)
            forms[-1][:-2, :-2] -= each._inverse.T @ each._inverse
        values, vectors = np.linalg.eigh(forms[0] - forms[1])
        kept = values > NEGLIGIBLE * values.max(initial=0.0)
        root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
        return VarianceDifference(self, root, NEGLIGIBLE * float(values.max(initial=0.0)))

    def terms(self, centre_m: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
        """Return covariances and regressors (kappa + 2, n), gradients, and remainders."""
        posterior, count = self._posterior, len(centre_m)
        phi, slope, form, below, above = self._covariances(centre_m, radius)
        gradient, trend_form, trend_range = _trend(posterior, centre_m, radius)
        rest = np.maximum(-below, above) + _largest_form(form, radius)
        trend_rest = np.abs(trend_range).max(axis=0) + _largest_form(trend_form, radius)
        row = regressors(centre_m, posterior.parameters.station).T
        return (
            np.vstack([phi, row]),
            np.concatenate([slope, np.zeros((2, 1, count)), gradient[:, None]], axis=1),
            np.vstack([rest, np.zeros(count), trend_rest]),
        )

    def _block(self, centre: Floats, radius: Floats) -> tuple[Floats, ...]:
        """Return values, tangents and remainder ranges of mean and variance over several discs."""
        posterior, root, sides, weight = self._posterior, self._root, self._sides, self._weight
        parameters = posterior.parameters
        shadow, beta = parameters.shadow_std_db**2, parameters.decorrelation_m
        noise, theta = parameters.multipath_std_db**2, posterior.theta
        phi, slope, form, below, above = self._covariances(centre, radius)
        gradient, trend_form, trend_range = _trend(posterior, centre, radius)
        row = regressors(centre, parameters.station)

        mean = row @ theta + weight @ phi
        mean_slope = theta[1] * gradient + weight @ slope
        mean_form = theta[1] * trend_form + weight @ form
        low, high = _weighted(weight[:, None], below, above)
        trend_low, trend_high = _scaled(theta[1], *trend_range)
        wide = ROUNDING * (1.0 + np.abs(mean))
        mean_low, mean_high = low + trend_low - wide, high + trend_high + wide

        # r = f - A' phi and z = R r with M = R' R, so that r' M r is the square of z. Its slopes
        # and the remainders of its tangents give the part of the square that is not linear in r.
        z = root @ row.T - sides @ phi
        z_slope = root[:, 1, None, None] * gradient - np.einsum("ik,dkn->idn", sides, slope)
        z_form = root[:, 1, None, None] * trend_form - np.einsum("ik,dkn->idn", sides, form)
        trend_rest = np.abs(trend_range).max(axis=0)
        rest = np.maximum(-below, above)
        z_tail = np.array([_largest_form(each, radius) for each in z_form])
        z_tail += np.abs(root[:, 1, None]) * trend_rest + np.abs(sides) @ rest
        z_steep = np.sqrt((z_slope**2).sum(axis=(0, 1))) * radius

        # phi' U^-1 phi: tangent at phi(c) along `back`, and the square of the change of phi.
        whitened = self._inverse @ phi
        explained = np.einsum("kn,kn->n", whitened, whitened)
        back = -2.0 * (self._inverse.T @ whitened + sides.T @ z)
        trend_weight = 2.0 * (root[:, 1] @ z)
        variance = noise + np.maximum(shadow - explained, 0.0) + (z**2).sum(axis=0)
        variance_slope = np.einsum("kn,dkn->dn", back, slope) + trend_weight * gradient
        variance_form = np.einsum("kn,dkn->dn", back, form) + trend_weight * trend_form
        variance_form += _product(z_slope[0], z_slope[0]) + _product(z_slope[1], z_slope[1])
        low, high = _weighted(back, below, above)
        z_rest = 2.0 * z_steep * np.hypot(*z_tail) + (z_tail**2).sum(axis=0)
        square, rest = self._square_of_change(slope, form, rest, radius)
        # Without fading, or over large discs, the kernel's norm bounds the square.
        by_kernel = -2.0 * shadow * np.expm1(-radius / beta)
        coarse = ~(_largest_form(square, radius) + rest < by_kernel)
        variance_form -= np.where(coarse, 0.0, square)
        wide = ROUNDING * (noise + shadow) + z_rest
        wide += np.abs(trend_weight) * trend_rest
        variance_low = low - np.where(coarse, by_kernel, rest) - wide
        variance_high = high + np.where(coarse, 0.0, rest) + wide
        return (
            *(mean, mean_slope, mean_form, mean_low, mean_high),
            *(variance, variance_slope, variance_form, variance_low, variance_high),
        )

    def _square_of_change(
        self, slope: Floats, form: Floats, rest: Floats, radius: Floats
    ) -> tuple[Floats, Floats]:
        """Return squared norms of whitened covariance changes: forms (3, n), remainders (n,)."""
        (x, y), form = self._inverse @ slope, self._inverse @ form
        pairs = (x, x), (x, y), (y, y)
        found = np.array([np.einsum("kn,kn->n", one, other) for one, other in pairs])
        found[1] *= 2.0
        sizes = np.einsum("dkn,dkn->dn", form, form)
        # The triangle inequality in the norm of U^-1 bounds the remainder; U's eigenvalues are at
        # least the least noise variance.
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = (rest**2).sum(axis=0) / self._least_noise
        beyond = np.fmin(beyond, ((np.abs(self._inverse) @ rest) ** 2).sum(axis=0))
        beyond = np.sqrt(beyond) + radius**2 * np.sqrt(sizes[0] + 0.5 * sizes[1] + sizes[2])
        return found, (2.0 * np.sqrt(_largest_form(found, radius)) + beyond) * beyond

    def _covariances(
        self, centre: Floats, radius: Floats
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return covariances (kappa, n), their gradients, forms, and ranges of remainders."""
        posterior, parameters = self._posterior, self._posterior.parameters
        measured, beta = posterior.origins, parameters.decorrelation_m
        places = place_origins(centre, posterior.now_s, parameters)
        phi = covariance_db2(measured, places, parameters)
        blur = None if measured.blur_m2 is None else measured.blur_m2[:, None]
        distance = pairwise_distance_m(measured.positions_m, centre, blur)
        offset = centre.T[:, None, :] - measured.positions_m.T[:, :, None]
        unit = offset / np.maximum(distance, 1e-300)
        slope = unit * (-phi / beta)
        nearest = np.maximum(distance - radius, np.maximum(1e-6 * radius, 1e-100))
        bend = distance - np.sqrt(np.maximum(distance**2 - radius**2, 0.0))
        below = -phi * bend / beta
        largest = phi * np.exp(radius / beta)
        above = largest * radius**2 / (2.0 * beta**2)
        # The disc may hold the measured position, where the covariance has a cusp.
        cusp = distance <= radius
        slope[:, cusp] = 0.0
        with np.errstate(over="ignore"):
            peak = phi * np.exp(np.minimum(distance / beta, 700.0))
            third = 1.0 / beta**2 + MIXED * (1.0 / beta + 1.0 / nearest) / nearest
            third *= largest * radius**3 / (6.0 * beta)
        below = np.where(cusp, phi * np.expm1(-radius / beta), below)
        above = np.where(cusp, np.minimum(peak, largest) - phi, above)
        tail = np.maximum(-below, above)
        far = ~cusp & (third < tail)
        below, above = np.where(far, -third, below), np.where(far, third, above)
        across = np.where(far, phi / (beta * np.maximum(distance, 1e-300)), 0.0)
        curved = np.where(far, phi / beta**2, 0.0) + across
        form = 0.5 * curved * _product(unit, unit)
        form[0] -= 0.5 * across
        form[2] -= 0.5 * across
        return phi, slope, form, below, above


def _trend(
    posterior: ChannelPosterior, centre: Floats, radius: Floats
) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
    """Return gradients, quadratic forms and remainders of -10 log10 of the station distance."""
    station = posterior.parameters.station
    scale = 10.0 / np.log(10.0)
    offset = (centre - np.asarray(station.position_m)).T
    across = np.hypot(*offset)
    square = across**2 + station.height_m**2
    nearest = np.hypot(np.maximum(across - radius, 0.0), station.height_m)
    farthest = np.hypot(across + radius, station.height_m)
    smooth = nearest > np.maximum(MIN_DISTANCE_M, 0.5 * radius)
    gradient = np.where(smooth, -scale * offset / np.maximum(square, 1e-300), 0.0)
    form = 0.5 * scale * (2.0 * _product(offset, offset) / np.maximum(square, 1e-300))
    form[[0, 2]] -= 0.5 * scale
    form = np.where(smooth, form / np.maximum(square, 1e-300), 0.0)
    # The third derivatives of log d are at most 2 / d^3.
    curved = scale * radius**3 / (3.0 * np.maximum(nearest, MIN_DISTANCE_M) ** 3)
    centre_db = -scale * np.log(np.maximum(np.sqrt(square), MIN_DISTANCE_M))
    least = -scale * np.log(np.maximum(farthest, MIN_DISTANCE_M)) - centre_db
    most = -scale * np.log(np.maximum(nearest, MIN_DISTANCE_M)) - centre_db
    low = cast("Floats", np.where(smooth, -curved, least))
    high = cast("Floats", np.where(smooth, curved, most))
    return np.asarray(gradient), form, (low, high)


def _weighted(weight: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return lower and upper bounds (n,) of weighted sums of intervals over measurements."""
    one, other = weight * low, weight * high
    return np.minimum(one, other).sum(axis=0), np.maximum(one, other).sum(axis=0)


def _scaled(factor: float, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return the interval [low, high] times a factor of either sign."""
    return (factor * low, factor * high) if factor >= 0.0 else (factor * high, factor * low)


def _root(covariance: Floats) -> Floats:
    """Return R with R' R = M for a covariance M (2, 2), which may be zero."""
    values, vectors = np.linalg.eigh(covariance)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
