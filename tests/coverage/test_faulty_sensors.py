"""Faulty sensors: located among readings as brute force does, and excluded by a network."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from planopt.coverage import (
    NONE,
    ConvexGround,
    Counting,
    Event,
    EventSensor,
    Gains,
    LawMover,
    NetworkController,
    Scene,
    Sensing,
    convex_region,
    faulty_reading,
    measure,
    signals,
    single_readings,
)

REGION = convex_region(np.array([[0, 0], [40, 0], [40, 30], [0, 30]]))
SENSING = Sensing(EventSensor(0.5, 60.0, 3.0))
GAINS = Gains(0.5, 1.0)
LAW = LawMover(GAINS, 1.0, 3.0)
PLACE_M = (30.0, 20.0)


def least_misfit(places: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    """Return the misfit of the best event of strength 60, or of none, from a fine grid."""

    def misfit(place: NDArray[np.float64]) -> float:
        square = ((places - place) ** 2).sum(axis=1)
        return float((((signal - 60.0 / (square / 9.0 + 1.0)) / 0.5) ** 2).sum())

    x, y = np.meshgrid(np.linspace(0, 40, 41), np.linspace(0, 30, 31))
    grid = np.stack((x.ravel(), y.ravel()), axis=1)
    starts = sorted(grid, key=misfit)[:3]
    bounds = [(0, 40), (0, 30)]
    found = [minimize(misfit, start, bounds=bounds, tol=1e-12).fun for start in starts]
    return min(*found, float(((signal / 0.5) ** 2).sum()))


@pytest.mark.parametrize("seed", range(3))
def test_the_contradicted_reading_is_that_of_brute_force(seed: int) -> None:
    """The reading whose removal lowers the misfit most, by enough, is found; else none."""
    generator = np.random.default_rng(seed)
    places = generator.random((6, 2)) * [40, 30]
    event = generator.random(2) * [40, 30]
    places[:3] = event + 2.0 * generator.standard_normal((3, 2))
    signal = measure(SENSING.sensor, places, event, generator)
    cases = [(signal, NONE)]
    for number, wrong in ((1, 0.0), (4, signal[4] + 8.0)):
        broken = signal.copy()
        broken[number] = wrong
        cases.append((broken, number))
    for values, broken in cases:
        rest = [least_misfit(np.delete(places, k, axis=0), np.delete(values, k)) for k in range(6)]
        every, order = least_misfit(places, values), np.argsort(rest)
        best, second = (rest[k] for k in order[:2])
        located = every - best > chi2.isf(1e-6, 1) and second - best > 8.0
        wanted = int(order[0]) if located and every > chi2.isf(1e-3, 6) else NONE
        found = faulty_reading(single_readings(places, values), SENSING, REGION)
        assert found == wanted
        assert found in (broken, NONE)


def test_two_readings_do_not_tell_which_is_wrong() -> None:
    """Of two contradictory readings at one position neither is excluded."""
    readings = single_readings(np.array([[20.0, 15.0], [20.0, 15.5]]), np.array([50.0, 0.0]))
    assert faulty_reading(readings, SENSING, REGION) == NONE


@pytest.mark.parametrize("signal", [None, 2.7])
def test_a_stuck_sensor_does_not_keep_a_team(signal: float | None) -> None:
    """A sensor stuck near an event or just above detection is excluded, and no other one."""
    event, generator = Event("leak", PLACE_M, 0.0, 12.0), np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(5.0, 40.0, 10.0), np.arange(5.0, 30.0, 10.0))
    starts = np.stack((x.ravel(), y.ravel()), axis=1)
    scene = Scene(
        ConvexGround(REGION), np.zeros(12), np.full(12, np.inf), (event,), (lambda _: 3,), SENSING,
        None, "all", GAINS, 1.0, Counting(), None, 20, 1.0, 60.0, 0.1,
    )  # fmt: skip
    scene = replace(scene, stop_when_settled=False)
    controller = NetworkController(scene, starts, LAW, np.random.default_rng(0))
    broken = int(np.linalg.norm(starts - np.array(PLACE_M), axis=1).argmin())
    stuck = math.nan
    for step in range(45):
        here = controller.motion.places_m
        readings = signals(event, SENSING, here, float(step), generator)
        if step < 8:
            stuck = readings[broken] if signal is None else signal
        else:
            readings[broken] = stuck
        found = controller.step(readings=readings[None])
        if step == 7:
            assert (found.states == 0).sum() == 3
    assert found.beliefs[0].excluded.any(axis=0).nonzero()[0].tolist() == [broken]
    assert (found.states == NONE).all()
