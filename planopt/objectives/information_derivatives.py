"""The information objectives with exact gradient and Hessian, for solvers.

Criteria T, D, A and V of :mod:`planopt.objectives.path_loss_learning`, and information and
spatial average of :mod:`planopt.objectives.mapping`. Two things differ from the values there: cusps
are rounded (:mod:`planopt.objectives.rounded_kernel`) and only the measurements of the local
channel are used. What a solver returns is to be valued again with the exact posterior. Places that
bring no measurement, or are near to that, count by their gates
(:mod:`planopt.objectives.gated_batch`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import inverse, log_determinant
from planopt.channel.places import require_places
from planopt.objectives.batch import batch_factor
from planopt.objectives.batch_derivatives import (
    BatchDerivatives,
    PathDerivatives,
    Rows,
    add_own_blocks,
    batch_derivatives,
    curvature_of,
)
from planopt.objectives.gated_batch import (
    blind_variance_db2,
    by_places,
    gated_batch,
    gated_rows,
)
from planopt.objectives.local_channel import LocalChannel, LocalGrid
from planopt.objectives.measuring import Gates
from planopt.objectives.path_loss_learning import Criterion
from planopt.objectives.rounded_kernel import rounded_kernel


def path_loss_derivatives(
    channel: LocalChannel,
    path_m: NDArray[np.float64],
    criterion: Criterion,
    gates: Gates | None = None,
) -> PathDerivatives:
    """:func:`planopt.objectives.path_loss_learning.path_loss_value` with derivatives.

    With N = M^-1 + B' S^-1 B the criterion's derivative by N is a positive semidefinite Z = F F'
    (I for T, N^-1 for D, N^-1 G N^-1 for V), and its curvature -c tr(Z dN N^-1 dN), c = 0, 1, 2.
    The part by d^2 N is that of tr(F' B' S^-1 B F).

    Parameters
    ----------
    channel
        The measurements near the path; its theta must not be known unless the criterion is T.
    path_m
        ``(h, 2)``.
    criterion
        What is valued.
    gates
        Of the path; None where all places bring a measurement.
    """
    places = require_places(path_m)
    batch = batch_derivatives(channel, places, universal=False)
    batch = gated_batch(batch, gates, channel.parameters)
    weight = inverse(batch_factor(batch.covariance))
    gained = batch.trend.value.T @ weight @ batch.trend.value
    if criterion.kind == "T":
        gradient, hessian = _trace_form(batch, weight, batch.trend)
        value = float(criterion.value(gained, None))
        return by_places(PathDerivatives(value, gradient, hessian), gates)
    before = np.asarray(np.linalg.inv(channel.theta_covariance), dtype=np.float64)
    spread = np.asarray(np.linalg.inv(before + gained), dtype=np.float64)
    by_n = criterion.slope(gained, before)
    gradient, hessian = _trace_form(batch, weight, batch.trend.times(_root(by_n)))
    # dN = x_i u' + u x_i', see _trace_form.
    x = weight @ batch.trend.value
    u = batch.trend.first - batch.first @ x
    half = x[batch.owner][:, :, None] * u[:, None, :]
    change = half + half.transpose(0, 2, 1)
    bent = np.einsum("pij,qij->pq", by_n @ change, (spread @ change).transpose(0, 2, 1))
    hessian -= (1.0 if criterion.kind == "D" else 2.0) * bent
    value = float(criterion.value(gained, before))
    return by_places(PathDerivatives(value, gradient, hessian), gates)


def path_information_derivatives(
    channel: LocalChannel,
    path_m: NDArray[np.float64],
    universal: bool = True,
    gates: Gates | None = None,
) -> PathDerivatives:
    """:func:`planopt.objectives.mapping.path_information` with derivatives; omega > 0."""
    batch = batch_derivatives(channel, require_places(path_m), universal)
    batch = gated_batch(batch, gates, channel.parameters)
    factor = batch_factor(batch.covariance)
    weight = inverse(factor)
    own = batch.owner
    every = np.arange(len(own))
    pulled = batch.first @ weight
    hessian = curvature_of(batch, 0.5 * weight)
    hessian -= pulled[:, own] * pulled[:, own].T
    hessian -= weight[np.ix_(own, own)] * (pulled @ batch.first.T)
    gradient = pulled[every, own]
    noise = channel.parameters.multipath_std_db**2
    if gates is None:
        floor = len(weight) * 0.5 * np.log(noise)
        return PathDerivatives(0.5 * log_determinant(factor) - float(floor), gradient, hessian)
    # The noise of a gated measurement is kappa + g^2 (omega^2 - kappa).
    gate, blind = gates.value[0], blind_variance_db2(channel.parameters)
    fills = blind + gate * gate * (noise - blind)
    slope = gate * (noise - blind) / fills
    gradient[2::3] -= slope
    hessian[every[2::3], every[2::3]] -= (noise - blind) / fills - 2.0 * slope * slope
    value = 0.5 * (log_determinant(factor) - float(np.log(fills).sum()))
    return by_places(PathDerivatives(value, gradient, hessian), gates)


def average_reduction_derivatives(
    channel: LocalChannel,
    grid: LocalGrid,
    path_m: NDArray[np.float64],
    universal: bool = True,
    gates: Gates | None = None,
) -> PathDerivatives:
    """:func:`planopt.objectives.mapping.average_reduction` with derivatives.

    Parameters
    ----------
    channel
        The measurements near the path.
    grid
        Where the map is wanted, prepared for this channel.
    path_m
        ``(h, 2)``.
    universal
        Count what is not known of theta.
    gates
        Of the path; None where all places bring a measurement.
    """
    places = require_places(path_m)
    batch = batch_derivatives(channel, places, universal)
    kernel = rounded_kernel(places[:, None] - grid.positions_m, channel.parameters)
    explained = batch.phi @ grid.solved
    across = Rows(
        kernel.value - explained[:, 0],
        (kernel.gradient.transpose(0, 2, 1) - explained[:, 1:3]).reshape(2 * len(places), -1),
        kernel.hessian.transpose(0, 2, 1) - explained[:, 3:],
    )
    if universal:
        pulled = batch.trend.times(channel.theta_covariance @ grid.trend.T)
        across = Rows(
            across.value + pulled.value, across.first + pulled.first, across.second + pulled.second
        )
    root = grid.root_weight
    across = Rows(across.value * root, across.first * root, across.second * root)
    batch, across = gated_batch(batch, gates, channel.parameters), gated_rows(across, gates)
    weight = inverse(batch_factor(batch.covariance))
    gradient, hessian = _trace_form(batch, weight, across)
    value = float((across.value * (weight @ across.value)).sum())
    return by_places(PathDerivatives(value, gradient, hessian), gates)


def _trace_form(
    batch: BatchDerivatives, weight: NDArray[np.float64], rows: Rows
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gradient and Hessian of tr(Y' W Y), W = S^-1, Y = `rows`.

    With X = W Y, and for coordinate p of place i: dY = e_i y_p', dS = e_i d_p' + d_p e_i' and
    u_p = y_p - X' d_p, so that R_p = dY - dS X = e_i u_p' - d_p x_i'. Then

        gradient_p = 2 x_i' u_p,
        Hessian_pq = 2 tr(R_p' W R_q) + 2 X . d^2 Y - X X' . d^2 S.
    """
    x = weight @ rows.value
    own = batch.owner
    u = rows.first - batch.first @ x
    xx = x @ x.T
    pulled = batch.first @ weight
    crossed = pulled[:, own].T * (u @ x.T)[:, own]
    hessian = weight[np.ix_(own, own)] * (u @ u.T) - crossed - crossed.T
    hessian += (pulled @ batch.first.T) * xx[np.ix_(own, own)]
    hessian *= 2.0
    hessian += curvature_of(batch, -xx)
    add_own_blocks(hessian, 2.0 * (rows.second @ x[:, :, None])[:, :, 0])
    return 2.0 * (x[own] * u).sum(axis=1), hessian


def _root(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """F with F F' = `matrix` (2, 2), symmetric and positive semidefinite."""
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0.0))
