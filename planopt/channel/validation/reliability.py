"""Predicted against realised connection: a reliability table with intervals by group.

Predictions are binned by the probability that was predicted, and each bin compares its mean with
the share that came true. Steps of one run belong together, as do powers of one walk, so that the
interval of a share counts groups: Korn and Graubard's interval for surveys of clusters ("Confidence
intervals for proportions with small expected number of positive counts estimated from survey data",
Survey Methodology 24(2), 1998). The variance of the share is that of cluster sampling
(:mod:`planopt.channel.validation.grouped_ratio`); it says how many independent outcomes the bin is
worth, with Student's quantile for there being few groups, and the exact binomial interval (Clopper
and Pearson) of that number follows. Unlike a bootstrap over groups, the interval has a width where
every outcome is the same; a bin of one outcome only is then worth as many outcomes as groups.

Bins do not begin or end at probabilities that a problem usually asks for, since plans keep these to
the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, stdtrit  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.validation.grouped_ratio import LEVEL, ratio_error
from planopt.errors import InputError

EDGES = (0.0, 0.15, 0.35, 0.55, 0.75, 0.85, 0.925, 0.975, 0.995, 1.0)
"""Of the bins of predicted probability; the last one includes its upper end."""

FEWEST_GROUPS = 5
"""Fewer groups give no interval."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Predictions of similar probability, and what came of them.

    Attributes
    ----------
    low, high
        Range of the predicted probability.
    count, groups
        How many predictions, and of how many groups.
    predicted
        Mean predicted probability of connection.
    realised
        Share that was connected.
    interval
        95 % interval of `realised`; None for fewer than :data:`FEWEST_GROUPS` groups.
    """

    low: float
    high: float
    count: int
    groups: int
    predicted: float
    realised: float
    interval: tuple[float, float] | None

    @property
    def agrees(self) -> bool | None:
        """Whether the interval holds the mean prediction; None without an interval."""
        if self.interval is None:
            return None
        return self.interval[0] <= self.predicted <= self.interval[1]


def reliability(
    predicted: NDArray[np.float64], realised: NDArray[np.bool_], group_of: NDArray[np.intp]
) -> tuple[ReliabilityBin, ...]:
    """Tabulate predicted against realised connection.

    Parameters
    ----------
    predicted
        ``(n,)`` probabilities; NaN where there was no prediction, which is left out.
    realised
        ``(n,)`` whether there was a connection.
    group_of
        ``(n,)`` label of the run, walk or day that each belongs to.

    Returns
    -------
    tuple
        The bins that hold a prediction, in ascending order.

    Raises
    ------
    InputError
        The lengths differ.

    Examples
    --------
    >>> import numpy as np
    >>> [one] = reliability(np.full(4, 0.8), np.array([1, 1, 0, 1], dtype=bool), np.arange(4))
    >>> one.predicted, one.realised, one.interval
    (0.8, 0.75, None)
    """
    if not predicted.shape == realised.shape == group_of.shape:
        raise InputError(
            f"{predicted.size} predictions, {realised.size} outcomes and {group_of.size} groups "
            "cannot be compared"
        )
    bins: list[ReliabilityBin] = []
    for low, high in pairwise(EDGES):
        inside = (predicted >= low) & ((predicted < high) | (high == 1.0))
        if inside.any():
            bins.append(_bin((low, high), predicted[inside], realised[inside], group_of[inside]))
    return tuple(bins)


def _bin(
    edges: tuple[float, float],
    predicted: NDArray[np.float64],
    realised: NDArray[np.bool_],
    group_of: NDArray[np.intp],
) -> ReliabilityBin:
    """One bin, with at least one prediction."""
    labels, number = np.unique(group_of, return_inverse=True)
    sizes = np.bincount(number).astype(np.float64)
    connected = np.bincount(number, weights=realised).astype(np.float64)
    return ReliabilityBin(
        *edges,
        count=len(predicted),
        groups=len(labels),
        predicted=float(predicted.mean()),
        realised=float(connected.sum() / sizes.sum()),
        interval=share_interval(connected, sizes) if len(labels) >= FEWEST_GROUPS else None,
    )


def share_interval(
    connected: NDArray[np.float64], sizes: NDArray[np.float64]
) -> tuple[float, float]:
    """Return Korn and Graubard's 95 % interval of a share.

    Parameters
    ----------
    connected
        ``(g,)`` how many outcomes of each of at least two groups came true.
    sizes
        ``(g,)`` how many there are of each, above 0.
    """
    groups, count = len(sizes), float(sizes.sum())
    share = float(connected.sum()) / count
    variance = ratio_error(connected, sizes) ** 2
    worth = float(groups) if variance == 0.0 else min(share * (1.0 - share) / variance, count)
    ordinary, few = np.asarray(stdtrit([max(count - 1.0, 1.0), groups - 1.0], 0.5 + LEVEL / 2))
    worth *= float(ordinary / few) ** 2
    return _binomial_interval(share * worth, worth)


def _binomial_interval(successes: float, trials: float) -> tuple[float, float]:
    """Clopper and Pearson's interval; neither number need be whole."""
    failures, tail = trials - successes, 0.5 - LEVEL / 2
    low = 0.0 if successes <= 0.0 else float(betaincinv(successes, failures + 1.0, tail))
    high = 1.0 if failures <= 0.0 else float(betaincinv(successes + 1.0, failures, 1.0 - tail))
    return low, high
