"""A number known by independent draws, with the confidence intervals that their count leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.prediction import bound_quantile
from planopt.errors import InputError
from planopt.short_repr import short_repr

CONFIDENCE = 0.95
"""Probability that an :class:`Interval` contains the true value."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % confidence interval."""

    value: float  # The estimate
    low: float  # Ends of the interval
    high: float


@dataclass(frozen=True, eq=False)
class SampledDistribution:
    """Independent draws of one number.

    Attributes
    ----------
    draws
        ``(count,)`` in the order drawn, count at least 2.
    """

    draws: NDArray[np.float64]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.draws.ndim != 1 or len(self.draws) < 2:
            raise InputError(
                f"draws of shape {self.draws.shape} are no distribution",
                key="count",
                remedy="draw at least 2",
            )

    @property
    def count(self) -> int:
        """Return how many draws."""
        return len(self.draws)

    def mean(self) -> Interval:
        """The mean, its interval by the central limit theorem."""
        value = float(self.draws.mean())
        half = _half_width() * float(self.draws.std(ddof=1)) / math.sqrt(self.count)
        return Interval(value, value - half, value + half)

    def quantile(self, share: float) -> Interval:
        """The value that is not exceeded with probability `share`; the interval by ranks.

        Raises
        ------
        InputError
            `share` is not from 0 to 1.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError(f"{share!r} is no probability", key="share", remedy="give 0 to 1")
        half = _half_width() * math.sqrt(share * (1.0 - share) / self.count)
        shares = np.clip([share, share - half, share + half], 0.0, 1.0)
        value, low, high = np.quantile(self.draws, shares, method="inverted_cdf").tolist()
        return Interval(value, low, high)

    def exceedance(self, limit: float) -> Interval:
        """P(more than `limit`), with Clopper and Pearson's interval, which holds at any count."""
        above = float((self.draws > limit).sum())
        below = self.count - above
        tail = 0.5 * (1.0 - CONFIDENCE)
        low = 0.0 if above == 0.0 else _beta_quantile(above, below + 1.0, tail)
        high = 1.0 if below == 0.0 else _beta_quantile(above + 1.0, below, 1.0 - tail)
        return Interval(above / self.count, low, high)


def _half_width() -> float:
    """Return half the width of an interval of a normal law, in its standard deviations."""
    return bound_quantile(0.5 + 0.5 * CONFIDENCE)


def _beta_quantile(first: float, second: float, share: float) -> float:
    return float(np.asarray(betaincinv(first, second, share), dtype=np.float64))
