"""Information that a path gathers on path loss, and information objectives with derivatives.

Criteria T, D, A and V all rest on M_{t+h}^-1 = M_t^-1 + B' S^-1 B, which is exact. [GM11] maximises
the trace of the increment, criterion T. That is scale dependent, (10 log10 d)^2 dominates it and
the robot runs for the far walls; D, the default, and A and V look at what is left unknown instead.

If the measurements do not identify theta, the posterior has a weak prior on it
(:data:`planopt.channel.posterior.WEAK_THETA_DEVIATION`). It is part of M_t and stays in the
plan, so that every criterion is finite from no measurement on.

Derivatives, here also of the information and the spatial average of
:mod:`planopt.objectives.mapping`, differ from the values in two ways: cusps are rounded and only
the measurements of the local channel are used (:mod:`planopt.objectives.rounded_kernel`). The path
that a solver returns is to be valued again with the exact posterior. Places that bring no
measurement, or nearly none, count by their gates (:mod:`planopt.objectives.batch_derivatives`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import inverse, log_determinant, solve_lower
from planopt.channel.kriging import kriging_terms
from planopt.channel.nearest.local_channel import LocalChannel, LocalGrid
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.batch import Batch, batch_factor, batch_of
from planopt.objectives.batch_derivatives import (
    BatchDerivatives,
    PathDerivatives,
    Rows,
    add_own_blocks,
    batch_derivatives,
    blind_variance_db2,
    by_places,
    curvature_of,
    gated_batch,
    gated_rows,
)
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import rounded_kernel
from planopt.plain_values import require_weights

Kind = Literal["T", "D", "A", "V"]


@dataclass(frozen=True, eq=False)
class Criterion:
    """The value of an information matrix N = M_{t+h}^-1; more is better."""

    # T: tr(N - M_t^-1), equation (2) of [GM11]. D: log det N. A: -tr N^-1. V: -tr(G N^-1).
    kind: Kind = "D"
    # (2, 2) G = sum_g w_g varphi(g) varphi(g)', from :func:`goal_criterion`; read by V only
    goal: NDArray[np.float64] = field(default_factory=lambda: np.eye(2))

    def __post_init__(self) -> None:
        if self.kind not in ("T", "D", "A", "V"):
            raise InputError(f"{self.kind!r} is no criterion", key="kind", remedy="T, D, A or V")
        if self.goal.shape != (2, 2):
            raise InputError(f"a goal of shape {self.goal.shape} is not (2, 2)", key="goal")

    def value(
        self, gained: NDArray[np.float64], before: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """The worth of B' S^-1 B = `gained` ``(..., 2, 2)`` on top of `before` = M_t^-1.

        `before` is not read by T and may be None there.
        """
        if self.kind == "T" or before is None:
            return np.asarray(np.trace(gained, axis1=-2, axis2=-1))
        after = before + gained
        if self.kind == "D":
            return np.asarray(np.linalg.slogdet(after)[1])
        spread = np.linalg.inv(after)
        goal = np.eye(2) if self.kind == "A" else self.goal
        return np.asarray(-np.einsum("ij,...ji->...", goal, spread))

    def slope(
        self, gained: NDArray[np.float64], before: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """The derivative of :meth:`value` by `gained`, symmetric; ``(..., 2, 2)``.

        I for T, N^-1 for D, N^-1 G N^-1 for V, with G = I for A.
        """
        if self.kind == "T" or before is None:
            return np.broadcast_to(np.eye(2), gained.shape)
        spread = np.asarray(np.linalg.inv(before + gained), dtype=np.float64)
        if self.kind == "D":
            return spread
        return np.asarray(spread @ (np.eye(2) if self.kind == "A" else self.goal) @ spread)


def goal_criterion(
    posterior: ChannelPosterior, goals_m: NDArray[np.float64], weight: NDArray[np.float64]
) -> Criterion:
    """Return V, -sum_g w_g varphi(g)' M_{t+h} varphi(g): theta where it matters (equation 4.2).

    varphi(g) is today's: what theta adds to the variance at g before the path's
    own measurements are used for shadowing there.
    """
    # Shapes: goals_m (g, 2); weight (g,).
    places = require_places(goals_m)
    trend = kriging_terms(posterior, places).trend
    return Criterion("V", trend.T @ (require_weights(weight, len(places))[:, None] * trend))


def path_loss_value(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], criterion: Criterion
) -> float:
    """Return the criterion's value of measuring at `path_m` (h, 2) (equations 4.1 and 4.2)."""
    rows = _whitened_trend(batch_of(posterior, path_m))
    return float(criterion.value(rows.T @ rows, _before(posterior, criterion)))


def path_loss_gain(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], criterion: Criterion
) -> float:
    """Return the gain of :func:`path_loss_value` over measuring nowhere; 0 at least."""
    nothing = float(criterion.value(np.zeros((2, 2)), _before(posterior, criterion)))
    return path_loss_value(posterior, path_m, criterion) - nothing


def path_loss_steps(
    posterior: ChannelPosterior, path_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``|varphi_{t+i-1}(q_i)|^2 / sigma_{t+i-1}^2(q_i)``, what each step adds to T; ``(h,)``."""
    return (_whitened_trend(batch_of(posterior, path_m)) ** 2).sum(axis=1)


def path_loss_one_step(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], criterion: Criterion
) -> NDArray[np.float64]:
    """The value of a path of one step to each of `positions_m` (n, 2), together; ``(n,)``.

    For T it is ``|varphi(q)|^2 / sigma^2(q)`` with sigma^2 as if theta were known, as in [GM11].
    """
    terms = kriging_terms(posterior, require_places(positions_m))
    gained = terms.trend[:, :, None] * terms.trend[:, None, :]
    gained /= terms.variance_db2[:, None, None]
    return criterion.value(gained, _before(posterior, criterion))


def theta_information(posterior: ChannelPosterior) -> NDArray[np.float64]:
    """``(2, 2)`` M_t^-1, the weak prior in it where the posterior has it."""
    if posterior.theta_known:
        raise InputError(
            "path loss is known: no path can teach anything about it",
            key="theta",
            remedy="condition the channel with theta='estimated'",
        )
    return np.asarray(np.linalg.inv(posterior.theta_covariance), dtype=np.float64)


def _before(posterior: ChannelPosterior, criterion: Criterion) -> NDArray[np.float64] | None:
    return None if criterion.kind == "T" else theta_information(posterior)


def _whitened_trend(batch: Batch) -> NDArray[np.float64]:
    """L^-1 B, whose Gram matrix is B' S^-1 B; ``(h, 2)``."""
    return solve_lower(batch_factor(batch.covariance_db2), batch.trend)


def path_loss_derivatives(
    channel: LocalChannel,
    path_m: NDArray[np.float64],  # (h, 2)
    criterion: Criterion,
    gates: Gates | None = None,
) -> PathDerivatives:
    """Return :func:`path_loss_value` with derivatives.

    With N = M^-1 + B' S^-1 B the criterion's derivative by N is a positive semidefinite Z = F F'
    (I for T, N^-1 for D, N^-1 G N^-1 for V), and its curvature -c tr(Z dN N^-1 dN), c = 0, 1, 2.
    The part by d^2 N is that of tr(F' B' S^-1 B F).
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
    """Return :func:`planopt.objectives.mapping.path_information` with derivatives; omega > 0."""
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
    path_m: NDArray[np.float64],  # (h, 2)
    universal: bool = True,
    gates: Gates | None = None,
) -> PathDerivatives:
    """Return :func:`planopt.objectives.mapping.average_reduction` with derivatives."""
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
