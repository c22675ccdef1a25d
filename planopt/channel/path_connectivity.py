"""P(connected at every place of a path): exact, and bounds with what makes them valid.

The places' powers belong together, so the product of the single probabilities is not the joint
one, and is a bound only under a condition that is checked here.

The normal distribution of two variables, for arrays of pairs, by Owen's T function.

P(X_1 <= u_1, ..., X_k <= u_k) for every k at once, X Gaussian.

Genz's separation of variables: given the earlier ones, each variable is drawn below its bound,
and the product of the conditional probabilities so far is an unbiased estimate of the joint one.
The products on the way are the prefixes, which is what a first passage needs. Randomly shifted
lattices give the samples: several of them, so that their scatter tells the error.

The distance that a robot drives until it is connected, along a given path (equation 3.10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtr, ndtri_exp, owens_t  # pyright: ignore[reportUnknownVariableType]  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import semidefinite_factor
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.parameters import leg_lengths_m, require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.short_repr import short_repr

FAR_SCORE = 40.0
"""Scores are not taken further out: the normal tail there is below the smallest float."""

VANISHING = 1e-200
"""Smaller scores count as zero: their products would, and quotients of those are no numbers."""


def bivariate_normal_cdf(
    first: NDArray[np.float64], second: NDArray[np.float64], correlation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """P(X <= first, Y <= second) for standard normal X, Y of the given correlation.

    Exact to rounding, about 1e-15 (D. B. Owen, Tables for computing bivariate normal
    probabilities, 1956). Arguments broadcast; infinite scores and correlations of 1 and -1 are
    taken as what they are.
    """
    h, k, rho = np.broadcast_arrays(_score(first), _score(second), np.clip(correlation, -1.0, 1.0))
    narrow = np.sqrt((1.0 - rho) * (1.0 + rho))
    crossing = (h < 0.0) != (k < 0.0)
    found = (
        0.5 * (_array(ndtr(h)) + _array(ndtr(k)))
        - _owen(h, k - rho * h, narrow)
        - _owen(k, h - rho * k, narrow)
        - 0.5 * crossing
    )
    # Two zero scores leave Owen's slopes 0 / 0.
    found = np.where((h == 0.0) & (k == 0.0), 0.25 + np.arcsin(rho) / (2.0 * np.pi), found)
    lower, upper = _array(ndtr(h)), _array(ndtr(k))
    found = np.where(rho >= 1.0, np.minimum(lower, upper), found)
    found = np.where(rho <= -1.0, lower + upper - 1.0, found)
    return np.clip(found, np.maximum(0.0, lower + upper - 1.0), np.minimum(lower, upper))


def _score(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scores that quotients can be made of."""
    scores = np.clip(_array(values), -FAR_SCORE, FAR_SCORE)
    return np.where(np.abs(scores) < VANISHING, 0.0, scores)


