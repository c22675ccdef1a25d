"""Event sensors, estimates and rings against closed forms, differences and drawn noise."""

import math
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from planopt.coverage import (
    ConvexGround,
    Drift,
    EventSensor,
    Readings,
    convex_region,
    cramer_rao_m2,
    fisher_information,
    free_ring_places,
    locate_event,
    measure,
    packed_places,
    pooled,
    ring_angles,
    ring_places,
    single_readings,
)

FIELD = convex_region(np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 16.0], [0.0, 16.0]]))
EVENT = np.array([7.3, 9.2])
SENSOR = EventSensor(0.05, 1.0)


def signal_at(
    sensor: EventSensor, places: NDArray[np.float64], event: NDArray[np.float64]
) -> NDArray[np.float64]:
    away = np.linalg.norm(places - event, axis=1) / sensor.scale_m
    return sensor.strength / (away**2 + 1.0)


def drawn(sensor: EventSensor, places: NDArray[np.float64], repeats: int, seed: int) -> Readings:
    noise = np.random.default_rng(seed).standard_normal(len(places)) / math.sqrt(repeats)
    exact = signal_at(sensor, places, EVENT)
    return Readings(places, exact + sensor.noise_std * noise, np.full(len(places), float(repeats)))


def test_slope() -> None:
    """The slope is the profile's derivative, and steepest at the best distance."""
    sensor, at, step = EventSensor(0.1, 5.0, 7.0), np.linspace(0.01, 30.0, 4000), 1e-6
    difference = (sensor.profile(at + step) - sensor.profile(at - step)) / (2.0 * step)
    assert sensor.slope(at) == pytest.approx(difference, abs=1e-7)
    assert at[sensor.slope(at).argmin()] == pytest.approx(sensor.best_distance_m, abs=0.01)


def test_information_by_differences() -> None:
    """That of the log-likelihood's expected curvature, and none at the event itself."""
    places = np.random.default_rng(0).random((6, 2)) * 4.0 + EVENT - 2.0
    step, jacobian = 1e-6, np.zeros((6, 2))
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        far, near = (signal_at(SENSOR, places, EVENT + sign * shift) for sign in (1.0, -1.0))
        jacobian[:, axis] = (far - near) / (2.0 * step)
    counts = np.arange(1.0, 7.0)
    wanted = jacobian.T @ (counts[:, None] * jacobian) / SENSOR.noise_std**2
    assert fisher_information(SENSOR, places, EVENT, counts) == pytest.approx(wanted, rel=1e-6)
    there = fisher_information(SENSOR, np.repeat(EVENT[None], 5, axis=0), EVENT)
    assert (there == 0.0).all() and cramer_rao_m2(there) == math.inf


