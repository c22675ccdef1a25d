"""Verifier of a network's moves and event estimates, independent of planner and estimator."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erfc

from planopt.arrays import Floats
from planopt.coverage.limits import LinkLaw, Motion, MoveLimits, RadioLimits

SLACK = 1e-6  # Relative tolerance of motion limits; tolerance in metres of distances to boundaries
SAMPLES = 512
"""Number of additional, shorter lengths at which a link's failure probability is evaluated."""
LOOKS = 9  # Number of positions along a move at which estimated base-station channels are evaluated
SHORTEST_M = 0.01  # Minimum length in metres at which a link is evaluated


@dataclass(frozen=True)
class Fault:
    """Violated constraint of a move."""

    # contact, clearance, speed, acceleration, turn, motion (inconsistent states) or radio
    kind: str
    agent: int
    other: int | None  # The other agent of a contact
    value: float  # Actual value, and limit, in m, m/s, m/s^2, rad/s, or as a probability
    limit: float


def verify_moves(
    free: shapely.Polygon,
    before: Motion,
    after: Motion,
    limits: MoveLimits,
    radio: RadioLimits | None = None,
) -> tuple[Fault, ...]:
    """Return all constraint violations in one step of a network; empty for a verified step."""
    before_m, after_m = before.places_m, after.places_m
    move, step = after_m - before_m, limits.time_step_s
    found: list[Fault] = []

    def require(kind: str, values: Floats, limit: float, slack: float) -> None:
        """Add a fault for every agent with a value above a limit."""
        for agent in np.flatnonzero(values > limit + slack):
            found.append(Fault(kind, int(agent), None, float(values[agent]), limit))

    control = before_m + 0.5 * move
    if limits.acceleration_m_s2 is not None:
        first, last = before.velocities_m_s, after.velocities_m_s
        control = before_m + 0.5 * step * first
        gap = np.linalg.norm(move - 0.5 * step * (first + last), axis=1)
        require("motion", gap, 0.0, SLACK * (1.0 + limits.speed_m_s * step))
        speed = np.maximum(np.linalg.norm(first, axis=1), np.linalg.norm(last, axis=1))
        change, most = np.linalg.norm(last - first, axis=1) / step, limits.acceleration_m_s2
        require("acceleration", change, most, SLACK * most)
    else:
        speed = np.linalg.norm(move, axis=1) / step
    if limits.turn_rate_rad_s is not None:
        heading = after.headings_rad
        turn = np.abs(heading - before.headings_rad)
        require("turn", turn / step, limits.turn_rate_rad_s, SLACK * limits.turn_rate_rad_s)
        across = np.stack((-np.sin(heading), np.cos(heading)), axis=1)
        require("motion", np.abs((move * across).sum(axis=1)), 0.0, SLACK)
        left = np.maximum(step - turn / limits.turn_rate_rad_s, SLACK * step)
        speed = np.linalg.norm(move, axis=1) / left
    if math.isfinite(limits.speed_m_s):
        require("speed", speed, limits.speed_m_s, SLACK * limits.speed_m_s)
    corners = np.stack((before_m, control, after_m), axis=1)
    swept = np.asarray(shapely.convex_hull(shapely.multipoints(corners)))
    keep_m = max(limits.body_radius_m, limits.clearance_m)
    slack = SLACK * max(1.0, keep_m)
    away = np.asarray(shapely.distance(shapely.boundary(free), swept), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]
    away = np.where(shapely.covers(free.buffer(slack), swept), away, -1.0)
    for agent in np.flatnonzero(away < keep_m - slack).tolist():
        found.append(Fault("clearance", agent, None, float(away[agent]), keep_m))
    if limits.body_radius_m > 0.0:
        timed = limits.turn_rate_rad_s is None
        found += _contacts(swept, corners, 2.0 * limits.body_radius_m, timed)
    if radio is not None:
        failure = _failures(corners, radio)
        require("radio", failure, 1.0 - radio.p_min, SLACK * (1.0 - radio.p_min))
    return tuple(found)


