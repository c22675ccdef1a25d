"""Maximum-likelihood localisation of events from a signal that decays with distance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.coverage.voronoi import ConvexRegion
from planopt.errors import InputError

GRID = 48  # Number of grid positions along the longer side of the region
STARTS = 6  # Number of grid positions used as initial guesses
STEPS = 60  # Maximum number of Levenberg-Marquardt steps
SETTLED = 1e-10  # Step length, as a share of the region's radius, below which the iteration stops
RIVAL = 8.0  # Maximum excess of -2 log L of other maxima that are reported
SINGULAR = 1e-12  # Eigenvalue ratio below which an information matrix counts as singular


@dataclass(frozen=True)
class EventSensor:
    """Measurement model ``K F(d) + noise`` of a diffusing source, ``F = 1/((d/scale)^2 + 1)``."""

    # The slope of F is largest at ``scale / sqrt(3)`` and zero at the source.

    noise_std: float  # Standard deviation of the Gaussian noise, in the signal's unit
    strength: float  # Factor K; estimators may treat it as unknown
    scale_m: float = 1.0  # Distance at which the signal has half its strength

    def profile(self, distance_m: Floats) -> Floats:
        """Return the signal profile F at distances, in the shape of the input."""
        return 1.0 / ((distance_m / self.scale_m) ** 2 + 1.0)

    def slope(self, distance_m: Floats) -> Floats:
        """Return the derivative of F with respect to distance in 1/m, in the shape of the input."""
        ratio = distance_m / self.scale_m
        return -2.0 * ratio / self.scale_m / (ratio**2 + 1.0) ** 2

    @property
    def best_distance_m(self) -> float:
        """Return the distance at which a reading is most informative about an event's position."""
        return self.scale_m / math.sqrt(3.0)


def measure(
    sensor: EventSensor,
    positions_m: Floats,  # (k, 2) positions of the agents
    event_m: Floats,  # (2,)
    generator: np.random.Generator,
) -> Floats:
    """Draw one noisy measurement at each position."""
    distance = np.linalg.norm(positions_m - event_m, axis=1)
    noise = generator.standard_normal(len(positions_m))
    return sensor.strength * sensor.profile(distance) + sensor.noise_std * noise


def fisher_information(
    sensor: EventSensor,
    positions_m: Floats,  # (k, 2) positions of the measurements
    event_m: Floats,  # (2,) position of the event
    counts: Floats | None = None,  # (k,) number of measurements at each position; one if None
) -> Floats:
    """Return the Fisher information (2, 2) of an event's position for a known strength."""
    offset = positions_m - event_m
    distance = np.linalg.norm(offset, axis=1)
    unit = offset / np.where(distance > 0.0, distance, 1.0)[:, None]
    gain = sensor.strength * sensor.slope(distance) / sensor.noise_std
    weight = gain**2 if counts is None else counts * gain**2
    return (unit * weight[:, None]).T @ unit


def cramer_rao_m2(information: Floats) -> float:
    """Return the Cramer-Rao bound on the mean squared position error, from `information`."""
    # The bound is infinite if the information ``(2, 2)`` is singular.
    determinant = float(np.linalg.det(information))
    trace = float(np.trace(information))
    return trace / determinant if determinant > 1e-14 * trace**2 else math.inf


@dataclass(frozen=True, eq=False)
class Readings:
    """Means and counts of repeated measurements, a sufficient statistic for the position."""

    positions_m: Floats  # (k, 2) positions of the measurements
    signal: Floats  # (k,) mean measurements in the signal's unit
    counts: Floats  # (k,) number of measurements in each mean


def single_readings(positions_m: Floats, signal: Floats) -> Readings:
    """Return the readings of single measurements ``(k,)`` at positions ``(k, 2)``."""
    return Readings(positions_m, signal, np.ones(len(signal)))


def joined(logs: Sequence[Readings]) -> Readings:
    """Concatenate the readings of one or more logs."""
    return Readings(
        np.concatenate([log.positions_m for log in logs]),
        np.concatenate([log.signal for log in logs]),
        np.concatenate([log.counts for log in logs]),
    )


