"""Probability law of connectivity for one station, several stations or uncertain parameters.

A :class:`ConnectivityLaw` gives the probability that a robot is connected at a position, the margin
in dB of the chance constraint, and joint samples of the power along a path. The serving power of
several stations (equation 3.5) is represented by the normal law with the same probability of
connection and the same margin. The combined score (equation 3.3) is computed from the logarithms of
both tails, so that it remains informative if the probability rounds to 0 or 1.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr, ndtri_exp

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.gaussian_sites import MIN_NOISE_VARIANCE_DB2
from planopt.channel.joint import JointPrediction, joint_prediction
from planopt.channel.kriging import (
    Prediction,
    bound_margin_db,
    bound_quantile,
    connection_probability,
    predict,
)
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.neighbours import NOWHERE, PlaceIndex
from planopt.channel.parameter_uncertainty import MarginalPosterior, mixture
from planopt.channel.parameters import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.errors import InputError

LEAST_DEVIATION_DB = math.sqrt(MIN_NOISE_VARIANCE_DB2)
"""Minimum standard deviation in scores, so that a known power at the threshold gives 1/2."""

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


def any_score(scores: Floats) -> Floats:
    """Return the combined score (...) of m stations from each station's score (m, ...)."""
    return _score(_log_any(scores), _log_normal(-scores).sum(axis=0))


def any_score_derivatives(scores: Floats) -> tuple[Floats, Floats, Floats]:
    """Return combined score z, gradient (m, ...) and Hessian in finite `scores` (equation 3.4)."""
    none_each = _log_normal(-scores)
    none = none_each.sum(axis=0)
    z = _score(_log_any(scores), none)
    weight = np.exp(0.5 * (z * z - scores * scores) + none - none_each)
    hazard = np.exp(-0.5 * scores * scores - LOG_ROOT_2PI - none_each)
    hessian = weight[:, None] * (z * weight[None] - hazard[None])
    own = np.arange(len(scores))
    hessian[own, own] = weight * (z * weight - scores)
    return z, weight, hessian


def _log_normal(scores: Floats) -> Floats:
    return np.asarray(log_ndtr(scores), dtype=np.float64)


def _log_any(scores: Floats) -> Floats:
    """Return log P(any station connects) without cancellation, adding one station at a time."""
    found = _log_normal(scores[0])
    none = _log_normal(-scores[0])
    with np.errstate(invalid="ignore"):  # NaN scores remain NaN
        for score in scores[1:]:
            found = np.logaddexp(found, _log_normal(score) + none)
            none = none + _log_normal(-score)
    return found


def _score(log_any: Floats, log_none: Floats) -> Floats:
    """Return the combined score, computed from the smaller tail probability for precision."""
    low = np.asarray(ndtri_exp(np.minimum(log_any, log_none)), dtype=np.float64)
    return np.where(log_any < log_none, low, -low)


SECANT_FROM_DB = 1e-4
"""Minimum |margin| in dB at which the score's slope is a secant; below it is the derivative."""
SETTLED_DB = 1e-10  # Tolerance of Newton's method on the margin, which typically takes six steps
MOST_STEPS = 100


def serving_prediction(
    predictions: Sequence[Prediction], thresholds_dbm: Sequence[float], p_min: float
) -> Prediction:
    """Return the normal law that represents the serving power of m stations at n positions."""
    if len(predictions) == 1:
        return predictions[0]
    above, deviation = above_thresholds_db(predictions, thresholds_dbm)
    score, weight, _ = any_score_derivatives(above / deviation)
    spread = 1.0 / (weight / deviation).sum(axis=0)
    if 0.0 < p_min < 1.0:
        margin = any_margin_db(above, deviation, p_min)
        far = np.abs(margin) > SECANT_FROM_DB
        np.divide(margin, score - bound_quantile(p_min), out=spread, where=far)
    return Prediction(thresholds_dbm[0] + spread * score, spread)


def any_probability(
    predictions: Sequence[Prediction], thresholds_dbm: Sequence[float], slack_db: float = 0.0
) -> Floats:
    """Return P(connected to any station) (n,) with all thresholds lowered by `slack_db`."""
    above, deviation = above_thresholds_db(predictions, thresholds_dbm)
    return np.asarray(ndtr(any_score((above + slack_db) / deviation)), dtype=np.float64)


def serving_power_dbm(powers_dbm: Floats, thresholds_dbm: Sequence[float]) -> Floats:
    """Return the serving power (...) for known powers (m, ...) of m stations."""
    if len(powers_dbm) == 1:
        return powers_dbm[0]
    offsets = thresholds_dbm[0] - np.asarray(thresholds_dbm)
    return (powers_dbm + offsets.reshape(-1, *[1] * (powers_dbm.ndim - 1))).max(axis=0)


