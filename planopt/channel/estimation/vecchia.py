"""Products of whitened columns without a factor of all measurements.

Vecchia's approximation conditions each measurement on the nearest of those before it, not on all:
an inverse factor with few entries a row (Vecchia, Journal of the Royal Statistical Society B, 1988;
Datta et al., Journal of the American Statistical Association, 2016).

A batch is taken in blocks from coarse to fine (:mod:`planopt.channel.nearest.windows`), so that the
products depend on where measurements are, not on the order of their rows. Those that come later are
taken one by one in their order. In the order of a path the nearest before are all on one side, and
theta was up to 0.5 of its standard error off.

Each of many powers regressed on measurements of its own: kriging weights, a batch at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import factor_and_inverse
from planopt.channel.measurement_covariance import (
    Origins,
    covariance_db2,
    own_covariance_db2,
    own_variance_db2,
)
from planopt.channel.nearest.place_index import PlaceIndex
from planopt.channel.nearest.windows import BESIDE, BLOCK, earlier_windows, place_blocks
from planopt.channel.parameters import ChannelParameters


@dataclass(frozen=True, eq=False)
class NeighbourRegression:
    """Regress each of k powers on m neighbours, about their path loss (equation 1.6)."""

    weights: NDArray[np.float64]  # (k, m) U_mm^-1 phi
    # (k,) of shadowing and the receiver's offset, given the neighbours
    variance_db2: NDArray[np.float64]


def regress_on_neighbours(
    parameters: ChannelParameters,
    own: Origins,
    neighbours: Origins,
    noise_variance_db2: NDArray[np.float64],  # (k, m) variance of the noise of these
    missing: NDArray[np.bool_],  # (k, m) those that are not there: their weight is zero
) -> NeighbourRegression:
    """Kriging weights of k powers, each from its own m neighbours."""
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


EARLIER_NEIGHBOURS = 64
"""Earlier measurements that each is conditioned on, of those that come later."""

ROWS_AT_ONCE = 256


def whitened_products(
    parameters: ChannelParameters,
    origins: Origins,
    noise_variance_db2: NDArray[np.float64],  # (n,) variance of the noise of each
    columns: NDArray[np.float64],  # (n, c) C
) -> NDArray[np.float64]:
    """C' U^-1 C with U^-1 after Vecchia, of a batch of measurements."""
    # Shapes: returns (c, c).
    products = np.zeros((columns.shape[1], columns.shape[1]))
    blocks = place_blocks(origins.positions_m, BLOCK)
    for window in earlier_windows(origins.positions_m, blocks, BESIDE):
        rows = window.rows
        covariance = own_covariance_db2(origins.at(rows), parameters)
        covariance.flat[:: len(rows) + 1] += noise_variance_db2[rows]
        _, inverse = factor_and_inverse(covariance)
        whitened = inverse[len(window.beside) :] @ columns[rows]
        products += whitened.T @ whitened
    return products


def added_products(
    parameters: ChannelParameters,
    origins: Origins,
    noise_variance_db2: NDArray[np.float64],
    columns: NDArray[np.float64],
    done: int,
) -> NDArray[np.float64]:
    """Add the products of the rows from `done` on to those of the earlier rows, in order."""
    index = PlaceIndex.of(origins.positions_m[:done])
    products = np.zeros((columns.shape[1], columns.shape[1]))
    for start in range(done, len(columns), ROWS_AT_ONCE):
        index = index.grown(origins.positions_m[:start])
        rows = np.arange(start, min(start + ROWS_AT_ONCE, len(columns)))
        earlier = nearest_earlier(index, origins.positions_m[rows], EARLIER_NEIGHBOURS)
        missing = earlier < 0
        found = regress_on_neighbours(
            parameters,
            origins.at(rows[:, None]),
            origins.at(earlier),
            noise_variance_db2[earlier],
            missing,
        )
        predicted = np.einsum("km,kmc->kc", found.weights, columns[earlier])
        variance = found.variance_db2 + noise_variance_db2[rows]
        whitened = (columns[rows] - predicted) / np.sqrt(variance)[:, None]
        products += whitened.T @ whitened
    return products


def nearest_earlier(
    index: PlaceIndex, positions_m: NDArray[np.float64], count: int
) -> NDArray[np.intp]:
    """Numbers of the `count` places nearest to each of `positions_m` among those before it."""
    # Shapes: positions_m (k, 2); returns (k, count).
    before, total = len(index.positions_m), len(positions_m)
    found, _ = index.nearest(positions_m, count)
    offset = index.positions_m[found] - positions_m[:, None]
    within = positions_m[:, None] - positions_m[None]
    within_m2 = np.einsum("kmi,kmi->km", within, within)
    within_m2[np.triu_indices(total)] = np.inf
    nobody = np.full((total, count), np.inf)
    squared_m2 = np.concatenate(
        [np.einsum("kmi,kmi->km", offset, offset), within_m2, nobody], axis=1
    )
    numbers = np.full(squared_m2.shape, -1)
    numbers[:, : found.shape[1]] = found
    numbers[:, found.shape[1] : -count] = np.arange(before, before + total)
    chosen = np.argpartition(squared_m2, count - 1, axis=1)[:, :count]
    near = np.take_along_axis(numbers, chosen, axis=1)
    near[np.isinf(np.take_along_axis(squared_m2, chosen, axis=1))] = -1
    return near
