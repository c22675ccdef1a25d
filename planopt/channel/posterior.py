"""The posterior: received power anywhere, given measurements, with path loss estimated.

The expensive part is the factor of the measurements' covariance. It is kept, shared between
successive posteriors, and grows by rows, so that one more measurement costs O(n^2) and copies
nothing. Beyond `EXACT_LIMIT` there is none: theta comes from Vecchia's approximation and a
prediction from the measurements near it, so that the cost of one more does not depend on their
number.

Path loss is found by generalised least squares from products of whitened columns, or by ordinary
least squares with the error that it has under the model: the latter weighs every measurement alike,
which is not best where shadowing is correlated, but does not depend on xi, beta and omega.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import put_lower_factor, whiten
from planopt.channel.estimation.least_squares import MIN_REGRESSOR_SPREAD_DB, receiver_columns
from planopt.channel.gaussian_sites import (
    MIN_NOISE_VARIANCE_DB2,
    LatentPrior,
    Sites,
    gaussian_sites,
    interval_sites,
    intervals,
    needs_site,
)
from planopt.channel.kriging import predict, predict_noiseless
from planopt.channel.local_channel import nearest_to_path
from planopt.channel.measurement_covariance import (
    Origins,
    covariance_db2,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
    place_origins,
)
from planopt.channel.measurements import Measurements, Table, as_measurements, join
from planopt.channel.neighbours import PlaceIndex
from planopt.channel.parameters import ChannelParameters, Station, regressors, require_finite
from planopt.channel.prediction import Prediction, connection_probability
from planopt.channel.vecchia import VecchiaInformation, vecchia_information
from planopt.channel.window_sites import neighbour_sites
from planopt.errors import InputError
from planopt.short_repr import short_repr

FACTOR_BLOCK = 264
"""Rows appended to a factor together; powers of two are slower because of cache conflicts."""

AT_ONCE = 768
"""Up to so many rows a factor is made in one piece."""


class FactorBuffer:
    """Lower Cholesky factor with spare rows; rows from `used` on are free."""

    def __init__(self, capacity: int) -> None:
        self.lower: NDArray[np.float64] = np.zeros((capacity, capacity))
        self.used = 0


def spacious(count: int) -> int:
    """Capacity for `count` rows and more to come; zeroed pages cost nothing until written."""
    return count + count // 2 + 64


def with_room(buffer: FactorBuffer | None, used: int, count: int) -> FactorBuffer:
    """A buffer for `count` rows whose first `used` ones are those of `buffer`.

    That itself where it has room and its free rows are not taken by another posterior.
    """
    if buffer is not None and buffer.used == used and len(buffer.lower) >= count:
        return buffer
    grown = FactorBuffer(spacious(count))
    if buffer is not None:
        grown.lower[:used, :used] = buffer.lower[:used, :used]
    grown.used = used
    return grown


def append_rows(
    buffer: FactorBuffer,
    parameters: ChannelParameters,
    origins: Origins,
    noise_variance_db2: NDArray[np.float64],  # (n,) variance of the noise of each
    columns: NDArray[np.float64],  # (n, c), whitened as far as the factor goes
) -> None:
    """Add the rows from `buffer.used` on to the factor, and whiten those of `columns` in place."""
    lower, count = buffer.lower, len(columns)
    block = AT_ONCE if count <= AT_ONCE else FACTOR_BLOCK
    for start in range(buffer.used, count, block):
        rows = slice(start, min(start + block, count))
        across = whiten(
            lower[:start, :start],
            covariance_db2(origins.at(slice(start)), origins.at(rows), parameters),
        )
        within = own_covariance_db2(origins.at(rows), parameters)
        within[np.diag_indices_from(within)] += noise_variance_db2[rows]
        if start:
            within -= across.T @ across
        lower[rows, :start] = across.T
        put_lower_factor(lower[rows, rows], within)
        columns[rows] = whiten(lower[rows, rows], columns[rows] - across.T @ columns[:start])
    buffer.used = count


def least_squares_theta(
    measurements: Measurements,
    values_db: NDArray[np.float64],
    lower: NDArray[np.float64],  # (n, n) Cholesky factor of U
    station: Station,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Theta and its error covariance (G'G)^-1 G'UG (G'G)^-1; None where it is not identified.

    Censored measurements are left out, since a limit has no residual. Offsets of receivers are
    estimated along with theta.
    """
    exact = ~measurements.censored
    known = measurements.take(exact)
    gamma = regressors(known.positions_m, station)
    if not len(known) or float(np.ptp(gamma[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return None
    columns = np.column_stack([gamma, receiver_columns(known)])
    inverse = np.linalg.pinv(columns)[: gamma.shape[1]]
    half = inverse @ lower[exact]
    return inverse @ values_db[exact], half @ half.T


WEAK_THETA_DEVIATION = (20.0, 1.0)
"""Prior deviation of K_PL (dB) and n_PL, used only where the measurements do not identify theta."""

MAX_INFORMATION_CONDITION = 1e10
"""Theta counts as identified while the condition number of its information, in units of
`WEAK_THETA_DEVIATION`, is below this."""


def theta_estimate(
    parameters: ChannelParameters, products: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate theta and its covariance M (equation 1.7)."""
    # Shapes: products (3, 3).
    # In units of the weak prior.
    unit = np.array(WEAK_THETA_DEVIATION)
    information = unit[:, None] * products[1:, 1:] * unit
    spread = np.linalg.eigvalsh(information)
    if spread[0] * MAX_INFORMATION_CONDITION <= spread[1]:
        information += np.eye(2)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    moved = unit * (covariance @ (unit * products[1:, 0]))
    theta = np.array([parameters.k_pl_db, parameters.n_pl]) + moved
    return theta, unit[:, None] * covariance * unit


def with_rows(grown: ChannelPosterior, before: ChannelPosterior) -> ChannelPosterior:
    """Add rows to the factor and to the whitened columns, and estimate theta."""
    parameters, old = grown.parameters, len(before.measurements)
    new = slice(old, None)
    columns = np.empty((len(grown.measurements), 3))
    columns[:old, 0], columns[:old, 1:] = before.whitened_values, before.whitened_regressors
    columns[new, 0] = grown.values_db[new]
    columns[new, 1:] = regressors(grown.measurements.positions_m[new], parameters.station)
    buffer = with_room(before.buffer, old, len(columns))
    append_rows(buffer, parameters, grown.origins, grown.noise_variance_db2, columns)
    about = columns.copy()
    about[:, 0] -= columns[:, 1:] @ [parameters.k_pl_db, parameters.n_pl]
    conditioned = replace(
        grown,
        whitened_values=np.ascontiguousarray(columns[:, 0]),
        whitened_regressors=np.ascontiguousarray(columns[:, 1:]),
        buffer=buffer,
    )
    return _with_theta(conditioned, about.T @ about)


def without_factor(grown: ChannelPosterior, before: ChannelPosterior) -> ChannelPosterior:
    """Sum the information of all measurements by Vecchia's approximation.

    `grown` and `before` as for :func:`with_rows`.
    """
    information = vecchia_information(
        grown.parameters,
        grown.measurements,
        grown.values_db,
        grown.noise_variance_db2,
        None if before.information is None else (before.information, before.index),
    )
    conditioned = replace(
        grown,
        whitened_values=np.zeros(0),
        whitened_regressors=np.zeros((0, 2)),
        buffer=None,
        information=information,
    )
    return _with_theta(conditioned, information.path_loss_products())


def _with_theta(posterior: ChannelPosterior, products: NDArray[np.float64]) -> ChannelPosterior:
    """Estimate theta by its rule; `products` as for `theta_estimate`."""
    if posterior.theta_known:
        return posterior
    theta, covariance = theta_estimate(posterior.parameters, products)
    if posterior.theta_rule == "least_squares":
        found = least_squares_theta(
            posterior.measurements,
            posterior.values_db,
            posterior.factor,
            posterior.parameters.station,
        )
        theta, covariance = found or (theta, covariance)
    return replace(posterior, theta=theta, theta_covariance=covariance)


MOST_JOINT_SITES = 300
"""Beyond so many censored or coarsely rounded measurements their sites are matched window by window
(:mod:`planopt.channel.window_sites`): jointly a sweep costs the cube of their number, at
750 ten times as much."""

ThetaRule = Literal["estimated", "known", "least_squares"]

EXACT_LIMIT = 5_000
"""Up to so many measurements all of them count; their factor takes 200 MB, and 450 MB with room to
grow."""


@dataclass(frozen=True, eq=False)
class ChannelPosterior:
    """The channel given measurements (universal kriging, equations 1.6 to 1.8).

    Attributes
    ----------
    parameters
        The channel's parameters; its theta is used where theta is known, and as the centre of
        the weak prior.
    measurements
        What was measured, kappa of them.
    values_db
        ``(kappa,)`` what the posterior is conditioned on: the measured power, and the site's
        value where it is censored or coarsely rounded.
    noise_variance_db2
        ``(kappa,)`` omega^2, with r^2 / 12 or the site's variance where rounded or censored, and
        with the variance that a position error gives path loss.
    whitened_values
        ``(kappa,)`` z_y = L^-1 y with U = R + diag(noise) = L L'.
    whitened_regressors
        ``(kappa, 2)`` z_Gamma = L^-1 Gamma.
    theta
        ``(2,)`` (K_PL, n_PL) in use.
    theta_covariance
        ``(2, 2)`` M, its covariance; zero where theta is known.
    theta_rule
        Where theta comes from, as :func:`condition` was told.
    now_s
        The time that is predicted for, where the channel forgets: that of the latest measurement,
        unless :func:`at_time` says otherwise.
    index
        Of the measured places.
    exact_limit
        Up to so many measurements there is a factor.
    buffer
        Where the factor is stored, shared with the posteriors that extend this one; None where
        there is none, and then whitened columns are empty.
    information
        What stands for the factor where there is none.
    """

    parameters: ChannelParameters
    measurements: Measurements
    values_db: NDArray[np.float64]
    noise_variance_db2: NDArray[np.float64]
    whitened_values: NDArray[np.float64]
    whitened_regressors: NDArray[np.float64]
    theta: NDArray[np.float64]
    theta_covariance: NDArray[np.float64]
    theta_rule: ThetaRule
    now_s: float
    index: PlaceIndex = field(repr=False)
    exact_limit: int = EXACT_LIMIT
    buffer: FactorBuffer | None = field(default=None, repr=False)
    information: VecchiaInformation | None = field(default=None, repr=False)

    __repr__ = short_repr

    @property
    def has_factor(self) -> bool:
        """Return whether predictions are from all measurements, not from the nearest."""
        return self.buffer is not None

    @property
    def theta_known(self) -> bool:
        """Return whether theta was given rather than estimated."""
        return self.theta_rule == "known"

    @property
    def factor(self) -> NDArray[np.float64]:
        """Lower Cholesky factor L of U, ``(kappa, kappa)``; a view, not to be written to.

        Raises
        ------
        InputError
            There are more than `exact_limit` measurements.
        """
        count = len(self.measurements)
        if self.buffer is None:
            raise InputError(
                f"this needs the factor of all measurements, and {count:,} are more than the "
                f"{self.exact_limit:,} that are factorised",
                key="measurements",
                remedy="condition on those near the places in question",
            )
        return self.buffer.lower[:count, :count]

    @cached_property
    def origins(self) -> Origins:
        """Return places, times and receivers of the measurements."""
        return measured_origins(self.measurements, self.parameters)

    def continues(self, earlier: ChannelPosterior) -> bool:
        """Return whether this is `earlier` and, it may be, later measurements; at any time."""
        if self is earlier:
            return True
        count = len(earlier.measurements)
        if self.parameters != earlier.parameters or count > len(self.measurements):
            return False
        one, other = self.measurements, earlier.measurements
        return (
            np.array_equal(self.values_db[:count], earlier.values_db)
            and np.array_equal(self.noise_variance_db2[:count], earlier.noise_variance_db2)
            and np.array_equal(one.positions_m[:count], other.positions_m)
            and np.array_equal(one.position_std_m[:count], other.position_std_m)
            and np.array_equal(one.time_s[:count], other.time_s)
            and np.array_equal(one.receiver[:count], other.receiver)
        )

    def covariance_with_db2(self, positions_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance of all measurements with the power at places (n, 2) now; ``(kappa, n)``."""
        places = place_origins(positions_m, self.now_s, self.parameters)
        return covariance_db2(self.origins, places, self.parameters)

    def predict(self, positions_m: ArrayLike) -> Prediction:
        """See :func:`planopt.channel.kriging.predict`."""
        return predict(self, positions_m)

    def extend(self, more: Measurements | Table) -> ChannelPosterior:
        """See :func:`extend`; tables are taken as well."""
        return extend(self, as_measurements(more))

    def connectivity(self, positions_m: ArrayLike, threshold_dbm: float) -> NDArray[np.float64]:
        """P(power >= `threshold_dbm`) at each of `positions_m` (n, 2); ``(n,)``."""
        threshold = require_finite(threshold_dbm, "threshold_dbm")
        prediction = predict(self, positions_m)
        return connection_probability(prediction.mean_db, prediction.deviation_db, threshold)


def condition(
    parameters: ChannelParameters,
    measurements: Measurements | Table,
    *,
    theta: ThetaRule = "estimated",
    exact_limit: int = EXACT_LIMIT,
    similar: ChannelPosterior | None = None,
) -> ChannelPosterior:
    """Condition the channel model on measurements (Lemma 2 of [GM11], equation 1.8).

    Parameters
    ----------
    parameters
        The channel's parameters.
    measurements
        Any number, none included. Censored and rounded ones enter as Gaussian sites.
    theta
        ``estimated``: path loss by generalised least squares, its uncertainty counted
        (equation 1.8); ``known``: `parameters` has it exactly; ``least_squares``: by ordinary
        least squares where that identifies it, its uncertainty counted too (equation 1.9). What
        kriging leaves of the power at a place is uncorrelated with all measurements, and so with
        any theta that is linear in them: the variance is s + varphi' M varphi with that theta's
        error covariance M.
    exact_limit
        Beyond so many measurements predictions are from the nearest
        (:func:`planopt.channel.kriging.predict`), theta is from Vecchia's approximation
        (:data:`planopt.channel.neighbours.BESIDE` has the accuracies), and
        sites are matched by neighbours.
    similar
        The same measurements under similar parameters: sites that are matched by neighbours start
        from its, and take fewer sweeps.

    Raises
    ------
    InputError
        Theta by least squares, from more than `exact_limit` measurements.
    """
    measurements = as_measurements(measurements)
    exact = len(measurements) <= exact_limit
    joint = int(needs_site(measurements, parameters.multipath_std_db**2).sum()) <= MOST_JOINT_SITES
    if exact and joint:
        sites = gaussian_sites(parameters, measurements)
    else:
        start = None if similar is None else Sites(similar.values_db, similar.noise_variance_db2)
        sites = neighbour_sites(parameters, measurements, start)
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    empty = ChannelPosterior(
        parameters,
        nothing,
        np.zeros(0),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 2)),
        np.array([parameters.k_pl_db, parameters.n_pl]),
        np.zeros((2, 2)),
        theta,
        0.0,
        PlaceIndex.of(nothing.positions_m),
        exact_limit,
        FactorBuffer(spacious(len(measurements) if exact else 0)),
    )
    return _append(empty, measurements, sites)


def extend(posterior: ChannelPosterior, more: Measurements) -> ChannelPosterior:
    """Condition on more measurements without refitting, O(kappa^2) for each with a factor.

    Without one the cost of each does not depend on how many there are. The first one beyond
    `exact_limit` drops the factor, and all are counted anew.

    A censored or coarsely rounded one becomes a Gaussian site by matching the first two moments of
    its own prediction, truncated to where it is known to lie, and stays that site. `posterior`
    remains valid.
    """
    alone = needs_site(more, posterior.parameters.multipath_std_db**2)
    start = 0
    while start < len(more):
        stop = start + 1
        if not alone[start]:
            while stop < len(more) and not alone[stop]:
                stop += 1
        part = more.take(slice(start, stop))
        sites = (
            _one_site(posterior, part)
            if alone[start]
            else gaussian_sites(posterior.parameters, part)
        )
        posterior = _append(posterior, part, sites)
        start = stop
    return posterior


def with_expected(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64]
) -> ChannelPosterior:
    """Return the posterior as if the predicted power had been measured at places (n, 2)."""
    count = len(posterior.measurements) + len(positions_m)
    # An existing factor is kept: conditioning on neighbours anew would take longer than its rows.
    limit = max(posterior.exact_limit, count) if posterior.has_factor else posterior.exact_limit
    power = posterior.predict(positions_m).mean_db
    times = np.full(len(positions_m), posterior.now_s)
    known = replace(posterior, exact_limit=limit)
    return extend(known, Measurements(positions_m, power, time_s=times))


SHARED_NEIGHBOURS = 512
"""Number of measurements that a path shares in joint laws where there is no factor of all."""


def factored_near(posterior: ChannelPosterior, path_m: NDArray[np.float64]) -> ChannelPosterior:
    """Return `posterior` if it has a factor, else one from those nearest to a path (h, 2).

    Theta and its covariance stay those of all measurements.
    """
    if posterior.has_factor:
        return posterior
    used = np.sort(nearest_to_path(posterior, path_m, SHARED_NEIGHBOURS))
    near = condition(
        posterior.parameters,
        posterior.measurements.take(used),
        theta=posterior.theta_rule,
        exact_limit=len(used),
    )
    return replace(
        near,
        theta=posterior.theta,
        theta_covariance=posterior.theta_covariance,
        now_s=posterior.now_s,
    )


def at_time(posterior: ChannelPosterior, now_s: float) -> ChannelPosterior:
    """The same knowledge, predicting for the time `now_s`; shares the factor, costs nothing."""
    return replace(posterior, now_s=require_finite(now_s, "now_s"))


Estimator = Literal["ml", "ls"]


@dataclass(frozen=True, eq=False)
class ThetaEstimate:
    """Path loss."""

    theta: NDArray[np.float64]  # (2,) (K_PL in dBm, n_PL)
    covariance: NDArray[np.float64]  # (2, 2) of its error under the channel's xi, beta and omega


def estimate_theta(
    measurements: Measurements | Table, parameters: ChannelParameters, how: Estimator = "ml"
) -> ThetaEstimate:
    """Estimate path loss for given xi, beta and omega (equations 1.7 and 1.9).

    Maximum likelihood is generalised least squares, M_ML = (Gamma' U^-1 Gamma)^-1, the smallest
    error of an unbiased estimate; ordinary least squares has (G'G)^-1 G'UG (G'G)^-1, which is never
    smaller. Where the measurements do not identify theta, a weak prior about the theta of
    `parameters` stands in (`WEAK_THETA_DEVIATION`).

    Parameters
    ----------
    measurements
        Any number. Censored ones are Gaussian sites to ``ml``; ``ls`` leaves them out.
    parameters
        The channel; its theta is not used but as said.
    how
        ``ml``: generalised least squares. ``ls``: ordinary least squares.

    Raises
    ------
    InputError
        There is no such estimator.
    """
    measurements = as_measurements(measurements)
    if how not in get_args(Estimator):
        raise InputError(f"{how!r} is no estimator", key="how", remedy="use ml or ls")
    rule = "estimated" if how == "ml" else "least_squares"
    posterior = condition(parameters, measurements, theta=rule)
    return ThetaEstimate(posterior.theta, posterior.theta_covariance)


def _append(posterior: ChannelPosterior, more: Measurements, sites: Sites) -> ChannelPosterior:
    """Add measurements, to the factor while there is one."""
    noise = np.maximum(sites.noise_variance_db2, MIN_NOISE_VARIANCE_DB2)
    noise += measured_path_loss_variance_db2(more, posterior.parameters)
    joined = join(posterior.measurements, more)
    grown = replace(
        posterior,
        measurements=joined,
        values_db=np.concatenate([posterior.values_db, sites.values_db]),
        noise_variance_db2=np.concatenate([posterior.noise_variance_db2, noise]),
        now_s=_latest_s(posterior, more),
        index=posterior.index.grown(joined.positions_m),
    )
    if len(joined) <= posterior.exact_limit:
        return with_rows(grown, posterior)
    return without_factor(grown, posterior)


def _latest_s(posterior: ChannelPosterior, more: Measurements) -> float:
    """The time to predict for once `more` is known."""
    times = more.time_s if not len(posterior.measurements) else [posterior.now_s, *more.time_s]
    return float(max(times, default=posterior.now_s))


def _one_site(posterior: ChannelPosterior, one: Measurements) -> Sites:
    """One new measurement known to be in an interval, as a Gaussian one.

    Moment matching against its own prediction: the one-site case of expectation propagation.
    """
    noise = max(posterior.parameters.multipath_std_db**2, MIN_NOISE_VARIANCE_DB2)
    prediction = predict_noiseless(posterior, one)
    prior = LatentPrior.known_mean(prediction.mean_db, np.diag(prediction.deviation_db**2))
    return interval_sites(prior, intervals(one), noise).as_measurements()
