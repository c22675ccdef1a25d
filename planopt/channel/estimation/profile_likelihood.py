"""Profile likelihood of xi, beta or omega from measurements.

For each value of one parameter the restricted likelihood is maximised over the other two (theta is
integrated out): the ridge is followed outwards from the estimate, each optimum the start of the
next, and back inwards, so that no better basin beside it is missed for long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.covariance_fit import covariance_bounds
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.least_squares import least_squares
from planopt.channel.estimation.likelihood_climb import LikelihoodClimb, Top
from planopt.channel.estimation.likelihood_data import likelihood_data
from planopt.channel.estimation.profile import Profile, ProfiledParameter
from planopt.channel.estimation.reml import thinned
from planopt.channel.intervals.censoring import needs_site
from planopt.channel.mean_model import mean_model
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station
from planopt.errors import InputError

MAX_MEASUREMENTS = 300
"""More than these are thinned: a profile costs some fifty evaluations of the likelihood."""

TOLERANCE = 1e-4
"""What a step may still promise in log L; nothing of that size can be seen."""

FLAT = 1e-6
"""Information of a logarithm below which the likelihood counts as flat."""

SHOWN_DROP = 4.0
"""A profile drawn by itself ends where log L has fallen by this."""

FIRST_STEP = 0.35
"""Of a profile drawn by itself, in deviations of the logarithm,"""

STEP_LIMITS = (0.02, 0.15)
"""but within these, in the logarithm, since flat directions have no deviation."""

GROWTH, MAX_STEPS = 1.15, 16
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
        A fixed random draw of `MAX_MEASUREMENTS` where there are more.
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
    ridge = _Ridge.of(measurements, station, forgetting_s)
    ascending, estimate = np.unique(wanted), ridge.value(parameter)
    sides = [ascending[ascending < estimate][::-1], ascending[ascending > estimate]]
    return ridge.profile(parameter, sides, math.inf)


@one_blas_thread()
def profiles_around(
    measurements: Measurements, station: Station, forgetting_s: float = math.inf
) -> tuple[Profile, ...]:
    """Profiles of all three, outwards from the estimate until log L has fallen by `SHOWN_DROP`.

    Parameters and errors as in :func:`profile_likelihood`. Values stay within the bounds of the
    fit.
    """
    ridge = _Ridge.of(measurements, station, forgetting_s)
    found: list[Profile] = []
    for parameter in get_args(ProfiledParameter):
        low, high = ridge.bounds(parameter)
        value = ridge.value(parameter)
        first = np.clip(FIRST_STEP * ridge.deviation(parameter), *STEP_LIMITS)
        steps = np.cumsum(first * GROWTH ** np.arange(MAX_STEPS))
        down, up = np.maximum(value * np.exp(-steps), low), np.minimum(value * np.exp(steps), high)
        sides = [down[np.append(True, down[:-1] > low)], up[np.append(True, up[:-1] < high)]]
        sides = [side[side != value] for side in sides]
        found.append(ridge.profile(parameter, sides, SHOWN_DROP))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Ridge:
    """The likelihood, its optimum and box, in logarithms of (xi^2, omega^2, beta)."""

    climb: LikelihoodClimb
    top: Top
    box: NDArray[np.float64]
    measurements: int

    @staticmethod
    def of(measurements: Measurements, station: Station, forgetting_s: float) -> _Ridge:
        """Fit by restricted maximum likelihood, on few enough measurements."""
        measurements = measurements.take(thinned(len(measurements), MAX_MEASUREMENTS))
        allows = examine(measurements, station)
        if allows.covariance_reason is not None:
            raise InputError(
                f"xi, beta and omega have no likelihood: {allows.covariance_reason}",
                remedy="measure more",
            )
        known = fit_channel(measurements, station, forgetting_s=forgetting_s).parameters
        exact = ~measurements.censored
        model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
        bounds = covariance_bounds(
            least_squares(model, measurements).variance_db2, allows.decorrelation_bounds_m
        )
        as_interval = needs_site(measurements, known.multipath_std_db**2)
        data = likelihood_data(model, measurements, known, as_interval)
        climb = LikelihoodClimb(data)
        box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
        return _Ridge(climb, climb.to_top(_logs(known), box, TOLERANCE), box, len(measurements))

    def value(self, parameter: ProfiledParameter) -> float:
        """The estimate."""
        axis, power = _AXES[parameter]
        return math.exp(self.top[0][axis] / power)

    def deviation(self, parameter: ProfiledParameter) -> float:
        """Of the logarithm of the estimate, from the average information."""
        axis, power = _AXES[parameter]
        logs, at = self.top
        scale = np.exp(logs)
        information = scale[:, None] * at.information * scale
        spread = np.linalg.inv(information + FLAT * np.eye(3))
        return math.sqrt(float(spread[axis, axis])) / power

    def bounds(self, parameter: ProfiledParameter) -> tuple[float, float]:
        """Those of the fit."""
        axis, power = _AXES[parameter]
        low, high = np.exp(self.box[axis] / power)
        return float(low), float(high)

    def profile(
        self, parameter: ProfiledParameter, sides: list[NDArray[np.float64]], drop: float
    ) -> Profile:
        """Follow the ridge along each of `sides`, values outwards from the estimate.

        A side ends where log L has fallen by `drop`.
        """
        axis, power = _AXES[parameter]
        points = {self.value(parameter): self.top[1].log_likelihood}
        for side in sides:
            found = self._outwards(axis, power * np.log(side), drop)
            self._inwards(axis, found)
            points |= {math.exp(logs[axis] / power): at.log_likelihood for logs, at in found[1:]}
        values, log_likelihood = np.array(sorted(points.items())).T
        best = float(values[np.argmax(log_likelihood)])
        return Profile(parameter, values, log_likelihood, best, self.measurements)

    def _outwards(self, axis: int, logs: NDArray[np.float64], drop: float) -> list[Top]:
        """Optima with coordinate `axis` at each of `logs`, after the whole likelihood's."""
        found, least = [self.top], self.top[1].log_likelihood - drop
        for number, value in enumerate(logs):
            start = found[-1][0]
            if number > 1:
                before = found[-2][0]
                start = start + (start - before) * (value - start[axis]) / (start - before)[axis]
            found.append(self._best_at(axis, value, start))
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
                found[inner] = self._best_at(axis, float(logs[axis]), start)

    def _best_at(self, axis: int, value: float, start: NDArray[np.float64]) -> Top:
        """The optimum with coordinate `axis` at `value`."""
        box = self.box.copy()
        box[axis] = value
        return self.climb.to_top(start, box, TOLERANCE)


_AXES: dict[ProfiledParameter, tuple[int, float]] = {
    "shadow_std_db": (0, 2.0),
    "multipath_std_db": (1, 2.0),
    "decorrelation_m": (2, 1.0),
}
"""Where a parameter is among (xi^2, omega^2, beta), and which power of it stands there."""


def _logs(parameters: ChannelParameters) -> NDArray[np.float64]:
    return np.log(
        [
            parameters.shadow_std_db**2,
            parameters.multipath_std_db**2,
            parameters.decorrelation_m,
        ]
    )