def pooled(logs: Sequence[Readings]) -> Readings:
    """Return the readings of all logs, with readings at equal positions averaged."""
    every = joined(logs)
    positions, which = np.unique(every.positions_m, axis=0, return_inverse=True)
    total = np.bincount(which, every.counts, minlength=len(positions))
    mean = np.bincount(which, every.counts * every.signal, minlength=len(positions)) / total
    return Readings(positions, mean, np.asarray(total, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class EventEstimate:
    """Maximum-likelihood estimate of an event's position."""

    position_m: Floats  # (2,)
    strength: float  # Factor K of the signal, estimated or known
    # (2, 2) inverse of the Fisher information; infinite if a direction is undetermined
    covariance_m2: Floats
    # Squared residuals over the noise variance; near their number if the model fits
    misfit: float
    rivals_m: Floats  # (r, 2) other local maxima with nearly the same likelihood
    velocity_m_s: Floats  # (2,) estimated velocity of a moving event; zero for static events


@dataclass(frozen=True, eq=False)
class Drift:
    """Constant-velocity motion model of an event, whose velocity is estimated with its position."""

    ages_s: Floats  # (k,) time since each reading was taken
    speed_std_m_s: float  # Prior standard deviation of each velocity component, positive
    guess_m_s: Floats  # (2,) initial guess of the velocity in addition to zero


def locate_event(
    sensor: EventSensor,
    readings: Readings,
    region: ConvexRegion,
    *,
    strength_known: bool = True,
    near_m: Floats | None = None,  # (g, 2) initial guesses of the position; a grid if None
    drift: Drift | None = None,
) -> EventEstimate:
    """Estimate the position of an event by maximum likelihood from several initial guesses."""
    if not len(readings.signal):
        raise InputError("is empty", key="readings", remedy="give at least one reading")
    grid = _grid(region) if near_m is None else _inside(region, near_m)
    starts = _starts(sensor, readings, grid, strength_known)
    if drift is not None:
        # With readings shifted by velocity times age, the event is static.
        shifted = readings.positions_m + drift.ages_s[:, None] * drift.guess_m_s
        moved = Readings(shifted, readings.signal, readings.counts)
        more = _starts(sensor, moved, grid, strength_known)
        more[:, 2:4] = drift.guess_m_s
        starts = np.concatenate((starts, more))
    free = np.array([True, True, *[drift is not None] * 2, not strength_known])
    found, misfit, information = _refined(sensor, readings, region, starts, free, drift)
    # A singular information matrix leaves all parameters undetermined.
    scale = np.sqrt(np.diag(information))
    even = information / np.outer(scale, scale) if (scale > 0.0).all() else np.zeros((1, 1))
    covariance = np.diag(np.full(2, np.inf))
    if np.linalg.eigvalsh(even)[0] >= SINGULAR:
        covariance = (np.linalg.inv(even) / np.outer(scale, scale))[:2, :2]
    width = 4.0 * float(np.sqrt(np.diag(covariance).max()))
    width = max(width if np.isfinite(width) else 0.0, 1e-6 * region.radius_m)
    places = [found[0, :2]]
    for place, one in zip(found[1:, :2], misfit[1:], strict=True):
        apart = np.linalg.norm(np.array(places) - place, axis=1)
        if one < misfit[0] + RIVAL and apart.min() > width:
            places.append(place)
    rivals, best = np.array(places[1:]).reshape(-1, 2), found[0]
    return EventEstimate(best[:2], float(best[4]), covariance, float(misfit[0]), rivals, best[2:4])


def _grid(region: ConvexRegion) -> Floats:
    """Return the positions (g, 2) of a regular grid in the region, and of the region's corners."""
    low, high = region.corners_m.min(axis=0), region.corners_m.max(axis=0)
    side = float((high - low).max()) / GRID
    x, y = (np.arange(low[k] + 0.5 * side, high[k], side) for k in range(2))
    positions = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.concatenate((positions[region.contains(positions)], region.corners_m))


def _starts(sensor: EventSensor, readings: Readings, grid: Floats, strength_known: bool) -> Floats:
    """Return initial event parameters (b, 5) at the best non-adjacent grid positions."""
    shape = sensor.profile(np.linalg.norm(grid[:, None] - readings.positions_m, axis=2))
    strength = np.full(len(grid), sensor.strength)
    if not strength_known:
        explained = (shape * shape) @ readings.counts
        strength = shape @ (readings.counts * readings.signal)
        strength = np.maximum(strength / np.where(explained > 0.0, explained, 1.0), 0.0)
    misfit = ((readings.signal - strength[:, None] * shape) ** 2) @ readings.counts
    chosen: list[int] = []
    spread = float(np.ptp(grid, axis=0).max()) / GRID
    for which in np.argsort(misfit).tolist():
        # Guesses next to a chosen one converge to the same maximum.
        apart = np.linalg.norm(grid[chosen] - grid[which], axis=1)
        if not (apart < 2.5 * spread).any():
            chosen.append(which)
        if len(chosen) == STARTS:
            break
    return np.column_stack((grid[chosen], np.zeros((len(chosen), 2)), strength[chosen]))


def _linearised(
    sensor: EventSensor, readings: Readings, drift: Drift | None, values: Floats
) -> tuple[Floats, Floats]:
    """Return normalised residuals (b, r), and derivatives (b, r, 5) of the model by parameters."""
    # Rows (b, 5): position, velocity and strength; the velocity's prior adds residuals.
    place, velocity, strength = values[:, None, :2], values[:, None, 2:4], values[:, 4:]
    ages = np.zeros((len(readings.signal), 1)) if drift is None else drift.ages_s[:, None]
    offset = place - (readings.positions_m + ages * velocity)
    distance = np.sqrt((offset * offset).sum(axis=-1))
    profile = sensor.profile(distance)
    # At the event the direction is undefined, but the slope of the profile is zero.
    along = strength * sensor.slope(distance) / np.where(distance > 0.0, distance, 1.0)
    toward = along[..., None] * offset
    root = np.sqrt(readings.counts) / sensor.noise_std
    residual = root * (readings.signal - profile * strength)
    slopes = root[:, None] * np.concatenate((toward, -ages * toward, profile[..., None]), axis=2)
    if drift is None:
        return residual, slopes
    prior = np.zeros((len(values), 2, 5))
    prior[:, :, 2:4] = np.eye(2) / drift.speed_std_m_s
    residual = np.concatenate((residual, -values[:, 2:4] / drift.speed_std_m_s), axis=1)
    return residual, np.concatenate((slopes, prior), axis=1)


def _refined(
    sensor: EventSensor,
    readings: Readings,
    region: ConvexRegion,
    values: Floats,
    free: Mask,  # (5,) mask of the estimated parameters
    drift: Drift | None,
) -> tuple[Floats, Floats, Floats]:
    """Refine initial guesses (b, 5) together by Levenberg-Marquardt steps within the region."""
    residual, slopes = _linearised(sensor, readings, drift, values)
    misfit = (residual * residual).sum(axis=1)
    damping = np.full(len(values), 1e-3)
    active = np.ones(len(values), dtype=np.bool_)
    for _ in range(STEPS):
        jacobian = slopes[..., free]
        information = np.swapaxes(jacobian, 1, 2) @ jacobian
        scale = np.diagonal(information, axis1=1, axis2=2)
        scale = damping[:, None] * np.where(scale > 0.0, scale, 1.0)
        damped = information + scale[:, :, None] * np.eye(scale.shape[1])
        pull = np.swapaxes(jacobian, 1, 2) @ residual[..., None]
        trial = values.copy()
        trial[:, free] += np.linalg.solve(damped, pull)[..., 0]
        trial[:, :2] = _inside(region, trial[:, :2])
        trial[:, 4] = np.maximum(trial[:, 4], 0.0)
        trial_residual, trial_slopes = _linearised(sensor, readings, drift, trial)
        value = (trial_residual * trial_residual).sum(axis=1)
        better = active & (value < misfit)
        shift = np.abs(trial[:, :2] - values[:, :2]).max(axis=1)
        values[better], misfit[better] = trial[better], value[better]
        residual[better], slopes[better] = trial_residual[better], trial_slopes[better]
        damping = np.where(better, np.maximum(damping / 5.0, 1e-12), 4.0 * damping)
        active &= ~(better & (shift < SETTLED * region.radius_m)) & (damping < 1e12)
        if not active.any():
            break
    order = np.argsort(misfit, kind="stable")
    best = slopes[order[0]][:, free]
    return values[order], misfit[order], best.T @ best


def _inside(region: ConvexRegion, positions: Floats) -> Floats:
    """Return positions (j, 2) projected onto the half-plane of each side in turn."""
    moved = positions.copy()
    for _ in range(3):
        for normal, offset in zip(region.normals, region.offsets_m, strict=True):
            moved -= np.maximum(moved @ normal - offset, 0.0)[:, None] * normal
    return moved
