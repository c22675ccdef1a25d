"""The path form of mapping, sum_i max{0, L_ii^2 - sigma_TH^2} psi(l_i), with derivatives.

Besides the kernel's, two kinks are rounded: the threshold, within `THRESHOLD_ROUNDING` of the
channel's variance, and the length of a leg, within the kernel's rounding. Beyond these widths the
value is that of the local channel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower
from planopt.channel.parameters import ChannelParameters
from planopt.channel.places import require_places
from planopt.objectives.batch import batch_factor
from planopt.objectives.batch_derivatives import (
    BatchDerivatives,
    PathDerivatives,
    batch_derivatives,
    curvature_of,
)
from planopt.objectives.gated_batch import blind_variance_db2, by_places, gated_batch
from planopt.objectives.local_channel import LocalChannel
from planopt.objectives.mapping import Uncertainty
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import CUSP_ROUNDING
from planopt.targets.rounding import rounded_length, rounded_positive_part

THRESHOLD_ROUNDING = 0.01
"""Width of the threshold's rounding as a share of xi^2 + omega^2; it makes the value of a step too
large by at most 3/16 of that width."""


def path_uncertainty_derivatives(
    channel: LocalChannel,
    path_m: NDArray[np.float64],
    settings: Uncertainty,
    gates: Gates | None = None,
) -> PathDerivatives:
    """:func:`planopt.objectives.mapping.path_uncertainty` with derivatives.

    Parameters
    ----------
    channel
        The measurements near the path.
    path_m
        ``(h, 2)``.
    settings
        Threshold, decay and start.
    gates
        Of the path; None where all places bring a measurement.
    """
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
