"""Restricted likelihood of xi^2, omega^2 and beta with its gradient (equations 2.6 and 2.7).

With V = xi^2 exp(-d / beta) + noise and the columns C = [y, X], the likelihood is a function of
log |V| and C' V^-1 C. X has the columns of the mean, with a flat prior, and indicators of all
receivers except number 0, with a normal prior. A short log is one window. For long logs the
likelihood is a product over blocks, each given nearby earlier measurements (equation 1.18). Let L
be the Cholesky factor of a window's covariance with the earlier measurements first, A the block's
rows of L^-1, D = A dV L'^-1 and z = L^-1 C, both split into earlier measurements and block:

    log |V| = sum 2 log diag(L)_own        C' V^-1 C = sum (A C)' (A C)
    dlog |V| = sum tr D_own    d(C' V^-1 C) = -sum (T + T'), T = z_own' (D_earlier z_earlier
                                                                      + D_own z_own / 2)

and the expected information is ``sum (<D_own, D_own> / 2 + <D_earlier, D_earlier>)`` [Gui21].
Sites (equation 2.11) are fitted together in one window, or window by window at the current mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.cholesky import (
    factor_and_inverse,
    factor_and_whitened,
    half_inverse,
    log_determinant,
    lower_factor,
    solve_lower,
    symmetric_product,
)
from planopt.channel.estimation.least_squares import receiver_columns
from planopt.channel.gaussian_sites import (
    Intervals,
    IntervalSites,
    LatentPrior,
    Sites,
    interval_sites,
    intervals,
    rounded_variance_db2,
)
from planopt.channel.long_logs import SITE_NEIGHBOURS, IntervalRows, WindowSites, window_sites
from planopt.channel.measurements import (
    RECEIVER_OFFSET_STD_DB,
    Measurements,
    Origins,
    ageing,
    measured_origins,
    measured_path_loss_variance_db2,
    own_distance_m,
)
from planopt.channel.neighbours import (
    BLOCK,
    BLOCK_NEIGHBOURS,
    Window,
    earlier_windows,
    place_blocks,
    surrounding_windows,
)
from planopt.channel.parameters import ChannelParameters, MeanModel

Covariance = tuple[float, float, float]
"""Covariance parameters xi^2 (dB^2), omega^2 (dB^2) and beta (m)."""
LEAST_FREEDOM = 3
"""Minimum residual degrees of freedom with receivers' offsets in a profiled likelihood."""
RANK_TOLERANCE = 1e-9  # Singular values below this share of the largest count as zero


@dataclass(frozen=True, eq=False)
class LikelihoodData:
    """Measurements in one window, or in a sequence of blocks with earlier neighbours."""

    known: ChannelParameters  # The forgetting time and the station, which are not estimated
    origins: Origins  # (n) of the measurements; receivers' offsets are coefficients here
    # (n, q): p columns of the mean model, then indicators of all receivers except number 0
    columns: Floats
    prior_precision: Floats  # (q,) of the coefficients; of the first p, 0 is flat
    line: Floats  # (p,) coefficients of the line subtracted from the powers, the prior's mean
    values_db: Floats  # (n,) powers less the mean model's offset and the line
    fixed_db2: Floats  # (n,) variance of rounding, and of path loss due to position errors
    gaussian: Mask  # (n,) false for intervals
    measured: Mask  # (n,) false for censored measurements
    intervals: IntervalRows | None
    log_steps: float  # Sum of log r over the coarsely rounded measurements
    windows: tuple[Window, ...]
    distances_m: tuple[Floats, ...]  # Within each window, position errors included

    @property
    def is_whole(self) -> bool:
        """Return True if there is only one window."""
        return len(self.windows) == 1

    def part(self, taken: Mask) -> LikelihoodData:
        """Return the Gaussian measurements selected by the mask `taken` as one window."""
        origins, every = self.origins.at(np.flatnonzero(taken)), np.ones(int(taken.sum()), np.bool_)
        windows = (Window(np.zeros(0, dtype=np.intp), np.arange(len(every))),)
        return replace(
            self,
            origins=origins,
            columns=self.columns[taken],
            values_db=self.values_db[taken],
            fixed_db2=self.fixed_db2[taken],
            gaussian=every,
            measured=every,
            intervals=None,
            log_steps=0.0,
            windows=windows,
            distances_m=_distances_m(origins, windows),
        )

    def flat_columns(self) -> Floats:
        """Return independent columns (n, k) that span the mean and the receiver offsets."""
        # Offsets are left out if fewer than `LEAST_FREEDOM` degrees of freedom would remain.
        mean = self.columns[:, : len(self.line)]
        if self.columns.shape[1] == len(self.line):
            return mean
        basis, spread, _ = np.linalg.svd(self.columns, full_matrices=False)
        basis = basis[:, spread > RANK_TOLERANCE * spread[0]]
        return basis if len(basis) - basis.shape[1] >= LEAST_FREEDOM else mean

    def correlation(self, window: int, decorrelation_m: float) -> Floats:
        """Return the shadowing correlation in the window with index `window`, ageing included."""
        correlation = np.exp(self.distances_m[window] * (-1.0 / decorrelation_m))
        if self.origins.time_s is not None:
            times = self.origins.time_s[self.windows[window].rows]
            correlation *= ageing(times[:, None], times, self.known)
        return correlation

    def lasting(self, window: int) -> Floats | None:
        """Return the covariance of lasting multipath in units of omega^2; None if it is zero."""
        times, lasting = self.origins.lasting_s, self.known.lasting
        if times is None or lasting is None:
            return None
        times = times[self.windows[window].rows]
        gap_s = np.abs(times[:, None] - times)
        return lasting.share * np.exp(gap_s / -lasting.time_s)

    @property
    def white_share(self) -> float:
        """Share of omega^2 that is white."""
        return 1.0 - (self.known.lasting.share if self.known.lasting else 0.0)


