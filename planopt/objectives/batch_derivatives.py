"""S and B of equation 1.11 with derivatives by the path; measurements may count in part.

Row and column i of S, and row i of B, depend on q_i. So the derivative of S by coordinate a of q_i
is ``e_i d' + d e_i'`` with d = D[2 i + a], and only these rows are kept. Coordinates are numbered
x_1, y_1, x_2, y_2, ... throughout.

A measurement of gate g in [0, 1] is one of g times what the channel gives there, with noise that
fills its variance up to that of measuring blindly, kappa = xi^2 + omega^2:

    S_g = G (S - kappa I) G + kappa I,    B_g = G B,    G = diag(g).

With g = 1 that is the measurement itself, with g = 0 one that tells nothing, and every objective of
S and B stays what it is. Each gate is a third coordinate of its place, on which row and column i of
S_g depend as they do on the place, so that with gates 2 h coordinates become 3 h;
:func:`by_places` then puts in how gates change with the places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.nearest.local_channel import LocalChannel
from planopt.channel.parameters import ChannelParameters
from planopt.objectives.measuring import Gates
from planopt.objectives.rounded_kernel import rounded_kernel, rounded_log_distance


@dataclass(frozen=True, eq=False)
class PathDerivatives:
    """An objective of a path of h places with derivatives by its 2 h coordinates."""

    value: float  # The objective
    gradient: NDArray[np.float64]  # (2 h,) by x_1, y_1, x_2,
    hessian: NDArray[np.float64]  # (2 h, 2 h) symmetric


@dataclass(frozen=True, eq=False)
class Rows:
    """r numbers for each place that depend on that place alone, such as the rows of B."""

    value: NDArray[np.float64]  # (h, r)
    first: NDArray[np.float64]  # (2 h, r) by the place's own coordinates
    # (h, 3, r) xx, xy, yy; with gates (h, 6, r), then x, y and the gate by the gate
    second: NDArray[np.float64]

    def times(self, matrix: NDArray[np.float64]) -> Rows:
        """Each row times `matrix` (r, s)."""
        return Rows(self.value @ matrix, self.first @ matrix, self.second @ matrix)


@dataclass(frozen=True, eq=False)
class BatchDerivatives:
    """S of a batch with derivatives, and its B."""

    covariance: NDArray[np.float64]  # (h, h) S
    # (2 h, h) D[2 i + a, k]: of S_ik by coordinate a of q_i; half of it where k = i
    first: NDArray[np.float64]
    # (2 h, 2 h) of S_ij by coordinates of q_i and of q_j; half of that part where j = i
    mixed: NDArray[np.float64]
    # (h, 3, h) of S_ik by two coordinates of q_i, k held; half of that part where k = i
    second: NDArray[np.float64]
    trend: Rows  # B
    phi: NDArray[np.float64]  # (h, 6, m) covariance with the measurements: value, x, y, xx, xy, yy

    @property
    def owner(self) -> NDArray[np.intp]:
        """Number of the place that each coordinate belongs to."""
        steps, count = len(self.covariance), len(self.first)
        return np.repeat(np.arange(steps), count // steps)


def batch_derivatives(
    channel: LocalChannel, path_m: NDArray[np.float64], universal: bool
) -> BatchDerivatives:
    """S, or S + B M B' where `universal`, and B, at `path_m` (h, 2)."""
    parameters, steps = channel.parameters, len(path_m)
    kernel = rounded_kernel(path_m[:, None] - channel.positions_m, parameters, channel.added_m2)
    phi = np.empty((steps, 6, len(channel.positions_m)))
    phi[:, 0] = kernel.value
    phi[:, 1:3] = kernel.gradient.transpose(0, 2, 1)
    phi[:, 3:] = kernel.hessian.transpose(0, 2, 1)
    solved = phi[:, :3].reshape(3 * steps, -1) @ channel.precision
    explained = (phi.reshape(6 * steps, -1) @ solved.T).reshape(steps, 6, steps, 3)

    own = np.arange(steps)
    between = rounded_kernel(path_m[:, None] - path_m, parameters)
    between.value[own, own] = parameters.shadow_std_db**2 + parameters.multipath_std_db**2
    between.hessian[own, own] = 0.0
    trend = _trend(channel, path_m, phi)
    covariance = between.value - explained[:, 0, :, 0]
    first = between.gradient.transpose(0, 2, 1) - explained[:, 1:3, :, 0]
    mixed = -between.hessian[:, :, [[0, 1], [1, 2]]].transpose(0, 2, 1, 3)
    mixed = mixed - explained[:, 1:3, :, 1:]
    second = between.hessian.transpose(0, 2, 1) - explained[:, 3:, :, 0]
    first, mixed = first.reshape(2 * steps, steps), mixed.reshape(2 * steps, 2 * steps)
    if universal:
        pulled = channel.theta_covariance @ trend.value.T
        covariance = covariance + trend.value @ pulled
        first = first + trend.first @ pulled
        mixed = mixed + trend.first @ channel.theta_covariance @ trend.first.T
        second = second + trend.second @ pulled
    return BatchDerivatives(
        0.5 * (covariance + covariance.T), first, 0.5 * (mixed + mixed.T), second, trend, phi
    )