def _owen(
    score: NDArray[np.float64], across: NDArray[np.float64], narrow: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Owen's T(score, across / (score narrow)); a zero score makes the slope infinite."""
    # Zero is added so that a score of -0 is one of 0. What is 0 / 0 here the caller replaces.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slope = across / (score * narrow + 0.0)
    return _array(owens_t(score, slope))


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


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
    """P(X_1 <= u_1, ..., X_k <= u_k) for k = 1 .. h."""

    probability: NDArray[np.float64]  # (h,) never increasing
    error: NDArray[np.float64]  # (h,) three standard errors; zero where the value is exact


def prefix_probabilities(
    bound: NDArray[np.float64],  # (h,) u
    covariance: NDArray[np.float64],  # (h, h), may be singular
    generator: np.random.Generator,
    tolerance: float = 1e-4,
) -> PrefixProbabilities:
    """P(X_1 <= u_1, ..., X_k <= u_k), k = 1 .. h, for X ~ N(0, `covariance`).

    A. Genz, Numerical computation of multivariate normal probabilities, 1992, with baker's
    transformed Richtmyer lattices.
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


@dataclass(frozen=True)
class Bound:
    """A bound on a probability, or why there is none.

    Attributes
    ----------
    value
        None where the bound is not proven for this case.
    reason
        Why it holds, or why it does not.
    """

    value: float | None
    reason: str

    @property
    def proven(self) -> bool:
        """Return whether there is a value."""
        return self.value is not None


@dataclass(frozen=True)
class Estimate:
    """A number and how far it may be off."""

    value: float  # The estimate
    error: float  # Three standard errors


@dataclass(frozen=True, eq=False)
class JointConnectivity:
    """P(power >= threshold at every place) and its bounds (equations 3.6 to 3.8).

    Attributes
    ----------
    at_each
        ``(h,)`` p_i, the probability at each place alone.
    exact
        By the multivariate normal distribution; None where it was not asked for.
    boole
        Lower bound 1 - sum (1 - p_i), at least 0.
    hunter
        Lower bound: Boole's plus P(out at both) over the edges of a maximum spanning tree.
    product
        Lower bound prod p_i, where no two places are negatively correlated.
    corrected_product
        Lower bound: the product less what the negatively correlated pairs can cost.
    upper
        Upper bound min p_i.
    """

    at_each: NDArray[np.float64]
    exact: Estimate | None
    boole: Bound
    hunter: Bound
    product: Bound
    corrected_product: Bound
    upper: Bound

    __repr__ = short_repr

    @property
    def lower(self) -> float:
        """The greatest proven lower bound."""
        bounds = (self.boole, self.hunter, self.product, self.corrected_product)
        return max(bound.value for bound in bounds if bound.value is not None)


def joint_connectivity(
    prediction: JointPrediction,
    threshold_dbm: float,
    generator: np.random.Generator | None = None,
    tolerance: float = 1e-4,
) -> JointConnectivity:
    """Return P(power >= threshold at all places) and bounds (equations 3.6 to 3.8).

    With the exact value for reports, without for constraints: the bounds cost O(h^2).

    Parameters
    ----------
    prediction
        From :func:`planopt.channel.joint.joint_prediction`.
    threshold_dbm
        Power from which on a place is connected.
    generator
        Source of randomness of the exact value, which is left out without one.
    tolerance
        Accuracy that the exact value tries to reach; the one reached is in the result.

    Raises
    ------
    InputError
        The threshold is not finite, or the covariance is none.
    """
    above = prediction.mean_db - require_finite(threshold_dbm, "threshold_dbm")
    deviation = prediction.deviation_db
    at_each = connection_probability(prediction.mean_db, deviation, threshold_dbm)
    out = 1.0 - at_each
    exact = None
    if generator is not None:
        # An orthant by symmetry: P(X >= -above) = P(X <= above) for X of mean zero.
        found = prefix_probabilities(above, prediction.covariance_db2, generator, tolerance)
        exact = Estimate(float(found.probability[-1]), float(found.error[-1]))
    boole = 1.0 - float(out.sum())
    both_out = _both_out(above, prediction.covariance_db2)
    return JointConnectivity(
        at_each,
        exact,
        Bound(max(0.0, boole), "always valid"),
        Bound(max(0.0, boole + spanning_tree_weight(both_out)), "always valid"),
        _product_bound(at_each, prediction.covariance_db2),
        _corrected_product(at_each, both_out, prediction.covariance_db2),
        Bound(float(at_each.min()), "always valid"),
    )


def spanning_tree_weight(weight: NDArray[np.float64]) -> float:
    """Total weight of a maximum spanning tree of the complete graph (Prim's algorithm)."""
    # Shapes: weight (h, h).
    outside = np.ones(len(weight), dtype=bool)
    outside[0] = False
    best = weight[0].copy()
    total = 0.0
    for _ in range(len(weight) - 1):
        joined = int(np.argmax(np.where(outside, best, -np.inf)))
        total += float(best[joined])
        outside[joined] = False
        best = np.maximum(best, weight[joined])
    return total


def _both_out(
    above_db: NDArray[np.float64], covariance_db2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """P(out at i and at j) for every pair; (h, h)."""
    deviation = np.sqrt(np.diag(covariance_db2))
    certain = np.where(above_db >= 0.0, -np.inf, np.inf)
    score = np.divide(-above_db, deviation, out=certain, where=deviation > 0.0)
    scale = np.outer(deviation, deviation)
    correlation = np.divide(covariance_db2, scale, out=np.zeros_like(scale), where=scale > 0.0)
    return bivariate_normal_cdf(score[:, None], score[None, :], correlation)


def _product_bound(at_each: NDArray[np.float64], covariance_db2: NDArray[np.float64]) -> Bound:
    """The product of the single probabilities, by Slepian's inequality."""
    negative = int((np.triu(covariance_db2, 1) < 0.0).sum())
    if negative:
        return Bound(
            None,
            f"not valid: {negative} pairs of places are negatively correlated, the covariance "
            f"going down to {covariance_db2.min():.3g} dB^2; Hunter's bound holds",
        )
    return Bound(float(at_each.prod()), "valid: no two places are negatively correlated (Slepian)")


def _corrected_product(
    at_each: NDArray[np.float64],
    both_out: NDArray[np.float64],
    covariance_db2: NDArray[np.float64],
) -> Bound:
    """Product less, over negatively correlated pairs, the sum of q_i q_j - P(both out), q = 1 - p.

    Let all correlations grow from 0 to their values in proportion. By Plackett's identity the joint
    probability changes with each at a rate from 0 to the bivariate density at the two bounds, whose
    integral is P(both out) - q_i q_j; the positive ones can be left out.
    """
    out = 1.0 - at_each
    missing = np.outer(out, out) - both_out
    negative = np.triu(covariance_db2, 1) < 0.0
    cost = float(np.maximum(missing[negative], 0.0).sum())
    return Bound(
        max(0.0, float(at_each.prod()) - cost),
        f"always valid: {cost:.3g} taken off for negatively correlated pairs (Plackett)",
    )


@dataclass(frozen=True, eq=False)
class FirstPassage:
    """The first connection along a path q_0 .. q_h; the robot stands at q_0.

    Attributes
    ----------
    travelled_m
        ``(h + 1,)`` length of the path up to each place; the first is 0.
    not_connected
        ``(h + 1,)`` pi_k, the probability of no connection at q_1 .. q_k; the first is 1.
    not_connected_error
        ``(h + 1,)`` three standard errors; zero where exact.
    """

    travelled_m: NDArray[np.float64]
    not_connected: NDArray[np.float64]
    not_connected_error: NDArray[np.float64]

    __repr__ = short_repr

    @property
    def connected_by(self) -> NDArray[np.float64]:
        """``(h + 1,)`` distribution function of the first passage, 1 - pi_k."""
        return 1.0 - self.not_connected

    @property
    def expected_distance_m(self) -> float:
        """E[D] = sum_k leg_{k+1} pi_k: driven until connected, or to the path's end."""
        return float(np.diff(self.travelled_m) @ self.not_connected[:-1])

    @property
    def expected_distance_error_m(self) -> float:
        """Error of :attr:`expected_distance_m` if those of pi_k all went one way."""
        return float(np.diff(self.travelled_m) @ self.not_connected_error[:-1])


def first_passage(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    threshold_dbm: float,
    generator: np.random.Generator,
    *,
    disconnected_now: bool = False,
    tolerance: float = 1e-4,
) -> FirstPassage:
    """Return the law of the first connection along a path, given measurements (equation 3.10).

    pi_k = P(power < threshold at q_1 .. q_k) by the multivariate normal distribution. Chances at
    the places are not taken as independent, which would promise too much.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(h + 1, 2)`` metres, h >= 1, where the robot stands first.
    threshold_dbm
        Power from which on a place is connected.
    generator
        Source of randomness of the integration.
    disconnected_now
        Condition on no connection at the first place too. False where that is already among the
        measurements, or where the first place does not matter.
    tolerance
        Accuracy of pi_k that is tried for; the one reached is in the result.

    Raises
    ------
    InputError
        `positions_m` is no path, the threshold is not finite, or `disconnected_now` is
        impossible.
    """
    places = require_places(positions_m, 2)
    asked = places if disconnected_now else places[1:]
    prediction = joint_prediction(posterior, asked)
    below = require_finite(threshold_dbm, "threshold_dbm") - prediction.mean_db
    found = prefix_probabilities(below, prediction.covariance_db2, generator, tolerance)
    probability, error = found.probability, found.error
    if not disconnected_now:
        probability, error = np.append(1.0, probability), np.append(0.0, error)
    elif probability[0] == 0.0:
        raise InputError(
            "the first place is certain to be connected: it cannot be given that it is not",
            key="disconnected_now",
        )
    travelled = np.append(0.0, np.cumsum(leg_lengths_m(places)))
    return FirstPassage(travelled, probability / probability[0], error / probability[0])
