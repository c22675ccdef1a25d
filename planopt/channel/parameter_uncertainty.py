"""Predictions under uncertain parameters (equation 1.17), and errors due to wrong ones (1.16).

The posterior is a mixture over a lattice of (xi^2 / alpha, beta) along the principal axes of the
likelihood, which also gives the weights. The total variance alpha is integrated out in closed form.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planopt.arrays import Floats
from planopt.channel.cholesky import lower_factor, one_blas_thread, whiten
from planopt.channel.estimation.channel_fit import MIN_NUGGET_SHARE
from planopt.channel.estimation.least_squares import examine
from planopt.channel.estimation.likelihood import (
    LikelihoodData,
    likelihood_data,
    profiled_log_likelihood,
)
from planopt.channel.estimation.reml import MOST_DENSE, thinned
from planopt.channel.gaussian_sites import MIN_NOISE_VARIANCE_DB2, rounded_variance_db2
from planopt.channel.kriging import Prediction, connection_probability
from planopt.channel.measurements import Measurements, Table, as_measurements, shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters, mean_model, regressors, require_places
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior, condition
from planopt.errors import InputError
from planopt.short_repr import short_repr

STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""Design points along each principal axis of the likelihood, in standard deviations."""
MAX_DEVIATION = 1.5  # Maximum standard deviation of log beta or logit(xi^2 / alpha)
MIN_WEIGHT = 0.01  # Minimum weight of a design point, as each costs a factor and a prediction
DIFFERENCE = 0.1
"""Finite-difference step for the likelihood's curvature, in log beta and logit(xi^2 / alpha)."""


@dataclass(frozen=True, eq=False)
class MarginalPosterior:
    """Posterior of the channel as a mixture over covariances.

    Attributes
    ----------
    components
        Posteriors, one for each covariance of the design.
    weights
        ``(k,)`` probabilities of the components, with sum one.
    """

    components: tuple[ChannelPosterior, ...]
    weights: Floats

    __repr__ = short_repr

    def predict(self, positions_m: Floats) -> Prediction:
        """Return mean and standard deviation of the mixture at `positions_m` (n, 2)."""
        places = require_places(positions_m)
        return mixture(self.weights, [component.predict(places) for component in self.components])

    def connectivity(self, positions_m: Floats, threshold_dbm: float) -> Floats:
        """Return P(power >= `threshold_dbm`) (n,) at positions (n, 2) under the mixture."""
        places = require_places(positions_m)
        chances = np.zeros(len(places))
        for weight, component in zip(self.weights, self.components, strict=True):
            part = component.predict(places)
            chances += weight * connection_probability(
                part.mean_db, part.deviation_db, threshold_dbm
            )
        return chances


def mixture(weights: Floats, parts: Sequence[Prediction]) -> Prediction:
    """Return mean and standard deviation of a mixture of predictions, weighted by `weights`."""
    means = np.stack([part.mean_db for part in parts])
    mean = weights @ means
    variances = np.stack([part.deviation_db for part in parts]) ** 2 + (means - mean) ** 2
    return Prediction(mean, np.sqrt(weights @ variances))


