"""Moments of future measurements along paths (equation 1.11).

S is the covariance of the measurements and B their regressors less the part predicted from earlier
data. A measurement with gate g in [0, 1] is g times the channel power plus noise that restores its
variance to that of an uninformative measurement, kappa = xi^2 + omega^2:

    S_g = G (S - kappa I) G + kappa I,    B_g = G B,    G = diag(g).

A position without a measurement has gate 0, and solvers use smooth gates in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask
from planopt.channel.cholesky import unwhiten, whiten
from planopt.channel.joint import joint_terms
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters, regressors, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError
from planopt.parts import require_weights


@dataclass(frozen=True, eq=False)
class Region:
    """Region to be mapped: weighted grid positions (equation 4.6; footnote 3 of [GM11])."""

    grid_m: Floats  # (g, 2) positions
    weight: Floats  # (g,) w_g >= 0; 1 / g each for the spatial average

    def __post_init__(self) -> None:
        require_weights(self.weight, len(require_places(self.grid_m)))


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
        """Variance kappa of an uninformative measurement."""
        return self.parameters.shadow_std_db**2 + self.parameters.multipath_std_db**2

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of gated measurements for known path loss as an array ``(..., N, N)``."""
        if self.gate is None:
            return self.whole_covariance
        both = self.gate[..., :, None] * self.gate[..., None, :]
        blind = self.blind_db2 * np.eye(self.gate.shape[-1])
        return both * (self.whole_covariance - blind) + blind

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
    def known_inverse(self) -> Floats:
        """Inverses of :attr:`covariance`."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)

    @cached_property
    def noise_db2(self) -> Floats:
        """Noise variance of each gated measurement as an array ``(..., N)``."""
        noise = np.full(self.positions_m.shape[:-1], self.parameters.multipath_std_db**2)
        if self.gate is None:
            return noise
        return self.blind_db2 + self.gate**2 * (noise - self.blind_db2)

    @cached_property
    def across(self) -> NDArray[np.floating]:
        """Weighted covariances of measurements with map positions as an array ``(..., N, g)``."""
        if self.map_covariance is None:
            raise AssertionError("the spatial average needs a map")
        across = self.map_covariance()
        return across if self.gate is None else self.gate.astype(across.dtype)[..., None] * across


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