def likelihood_data(
    model: MeanModel,
    measurements: Measurements,
    known: ChannelParameters,
    as_interval: Mask | None = None,  # (n,); None for the censored ones
    block_decorrelation_m: tuple[float, float] | None = None,
) -> LikelihoodData:
    """Return the likelihood data in one window, or in blocks if `block_decorrelation_m` is set."""
    chosen = measurements.censored if as_interval is None else as_interval
    origins = measured_origins(measurements, known).without_offsets()
    displaced = measured_path_loss_variance_db2(measurements, known)
    receivers = receiver_columns(measurements)
    bands, rows = intervals(measurements), np.flatnonzero(chosen)
    around: tuple[Window, ...] = ()
    if block_decorrelation_m is None:
        windows = (Window(np.zeros(0, dtype=np.intp), np.arange(len(measurements))),)
    else:
        coordinates = origins.positions_m
        if origins.time_s is not None:
            apart_m = math.sqrt(math.prod(block_decorrelation_m)) / known.forgetting_s
            coordinates = np.column_stack([coordinates, apart_m * origins.time_s])
        blocks = place_blocks(coordinates, BLOCK)
        windows = earlier_windows(coordinates, blocks, BLOCK_NEIGHBOURS)
        with_some = tuple(own for own in blocks if chosen[own].any())
        around = surrounding_windows(coordinates, with_some, SITE_NEIGHBOURS)
    power, measured = measurements.power_dbm - model.offset_db, ~measurements.censored
    line = np.linalg.lstsq(model.columns[measured], power[measured], rcond=None)[0]
    precision = np.zeros(len(line))
    if known.n_pl_prior is not None and len(line) == 2:
        mean, deviation = known.n_pl_prior
        precision[1] = deviation**-2
        line = np.array([(power - mean * model.columns[:, 1])[measured].mean(), mean])
    start = model.offset_db + model.columns @ line
    width = bands.width_db[rows]
    return LikelihoodData(
        known,
        origins,
        np.column_stack([model.columns, receivers]),
        np.append(precision, np.full(receivers.shape[1], RECEIVER_OFFSET_STD_DB**-2)),
        np.asarray(line, dtype=np.float64),
        measurements.power_dbm - start,
        np.where(chosen, 0.0, rounded_variance_db2(measurements.resolution_db)) + displaced,
        ~chosen,
        measured,
        IntervalRows(
            rows,
            Intervals(bands.upper_db[rows] - start[rows], width),
            displaced[rows],
            around,
            _distances_m(origins, around),
        )
        if len(rows)
        else None,
        float(np.log(width[np.isfinite(width)]).sum()),
        windows,
        _distances_m(origins, windows),
    )


