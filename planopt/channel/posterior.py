"""Posterior of the channel: received power at any position, conditional on measurements.

The Cholesky factor of the measurements' covariance is shared between successive posteriors and
grows by rows, so one more measurement costs O(n^2) without copying. Beyond `EXACT_LIMIT`
measurements there is no factor: theta comes from Vecchia's approximation and predictions use the
nearest measurements.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from planopt.arrays import Floats
from planopt.channel.cholesky import put_lower_factor, whiten
from planopt.channel.estimation.channel_fit import ChannelFit
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
from planopt.channel.kriging import (
    Prediction,
    connection_probability,
    nearest_to_path,
    predict,
    predict_noiseless,
)
from planopt.channel.long_logs import VecchiaInformation, neighbour_sites, vecchia_information
from planopt.channel.measurements import (
    Measurements,
    Origins,
    Table,
    as_measurements,
    covariance_db2,
    join,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
    place_origins,
)
from planopt.channel.neighbours import PlaceIndex
from planopt.channel.parameters import ChannelParameters, regressors, require_finite
from planopt.errors import InputError
from planopt.short_repr import short_repr

FACTOR_BLOCK = 264
"""Number of rows appended to a Cholesky factor at once; powers of two cause cache conflicts."""
AT_ONCE = 768  # Maximum number of rows of a Cholesky factor that is computed in one block
WEAK_THETA_DEVIATION = (20.0, 1.0)
"""Prior standard deviation of K_PL (dB) and n_PL, used if measurements do not identify theta."""
MAX_INFORMATION_CONDITION = 1e10
"""Maximum condition number of theta's information, in units of `WEAK_THETA_DEVIATION`."""
MOST_JOINT_SITES = 300  # Maximum number of joint sites, whose sweep costs their number cubed
EXACT_LIMIT = 5_000
"""Maximum number of measurements with a Cholesky factor (200 MB, or 450 MB with room to grow)."""
SHARED_NEIGHBOURS = 512
"""Number of measurements used for the joint law along a path if there is no full factor."""

ThetaRule = Literal["estimated", "known", "least_squares"]


class FactorBuffer:
    """Storage of a lower Cholesky factor that grows by rows; rows from `used` on are free."""

    def __init__(self, count: int) -> None:
        # Zeroed memory pages are free until written.
        capacity = count + count // 2 + 64
        self.lower: Floats = np.zeros((capacity, capacity))
        self.used = 0

    def append(
        self,
        parameters: ChannelParameters,
        origins: Origins,  # (n,) of all measurements
        noise_variance_db2: Floats,  # (n,)
        columns: Floats,  # (n, c), the first `used` rows already whitened
    ) -> None:
        """Append rows `used` onwards to the factor, and whiten these rows of `columns` in place."""
        lower, count = self.lower, len(columns)
        block = AT_ONCE if count <= AT_ONCE else FACTOR_BLOCK
        for start in range(self.used, count, block):
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
        self.used = count


def with_room(buffer: FactorBuffer | None, used: int, count: int) -> FactorBuffer:
    """Return a buffer with room for `count` rows and the first `used` rows of `buffer`."""
    # Returns `buffer` itself if it has room and no other posterior uses its free rows.
    if buffer is not None and buffer.used == used and len(buffer.lower) >= count:
        return buffer
    grown = FactorBuffer(count)
    if buffer is not None:
        grown.lower[:used, :used] = buffer.lower[:used, :used]
    grown.used = used
    return grown


