"""Profile likelihood of xi, beta or omega from measurements.

For each value of one parameter the restricted likelihood is maximised over the other two, theta
integrated out (:mod:`planopt.channel.estimation.profile`).
"""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.estimate import GivenToFit, by_likelihood
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.profile import Profile, ProfiledParameter, Ridge
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import Station, mean_model
from planopt.errors import InputError

SHOWN_DROP = 4.0
"""A profile drawn by itself ends where log L has fallen by this."""

FIRST_STEP = 1.3
"""Of a profile drawn by itself, in deviations of the logarithm,"""

STEP_LIMITS = (0.02, 0.3)
"""but within these, in the logarithm, since flat directions have no deviation."""

GROWTH, MAX_STEPS = 1.2, 12
"""Each further step is that much longer; so many a side at most."""


@one_blas_thread()
def profile_likelihood(
    measurements: Measurements | Table,
    station: Station,
    parameter: ProfiledParameter,
    values: NDArray[np.float64],
    forgetting_s: float = math.inf,
) -> Profile:
    """The profile of one parameter at `values`, and at its estimate.

    Parameters
    ----------
    measurements
        Any number that allows an estimate.
    station
        The fixed station.
    parameter
        ``shadow_std_db`` (xi), ``decorrelation_m`` (beta) or ``multipath_std_db`` (omega).
    values
        ``(k,)`` positive, in any order.
    forgetting_s
        As in :func:`planopt.channel.estimation.fit.fit_channel`.

    Raises
    ------
    InputError
        The measurements do not allow the three to be estimated; there is no such parameter; or a
        value is not positive and finite.
    """
    measurements = as_measurements(measurements)
    if parameter not in get_args(ProfiledParameter):
        raise InputError(
            f"{parameter!r} has no profile",
            key="parameter",
            remedy=f"use {', '.join(get_args(ProfiledParameter))}",
        )
    wanted = np.asarray(values, dtype=np.float64).ravel()
    if not (np.isfinite(wanted).all() and (wanted > 0.0).all()):
        raise InputError("a value is not positive and finite", key="values")
    ridge = _ridge(measurements, station, forgetting_s)
    ascending, estimate = np.unique(wanted), ridge.value(parameter)
    sides = [ascending[ascending < estimate][::-1], ascending[ascending > estimate]]
    return ridge.profile(parameter, sides, math.inf, len(measurements))


@one_blas_thread()
def profiles_around(
    measurements: Measurements, station: Station, forgetting_s: float = math.inf
) -> tuple[Profile, ...]:
    """Profiles of all three, outwards from the estimate until log L has fallen by `SHOWN_DROP`.

    Parameters and errors as in :func:`profile_likelihood`. Values stay within the bounds of the
    fit.
    """
    ridge = _ridge(measurements, station, forgetting_s)
    found: list[Profile] = []
    for parameter in get_args(ProfiledParameter):
        low, high = ridge.bounds(parameter)
        value = ridge.value(parameter)
        first = np.clip(FIRST_STEP * ridge.deviation(parameter), *STEP_LIMITS)
        steps = np.cumsum(first * GROWTH ** np.arange(MAX_STEPS))
        down, up = np.maximum(value * np.exp(-steps), low), np.minimum(value * np.exp(steps), high)
        sides = [down[np.append(True, down[:-1] > low)], up[np.append(True, up[:-1] < high)]]
        sides = [side[side != value] for side in sides]
        found.append(ridge.profile(parameter, sides, SHOWN_DROP, len(measurements)))
    return tuple(found)


def _ridge(measurements: Measurements, station: Station, forgetting_s: float) -> Ridge:
    """Fit by restricted maximum likelihood."""
    allows = examine(measurements, station)
    measurements = measurements.by_place()
    if allows.covariance_reason is not None:
        raise InputError(
            f"xi, beta and omega have no likelihood: {allows.covariance_reason}",
            remedy="measure more",
        )
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
    found = by_likelihood(GivenToFit(model, measurements, station, allows, forgetting_s)).reml
    if found is None:
        raise AssertionError("the likelihood gives a fit by it")
    return found.ridge