def _distances_m(origins: Origins, windows: tuple[Window, ...]) -> tuple[Floats, ...]:
    return tuple(own_distance_m(origins.at(window.rows)) for window in windows)


MAP_EXTENT_SHARE = 1.0 / 6.0  # Prior median of beta for ``map``, as a share of the log's extent
MAP_LOG_BETA_STD = 0.7  # Prior standard deviation of the logarithm of beta for ``map``
SITE_TOLERANCE = 1e-4
"""Tolerance of the interval sites during the search; it halves the number of sweeps."""
MEAN_TOLERANCE = 0.2
"""Sites are matched again if an interval's mean changes by more standard errors than this."""


@dataclass(frozen=True, eq=False)
class Precision:
    """Inverse covariance of all measurements, with the coefficients' covariance."""

    half: Floats  # (n, n) upper half of V^-1, zeros below
    weights: Floats  # (n, q) V^-1 X
    spread: Floats  # (q, q) S

    def projection(self) -> Floats:
        """Return the projection P = V^-1 - V^-1 X S X' V^-1, as an array (n, n)."""
        whole = self.half + np.triu(self.half, 1).T
        return whole - self.weights @ self.spread @ self.weights.T


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Value and derivatives of the restricted likelihood at a point."""

    log_likelihood: float  # Log L, constants included
    gradient: Floats  # (3,) with respect to xi^2, omega^2, beta
    # (3, 3) approximate negative Hessian, positive semidefinite, with sites as measurements: the
    # average of observed and expected information, y' P dV_i P dV_j P y / 2, for one window;
    # the expected information for several
    information: Floats
    coefficients: Floats  # (p,) of the mean, by generalised least squares
    coefficient_covariance: Floats  # (p, p) covariance of `coefficients`
    precision: Precision | None  # None for several windows


@dataclass(frozen=True)
class LogNormal:
    """Log-normal prior of beta (equation 2.13)."""

    median_m: float
    deviation: float  # Standard deviation of log beta

    @staticmethod
    def for_extent(extent_m: float) -> LogNormal:
        """Return the prior of ``map`` for a log of this extent."""
        return LogNormal(MAP_EXTENT_SHARE * extent_m, MAP_LOG_BETA_STD)

    def added_to(self, at: Evaluation, beta: float) -> Evaluation:
        """Return the evaluation `at` plus the log-prior and its derivatives at `beta`."""
        apart = math.log(beta / self.median_m) / self.deviation
        gradient = at.gradient.copy()
        gradient[2] -= apart / (self.deviation * beta)
        value = at.log_likelihood - 0.5 * apart**2
        information = at.information + self.information(beta)
        return replace(at, log_likelihood=value, gradient=gradient, information=information)

    def information(self, beta: float) -> Floats:
        """Return the prior's information (3, 3) on xi^2, omega^2 and beta."""
        return np.diag([0.0, 0.0, (self.deviation * beta) ** -2.0])