def _contacts(
    swept: NDArray[np.object_], corners: Floats, least_m: float, timed: bool
) -> list[Fault]:
    """Return a fault for each pair of agents within `least_m`, at equal times if `timed`."""
    tree = shapely.STRtree(swept)
    pairs = tree.query(swept, predicate="dwithin", distance=least_m)
    found: list[Fault] = []
    for one, other in pairs.T:
        if one >= other:
            continue
        apart = float(shapely.distance(swept[one], swept[other]))  # pyright: ignore[reportUnknownMemberType]
        if timed:
            apart = _least_distance(corners[one] - corners[other])
        if apart <= least_m:
            found.append(Fault("contact", int(one), int(other), apart, least_m))
    return found


def _least_distance(corners: Floats) -> float:
    """Return the distance from the origin to a parabola with control points (3, 2)."""
    start, bend = corners[0], corners[0] - 2.0 * corners[1] + corners[2]
    slope = 2.0 * (corners[1] - corners[0])
    # |start + slope t + bend t^2|^2 is least at an end or at a root of its derivative.
    derivative = [
        2.0 * float(bend @ bend),
        3.0 * float(slope @ bend),
        float(slope @ slope) + 2.0 * float(start @ bend),
        float(start @ slope),
    ]
    times = [0.0, 1.0]
    scale = max(abs(one) for one in derivative)
    if scale > 0.0:
        roots = np.roots([one if abs(one) > 1e-14 * scale else 0.0 for one in derivative])
        times += [float(root.real) for root in roots if abs(root.imag) < 1e-6]
    places = [start + slope * t + bend * t * t for t in np.clip(times, 0.0, 1.0)]
    return min(math.hypot(*place) for place in places)


def _failures(corners: Floats, radio: RadioLimits) -> Floats:
    """Return upper bounds (n,) of each agent's probability of disconnection during a step."""
    # Each link has the largest length between any positions; the best path counts.
    count = len(corners)
    length = np.zeros((count, count))
    direct = np.zeros((count, len(radio.stations_m)))
    for corner in range(3):
        away = np.linalg.norm(corners[:, corner, None] - radio.stations_m, axis=2)
        direct = np.maximum(direct, away)
        for other in range(3):
            gap = np.linalg.norm(corners[:, corner, None] - corners[None, :, other], axis=2)
            length = np.maximum(length, gap)
    step, link = _fails(radio.agent_link, length, radio.threshold_dbm), radio.station_link
    if isinstance(link, LinkLaw):
        best = _fails(link, direct, radio.threshold_dbm).min(axis=1)
    else:
        # Evaluate estimated channels along the move; the station is the same throughout.
        t = np.linspace(0.0, 1.0, LOOKS)
        bend = np.stack(((1.0 - t) ** 2, 2.0 * t * (1.0 - t), t**2), axis=1)
        places = np.einsum("tk,nkx->tnx", bend, corners)
        powers = [one.predict(places.reshape(-1, 2)) for one in link.posteriors]
        each = [_below(one.mean_db - radio.threshold_dbm, one.deviation_db) for one in powers]
        best = np.array(each).reshape(len(each), LOOKS, count).max(axis=1).min(axis=0)
    waiting = np.ones(count, dtype=np.bool_)
    for _ in range(count):
        agent = int(np.where(waiting, best, np.inf).argmin())
        waiting[agent] = False
        better = waiting & (best[agent] + step[agent] < best)
        best[better] = best[agent] + step[agent, better]
    return np.minimum(best, 1.0)


def _below(margin_db: Floats, deviation_db: Floats) -> Floats:
    """Return P(power < threshold) of powers with a mean margin above the threshold."""
    score = margin_db / np.maximum(deviation_db, 1e-9)
    return 0.5 * np.asarray(erfc(score / math.sqrt(2.0)), dtype=np.float64)


def _fails(law: LinkLaw, lengths_m: Floats, threshold_dbm: float) -> Floats:
    """Return the largest failure probability of links up to each length."""

    def below(distance_m: Floats) -> Floats:
        slope = -10.0 * np.log10(distance_m)
        mean = law.theta[0] + slope * law.theta[1] - threshold_dbm
        (a, b), (_, c) = law.theta_covariance
        spread = np.sqrt(np.maximum(a + 2.0 * b * slope + c * slope**2, 0.0) + law.deviation_db**2)
        return _below(mean, spread)

    lengths = np.maximum(lengths_m, SHORTEST_M)
    grid = np.geomspace(SHORTEST_M, 2.0 * float(lengths.max()), SAMPLES)
    shorter = np.maximum.accumulate(below(grid))[np.searchsorted(grid, lengths, side="right") - 1]
    return np.maximum(below(lengths), shorter)