def above_thresholds_db(
    predictions: Sequence[Prediction], thresholds_dbm: Sequence[float]
) -> tuple[Floats, Floats]:
    """Return mean minus threshold (m, n) and standard deviation (m, n) of each station's power."""
    above = np.stack(
        [
            prediction.mean_db - threshold
            for prediction, threshold in zip(predictions, thresholds_dbm, strict=True)
        ]
    )
    deviation = np.stack([prediction.deviation_db for prediction in predictions])
    return above, np.maximum(deviation, LEAST_DEVIATION_DB)


def any_margin_db(above_db: Floats, deviation_db: Floats, p_min: float) -> Floats:
    """Return the common threshold increase (n,) in dB at which P(connected to any) = `p_min`."""
    wanted = bound_quantile(p_min)
    shared = bound_quantile(-math.expm1(math.log1p(-p_min) / len(above_db)))
    low: Floats = (above_db - wanted * deviation_db).max(axis=0)
    high: Floats = (above_db - shared * deviation_db).max(axis=0)
    margin = low.copy()
    open_places = np.flatnonzero(high - low > SETTLED_DB)
    for _ in range(MOST_STEPS):
        if not len(open_places):
            break
        above, deviation = above_db[:, open_places], deviation_db[:, open_places]
        here = margin[open_places]
        score, weight, _ = any_score_derivatives((above - here) / deviation)
        lacking = score - wanted
        low[open_places] = np.where(lacking >= 0.0, here, low[open_places])
        high[open_places] = np.where(lacking < 0.0, here, high[open_places])
        there = here + lacking / (weight / deviation).sum(axis=0)
        between = (there >= low[open_places]) & (there <= high[open_places])
        there = np.where(between, there, 0.5 * (low[open_places] + high[open_places]))
        margin[open_places] = there
        open_places = open_places[np.abs(there - here) > SETTLED_DB]
    return margin


@dataclass(frozen=True, eq=False)
class KnownPower:
    """Lower and upper bounds of the power where readings determine the connection."""

    rows: Indices  # (k,) indices of the positions
    # (k,) bounds of the power; equal for an exact reading, minus infinity for a censored one
    least_dbm: Floats
    most_dbm: Floats

    def replace_in(self, power: Prediction) -> Prediction:
        """Return `power`; known rows are clipped to their bounds, with zero standard deviation."""
        if not len(self.rows):
            return power
        mean, deviation = power.mean_db.copy(), power.deviation_db.copy()
        mean[self.rows] = np.clip(mean[self.rows], self.least_dbm, self.most_dbm)
        deviation[self.rows] = 0.0
        return Prediction(mean, deviation)


NOTHING_KNOWN = KnownPower(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0))


def known_power(
    station: ChannelPosterior,
    positions_m: Floats,  # (n, 2)
    threshold_dbm: float,
    proven: PlaceIndex = NOWHERE,  # Positions from which packets arrived at this station
) -> KnownPower:
    """Return power bounds where readings and packets determine a connection (equation 3.12)."""
    places, read = station.index.within(positions_m, SAME_PLACE_M)
    arrived, _ = proven.within(positions_m, SAME_PLACE_M)
    if not len(places) and not len(arrived):
        return NOTHING_KNOWN
    least, most = np.full(len(positions_m), -np.inf), np.full(len(positions_m), np.inf)
    if len(places):
        least[places], most[places] = np.inf, -np.inf
        lowest, highest = _power_bounds_dbm(station, read)
        np.minimum.at(least, places, lowest)
        np.maximum.at(most, places, highest)
    least[arrived] = np.maximum(least[arrived], threshold_dbm)
    rows = ((least >= threshold_dbm) | (most < threshold_dbm)).nonzero()[0]
    return KnownPower(rows, least[rows], np.maximum(most[rows], least[rows]))


def _power_bounds_dbm(station: ChannelPosterior, read: Indices | slice) -> tuple[Floats, Floats]:
    """Return lower and upper bounds of the power at the positions of readings (equation 3.12)."""
    measured = station.measurements
    power, half = measured.power_dbm[read], 0.5 * measured.resolution_db[read]
    free = (measured.receiver[read] != 0) | (measured.position_std_m[read] > 0.0)
    free |= math.isfinite(station.parameters.forgetting_s)
    censored = measured.censored[read]
    least = np.where(free | censored, -np.inf, power - half)
    return least, np.where(free, np.inf, np.where(censored, power, power + half))


