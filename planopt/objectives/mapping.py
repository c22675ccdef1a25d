"""The value of a path for the map of the channel (equations 4.3 to 4.6), and its derivatives.

`universal` says which variance counts: that as if theta were known (Lemma 2 of [GM11]), or that
with the uncertainty of theta (exact). Where theta is known they are the same.

Derivatives are those of the local channel (:mod:`planopt.objectives.rounded_kernel`). Besides its
kernel, two kinks are rounded: the threshold, within `THRESHOLD_ROUNDING` of the channel's variance,
and the length of a leg, within the kernel's rounding. Beyond these widths the value is that of
the local channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import semidefinite_factor, solve_lower
from planopt.channel.kriging import kriging_terms
from planopt.channel.nearest.local_channel import LocalChannel
from planopt.channel.parameters import ChannelParameters
from planopt.channel.places import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.channel.prediction import combine
from planopt.errors import InputError
from planopt.objectives.batch import (
    KnownPlaces,
    batch_factor,
    batch_of,
    cross_covariance_db2,
    known_places,
)
from planopt.objectives.batch_derivatives import (
    BatchDerivatives,
    PathDerivatives,
    batch_derivatives,
    blind_variance_db2,
    by_places,
    curvature_of,
    gated_batch,
)
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import CUSP_ROUNDING
from planopt.plain_values import require_weights
from planopt.targets.rounding import rounded_length, rounded_positive_part


@dataclass(frozen=True)
class Uncertainty:
    """Settings of J_CH (equation 4.3): where variance counts, and how much nearness does."""

    threshold_db2: float  # sigma_TH^2: variance up to this counts as known
    decay_per_m: float  # zeta >= 0 of psi(d) = exp(-zeta d)
    start_m: tuple[float, float] = (0.0, 0.0)  # Where the robot stands; of the path form only
    universal: bool = True  # Count what is not known of theta


@dataclass(frozen=True, eq=False)
class Region:
    """The region whose map is wanted (equation 4.6; footnote 3 of [GM11])."""

    grid_m: NDArray[np.float64]  # (g, 2) places
    weight: NDArray[np.float64]  # (g,) w_g >= 0; 1 / g each for the spatial average
    universal: bool = True  # Count what is not known of theta

    def __post_init__(self) -> None:
        require_weights(self.weight, len(require_places(self.grid_m)))


def channel_uncertainty(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],  # (n, 2) q, none of them measured: there the power is known
    distance_m: NDArray[np.float64],  # (n,)
    settings: Uncertainty,
) -> NDArray[np.float64]:
    """Return J_CH(q) = max{0, sigma^2(q) - sigma_TH^2} psi(d), dB^2 (equation 4.3); ``(n,)``."""
    terms = kriging_terms(posterior, require_places(positions_m))
    spread = posterior.theta_covariance if settings.universal else np.zeros((2, 2))
    variance = combine(terms, posterior.theta, spread).deviation_db ** 2
    return _above(variance, settings) * np.exp(-settings.decay_per_m * distance_m)


def uncertainty_target(
    posterior: ChannelPosterior,
    allowed_m: NDArray[np.float64],
    distance_m: NDArray[np.float64],
    settings: Uncertainty,
) -> int | None:
    """Return the index of q* = argmax J_CH (equation 4.3) among the allowed places.

    None where no place is above the threshold: the map is good enough. Arguments as
    :func:`channel_uncertainty`; the caller leaves out obstacles and measured places. Of equals the
    first.
    """
    worth = channel_uncertainty(posterior, allowed_m, distance_m, settings)
    best = int(worth.argmax())
    return best if worth[best] > 0.0 else None


def path_uncertainty(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Uncertainty,
    measured: NDArray[np.bool_] | None = None,  # (h,) which places are measured; all unless given
) -> float:
    """Return sum_i max{0, L_ii^2 - sigma_TH^2} psi(l_i), dB^2 (equation 4.4).

    L_ii^2 is the variance at q_i after the earlier places of the path, l_i the length of the path
    up to it from `settings.start_m`. The sum is over the measured places.
    """
    places = require_places(path_m)
    length = np.cumsum(leg_lengths_m(np.vstack([np.asarray(settings.start_m), places])))
    if measured is not None:
        places, length = places[measured], length[measured]
    if not len(places):
        return 0.0
    factor = semidefinite_factor(batch_of(posterior, places).covariance(settings.universal))
    return float(_above(np.diag(factor) ** 2, settings) @ np.exp(-settings.decay_per_m * length))


def path_information(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], universal: bool = True
) -> float:
    """Return 1/2 log det S - h/2 log omega^2, the information on the channel in nats.

    Monotone and submodular in the set of places (equation 4.5). For h = 1 it has the maximiser of
    J_CH with psi = 1 and sigma_TH = 0.
    """
    factor = batch_factor(batch_of(posterior, path_m).covariance(universal))
    return float(np.log(np.diag(factor) / require_multipath_db(posterior)).sum())


def average_reduction(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Region,
    known: KnownPlaces | None = None,
) -> float:
    """Return sum_g w_g (sigma_t^2(g) - sigma_{t+h}^2(g)) in dB^2 (equation 4.6)."""
    near = factored_near(posterior, path_m)
    if known is None or near is not posterior:
        known = known_places(near, settings.grid_m)
    factor = batch_factor(batch_of(posterior, path_m).covariance(settings.universal))
    across = cross_covariance_db2(near, path_m, known, settings.universal)
    return float((solve_lower(factor, across) ** 2).sum(axis=0) @ settings.weight)


def require_multipath_db(posterior: ChannelPosterior) -> float:
    """The deviation omega > 0 of multipath, or an InputError."""
    omega = posterior.parameters.multipath_std_db
    if omega <= 0.0:
        raise InputError(
            "without multipath a measurement is exact, and its information infinite",
            key="multipath_std_db",
            remedy="use the path form or the spatial average",
        )
    return omega


def _above(variance_db2: NDArray[np.float64], settings: Uncertainty) -> NDArray[np.float64]:
    return np.maximum(0.0, variance_db2 - settings.threshold_db2)


THRESHOLD_ROUNDING = 0.01
"""Width of the threshold's rounding as a share of xi^2 + omega^2; it makes the value of a step too
large by at most 3/16 of that width."""


def path_uncertainty_derivatives(
    channel: LocalChannel,
    path_m: NDArray[np.float64],  # (h, 2)
    settings: Uncertainty,
    gates: Gates | None = None,
) -> PathDerivatives:
    """Return :func:`path_uncertainty` with derivatives."""
    places = require_places(path_m)
    batch = batch_derivatives(channel, places, settings.universal)
    batch = gated_batch(batch, gates, channel.parameters)
    lower = batch_factor(batch.covariance)
    left = solve_lower(lower, np.eye(len(lower)))
    along = left @ batch.first.T
    diagonal = np.diag(lower) ** 2
    # With a gate g, L_ii^2 is kappa + g^2 (that of the whole measurement - kappa). Measured from a
    # threshold that is gated alike, what is above it counts g^2 times.
    gate = np.ones(len(places)) if gates is None else gates.value[0]
    blind = blind_variance_db2(channel.parameters)
    fall = settings.threshold_db2 - blind
    worth, slope, bend = rounded_positive_part(
        diagonal - blind - gate * gate * fall, threshold_width_db2(channel.parameters)
    )
    own, every = batch.owner, np.arange(len(places))
    # Of what is above it by the coordinates; see _bent_variances.
    changes = 2.0 * diagonal[:, None] * left[:, own] * along
    if gates is not None:
        changes[every, 2::3] -= np.diag(2.0 * gate * fall)

    width = CUSP_ROUNDING * channel.parameters.decorrelation_m
    near, near_first, near_bent = _nearness(places, settings, width, worth)
    if gates is not None:
        near_first, near_bent = _without_gates(near_first, near_bent)
    hessian = _bent_variances(batch, left, along, diagonal * near * slope)
    if gates is not None:
        gated = 3 * every + 2
        hessian[gated, gated] -= 2.0 * fall * near * slope
    hessian += changes.T @ ((near * bend)[:, None] * changes)
    crossed = changes.T @ (slope[:, None] * near_first)
    hessian += crossed + crossed.T + near_bent
    gradient = (near * slope) @ changes + worth @ near_first
    return by_places(PathDerivatives(float(worth @ near), gradient, hessian), gates)


def _without_gates(
    first: NDArray[np.float64], bent: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives (h, 2 h) and (2 h, 2 h) by places, among coordinates that gates belong to."""
    steps = len(first)
    place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
    wide_first, wide_bent = np.zeros((steps, 3 * steps)), np.zeros((3 * steps, 3 * steps))
    wide_first[:, place] = first
    wide_bent[np.ix_(place, place)] = bent
    return wide_first, wide_bent


