"""A profile of the likelihood: which values of a parameter the measurements do not rule out.

Unlike a standard error it shows asymmetry, and that a parameter has no end on one side: where the
profile does not fall below the cut, no value is ruled out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

ProfiledParameter = Literal["shadow_std_db", "decorrelation_m", "multipath_std_db"]

WORDS: dict[str, tuple[str, str]] = {
    "n_pl": ("path loss exponent n_PL", ""),
    "shadow_std_db": ("deviation of shadowing", "dB"),
    "decorrelation_m": ("decorrelation distance", "m"),
    "multipath_std_db": ("deviation of multipath", "dB"),
}
"""What parameters are called, and their units."""

CUT_95 = 1.9207
"""Half the 95 % quantile of chi-square with one degree of freedom: values whose log likelihood is
within this of the largest are the 95 % confidence set."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A profile of the restricted likelihood.

    Attributes
    ----------
    parameter
        Which.
    values
        ``(k,)`` ascending, in the parameter's unit; the estimate is among them.
    log_likelihood
        ``(k,)`` the largest with the parameter at that value.
    estimate
        The value that is most likely.
    measurements
        How many it rests on, after thinning.
    """

    parameter: ProfiledParameter
    values: NDArray[np.float64]
    log_likelihood: NDArray[np.float64]
    estimate: float
    measurements: int

    @property
    def drop(self) -> NDArray[np.float64]:
        """``(k,)`` log L less its largest."""
        return self.log_likelihood - self.log_likelihood.max()

    def curve(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``(count,)`` values and `drop` between those computed.

        The signed root of the drop is taken as straight in the logarithm of the value, as it is
        where the likelihood is normal.
        """
        logs = np.log(self.values)
        root = np.copysign(np.sqrt(-self.drop), logs - math.log(self.estimate))
        fine: NDArray[np.float64] = np.linspace(logs[0], logs[-1], count, dtype=np.float64)
        between: NDArray[np.float64] = np.interp(fine, logs, root)
        return np.exp(fine), -(between**2)

    def interval_95(self) -> tuple[float, float]:
        """Ends of the 95 % confidence set, 0 and ``inf`` where `values` do not reach them.

        Between values as in :meth:`curve`.
        """
        above, logs = math.sqrt(CUT_95) - np.sqrt(-self.drop), np.log(self.values)
        inside = np.flatnonzero(above >= 0.0)
        first, last = int(inside[0]), int(inside[-1])
        low, high = 0.0, math.inf
        if first > 0:
            low = _crossing(logs[first - 1 : first + 1], above[first - 1 : first + 1])
        if last < len(logs) - 1:
            high = _crossing(logs[last : last + 2], above[last : last + 2])
        return low, high


def interval_words(low: float, high: float, unit: str) -> str:
    """A 95 % interval in words, 0 and ``inf`` for no end."""
    if math.isinf(high):
        words = f"above {low:.3g} {unit}" if low else "anything"
    else:
        words = f"{low:.3g} to {high:.3g} {unit}" if low else f"below {high:.3g} {unit}"
    return words.rstrip() + " (95 %)"


def _crossing(logs: NDArray[np.float64], above: NDArray[np.float64]) -> float:
    """Where a straight line between two points crosses zero."""
    return math.exp(float(logs[0] + (logs[1] - logs[0]) * above[0] / (above[0] - above[1])))
