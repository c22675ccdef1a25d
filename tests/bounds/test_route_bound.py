"""Lower bounds on routes hold for every path, and are tight where the optimum is known."""

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest
import shapely

from planopt.bounds.route import RouteBound, RouteProblem, route_bounds
from planopt.channel import ChannelParameters, ChannelPosterior, Measurements, Station, condition

THRESHOLD_DBM = -68.0
WALL = shapely.box(28.0, 0.0, 32.0, 40.0)


def posterior_of(seed: int, station: tuple[float, float] = (10.0, 40.0)) -> ChannelPosterior:
    """A channel with shadowing, from sixty measurements."""
    generator = np.random.default_rng(seed)
    parameters = ChannelParameters(-30.0, 2.5, 6.0, 12.0, 2.0, Station(station, 2.0))
    positions = generator.uniform((0.0, 0.0), (60.0, 50.0), (60, 2))
    power = -30.0 - 25.0 * np.log10(np.hypot(*(positions - station).T) + 2.0)
    power += generator.normal(0.0, 6.0, 60)
    return condition(parameters, Measurements(positions, power))


def scene(seed: int = 0, price: float = 10.0, stations: int = 1) -> RouteProblem:
    """A field with a wall, to be crossed from the left to the right."""
    places = [(10.0, 40.0), (50.0, 8.0)][:stations]
    return RouteProblem(
        bounds_m=(0.0, 0.0, 60.0, 50.0),
        obstacles=[WALL],
        clearance_m=1.0,
        start_m=np.array([5.0, 5.0]),
        goal_m=np.array([55.0, 6.0]),
        goal_radius_m=0.5,
        price=price,
        free_above=2.0,
        posteriors=[posterior_of(seed + k, place) for k, place in enumerate(places)],
        thresholds_dbm=[THRESHOLD_DBM] * stations,
    )


def last_bound(problem: RouteProblem, seconds: float = 0.0) -> RouteBound:
    """The last bound within a time."""
    return list(route_bounds(problem, seconds))[-1]


def path_cost_m(problem: RouteProblem, path_m: np.ndarray) -> float:
    """The cost of a polyline by quadrature every five centimetres."""
    cost = 0.0
    for a, b in pairwise(path_m):
        length = float(np.linalg.norm(b - a))
        share = (np.arange(max(1, int(length / 0.05))) + 0.5) / max(1, int(length / 0.05))
        places = a + share[:, None] * (b - a)
        silent = np.ones(len(places))
        for posterior, threshold in zip(problem.posteriors, problem.thresholds_dbm, strict=True):
            silent *= 1.0 - posterior.connectivity(places, threshold)
        silent[1.0 - silent >= problem.free_above] = 0.0
        cost += length * float((1.0 + problem.price * silent).mean())
    return cost


def random_paths(problem: RouteProblem, count: int, seed: int) -> list[np.ndarray]:
    """Polylines over the wall's free end that keep the clearance."""
    generator = np.random.default_rng(seed)
    blocked = WALL.buffer(problem.clearance_m)
    found: list[np.ndarray] = []
    while len(found) < count:
        inner = generator.uniform((1.0, 1.0), (59.0, 49.0), (3, 2))
        inner = inner[np.argsort(inner[:, 0])]
        over = [[generator.uniform(25.0, 27.0), generator.uniform(41.5, 49.0)]]
        over += [[generator.uniform(33.0, 35.0), generator.uniform(41.5, 49.0)]]
        path = np.vstack([problem.start_m, inner[inner[:, 0] < 25], over])
        path = np.vstack([path, inner[inner[:, 0] > 35], problem.goal_m])
        if not blocked.intersects(shapely.LineString(path)):
            found.append(path)
    return found


@pytest.mark.parametrize("stations", [1, 2])
@pytest.mark.parametrize("free_above", [2.0, 0.8])
def test_no_path_is_cheaper(stations: int, free_above: float) -> None:
    """Two hundred random feasible paths cost at least the bound, in each of three scenes."""
    compared = 0
    for seed in range(3):
        problem = replace(scene(10 * seed, stations=stations), free_above=free_above)
        bound = last_bound(problem).value_m
        assert bound > 0.0
        for path in random_paths(problem, 200, seed):
            assert path_cost_m(problem, path) >= bound
            compared += 1
    print(f"{compared} comparisons")
    assert compared == 600


@pytest.mark.parametrize("goal_m", [(55.0, 6.0), (32.6, 20.0)], ids=["far", "next to the wall"])
def test_without_a_price_the_bound_is_the_shortest_path(goal_m: tuple[float, float]) -> None:
    """Round the wall's end: straight pieces between the corners."""
    problem = replace(scene(price=0.0), clearance_m=0.0, goal_m=np.array(goal_m))
    left, right = np.array([28.0, 40.0]), np.array([32.0, 40.0])
    shortest = np.linalg.norm(left - problem.start_m) + np.linalg.norm(problem.goal_m - right)
    shortest += 4.0 - problem.goal_radius_m
    assert 0.995 <= last_bound(problem, 2.0).value_m / shortest <= 1.0


def test_the_bound_grows_with_time_and_price() -> None:
    """Every later bound is at least the earlier one; a higher price never lowers it."""
    values = [bound.value_m for bound in islice(route_bounds(scene(), 60.0), 3)]
    assert values == sorted(values)
    assert len(values) == 3
    by_price = [last_bound(scene(price=price)).value_m for price in (0.0, 2.0, 10.0)]
    assert by_price == sorted(by_price)


def test_an_open_field_without_outage_is_crossed_straight() -> None:
    """Where connection is certain the bound is the distance to the goal's circle."""
    problem = replace(scene(), obstacles=[], thresholds_dbm=[-300.0])
    distance = np.linalg.norm(problem.goal_m - problem.start_m) - problem.goal_radius_m
    assert last_bound(problem).value_m == pytest.approx(distance, rel=1e-3)
    assert last_bound(problem).value_m <= distance * (1.0 + 1e-9)
