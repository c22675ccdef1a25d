"""Measurement gains along a path: information gain and variance reduction.

All classes use C = S, or C = S + B M B' for uncertain theta: :class:`Information` log det C
(equations 4.1 and 4.5), :class:`VarianceRemoved` tr(Y' C^-1 Y) (4.1, 4.2 and 4.6), and
:class:`PathUncertainty` variances above a threshold (4.4).
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, rounded_length, rounded_positive_part
from planopt.channel.cholesky import inverse, log_determinant, solve_lower
from planopt.channel.kriging import kriging_terms
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.moments import Moments, Pull, Region, covariance_factor, pull_of_lengths
from planopt.objectives.path_derivatives import (
    CovarianceDerivatives,
    LocalPath,
    PathDerivatives,
    add_own_blocks,
    by_lengths,
    length_jacobian,
)
from planopt.objectives.stage_power import CUSP_ROUNDING


class Gain(Protocol):
    """Base class of gains by measurements along paths; a gain is zero without measurements."""

    def value(self, moments: Moments) -> Floats:
        """Return the gain of each path, ``(...)``."""
        ...

    def pull(self, moments: Moments) -> Pull:
        """Return the adjoints of :meth:`value` w.r.t. the gated moments of many paths."""
        ...

    def derivatives(self, path: LocalPath) -> PathDerivatives:
        """Return the gain of one path with derivatives w.r.t. positions and gates."""
        ...


@dataclass(frozen=True)
class Information:
    """Mutual information of measurements and the channel (or its path loss alone), in nats."""

    # Channel: 1/2 log det (S + B M B') minus that of the noise (equation 4.5), monotone submodular.
    # Path loss: minus 1/2 log det S instead, which gives 1/2 log (det M_t / det M_{t+h}).

    about: Literal["channel", "path loss"] = "channel"
    factor: float = 1.0

    def value(self, moments: Moments) -> Floats:
        """Return the information gain of each path."""
        diagonal = np.diagonal(moments.factor, axis1=-2, axis2=-1)
        if self.about == "path loss":
            less = np.diagonal(covariance_factor(moments.covariance), axis1=-2, axis2=-1)
        elif moments.parameters.multipath_std_db <= 0.0:
            raise InputError(
                "is 0: measurements are then exact, and their information is infinite",
                key="multipath_std_db",
                remedy='give multipath above 0 dB, or use form = "path" or "average"',
            )
        else:
            less = np.sqrt(moments.noise_db2)
        return self.factor * np.log(diagonal / less).sum(axis=-1)

    def pull(self, moments: Moments) -> Pull:
        """Return the information gain's adjoints w.r.t. the moments, from half the inverse of C."""
        found = _by_universal(moments, 0.5 * self.factor * moments.inverse)
        if self.about == "path loss":
            known = np.asarray(np.linalg.inv(moments.covariance), dtype=np.float64)
            return found.plus(Pull(by_covariance=known), -0.5 * self.factor)
        if moments.gate is None:
            return found
        noise = moments.parameters.multipath_std_db**2
        fills = moments.gate * (noise - moments.blind_db2) / moments.noise_db2
        return found.plus(Pull(by_gate=fills), -self.factor)

    def derivatives(self, path: LocalPath) -> PathDerivatives:
        """Return the information gain of one path with derivatives."""
        found = _half_log_determinant(path.universal)
        if self.about == "path loss":
            found = found.plus(_half_log_determinant(path.covariance), -1.0)
        else:
            found = found.plus(_half_log_noise(path), -1.0)
        return PathDerivatives(
            self.factor * found.value, self.factor * found.gradient, self.factor * found.hessian
        )