Predictor = Callable[[ChannelPosterior, Floats], Prediction]
"""Function that predicts a station's power at positions (n, 2)."""


@dataclass(frozen=True, eq=False)
class ConnectivityLaw:
    """Law of the connection to one station, or to any of several with independent fading."""

    posteriors: tuple[ChannelPosterior, ...]  # One per station
    thresholds_dbm: tuple[float, ...]  # Minimum power for a connection, one per station
    p_min: float  # Required probability; the combined law's margin is exact for it
    # Positions from which packets arrived, and arrive again because multipath is constant there
    proven: PlaceIndex = field(default=NOWHERE, kw_only=True)

    def combined(self, powers: Sequence[Prediction]) -> Prediction:
        """Return the normal law of the serving power, given each station's predicted power."""
        return serving_prediction(powers, self.thresholds_dbm, self.p_min)

    def known(self, positions_m: Floats) -> list[KnownPower]:
        """Return each station's power bounds where readings or packets determine a connection."""
        # A packet does not tell which of several stations received it.
        proven = self.proven if len(self.posteriors) == 1 else NOWHERE
        return [
            known_power(station, positions_m, threshold, proven)
            for station, threshold in zip(self.posteriors, self.thresholds_dbm, strict=True)
        ]

    def is_connected(self, positions_m: Floats) -> Mask:
        """Return a mask (n,) of positions (n, 2) where a reading or packet proves a connection."""
        found = np.zeros(len(positions_m), dtype=np.bool_)
        for known, threshold in zip(self.known(positions_m), self.thresholds_dbm, strict=True):
            found[known.rows[known.least_dbm >= threshold]] = True
        found[self._proven(positions_m)] = True
        return found

    def _proven(self, positions_m: Floats) -> Indices:
        """Return the indices of positions (n, 2) from which a packet arrived."""
        return self.proven.within(positions_m, SAME_PLACE_M)[0]

    @property
    def connected_m(self) -> Floats:
        """Positions (k, 2) where readings or packets prove a connection."""
        places, found = self.proven.positions_m, list[Floats]()
        unread = np.ones(len(places), dtype=np.bool_)
        for station, threshold in zip(self.posteriors, self.thresholds_dbm, strict=True):
            least, _ = _power_bounds_dbm(station, slice(None))
            found.append(station.measurements.positions_m[least >= threshold])
            known = known_power(station, places, threshold)
            unread[known.rows[known.least_dbm >= threshold]] = False
        found.append(places[unread])
        return np.vstack(found)

    def each_power(self, positions_m: Floats, predict: Predictor = predict) -> list[Prediction]:
        """Return the power of each station at positions (n, 2), known or predicted."""
        return [
            known.replace_in(predict(station, positions_m))
            for known, station in zip(self.known(positions_m), self.posteriors, strict=True)
        ]

    def predicted(self, positions_m: Floats, predict: Predictor = predict) -> Prediction:
        """Return the predicted serving power; unlike `power`, it ignores known values."""
        return self.combined([predict(station, positions_m) for station in self.posteriors])

    def power(self, positions_m: Floats, predict: Predictor = predict) -> Prediction:
        """Return the normal law of the serving power at positions (n, 2), known or predicted."""
        if len(self.posteriors) == 1:
            return self.known(positions_m)[0].replace_in(self.predicted(positions_m, predict))
        power, rows = (
            self.combined(self.each_power(positions_m, predict)),
            self._proven(positions_m),
        )
        least = np.full(len(rows), self.thresholds_dbm[0])
        return KnownPower(rows, least, np.full(len(rows), np.inf)).replace_in(power)

    def probability(self, positions_m: Floats, slack_db: float = 0.0) -> Floats:
        """Return P(connected) (n,) at positions (n, 2), thresholds lowered by `slack_db`."""
        found = any_probability(self.each_power(positions_m), self.thresholds_dbm, slack_db)
        found[self._proven(positions_m)] = 1.0
        return found

    def margin_db(self, positions_m: Floats) -> Floats:
        """Return the margin (n,) of the chance constraint P(connected) >= p_min in dB."""
        return self.margin_of_db(self.power(positions_m))

    def margin_of_db(self, power: Prediction) -> Floats:
        """Return the margin of the chance constraint in dB for a serving power prediction."""
        return bound_margin_db(
            power.mean_db, power.deviation_db, self.thresholds_dbm[0], self.p_min
        )

    def along(self, path_m: Floats) -> list[JointPrediction]:
        """Return the joint law of each station's power along a path (N, 2), known or predicted."""
        found: list[JointPrediction] = []
        for known, station in zip(self.known(path_m), self.posteriors, strict=True):
            joint = joint_prediction(factored_near(station, path_m), path_m)
            covariance = joint.covariance_db2
            covariance[known.rows], covariance[:, known.rows] = 0.0, 0.0
            power = known.replace_in(Prediction(joint.mean_db, joint.deviation_db))
            found.append(JointPrediction(power.mean_db, covariance))
        return found

    def sample(self, path_m: Floats, count: int, seed: int) -> Floats:
        """Draw serving powers ``(count, N)`` along a path; each station has its own seed."""
        drawn = [
            joint.sample(count, np.random.default_rng([seed, number] if number else seed))
            for number, joint in enumerate(self.along(path_m))
        ]
        return serving_power_dbm(np.stack(drawn), self.thresholds_dbm)


