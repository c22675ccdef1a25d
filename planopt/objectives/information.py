"""Measurement gains along a path: information gain and variance reduction.

All classes use C = S, or C = S + B M B' for uncertain theta: :class:`Information` log det C
(equations 4.1 and 4.5), :class:`VarianceRemoved` tr(Y' C^-1 Y) (4.1, 4.2 and 4.6), and
:class:`PathUncertainty` variances above a threshold (4.4).
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Derivatives, Floats, rounded_length, rounded_positive_part
from planopt.channel.kriging import kriging_terms
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.moments import Moments, Region, covariance_factor
from planopt.objectives.path_derivatives import (
    CovarianceDerivatives,
    LocalPaths,
    PathDerivatives,
    Rows,
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

    def slope(self, path: LocalPaths) -> Floats:
        """Return the gradient of each path's gain, w.r.t. positions and gates."""
        ...

    def derivatives(self, path: LocalPaths) -> PathDerivatives:
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

    def slope(self, path: LocalPaths) -> Floats:
        """Return the gradient of each path's information gain, from half the inverse of C."""
        moments = path.moments
        found = path.universal.slope(0.5 * self.factor * moments.inverse)
        if self.about == "path loss":
            return found - path.covariance.slope(0.5 * self.factor * moments.known_inverse)
        if moments.gate is not None:
            part = moments.parameters.multipath_std_db**2 - moments.blind_db2
            found[:, 2::3] -= self.factor * moments.gate * part / moments.noise_db2
        return found

    def derivatives(self, path: LocalPaths) -> PathDerivatives:
        """Return the information gain of one path with derivatives."""
        moments = path.moments
        hessian = _half_log_bend(path.universal, moments.inverse[0])
        if self.about == "path loss":
            hessian -= _half_log_bend(path.covariance, moments.known_inverse[0])
        elif moments.gate is not None:
            part = moments.parameters.multipath_std_db**2 - moments.blind_db2
            share, every = part / moments.noise_db2[0], np.arange(2, len(hessian), 3)
            hessian[every, every] -= share - 2.0 * (moments.gate[0] * share) ** 2
        value = float(self.value(moments)[0])
        return PathDerivatives(value, self.slope(path)[0], self.factor * hessian)


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

    def _solved(self, path: LocalPaths) -> tuple[CovarianceDerivatives, Rows, Floats, Floats]:
        """Return C and Y of :meth:`_parts` with derivatives, C^-1, and X = C^-1 Y."""
        moments = path.moments
        batch = path.universal if self.universal else path.covariance
        rows = path.across if self.loading is None else path.trend.times(self.loading)
        weight = moments.inverse if self.universal else moments.known_inverse
        return batch, rows, weight, weight.astype(rows.value.dtype) @ rows.value

    # Let X = C^-1 Y. For coordinate p of position i, dY = e_i y_p', dC = e_i d_p' + d_p e_i'
    # and u_p = y_p - X' d_p. With R_p = dY - dC X = e_i u_p' - d_p x_i':
    #     gradient_p = 2 x_i' u_p,
    #     Hessian_pq = 2 tr(R_p' C^-1 R_q) + 2 X . d^2 Y - X X' . d^2 C.

    def slope(self, path: LocalPaths) -> Floats:
        """Return the gradient of the trace of each path."""
        batch, rows, _, x = self._solved(path)
        u = rows.first - batch.first.astype(rows.first.dtype) @ x
        return 2.0 * np.einsum("cpr,cpr->cp", x[:, batch.owner], u).astype(np.float64)

    def derivatives(self, path: LocalPaths) -> PathDerivatives:
        """Return the trace of :meth:`value` for one path, with derivatives."""
        batch, rows, (weight,), (x,) = self._solved(path)
        own, first = batch.owner, batch.first[0]
        u = rows.first[0] - first @ x
        xx = x @ x.T
        pulled = first @ weight
        crossed = pulled[:, own].T * (u @ x.T)[:, own]
        hessian = weight[np.ix_(own, own)] * (u @ u.T) - crossed - crossed.T
        hessian += (pulled @ first.T) * xx[np.ix_(own, own)]
        hessian *= 2.0
        hessian += batch.curvature(-xx)
        add_own_blocks(hessian, 2.0 * (rows.second[0] @ x[:, :, None])[:, :, 0])
        value = float((rows.value[0] * x).sum())
        return PathDerivatives(value, 2.0 * (x[own] * u).sum(axis=1), hessian)


THRESHOLD_ROUNDING = 0.01  # Smoothing width of the variance threshold as a share of xi^2 + omega^2
TINY_DB2, SHARP_M = 1e-12, 1e-9  # Smoothing widths of threshold and step lengths in ranking