@dataclass(frozen=True, eq=False)
class VarianceRemoved:
    """Gain tr(Y' C^-1 Y), C the covariance: map variance removed, or path-loss information."""

    # Y is B times `loading`, or holds the covariances with the map positions.

    loading: Floats | None = None  # (2, r); None for the map
    universal: bool = True  # C is S + B M B' if true, else S

    def value(self, moments: Moments) -> Floats:
        """Return the trace tr(Y' C^-1 Y) of each path, with C and Y from :meth:`_parts`."""
        # tr(C^-1 Y Y') needs only the small Y Y'; solving for the wide Y costs several times more.
        covariance, rows = self._parts(moments)
        gathered = rows @ rows.swapaxes(-1, -2)
        return np.trace(np.linalg.solve(covariance, gathered), axis1=-2, axis2=-1)

    def _parts(self, moments: Moments) -> tuple[Floats, NDArray[np.floating]]:
        """Return covariance C and matrix Y of the trace tr(Y' C^-1 Y)."""
        covariance = moments.universal if self.universal else moments.covariance
        return covariance, moments.across if self.loading is None else moments.trend @ self.loading

    def pull(self, moments: Moments) -> Pull:
        """Return the trace's adjoints: -X X' w.r.t. C and 2 X w.r.t. Y, with X = C^-1 Y."""
        covariance, rows = self._parts(moments)
        precision = moments.inverse if self.universal else np.linalg.inv(covariance)
        x = precision.astype(rows.dtype) @ rows
        by_covariance = -(x @ x.swapaxes(-1, -2)).astype(np.float64)
        found = _by_universal(moments, by_covariance)
        if not self.universal:
            found = Pull(by_covariance=by_covariance)
        if self.loading is None:
            return found.plus(Pull(by_across=x), 2.0)
        return found.plus(Pull(by_trend=x @ self.loading.T), 2.0)

    def derivatives(self, path: LocalPath) -> PathDerivatives:
        """Return the trace of :meth:`value` for one path, with derivatives."""
        # Let X = C^-1 Y. For coordinate p of position i, dY = e_i y_p', dC = e_i d_p' + d_p e_i'
        # and u_p = y_p - X' d_p. With R_p = dY - dC X = e_i u_p' - d_p x_i':
        #     gradient_p = 2 x_i' u_p,
        #     Hessian_pq = 2 tr(R_p' C^-1 R_q) + 2 X . d^2 Y - X X' . d^2 C.
        batch = path.universal if self.universal else path.covariance
        rows = path.across if self.loading is None else path.trend.times(self.loading)
        weight = inverse(covariance_factor(batch.value))
        x = weight @ rows.value
        own = batch.owner
        u = rows.first - batch.first @ x
        xx = x @ x.T
        pulled = batch.first @ weight
        crossed = pulled[:, own].T * (u @ x.T)[:, own]
        hessian = weight[np.ix_(own, own)] * (u @ u.T) - crossed - crossed.T
        hessian += (pulled @ batch.first.T) * xx[np.ix_(own, own)]
        hessian *= 2.0
        hessian += batch.curvature(-xx)
        add_own_blocks(hessian, 2.0 * (rows.second @ x[:, :, None])[:, :, 0])
        value = float((rows.value * x).sum())
        return PathDerivatives(value, 2.0 * (x[own] * u).sum(axis=1), hessian)


THRESHOLD_ROUNDING = 0.01
"""Smoothing width of the variance threshold as a share of xi^2 + omega^2."""


