"""Climbing the restricted likelihood in the logarithms of xi^2, omega^2 and beta.

In logarithms, so that none can become negative, that steps do not depend on units, and that the
ridge along which xi^2 and beta grow together is straight. The likelihood may have several maxima,
above all two: a steep path loss with a short decorrelation distance, and a flat one with a long
distance, in whose slow shadowing the slope is hidden.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.damped_newton import minimise_damped
from planopt.channel.estimation.likelihood import Covariance, Evaluated, Likelihood

ROUGH, FINE = 3e-2, 1e-5
"""What a step may still promise in log L where starts are compared, and at the end."""

SAME_LOGS = 0.05
"""Optima nearer than this in every logarithm are one."""

NO_DIP = 0.1
"""Optima are on one ridge where halfway between them log L is lower than at either by no more."""

FLAT = 1e-6
"""Information of a logarithm below which the likelihood counts as flat."""

NEARLY_AS_LIKELY = 2.0
"""Optima whose log L is lower by no more than this are kept beside the best."""

Top = tuple[NDArray[np.float64], Evaluated]
"""A point in logarithms, and the likelihood there."""


class LikelihoodClimb:
    """Climbs of one likelihood, to its optima within `fine`."""

    def __init__(self, likelihood: Likelihood, fine: float = FINE) -> None:
        self._likelihood = likelihood
        self._fine = fine
        self._top: Top | None = None
        self._tolerance = 0.0

    def to_top(self, start: NDArray[np.float64], box: NDArray[np.float64], tolerance: float) -> Top:
        """The optimum reached from `start` (3,) within `box` (3, 2), all in logarithms."""
        self._top, self._tolerance = None, tolerance
        minimise_damped(self._objective, start, box[:, 0], box[:, 1], tolerance)
        if self._top is None:
            raise AssertionError("the start is evaluated")
        return self._top

    def log_likelihood(self, logs: NDArray[np.float64]) -> float:
        """At a point (3,) in logarithms."""
        return self._likelihood.at(variances(logs)).log_likelihood

    def rise(self, logs: NDArray[np.float64], axis: int) -> float:
        """Slope of log L over one logarithm along the ridge that passes near a point (3,)."""
        values = np.exp(logs)
        at = self._likelihood.at(variances(logs), ROUGH)
        gradient = at.gradient * values
        information = values[:, None] * at.information * values + FLAT * np.eye(3)
        others = np.delete(np.arange(3), axis)
        onto = np.linalg.solve(information[np.ix_(others, others)], gradient[others])
        return float(gradient[axis] - information[axis, others] @ onto)

    def distinct(self, tops: Iterable[Top]) -> list[Top]:
        """Those of `tops` that are not on one ridge with a better one, the best first."""
        kept: list[Top] = []
        for top in sorted(tops, key=lambda one: -one[1].log_likelihood):
            if not any(self._on_one_ridge(better[0], top) for better in kept):
                kept.append(top)
        return kept

    def modes(self, starts: Iterable[NDArray[np.float64]], box: NDArray[np.float64]) -> list[Top]:
        """The optima reached from `starts`, the best first, none that is far less likely."""
        tops = self.distinct(self.to_top(start, box, ROUGH) for start in starts)
        least = tops[0][1].log_likelihood - NEARLY_AS_LIKELY - ROUGH
        likely = [logs for logs, at in tops if at.log_likelihood > least]
        return self.distinct(self.to_top(logs, box, self._fine) for logs in likely)

    def _on_one_ridge(self, better: NDArray[np.float64], top: Top) -> bool:
        logs, at = top
        if np.abs(logs - better).max() < SAME_LOGS:
            return True
        return self.log_likelihood(0.5 * (logs + better)) > at.log_likelihood - NO_DIP

    def _objective(
        self, logs: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Minus log L, its gradient and information, by the logarithms."""
        at = self._likelihood.at(variances(logs), self._tolerance)
        values = np.exp(logs)
        if self._top is None or at.log_likelihood > self._top[1].log_likelihood:
            self._top = logs, at
        return (
            -at.log_likelihood,
            -at.gradient * values,
            values[:, None] * at.information * values,
        )


def variances(logs: NDArray[np.float64]) -> Covariance:
    """(xi^2, omega^2, beta) from their logarithms."""
    shadow, nugget, beta = np.exp(logs)
    return float(shadow), float(nugget), float(beta)
