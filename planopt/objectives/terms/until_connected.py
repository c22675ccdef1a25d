# pyright: basic
"""Term ``until_connected``: minus the expected distance until connected (equation 4.13).

Assumed-density filtering (equation 4.15) is within hundredths of the multivariate integral
(:func:`planopt.channel.first_passage`) at a hundredth of its cost.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from planopt.arrays import Derivatives, Floats, Indices, Mask, rounded_length
from planopt.channel.joint import joint_prediction
from planopt.channel.kriging import LocalChannel, score_probability
from planopt.channel.parameters import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior, factored_near
from planopt.objectives.path_derivatives import (
    LocalPaths,
    PathDerivatives,
    add_own_blocks,
    by_lengths,
    length_jacobian,
)
from planopt.objectives.terms.term import NearPath, Paths, Steers, Term, TermContext

WAITING = 0.1
"""Cost per metre by which a step is shorter than the longest; otherwise waiting is free."""
NOT_PROBED_DB = 1e3  # Offset in dB that puts positions without a probe below the threshold
LEAST_CHANCE = 1e-12  # Minimum probability of connection of a probed position
PROBE_SHARE = 1.0 / 3.0
"""Expected distance between probes as a share of the decorrelation distance. For 1/6 to 2/3,
searches from 40 start positions on one map were within a tenth of the best."""
LEAST_VARIANCE_DB2 = 1e-12  # Minimum variance, in case the power at a position is known exactly
LEAST_SCORE = -5.0  # Minimum score: the outage probability of a position is at least Q(5) = 3e-7


@dataclass(frozen=True)
class Search:
    """Settings of a search for connection."""

    start_m: tuple[float, float]  # Position of the robot
    thresholds_dbm: tuple[float, ...]  # Minimum power of a connection to each station
    beyond_m: float = 0.0  # Metres added if the path ends without connection
    step_m: float | None = None  # Longest step, for the cost of waiting; None if waiting is free


def charged_distance_m(
    posteriors: Sequence[ChannelPosterior],
    path_m: Floats,  # (h, 2)
    settings: Search,
    probed: Mask | None = None,  # (h,) True where the robot probes; None: all
) -> float:
    """Return the expected distance until connected, plus its penalty if never connected."""
    # E[D] alone favours a stationary robot, so leg lengths are those of `counted_legs_m`.
    # Stations are independent, so their outage probabilities multiply.
    places = require_places(path_m)
    missing_db = 0.0 if probed is None else np.where(probed, 0.0, NOT_PROBED_DB)
    powers = [joint_prediction(factored_near(each, places), places) for each in posteriors]
    stations = [
        ((power.mean_db - threshold - missing_db)[None], power.covariance_db2[None])
        for power, threshold in zip(powers, settings.thresholds_dbm, strict=True)
    ]
    legs = leg_lengths_m(np.vstack([np.asarray(settings.start_m), places]))
    counted = counted_legs_m(legs, settings.step_m)
    return float(charged_distances_m(stations, counted[None], settings.beyond_m)[0])


def counted_legs_m(legs_m: Floats, step_m: float | None) -> Floats:
    """Return leg lengths, increased by a share of their shortfall from the step limit `step_m`."""
    return legs_m if step_m is None else (1.0 - WAITING) * legs_m + WAITING * step_m


def charged_distances_m(
    stations: Sequence[tuple[Floats, Floats]],
    legs_m: Floats,  # (c, h) counted lengths of the steps
    beyond_m: Floats | float,
) -> Floats:
    """Return :func:`charged_distance_m` (c,) of c paths of h positions, by local channels."""
    failing = np.ones_like(legs_m)
    for above_db, covariance_db2 in stations:
        failing *= filtered_failing(above_db, covariance_db2)
    return (
        legs_m[:, 0]
        + np.einsum("ck,ck->c", legs_m[:, 1:], failing[:, :-1])
        + beyond_m * failing[:, -1]
    )


def filtered_failing(above_db: Floats, covariance_db2: Floats) -> Floats:
    """Return P(not connected so far) ``(c, h)`` at all positions of c paths (equation 4.15)."""
    # Shapes: above_db (c, h); covariance_db2 (c, h, h).
    mean, covariance = above_db.copy(), covariance_db2.copy()
    below = np.empty_like(mean)
    for k in range(int(mean.shape[1])):
        variance = np.maximum(covariance[:, k, k], LEAST_VARIANCE_DB2)
        deviation = np.sqrt(variance)
        score = np.maximum(-mean[:, k] / deviation, LEAST_SCORE)
        below[:, k] = score_probability(score)
        ratio = np.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi) / below[:, k]
        shared = covariance[:, k, k + 1 :].copy()
        mean[:, k + 1 :] -= (ratio / deviation)[:, None] * shared
        shrink = ratio * (ratio + score) / variance
        covariance[:, k + 1 :, k + 1 :] -= (
            shrink[:, None, None] * shared[:, :, None] * shared[:, None, :]
        )
    return np.asarray(np.cumprod(below, axis=1), dtype=np.float64)


def search_length_m(distance_m: Floats, chance: Floats, decorrelation_m: float) -> Floats:
    """Return the expected search lengths (k,) for first probes at k alternative positions."""
    # The first probe costs the path length D to its position. Each further probe is nearby, equally
    # likely to succeed, and costs L, `PROBE_SHARE` of the decorrelation distance.
    # Shapes: distance_m, chance (k,).
    odds_against = (1.0 - chance) / np.maximum(chance, LEAST_CHANCE)
    return distance_m + PROBE_SHARE * decorrelation_m * odds_against


@dataclass(frozen=True)
class PassageProgramme:
    """CasADi functions that evaluate the expected cost of a path."""

    # Their argument z stacks (mean above threshold (h,), covariance (h, h)) of each station, leg
    # lengths (h,) and the cost of ending unconnected. Outage probabilities of stations multiply.

    value: Any  # Function of z: expected cost in metres
    gradient: Any  # Gradient w.r.t. z, with covariances as lower triangles
    along: Any  # Function of z and a direction: directional derivative of the gradient


@cache
def passage_programme(steps: int, stations: int = 1) -> PassageProgramme:
    """Return the functions for a path of h = `steps` positions, cached by number of steps."""
    import casadi as ca

    size = steps * (steps + 1)
    z = ca.SX.sym("z", stations * size + steps + 1)
    each = [_failing(z[own * size : (own + 1) * size], steps) for own in range(stations)]
    legs = z[stations * size :]  # The last entry is the cost beyond the path
    distance = legs[0]
    for k in range(steps):
        failing = math.prod((own[k] for own in each[1:]), start=each[0][k])
        distance += failing * legs[k + 1]
    slope = ca.gradient(distance, z)
    direction = ca.SX.sym("direction", z.numel())
    return PassageProgramme(
        ca.Function("distance", [z], [distance]),
        ca.Function("slope", [z], [slope]),
        ca.Function("along", [z, direction], [ca.jtimes(slope, z, direction)]),
    )


def _failing(z: Any, steps: int) -> list[Any]:
    """Return symbolic P(not connected so far) at each position, for one station."""
    import casadi as ca

    mean = [z[k] for k in range(steps)]
    covariance = [[z[steps * (1 + j) + i] for j in range(steps)] for i in range(steps)]
    failing: Any = 1.0
    found: list[Any] = []
    for k in range(steps):
        deviation = ca.sqrt(covariance[k][k])
        score = ca.fmax(-mean[k] / deviation, LEAST_SCORE)
        below = 0.5 * (1.0 + ca.erf(score / math.sqrt(2.0)))
        ratio = ca.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi) / below
        failing = failing * below
        found.append(failing)
        shrink = ratio * (ratio + score) / covariance[k][k]
        for i in range(k + 1, steps):
            mean[i] -= covariance[i][k] / deviation * ratio
            for j in range(k + 1, i + 1):
                covariance[i][j] -= covariance[i][k] * covariance[j][k] * shrink
    return found


def charged_distance_derivatives(
    channels: Sequence[LocalChannel],
    path_m: Floats,  # (h, 2)
    settings: Search,
    width_m: float,
    beyond: Derivatives | None = None,  # Cost of ending unconnected at the last position
    probed: Mask | None = None,  # (h,)
) -> PathDerivatives:
    """Return :func:`charged_distance_m` with derivatives, by local channels and filtering."""
    stations = [LocalPaths(channel, path_m[None]) for channel in channels]
    steps = len(path_m)
    legs = rounded_length(np.diff(np.vstack([settings.start_m, path_m]), axis=0), width_m)
    if settings.step_m is not None:
        driven = 1.0 - WAITING
        counted = counted_legs_m(legs.value, settings.step_m)
        legs = Derivatives(counted, driven * legs.gradient, driven * legs.hessian)
    if beyond is None:
        beyond = Derivatives(np.array([settings.beyond_m]), np.zeros((1, 2)), np.zeros((1, 3)))
    missing_db = 0.0 if probed is None else np.where(probed, 0.0, NOT_PROBED_DB)
    z: list[Floats] = []
    # Derivatives of z w.r.t. the coordinates.
    jacobian: list[Floats] = []
    for station, threshold in zip(stations, settings.thresholds_dbm, strict=True):
        z += [station.power_mean.value - threshold - missing_db, station.universal.value[0].ravel()]
        jacobian += _jacobians(station)
    by_beyond = np.zeros((1, 2 * steps))
    by_beyond[0, -2:] = beyond.gradient[0]
    point = np.concatenate([*z, legs.value, beyond.value])
    directions = np.concatenate([*jacobian, length_jacobian(legs), by_beyond])

    programme = passage_programme(steps, len(stations))
    gradient = np.asarray(programme.gradient(point)).ravel()
    hessian = directions.T @ np.asarray(programme.along(point, directions))
    size = steps * (steps + 1)
    for number, station in enumerate(stations):
        own = gradient[number * size : (number + 1) * size]
        by_s = own[steps:].reshape(steps, steps)
        hessian += station.universal.curvature(0.5 * (by_s + by_s.T))
        add_own_blocks(hessian, own[:steps, None] * station.power_mean.hessian)
    hessian += by_lengths(legs, gradient[-steps - 1 : -1])[1]
    xx, xy, yy = gradient[-1] * beyond.hessian[0]
    hessian[-2:, -2:] += [[xx, xy], [xy, yy]]
    return PathDerivatives(
        float(programme.value(point)), directions.T @ gradient, 0.5 * (hessian + hessian.T)
    )


def _jacobians(station: LocalPaths) -> list[Floats]:
    """Return the Jacobians of the mean (h, 2 h) and covariance (h h, 2 h) of a station's power."""
    steps = station.shape[1]
    k = np.arange(steps)
    by_mean = np.zeros((steps, steps, 2))
    by_mean[k, k] = station.power_mean.gradient
    by_covariance = np.zeros((steps, steps, steps, 2))
    first = station.universal.first[0].reshape(steps, 2, steps)
    by_covariance[k, :, k] += first.transpose(0, 2, 1)
    by_covariance[:, k, k] += first.transpose(2, 0, 1)
    return [by_mean.reshape(steps, -1), by_covariance.reshape(steps * steps, -1)]