class RestrictedLikelihood:
    """Restricted likelihood, times a prior if there is one."""

    def __init__(self, data: LikelihoodData, prior: LogNormal | None = None) -> None:
        self.data, self.prior = data, prior
        self._sites: WindowSites | IntervalSites | None = None
        self._coefficients = np.zeros(len(data.prior_precision))

    def at(self, covariance: Covariance, site_tolerance: float = SITE_TOLERANCE) -> Evaluation:
        """Evaluate the likelihood at (xi^2, omega^2, beta)."""
        whole = self.data.is_whole
        at = self._whole(covariance, site_tolerance) if whole else self._blocks(covariance)
        return at if self.prior is None else self.prior.added_to(at, covariance[2])

    def information(self, covariance: Covariance, at: Evaluation) -> Floats:
        """Return the expected information (3, 3) at `covariance`; `at` is the evaluation there."""
        if at.precision is None:
            return at.information
        # Intervals count as Gaussian sites. The variance of a rounded measurement is assumed to
        # grow as omega^2. Censored measurements carry no information on omega^2, so that its
        # standard error is not understated.
        data, projection, (shadow, _, beta) = self.data, at.precision.projection(), covariance
        correlation, lasting = data.correlation(0, beta), data.lasting(0)
        slope = correlation * data.distances_m[0] * (shadow / beta**2)
        noise = data.white_share * projection * data.measured
        if lasting is not None:
            noise += projection @ lasting
        products = [projection @ correlation, noise, projection @ slope]
        expected = np.array([[0.5 * float(np.vdot(a.T, b)) for b in products] for a in products])
        return expected if self.prior is None else expected + self.prior.information(covariance[2])

    def _whole(self, covariance: Covariance, site_tolerance: float) -> Evaluation:
        """Evaluate the likelihood of a single window, with all interval sites fitted jointly."""
        data, rows = self.data, self.data.intervals
        shadow, nugget, beta = covariance
        correlation, lasting = data.correlation(0, beta), data.lasting(0)
        white = data.white_share
        total = shadow * correlation
        if lasting is not None:
            total += nugget * lasting
        values, noise = data.values_db, data.fixed_db2 + white * nugget
        sites = log_likelihood = None
        if rows is not None:
            start = self._sites
            prior, log_gaussian = _interval_prior(data, total, noise)
            sites = interval_sites(
                prior,
                rows.known,
                white * nugget,
                start if isinstance(start, IntervalSites) else None,
                site_tolerance,
            )
            self._sites = sites
            log_likelihood = log_gaussian + sites.log_evidence - data.log_steps
            values, noise = _with_sites(rows, values, noise, sites.as_measurements())
        total.flat[:: len(total) + 1] += noise
        columns = np.column_stack([values, data.columns])
        determinant, half = half_inverse(total)
        weights = symmetric_product(half, columns)
        correlation_slope = correlation * data.distances_m[0]
        correlation_slope *= shadow / beta**2
        diagonal = np.diag(half)
        moved = np.stack(
            [
                correlation @ weights,
                white * weights * data.gaussian[:, None],
                correlation_slope @ weights,
            ]
        )
        lasted = 0.0 if lasting is None else lasting @ weights
        moved[1] += lasted
        sums = _Sums(
            determinant,
            columns.T @ weights,
            # Traces of products with V^-1, of which only the upper half is stored.
            np.array(
                [
                    2.0 * np.vdot(half, correlation) - diagonal.sum(),
                    white * diagonal[data.gaussian].sum()
                    + (0.0 if lasting is None else 2.0 * np.vdot(half, lasting))
                    - (1.0 - white) * diagonal.sum(),
                    2.0 * np.vdot(half, correlation_slope),
                ],
                dtype=np.float64,
            ),
            -(weights.T @ moved),
            np.zeros((3, 3)),
        )
        coefficients, spread = sums.estimate(data.prior_precision)
        # Rounded measurements inform omega^2 too: their sites' variances grow nearly as omega^2.
        moved[1] = white * weights * data.measured[:, None] + lasted
        along = moved @ np.concatenate([[1.0], -coefficients])
        explained = along @ weights[:, 1:]
        sums.information = 0.5 * (
            along @ symmetric_product(half, along.T) - explained @ spread @ explained.T
        )
        slope = 0.0 if sites is None else white * sites.evidence_slope
        precision = Precision(half, weights[:, 1:], spread)
        return _evaluation(
            data, sums, (coefficients, spread), slope, log_likelihood, 0.0, precision
        )

    def _blocks(self, covariance: Covariance) -> Evaluation:
        """Evaluate the likelihood of several windows, iterating sites and mean to convergence."""
        data, rows = self.data, self.data.intervals
        shadow, nugget, beta = covariance
        sites = self._sites if isinstance(self._sites, WindowSites) else None
        coefficients = self._coefficients
        values, noise = data.values_db, data.fixed_db2 + data.white_share * nugget
        parameters = replace(
            data.known,
            shadow_std_db=math.sqrt(shadow),
            multipath_std_db=math.sqrt(nugget),
            decorrelation_m=beta,
        )
        while True:
            if rows is not None:
                sites = window_sites(
                    parameters,
                    data.origins,
                    (values, noise),
                    rows,
                    data.columns @ coefficients,
                    sites,
                    SITE_TOLERANCE,
                )
                as_measured = Sites(sites.values_db, 1.0 / sites.precision)
                values, noise = _with_sites(rows, values, noise, as_measured)
            sums = _window_sums(data, covariance, np.column_stack([values, data.columns]), noise)
            before, (coefficients, spread) = coefficients, sums.estimate(data.prior_precision)
            if rows is None:
                break
            there = data.columns[rows.rows]
            error = np.sqrt(np.einsum("ij,jk,ik->i", there, spread, there))
            if (np.abs(there @ (coefficients - before)) <= MEAN_TOLERANCE * error).all():
                break
        slope = 0.0 if sites is None else data.white_share * sites.slope
        log_factor = 0.0 if sites is None else sites.log_factor - data.log_steps
        self._sites, self._coefficients = sites, coefficients
        return _evaluation(data, sums, (coefficients, spread), slope, None, log_factor, None)