@one_blas_thread()
def marginalise(
    parameters: ChannelParameters,
    measurements: Measurements | Table,
    exact_limit: int = EXACT_LIMIT,
) -> MarginalPosterior:
    """Condition on measurements with xi, beta and omega uncertain.

    The prior is flat in log alpha, log beta and logit(xi^2 / alpha), within the bounds of the fit
    (beta between a third of the spacing and the extent, xi^2 / alpha at most 0.99).

    Parameters
    ----------
    parameters
        Estimated parameters, preferably by ``reml``, at the centre of the design. Their theta is
        used as in :func:`planopt.channel.condition`.
    measurements
        Measurements used for the estimate. Censored ones enter the predictions but not the weights;
        alpha is then scaled to the estimate. The weights use a fixed random subset of at most
        `MOST_DENSE` measurements.
    exact_limit
        Maximum number of measurements with a factor, as in :func:`planopt.channel.condition`; each
        of the about 20 components needs one.

    Returns
    -------
    MarginalPosterior
        Mixture posterior; its only component is the estimate if the measurements do not identify a
        covariance.

    Raises
    ------
    InputError
        Nothing can be estimated from the measurements.
    """
    measurements = as_measurements(measurements)
    allows = examine(measurements, parameters.station)
    if allows.covariance_reason is not None:
        return MarginalPosterior(
            (condition(parameters, measurements, exact_limit=exact_limit),), np.ones(1)
        )
    placed = measurements.by_place()
    rows = np.flatnonzero(~placed.censored)
    exact = placed.take(rows[thinned(len(rows), MOST_DENSE)])
    every = np.ones(len(exact), dtype=np.bool_)
    model = mean_model(exact.positions_m, every, parameters.station, allows.n_pl_reason is None)
    data = likelihood_data(model, exact, parameters)
    low, high = allows.decorrelation_bounds_m
    top = math.log((1.0 - MIN_NUGGET_SHARE) / MIN_NUGGET_SHARE)
    box = np.array([[-top, top], [math.log(low), math.log(high)]])
    # The likelihood's alpha includes the variance of rounding, which `condition` adds again.
    rounding = float(rounded_variance_db2(exact.resolution_db).mean())
    multipath_std_db = math.hypot(parameters.multipath_std_db, math.sqrt(rounding))
    shadow, multipath = (
        math.log(max(deviation, sys.float_info.min))
        for deviation in (parameters.shadow_std_db, multipath_std_db)
    )
    centre = np.clip(
        (np.array([2.0 * (shadow - multipath), math.log(parameters.decorrelation_m)])),
        box[:, 0],
        box[:, 1],
    )
    freedom = len(exact) - data.flat_columns().shape[1]
    points = _design(data, centre, box)
    found = [_likelihood(data, point) for point in points]
    logs = np.array([log for log, _ in found])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    kept = np.flatnonzero(weights >= MIN_WEIGHT)
    # Uncensored powers vary less than all powers: scale to the estimate, the first design point.
    unseen = 1.0
    if measurements.censored.any():
        estimate = parameters.shadow_std_db**2 + parameters.multipath_std_db**2 + rounding
        unseen = estimate / found[0][1]
    components: list[ChannelPosterior] = []
    for index in kept:
        share, beta = _values(points[index])
        # A normal distribution with this alpha has the variance of Student's t.
        alpha = unseen * found[index][1] * freedom / (freedom - 2.0)
        nugget = (1.0 - share) * alpha
        nugget = max(nugget - rounding, MIN_NUGGET_SHARE * nugget)
        component = replace(
            parameters,
            shadow_std_db=math.sqrt(share * alpha),
            multipath_std_db=math.sqrt(nugget),
            decorrelation_m=beta,
        )
        similar = components[-1] if components else None
        components.append(
            condition(component, measurements, exact_limit=exact_limit, similar=similar)
        )
    return MarginalPosterior(tuple(components), weights[kept] / weights[kept].sum())


def _design(data: LikelihoodData, centre: Floats, box: Floats) -> Floats:
    """Return points (k, 2) on a lattice along the principal axes of the likelihood."""
    curvature = np.empty((2, 2))
    # Near the edge of the box the differences are taken around a point moved inwards.
    middle = np.clip(centre, box[:, 0] + DIFFERENCE, box[:, 1] - DIFFERENCE)
    first, second = DIFFERENCE * np.eye(2)

    def value(point: Floats) -> float:
        return _likelihood(data, point)[0]

    here = value(middle)
    for axis, step in enumerate((first, second)):
        curvature[axis, axis] = 2.0 * here - value(middle + step) - value(middle - step)
    curvature[0, 1] = curvature[1, 0] = -0.25 * (
        value(middle + first + second)
        - value(middle + first - second)
        - value(middle - first + second)
        + value(middle - first - second)
    )
    eigenvalues, axes = np.linalg.eigh(curvature / DIFFERENCE**2)
    deviations = 1.0 / np.sqrt(np.maximum(eigenvalues, MAX_DEVIATION**-2))
    steps = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)
    points = centre + (steps * deviations) @ axes.T
    inside = np.all((box[:, 0] <= points) & (points <= box[:, 1]), axis=1)
    # The centre is added separately, because rounding may put it outside the box.
    return np.concatenate([centre[None], points[inside & steps.any(axis=1)]])


def _likelihood(data: LikelihoodData, point: Floats) -> tuple[float, float]:
    """Return the log-likelihood up to a constant, with alpha integrated out, and the best alpha."""
    return profiled_log_likelihood(data, *_values(point))


def _values(point: Floats) -> tuple[float, float]:
    """Return (xi^2 / alpha, beta) of a design point."""
    return 1.0 / (1.0 + math.exp(-point[0])), math.exp(point[1])


ELEMENTS = 2**17  # Target number of position-measurement pairs in a block


PERTURBED = ("k_pl_db", "n_pl", "shadow_variance_db2", "decorrelation_m", "multipath_std_db")
"""Names of the parameters perturbed in Fig. 1 of [GM11]: K_PL, n_PL, xi^2, beta and omega."""