@dataclass(frozen=True)
class UntilConnectedTerm(Term):
    """Expected distance until connected, a cost in metres."""

    beyond_m: Annotated[
        float | None,
        Field(
            ge=0,
            le=1e6,
            description="Expected length in metres of the search that remains if the end of the "
            "path is not connected; default: estimated from the posterior.",
        ),
    ] = None

    kind: ClassVar[str] = "until_connected"
    summary: ClassVar[str] = "Expected distance until connected, a cost."
    task: ClassVar[str | None] = "connect"

    @property
    def steers(self) -> Steers | None:
        """Return ``connection``: the term steers to positions where the robot tries to connect."""
        return "connection"

    def search(self, at: TermContext) -> Search:
        """Return the settings of the search for connection at the current step."""
        x, y = at.position_m
        return Search(
            (float(x), float(y)),
            at.law.thresholds_dbm,
            beyond_m=at.once((UntilConnectedTerm, "after", self), lambda: self._after_try_m(at)),
            step_m=at.step_length_m,
        )

    def _after_try_m(self, at: TermContext) -> float:
        """Return the expected search length beyond the probe at the end of the steering path."""
        # R - D of `search_length_m`; it depends on that path only, so it can be recomputed.
        steered = at.steering
        if steered is None:
            return at.workspace_diagonal_m if self.beyond_m is None else self.beyond_m
        chance = np.array([at.chance(steered.end_m)])
        after = self.search_length_m(at, steered.rest_m[:1], chance) - steered.rest_m[0]
        # The cost is capped, because probabilities near a thousandth are unreliable.
        most_m = at.workspace_diagonal_m if self.beyond_m is None else np.inf
        return max(min(float(after[0]), most_m), 0.0)

    def search_length_m(self, at: TermContext, length_m: Floats, chance: Floats) -> Floats:
        """Return expected search lengths (k,) for first probes at distances `length_m` (k,)."""
        # The length is R of the module's `search_length_m`, or D + (1 - P) `beyond_m`.
        if self.beyond_m is not None:
            return length_m + (1.0 - chance) * self.beyond_m
        decorrelation_m = max(own.parameters.decorrelation_m for own in at.law.posteriors)
        return search_length_m(length_m, chance, decorrelation_m)

    def charged_beyond_m(self, at: TermContext, ends_m: Floats) -> Floats:
        """Return the cost-to-go (n,) of plans that end unconnected at `ends_m` (n, 2)."""
        after = np.full(len(ends_m), self.search(at).beyond_m)
        return after if at.steering is None else after + at.steering.distance_m(ends_m)

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return minus the expected distance until connected for one path, in metres."""

        def charged_m() -> float:
            beyond = float(self.charged_beyond_m(at, path_m[-1:])[0])
            settings = replace(self.search(at), beyond_m=beyond)
            return charged_distance_m(at.law.posteriors, path_m, settings, at.probing.takes(path_m))

        return -at.once((UntilConnectedTerm, "charged", self, path_m.tobytes()), charged_m)

    def values(self, paths: Paths) -> Floats:
        """Return minus the expected distances until connected of many paths."""
        settings = self.search(paths.at)
        missing_db = np.where(paths.at.probing.takes(paths.paths_m), 0.0, NOT_PROBED_DB)
        powers = [
            (
                power.mean_db.reshape(paths.shape) - threshold - missing_db,
                station.plain_universal.value,
            )
            for power, station, threshold in zip(
                paths.each, paths.stations, settings.thresholds_dbm, strict=True
            )
        ]
        beyond = self.charged_beyond_m(paths.at, paths.paths_m[:, -1])
        legs = counted_legs_m(paths.legs_m, settings.step_m)
        return -charged_distances_m(powers, legs, beyond)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the value and derivatives of one path, using the local channel."""
        search = self.search(path.at)
        found = charged_distance_derivatives(
            path.channels,
            path.places_m,
            search,
            path.rounding_m,
            _beyond(path, search),
            path.probed,
        )
        return PathDerivatives(-found.value, -found.gradient, -found.hessian)

    def stage_reward(
        self, at: TermContext, places_m: Floats, stage: int | Indices, chance: Floats
    ) -> Floats:
        """Return the expected distance saved by a probe at each position."""
        return self.search(at).beyond_m * chance

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return an upper bound of the distance that one probe saves."""
        return self.search(at).beyond_m


def _beyond(path: NearPath, search: Search) -> Derivatives | None:
    """Return the cost-to-go with derivatives w.r.t. the last position; None without steering."""
    steering = path.at.steering
    if path.ahead is None or steering is None:
        return None
    turn = path.ahead[-1:]
    leg = rounded_length(path.places_m[-1:] - steering.turns_m[turn], path.rounding_m)
    rest = leg.value + steering.rest_m[turn] + search.beyond_m
    return Derivatives(rest, leg.gradient, leg.hessian)
