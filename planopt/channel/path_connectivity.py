"""Connectivity along a path: P(connected at all positions), and the first connection."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr, ndtri_exp, owens_t

from planopt.arrays import Floats
from planopt.channel.cholesky import semidefinite_factor
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.kriging import connection_probability
from planopt.channel.parameters import leg_lengths_m, require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.short_repr import short_repr

FAR_SCORE = 40.0  # Limit of scores; the normal tail beyond is below the smallest float
VANISHING = 1e-200  # Limit below which scores count as zero, because their products underflow
SHIFTS = 12
"""Number of independent random shifts of the lattice; their scatter gives the error estimate."""
FIRST_POINTS, LAST_POINTS = 2**9, 2**15
"""Initial and maximum number of lattice points, doubled until the tolerance is met."""
FAR = 1e8  # Limit of scores, so that their squares do not overflow
ERRORS = 3.0  # Number of standard errors over the shifts in the reported error


def bivariate_normal_cdf(first: Floats, second: Floats, correlation: Floats) -> Floats:
    """Return P(X <= first, Y <= second) of correlated standard normal X and Y."""
    # Owen's T function is exact up to rounding (D. B. Owen, Tables for computing bivariate
    # normal probabilities, 1956). Arguments broadcast; infinite scores and correlations of +-1 are
    # valid.
    h, k, rho = np.broadcast_arrays(_score(first), _score(second), np.clip(correlation, -1.0, 1.0))
    narrow = np.sqrt((1.0 - rho) * (1.0 + rho))
    lower, upper = _array(ndtr(h)), _array(ndtr(k))
    found = (
        0.5 * (lower + upper)
        - _owen(h, k - rho * h, narrow)
        - _owen(k, h - rho * k, narrow)
        - 0.5 * ((h < 0.0) != (k < 0.0))
    )
    # Owen's slopes are 0 / 0 for two zero scores.
    found = np.where((h == 0.0) & (k == 0.0), 0.25 + np.arcsin(rho) / (2.0 * np.pi), found)
    found = np.where(rho >= 1.0, np.minimum(lower, upper), found)
    found = np.where(rho <= -1.0, lower + upper - 1.0, found)
    return np.clip(found, np.maximum(0.0, lower + upper - 1.0), np.minimum(lower, upper))


def _score(values: Floats) -> Floats:
    """Return scores clipped to +-`FAR_SCORE`; scores of almost zero are set to zero."""
    scores = np.clip(_array(values), -FAR_SCORE, FAR_SCORE)
    return np.where(np.abs(scores) < VANISHING, 0.0, scores)


def _owen(score: Floats, across: Floats, narrow: Floats) -> Floats:
    """Return Owen's function T(score, across / (score * narrow)); a score may be zero."""
    # Adding zero turns -0 into 0. The caller replaces the results of 0 / 0.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slope = across / (score * narrow + 0.0)
    return _array(owens_t(score, slope))


def _array(values: object) -> Floats:
    return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PrefixProbabilities:
    """Probabilities P(X_1 <= u_1, ..., X_k <= u_k) for k = 1 .. h."""

    probability: Floats  # (h,) non-increasing
    error: Floats  # (h,) three standard errors; zero if exact


def prefix_probabilities(
    bound: Floats,  # (h,) u
    covariance: Floats,  # (h, h), may be singular
    generator: np.random.Generator,
    tolerance: float = 1e-4,
) -> PrefixProbabilities:
    """Return P(X_1 <= u_1, ..., X_k <= u_k), k = 1 .. h, for X ~ N(0, `covariance`)."""
    # Genz's method (Numerical computation of multivariate normal probabilities, 1992) with randomly
    # shifted Richtmyer lattices and the baker's transformation. Each variable is drawn below its
    # bound given the earlier ones; products of the conditional probabilities estimate all prefixes.
    if not tolerance > 0.0:
        raise InputError(f"is {tolerance!r}, should be above 0", key="tolerance")
    lower = semidefinite_factor(covariance)
    if len(bound) == 1:
        return PrefixProbabilities(_products(bound, lower, np.zeros((1, 0))), np.zeros(1))
    direction = np.sqrt(_primes(len(bound) - 1))
    points = FIRST_POINTS
    while True:
        multiples = np.arange(points, dtype=np.float64)[:, None] * direction
        # Reduced modulo 1 before the shift, so that large multiples keep their digits.
        lattice = _array(multiples - np.floor(multiples))
        runs = np.empty((SHIFTS, len(bound)))
        for run in runs:
            moved = lattice + generator.random(len(direction))
            folded = np.abs(2.0 * (moved - np.floor(moved)) - 1.0)
            run[:] = _products(bound, lower, folded)
        error = ERRORS * runs.std(axis=0, ddof=1) / np.sqrt(SHIFTS)
        # The first value is exact apart from rounding.
        error[0] = 0.0
        if error.max() <= tolerance or points == LAST_POINTS:
            return PrefixProbabilities(runs.mean(axis=0), error)
        points *= 2