@dataclass(frozen=True, eq=False)
class ChannelPosterior:
    """Channel conditional on measurements (universal kriging, equations 1.6 to 1.8).

    Attributes
    ----------
    parameters
        Parameters of the channel. Their theta is used if theta is known; otherwise it is the mean
        of the weak prior.
    measurements
        The kappa measurements.
    values_db
        ``(kappa,)`` values conditioned on: the measured power, or the Gaussian site's value for a
        censored or coarsely rounded measurement.
    noise_variance_db2
        ``(kappa,)`` noise variance: omega^2, plus r^2 / 12 if rounded, or the site's variance. The
        variance of path loss due to position errors is added.
    whitened_values
        ``(kappa,)`` z_y = L^-1 y with U = R + diag(noise) = L L'; empty if L is not computed.
    whitened_regressors
        ``(kappa, 2)`` z_Gamma = L^-1 Gamma; empty if L is not computed.
    theta
        ``(2,)`` estimated or known (K_PL, n_PL).
    theta_covariance
        ``(2, 2)`` covariance M of theta; zero if theta is known.
    theta_rule
        Rule for theta, as passed to :func:`condition`.
    now_s
        Time of predictions in a time-varying channel: the time of the latest measurement, or the
        time passed to :func:`at_time`.
    index
        Search tree of the measured positions.
    exact_limit
        Maximum number of measurements for which L is computed.
    buffer
        Storage of the factor, shared with posteriors that extend this one. None without a factor.
    information
        Vecchia's approximation of theta's information; None with a factor.
    """

    parameters: ChannelParameters
    measurements: Measurements
    values_db: Floats
    noise_variance_db2: Floats
    whitened_values: Floats
    whitened_regressors: Floats
    theta: Floats
    theta_covariance: Floats
    theta_rule: ThetaRule
    now_s: float
    index: PlaceIndex = field(repr=False)
    exact_limit: int = EXACT_LIMIT
    buffer: FactorBuffer | None = field(default=None, repr=False)
    information: VecchiaInformation | None = field(default=None, repr=False)

    __repr__ = short_repr

    @property
    def has_factor(self) -> bool:
        """Return whether predictions use all measurements, not only the nearest."""
        return self.buffer is not None

    @property
    def theta_known(self) -> bool:
        """Return whether theta is known rather than estimated."""
        return self.theta_rule == "known"

    @property
    def factor(self) -> Floats:
        """Lower Cholesky factor L of U, ``(kappa, kappa)``, as a view; do not modify it.

        Raises
        ------
        InputError
            There are more than `exact_limit` measurements.
        """
        count = len(self.measurements)
        if self.buffer is None:
            raise InputError(
                f"there are {count:,} measurements, but exact computation is limited to "
                f"{self.exact_limit:,}",
                key="measurements",
                remedy="condition on the measurements near the positions of interest",
            )
        return self.buffer.lower[:count, :count]

    @cached_property
    def origins(self) -> Origins:
        """Return positions, times and receivers of the measurements."""
        return measured_origins(self.measurements, self.parameters)

    def continues(self, earlier: ChannelPosterior) -> bool:
        """Return whether this posterior equals or extends `earlier`, regardless of `now_s`."""
        if self is earlier:
            return True
        count = len(earlier.measurements)
        if self.parameters != earlier.parameters or count > len(self.measurements):
            return False
        one, other = self.measurements, earlier.measurements
        names = ("positions_m", "position_std_m", "time_s", "receiver")
        pairs = [(getattr(one, name), getattr(other, name)) for name in names]
        pairs += [
            (self.values_db, earlier.values_db),
            (self.noise_variance_db2, earlier.noise_variance_db2),
        ]
        return all(np.array_equal(mine[:count], former) for mine, former in pairs)

    def covariance_with_db2(self, positions_m: Floats) -> Floats:
        """Return covariances (kappa, n) of the measurements with the power at n positions."""
        places = place_origins(positions_m, self.now_s, self.parameters)
        return covariance_db2(self.origins, places, self.parameters)

    def predict(self, positions_m: ArrayLike) -> Prediction:
        """Predict power at positions; see :func:`planopt.channel.kriging.predict`."""
        return predict(self, positions_m)

    def extend(self, more: Measurements | Table) -> ChannelPosterior:
        """Condition on more measurements or a table of them; see :func:`extend`."""
        return extend(self, as_measurements(more))

    def connectivity(self, positions_m: ArrayLike, threshold_dbm: float) -> Floats:
        """Return P(power >= `threshold_dbm`) (n,) at positions (n, 2)."""
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
        Parameters of the channel.
    measurements
        Measurements; may be empty. Censored and coarsely rounded ones become Gaussian sites.
    theta
        ``estimated``: path loss by generalised least squares, with its uncertainty (equation
        1.8). ``known``: the path loss of `parameters` is exact. ``least_squares``: ordinary least
        squares, if it identifies theta, with its uncertainty (equation 1.9). The kriging error is
        uncorrelated with any estimate of theta that is linear in the measurements, so the variance
        is s + varphi' M varphi (equation 1.8) with M the error covariance of that estimate.
    exact_limit
        Maximum number of measurements for which L is computed. Beyond it, predictions use the
        nearest measurements, and theta comes from Vecchia's approximation (see
        :data:`planopt.channel.neighbours.BLOCK_NEIGHBOURS` for its accuracy).
    similar
        Posterior of the same measurements under similar parameters; warm start of the sites of
        long logs.

    Raises
    ------
    InputError
        `theta` is ``least_squares`` and there are more than `exact_limit` measurements.
    """
    measurements = as_measurements(measurements)
    exact = len(measurements) <= exact_limit
    joint = int(needs_site(measurements, parameters.white_variance_db2).sum()) <= MOST_JOINT_SITES
    if exact and joint:
        sites = gaussian_sites(parameters, measurements)
    else:
        start = None if similar is None else Sites(similar.values_db, similar.noise_variance_db2)
        sites = neighbour_sites(parameters, measurements, start)
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    empty = ChannelPosterior(
        parameters,
        nothing,
        *(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2))),
        np.array([parameters.k_pl_db, parameters.n_pl]),
        np.zeros((2, 2)),
        theta,
        0.0,
        PlaceIndex.of(nothing.positions_m),
        exact_limit,
        FactorBuffer(len(measurements) if exact else 0),
    )
    return _append(empty, measurements, sites)


def extend(posterior: ChannelPosterior, more: Measurements) -> ChannelPosterior:
    """Condition on more measurements without refitting the parameters.

    Each measurement costs O(kappa^2) with a factor, and O(1) without. The factor is dropped as soon
    as `exact_limit` is exceeded. A censored or coarsely rounded measurement becomes a Gaussian site
    that matches the moments of its prediction truncated to its interval. `posterior` remains valid.
    """
    alone = needs_site(more, posterior.parameters.white_variance_db2)
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


def with_expected(posterior: ChannelPosterior, positions_m: Floats) -> ChannelPosterior:
    """Return the posterior with the predicted powers at n positions added as measurements."""
    count = len(posterior.measurements) + len(positions_m)
    # Extending an existing factor is faster than conditioning on neighbours.
    limit = max(posterior.exact_limit, count) if posterior.has_factor else posterior.exact_limit
    power = posterior.predict(positions_m).mean_db
    times = np.full(len(positions_m), posterior.now_s)
    known = replace(posterior, exact_limit=limit)
    return extend(known, Measurements(positions_m, power, time_s=times))


def with_repeated(
    posterior: ChannelPosterior, positions_m: Floats, noise_variance_db2: Floats
) -> ChannelPosterior:
    """Return the posterior's covariance after measurements with given noise; the mean is kept."""
    count, times = len(posterior.measurements), np.full(len(positions_m), posterior.now_s)
    more = Measurements(positions_m, np.zeros(len(times)), time_s=times)
    limit = max(posterior.exact_limit, count + len(times))
    known = replace(posterior, theta_rule="known", exact_limit=limit)
    grown = _append(known, more, Sites(more.power_dbm, noise_variance_db2))
    rows = grown.whitened_regressors[count:]
    gain = np.eye(2) + posterior.theta_covariance @ (rows.T @ rows)
    left = np.linalg.solve(gain, posterior.theta_covariance)
    return replace(grown, theta_covariance=0.5 * (left + left.T))


