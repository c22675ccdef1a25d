"""Event sensors, estimates and rings against closed forms, differences and drawn noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from planopt.coverage.events import (
    cramer_rao_m2,
    fisher_information,
    packed_places,
    ring_angles,
    ring_places,
)
from planopt.coverage.localisation import (
    Drift,
    EventSensor,
    Readings,
    best_distance_m,
    diffusion_sensor,
    locate_events,
    measure,
    no_readings,
    pooled,
    sensitivity,
    single_readings,
)
from planopt.coverage.region import ConvexRegion, convex_region
from planopt.errors import InputError

FIELD = convex_region(np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 16.0], [0.0, 16.0]]))
EVENT = np.array([7.3, 9.2])
SENSOR = diffusion_sensor(0.05, 1.0)


def exponential_sensor(noise_std: float, strength: float, scale_m: float) -> EventSensor:
    """A sensor of another kind: the signal falls exponentially from half the scale on."""

    def profile(d: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-0.5 * (d / scale_m) ** 2)

    def slope(d: NDArray[np.float64]) -> NDArray[np.float64]:
        return -d / scale_m**2 * np.exp(-0.5 * (d / scale_m) ** 2)

    return EventSensor(noise_std, strength, profile, slope, 20.0 * scale_m)


def drawn(sensor: EventSensor, places: NDArray[np.float64], repeats: int, seed: int) -> Readings:
    """Means of repeated measurements of the event."""
    noise = np.random.default_rng(seed).standard_normal(len(places)) / math.sqrt(repeats)
    exact = sensor.signal(np.linalg.norm(places - EVENT, axis=1))
    return Readings(places, exact + sensor.noise_std * noise, np.full(len(places), float(repeats)))


def test_best_distance() -> None:
    """The diffusing source is steepest at 1 / sqrt(3) of its scale, the bell at its deviation."""
    assert best_distance_m(SENSOR) == pytest.approx(1.0 / math.sqrt(3.0), rel=1e-6)
    assert sensitivity(SENSOR, best_distance_m(SENSOR)) == pytest.approx(9.0 / (8.0 * math.sqrt(3)))
    wide = diffusion_sensor(0.1, 5.0, scale_m=7.0)
    assert best_distance_m(wide) == pytest.approx(7.0 / math.sqrt(3.0), rel=1e-6)
    tiny = diffusion_sensor(0.1, 5.0, scale_m=0.01, reach_m=1000.0)
    assert best_distance_m(tiny) == pytest.approx(0.01 / math.sqrt(3.0), rel=1e-4)
    assert best_distance_m(exponential_sensor(0.1, 2.0, 3.0)) == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize("sensor", [SENSOR, exponential_sensor(0.2, 3.0, 4.0)])
def test_slopes_are_derivatives(sensor: EventSensor) -> None:
    """The gain is the derivative of the signal by distance."""
    at, step = np.linspace(0.01, 10.0, 40), 1e-6
    difference = (sensor.signal(at + step) - sensor.signal(at - step)) / (2.0 * step)
    assert sensor.gain(at) == pytest.approx(difference, abs=1e-7)


def test_information_by_differences() -> None:
    """The information is that of the log-likelihood's expected curvature."""
    places = np.random.default_rng(0).random((6, 2)) * 4.0 + EVENT - 2.0
    step, jacobian = 1e-6, np.zeros((6, 2))
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        far, near = (
            SENSOR.signal(np.linalg.norm(places - EVENT - sign * shift, axis=1))
            for sign in (1.0, -1.0)
        )
        jacobian[:, axis] = (far - near) / (2.0 * step)
    counts = np.arange(1.0, 7.0)
    wanted = jacobian.T @ (counts[:, None] * jacobian) / SENSOR.noise_std**2
    assert fisher_information(SENSOR, places, EVENT, counts) == pytest.approx(wanted, rel=1e-6)


def test_the_event_itself_tells_nothing() -> None:
    """Agents that drive to the event learn a bounded amount on the way, and nothing there."""
    there = np.repeat(EVENT[None], 5, axis=0)
    assert (fisher_information(SENSOR, there, EVENT) == 0.0).all()
    assert cramer_rao_m2(fisher_information(SENSOR, there, EVENT)) == math.inf
    # The law p' = p + k dt (s - p) from several sides, and twice as many steps of it.
    starts = EVENT + 4.0 * np.stack((np.cos(np.arange(3.0)), np.sin(np.arange(3.0))), axis=1)
    ways = [EVENT + (starts - EVENT) * 0.8**k for k in range(400)]
    short = fisher_information(SENSOR, np.concatenate(ways[:200]), EVENT)
    long = fisher_information(SENSOR, np.concatenate(ways), EVENT)
    assert long == pytest.approx(short, rel=1e-9)
    ring = ring_places(starts, EVENT, best_distance_m(SENSOR))
    one = fisher_information(SENSOR, ring, EVENT)
    assert np.trace(one) * 200 > 20.0 * np.trace(short)