def _products(bound: Floats, lower: Floats, uniform: Floats) -> Floats:
    """Return cumulative products (h,) of conditional probabilities, averaged over `uniform`."""
    # Products are stored as logarithms, so that improbable prefixes do not underflow.
    samples, count = len(uniform), len(bound)
    drawn = np.zeros((samples, count))
    log_product = np.zeros(samples)
    mean = np.empty(count)
    for k in range(count):
        room = bound[k] - drawn[:, :k] @ lower[k, :k]
        spread = lower[k, k]
        if spread > 0.0:
            reach: Floats = np.clip(room / spread, -FAR, FAR)
            log_inside = _array(log_ndtr(reach))
        else:
            # Earlier values determine this one, so it needs no draw.
            log_inside = np.where(room >= 0.0, 0.0, -np.inf)
        log_product += log_inside
        mean[k] = np.exp(log_product).mean()
        if spread > 0.0 and k + 1 < count:
            log_uniform = np.log(np.maximum(uniform[:, k], np.finfo(np.float64).tiny))
            drawn[:, k] = _array(ndtri_exp(log_uniform + log_inside))
    return mean


def _primes(count: int) -> Floats:
    """Return the first `count` primes, by trial division."""
    found: list[int] = []
    candidate = 2
    while len(found) < count:
        if all(candidate % prime for prime in found if prime * prime <= candidate):
            found.append(candidate)
        candidate += 1
    return np.array(found, dtype=np.float64)


@dataclass(frozen=True)
class Bound:
    """Bound on a probability, or the reason why there is none.

    Attributes
    ----------
    value
        Value of the bound; None if it is not proven for this case.
    reason
        Reason why the bound holds or does not hold.
    """

    value: float | None
    reason: str

    @property
    def proven(self) -> bool:
        """Return True if the bound has a value."""
        return self.value is not None


@dataclass(frozen=True)
class Estimate:
    """Estimate of a number with its error."""

    value: float
    error: float  # Three standard errors


@dataclass(frozen=True, eq=False)
class JointConnectivity:
    """Probability of power >= threshold at all positions, with bounds (equations 3.6 to 3.8).

    Attributes
    ----------
    at_each
        ``(h,)`` marginal probabilities p_i.
    exact
        Joint probability from the multivariate normal distribution; None without a generator.
    boole
        Lower bound 1 - sum (1 - p_i), at least 0.
    hunter
        Lower bound: Boole's plus P(disconnected at both) over the edges of a maximum spanning tree.
    product
        Lower bound prod p_i, valid if no two positions are negatively correlated.
    corrected_product
        Lower bound: prod p_i minus the maximum loss from negatively correlated pairs.
    upper
        Upper bound min p_i.
    """

    at_each: Floats
    exact: Estimate | None
    boole: Bound
    hunter: Bound
    product: Bound
    corrected_product: Bound
    upper: Bound

    __repr__ = short_repr

    @property
    def lower(self) -> float:
        """Largest proven lower bound."""
        bounds = (self.boole, self.hunter, self.product, self.corrected_product)
        return max(bound.value for bound in bounds if bound.value is not None)