def threshold_width_db2(parameters: ChannelParameters) -> float:
    """Within this of sigma_TH^2 the positive part is rounded."""
    return THRESHOLD_ROUNDING * (parameters.shadow_std_db**2 + parameters.multipath_std_db**2)


def _bent_variances(
    batch: BatchDerivatives,
    left: NDArray[np.float64],
    along: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> NDArray[np.float64]:
    """sum_i w_i / L_ii^2 d^2 L_ii^2 for `weight` w; ``(2 h, 2 h)``.

    L_ii^2 is the least of y' S y over y with y_i = 1 and nothing after i; the minimiser is
    L_ii n_i, n_i row i of N = L^-1 = `left`. So its derivative is L_ii^2 n_i' dS n_i, and the
    second one L_ii^2 (n_i' d^2 S n_i - 2 sum_{k<i} (N dS n_i)_k (N dS' n_i)_k). For coordinate p of
    place j, (N dS n_i)_k = N_kj (N D')_ip + (N D')_kp N_ij, N D' = `along`.
    """
    steps = len(left)
    wide = left[:, batch.owner]
    found = curvature_of(batch, left.T @ (weight[:, None] * left))
    for i in range(1, steps):
        moved = wide[:i] * along[i] + along[:i] * wide[i]
        found -= 2.0 * weight[i] * (moved.T @ moved)
    return found


def _nearness(
    places_m: NDArray[np.float64],
    settings: Uncertainty,
    width_m: float,
    worth: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """psi(l_i) (h,), its first derivatives (h, 2 h), and sum_i worth_i d^2 psi(l_i) (2 h, 2 h)."""
    steps, zeta = len(places_m), settings.decay_per_m
    legs = rounded_length(
        np.diff(places_m, axis=0, prepend=np.asarray(settings.start_m)[None]), width_m
    )
    # Rows: legs; columns: coordinates. A leg has its end at its own place, its start at the last.
    first = np.zeros((steps, steps, 2))
    each = np.arange(steps)
    first[each, each] = legs.gradient
    first[each[1:], each[:-1]] = -legs.gradient[1:]
    length_first = np.cumsum(first.reshape(steps, -1), axis=0)
    near = np.exp(-zeta * np.cumsum(legs.value))
    # Leg k is in the lengths of all places from k on.
    pull = np.cumsum((worth * near)[::-1])[::-1]
    bent = np.zeros((steps, 2, steps, 2))
    blocks = (pull[:, None] * legs.hessian)[:, [0, 1, 1, 2]].reshape(steps, 2, 2)
    bent[each, :, each] += blocks
    bent[each[:-1], :, each[:-1]] += blocks[1:]
    bent[each[1:], :, each[:-1]] -= blocks[1:]
    bent[each[:-1], :, each[1:]] -= blocks[1:]
    curved = length_first.T @ ((zeta**2 * worth * near)[:, None] * length_first)
    curved -= zeta * bent.reshape(2 * steps, 2 * steps)
    return near, -zeta * near[:, None] * length_first, curved
