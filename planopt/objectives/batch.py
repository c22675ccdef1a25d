"""A batch of future measurements: S, B and mu of equation 1.11, and covariances with them.

Learning path loss and mapping the channel both ask what is known after the robot has measured at
q_1 .. q_h. That does not depend on the values it will measure, only on these terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import unwhiten, whiten
from planopt.channel.joint import joint_terms
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class Batch:
    """Moments of h future measurements, given those there are (equation 1.11)."""

    mean_db: NDArray[np.float64]  # (h,) mu, dBm
    covariance_db2: NDArray[np.float64]  # (h, h) S, as if theta were known
    trend: NDArray[np.float64]  # (h, 2) B: row i is varphi(q_i)'
    theta_covariance: NDArray[np.float64]  # (2, 2) M; zero where theta is known

    def covariance(self, universal: bool) -> NDArray[np.float64]:
        """S, or S + B M B' (`universal`) that counts what is not known of theta; ``(h, h)``."""
        if not universal:
            return self.covariance_db2
        return self.covariance_db2 + self.trend @ self.theta_covariance @ self.trend.T


def batch_of(posterior: ChannelPosterior, path_m: NDArray[np.float64]) -> Batch:
    """The terms for measuring at `path_m` (h, 2); O(kappa^2 h).

    From all measurements, or from those near where they are very many
    (:func:`planopt.channel.posterior.factored_near`).
    """
    places = require_places(path_m)
    near = factored_near(posterior, places)
    terms = joint_terms(near, places)
    covariance = 0.5 * (terms.latent_db2 + terms.latent_db2.T)
    covariance[np.diag_indices_from(covariance)] += near.parameters.multipath_std_db**2
    return Batch(
        terms.data_db + terms.trend @ near.theta,
        covariance,
        terms.trend,
        posterior.theta_covariance,
    )


@dataclass(frozen=True, eq=False)
class KnownPlaces:
    """Places of a map, prepared once for the covariances of many paths with them."""

    grid_m: NDArray[np.float64]  # (g, 2)
    phi_db2: NDArray[np.float64]  # (kappa, g) covariances with the measurements
    trend: NDArray[np.float64]  # (g, 2) varphi(g)'


def known_places(posterior: ChannelPosterior, grid_m: NDArray[np.float64]) -> KnownPlaces:
    """Prepare `grid_m` (g, 2) for a posterior that has a factor; O(kappa g)."""
    parameters = posterior.parameters
    phi = posterior.covariance_with_db2(grid_m)
    solved = unwhiten(posterior.factor, posterior.whitened_regressors)
    return KnownPlaces(grid_m, phi, regressors(grid_m, parameters.station) - phi.T @ solved)


def cross_covariance_db2(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],  # (h, 2)
    known: KnownPlaces,
    universal: bool,
) -> NDArray[np.float64]:
    """Covariance of what is measured on a path with the power at other places; ``(h, g)``.

    c(q) = k_h(q) - Phi' U^-1 phi(q) (equation 4.6), plus B M varphi(q) where `universal`.
    """
    parameters = posterior.parameters
    phi = posterior.covariance_with_db2(path_m)
    solved = unwhiten(posterior.factor, whiten(posterior.factor, phi))
    covariance = shadow_covariance_db2(path_m, known.grid_m, parameters)
    covariance -= solved.T @ known.phi_db2
    if universal:
        rows = unwhiten(posterior.factor, posterior.whitened_regressors)
        trend = regressors(path_m, parameters.station) - phi.T @ rows
        covariance += trend @ posterior.theta_covariance @ known.trend.T
    return covariance


def batch_factor(covariance_db2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower Cholesky factor L of S, ``(h, h)``; L_ii^2 is the variance after q_1 .. q_{i-1}."""
    try:
        return np.asarray(np.linalg.cholesky(covariance_db2), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise InputError(
            "without multipath a path that comes twice to a place has no finite information",
            key="path_m",
            remedy="give multipath a deviation above 0, or leave repeated places out",
        ) from None