@pytest.mark.parametrize("agents", [2, 3, 5, 8])
def test_rings_are_best(agents: int) -> None:
    """The ring's information is P g^2 / 2 sigma^2 per axis; no turned or moved ring has more."""
    radius = SENSOR.best_distance_m
    start = EVENT + np.random.default_rng(agents).standard_normal((agents, 2))
    ring = ring_places(start, EVENT, radius)
    slope = float(SENSOR.slope(np.array(radius)))
    wanted = 0.5 * agents * slope**2 / SENSOR.noise_std**2 * np.eye(2)
    assert fisher_information(SENSOR, ring, EVENT) == pytest.approx(wanted, abs=1e-6)
    best = cramer_rao_m2(wanted)
    generator = np.random.default_rng(1)
    for _ in range(200):
        other = EVENT + generator.uniform(-2.0, 2.0, (agents, 2))
        assert cramer_rao_m2(fisher_information(SENSOR, other, EVENT)) >= best * (1.0 - 1e-9)


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


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("event", [(0.3, 0.4), (0.1, 5.0), (5.0, 5.0)])
def test_ring_in_the_free_region(event: tuple[float, float], known: bool) -> None:
    """Three agents stand as well as the best of all free triples, also in a corner."""
    ground = ConvexGround(convex_region(np.array([[0, 0], [10, 0], [10, 10], [0, 10.0]])))
    there, radius = np.array(event), SENSOR.best_distance_m

    def error_m2(bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        units = np.stack((np.cos(bearings), np.sin(bearings)), axis=-1)
        rows = units if known else np.concatenate((units, np.ones((*units.shape[:-1], 1))), axis=-1)
        information = np.swapaxes(rows, -1, -2) @ rows + 1e-9 * np.eye(rows.shape[-1])
        return np.trace(np.linalg.inv(information)[..., :2, :2], axis1=-2, axis2=-1)

    turn = ring_angles(72)
    inside = ground.allows(there + radius * np.stack((np.cos(turn), np.sin(turn)), axis=1))
    best = error_m2(np.array(list(combinations(turn[inside], 3)))).min()
    agents = there + np.random.default_rng(2).uniform(0.0, 1.0, (3, 2))
    ring = free_ring_places(agents, there, radius, ground, known)
    assert ground.allows(ring).all()
    away = ring - there
    assert np.linalg.norm(away, axis=1) == pytest.approx(radius)
    found = error_m2(np.arctan2(away[:, 1], away[:, 0]))
    assert found <= 1.02 * best
    # Projected into a corner, an equal ring is worse.
    if event == (0.3, 0.4) and known:
        near = ground.nearest(ring_places(agents, there, radius))
        bounds = [cramer_rao_m2(fisher_information(SENSOR, at, there)) for at in (ring, near)]
        assert bounds[0] < 0.9 * bounds[1]


def monte_carlo(sensor: EventSensor, places: NDArray[np.float64], repeats: int, runs: int) -> float:
    """Mean squared distance error over drawn noise."""
    errors = np.zeros(runs)
    for run in range(runs):
        found = locate_event(sensor, drawn(sensor, places, repeats, run), FIELD)
        # Two places explain two distances: the other one is a rival.
        near = np.vstack((found.position_m, found.rivals_m))
        errors[run] = ((near - EVENT) ** 2).sum(axis=1).min()
    return float(errors.mean())


@pytest.mark.parametrize("agents", [2, 5])
def test_ring_meets_the_cramer_rao_bound(agents: int) -> None:
    """The mean squared error on the ring is within 10 % of the bound, 600 runs each."""
    ring = ring_places(
        FIELD.corners_m[[0, 1, 2, 3, 0]][:agents] + 0.1, EVENT, SENSOR.best_distance_m
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
        for run in range(120):
            found = locate_event(SENSOR, drawn(SENSOR, places, 9, run), FIELD, strength_known=known)
            off = found.position_m - EVENT
            inside += float(off @ np.linalg.solve(found.covariance_m2, off)) < 5.991
        assert inside / 120 == pytest.approx(0.95, abs=0.04)


def test_against_scipy() -> None:
    """The estimate is the least-squares solution of SciPy from the truth."""
    sensor = EventSensor(0.02, 3.0, 4.0)
    places = np.random.default_rng(3).random((30, 2)) * np.array([20.0, 16.0])
    readings = drawn(sensor, places, 1, 3)
    found = locate_event(sensor, readings, FIELD)

    def residuals(s: NDArray[np.float64]) -> NDArray[np.float64]:
        return (readings.signal - signal_at(sensor, places, s)) / 0.02

    wanted = least_squares(residuals, EVENT, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.position_m == pytest.approx(wanted.x, abs=1e-7)
    assert found.misfit == pytest.approx(2.0 * wanted.cost)
    jacobian = wanted.jac.T @ wanted.jac
    assert found.covariance_m2 == pytest.approx(np.linalg.inv(jacobian), rel=1e-4)
    assert not len(found.rivals_m)


def test_moving_event_against_scipy() -> None:
    """Place and velocity agree with another solver; the covariance is of both, and the prior's."""
    generator, sensor = np.random.default_rng(6), EventSensor(0.3, 50.0, 3.0)
    place, velocity = np.array([5.0, 5.5]), np.array([0.3, -0.2])
    places, ages = generator.uniform(0.0, 16.0, (40, 2)), np.repeat(np.arange(8.0), 5)
    signal = signal_at(sensor, places, place - ages[:, None] * velocity)
    signal += 0.3 * generator.standard_normal(40)

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        expected = signal_at(sensor, places, x[:2] - ages[:, None] * x[2:])
        return np.concatenate(((signal - expected) / 0.3, x[2:] / 0.7))

    other = least_squares(residuals, [*place, *velocity], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    readings = single_readings(places, signal)
    found = locate_event(sensor, readings, FIELD, drift=Drift(ages, 0.7, np.zeros(2)))
    assert np.allclose(found.position_m, other.x[:2], atol=1e-5)
    assert np.allclose(found.velocity_m_s, other.x[2:], atol=1e-5)
    inverse = np.linalg.inv(other.jac.T @ other.jac)[:2, :2]
    assert np.allclose(found.covariance_m2, inverse, rtol=1e-3)
    # Readings of one moment tell nothing of the velocity.
    now = locate_event(sensor, readings, FIELD, drift=Drift(0.0 * ages, 0.7, velocity))
    still = locate_event(sensor, readings, FIELD)
    assert np.allclose(now.velocity_m_s, 0.0, atol=1e-6)
    assert np.allclose(now.position_m, still.position_m, atol=1e-5)
    assert np.allclose(now.covariance_m2, still.covariance_m2, rtol=1e-4)


def test_one_straight_path_leaves_the_mirror_image() -> None:
    """A single path has two explanations; a neighbour's readings off it leave one."""
    path = np.stack((np.linspace(2.0, 12.0, 60), np.full(60, 8.2)), axis=1)
    alone = drawn(SENSOR, path, 4, 5)
    found = locate_event(SENSOR, alone, FIELD)
    both = np.sort(np.vstack((found.position_m, found.rivals_m))[:, 1])
    assert both == pytest.approx([7.2, 9.2], abs=0.1)
    helped = pooled([alone, drawn(SENSOR, np.array([[7.0, 9.9], [9.0, 10.0]]), 4, 6)])
    found = locate_event(SENSOR, helped, FIELD)
    assert not len(found.rivals_m)
    assert found.position_m == pytest.approx(EVENT, abs=0.1)


def test_open_directions_are_said() -> None:
    """One distance leaves a direction open, and so do readings at the event itself."""
    found = locate_event(SENSOR, drawn(SENSOR, EVENT[None] + 0.5, 1000, 7), FIELD)
    assert not np.isfinite(np.diag(found.covariance_m2)).any()
    exact = locate_event(SENSOR, Readings(EVENT[None], np.ones(1), np.array([1e6])), FIELD)
    assert not np.isfinite(exact.covariance_m2).all() or len(exact.rivals_m)


def test_estimates_stay_in_the_region() -> None:
    """Readings that rise toward a border put the event on it."""
    places = np.array([[18.0, 2.0], [19.0, 8.0], [18.5, 14.0]])
    signal = signal_at(SENSOR, places, np.array([21.0, 8.0]))
    found = locate_event(SENSOR, Readings(places, signal, np.full(3, 100.0)), FIELD)
    assert FIELD.contains(found.position_m[None]).all()


def test_pooling_keeps_the_information_of_repeats() -> None:
    """Repeated measurements, one by one or as means, give the same estimate."""
    generator = np.random.default_rng(9)
    places = np.repeat(EVENT + generator.uniform(-2.0, 2.0, (5, 2)), 20, axis=0)
    signal = measure(SENSOR, places, EVENT, generator)
    single = single_readings(places, signal)
    joined = pooled([single_readings(places[k::7], signal[k::7]) for k in range(7)])
    assert len(joined.signal) == 5 and joined.counts.tolist() == [20.0] * 5
    one, other = (locate_event(SENSOR, readings, FIELD) for readings in (single, joined))
    assert one.position_m == pytest.approx(other.position_m, abs=1e-7)
    assert one.covariance_m2 == pytest.approx(other.covariance_m2, rel=1e-6)
