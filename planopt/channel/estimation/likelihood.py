"""What a likelihood of (xi^2, omega^2, beta) gives, however it is computed."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Covariance = tuple[float, float, float]
"""xi^2 (dB^2), omega^2 (dB^2), beta (m)."""

SITE_TOLERANCE = 1e-4
"""Of the sites of intervals while climbing: what it costs in log L is far below what is asked of
the optimum, and it saves half of the sweeps."""


class Evaluated(Protocol):
    """The restricted likelihood at one point."""

    @property
    def log_likelihood(self) -> float:
        """Log L, constants included."""
        ...

    @property
    def gradient(self) -> NDArray[np.float64]:
        """``(3,)`` by xi^2, omega^2, beta."""
        ...

    @property
    def information(self) -> NDArray[np.float64]:
        """``(3, 3)`` about minus the second derivatives; positive semidefinite."""
        ...

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """``(p,)`` of the mean, by generalised least squares."""
        ...

    @property
    def coefficient_covariance(self) -> NDArray[np.float64]:
        """``(p, p)`` theirs."""
        ...


class Likelihood(Protocol):
    """A restricted likelihood of measurements; may keep what makes the next evaluation faster."""

    def at(self, covariance: Covariance, tolerance: float = 0.0) -> Evaluated:
        """Evaluate it; log L may be off by about `tolerance` where that is faster."""
        ...

    def information(self, covariance: Covariance, at: Evaluated) -> NDArray[np.float64]:
        """Return the information (3, 3) whose inverse has the squared standard errors.

        `at` is what :meth:`at` gave there.
        """
        ...
