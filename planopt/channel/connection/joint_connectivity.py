"""P(connected at every place of a path): exact, and bounds with what makes them valid.

The places' powers belong together, so the product of the single probabilities is not the joint
one, and is a bound only under a condition that is checked here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.bivariate import bivariate_normal_cdf
from planopt.channel.connection.orthant import prefix_probabilities
from planopt.channel.connectivity import connection_probability
from planopt.channel.joint import JointPrediction
from planopt.channel.places import require_finite
from planopt.short_repr import short_repr


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
        """Whether there is a value."""
        return self.value is not None


@dataclass(frozen=True)
class Estimate:
    """A number and how far it may be off.

    Attributes
    ----------
    value
        The estimate.
    error
        Three standard errors.
    """

    value: float
    error: float


@dataclass(frozen=True, eq=False)
class JointConnectivity:
    """P(power >= threshold at every place) and its bounds (equations 3.10 to 3.12).

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
    """Return P(power >= threshold at all places) and bounds (equations 3.10 to 3.12).

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
    """Total weight of a maximum spanning tree of the complete graph (Prim's algorithm).

    Parameters
    ----------
    weight
        ``(h, h)`` symmetric; the diagonal is not read.
    """
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