@dataclass(frozen=True, eq=False)
class UncertainParameters(ConnectivityLaw):
    """Law of the connection to a single station with uncertain xi, beta, omega and path loss."""

    marginal: MarginalPosterior

    def predicted(self, positions_m: Floats, predict: Predictor = predict) -> Prediction:
        """Return the normal law that represents the mixture; the argument `predict` is ignored."""
        weights = self.marginal.weights
        parts = [component.predict(positions_m) for component in self.marginal.components]
        deviation = mixture(weights, parts).deviation_db
        kept_dbm = mixture_quantile_dbm(weights, parts, self.p_min)
        return Prediction(kept_dbm + bound_quantile(self.p_min) * deviation, deviation)

    def probability(self, positions_m: Floats, slack_db: float = 0.0) -> Floats:
        """Return P(connected) (n,) from the mixture, thresholds lowered by `slack_db`."""
        threshold, (known,) = self.thresholds_dbm[0] - slack_db, self.known(positions_m)
        found = self.marginal.connectivity(positions_m, threshold)
        found[known.rows] = known.least_dbm >= threshold
        return found


MOST_ROUNDS = 60  # Maximum number of Newton or bisection steps for a quantile
NEWTON_STEP_DB = 1e-8
"""Tolerance of Newton steps; after such a short step the error is within rounding."""


def mixture_quantile_dbm(weights: Floats, parts: list[Prediction], p_min: float) -> Floats:
    """Return the power (n,) that a mixture of normal laws exceeds with probability `p_min`."""
    # The parts' quantiles bracket it; bisection replaces Newton steps that leave the bracket.
    means = np.stack([part.mean_db for part in parts])
    deviations = np.stack([part.deviation_db for part in parts])
    own = means - bound_quantile(p_min) * deviations
    low: Floats = own.min(axis=0)
    high: Floats = own.max(axis=0)
    found: Floats = 0.5 * (low + high)
    spread = deviations > 0.0
    for _ in range(MOST_ROUNDS):
        excess = weights @ connection_probability(means - found, deviations, 0.0) - p_min
        low, high = np.where(excess >= 0.0, found, low), np.where(excess < 0.0, found, high)
        zero = np.zeros_like(means)
        score = np.divide(found - means, deviations, out=zero.copy(), where=spread)
        bell = np.exp(-0.5 * score**2) / math.sqrt(2.0 * math.pi)
        density = weights @ np.divide(bell, deviations, out=zero, where=spread)
        step = np.divide(excess, density, out=np.full(len(found), np.inf), where=density > 0.0)
        middle = 0.5 * (low + high)
        better = np.where((low <= found + step) & (found + step <= high), found + step, middle)
        moved = np.abs(better - found)
        found = better
        if (moved <= NEWTON_STEP_DB).all():
            break
    return found


def connected_to_any(
    posteriors: Sequence[ChannelPosterior], positions_m: ArrayLike, threshold_dbm: float
) -> Floats:
    """Return P(power >= threshold from at least one of independent stations) as an array ``(n,)``.

    Parameters
    ----------
    posteriors
        Posteriors of the stations, at least one.
    positions_m
        ``(n, 2)`` positions in metres.
    threshold_dbm
        Minimum power for a connection.

    Raises
    ------
    InputError
        There is no station, or an argument is invalid.
    """
    if not posteriors:
        raise InputError(
            "is empty", key="posteriors", remedy="give at least one posterior, one per base station"
        )
    threshold, places = require_finite(threshold_dbm, "threshold_dbm"), require_places(positions_m)
    predictions = [predict(posterior, places) for posterior in posteriors]
    return any_probability(predictions, [threshold] * len(predictions))