def curvature_of(
    batch: BatchDerivatives, gradient_by_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """sum_ij G_ij d^2 S_ij for symmetric G = `gradient_by_s` (h, h); ``(2 h, 2 h)``."""
    width = len(batch.first) // len(batch.covariance)
    wide = np.repeat(np.repeat(gradient_by_s, width, axis=0), width, axis=1)
    found = 2.0 * wide * batch.mixed
    own = (batch.second @ gradient_by_s[:, :, None])[:, :, 0]
    add_own_blocks(found, 2.0 * own)
    return found


OWN_BLOCKS = {
    3: ((0, 0, 0), (1, 0, 1), (2, 1, 1)),
    6: ((0, 0, 0), (1, 0, 1), (2, 1, 1), (3, 0, 2), (4, 1, 2), (5, 2, 2)),
}
"""Which two of a place's coordinates each of its 3 or 6 second derivatives is by."""


def add_own_blocks(hessian: NDArray[np.float64], own: NDArray[np.float64]) -> None:
    """Add `own` (h, 3), xx, xy, yy of each place, to the diagonal blocks of `hessian`.

    Or ``(h, 6)``, as in :class:`Rows`.
    """
    first = np.arange(0, len(hessian), len(hessian) // len(own))
    for column, a, b in OWN_BLOCKS[int(own.shape[1])]:
        hessian[first + a, first + b] += own[:, column]
        if a != b:
            hessian[first + b, first + a] += own[:, column]


def _trend(channel: LocalChannel, path_m: NDArray[np.float64], phi: NDArray[np.float64]) -> Rows:
    """B = Gamma_h - Phi' A."""
    rows = -phi @ channel.trend
    loss = rounded_log_distance(path_m, channel.parameters.station)
    rows[:, 0, 0] += 1.0
    rows[:, 0, 1] += loss.value
    rows[:, 1:3, 1] += loss.gradient
    rows[:, 3:, 1] += loss.hessian
    return Rows(rows[:, 0], rows[:, 1:3].reshape(-1, 2), rows[:, 3:])


def blind_variance_db2(parameters: ChannelParameters) -> float:
    """kappa, the variance of a measurement that tells nothing."""
    return parameters.shadow_std_db**2 + parameters.multipath_std_db**2


def gated_batch(
    batch: BatchDerivatives, gates: Gates | None, parameters: ChannelParameters
) -> BatchDerivatives:
    """S_g and B_g of a path; `batch` itself without gates."""
    if gates is None:
        return batch
    gate, steps = gates.value[0], len(batch.covariance)
    both = gate[:, None] * gate
    blind = blind_variance_db2(parameters) * np.eye(steps)
    told = batch.covariance - blind
    first = batch.first.reshape(steps, 2, steps)
    wide_first = np.empty((steps, 3, steps))
    wide_first[:, :2] = both[:, None] * first
    wide_first[:, 2] = gate * told
    mixed = np.empty((steps, 3, steps, 3))
    mixed[:, :2, :, :2] = both[:, None, :, None] * batch.mixed.reshape(steps, 2, steps, 2)
    by_gate = gate[:, None, None] * first
    mixed[:, :2, :, 2] = by_gate
    mixed[:, 2, :, :2] = by_gate.transpose(2, 0, 1)
    mixed[:, 2, :, 2] = told
    second = np.zeros((steps, 6, steps))
    second[:, :3] = both[:, None] * batch.second
    second[:, 3:5] = gate * first
    return BatchDerivatives(
        both * told + blind,
        wide_first.reshape(3 * steps, steps),
        mixed.reshape(3 * steps, 3 * steps),
        second,
        gated_rows(batch.trend, gates),
        batch.phi,
    )


def gated_rows(rows: Rows, gates: Gates | None) -> Rows:
    """G times rows that depend on single places; the rows themselves without gates."""
    if gates is None:
        return rows
    gate, steps = gates.value[0], len(rows.value)
    plain = rows.first.reshape(steps, 2, -1)
    first = np.concatenate([gate[:, None, None] * plain, rows.value[:, None]], axis=1)
    second = [gate[:, None, None] * rows.second, plain, np.zeros_like(plain[:, :1])]
    return Rows(
        gate[:, None] * rows.value,
        first.reshape(3 * steps, -1),
        np.concatenate(second, axis=1),
    )


def by_places(found: PathDerivatives, gates: Gates | None) -> PathDerivatives:
    """Turn derivatives by places and gates, (3 h,) and (3 h, 3 h), into those by places."""
    if gates is None:
        return found
    steps = len(found.gradient) // 3
    gradient = found.gradient.reshape(steps, 3)
    place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
    gate = 3 * np.arange(steps) + 2
    jacobian = gates.jacobian()
    crossed = found.hessian[np.ix_(place, gate)] @ jacobian
    hessian = found.hessian[np.ix_(place, place)] + crossed + crossed.T
    hessian += jacobian.T @ found.hessian[np.ix_(gate, gate)] @ jacobian
    hessian += gates.curvature(gradient[:, 2])
    return PathDerivatives(
        found.value, gradient[:, :2].ravel() + gradient[:, 2] @ jacobian, hessian
    )