@dataclass(frozen=True, eq=False)
class _Excess:
    """Parts of the uncertainty along c paths, with P coordinates each."""

    excess: Floats  # (c, N) excess over the threshold, and two derivatives of its smoothing
    slope: Floats
    bend: Floats
    near: Floats  # (c, N) weights by path length, and their gradients (c, N, P)
    near_first: Floats
    changes: Floats  # (c, N, P) gradients of the excess without smoothing
    left: Floats  # (c, N, N) inverse Cholesky factors
    along: Floats  # (c, N, P) inverse factors times derivatives of the covariance
    diagonal: Floats  # (c, N) variances given earlier positions
    legs: Derivatives  # (c, N) step lengths
    by_place: Floats  # (c, N, 2 N) gradients of path lengths


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

    def _along(self, path: LocalPaths) -> _Excess:
        """Return the sum's parts; threshold and lengths are smoothed unless paths are ranked."""
        moments, batch, exact = path.moments, path.universal, path.order < 2
        left = np.asarray(np.linalg.inv(moments.factor), dtype=np.float64)
        along = left @ batch.first.swapaxes(1, 2)
        diagonal = np.diagonal(moments.factor, axis1=1, axis2=2) ** 2
        gate = np.ones(path.shape) if path.gate is None else path.gate
        fall = self.threshold_db2 - moments.blind_db2
        excess, slope, bend = rounded_positive_part(
            diagonal - moments.blind_db2 - gate * gate * fall,
            TINY_DB2 if exact else THRESHOLD_ROUNDING * moments.blind_db2,
        )
        # Derivatives of the excess w.r.t. the coordinates; see _bent_variances.
        changes = 2.0 * diagonal[:, :, None] * left[:, :, batch.owner] * along
        if path.gate is not None:
            steps = np.arange(path.shape[1])
            changes[:, steps, 3 * steps + 2] -= 2.0 * gate * fall
        start = np.broadcast_to(self.start_m, (len(gate), 1, 2))
        offsets = np.diff(np.concatenate([start, path.paths_m], axis=1), axis=1)
        width = CUSP_ROUNDING * path.channel.parameters.decorrelation_m
        legs = rounded_length(offsets, SHARP_M if exact else width)
        near = np.exp(-self.decay_per_m * np.cumsum(legs.value, axis=1))
        # Derivatives of psi(l_i) w.r.t. the coordinates.
        by_place = np.cumsum(length_jacobian(legs), axis=1)
        near_first = -self.decay_per_m * near[:, :, None] * by_place
        if path.gate is not None:
            wide = np.zeros((*near_first.shape[:2], path.shape[1], 3))
            wide[..., :2] = near_first.reshape(*near_first.shape[:2], -1, 2)
            near_first = wide.reshape(*near_first.shape[:2], -1)
        return _Excess(
            excess, slope, bend, near, near_first, changes, left, along, diagonal, legs, by_place
        )

    def slope(self, path: LocalPaths) -> Floats:
        """Return the gradient of the sum of each path."""
        own = self._along(path)
        found = np.einsum("ci,cip->cp", own.near * own.slope, own.changes)
        return found + np.einsum("ci,cip->cp", own.excess, own.near_first)

    def derivatives(self, path: LocalPaths) -> PathDerivatives:
        """Return the sum for one path with derivatives; threshold and lengths are smoothed."""
        own = self._along(path)
        [excess], [slope], [bend], [near], [changes] = (
            own.excess,
            own.slope,
            own.bend,
            own.near,
            own.changes,
        )
        [near_first], [by_place], [left], [along] = (
            own.near_first,
            own.by_place,
            own.left,
            own.along,
        )
        # sum_i excess_i d^2 psi(l_i)
        after = np.cumsum((excess * near)[::-1])[::-1]
        near_bent = by_place.T @ ((self.decay_per_m**2 * excess * near)[:, None] * by_place)
        legs = Derivatives(own.legs.value[0], own.legs.gradient[0], own.legs.hessian[0])
        near_bent -= self.decay_per_m * by_lengths(legs, after)[1]
        hessian = _bent_variances(path.universal, left, along, own.diagonal[0] * near * slope)
        hessian += changes.T @ ((near * bend)[:, None] * changes)
        crossed = changes.T @ (slope[:, None] * near_first)
        hessian += crossed + crossed.T
        if path.gate is None:
            hessian += near_bent
        else:
            place = (3 * np.arange(len(near))[:, None] + [0, 1]).ravel()
            hessian[np.ix_(place, place)] += near_bent
            gated = 3 * np.arange(len(near)) + 2
            fall = self.threshold_db2 - path.moments.blind_db2
            hessian[gated, gated] -= 2.0 * fall * near * slope
        return PathDerivatives(float(excess @ near), self.slope(path)[0], hessian)


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


def _half_log_bend(batch: CovarianceDerivatives, weight: Floats) -> Floats:
    """Return the Hessian of 1/2 log det C of one path, from C^-1 = `weight` (N, N)."""
    own, first = batch.owner, batch.first[0]
    pulled = first @ weight
    found = batch.curvature(0.5 * weight)
    found -= pulled[:, own] * pulled[:, own].T
    found -= weight[np.ix_(own, own)] * (pulled @ first.T)
    return found


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
