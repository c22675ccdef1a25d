"""Localisation of events from readings of a signal that falls with distance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.region import ConvexRegion, positive
from planopt.errors import InputError

Profile = Callable[[NDArray[np.float64]], NDArray[np.float64]]

SCAN = 400
"""Distances that are tried, evenly and on a logarithmic scale, for the steepest point."""

ZOOMS, ZOOMED = 12, 21
"""How often the best distance's surroundings are looked at again, at how many distances: each time
they are a tenth as wide."""


@dataclass(frozen=True)
class EventSensor:
    """The measurement ``S = K F(d) + noise`` at a distance d from the event."""

    # Standard deviation sigma of the Gaussian noise, in the signal's unit; more than 0
    noise_std: float
    strength: float  # K: factor of the profile, more than 0. Estimators may treat it as unknown.
    profile: Profile  # F: decreasing function of the distance in metres; takes and returns arrays
    slope: Profile  # Its derivative by distance
    # Beyond this distance the signal is of no use; used to look for the best distance
    reach_m: float

    def __post_init__(self) -> None:
        positive(self.noise_std, "sensor.noise_std")
        positive(self.strength, "sensor.strength")
        positive(self.reach_m, "sensor.reach_m")
        distances = np.linspace(0.0, self.reach_m, SCAN)
        values, slopes = self.profile(distances), self.slope(distances)
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            raise InputError("the profile is not finite", key="sensor.profile")
        if (slopes > 0.0).any() or (np.diff(values) > 0.0).any():
            raise InputError(
                "the signal grows with distance", key="sensor.profile", remedy="F has to decrease"
            )

    def signal(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signal without noise at distances; of the same shape."""
        return self.strength * self.profile(distance_m)

    def gain(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``K F'(d)`` at distances: change of the signal per metre; of the same shape."""
        return self.strength * self.slope(distance_m)


def diffusion_sensor(
    noise_std: float, strength: float, scale_m: float = 1.0, reach_m: float = 100.0
) -> EventSensor:
    """Return the sensor of a diffusing source, ``S = K / ((d / scale)^2 + 1) + noise``."""
    positive(scale_m, "sensor.scale_m")

    def profile(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1.0 / ((distance_m / scale_m) ** 2 + 1.0)

    def slope(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = distance_m / scale_m
        return -2.0 * ratio / scale_m / (ratio**2 + 1.0) ** 2

    return EventSensor(noise_std, strength, profile, slope, reach_m)


def measure(
    sensor: EventSensor,
    positions_m: NDArray[np.float64],  # (k, 2) where agents measure
    event_m: NDArray[np.float64],  # (2,) where the event is
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw one measurement at each position."""
    distance = np.linalg.norm(positions_m - event_m, axis=1)
    noise = generator.standard_normal(len(positions_m))
    return sensor.signal(distance) + sensor.noise_std * noise


def sensitivity(sensor: EventSensor, distance_m: float) -> float:
    """Return g: how much the signal changes per metre at a distance, at least 0."""
    return float(-sensor.gain(np.array([distance_m]))[0])


def best_distance_m(sensor: EventSensor) -> float:
    """Return the distance at which a measurement tells most of where the event is.

    That is where the signal is steepest: ``scale / sqrt(3)`` for a diffusing source. At the source
    itself the slope is zero, and a measurement tells nothing.
    """
    # A source that is small against its reach is between the first distances of an even grid.
    even = np.linspace(0.0, sensor.reach_m, SCAN)
    fine = np.geomspace(1e-6 * sensor.reach_m, sensor.reach_m, SCAN)
    distances = np.sort(np.concatenate((even, fine)))
    best = int(sensor.gain(distances).argmin())
    for _ in range(ZOOMS):
        low, high = distances[max(best - 1, 0)], distances[min(best + 1, len(distances) - 1)]
        distances = np.linspace(float(low), float(high), ZOOMED)
        best = int(sensor.gain(distances).argmin())
    return float(distances[best])


@dataclass(frozen=True, eq=False)
class Readings:
    """Means of measurements, each at one place.

    The mean of repeated measurements at one place and their number hold all that they tell.
    """

    positions_m: NDArray[np.float64]  # (k, 2) where they were taken
    signal: NDArray[np.float64]  # (k,) their means, in the signal's unit
    counts: NDArray[np.float64]  # (k,) how many measurements each is the mean of

    def __post_init__(self) -> None:
        count = len(self.signal)
        shapes = self.positions_m.shape, self.signal.shape, self.counts.shape
        if shapes != ((count, 2), (count,), (count,)):
            raise InputError(f"arrays of shapes {shapes} are no readings", key="readings")
        finite = np.isfinite(self.positions_m).all() and np.isfinite(self.signal).all()
        if not finite or not (self.counts >= 1.0).all():
            raise InputError("a reading is not finite, or of no measurement", key="readings")


def no_readings() -> Readings:
    """Return readings without any measurement."""
    return Readings(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def single_readings(positions_m: NDArray[np.float64], signal: NDArray[np.float64]) -> Readings:
    """Return measurements ``(k,)`` that were taken once at each of ``(k, 2)`` places."""
    return Readings(positions_m, signal, np.ones(len(signal)))


def pooled(logs: Iterable[Readings]) -> Readings:
    """Join readings, and average those that were taken at the very same place."""
    every = [no_readings(), *logs]
    positions = np.concatenate([log.positions_m for log in every])
    signal = np.concatenate([log.signal for log in every])
    counts = np.concatenate([log.counts for log in every])
    places, which = np.unique(positions, axis=0, return_inverse=True)
    total = np.bincount(which, counts, minlength=len(places))
    mean = np.bincount(which, counts * signal, minlength=len(places)) / np.maximum(total, 1.0)
    return Readings(places, mean, np.asarray(total, dtype=np.float64))


GRID = 48
"""Grid places along the longer side of the region."""

STARTS = 6
"""How many of the best grid places are refined."""

STEPS = 60
"""Limit of Levenberg-Marquardt steps."""

SETTLED = 1e-10
"""Steps end once they move by less than this share of the region's radius."""

RIVAL = 8.0
"""Twice the log-likelihood that another maximum may be worse by and still count: the event may be
there with odds of more than 1 to 55."""

SINGULAR = 1e-12
"""An information matrix with a smaller ratio of eigenvalues leaves a direction undetermined."""


@dataclass(frozen=True, eq=False)
class EventEstimate:
    """The most likely places of events."""

    positions_m: NDArray[np.float64]  # (j, 2) most likely places
    strengths: NDArray[np.float64]  # (j,) factors K of their signals, estimated or as given
    # (2 j, 2 j) covariance of the places, x and y of each event in turn: the inverse of the Fisher
    # information. Infinite on the diagonal where the readings leave a direction open.
    covariance_m2: NDArray[np.float64]
    # Sum of squared residuals over the noise variance; about the number of readings if the model is
    # right
    misfit: float
    # (r, 2) other places that explain the readings nearly as well; for one event only
    rivals_m: NDArray[np.float64]
    # (2,) estimated velocity of an event that moves; zero for others
    velocity_m_s: NDArray[np.float64]

    @property
    def is_determined(self) -> bool:
        """Return whether the readings leave neither a direction nor another place open."""
        return bool(np.isfinite(self.covariance_m2).all()) and not len(self.rivals_m)


@dataclass(frozen=True, eq=False)
class Drift:
    """The motion of an event at a constant velocity, estimated together with its place."""

    ages_s: NDArray[np.float64]  # (k,) how long ago each reading was taken
    # Standard deviation of each component of the velocity before anything is read, more than 0
    speed_std_m_s: float
    # (2,) a velocity to start from besides zero, such as an earlier estimate
    guess_m_s: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Fits:
    """Local maxima, best first.

    Places (b, j, 2), velocities (b, 2), strengths (b, j), misfits (b,), and informations.
    """

    places: NDArray[np.float64]
    velocities: NDArray[np.float64]
    strengths: NDArray[np.float64]
    misfit: NDArray[np.float64]
    information: NDArray[np.float64]


def locate_events(
    sensor: EventSensor,
    readings: Readings,
    region: ConvexRegion,
    events: int = 1,
    *,
    strength_known: bool = True,
    near_m: NDArray[np.float64] | None = None,  # (g, 2)
    drift: Drift | None = None,
) -> EventEstimate:
    """Estimate the places of events whose signals add up."""
    if not len(readings.signal):
        raise InputError("there is no reading", key="readings", remedy="measure first")
    if events < 1:
        raise InputError(f"{events} events", key="events")
    if drift is not None and events != 1:
        raise InputError(f"{events} events that move", key="events", remedy="locate one at a time")
    grid = _grid(region) if near_m is None else _inside(region, near_m)
    places, strengths = np.zeros((0, 2)), np.zeros(0)
    fits = None
    for _ in range(events):
        first, known = _starts(sensor, readings, places, strengths, grid, strength_known)
        velocities = np.zeros((len(first), 2))
        if drift is not None:
            # Against readings that are moved by the velocity since they were taken, events stand.
            moved = readings.positions_m + drift.ages_s[:, None] * drift.guess_m_s
            shifted = Readings(moved, readings.signal, readings.counts)
            more = _starts(sensor, shifted, places, strengths, grid, strength_known)
            guesses = np.repeat(drift.guess_m_s[None], len(more[0]), axis=0)
            first, known = np.concatenate((first, more[0])), np.concatenate((known, more[1]))
            velocities = np.concatenate((velocities, guesses))
        fits = _refined(sensor, readings, region, first, velocities, known, strength_known, drift)
        places, strengths = fits.places[0], fits.strengths[0]
    if fits is None:
        raise AssertionError("no event was looked for")
    covariance = _covariance(fits.information[0])[: 2 * events, : 2 * events]
    rivals = _rivals(fits, covariance, region) if events == 1 else np.zeros((0, 2))
    misfit, velocity = float(fits.misfit[0]), fits.velocities[0]
    return EventEstimate(places, strengths, covariance, misfit, rivals, velocity)


def _grid(region: ConvexRegion) -> NDArray[np.float64]:
    """Places (g, 2) of an even grid in the region, and its corners."""
    low, high = region.corners_m.min(axis=0), region.corners_m.max(axis=0)
    side = float((high - low).max()) / GRID
    x, y = (np.arange(low[k] + 0.5 * side, high[k], side) for k in range(2))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.concatenate((places[region.contains(places)], region.corners_m))


def _starts(
    sensor: EventSensor,
    readings: Readings,
    places: NDArray[np.float64],
    strengths: NDArray[np.float64],
    grid: NDArray[np.float64],
    strength_known: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (b, j + 1, 2) and strengths: j that are found, and one of the best grid places."""
    left = readings.signal - _model(sensor, readings.positions_m, places, strengths)
    shape = sensor.profile(np.linalg.norm(grid[:, None] - readings.positions_m, axis=2))
    weight = readings.counts
    strength = np.full(len(grid), sensor.strength)
    if not strength_known:
        explained = (shape * shape) @ weight
        strength = (shape @ (weight * left)) / np.where(explained > 0.0, explained, 1.0)
        strength = np.maximum(strength, 0.0)
    misfit = ((left - strength[:, None] * shape) ** 2) @ weight
    chosen: list[int] = []
    spread = float(np.ptp(grid, axis=0).max()) / GRID
    for which in np.argsort(misfit).tolist():
        # Neighbours of a chosen place lead to the same maximum.
        apart = np.linalg.norm(grid[chosen] - grid[which], axis=1)
        if not (apart < 2.5 * spread).any():
            chosen.append(which)
        if len(chosen) == STARTS:
            break
    known = np.repeat(places[None], len(chosen), axis=0), np.repeat(strengths[None], len(chosen), 0)
    return (
        np.concatenate((known[0], grid[chosen][:, None]), axis=1),
        np.concatenate((known[1], strength[chosen][:, None]), axis=1),
    )


def _model(
    sensor: EventSensor,
    positions: NDArray[np.float64],
    places: NDArray[np.float64],
    strengths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Expected signals (..., k) of events at places (..., j, 2) of strengths (..., j).

    Positions of the readings are (k, 2) or (..., k, 2).
    """
    offset = places[..., None, :, :] - positions[..., None, :]
    distance = np.sqrt((offset * offset).sum(axis=-1))
    return (sensor.profile(distance) * strengths[..., None, :]).sum(axis=-1)


def _jacobian(
    sensor: EventSensor,
    positions: NDArray[np.float64],
    places: NDArray[np.float64],
    strengths: NDArray[np.float64],
    strength_known: bool,
    drift: Drift | None,
) -> NDArray[np.float64]:
    """Derivatives of expected signals; (b, k, columns).

    Columns are places, the velocity if the event moves, and unknown strengths.
    """
    offset = places[:, None] - positions[..., None, :]
    distance = np.sqrt((offset * offset).sum(axis=-1))
    # At the event itself the direction is undefined, and the slope of a smooth profile zero.
    along = strengths[:, None] * sensor.slope(distance) / np.where(distance > 0.0, distance, 1.0)
    columns = (along[..., None] * offset).reshape(*offset.shape[:2], -1)
    if drift is not None:
        columns = np.concatenate((columns, -drift.ages_s[:, None] * columns), axis=2)
    if strength_known:
        return columns
    return np.concatenate((columns, sensor.profile(distance)), axis=2)


def _refined(
    sensor: EventSensor,
    readings: Readings,
    region: ConvexRegion,
    places: NDArray[np.float64],
    velocities: NDArray[np.float64],
    strengths: NDArray[np.float64],
    strength_known: bool,
    drift: Drift | None,
) -> _Fits:
    """Climb from several starts at once to the maxima beside them, within the region."""
    root = np.sqrt(readings.counts) / sensor.noise_std
    starts, events = len(places), int(places.shape[1])
    still = 2 * events
    rest = still if drift is None else still + 2

    def seen(velocities: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of the readings, moved by the velocity since they were taken."""
        if drift is None:
            return readings.positions_m
        return readings.positions_m + drift.ages_s[:, None] * velocities[:, None]

    def residuals(
        places: NDArray[np.float64],
        velocities: NDArray[np.float64],
        strengths: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        found = root * (readings.signal - _model(sensor, seen(velocities), places, strengths))
        if drift is None:
            return found
        return np.concatenate((found, -velocities / drift.speed_std_m_s), axis=1)

    def slopes(
        places: NDArray[np.float64],
        velocities: NDArray[np.float64],
        strengths: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        found = root[:, None] * _jacobian(
            sensor, seen(velocities), places, strengths, strength_known, drift
        )
        if drift is None:
            return found
        prior = np.zeros((starts, 2, found.shape[2]))
        prior[:, :, still:rest] = np.eye(2) / drift.speed_std_m_s
        return np.concatenate((found, prior), axis=1)

    residual = residuals(places, velocities, strengths)
    misfit = np.asarray((residual * residual).sum(axis=1), dtype=np.float64)
    damping = np.full(starts, 1e-3)
    open_ = np.ones(starts, dtype=np.bool_)
    jacobian = slopes(places, velocities, strengths)
    for _ in range(STEPS):
        information = np.swapaxes(jacobian, 1, 2) @ jacobian
        scale = np.diagonal(information, axis1=1, axis2=2)
        scale = damping[:, None] * np.where(scale > 0.0, scale, 1.0)
        damped = information + scale[:, :, None] * np.eye(scale.shape[1])
        pull = np.swapaxes(jacobian, 1, 2) @ residual[..., None]
        step = np.asarray(np.linalg.solve(damped, pull), dtype=np.float64)[..., 0]
        moved = places + step[:, :still].reshape(places.shape)
        moved = _inside(region, moved.reshape(-1, 2)).reshape(places.shape)
        faster = velocities if drift is None else velocities + step[:, still:rest]
        stronger = strengths if strength_known else np.maximum(strengths + step[:, rest:], 0)
        tried = residuals(moved, faster, stronger)
        value = np.asarray((tried * tried).sum(axis=1), dtype=np.float64)
        better = np.asarray(open_ & (value < misfit), dtype=np.bool_)
        shift = np.abs(moved - places).max(axis=(1, 2))
        places = np.where(better[:, None, None], moved, places)
        velocities = np.where(better[:, None], faster, velocities)
        strengths = np.where(better[:, None], stronger, strengths)
        residual = np.where(better[:, None], tried, residual)
        misfit = np.where(better, value, misfit)
        damping = np.where(better, np.maximum(damping / 5.0, 1e-12), 4.0 * damping)
        going = ~(better & (shift < SETTLED * region.radius_m)) & (damping < 1e12)
        open_ = np.asarray(open_ & going, dtype=np.bool_)
        jacobian = slopes(places, velocities, strengths)
        if not open_.any():
            break
    order = np.argsort(misfit, kind="stable")
    information = np.swapaxes(jacobian, 1, 2) @ jacobian
    return _Fits(
        places[order], velocities[order], strengths[order], misfit[order], information[order]
    )


def _inside(region: ConvexRegion, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (j, 2), those outside moved to near the border: onto each side's line in turn."""
    moved = places.copy()
    for _ in range(3):
        for normal, offset in zip(region.normals, region.offsets_m, strict=True):
            moved -= np.maximum(moved @ normal - offset, 0.0)[:, None] * normal
    return moved


def _covariance(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of an information matrix; infinite on the diagonal if it is singular."""
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        return np.diag(np.full(len(scale), np.inf))
    even = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(even)[0] < SINGULAR:
        return np.diag(np.full(len(scale), np.inf))
    return np.linalg.inv(even) / np.outer(scale, scale)


def _rivals(
    fits: _Fits, covariance: NDArray[np.float64], region: ConvexRegion
) -> NDArray[np.float64]:
    """Other maxima (r, 2) nearly as good as the first, farther from it than its uncertainty."""
    width = 4.0 * float(np.sqrt(np.diag(covariance).max()))
    width = max(width if np.isfinite(width) else 0.0, 1e-6 * region.radius_m)
    found = [fits.places[0, 0]]
    for place, misfit in zip(fits.places[1:, 0], fits.misfit[1:], strict=True):
        apart = np.linalg.norm(np.array(found) - place, axis=1)
        if misfit < fits.misfit[0] + RIVAL and apart.min() > width:
            found.append(place)
    return np.array(found[1:]).reshape(-1, 2)