def factored_near(posterior: ChannelPosterior, path_m: Floats) -> ChannelPosterior:
    """Return `posterior` if it has a factor, else one with a factor from data near `path_m`."""
    # Theta and its covariance still come from all measurements.
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
    """Return the posterior for predictions at time `now_s`; both posteriors share the factor."""
    return replace(posterior, now_s=require_finite(now_s, "now_s"))


def _append(posterior: ChannelPosterior, more: Measurements, sites: Sites) -> ChannelPosterior:
    """Return the posterior with measurements added to its factor, or to Vecchia's sums."""
    parameters = posterior.parameters
    noise = np.maximum(sites.noise_variance_db2, MIN_NOISE_VARIANCE_DB2)
    noise += measured_path_loss_variance_db2(more, parameters)
    joined = join(posterior.measurements, more)
    old = len(posterior.measurements)
    times = [posterior.now_s, *more.time_s] if old else more.time_s
    grown = replace(
        posterior,
        measurements=joined,
        values_db=np.concatenate([posterior.values_db, sites.values_db]),
        noise_variance_db2=np.concatenate([posterior.noise_variance_db2, noise]),
        now_s=float(max(times, default=posterior.now_s)),
        index=posterior.index.grown(joined.positions_m),
    )
    if len(joined) > posterior.exact_limit:
        before = None if posterior.information is None else (posterior.information, posterior.index)
        information = vecchia_information(
            parameters, joined, grown.values_db, grown.noise_variance_db2, before
        )
        grown = replace(
            grown,
            whitened_values=np.zeros(0),
            whitened_regressors=np.zeros((0, 2)),
            buffer=None,
            information=information,
        )
        return _with_theta(grown, information.path_loss_products())
    columns = np.empty((len(joined), 3))
    columns[:old, 0], columns[:old, 1:] = posterior.whitened_values, posterior.whitened_regressors
    columns[old:, 0] = sites.values_db
    columns[old:, 1:] = regressors(more.positions_m, parameters.station)
    buffer = with_room(posterior.buffer, old, len(columns))
    buffer.append(parameters, grown.origins, grown.noise_variance_db2, columns)
    grown = replace(
        grown,
        whitened_values=columns[:, 0].copy(),
        whitened_regressors=columns[:, 1:].copy(),
        buffer=buffer,
    )
    columns[:, 0] -= columns[:, 1:] @ [parameters.k_pl_db, parameters.n_pl]
    return _with_theta(grown, columns.T @ columns)


