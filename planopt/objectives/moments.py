"""Moments of future measurements along paths (equation 1.11), with adjoints.

S is the covariance of the measurements and B their regressors less the part predicted from earlier
data. A measurement with gate g in [0, 1] is g times the channel power plus noise that restores its
variance to that of an uninformative measurement, kappa = xi^2 + omega^2:

    S_g = G (S - kappa I) G + kappa I,    B_g = G B,    G = diag(g).

A position without a measurement has gate 0, and solvers use smooth gates in between. Gradients
w.r.t. positions follow from the adjoints of S, B and the covariances (:class:`Pull`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.channel.cholesky import unwhiten, whiten
from planopt.channel.joint import joint_terms
from planopt.channel.kriging import KrigingTerms, LocalChannel, LocalGrid, Prediction, combine
from planopt.channel.measurements import decayed_db2, shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters, regressors, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError
from planopt.objectives.measuring import Gates
from planopt.objectives.stage_power import CUSP_ROUNDING, rounded_log_distance
from planopt.parts import require_weights

Real = TypeVar("Real", np.float32, np.float64)

SINGLE = np.float32
"""Type for covariances of many paths, which are only ranked; it saves up to 40 % of the time."""
TINY_M = 1e-9
"""Distance in metres below which the direction between two positions is undefined."""
NUGGET_SHARE = 1e-4
"""Minimum multipath variance as a share of the shadowing variance, for regularity."""


@dataclass(frozen=True, eq=False)
class Region:
    """Region to be mapped: weighted grid positions (equation 4.6; footnote 3 of [GM11])."""

    grid_m: Floats  # (g, 2) positions
    weight: Floats  # (g,) w_g >= 0; 1 / g each for the spatial average

    def __post_init__(self) -> None:
        require_weights(self.weight, len(require_places(self.grid_m)))


def blind_variance_db2(parameters: ChannelParameters) -> float:
    """Return kappa in dB^2, the variance of an uninformative measurement."""
    return parameters.shadow_std_db**2 + parameters.multipath_std_db**2


@dataclass(frozen=True, eq=False)
class Moments:
    """Covariances and regressors of gated measurements along one path or c paths (leading axis)."""

    parameters: ChannelParameters
    positions_m: Floats  # (..., N, 2)
    whole_covariance: Floats  # (..., N, N) S in dB^2 without gates, theta known
    whole_trend: Floats  # (..., N, 2) B without gates
    theta_covariance: Floats  # (2, 2) M; zero if theta is known
    gate: Floats | None  # (..., N); None: all one
    # Returns covariances (..., N, g) with the map for uncertain theta, times the root weights
    map_covariance: Callable[[], NDArray[np.floating]] | None = None

    @property
    def blind_db2(self) -> float:
        """Variance of an uninformative measurement."""
        return blind_variance_db2(self.parameters)

    @cached_property
    def gated_part(self) -> Floats:
        """Matrix S - kappa I ``(..., N, N)`` to multiply by gates, with kappa = `blind_db2`."""
        return self.whole_covariance - self.blind_db2 * np.eye(self.whole_covariance.shape[-1])

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of gated measurements for known path loss as an array ``(..., N, N)``."""
        if self.gate is None:
            return self.whole_covariance
        both = self.gate[..., :, None] * self.gate[..., None, :]
        return both * self.gated_part + self.blind_db2 * np.eye(self.gate.shape[-1])

    @cached_property
    def trend(self) -> Floats:
        """Path-loss regressors of gated measurements as an array ``(..., N, 2)``."""
        return self.whole_trend if self.gate is None else self.gate[..., None] * self.whole_trend

    @cached_property
    def universal(self) -> Floats:
        """Covariance of gated measurements for uncertain path loss as an array ``(..., N, N)``."""
        return self.covariance + self.trend @ self.theta_covariance @ self.trend.swapaxes(-1, -2)

    @cached_property
    def factor(self) -> Floats:
        """Cholesky factors of :attr:`universal`; squared pivots are conditional variances."""
        return covariance_factor(self.universal)

    @cached_property
    def inverse(self) -> Floats:
        """Inverses of :attr:`universal`."""
        return np.asarray(np.linalg.inv(self.universal), dtype=np.float64)

    @cached_property
    def noise_db2(self) -> Floats:
        """Noise variance of each gated measurement as an array ``(..., N)``."""
        noise = np.full(self.positions_m.shape[:-1], self.parameters.multipath_std_db**2)
        if self.gate is None:
            return noise
        return self.blind_db2 + self.gate**2 * (noise - self.blind_db2)

    @cached_property
    def whole_across(self) -> NDArray[np.floating]:
        """Weighted covariances ``(..., N, g)`` of ungated measurements with map positions."""
        if self.map_covariance is None:
            raise AssertionError("the spatial average needs a map")
        return self.map_covariance()

    @cached_property
    def across(self) -> NDArray[np.floating]:
        """Weighted covariances of measurements with map positions as an array ``(..., N, g)``."""
        across = self.whole_across
        return across if self.gate is None else self.gate.astype(across.dtype)[..., None] * across

    def without_gates(self, pull: Pull) -> Pull:
        """Convert adjoints of gated moments to adjoints of ungated moments and gates."""
        gate = self.gate
        if gate is None:
            return pull
        by_gate = np.zeros(gate.shape) if pull.by_gate is None else pull.by_gate.copy()
        by_covariance, by_trend, by_across = pull.by_covariance, pull.by_trend, pull.by_across
        if by_covariance is not None:
            by_gate += 2.0 * np.einsum(
                "...ij,...ij,...j->...i", by_covariance, self.gated_part, gate
            )
            by_covariance = gate[..., :, None] * gate[..., None, :] * by_covariance
        if by_trend is not None:
            by_gate += (by_trend * self.whole_trend).sum(axis=-1)
            by_trend = gate[..., None] * by_trend
        if by_across is not None:
            by_gate += (by_across * self.whole_across).sum(axis=-1, dtype=np.float64)
            by_across = gate.astype(by_across.dtype)[..., None] * by_across
        return Pull(pull.by_position, by_covariance, by_trend, by_across, pull.by_phi, by_gate)