@dataclass(eq=False)
class _Sums:
    """Sums over all windows from which the likelihood and its derivatives are computed."""

    log_determinant: float
    products: Floats
    log_slopes: Floats
    product_slopes: Floats
    information: Floats

    def estimate(self, prior_precision: Floats) -> tuple[Floats, Floats]:
        """Return generalised least-squares coefficients (q,) and their covariance (q, q)."""
        spread = np.asarray(
            np.linalg.inv(self.products[1:, 1:] + np.diag(prior_precision)), dtype=np.float64
        )
        return spread @ self.products[1:, 0], spread


def _evaluation(
    data: LikelihoodData,
    sums: _Sums,
    estimate: tuple[Floats, Floats],  # From `_Sums.estimate`
    nugget_slope: float,  # d(log probability of the intervals) / d omega^2, with sites fixed
    log_likelihood: float | None,  # None: computed from the sums
    log_factor: float,  # Log of the factor that turns sites as measurements into intervals
    precision: Precision | None,
) -> Evaluation:
    """Return the likelihood and its derivatives from the sums over windows."""
    coefficients, spread = estimate
    count, proper = len(data.line), data.prior_precision > 0.0
    value = log_likelihood
    if value is None:
        squares = sums.products[0, 0] - float(sums.products[0, 1:] @ coefficients)
        value = log_factor - 0.5 * (
            sums.log_determinant
            - float(np.linalg.slogdet(spread)[1])
            - float(np.log(data.prior_precision[proper]).sum())
            + squares
            + (len(data.values_db) - int((~proper).sum())) * math.log(2.0 * math.pi)
        )
    residual = np.concatenate([[1.0], -coefficients])
    slopes = sums.product_slopes
    gradient: Floats = -0.5 * (
        sums.log_slopes
        + np.einsum("ij,kij->k", spread, slopes[:, 1:, 1:])
        + slopes @ residual @ residual
    )
    gradient[1] += nugget_slope
    return Evaluation(
        value,
        gradient,
        sums.information,
        data.line + coefficients[:count],
        spread[:count, :count],
        precision,
    )


def _with_sites(
    rows: IntervalRows, values: Floats, noise: Floats, sites: Sites
) -> tuple[Floats, Floats]:
    """Return values (n,) and noise variances (n,), with Gaussian sites in place of intervals."""
    values, noise = values.copy(), noise.copy()
    values[rows.rows] = sites.values_db
    noise[rows.rows] = sites.noise_variance_db2 + rows.displaced_db2
    return values, noise


def _interval_prior(
    data: LikelihoodData,
    latent_db2: Floats,  # (n, n) covariance of shadowing
    noise_db2: Floats,  # (n,) of the Gaussian measurements
) -> tuple[LatentPrior, float]:
    """Return the prior of the powers in intervals, and the log-likelihood of the other readings."""
    # If rounded intervals may determine theta, log L is taken at the line.
    if data.intervals is None:
        raise AssertionError("there are intervals")
    rows, exact = data.intervals.rows, np.flatnonzero(data.gaussian)
    covariance = latent_db2[np.ix_(rows, rows)]
    covariance.flat[:: len(rows) + 1] += data.intervals.displaced_db2
    left, mean = data.columns[rows], np.zeros(len(rows))
    information, score = np.diag(data.prior_precision), np.zeros(len(data.prior_precision))
    prior_precision = data.prior_precision[data.prior_precision > 0.0]
    log_gaussian = 0.5 * float(np.log(prior_precision / (2.0 * math.pi)).sum())
    if len(exact):
        total = latent_db2[np.ix_(exact, exact)]
        total.flat[:: len(exact) + 1] += noise_db2[exact]
        lower = lower_factor(total)
        half_columns = solve_lower(lower, data.columns[exact])
        half_values = solve_lower(lower, data.values_db[exact])
        half_cross = solve_lower(lower, latent_db2[np.ix_(exact, rows)])
        mean = half_cross.T @ half_values
        covariance -= half_cross.T @ half_cross
        left = left - half_cross.T @ half_columns
        information = information + half_columns.T @ half_columns
        score = half_columns.T @ half_values
        squares = float(half_values @ half_values)
        log_gaussian -= 0.5 * (
            log_determinant(lower) + squares + len(exact) * math.log(2.0 * math.pi)
        )
    prior = LatentPrior(mean, covariance, left, information, score)
    if np.isfinite(data.intervals.known.width_db).any():
        return prior, log_gaussian
    integrated, log_integral = prior.integrated()
    return integrated, log_gaussian + log_integral