@dataclass(frozen=True)
class PathUncertainty:
    """Weighted sum of the excess of each variance over a threshold, in dB^2 (equation 4.4)."""

    # L_ii^2: variance given the earlier positions; psi(l) = exp(-zeta l), l the path length.

    start_m: tuple[float, float]  # Position of the robot
    threshold_db2: float = 0.0  # sigma_TH^2; a smaller variance counts as known
    decay_per_m: float = 0.0  # zeta >= 0

    def value(self, moments: Moments) -> Floats:
        """Return the sum of excess variances for each path."""
        excess, near = self._parts(moments)
        return (excess * near).sum(axis=-1)

    def _parts(self, moments: Moments) -> tuple[Floats, Floats]:
        """Return the excess of each variance over the threshold, and its weight; both (..., N)."""
        places = moments.positions_m
        start = np.broadcast_to(self.start_m, (*places.shape[:-2], 1, 2))
        legs = np.linalg.norm(np.diff(np.concatenate([start, places], axis=-2), axis=-2), axis=-1)
        near = np.exp(-self.decay_per_m * np.cumsum(legs, axis=-1))
        variance = np.diagonal(moments.factor, axis1=-2, axis2=-1) ** 2
        # A gate g scales L_ii^2 - kappa, threshold and excess by g^2.
        gate = 1.0 if moments.gate is None else moments.gate
        fall = self.threshold_db2 - moments.blind_db2
        return np.maximum(variance - moments.blind_db2 - gate**2 * fall, 0.0), near

    def pull(self, moments: Moments) -> Pull:
        """Return the adjoints of the sum w.r.t. the moments, from the inverse Cholesky factor."""
        excess, near = self._parts(moments)
        rows = np.asarray(np.linalg.inv(moments.factor), dtype=np.float64)
        counts = np.where(excess > 0.0, near, 0.0)
        weight = np.diagonal(moments.factor, axis1=1, axis2=2) ** 2 * counts
        found = _by_universal(moments, rows.transpose(0, 2, 1) @ (weight[:, :, None] * rows))
        if moments.gate is not None:
            fall = 2.0 * moments.gate * (self.threshold_db2 - moments.blind_db2)
            found = found.plus(Pull(by_gate=fall * counts), -1.0)
        # A step length adds to the path length of its own position and of all later ones.
        after = np.cumsum((excess * near)[:, ::-1], axis=1)[:, ::-1]
        start = np.array(self.start_m)
        return found.plus(pull_of_lengths(start, moments.positions_m, -self.decay_per_m * after))

    def derivatives(self, path: LocalPath) -> PathDerivatives:
        """Return the sum for one path with derivatives; threshold and lengths are smoothed."""
        batch, gates, parameters = path.universal, path.gates, path.channel.parameters
        lower = covariance_factor(batch.value)
        left = solve_lower(lower, np.eye(len(lower)))
        along = left @ batch.first.T
        diagonal = np.diag(lower) ** 2
        gate = np.ones(path.steps) if gates is None else gates.value[0]
        fall = self.threshold_db2 - path.blind_db2
        excess, slope, bend = rounded_positive_part(
            diagonal - path.blind_db2 - gate * gate * fall, THRESHOLD_ROUNDING * path.blind_db2
        )
        # Derivatives of the excess w.r.t. the coordinates; see _bent_variances.
        changes = 2.0 * diagonal[:, None] * left[:, batch.owner] * along
        gated = 3 * np.arange(path.steps) + 2
        if gates is not None:
            changes[:, gated] -= np.diag(2.0 * gate * fall)
        offsets = np.diff(path.path_m, axis=0, prepend=np.array(self.start_m)[None])
        legs = rounded_length(offsets, CUSP_ROUNDING * parameters.decorrelation_m)
        near = np.exp(-self.decay_per_m * np.cumsum(legs.value))
        # Derivatives of psi(l_i) w.r.t. the coordinates, and sum_i excess_i d^2 psi(l_i).
        by_place = np.cumsum(length_jacobian(legs), axis=0)
        near_first = -self.decay_per_m * near[:, None] * by_place
        after = np.cumsum((excess * near)[::-1])[::-1]
        near_bent = by_place.T @ ((self.decay_per_m**2 * excess * near)[:, None] * by_place)
        near_bent -= self.decay_per_m * by_lengths(legs, after)[1]
        if gates is not None:
            steps = len(near_first)
            place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
            wide_first, wide_bent = np.zeros((steps, 3 * steps)), np.zeros((3 * steps, 3 * steps))
            wide_first[:, place] = near_first
            wide_bent[np.ix_(place, place)] = near_bent
            near_first, near_bent = wide_first, wide_bent
        hessian = _bent_variances(batch, left, along, diagonal * near * slope)
        if gates is not None:
            hessian[gated, gated] -= 2.0 * fall * near * slope
        hessian += changes.T @ ((near * bend)[:, None] * changes)
        crossed = changes.T @ (slope[:, None] * near_first)
        hessian += crossed + crossed.T + near_bent
        gradient = (near * slope) @ changes + excess @ near_first
        return PathDerivatives(float(excess @ near), gradient, hessian)