def joint_connectivity(
    prediction: JointPrediction,
    threshold_dbm: float,
    generator: np.random.Generator | None = None,
    tolerance: float = 1e-4,
) -> JointConnectivity:
    """Return P(power >= threshold at all positions) with bounds (equations 3.6 to 3.8).

    The bounds alone, which suffice for constraints, cost O(h^2).

    Parameters
    ----------
    prediction
        Joint prediction from :func:`planopt.channel.joint_prediction`.
    threshold_dbm
        Minimum power for a connection.
    generator
        Random number generator for the exact value; None to compute the bounds only.
    tolerance
        Required accuracy of the exact value; the result contains the accuracy reached.

    Raises
    ------
    InputError
        The threshold is not finite, or the covariance is invalid.
    """
    above = prediction.mean_db - require_finite(threshold_dbm, "threshold_dbm")
    deviation, covariance = prediction.deviation_db, prediction.covariance_db2
    at_each = connection_probability(prediction.mean_db, deviation, threshold_dbm)
    exact = None
    if generator is not None:
        # By symmetry, P(X >= -above) = P(X <= above) for X of mean zero.
        found = prefix_probabilities(above, covariance, generator, tolerance)
        exact = Estimate(float(found.probability[-1]), float(found.error[-1]))
    out = 1.0 - at_each
    certain = np.where(above >= 0.0, -np.inf, np.inf)
    scores = np.divide(-above, deviation, out=certain, where=deviation > 0.0)
    scale = np.outer(deviation, deviation)
    correlation = np.divide(covariance, scale, out=np.zeros_like(scale), where=scale > 0.0)
    both_out = bivariate_normal_cdf(scores[:, None], scores[None, :], correlation)
    boole, product = 1.0 - float(out.sum()), float(at_each.prod())
    negative = np.triu(covariance, 1) < 0.0
    if negative.any():
        slepian = Bound(
            None,
            f"not valid: {int(negative.sum())} pairs of places are negatively correlated, the "
            f"covariance going down to {covariance.min():.3g} dB^2; Hunter's bound holds",
        )
    else:
        slepian = Bound(product, "valid: no two places are negatively correlated (Slepian)")
    # Scale all correlations from 0 to their values. By Plackett's identity, the derivative with
    # respect to each is between 0 and the bivariate density, whose integral is
    # P(both out) - q_i q_j, q = 1 - p. Positive correlations only increase the probability.
    cost = float(np.maximum((np.outer(out, out) - both_out)[negative], 0.0).sum())
    return JointConnectivity(
        at_each,
        exact,
        Bound(max(0.0, boole), "always valid"),
        Bound(max(0.0, boole + spanning_tree_weight(both_out)), "always valid"),
        slepian,
        Bound(
            max(0.0, product - cost),
            f"always valid: {cost:.3g} taken off for negatively correlated pairs (Plackett)",
        ),
        Bound(float(at_each.min()), "always valid"),
    )


def spanning_tree_weight(weight: Floats) -> float:
    """Return the total weight of a maximum spanning tree, by Prim's algorithm."""
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


@dataclass(frozen=True, eq=False)
class FirstPassage:
    """Distribution of the first connection along a path q_0 .. q_h that starts at q_0.

    Attributes
    ----------
    travelled_m
        ``(h + 1,)`` path length up to each position; the first is 0.
    not_connected
        ``(h + 1,)`` probability pi_k of no connection at q_1 .. q_k; the first is 1.
    not_connected_error
        ``(h + 1,)`` three standard errors of `not_connected`; zero if exact.
    """

    travelled_m: Floats
    not_connected: Floats
    not_connected_error: Floats

    __repr__ = short_repr

    @property
    def expected_distance_m(self) -> float:
        """Expected distance to the first connection, or to the path's end without one."""
        return float(np.diff(self.travelled_m) @ self.not_connected[:-1])


def first_passage(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    threshold_dbm: float,
    generator: np.random.Generator,
    *,
    disconnected_now: bool = False,
    tolerance: float = 1e-4,
) -> FirstPassage:
    """Return the distribution of the first connection along a path (equation 3.10).

    pi_k = P(power < threshold at q_1 .. q_k) by the multivariate normal distribution. Assuming
    independent positions would be optimistic.

    Parameters
    ----------
    posterior
        Channel conditional on measurements.
    positions_m
        ``(h + 1, 2)`` positions in metres, h >= 1; the robot starts at the first.
    threshold_dbm
        Minimum power for a connection.
    generator
        Random number generator of the integration.
    disconnected_now
        True to condition on no connection at the first position. False if the measurements
        already include that, or if the first position does not matter.
    tolerance
        Required accuracy of pi_k; the result contains the accuracy reached.

    Raises
    ------
    InputError
        `positions_m` is not a path, the threshold is not finite, or `disconnected_now` is
        impossible.
    """
    places = require_places(positions_m, 2)
    prediction = joint_prediction(posterior, places if disconnected_now else places[1:])
    below = require_finite(threshold_dbm, "threshold_dbm") - prediction.mean_db
    found = prefix_probabilities(below, prediction.covariance_db2, generator, tolerance)
    probability, error = found.probability, found.error
    if not disconnected_now:
        probability, error = np.append(1.0, probability), np.append(0.0, error)
    elif probability[0] == 0.0:
        raise InputError(
            "is true, but the first position is connected with certainty: the condition has "
            "probability 0",
            key="disconnected_now",
        )
    travelled = np.append(0.0, np.cumsum(leg_lengths_m(places)))
    return FirstPassage(travelled, probability / probability[0], error / probability[0])
