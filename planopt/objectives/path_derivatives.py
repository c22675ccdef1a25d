"""First and second derivatives of the moments of one path, with the chain rule to its positions.

Only row and column i of S and row i of B depend on q_i. The derivative of S w.r.t. coordinate a of
q_i is therefore ``e_i d' + d e_i'`` with d = D[2 i + a], and only these rows are stored.
Coordinates are ordered x_1, y_1, x_2, y_2, ... A gate is a third coordinate of its position;
:func:`by_positions` substitutes the derivatives of the gates w.r.t. positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planopt.arrays import Derivatives, Floats, Indices
from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.parameters import require_places
from planopt.objectives.measuring import Gates
from planopt.objectives.moments import blind_variance_db2
from planopt.objectives.stage_power import rounded_kernel, rounded_log_distance


@dataclass(frozen=True, eq=False)
class PathDerivatives:
    """Objective value of a path, with derivatives w.r.t. the 2 h coordinates of h positions."""

    value: float  # Objective value
    gradient: Floats  # (2 h,) w.r.t. x_1, y_1, x_2, ...
    hessian: Floats  # (2 h, 2 h) symmetric

    def plus(self, other: PathDerivatives, weight: float = 1.0) -> PathDerivatives:
        """Return the sum of this objective and `weight` times `other`."""
        return PathDerivatives(
            self.value + weight * other.value,
            self.gradient + weight * other.gradient,
            self.hessian + weight * other.hessian,
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Matrix (h, r) with derivatives, whose row i depends only on position i of a path."""

    value: Floats  # (h, r)
    first: Floats  # (2 h, r) w.r.t. the position's own coordinates
    second: Floats  # (h, 3, r) xx, xy, yy; with gates (h, 6, r): xx, xy, yy, xg, yg, gg

    def times(self, matrix: Floats) -> Rows:
        """Return the rows times `matrix` (r, s), or scaled by the elements of a vector (r,)."""
        if matrix.ndim == 1:
            return Rows(self.value * matrix, self.first * matrix, self.second * matrix)
        return Rows(self.value @ matrix, self.first @ matrix, self.second @ matrix)

    def gated(self, gates: Gates | None) -> Rows:
        """Return the rows multiplied by gates; without gates, return them unchanged."""
        if gates is None:
            return self
        gate, steps = gates.value[0], len(self.value)
        plain = self.first.reshape(steps, 2, -1)
        first = np.concatenate([gate[:, None, None] * plain, self.value[:, None]], axis=1)
        second = [gate[:, None, None] * self.second, plain, np.zeros_like(plain[:, :1])]
        return Rows(
            gate[:, None] * self.value, first.reshape(3 * steps, -1), np.concatenate(second, axis=1)
        )


