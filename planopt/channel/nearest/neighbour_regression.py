"""Each of many powers regressed on measurements of its own: kriging weights, a batch at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurement_covariance import (
    Origins,
    covariance_db2,
    own_covariance_db2,
    own_variance_db2,
)
from planopt.channel.parameters import ChannelParameters


@dataclass(frozen=True, eq=False)
class NeighbourRegression:
    """Regress each of k powers on m neighbours, about their path loss (equation 1.6).

    Attributes
    ----------
    weights
        ``(k, m)`` U_mm^-1 phi.
    variance_db2
        ``(k,)`` of shadowing and the receiver's offset, given the neighbours.
    """

    weights: NDArray[np.float64]
    variance_db2: NDArray[np.float64]


def regress_on_neighbours(
    parameters: ChannelParameters,
    own: Origins,
    neighbours: Origins,
    noise_variance_db2: NDArray[np.float64],
    missing: NDArray[np.bool_],
) -> NeighbourRegression:
    """Kriging weights of k powers, each from its own m neighbours.

    Parameters
    ----------
    parameters
        The channel's parameters.
    own
        Origins of the powers, ``(k, 1)``.
    neighbours
        Origins ``(k, m)`` of what each is regressed on.
    noise_variance_db2
        ``(k, m)`` variance of the noise of these.
    missing
        ``(k, m)`` those that are not there: their weight is zero.
    """
    covariance = own_covariance_db2(neighbours, parameters)
    across = covariance_db2(own, neighbours, parameters)[:, 0]
    if missing.any():
        covariance[missing] = 0.0
        covariance.swapaxes(1, 2)[missing] = 0.0
        across[missing] = 0.0
    np.einsum("kii->ki", covariance)[...] += np.where(missing, 1.0, noise_variance_db2)
    solved = np.linalg.solve(covariance, across[:, :, None])
    weights = np.asarray(solved, dtype=np.float64)[:, :, 0]
    explained = np.einsum("km,km->k", weights, across)
    latent = own_variance_db2(own, parameters)[:, 0] - explained
    # Rounding alone can make it negative, beside a neighbour that is known exactly.
    return NeighbourRegression(weights, np.maximum(latent, 0.0))