WORSE = 0.1
"""Largest permitted excess of -2 log L of an estimate over that of the best position nearby."""
TOO_SMALL = 0.97  # Smallest permitted ratio of a standard deviation to the recomputed one
HEADINGS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Initial guesses of an event's velocity, in prior standard deviations."""
FINE = 1e-12  # Relative tolerances of the least-squares solver


@dataclass(frozen=True)
class SignalModel:
    """Model ``K / ((d / scale)^2 + 1)`` of an event's readings, as used by the verifier."""

    noise_std: float
    strength: float
    strength_known: bool
    scale_m: float
    speed_std_m_s: float | None  # Prior standard deviation of velocity components; None: static


def _fitted(residuals: Callable[[Floats], Floats], first: Floats, most: int | None = None) -> Any:
    """Minimise the sum of squared residuals from an initial guess in at most `most` trials."""
    solver = cast("Any", least_squares)
    return solver(residuals, first, x_scale="jac", ftol=FINE, xtol=FINE, gtol=FINE, max_nfev=most)


def estimate_fault(
    model: SignalModel,
    positions_m: Floats,  # (r, 2) positions of the readings
    signal: Floats,  # (r,)
    ages_s: Floats,  # (r,) time from each reading to the estimate
    place_m: Floats,  # (2,) estimate and its standard deviation
    std_m: float,
    inner: bool,  # Whether the estimate is inside the region, not on its border
) -> str | None:
    """Return the reason why an estimate contradicts its readings; None if it agrees."""
    # The standard deviation may exceed the recomputed one, since it includes rival positions.
    moves, loud = model.speed_std_m_s is not None, not model.strength_known

    def residuals(values: Floats) -> Floats:
        """Return normalised residuals; `values` are position, velocity and strength."""
        velocity = values[2:4] if moves else np.zeros(2)
        offset = positions_m - (values[:2] - ages_s[:, None] * velocity)
        strength = values[-1] if loud else model.strength
        expected = strength / ((offset**2).sum(axis=1) / model.scale_m**2 + 1.0)
        prior = velocity / model.speed_std_m_s if model.speed_std_m_s is not None else np.zeros(0)
        return np.concatenate(((signal - expected) / model.noise_std, prior))

    # Velocity and strength are not saved; the best ones for the position are found first.
    away = ((positions_m - place_m) ** 2).sum(axis=1) / model.scale_m**2
    shape = 1.0 / (away + 1.0)
    if moves or loud:
        guess = np.full(int(loud), float(shape @ signal / (shape @ shape)))
        speed = model.speed_std_m_s or 0.0
        turns = speed * HEADINGS if moves else np.zeros((1, 0))
        trials = [
            _fitted(lambda part: residuals(np.concatenate((place_m, part))), first)
            for first in (np.concatenate((turn, guess)) for turn in turns)
        ]
        best = min(trials, key=lambda trial: trial.cost)
        rest, misfit = cast("Floats", best.x), 2.0 * float(best.cost)
    else:
        rest, misfit = np.zeros(0), float((residuals(place_m) ** 2).sum())
    found = _fitted(residuals, np.concatenate((place_m, rest)))
    # The covariance is that at the estimate: of few readings it may change within a metre.
    jacobian = cast("Floats", _fitted(residuals, np.concatenate((place_m, rest)), 1).jac)
    scale = np.linalg.norm(jacobian, axis=0)
    if not (scale > 0.0).all():
        return "the readings do not determine the position"
    even = jacobian / scale
    inverse = np.asarray(np.linalg.pinv(even.T @ even), dtype=np.float64)
    covariance = inverse / np.outer(scale, scale)
    best_m = float(np.sqrt(np.trace(covariance[:2, :2])))
    if inner and misfit > 2.0 * float(found.cost) + WORSE:
        off_m = float(np.linalg.norm(cast("Floats", found.x)[:2] - place_m))
        return f"the estimate is {off_m:.4g} m from the position that its readings determine"
    if inner and std_m < TOO_SMALL * best_m:
        return f"the standard deviation is {std_m:.4g} m, its readings have {best_m:.4g} m"
    return None