def _window_sums(
    data: LikelihoodData,
    covariance: Covariance,
    columns: Floats,  # (n, q + 1) C
    noise_db2: Floats,  # (n,), sites as measurements
) -> _Sums:
    """Return the sums over all blocks, each block conditional on its earlier neighbours."""
    shadow, nugget, beta = covariance
    size = columns.shape[1]
    sums = _Sums(
        0.0, np.zeros((size, size)), np.zeros(3), np.zeros((3, size, size)), np.zeros((3, 3))
    )
    # The variance of a rounded measurement's site grows nearly as omega^2.
    coarse = bool((data.measured & ~data.gaussian).any())
    for number, window in enumerate(data.windows):
        rows, own, near = window.rows, len(window.own), len(window.near)
        correlation, noise = data.correlation(number, beta), noise_db2[rows]
        total, lasting = shadow * correlation, data.lasting(number)
        if lasting is not None:
            total += nugget * lasting
        total.flat[:: len(total) + 1] += noise
        diagonal, inverted = factor_and_inverse(total)
        last = inverted[near:]
        whitened = inverted @ columns[rows]
        before, here = whitened[:near], whitened[near:]
        sums.log_determinant += 2.0 * float(np.log(diagonal[near:]).sum())
        sums.products += here.T @ here
        correlation *= data.distances_m[number]
        white = last * data.white_share
        parts = [last * noise, white * data.gaussian[rows], last @ correlation]
        if coarse:
            parts.append(white * data.measured[rows])
        if lasting is not None:
            lasted = last @ lasting
            parts[0] += nugget * lasted
            for part in parts[1::2]:
                part += lasted
        moved = (np.concatenate(parts) @ inverted.T).reshape(len(parts), own, -1)
        # The whitened total covariance is the identity.
        moved[0] *= -1.0
        moved[0, np.arange(own), near + np.arange(own)] += 1.0
        moved[0] /= shadow
        moved[2] *= shadow / beta**2
        within, across = moved[:3, :, near:], moved[:3, :, :near]
        sums.log_slopes += np.trace(within, axis1=1, axis2=2)
        half = here.T @ (across @ before + 0.5 * (within @ here))
        sums.product_slopes -= half + half.swapaxes(1, 2)
        if coarse:
            moved[1] = moved[3]
        within *= math.sqrt(0.5)
        flat = moved[:3].reshape(3, -1)
        sums.information += flat @ flat.T
    return sums


def profiled_log_likelihood(
    data: LikelihoodData, correlated_share: float, decorrelation_m: float
) -> tuple[float, float]:
    """Return the log-likelihood maximised over the total variance alpha, and this alpha."""
    # Terms that do not scale with alpha are ignored, and offsets have a flat prior.
    count = len(data.values_db)
    correlation = correlated_share * data.correlation(0, decorrelation_m)
    lasting = data.lasting(0)
    if lasting is not None:
        correlation += (1.0 - correlated_share) * lasting
    np.fill_diagonal(correlation, 1.0)
    columns = np.column_stack([data.values_db, data.flat_columns()])
    lower, whitened = factor_and_whitened(correlation, columns)
    half_values, half_columns = whitened[:, 0], whitened[:, 1:]
    information = half_columns.T @ half_columns
    score = half_columns.T @ half_values
    fitted = np.asarray(np.linalg.solve(information, score), dtype=np.float64)
    residual = half_values - half_columns @ fitted
    freedom = count - len(score)
    variance = max(float(residual @ residual) / freedom, 1e-12)
    log_likelihood = -0.5 * (
        log_determinant(lower)
        + float(np.linalg.slogdet(information)[1])
        + freedom * (math.log(2.0 * math.pi) + math.log(variance) + 1.0)
    )
    return log_likelihood, variance
