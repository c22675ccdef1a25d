"""Profiles of the likelihood: which values of a parameter measurements do not rule out.

Unlike a standard error a profile shows asymmetry, and that a parameter has no end on one side:
where the profile does not fall below the cut, no value is ruled out.

Its ridge, the likelihood maximised over the other parameters, is followed outwards from the best
optimum, each point the start of the next, and back inwards, so that no better basin beside it is
missed for long. Other known optima are starts too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.likelihood_climb import FLAT, LikelihoodClimb, Top

TOLERANCE = 1e-3
"""What a step may still promise in log L."""

STEP_LIMITS = (0.02, 1.5)
"""A first step, in the logarithm, is within these: flat directions have no deviation."""

END_TOLERANCE = 0.02
"""An end of an interval is found when log L there is off the cut by no more than this."""

SECANT_SHARES = (0.1, 0.9)
"""A secant goes to within these shares of the way to a value that is ruled out."""

MAX_TRIALS = 12
"""Values tried for an end."""

AXES: dict[ProfiledParameter, tuple[int, float]] = {
    "shadow_std_db": (0, 2.0),
    "multipath_std_db": (1, 2.0),
    "decorrelation_m": (2, 1.0),
}
"""Where a parameter is among (xi^2, omega^2, beta), and which power of it stands there."""


@dataclass(frozen=True, eq=False)
class Ridge:
    """A likelihood, its optima and its box, in logarithms of (xi^2, omega^2, beta)."""

    climb: LikelihoodClimb  # Of the likelihood
    modes: tuple[Top, ...]  # Its optima, the best first
    box: NDArray[np.float64]  # (3, 2)

    def value(self, parameter: ProfiledParameter) -> float:
        """The estimate."""
        axis, power = AXES[parameter]
        return math.exp(self.modes[0][0][axis] / power)

    def deviation(self, parameter: ProfiledParameter) -> float:
        """Return the deviation of the estimate's logarithm, from the information there."""
        axis, power = AXES[parameter]
        return self._log_deviation(axis) / power

    def bounds(self, parameter: ProfiledParameter) -> tuple[float, float]:
        """Return the bounds of the fit."""
        axis, power = AXES[parameter]
        low, high = np.exp(self.box[axis] / power)
        return float(low), float(high)

    def profile(
        self,
        parameter: ProfiledParameter,
        sides: list[NDArray[np.float64]],
        drop: float,
        measurements: int,
    ) -> Profile:
        """Follow the ridge along each of `sides`, values outwards from the estimate.

        A side ends where log L has fallen by `drop`.
        """
        axis, power = AXES[parameter]
        best = self.modes[0]
        points = {self.value(parameter): best[1].log_likelihood}
        for side in sides:
            found = self._outwards(axis, power * np.log(side), drop)
            self._inwards(axis, found)
            points |= {math.exp(logs[axis] / power): at.log_likelihood for logs, at in found[1:]}
        values, log_likelihood = np.array(sorted(points.items())).T
        likeliest = float(values[np.argmax(log_likelihood)])
        return Profile(parameter, values, log_likelihood, likeliest, measurements)

    def interval_95(self, parameter: ProfiledParameter) -> tuple[float, float]:
        """Ends of the 95 % confidence set; 0 and ``inf`` where none is within the box.

        With every optimum within the cut inside.
        """
        axis, power = AXES[parameter]
        low, high = self._end(axis, -1.0), self._end(axis, 1.0)
        return (
            0.0 if low is None else math.exp(low / power),
            math.inf if high is None else math.exp(high / power),
        )

    def _end(self, axis: int, way: float) -> float | None:
        """Return where the profile crosses the cut, to one side, in the logarithm, or None.

        The root of what log L has fallen by is nearly straight in the logarithm: the secant.
        """
        best = self.modes[0]
        top, wanted = best[1].log_likelihood, math.sqrt(CUT_95)
        edge = float(self.box[axis, 0 if way < 0.0 else 1])
        within = [mode for mode in self.modes if top - mode[1].log_likelihood < CUT_95]
        inner = max(within, key=lambda mode: way * mode[0][axis])
        inner_root = math.sqrt(top - inner[1].log_likelihood)
        outer: tuple[float, float] | None = None
        step = wanted * math.sqrt(2.0) * self._log_deviation(axis)
        for _ in range(MAX_TRIALS):
            here = float(inner[0][axis])
            value = here + way * float(np.clip(step, *STEP_LIMITS))
            value = edge if way * (value - edge) > 0.0 else value
            found = self._best_at(axis, value, inner)
            root = math.sqrt(max(top - found[1].log_likelihood, 0.0))
            if abs(root**2 - CUT_95) < END_TOLERANCE:
                return value
            if root > wanted:
                outer = value, root
            elif value == edge:
                return None
            else:
                inner, inner_root = found, root
            here = float(inner[0][axis])
            if outer is None:
                gone = way * (here - float(best[0][axis]))
                step = gone * (wanted / inner_root - 1.0) if inner_root > 0.0 else math.inf
            else:
                share = (wanted - inner_root) / (outer[1] - inner_root)
                step = float(np.clip(share, *SECANT_SHARES)) * way * (outer[0] - here)
        return float(inner[0][axis]) if outer is None else outer[0]

    def _log_deviation(self, axis: int) -> float:
        """Return the deviation of one logarithm, from the information at the best optimum."""
        logs, at = self.modes[0]
        scale = np.exp(logs)
        spread = np.linalg.inv(scale[:, None] * at.information * scale + FLAT * np.eye(3))
        return math.sqrt(float(spread[axis, axis]))

    def _outwards(self, axis: int, logs: NDArray[np.float64], drop: float) -> list[Top]:
        """Optima with coordinate `axis` at each of `logs`, after the whole likelihood's."""
        found = [self.modes[0]]
        least = found[0][1].log_likelihood - drop
        for value in logs:
            found.append(self._best_at(axis, float(value), found[-1]))
            if found[-1][1].log_likelihood < least:
                break
        return found

    def _inwards(self, axis: int, found: list[Top]) -> None:
        """Improve optima where the basin of the next one outwards is the better one."""
        for inner in range(len(found) - 2, 0, -1):
            logs, at = found[inner]
            start = found[inner + 1][0].copy()
            start[axis] = logs[axis]
            if self.climb.log_likelihood(start) > at.log_likelihood + TOLERANCE:
                found[inner] = self._climbed(axis, start)

    def _best_at(self, axis: int, value: float, near: Top) -> Top:
        """The optimum with coordinate `axis` at `value`: from one near by, and from other modes."""
        starts = [_along(axis, value, near)]
        starts += [_along(axis, value, mode) for mode in self.modes[1:]]
        tops = [self._climbed(axis, np.clip(start, *self.box.T)) for start in starts]
        return max(tops, key=lambda top: top[1].log_likelihood)

    def _climbed(self, axis: int, start: NDArray[np.float64]) -> Top:
        """The optimum from `start` with coordinate `axis` held."""
        box = self.box.copy()
        box[axis] = start[axis]
        return self.climb.to_top(start, box, TOLERANCE)


def _along(axis: int, value: float, near: Top) -> NDArray[np.float64]:
    """Return the direction of the ridge through an optimum, by the information there."""
    logs, at = near
    scale = np.exp(logs)
    information = scale[:, None] * at.information * scale + FLAT * np.eye(3)
    others = np.array([number for number in range(3) if number != axis])
    step = value - logs[axis]
    start = logs.copy()
    start[axis] = value
    start[others] -= np.linalg.solve(
        information[np.ix_(others, others)], information[others, axis] * step
    )
    return start


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
    """A profile of the restricted likelihood."""

    parameter: ProfiledParameter  # Which
    # (k,) ascending, in the parameter's unit; the estimate is among them
    values: NDArray[np.float64]
    log_likelihood: NDArray[np.float64]  # (k,) the largest with the parameter at that value
    estimate: float  # The value that is most likely
    measurements: int  # How many it rests on, after thinning

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
    """Return where a straight line between two points crosses zero."""
    return math.exp(float(logs[0] + (logs[1] - logs[0]) * above[0] / (above[0] - above[1])))
