"""Moments of measurements along paths by a local channel, with the chain rule to positions.

Only row and column i of S and row i of B depend on q_i. The derivative of S w.r.t. coordinate a of
q_i is therefore ``e_i d' + d e_i'`` with d = D[2 i + a], and only these rows are stored.
Coordinates are ordered x_1, y_1, x_2, y_2, ... A gate is a third coordinate of its position;
:func:`by_positions` substitutes the derivatives of the gates w.r.t. positions. Solvers need second
derivatives of one path, and searches rank hundreds of paths by values and gradients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from planopt.arrays import Derivatives, Floats, Indices
from planopt.channel.kriging import KrigingTerms, LocalChannel, LocalGrid, Prediction, combine
from planopt.objectives.measuring import Gates
from planopt.objectives.moments import Moments
from planopt.objectives.stage_power import fill_rounded_kernel, rounded_log_distance, softened_m2

SINGLE = np.float32
"""Type for covariances of many paths, which are only ranked; it saves up to 40 % of the time."""
NUGGET_SHARE = 1e-4  # Minimum multipath variance in ranking as a share of the shadowing variance
TINY_M2 = 1e-12
"""Squared distance added for ranked paths, so that directions are defined at measured places."""


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
    """Matrices (c, N, r) with derivatives, whose row i depends only on position i of a path."""

    value: Floats  # (c, N, r)
    first: Floats  # (c, 2 N, r) w.r.t. the position's own coordinates
    second: Floats  # (c, N, 3, r) xx, xy, yy; with gates (c, N, 6, r): xx, xy, yy, xg, yg, gg

    def times(self, matrix: Floats) -> Rows:
        """Return the rows times `matrix` (r, s), or scaled by the elements of a vector (r,)."""
        if matrix.ndim == 1:
            return Rows(self.value * matrix, self.first * matrix, self.second * matrix)
        return Rows(self.value @ matrix, self.first @ matrix, self.second @ matrix)

    def gated(self, gate: Floats | None) -> Rows:
        """Return the rows multiplied by gates (c, N); without gates, return them unchanged."""
        if gate is None:
            return self
        count, steps, width = self.value.shape
        factor = gate.astype(self.value.dtype)[:, :, None]
        plain = self.first.reshape(count, steps, 2, width)
        first = np.concatenate([factor[..., None] * plain, self.value[:, :, None]], axis=2)
        second = self.second
        if second.shape[2]:
            parts = [factor[..., None] * second, plain, np.zeros_like(plain[:, :, :1])]
            second = np.concatenate(parts, axis=2)
        return Rows(factor * self.value, first.reshape(count, 3 * steps, width), second)


@dataclass(frozen=True, eq=False)
class CovarianceDerivatives:
    """Covariance matrices S of the measurements along paths, with derivatives w.r.t. positions."""

    value: Floats  # (c, N, N) S
    first: Floats  # (c, 2 N, N) D[2 i + a, k]: dS_ik by coordinate a of q_i; half of it if k = i
    mixed: Floats  # (c, 2 N, 2 N) d^2 S_ij by coordinates of q_i and q_j; half of it if j = i
    second: Floats  # (c, N, 3, N) d^2 S_ik by two coordinates of q_i; half of it if k = i

    @property
    def owner(self) -> Indices:
        """Index of each coordinate's position."""
        steps, count = int(self.value.shape[1]), int(self.first.shape[1])
        return np.repeat(np.arange(steps), count // steps)

    def slope(self, by_s: Floats) -> Floats:
        """Return the gradients (c, 2 N) of sum_ij G_ij S_ij for symmetric G = `by_s` (c, N, N)."""
        return 2.0 * np.einsum("cpk,cpk->cp", self.first, by_s[:, self.owner])

    def curvature(self, by_s: Floats) -> Floats:
        """Return the Hessian (2 N, 2 N) of sum_ij G_ij S_ij of one path, for G = `by_s` (N, N)."""
        own = self.owner
        found = 2.0 * by_s[np.ix_(own, own)] * self.mixed[0]
        add_own_blocks(found, 2.0 * (self.second[0] @ by_s[:, :, None])[:, :, 0])
        return found

    def gated(self, gate: Floats | None, blind_db2: float) -> CovarianceDerivatives:
        """Return the covariance S_g of gated measurements; without gates, S unchanged."""
        if gate is None:
            return self
        count, steps = gate.shape
        both = gate[:, :, None] * gate[:, None]
        blind = blind_db2 * np.eye(steps)
        part = self.value - blind
        first = self.first.reshape(count, steps, 2, steps)
        wide_first = np.empty((count, steps, 3, steps))
        wide_first[:, :, :2] = both[:, :, None] * first
        wide_first[:, :, 2] = gate[:, None] * part
        mixed, second = self.mixed, self.second
        if second.shape[2]:
            plain = mixed.reshape(count, steps, 2, steps, 2)
            wide = np.empty((count, steps, 3, steps, 3))
            wide[:, :, :2, :, :2] = both[:, :, None, :, None] * plain
            by_gate = gate[:, :, None, None] * first
            wide[:, :, :2, :, 2] = by_gate
            wide[:, :, 2, :, :2] = by_gate.transpose(0, 3, 1, 2)
            wide[:, :, 2, :, 2] = part
            mixed = wide.reshape(count, 3 * steps, 3 * steps)
            second = np.zeros((count, steps, 6, steps))
            second[:, :, :3] = both[:, :, None] * self.second
            second[:, :, 3:5] = gate[:, None, None] * first
        return CovarianceDerivatives(
            both * part + blind, wide_first.reshape(count, 3 * steps, steps), mixed, second
        )


class LocalPaths:
    """Power and measurements along c paths by one local channel, with derivatives if asked for."""

    def __init__(
        self,
        channel: LocalChannel,
        paths_m: Floats,  # (c, N, 2)
        gate: Floats | None = None,  # (c, N); None: all one
        grid: LocalGrid | None = None,  # Grid of the averaged map, if any
        order: int = 2,  # Highest derivatives; below 2 paths are ranked, in single precision
    ) -> None:
        self.channel, self.paths_m, self.gate, self.order = channel, paths_m, gate, order
        self._grid = grid
        self.shape: tuple[int, int] = (len(paths_m), paths_m.shape[1])
        self.type: Any = np.float64 if order == 2 else SINGLE
        # (c, N, 6, m) covariance with the measurements: value, x, y, xx, xy, yy
        self._phi = self._kernel(channel.positions_m, channel.added_m2)
        # Only second derivatives need the products of the first.
        precision: Floats = channel.precision if order == 2 else channel.single_precision
        self._solved = self._phi[:, :, : 3 if order == 2 else 1] @ precision

    def _kernel(self, others_m: Floats, added_m2: Floats | float = 0.0) -> Floats:
        """Return the covariance (c, N, 1, 3 or 6, m) with positions (m, 2), and derivatives."""
        parameters, parts = self.channel.parameters, (1, 3, 6)[self.order]
        # Offsets from the mean position, so that single precision keeps digits of coordinates.
        middle = self.paths_m.mean(axis=(0, 1))
        here, there = (each - middle for each in (self.paths_m, others_m))
        here, there = here.astype(self.type), there.astype(self.type)
        soft_m2 = softened_m2(added_m2, parameters) if self.order == 2 else added_m2 + TINY_M2
        found: Floats = np.empty((*self.shape, parts, len(others_m)), dtype=self.type)
        fill_rounded_kernel(
            found.transpose(2, 0, 1, 3),
            here[..., :1] - there[:, 0],
            here[..., 1:] - there[:, 1],
            parameters,
            np.asarray(soft_m2, dtype=self.type),
        )
        return found

    @cached_property
    def _sums(self) -> Floats:
        """Weighted sums (c, N, 1, 3 or 6, 3) of covariances: powers, path-loss regressors."""
        columns, phi = self.channel.weights_and_trend, self._phi
        # Values in double precision, because the covariance of theta may be large.
        found = np.empty((*phi.shape[:3], 3))
        found[:, :, 0] = phi[:, :, 0] @ columns
        if self.order:
            found[:, :, 1:] = phi[:, :, 1:] @ columns.astype(self.type)
        return found

    @cached_property
    def plain_trend(self) -> Rows:
        """Path-loss regressors of ungated measurements."""
        found = -self._sums[..., 1:]
        loss = rounded_log_distance(self.paths_m.reshape(-1, 2), self.channel.parameters.station)
        found[:, :, 0, 0] += 1.0
        found[..., 1] += loss.rows[:, : found.shape[2]].reshape(found.shape[:3])
        first = found[:, :, 1:3].reshape(len(found), -1, 2)
        return Rows(found[:, :, 0], first, found[:, :, 3:])

    @cached_property
    def _known(self) -> CovarianceDerivatives:
        """Covariance of ungated measurements for known path loss."""
        (count, steps), parameters = self.shape, self.channel.parameters
        parts, solved = self._phi.shape[2], self._solved.shape[2]
        explained = self._phi.reshape(count, parts * steps, -1) @ self._solved.reshape(
            count, solved * steps, -1
        ).swapaxes(1, 2)
        explained = explained.reshape(count, steps, parts, steps, solved)
        between = np.empty((parts, count, steps, steps))
        x, y = (self.paths_m[..., axis, None] - self.paths_m[:, None, :, axis] for axis in (0, 1))
        soft_m2 = softened_m2(0.0, parameters) if self.order == 2 else TINY_M2
        fill_rounded_kernel(between, x, y, parameters, soft_m2)
        own, noise_db2 = np.arange(steps), parameters.multipath_std_db**2
        if self.order < 2:
            noise_db2 = max(noise_db2, NUGGET_SHARE * parameters.shadow_std_db**2)
        else:
            between[3:, :, own, own] = 0.0
        between[0, :, own, own] = parameters.shadow_std_db**2 + noise_db2
        value = between[0] - explained[:, :, 0, :, 0]
        rest = between[1:].transpose(1, 2, 0, 3) - explained[:, :, 1:, :, 0]
        mixed = np.zeros((count, 0, 0))
        if self.order == 2:
            crossed = -between[[[3, 4], [4, 5]]].transpose(2, 3, 0, 4, 1)
            mixed = (crossed - explained[:, :, 1:3, :, 1:]).reshape(count, 2 * steps, 2 * steps)
            mixed = 0.5 * (mixed + mixed.swapaxes(1, 2))
        return CovarianceDerivatives(
            0.5 * (value + value.swapaxes(1, 2)),
            rest[:, :, :2].reshape(count, -1, steps),
            mixed,
            rest[:, :, 2:],
        )

    @cached_property
    def plain_universal(self) -> CovarianceDerivatives:
        """Covariance of ungated measurements for uncertain path loss."""
        known, trend, spread = self._known, self.plain_trend, self.channel.theta_covariance
        pulled = spread @ trend.value.swapaxes(1, 2)
        mixed, second = known.mixed, known.second
        if self.order == 2:
            mixed = mixed + trend.first @ spread @ trend.first.swapaxes(1, 2)
            mixed = 0.5 * (mixed + mixed.swapaxes(1, 2))
            second = second + trend.second @ pulled[:, None]
        first = known.first + trend.first @ pulled
        return CovarianceDerivatives(known.value + trend.value @ pulled, first, mixed, second)

    @cached_property
    def covariance(self) -> CovarianceDerivatives:
        """Covariance of gated measurements for known path loss."""
        return self._known.gated(self.gate, self.moments.blind_db2)

    @cached_property
    def universal(self) -> CovarianceDerivatives:
        """Covariance of gated measurements for uncertain path loss."""
        return self.plain_universal.gated(self.gate, self.moments.blind_db2)

    @cached_property
    def trend(self) -> Rows:
        """Path-loss regressors of gated measurements."""
        return self.plain_trend.gated(self.gate)

    @cached_property
    def _plain_across(self) -> Rows:
        """Covariances of ungated measurements with map positions, times roots of map weights."""
        grid, count = self._grid, len(self.paths_m)
        if grid is None:
            raise AssertionError("the spatial average needs a map")
        found = self._kernel(grid.positions_m)
        found -= self._phi @ grid.solved.astype(self.type)
        trend, along = self.plain_trend, self.channel.theta_covariance @ grid.trend.T
        root = grid.root_weight.astype(self.type)
        across = Rows(
            found[:, :, 0], found[:, :, 1:3].reshape(count, -1, len(root)), found[:, :, 3:]
        )
        for own, rows in (
            (across.value, trend.value),
            (across.first, trend.first),
            (across.second, trend.second),
        ):
            own += rows.astype(self.type) @ along.astype(self.type)
        return across.times(root)

    @cached_property
    def across(self) -> Rows:
        """Covariances of gated measurements with map positions, times roots of map weights."""
        return self._plain_across.gated(self.gate)

    @cached_property
    def moments(self) -> Moments:
        """Moments of the gated measurements."""
        return Moments(
            self.channel.parameters,
            self.paths_m,
            self._known.value,
            self.plain_trend.value,
            self.channel.theta_covariance,
            self.gate,
            lambda: self._plain_across.value,
        )

    @cached_property
    def power(self) -> Prediction:
        """Power prediction at every position, path by path as an array ``(c N,)``."""
        variance, trend = np.diagonal(self._known.value, axis1=1, axis2=2), self.plain_trend
        data = self._sums[:, :, 0, 0]
        terms = KrigingTerms(data.ravel(), trend.value.reshape(-1, 2), variance.ravel())
        return combine(terms, self.channel.theta, self.channel.theta_covariance)

    @cached_property
    def power_mean(self) -> Derivatives:
        """Predicted mean power at every position, path by path."""
        theta, trend, rest = self.channel.theta, self.plain_trend, self._sums[:, :, 1:, 0]
        places, parts = len(self.power.mean_db), rest.shape[2] - 2
        first = trend.first @ theta + rest[:, :, :2].reshape(len(rest), -1)
        second = trend.second @ theta + rest[:, :, 2:]
        return Derivatives(
            self.power.mean_db, first.reshape(places, 2), second.reshape(places, parts)
        )

    def power_slope(self, by_mean: Floats, by_deviation: Floats) -> Floats:
        """Return gradients (c, N, 2) from those w.r.t. mean and deviation of the power (c, N)."""
        (count, steps), own = self.shape, np.arange(self.shape[1])
        first = self.plain_universal.first.reshape(count, steps, 2, steps)[:, own, :, own]
        deviation = self.power.deviation_db.reshape(self.shape)
        by_variance = (by_deviation / deviation)[..., None] * first.swapaxes(0, 1)
        return by_variance + by_mean[..., None] * self.power_mean.gradient.reshape(count, steps, 2)


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


def slope_by_positions(gradient: Floats, gates: Gates | None) -> Floats:
    """Eliminate the gates from gradients (c, 2 N or 3 N); return them by positions, (c, N, 2)."""
    count = len(gradient)
    if gates is None:
        return gradient.reshape(count, -1, 2)
    by_place = gradient.reshape(count, -1, 3)
    through = np.einsum("ci,cia->ca", by_place[..., 2], gates.jacobian())
    return by_place[..., :2] + through.reshape(count, -1, 2)


def by_positions(found: PathDerivatives, gates: Gates | None) -> PathDerivatives:
    """Eliminate the gates by the chain rule and return derivatives w.r.t. positions only."""
    if gates is None:
        return found
    steps = len(found.gradient) // 3
    place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
    gate = 3 * np.arange(steps) + 2
    (jacobian,) = gates.jacobian()
    crossed = found.hessian[np.ix_(place, gate)] @ jacobian
    hessian = found.hessian[np.ix_(place, place)] + crossed + crossed.T
    hessian += jacobian.T @ found.hessian[np.ix_(gate, gate)] @ jacobian
    hessian += gates.curvature(found.gradient[gate])
    return PathDerivatives(
        found.value, found.gradient[place] + found.gradient[gate] @ jacobian, hessian
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
    """Return the derivatives ``(..., h, 2 h)`` of step lengths (..., h) w.r.t. all coordinates."""
    steps = int(lengths.value.shape[-1])
    found, k = np.zeros((*lengths.value.shape, steps, 2)), np.arange(steps)
    found[..., k, k, :] = lengths.gradient
    found[..., k[1:], k[:-1], :] = -lengths.gradient[..., 1:, :]
    return found.reshape(*lengths.value.shape, 2 * steps)
