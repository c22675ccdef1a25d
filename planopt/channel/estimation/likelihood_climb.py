"""Climbing the restricted likelihood in the logarithms of xi^2, omega^2 and beta.

In logarithms, so that none can become negative, that steps do not depend on units, and that the
ridge along which xi^2 and beta grow together is straight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.damped_newton import minimise_damped
from planopt.channel.estimation.likelihood_data import LikelihoodData
from planopt.channel.estimation.restricted_likelihood import Covariance, Evaluation, evaluate
from planopt.channel.intervals.sites import IntervalSites

ROUGH, FINE = 3e-2, 1e-5
"""What a step may still promise in log L where starts are compared, and at the end."""

SITE_TOLERANCE = 1e-4
"""Of sites while climbing: what it costs in log L is far below `FINE`, and it saves half of EP."""

Top = tuple[NDArray[np.float64], Evaluation]
"""A point in logarithms, and the likelihood there."""


class LikelihoodClimb:
    """Climbs of one likelihood; keeps the last sites, so that EP starts warm."""

    def __init__(self, data: LikelihoodData) -> None:
        self._data = data
        self._sites: IntervalSites | None = None
        self._top: Top | None = None

    def to_top(self, start: NDArray[np.float64], box: NDArray[np.float64], tolerance: float) -> Top:
        """The optimum reached from `start` (3,) within `box` (3, 2), all in logarithms."""
        self._top = None
        minimise_damped(self._objective, start, box[:, 0], box[:, 1], tolerance)
        if self._top is None:
            raise AssertionError("the start is evaluated")
        return self._top

    def log_likelihood(self, logs: NDArray[np.float64]) -> float:
        """At a point (3,) in logarithms."""
        return self._at(logs).log_likelihood

    def _at(self, logs: NDArray[np.float64]) -> Evaluation:
        at = evaluate(self._data, variances(logs), self._sites, SITE_TOLERANCE)
        self._sites = at.sites
        return at

    def _objective(
        self, logs: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Minus log L, its gradient and average information, by the logarithms."""
        at = self._at(logs)
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