@pytest.mark.parametrize("agents", [2, 3, 5, 8])
def test_rings_are_best(agents: int) -> None:
    """The ring's information is P g^2 / 2 sigma^2 each way; no turned or moved ring has more."""
    radius = best_distance_m(SENSOR)
    start = EVENT + np.random.default_rng(agents).standard_normal((agents, 2))
    ring = ring_places(start, EVENT, radius)
    slope = sensitivity(SENSOR, radius)
    wanted = 0.5 * agents * slope**2 / SENSOR.noise_std**2 * np.eye(2)
    assert fisher_information(SENSOR, ring, EVENT) == pytest.approx(wanted, abs=1e-6)
    best = cramer_rao_m2(wanted)
    generator = np.random.default_rng(1)
    for _ in range(200):
        other = EVENT + generator.uniform(-2.0, 2.0, (agents, 2))
        assert cramer_rao_m2(fisher_information(SENSOR, other, EVENT)) >= best * (1.0 - 1e-9)
    with pytest.raises(InputError):
        ring_angles(0)


def test_ring_keeps_the_order() -> None:
    """Agents keep their order around the event, and turn by the least sum of squares."""
    for agents in (1, 2, 3, 7):
        generator = np.random.default_rng(agents)
        for _ in range(6):
            start = generator.standard_normal((agents, 2))
            ring = ring_places(start, np.zeros(2), 2.0)
            assert np.hypot(*ring.T) == pytest.approx(2.0)
            before, after = (np.arctan2(p[:, 1], p[:, 0]) for p in (start, ring))
            off = (after - before + np.pi) % (2.0 * np.pi) - np.pi
            slots = ring_angles(agents)
            least = math.inf
            for shift in np.linspace(0.0, 2.0 * np.pi, 241):
                # Every way of putting agents, in their order, on a turned ring.
                for first in range(agents):
                    at = np.sort((slots + shift) % (2.0 * np.pi) - np.pi)
                    gap = np.roll(at, first) - np.sort(before)
                    gap = (gap + np.pi) % (2.0 * np.pi) - np.pi
                    least = min(least, float((gap**2).sum()))
            assert (off**2).sum() <= least + 0.05 * agents


def monte_carlo(sensor: EventSensor, places: NDArray[np.float64], repeats: int, runs: int) -> float:
    """Mean squared distance error over drawn noise."""
    errors = np.zeros(runs)
    for run in range(runs):
        found = locate_events(sensor, drawn(sensor, places, repeats, run), FIELD)
        # Two places explain two distances: the other one is a rival.
        near = np.concatenate((found.positions_m, found.rivals_m))
        errors[run] = ((near - EVENT) ** 2).sum(axis=1).min()
    return float(errors.mean())


@pytest.mark.parametrize("agents", [2, 3, 5])
def test_ring_meets_the_cramer_rao_bound(agents: int) -> None:
    """The mean squared error on the ring is within 10 % of the bound, 600 runs each."""
    ring = ring_places(
        FIELD.corners_m[[0, 1, 2, 3, 0]][:agents] + 0.1, EVENT, best_distance_m(SENSOR)
    )
    bound = cramer_rao_m2(fisher_information(SENSOR, ring, EVENT, np.full(agents, 60.0)))
    assert bound == pytest.approx(4.0 * 0.05**2 / (60.0 * agents * 9.0**2 / 64.0 / 3.0))
    assert monte_carlo(SENSOR, ring, 60, 600) == pytest.approx(bound, rel=0.1)


def test_bodies_that_crowd_get_places_of_their_own() -> None:
    """Places are apart by more than two radii, near the event, and matched at least total."""
    rng, event = np.random.default_rng(4), np.array([20.0, 30.0])
    # Radii of the least circles that hold so many discs of radius 1 (Graham 1968).
    for count, circle in ((1, 1.0), (2, 2.0), (3, 2.1547), (7, 3.0), (12, 4.0296)):
        agents = event + 9.0 * rng.normal(size=(count, 2))
        places = packed_places(agents, event, 0.5)
        gaps = np.linalg.norm(places[:, None] - places, axis=2) + 99.0 * np.eye(count)
        assert gaps.min() > 1.0
        away = np.linalg.norm(places - event, axis=1).max()
        assert (circle - 1.0) * 0.5 <= away + 1e-12 <= 1.06 * (circle - 1.0) * 0.5 + 1e-9
        total = ((agents - places) ** 2).sum()
        for _ in range(50):
            assert total <= ((agents - rng.permutation(places)) ** 2).sum() + 1e-9
        moved = packed_places(agents + (5.0, -3.0), event + (5.0, -3.0), 0.5)
        np.testing.assert_allclose(moved, places + (5.0, -3.0))


