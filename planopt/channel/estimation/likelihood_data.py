"""Measurements as a likelihood needs them: Gaussian first, distances, what is not estimated.

What a likelihood of (xi^2, omega^2, beta) gives, however it is computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.channel.gaussian_sites import intervals
from planopt.channel.measurement_covariance import (
    ageing,
    measured_origins,
    measured_path_loss_variance_db2,
    offset_covariance_db2,
    own_distance_m,
)
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, MeanModel

LEAST_FREEDOM = 3
"""Starts and weights leave offsets out where fewer measurements would be left over."""

RANK_TOLERANCE = 1e-9
"""Columns below this share of the largest singular value add nothing."""


@dataclass(frozen=True)
class LikelihoodData:
    """Measurements, Gaussian ones first, as the likelihood needs them."""

    distance_m: NDArray[np.float64]  # (n, n), position errors included
    columns: NDArray[np.float64]  # (n, p) of the mean model
    # (n,) power less the mean model's offset; the limit for censored ones
    power_db: NDArray[np.float64]
    # Number of measurements that are Gaussian, exact or rounded finely; they come first. The others
    # are intervals.
    exact: int
    # (n,) step r that the power was rounded to, 0 for none; inf for censored ones
    width_db: NDArray[np.float64]
    # (n, n) the factor of the correlation; None where the channel does not forget
    age: NDArray[np.float64] | None
    # (n, n) covariance that is not estimated; None where there is none
    fixed_db2: NDArray[np.float64] | None
    receiver: NDArray[np.intp]  # (n,) number of the receiver

    def gaussian(self, rows: NDArray[np.intp]) -> LikelihoodData:
        """Return the data of `rows`, which are Gaussian ones."""
        square = np.ix_(rows, rows)
        return LikelihoodData(
            self.distance_m[square],
            self.columns[rows],
            self.power_db[rows],
            len(rows),
            self.width_db[rows],
            None if self.age is None else self.age[square],
            None if self.fixed_db2 is None else self.fixed_db2[square],
            self.receiver[rows],
        )

    def flat_columns(self) -> NDArray[np.float64]:
        """The mean's columns, and a basis of what receivers' offsets add to them; ``(n, q)``.

        For offsets under a flat prior. Where too few measurements would be left, or there are no
        offsets, the mean's alone.
        """
        if not self.receiver.any():
            return self.columns
        numbers = np.unique(self.receiver)
        whole = np.column_stack([self.columns, self.receiver[:, None] == numbers[numbers != 0]])
        basis, spread, _ = np.linalg.svd(whole, full_matrices=False)
        basis = basis[:, spread > RANK_TOLERANCE * spread[0]]
        return basis if len(basis) - basis.shape[1] >= LEAST_FREEDOM else self.columns

    def correlation(self, decorrelation_m: float) -> NDArray[np.float64]:
        """exp(-d / beta) by the factor of age; ``(n, n)``."""
        correlation = np.exp(-self.distance_m / decorrelation_m)
        if self.age is not None:
            correlation *= self.age
        return correlation


def likelihood_data(
    model: MeanModel,
    measurements: Measurements,
    known: ChannelParameters,
    as_interval: NDArray[np.bool_] | None = None,  # (n,)
) -> LikelihoodData:
    """Sort Gaussian measurements first and compute distances."""
    chosen = measurements.censored if as_interval is None else as_interval
    order = np.argsort(chosen, kind="stable")
    ordered = measurements.take(order)
    origins = measured_origins(ordered, known)
    times = origins.time_s
    bands = intervals(measurements)
    power = np.where(measurements.censored, bands.upper_db, measurements.power_dbm)
    return LikelihoodData(
        own_distance_m(origins),
        model.columns[order],
        (power - model.offset_db)[order],
        int((~chosen).sum()),
        bands.width_db[order],
        None if times is None else ageing(times[:, None], times, known),
        _fixed_covariance_db2(ordered, known),
        ordered.receiver,
    )


def _fixed_covariance_db2(
    measurements: Measurements, known: ChannelParameters
) -> NDArray[np.float64] | None:
    """Return the covariance of receivers' offsets and errors of path loss; (n, n)."""
    if not (measurements.receiver.any() or measurements.position_std_m.any()):
        return None
    fixed = np.diag(measured_path_loss_variance_db2(measurements, known))
    return fixed + offset_covariance_db2(measurements.receiver, measurements.receiver)


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