def _with_theta(posterior: ChannelPosterior, products: Floats) -> ChannelPosterior:
    """Return the posterior with theta estimated by its rule; known theta is kept."""
    if posterior.theta_known:
        return posterior
    theta, covariance = theta_estimate(posterior.parameters, products)
    if posterior.theta_rule == "least_squares":
        theta, covariance = least_squares_theta(posterior) or (theta, covariance)
    return replace(posterior, theta=theta, theta_covariance=covariance)


def theta_estimate(
    parameters: ChannelParameters,
    products: Floats,  # (3, 3) of whitened [y - Gamma theta_0, Gamma]
) -> tuple[Floats, Floats]:
    """Estimate theta and its covariance M (equation 1.7, or 2.14 with a prior on n_PL)."""
    # Scaled by the weak prior's standard deviations.
    unit = np.array(WEAK_THETA_DEVIATION)
    score, precision = products[1:, 0], np.zeros((2, 2))
    if parameters.n_pl_prior is not None:
        mean, deviation = parameters.n_pl_prior
        precision[1, 1] = deviation**-2
        score = score + precision @ [0.0, mean - parameters.n_pl]
    information = unit[:, None] * (products[1:, 1:] + precision) * unit
    eigenvalues = np.linalg.eigvalsh(information)
    if eigenvalues[0] * MAX_INFORMATION_CONDITION <= eigenvalues[1]:
        information += np.eye(2)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    moved = unit * (covariance @ (unit * score))
    theta = np.array([parameters.k_pl_db, parameters.n_pl]) + moved
    return theta, unit[:, None] * covariance * unit


def least_squares_theta(posterior: ChannelPosterior) -> tuple[Floats, Floats] | None:
    """Return ordinary least-squares theta and its error covariance, or None if unidentifiable."""
    # Receivers' offsets are estimated together with theta.
    exact = ~posterior.measurements.censored
    known = posterior.measurements.take(exact)
    gamma = regressors(known.positions_m, posterior.parameters.station)
    if not len(known) or float(np.ptp(gamma[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return None
    columns = np.column_stack([gamma, receiver_columns(known)])
    inverse = np.linalg.pinv(columns)[: gamma.shape[1]]
    half = inverse @ posterior.factor[exact]
    return inverse @ posterior.values_db[exact], half @ half.T


def _one_site(posterior: ChannelPosterior, one: Measurements) -> Sites:
    """Return the Gaussian site of one new interval measurement, by EP with one site."""
    noise = max(posterior.parameters.white_variance_db2, MIN_NOISE_VARIANCE_DB2)
    prediction = predict_noiseless(posterior, one)
    prior = LatentPrior.known_mean(prediction.mean_db, np.diag(prediction.deviation_db**2))
    return interval_sites(prior, intervals(one), noise).as_measurements()


@dataclass(frozen=True)
class Belief:
    """Fit and posterior of each station's channel; `further` has all stations but the first.

    Attributes
    ----------
    fit
        Fit of the parameters to the initial measurements.
    posterior
        Posterior of all measurements so far.
    further
        Beliefs about the other stations, in the problem's order; their own `further` is empty.
    """

    fit: ChannelFit
    posterior: ChannelPosterior
    further: tuple[Belief, ...] = ()

    __repr__ = short_repr

    @property
    def posteriors(self) -> tuple[ChannelPosterior, ...]:
        """Return the posterior of each station, in the problem's order."""
        return (self.posterior, *(belief.posterior for belief in self.further))


def update(belief: Belief, more: Measurements, *further: Measurements) -> Belief:
    """Add measurements of each station without refitting (Algorithm 1 of [GM11])."""
    return replace(
        belief,
        posterior=extend(belief.posterior, more),
        further=tuple(
            replace(other, posterior=extend(other.posterior, taken))
            for other, taken in zip(belief.further, further, strict=True)
        ),
    )
