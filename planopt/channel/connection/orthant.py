"""P(X_1 <= u_1, ..., X_k <= u_k) for every k at once, X Gaussian.

Genz's separation of variables: given the earlier ones, each variable is drawn below its bound,
and the product of the conditional probabilities so far is an unbiased estimate of the joint one.
The products on the way are the prefixes, which is what a first passage needs. Randomly shifted
lattices give the samples: several of them, so that their scatter tells the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri_exp  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.semidefinite import semidefinite_factor
from planopt.errors import InputError

SHIFTS = 12
"""Independent random shifts of the lattice; their scatter is the error estimate."""

FIRST_POINTS = 2**9
LAST_POINTS = 2**15
"""Points of the lattice, doubled from the first number to the last until accurate enough."""

FAR = 1e8
"""Scores are not taken further out: the logarithm of the normal tail must be squared safely."""

ERRORS = 3.0
"""An error is this many standard errors over the shifts."""


@dataclass(frozen=True, eq=False)
class PrefixProbabilities:
    """P(X_1 <= u_1, ..., X_k <= u_k) for k = 1 .. h.

    Attributes
    ----------
    probability
        ``(h,)`` never increasing.
    error
        ``(h,)`` three standard errors; zero where the value is exact.
    """

    probability: NDArray[np.float64]
    error: NDArray[np.float64]


def prefix_probabilities(
    bound: NDArray[np.float64],
    covariance: NDArray[np.float64],
    generator: np.random.Generator,
    tolerance: float = 1e-4,
) -> PrefixProbabilities:
    """P(X_1 <= u_1, ..., X_k <= u_k), k = 1 .. h, for X ~ N(0, `covariance`).

    A. Genz, Numerical computation of multivariate normal probabilities, 1992, with baker's
    transformed Richtmyer lattices.

    Parameters
    ----------
    bound
        ``(h,)`` u.
    covariance
        ``(h, h)``, may be singular.
    generator
        Source of the shifts.
    tolerance
        Points are doubled until no error is above this, or there are `LAST_POINTS`; the error
        that remains is in the result.

    Raises
    ------
    InputError
        `covariance` is none, or `tolerance` is not positive.
    """
    if not tolerance > 0.0:
        raise InputError(f"{tolerance!r} is not positive", key="tolerance")
    lower = semidefinite_factor(covariance)
    if len(bound) == 1:
        return PrefixProbabilities(_products(bound, lower, np.zeros((1, 0))), np.zeros(1))
    direction = np.sqrt(_primes(len(bound) - 1))
    points = FIRST_POINTS
    while True:
        multiples = np.arange(points, dtype=np.float64)[:, None] * direction
        # Reduced before the shift, so that large multiples keep their digits.
        lattice = _array(multiples - np.floor(multiples))
        runs = np.stack(
            [
                _products(bound, lower, _shifted(lattice, generator.random(len(direction))))
                for _ in range(SHIFTS)
            ]
        )
        error = ERRORS * runs.std(axis=0, ddof=1) / np.sqrt(SHIFTS)
        # The first is the same in every run and exact; rounding alone makes its scatter.
        error[0] = 0.0
        if error.max() <= tolerance or points == LAST_POINTS:
            return PrefixProbabilities(runs.mean(axis=0), error)
        points *= 2


def _shifted(lattice: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shift modulo one, then fold: the baker's transformation makes the integrand periodic."""
    moved = lattice + shift
    return np.abs(2.0 * (moved - np.floor(moved)) - 1.0)


def _products(
    bound: NDArray[np.float64], lower: NDArray[np.float64], uniform: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean over samples of the product of conditional probabilities up to each k; (h,).

    In logarithms, so that improbable prefixes do not underflow on the way.
    """
    samples, count = len(uniform), len(bound)
    drawn = np.zeros((samples, count))
    log_product = np.zeros(samples)
    mean = np.empty(count)
    for k in range(count):
        room = bound[k] - drawn[:, :k] @ lower[k, :k]
        # What earlier values determine is inside or not, and needs no draw.
        spread = lower[k, k]
        log_inside = (
            _array(log_ndtr(np.clip(room / spread, -FAR, FAR)))
            if spread > 0.0
            else np.where(room >= 0.0, 0.0, -np.inf)
        )
        log_product += log_inside
        mean[k] = np.exp(log_product).mean()
        if spread > 0.0 and k + 1 < count:
            log_uniform = np.log(np.maximum(uniform[:, k], np.finfo(np.float64).tiny))
            drawn[:, k] = _array(ndtri_exp(log_uniform + log_inside))
    return mean


def _primes(count: int) -> NDArray[np.float64]:
    """The first `count` primes, by trial division."""
    found: list[int] = []
    candidate = 2
    while len(found) < count:
        if all(candidate % prime for prime in found if prime * prime <= candidate):
            found.append(candidate)
        candidate += 1
    return np.array(found, dtype=np.float64)


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