def mean_squared_error_db2(
    true: ChannelParameters,
    assumed: ChannelParameters,
    measured_m: ArrayLike,
    positions_m: ArrayLike,
) -> Floats:
    """Return the mean squared prediction error Delta^2 for wrong parameters (equation 1.16).

    With w = U_est^-1 phi_est the weights of equation 1.6 and delta theta = theta - theta_est,

        Delta^2 = xi^2 + omega^2 - 2 w' phi + w' U w + ((gamma - Gamma' w)' delta theta)^2,

    as in [GM11]. The last term, the squared bias, is computed from true and assumed path loss, so
    the assumed station may be wrong too. The posterior assumes that theta is known.

    Parameters
    ----------
    true
        True parameters of the channel.
    assumed
        Parameters that the posterior assumes.
    measured_m
        ``(kappa, 2)`` positions of uncensored measurements; may be empty.
    positions_m
        ``(n, 2)`` positions of the predictions.

    Returns
    -------
    NDArray
        ``(n,)`` mean squared errors in dB^2, multipath included.

    Raises
    ------
    InputError
        Positions are not ``(n, 2)`` and finite, or there are more than `EXACT_LIMIT` measured ones.
    """
    measured = require_places(measured_m, at_least=0)
    if len(measured) > EXACT_LIMIT:
        raise InputError(
            f"has {len(measured):,} measurements, but exact computation is limited to "
            f"{EXACT_LIMIT:,}",
            key="measured_m",
            remedy="give only the measurements near the positions of interest",
        )
    places = require_places(positions_m)
    count = len(measured)
    total = shadow_covariance_db2(measured, measured, true)
    total[np.diag_indices(count)] += true.multipath_std_db**2
    # The posterior as planopt computes it, with its minimum nugget.
    believed = shadow_covariance_db2(measured, measured, assumed)
    believed[np.diag_indices(count)] += max(assumed.multipath_std_db**2, MIN_NOISE_VARIANCE_DB2)
    precision = _inverse(believed)
    # w' U w = phi_est' B phi_est needs one product per block of positions.
    spread = precision @ total @ precision
    offset = _path_loss_db(true, measured) - _path_loss_db(assumed, measured)
    error = np.empty(len(places))
    block = max(1, ELEMENTS // max(1, count))
    for start in range(0, len(places), block):
        part = slice(start, start + block)
        across = shadow_covariance_db2(places[part], measured, true)
        across_assumed = shadow_covariance_db2(places[part], measured, assumed)
        weights = across_assumed @ precision
        bias = _path_loss_db(true, places[part]) - _path_loss_db(assumed, places[part])
        bias -= weights @ offset
        error[part] = (
            np.einsum("nk,nk->n", across_assumed @ spread, across_assumed)
            - 2.0 * np.einsum("nk,nk->n", weights, across)
            + bias**2
        )
    return error + true.shadow_std_db**2 + true.multipath_std_db**2


def perturbed(parameters: ChannelParameters, name: str, relative_error: float) -> ChannelParameters:
    """Return `parameters` with the one called `name` multiplied by 1 + `relative_error`."""
    if not (math.isfinite(relative_error) and relative_error > -1.0):
        raise InputError(
            f"is {relative_error!r}, should be above -1 (-100 %)",
            key="relative_error",
            remedy="give a fraction, e.g. 0.1 for +10 %",
        )
    factor = 1.0 + relative_error
    if name == "shadow_variance_db2":
        return replace(parameters, shadow_std_db=parameters.shadow_std_db * math.sqrt(factor))
    if name not in PERTURBED:
        raise InputError(
            f"is {name!r}, which is not a parameter that can be perturbed",
            key="name",
            remedy=f"use one of {', '.join(PERTURBED)}",
        )
    return replace(parameters, **{name: getattr(parameters, name) * factor})


def sensitivity_curves(
    true: ChannelParameters,
    measured_m: Floats,
    positions_m: Floats,
    relative_errors: Sequence[float],
) -> dict[str, Floats]:
    """Return the mean squared prediction error against each parameter's error ([GM11], Fig. 1).

    Parameters
    ----------
    true
        True parameters of the channel.
    measured_m
        ``(kappa, 2)`` positions of measurements.
    positions_m
        ``(n, 2)`` positions to average over, which represent the workspace.
    relative_errors
        ``(k,)`` relative errors, 0.1 for 10 %.

    Returns
    -------
    dict
        ``(k,)`` averages in dB^2 for each of `PERTURBED`.
    """
    return {
        name: np.array(
            [
                mean_squared_error_db2(
                    true, perturbed(true, name, error), measured_m, positions_m
                ).mean()
                for error in relative_errors
            ]
        )
        for name in PERTURBED
    }


def _inverse(covariance: Floats) -> Floats:
    """Return the inverse of a covariance (kappa, kappa), also for kappa = 0."""
    if not len(covariance):
        return covariance
    half = whiten(lower_factor(covariance), np.eye(len(covariance)))
    return half.T @ half


def _path_loss_db(parameters: ChannelParameters, places_m: Floats) -> Floats:
    """Return the mean power at `places_m` (n, 2) from path loss alone."""
    theta = np.array([parameters.k_pl_db, parameters.n_pl])
    return regressors(places_m, parameters.station) @ theta