def test_covariance_holds_the_truth() -> None:
    """95 % ellipses hold the event 95 times in 100, for known and unknown strength."""
    generator = np.random.default_rng(2)
    places = EVENT + generator.uniform(-2.0, 2.0, (12, 2))
    for known in (True, False):
        inside = 0
        for run in range(250):
            found = locate_events(
                SENSOR, drawn(SENSOR, places, 9, run), FIELD, strength_known=known
            )
            off = found.positions_m[0] - EVENT
            inside += float(off @ np.linalg.solve(found.covariance_m2, off)) < 5.991
        assert inside / 250 == pytest.approx(0.95, abs=0.04)


def test_against_scipy() -> None:
    """The estimate is the least-squares solution of SciPy from the truth."""
    sensor = exponential_sensor(0.02, 3.0, 4.0)
    places = np.random.default_rng(3).random((30, 2)) * np.array([20.0, 16.0])
    readings = drawn(sensor, places, 1, 3)
    found = locate_events(sensor, readings, FIELD)

    def residuals(s: NDArray[np.float64]) -> NDArray[np.float64]:
        return (readings.signal - sensor.signal(np.linalg.norm(places - s, axis=1))) / 0.02

    wanted = least_squares(residuals, EVENT, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.positions_m[0] == pytest.approx(wanted.x, abs=1e-7)
    assert found.misfit == pytest.approx(2.0 * wanted.cost)
    jacobian = wanted.jac.T @ wanted.jac
    assert found.covariance_m2 == pytest.approx(np.linalg.inv(jacobian), rel=1e-4)
    assert found.is_determined


def test_moving_event_against_scipy() -> None:
    """Place and velocity agree with another solver; the covariance is of both, and the prior's."""
    generator, sensor = np.random.default_rng(6), diffusion_sensor(0.3, 50.0, 3.0)
    place, velocity = np.array([5.0, 5.5]), np.array([0.3, -0.2])
    places, ages = generator.uniform(0.0, 16.0, (40, 2)), np.repeat(np.arange(8.0), 5)
    away = np.linalg.norm(place - ages[:, None] * velocity - places, axis=1)
    signal = sensor.signal(away) + 0.3 * generator.standard_normal(40)

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        away = np.linalg.norm(x[:2] - ages[:, None] * x[2:] - places, axis=1)
        return np.concatenate(((signal - sensor.signal(away)) / 0.3, x[2:] / 0.7))

    other = least_squares(residuals, [*place, *velocity], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    readings = single_readings(places, signal)
    found = locate_events(sensor, readings, FIELD, drift=Drift(ages, 0.7, np.zeros(2)))
    assert np.allclose(found.positions_m[0], other.x[:2], atol=1e-5)
    assert np.allclose(found.velocity_m_s, other.x[2:], atol=1e-5)
    inverse = np.linalg.inv(other.jac.T @ other.jac)[:2, :2]
    assert np.allclose(found.covariance_m2, inverse, rtol=1e-3)
    # Readings of one moment tell nothing of the velocity.
    now = locate_events(sensor, readings, FIELD, drift=Drift(0.0 * ages, 0.7, velocity))
    still = locate_events(sensor, readings, FIELD)
    assert np.allclose(now.velocity_m_s, 0.0, atol=1e-6)
    assert np.allclose(now.positions_m, still.positions_m, atol=1e-5)
    assert np.allclose(now.covariance_m2, still.covariance_m2, rtol=1e-4)
    with pytest.raises(InputError, match="2 events that move"):
        locate_events(sensor, readings, FIELD, 2, drift=Drift(ages, 0.7, np.zeros(2)))


def test_more_measurements_come_closer() -> None:
    """Estimates are consistent: the error falls as the root of the number of measurements."""
    generator = np.random.default_rng(4)
    places = EVENT + generator.uniform(-3.0, 3.0, (8, 2))
    errors = [monte_carlo(SENSOR, places, repeats, 100) for repeats in (20, 80, 320)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.35)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.35)


def test_one_straight_path_leaves_the_mirror_image() -> None:
    """A single path has two explanations; a neighbour's readings off it leave one."""
    path = np.stack((np.linspace(2.0, 12.0, 60), np.full(60, 8.2)), axis=1)
    alone = drawn(SENSOR, path, 4, 5)
    found = locate_events(SENSOR, alone, FIELD)
    both = np.sort(np.concatenate((found.positions_m, found.rivals_m))[:, 1])
    assert both == pytest.approx([7.2, 9.2], abs=0.1)
    assert not found.is_determined
    helped = pooled([alone, drawn(SENSOR, np.array([[7.0, 9.9], [9.0, 10.0]]), 4, 6)])
    found = locate_events(SENSOR, helped, FIELD)
    assert not len(found.rivals_m)
    assert found.positions_m[0] == pytest.approx(EVENT, abs=0.1)


def test_open_directions_are_said() -> None:
    """One distance leaves a direction open, and so do readings at the event itself."""
    found = locate_events(SENSOR, drawn(SENSOR, EVENT[None] + 0.5, 1000, 7), FIELD)
    assert not np.isfinite(np.diag(found.covariance_m2)).any()
    assert not found.is_determined
    exact = Readings(EVENT[None], np.array([1.0]), np.array([1e6]))
    assert not locate_events(SENSOR, exact, FIELD).is_determined


def test_several_events_in_one_signal() -> None:
    """Three events of unknown strengths, of which two are near to each other."""
    events = np.array([[3.0, 4.0], [5.5, 4.5], [15.0, 11.0]])
    strengths = np.array([1.0, 2.0, 0.7])
    generator = np.random.default_rng(8)
    places = generator.random((400, 2)) * np.array([20.0, 16.0])
    distance = np.linalg.norm(places[:, None] - events, axis=2)
    signal = (strengths / (distance**2 + 1.0)).sum(axis=1)
    sensor = diffusion_sensor(0.01, 1.0)
    readings = single_readings(places, signal + 0.01 * generator.standard_normal(400))
    found = locate_events(sensor, readings, FIELD, 3, strength_known=False)
    order = np.argsort(found.positions_m[:, 0])
    assert found.positions_m[order] == pytest.approx(events, abs=0.1)
    assert found.strengths[order] == pytest.approx(strengths, abs=0.1)
    assert found.covariance_m2.shape == (6, 6)
    assert found.misfit == pytest.approx(391.0, rel=0.2)
    off = (found.positions_m[order] - events).ravel()
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    covariance = found.covariance_m2[np.ix_(rows, rows)]
    assert off @ np.linalg.solve(covariance, off) < 22.5


def test_estimates_stay_in_the_region() -> None:
    """Readings that rise toward a border put the event on it."""
    places = np.array([[18.0, 2.0], [19.0, 8.0], [18.5, 14.0]])
    beyond = np.array([21.0, 8.0])
    signal = SENSOR.signal(np.linalg.norm(places - beyond, axis=1))
    found = locate_events(SENSOR, Readings(places, signal, np.full(3, 100.0)), FIELD)
    assert FIELD.contains(found.positions_m).all()


def test_pooling_keeps_what_repeats_tell() -> None:
    """Repeated measurements, one by one or as means, give the same estimate."""
    generator = np.random.default_rng(9)
    places = np.repeat(EVENT + generator.uniform(-2.0, 2.0, (5, 2)), 20, axis=0)
    signal = measure(SENSOR, places, EVENT, generator)
    single = single_readings(places, signal)
    joined = pooled([single_readings(places[k::7], signal[k::7]) for k in range(7)])
    assert len(joined.signal) == 5 and joined.counts.tolist() == [20.0] * 5
    one, other = (locate_events(SENSOR, readings, FIELD) for readings in (single, joined))
    assert one.positions_m == pytest.approx(other.positions_m, abs=1e-7)
    assert one.covariance_m2 == pytest.approx(other.covariance_m2, rel=1e-6)
    assert not len(pooled([]).signal)


def test_bad_input(square: ConvexRegion) -> None:
    """Sensors that rise, missing readings, numbers out of range."""
    flat = np.ones_like
    attempts = [
        lambda: diffusion_sensor(0.0, 1.0),
        lambda: diffusion_sensor(0.1, -1.0),
        lambda: diffusion_sensor(0.1, 1.0, scale_m=0.0),
        lambda: EventSensor(0.1, 1.0, lambda d: d, flat, 10.0),
        lambda: EventSensor(0.1, 1.0, lambda d: np.full_like(d, np.nan), flat, 10.0),
        lambda: locate_events(SENSOR, no_readings(), square),
        lambda: locate_events(SENSOR, drawn(SENSOR, EVENT[None], 1, 0), square, 0),
        lambda: Readings(np.zeros((2, 2)), np.zeros(3), np.ones(2)),
        lambda: single_readings(np.zeros((1, 2)), np.array([np.nan])),
        lambda: Readings(np.zeros((1, 2)), np.zeros(1), np.zeros(1)),
        lambda: ring_places(np.zeros((2, 2)), EVENT, 0.0),
        lambda: ring_places(np.zeros((0, 2)), EVENT, 1.0),
    ]
    for number, attempt in enumerate(attempts):
        with pytest.raises(InputError):
            attempt()
            pytest.fail(f"attempt {number} went through")