def map_criterion(posterior: ChannelPosterior, region: Region) -> Floats:
    """Return G (2, 2) such that tr(G M) is the map variance due to path-loss covariance M."""
    # G = sum_g w_g varphi(g) varphi(g)', with varphi(g) from the posterior before the path.
    trend = kriging_terms(posterior, region.grid_m).trend
    return trend.T @ (region.weight[:, None] * trend)


def require_estimated_path_loss(posterior: ChannelPosterior) -> None:
    """Raise an InputError for known path loss, on which no path yields information."""
    if posterior.theta_known:
        raise InputError(
            "the path loss is known, so that no measurement gives information about it",
            key="theta",
            remedy='condition the channel with theta="estimated"',
        )


def square_root(matrix: Floats) -> Floats:
    """Return F with F F' = `matrix`, a symmetric positive semidefinite (2, 2) matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _by_universal(moments: Moments, by_universal: Floats) -> Pull:
    """Return adjoints of S and B from adjoints of S + B M B' (M: path-loss covariance)."""
    by_trend = 2.0 * (by_universal @ (moments.trend @ moments.theta_covariance))
    return Pull(by_covariance=by_universal, by_trend=by_trend)


def _half_log_determinant(batch: CovarianceDerivatives) -> PathDerivatives:
    """Return 1/2 log det of a covariance C with derivatives w.r.t. the path's coordinates."""
    factor = covariance_factor(batch.value)
    weight, own = inverse(factor), batch.owner
    pulled = batch.first @ weight
    hessian = batch.curvature(0.5 * weight)
    hessian -= pulled[:, own] * pulled[:, own].T
    hessian -= weight[np.ix_(own, own)] * (pulled @ batch.first.T)
    gradient = pulled[np.arange(len(own)), own]
    return PathDerivatives(0.5 * log_determinant(factor), gradient, hessian)


def _half_log_noise(path: LocalPath) -> PathDerivatives:
    """Return half the log determinant of the noise of gated measurements, with derivatives."""
    noise, gates = path.channel.parameters.multipath_std_db**2, path.gates
    if gates is None:
        count = 2 * path.steps
        value = 0.5 * path.steps * float(np.log(noise))
        return PathDerivatives(value, np.zeros(count), np.zeros((count, count)))
    gate, part = gates.value[0], noise - path.blind_db2
    fills = path.blind_db2 + gate * gate * part
    gradient, hessian = np.zeros(3 * path.steps), np.zeros((3 * path.steps, 3 * path.steps))
    every = 3 * np.arange(path.steps) + 2
    gradient[every] = gate * part / fills
    hessian[every, every] = part / fills - 2.0 * gradient[every] ** 2
    return PathDerivatives(0.5 * float(np.log(fills).sum()), gradient, hessian)


def _bent_variances(
    batch: CovarianceDerivatives, left: Floats, along: Floats, weight: Floats
) -> Floats:
    """Return the weighted sum of the pivots' relative second derivatives, (2 h, 2 h)."""
    # L_ii^2 is the minimum of y' S y over y with y_i = 1 and y_k = 0 for k > i. The minimiser is
    # L_ii n_i, with n_i row i of N = L^-1 = `left`. The first derivative is L_ii^2 n_i' dS n_i, the
    # second L_ii^2 (n_i' d^2 S n_i - 2 sum_{k<i} (N dS n_i)_k (N dS' n_i)_k). For coordinate p of
    # position j, (N dS n_i)_k = N_kj (N D')_ip + (N D')_kp N_ij, with N D' = `along`.
    wide = left[:, batch.owner]
    found = batch.curvature(left.T @ (weight[:, None] * left))
    for i in range(1, len(left)):
        moved = wide[:i] * along[i] + along[:i] * wide[i]
        found -= 2.0 * weight[i] * (moved.T @ moved)
    return found
