"""Test of the readings of one step for a faulty sensor (Baarda's data snooping)."""

import numpy as np
from scipy.special import chdtrc, chdtri  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats, Mask
from planopt.coverage.assignment import NONE
from planopt.coverage.events import Sensing
from planopt.coverage.localisation import RIVAL, EventEstimate, Readings, locate_event
from planopt.coverage.voronoi import ConvexRegion

GLOBAL_LEVEL = 1e-3
"""Level of the test whether all readings of a step fit one event, or none."""
OUTLIER_LEVEL = 1e-6
"""Level at which a single reading is an outlier, and at which readings refute an estimate."""
OUTLIER = float(chdtri(1, OUTLIER_LEVEL))
"""Decrease of the misfit above which a single reading is an outlier."""
CONTRADICTIONS = 3
"""Number of contradictions after which a sensor is excluded."""


def taken(readings: Readings, rows: Mask) -> Readings:
    """Return the readings that the mask `rows` selects."""
    return Readings(readings.positions_m[rows], readings.signal[rows], readings.counts[rows])


def misfit_level(readings: Readings, sensing: Sensing, event: EventEstimate) -> float:
    """Return the significance level at which the readings of one step refute an estimate."""
    away_m = np.linalg.norm(readings.positions_m - event.position_m, axis=1)
    expected = event.strength * sensing.sensor.profile(away_m)
    misfit = float((((readings.signal - expected) / sensing.sensor.noise_std) ** 2).sum())
    return float(chdtrc(len(readings.signal), misfit))


def faulty_reading(readings: Readings, sensing: Sensing, hull: ConvexRegion) -> int:
    """Return the number of the reading that the others of its step contradict; `NONE` if none.

    The test is that of equation (7.22).

    Parameters
    ----------
    readings, sensing, hull
        Readings of one step, the sensor's model, and the region that contains the event.

    Examples
    --------
    >>> from planopt.coverage import EventSensor, convex_region, single_readings
    >>> import numpy as np
    >>> square = convex_region(np.array([[0, 0], [40, 0], [40, 40], [0, 40]]))
    >>> places_m = np.array([[20.0, 20.0], [21.0, 20.0], [20.0, 21.0], [30.0, 30.0]])
    >>> readings = single_readings(places_m, np.array([0.1, 54.0, -0.2, 0.3]))
    >>> faulty_reading(readings, Sensing(EventSensor(0.5, 60.0, 3.0)), square)
    1
    """
    count, deviation = len(readings.signal), readings.signal / sensing.sensor.noise_std
    every = _misfit(readings, deviation, sensing, hull)
    if count < 3 or every < float(chdtri(count, GLOBAL_LEVEL)):
        return NONE
    rest = np.array(
        [
            _misfit(taken(readings, kept), deviation[kept], sensing, hull)
            for kept in ~np.eye(count, dtype=np.bool_)
        ]
    )
    best, second = np.sort(rest)[:2]
    # If two readings explain the misfit nearly as well, the fault cannot be told.
    found = every - best > OUTLIER and second - best > RIVAL
    return int(rest.argmin()) if found else NONE


def _misfit(readings: Readings, deviation: Floats, sensing: Sensing, hull: ConvexRegion) -> float:
    """Return the smaller misfit of readings: without an event, or with one at its best position."""
    silent = float((deviation**2).sum())
    if silent < OUTLIER:
        return silent
    event = locate_event(sensing.sensor, readings, hull, strength_known=sensing.strength_known)
    return min(silent, event.misfit)