@dataclass(frozen=True, eq=False)
class CovarianceDerivatives:
    """Covariance matrix S of a path's measurements, with derivatives w.r.t. positions."""

    value: Floats  # (h, h) S
    first: Floats  # (2 h, h) D[2 i + a, k]: dS_ik w.r.t. coordinate a of q_i; half of it if k = i
    mixed: Floats  # (2 h, 2 h) d^2 S_ij w.r.t. coordinates of q_i and q_j; half of it if j = i
    second: Floats  # (h, 3, h) d^2 S_ik w.r.t. two coordinates of q_i; half of it if k = i

    @property
    def owner(self) -> Indices:
        """Index of each coordinate's position."""
        steps, count = len(self.value), len(self.first)
        return np.repeat(np.arange(steps), count // steps)

    def curvature(self, gradient_by_s: Floats) -> Floats:
        """Return the Hessian ``(2 h, 2 h)`` of sum_ij G_ij S_ij for G = `gradient_by_s`."""
        width = len(self.first) // len(self.value)
        wide = np.repeat(np.repeat(gradient_by_s, width, axis=0), width, axis=1)
        found = 2.0 * wide * self.mixed
        own = (self.second @ gradient_by_s[:, :, None])[:, :, 0]
        add_own_blocks(found, 2.0 * own)
        return found

    def gated(self, gates: Gates | None, blind_db2: float) -> CovarianceDerivatives:
        """Return the covariance S_g of gated measurements; without gates, S unchanged."""
        if gates is None:
            return self
        gate, steps = gates.value[0], len(self.value)
        both = gate[:, None] * gate
        blind = blind_db2 * np.eye(steps)
        part = self.value - blind
        first = self.first.reshape(steps, 2, steps)
        wide_first = np.empty((steps, 3, steps))
        wide_first[:, :2] = both[:, None] * first
        wide_first[:, 2] = gate * part
        mixed = np.empty((steps, 3, steps, 3))
        mixed[:, :2, :, :2] = both[:, None, :, None] * self.mixed.reshape(steps, 2, steps, 2)
        by_gate = gate[:, None, None] * first
        mixed[:, :2, :, 2] = by_gate
        mixed[:, 2, :, :2] = by_gate.transpose(2, 0, 1)
        mixed[:, 2, :, 2] = part
        second = np.zeros((steps, 6, steps))
        second[:, :3] = both[:, None] * self.second
        second[:, 3:5] = gate * first
        return CovarianceDerivatives(
            both * part + blind,
            wide_first.reshape(3 * steps, steps),
            mixed.reshape(3 * steps, 3 * steps),
            second,
        )


class LocalPath:
    """Moments of measurements along a path (h, 2) by a local channel, with derivatives."""

    def __init__(
        self,
        channel: LocalChannel,
        path_m: Floats,  # (h, 2)
        gates: Gates | None = None,
        grid: LocalGrid | None = None,  # Grid of the averaged map, if any
    ) -> None:
        self.channel, self.gates, self._grid = channel, gates, grid
        self.path_m, self.steps = require_places(path_m), len(path_m)
        kernel = rounded_kernel(
            path_m[:, None] - channel.positions_m, channel.parameters, channel.added_m2
        )
        # (h, 6, m) covariance with the measurements: value, x, y, xx, xy, yy
        self._phi = np.empty((self.steps, 6, len(channel.positions_m)))
        self._phi[:, 0] = kernel.value
        self._phi[:, 1:3] = kernel.gradient.transpose(0, 2, 1)
        self._phi[:, 3:] = kernel.hessian.transpose(0, 2, 1)

    @property
    def blind_db2(self) -> float:
        """Variance of an uninformative measurement."""
        return blind_variance_db2(self.channel.parameters)

    @cached_property
    def plain_trend(self) -> Rows:
        """Path-loss regressors of ungated measurements."""
        parameters, phi = self.channel.parameters, self._phi
        loss = rounded_log_distance(self.path_m, parameters.station)
        # b = (1, gamma) - trend' phi.
        rows = -phi @ self.channel.trend
        rows[:, 0] += np.column_stack([np.ones(self.steps), loss.value])
        rows[:, 1:3, 1] += loss.gradient
        rows[:, 3:, 1] += loss.hessian
        return Rows(rows[:, 0], rows[:, 1:3].reshape(-1, 2), rows[:, 3:])

    @cached_property
    def _known(self) -> CovarianceDerivatives:
        """Covariance of ungated measurements for known path loss."""
        channel, steps, phi = self.channel, self.steps, self._phi
        parameters, own = channel.parameters, np.arange(self.steps)
        solved = phi[:, :3].reshape(3 * steps, -1) @ channel.precision
        explained = (phi.reshape(6 * steps, -1) @ solved.T).reshape(steps, 6, steps, 3)
        between = rounded_kernel(self.path_m[:, None] - self.path_m, parameters)
        between.value[own, own] = self.blind_db2
        between.hessian[own, own] = 0.0
        covariance = between.value - explained[:, 0, :, 0]
        first = between.gradient.transpose(0, 2, 1) - explained[:, 1:3, :, 0]
        mixed = -between.hessian[:, :, [[0, 1], [1, 2]]].transpose(0, 2, 1, 3)
        mixed = (mixed - explained[:, 1:3, :, 1:]).reshape(2 * steps, 2 * steps)
        second = between.hessian.transpose(0, 2, 1) - explained[:, 3:, :, 0]
        return CovarianceDerivatives(
            0.5 * (covariance + covariance.T),
            first.reshape(2 * steps, steps),
            0.5 * (mixed + mixed.T),
            second,
        )

    @cached_property
    def plain_universal(self) -> CovarianceDerivatives:
        """Covariance of ungated measurements for uncertain path loss."""
        known, trend, spread = self._known, self.plain_trend, self.channel.theta_covariance
        pulled = spread @ trend.value.T
        mixed = known.mixed + trend.first @ spread @ trend.first.T
        return CovarianceDerivatives(
            known.value + trend.value @ pulled,
            known.first + trend.first @ pulled,
            0.5 * (mixed + mixed.T),
            known.second + trend.second @ pulled,
        )

    @cached_property
    def covariance(self) -> CovarianceDerivatives:
        """Covariance of gated measurements for known path loss."""
        return self._known.gated(self.gates, self.blind_db2)

    @cached_property
    def universal(self) -> CovarianceDerivatives:
        """Covariance of gated measurements for uncertain path loss."""
        return self.plain_universal.gated(self.gates, self.blind_db2)

    @cached_property
    def trend(self) -> Rows:
        """Path-loss regressors of gated measurements."""
        return self.plain_trend.gated(self.gates)

    @cached_property
    def across(self) -> Rows:
        """Covariances of measurements with map positions, times square roots of map weights."""
        channel, grid, steps = self.channel, self._grid, self.steps
        if grid is None:
            raise AssertionError("the spatial average needs a map")
        kernel = rounded_kernel(self.path_m[:, None] - grid.positions_m, channel.parameters)
        explained = self._phi @ grid.solved
        by_theta = self.plain_trend.times(channel.theta_covariance @ grid.trend.T)
        first = kernel.gradient.transpose(0, 2, 1) - explained[:, 1:3]
        across = Rows(
            kernel.value - explained[:, 0] + by_theta.value,
            first.reshape(2 * steps, -1) + by_theta.first,
            kernel.hessian.transpose(0, 2, 1) - explained[:, 3:] + by_theta.second,
        )
        return across.times(grid.root_weight).gated(self.gates)

    @cached_property
    def power_mean(self) -> Derivatives:
        """Predicted mean power at every position, dBm."""
        channel, trend = self.channel, self.plain_trend
        power = self._phi @ channel.weights
        return Derivatives(
            trend.value @ channel.theta + power[:, 0],
            trend.first.reshape(self.steps, 2, 2) @ channel.theta + power[:, 1:3],
            trend.second @ channel.theta + power[:, 3:],
        )


OWN_BLOCKS = {
    3: ((0, 0, 0), (1, 0, 1), (2, 1, 1)),
    6: ((0, 0, 0), (1, 0, 1), (2, 1, 1), (3, 0, 2), (4, 1, 2), (5, 2, 2)),
}
"""Column and coordinate pair of each second derivative of a position: 3, or 6 with a gate."""


def add_own_blocks(hessian: Floats, own: Floats) -> None:
    """Add second derivatives `own` (xx, xy, yy per position) to the diagonal of `hessian`."""
    # With gates `own` is ``(h, 6)``, as in `Rows`.
    first = np.arange(0, len(hessian), len(hessian) // len(own))
    for column, a, b in OWN_BLOCKS[int(own.shape[1])]:
        hessian[first + a, first + b] += own[:, column]
        if a != b:
            hessian[first + b, first + a] += own[:, column]


def by_positions(found: PathDerivatives, gates: Gates | None) -> PathDerivatives:
    """Eliminate the gates by the chain rule and return derivatives w.r.t. positions only."""
    if gates is None:
        return found
    steps = len(found.gradient) // 3
    gradient = found.gradient.reshape(steps, 3)
    place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
    gate = 3 * np.arange(steps) + 2
    (jacobian,) = gates.jacobian()
    crossed = found.hessian[np.ix_(place, gate)] @ jacobian
    hessian = found.hessian[np.ix_(place, place)] + crossed + crossed.T
    hessian += jacobian.T @ found.hessian[np.ix_(gate, gate)] @ jacobian
    hessian += gates.curvature(gradient[:, 2])
    return PathDerivatives(
        found.value, gradient[:, :2].ravel() + gradient[:, 2] @ jacobian, hessian
    )


def by_stages(
    value: float, gradient: Floats, hessian: Floats, inputs: Sequence[Derivatives]
) -> PathDerivatives:
    """Return a value's derivatives w.r.t. positions, by the chain rule through stage inputs."""
    # Shapes: gradient (h, c); hessian (h, c, h, c).
    steps = len(gradient)
    slopes = np.stack([each.gradient for each in inputs], axis=1)
    bent = np.stack([each.hessian for each in inputs], axis=1)
    inner = np.einsum("kcld,ldb->kclb", hessian, slopes)
    found = np.einsum("kclb,kca->kalb", inner, slopes).reshape(2 * steps, 2 * steps)
    add_own_blocks(found, np.einsum("kc,kcx->kx", gradient, bent))
    return PathDerivatives(value, np.einsum("kc,kca->ka", gradient, slopes).ravel(), found)


def by_lengths(
    lengths: Derivatives,  # (h,) step lengths with derivatives w.r.t. offsets
    gradient: Floats,  # (h,) gradient w.r.t. lengths
) -> tuple[Floats, Floats]:
    """Return gradient (2 h,) and Hessian part (2 h, 2 h) of a function of step lengths."""
    count = len(gradient)
    slope = gradient[:, None] * lengths.gradient
    slope[:-1] -= slope[1:].copy()
    blocks = (gradient[:, None] * lengths.hessian)[:, [0, 1, 1, 2]].reshape(count, 2, 2)
    hessian = np.zeros((count, 2, count, 2))
    k = np.arange(count)
    hessian[k, :, k] += blocks
    hessian[k[:-1], :, k[:-1]] += blocks[1:]
    hessian[k[:-1], :, k[1:]] -= blocks[1:]
    hessian[k[1:], :, k[:-1]] -= blocks[1:]
    return slope.ravel(), hessian.reshape(2 * count, 2 * count)


def length_jacobian(lengths: Derivatives) -> Floats:
    """Return the derivatives ``(h, 2 h)`` of all step lengths w.r.t. all coordinates."""
    steps = len(lengths.value)
    found, k = np.zeros((steps, steps, 2)), np.arange(steps)
    found[k, k] = lengths.gradient
    found[k[1:], k[:-1]] = -lengths.gradient[1:]
    return found.reshape(steps, 2 * steps)