def covariance_factor(covariance_db2: Floats) -> Floats:
    """Return lower Cholesky factors of covariances ``(..., N, N)``."""
    try:
        return np.asarray(np.linalg.cholesky(covariance_db2), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise InputError(
            "visits a position twice, which without multipath gives infinite information",
            key="path_m",
            remedy="give multipath_std_db above 0, or leave repeated positions out",
        ) from None


@dataclass(frozen=True, eq=False)
class KnownPlaces:
    """Map positions with precomputed terms for their covariances with many paths."""

    grid_m: Floats  # (g, 2)
    phi_db2: Floats  # (kappa, g) covariances with the measurements
    trend: Floats  # (g, 2) varphi(g)'


def known_places(posterior: ChannelPosterior, grid_m: Floats) -> KnownPlaces:
    """Return precomputed terms of map positions `grid_m` (g, 2) for a channel posterior."""
    parameters = posterior.parameters
    phi = posterior.covariance_with_db2(grid_m)
    solved = unwhiten(posterior.factor, posterior.whitened_regressors)
    return KnownPlaces(grid_m, phi, regressors(grid_m, parameters.station) - phi.T @ solved)


def cross_covariance_db2(posterior: ChannelPosterior, path_m: Floats, known: KnownPlaces) -> Floats:
    """Return covariances ``(N, g)`` of measurements on a path with the power at map positions."""
    # Shapes: path_m (N, 2).
    # c(q) = k_h(q) - Phi' U^-1 phi(q) + B M varphi(q) (equation 4.6).
    parameters = posterior.parameters
    phi = posterior.covariance_with_db2(path_m)
    solved = unwhiten(posterior.factor, whiten(posterior.factor, phi))
    rows = unwhiten(posterior.factor, posterior.whitened_regressors)
    trend = regressors(path_m, parameters.station) - phi.T @ rows
    covariance = shadow_covariance_db2(path_m, known.grid_m, parameters)
    covariance -= solved.T @ known.phi_db2
    return covariance + trend @ posterior.theta_covariance @ known.trend.T


def posterior_moments(
    posterior: ChannelPosterior,
    path_m: Floats,  # (N, 2)
    taken: Mask | None = None,  # (N,) True where a measurement is taken; None: all
    region: Region | None = None,  # Region of the averaged map
    known: KnownPlaces | None = None,  # Precomputed terms of the region for this posterior
) -> Moments:
    """Return the moments of measurements along a path according to the exact posterior."""
    places = require_places(path_m)
    near = factored_near(posterior, places)
    terms = joint_terms(near, places)
    covariance = 0.5 * (terms.latent_db2 + terms.latent_db2.T)
    covariance[np.diag_indices_from(covariance)] += near.parameters.multipath_std_db**2

    def across() -> Floats:
        if region is None:
            raise AssertionError("the spatial average needs a map")
        grid = known if near is posterior else None
        grid = known_places(near, region.grid_m) if grid is None else grid
        return cross_covariance_db2(near, places, grid) * np.sqrt(region.weight)

    return Moments(
        near.parameters,
        places,
        covariance,
        terms.trend,
        posterior.theta_covariance,
        None if taken is None or taken.all() else taken.astype(np.float64),
        across,
    )


@dataclass(frozen=True, eq=False)
class Pull:
    """Adjoints: derivatives of one scalar per path w.r.t. the path's moments; None means zero."""

    by_position: Floats | None = None  # (c, N, 2) w.r.t. positions, all else fixed
    by_covariance: Floats | None = None  # (c, N, N) w.r.t. S, symmetric
    by_trend: Floats | None = None  # (c, N, 2) w.r.t. B
    by_across: NDArray[np.floating] | None = None  # (c, N, g) w.r.t. the covariances with the map
    # (c, N, m) w.r.t. the covariances with the measurements, S and B fixed
    by_phi: NDArray[np.float32] | None = None
    by_gate: Floats | None = None  # (c, N)

    def plus(self, other: Pull, weight: float = 1.0) -> Pull:
        """Return these adjoints plus `weight` times `other`."""
        return Pull(
            _sum(self.by_position, other.by_position, weight),
            _sum(self.by_covariance, other.by_covariance, weight),
            _sum(self.by_trend, other.by_trend, weight),
            _sum(self.by_across, other.by_across, weight),
            _sum(self.by_phi, other.by_phi, weight),
            _sum(self.by_gate, other.by_gate, weight),
        )


def _sum(a: NDArray[Real] | None, b: NDArray[Real] | None, weight: float) -> NDArray[Real] | None:
    """Return ``a + weight b``; None counts as zero."""
    if b is None:
        return a
    found = b.copy()
    found *= weight
    if a is not None:
        found += a
    return found


def pull_of_lengths(start_m: Floats, paths_m: Floats, by_length: Floats) -> Pull:
    """Return the adjoints of positions from the adjoints `by_length` of step lengths."""
    # Shapes: start_m (2,); paths_m (c, N, 2); by_length (c, N).
    ends = np.concatenate([np.broadcast_to(start_m, (len(paths_m), 1, 2)), paths_m], axis=1)
    legs = np.diff(ends, axis=1)
    length = np.maximum(np.hypot(legs[..., 0], legs[..., 1]), TINY_M)
    found = (by_length / length)[:, :, None] * legs
    found[:, :-1] -= found[:, 1:].copy()
    return Pull(by_position=found)


class LocalPaths:
    """Batched power prediction along c paths by one local channel, with the chain rule."""

    def __init__(
        self,
        channel: LocalChannel,
        precision: NDArray[np.float32],  # (m, m) of the channel
        paths_m: Floats,  # (c, N, 2)
        grid: LocalGrid | None = None,  # Grid of the averaged map, if any
    ) -> None:
        self.channel, self.paths_m, self._grid = channel, paths_m, grid
        parameters = channel.parameters
        places = paths_m.reshape(-1, 2)
        self.shape: tuple[int, int] = (len(paths_m), len(places) // max(len(paths_m), 1))
        self._distance_m, self._phi = _single_kernel(
            places, channel.positions_m, parameters, channel.added_m2
        )
        self._solved = (self._phi @ precision).reshape(*self.shape, -1)
        by_path = self._phi.reshape(*self.shape, -1)
        self.covariance = shadow_covariance_db2(paths_m, paths_m, parameters)  # S, (c, N, N)
        self.covariance -= self._solved @ by_path.transpose(0, 2, 1)
        own = np.arange(self.shape[1])
        least = NUGGET_SHARE * parameters.shadow_std_db**2
        self.covariance[:, own, own] += max(parameters.multipath_std_db**2, least)
        # Double precision, because the covariance of theta may be large.
        projected = self._phi @ np.column_stack([channel.weights, channel.trend])
        self._data_db = projected[:, 0]
        trend = regressors(places, parameters.station) - projected[:, 1:]
        self.trend = trend.reshape(*self.shape, 2)  # B

    def moments(self, gate: Floats | None = None) -> Moments:
        """Return the moments of measurements along the paths for gates (c, N)."""
        return Moments(
            self.channel.parameters,
            self.paths_m,
            self.covariance,
            self.trend,
            self.channel.theta_covariance,
            gate,
            lambda: self._across[2],
        )

    @cached_property
    def power(self) -> Prediction:
        """Power prediction at every position, path by path as an array ``(c N,)``."""
        own = np.arange(self.shape[1])
        terms = KrigingTerms(
            self._data_db, self.trend.reshape(-1, 2), self.covariance[:, own, own].ravel()
        )
        return combine(terms, self.channel.theta, self.channel.theta_covariance)

    @property
    def _map(self) -> LocalGrid:
        if self._grid is None:
            raise AssertionError("the spatial average needs a map")
        return self._grid

    @cached_property
    def _across(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Distances and kernel values ``(c N, g)`` to map positions; covariances ``(c, N, g)``."""
        # The weighted covariance c of equation 4.6 is for uncertain theta.
        channel, grid = self.channel, self._map
        distance, kernel = _single_kernel(
            self.paths_m.reshape(-1, 2), grid.positions_m, channel.parameters
        )
        across = kernel.copy()
        across -= self._phi @ grid.solved.astype(SINGLE)
        along = (channel.theta_covariance @ grid.trend.T).astype(SINGLE)
        across += self.trend.reshape(-1, 2).astype(SINGLE) @ along
        across *= grid.root_weight.astype(SINGLE)
        return distance, kernel, across.reshape(*self.shape, -1)

    def pull_of_power(self, by_mean: Floats, by_deviation: Floats) -> Pull:
        """Return the adjoints of the moments from adjoints of mean and deviation ``(c, N)``."""
        channel, own = self.channel, np.arange(self.shape[1])
        deviation = self.power.deviation_db.reshape(self.shape)
        by_variance = np.zeros((*self.shape, self.shape[1]))
        by_variance[:, own, own] = 0.5 * by_deviation / deviation
        return Pull(
            by_covariance=by_variance,
            by_trend=2.0 * (by_variance @ (self.trend @ channel.theta_covariance))
            + by_mean[:, :, None] * channel.theta,
            by_phi=by_mean.astype(SINGLE)[:, :, None] * channel.weights.astype(SINGLE),
        )

    def slopes(self, pull: Pull, gates: Gates | None = None) -> Floats:
        """Return the gradient ``(c, N, 2)`` w.r.t. positions from adjoints of moments and gates."""
        channel = self.channel
        found, by_phi = np.zeros((*self.shape, 2)), np.zeros_like(self._solved)
        by_trend = pull.by_trend
        if pull.by_position is not None:
            found += pull.by_position
        if pull.by_gate is not None and gates is not None:
            by_place = np.einsum("ci,cia->ca", pull.by_gate, gates.jacobian())
            found += by_place.reshape(found.shape)
        if pull.by_phi is not None:
            by_phi += pull.by_phi
        if pull.by_covariance is not None:
            found += self._between(pull.by_covariance)
            by_phi += (-2.0 * pull.by_covariance).astype(SINGLE) @ self._solved
        if pull.by_across is not None:
            grid, (distance, kernel, _) = self._map, self._across
            by_across = (pull.by_across * grid.root_weight.astype(SINGLE)).reshape(kernel.shape)
            by_map = (by_across @ grid.trend.astype(SINGLE)).astype(np.float64)
            by_map = by_map.reshape(*self.shape, 2) @ channel.theta_covariance
            by_trend = by_map if by_trend is None else by_trend + by_map
            by_phi -= (by_across @ grid.solved.T.astype(SINGLE)).reshape(by_phi.shape)
            found += self._through(by_across, grid.positions_m, distance, kernel)
        if by_trend is not None:
            by_phi -= by_trend.astype(SINGLE) @ channel.trend.T.astype(SINGLE)
            loss = rounded_log_distance(self.paths_m.reshape(-1, 2), channel.parameters.station)
            found += by_trend[:, :, 1:] * loss.gradient.reshape(found.shape)
        by_kernel = by_phi.reshape(self._phi.shape)
        return found + self._through(by_kernel, channel.positions_m, self._distance_m, self._phi)

    def _through(
        self,
        by_kernel: NDArray[np.float32],
        others_m: Floats,
        distance_m: NDArray[np.float32],
        kernel: NDArray[np.float32],
    ) -> Floats:
        """Return the gradient ``(c, N, 2)`` through covariances with positions `others_m`."""
        # d k = -k / (beta r) (q - other), in place of `by_kernel`.
        beta = self.channel.parameters.decorrelation_m
        by_kernel *= kernel
        by_kernel /= np.maximum(distance_m, SINGLE(CUSP_ROUNDING * beta))
        middle = self.paths_m.reshape(-1, 2).mean(axis=0)
        moved = np.column_stack([others_m - middle, np.ones(len(others_m))]).astype(SINGLE)
        pulled = (by_kernel @ moved).astype(np.float64).reshape(*self.shape, 3)
        return (pulled[:, :, :2] - pulled[:, :, 2:] * (self.paths_m - middle)) / beta

    def _between(self, by_covariance: Floats) -> Floats:
        """Return the gradient through prior covariances between positions of the same path."""
        parameters = self.channel.parameters
        beta = parameters.decorrelation_m
        offset = self.paths_m[:, :, None] - self.paths_m[:, None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        kernel = parameters.shadow_std_db**2 * np.exp(-distance / beta)
        slope = -2.0 * by_covariance * kernel / (beta * np.maximum(distance, CUSP_ROUNDING * beta))
        return (slope[..., None] * offset).sum(axis=2)


def _single_kernel(
    a: Floats, b: Floats, parameters: ChannelParameters, added_m2: Floats | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return distances and shadowing covariances ``(n, m)`` between positions `a` and `b`."""
    # Shapes: a (n, 2); b (m, 2); added_m2 (m,), added to the squared distances.
    # Offsets from the mean of `a` are rounded to float32, so coordinates near 3e6 keep their
    # digits.
    middle = a.mean(axis=0)
    from_m, to_m = (a - middle).astype(SINGLE), (b - middle).astype(SINGLE)
    distance = from_m[:, :1] - to_m[:, 0]
    distance *= distance
    dy = from_m[:, 1:] - to_m[:, 1]
    dy *= dy
    distance += dy
    if added_m2 is not None:
        distance += added_m2.astype(SINGLE)
    np.sqrt(distance, out=distance)
    return distance, decayed_db2(distance.copy(), parameters)
