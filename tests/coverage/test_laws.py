"""The control laws against closed forms, the cost's gradient, and paths round obstacles."""

import numpy as np
import pytest
import shapely
from scattered import scattered

from planopt.coverage import (
    ConvexGround,
    ConvexRegion,
    Gains,
    GeodesicGround,
    coverage,
    coverage_aims,
    geodesic_ground,
    law_moves,
    voronoi_cells,
)

OUTLINE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]])
WALLS = (shapely.box(30, 0, 34, 45), shapely.box(60, 20, 64, 60))


@pytest.fixture(scope="module")
def walled() -> GeodesicGround:
    """A corridor with two walls, 1 m of which agents keep away from."""
    return geodesic_ground(OUTLINE, WALLS, 4.0, clearance_m=1.0)


def test_velocity_is_the_gradient_over_twice_the_mass(hexagon: ConvexRegion) -> None:
    """Covering agents go down the cost's gradient, -k dH/dp / (2 M)."""
    agents = scattered(hexagon, 12, np.random.default_rng(0))
    nobody = np.zeros(12, dtype=np.bool_)
    aims = coverage_aims(ConvexGround(hexagon), agents, nobody)
    found = coverage(voronoi_cells(hexagon, agents))
    gradient = 2.0 * found.mass[:, None] * (agents - found.targets_m)
    velocity = (law_moves(agents, aims.targets_m, nobody, Gains(1.0, 0.3), 0.5) - agents) / 0.5
    assert velocity == pytest.approx(-0.3 * gradient / (2.0 * found.mass[:, None]))


def test_partitions_differ_by_the_responding_cells(square: ConvexRegion) -> None:
    """Without responding agents the covering ones divide the whole region."""
    agents = scattered(square, 9, np.random.default_rng(2))
    responds = np.arange(9) < 3
    alone = coverage_aims(ConvexGround(square), agents, responds, "coverage_only")
    wanted = coverage(voronoi_cells(square, agents[3:]))
    assert alone.cost == pytest.approx(wanted.cost)
    assert alone.targets_m[3:] == pytest.approx(wanted.targets_m)
    together = coverage_aims(ConvexGround(square), agents, responds)
    assert together.cost < alone.cost
    everybody = coverage_aims(ConvexGround(square), agents, agents[:, 0] >= 0.0, "coverage_only")
    assert everybody.cost == pytest.approx(together.cost)


def test_agents_at_one_place_leave_each_other(square: ConvexRegion, walled: GeodesicGround) -> None:
    """Six agents that an event has let go spread as far as six that start apart."""
    nobody = np.zeros(6, dtype=np.bool_)
    for ground, place in (
        (ConvexGround(square), (30.0, 40.0)),
        (ConvexGround(square), (0.0, 0.0)),
        (walled, (45.0, 20.0)),
    ):
        agents = np.tile(np.array(place), (6, 1))
        others = np.array([[10, 10], [22, 50], [45, 20], [50, 55], [80, 20], [90, 50]], dtype=float)
        costs, apart = list[float](), list[float]()
        for _ in range(80):
            for each, found in ((agents, costs), (others, apart)):
                aims = coverage_aims(ground, each, nobody)
                found.append(aims.cost)
                each[:] = law_moves(each, aims.targets_m, nobody, Gains(), 1.0)
        assert (np.diff(costs) <= 1e-6 * costs[0]).all()
        assert costs[-1] < 1.3 * apart[-1]


def test_laws_of_events_and_speed() -> None:
    """A geometric series towards the event, in any dimension; fast moves keep their direction."""
    for dimension in (1, 2, 3):
        start, event = np.full((1, dimension), 8.0), np.full((1, dimension), 3.0)
        place = start
        for _ in range(6):
            place = law_moves(place, event, np.array([True]), Gains(0.5, 1.0), 0.8)
        assert place == pytest.approx(event + 0.6**6 * (start - event), rel=1e-12)
    agents, targets = np.zeros((2, 2)), np.array([[30.0, 40.0], [0.3, 0.4]])
    moved = law_moves(agents, targets, np.array([True, False]), Gains(), 1.0, 2.0)
    assert moved == pytest.approx(np.array([[1.2, 1.6], [0.3, 0.4]]))


def test_agents_drive_round_walls_to_their_event(walled: GeodesicGround) -> None:
    """Every step stays free and shortens the path by its own length, until the event is reached."""
    agents, event = np.array([[5.0, 5.0], [95.0, 50.0]]), np.array([[50.0, 10.0], [50.0, 10.0]])
    responds, gains = np.ones(2, dtype=np.bool_), Gains(0.2, 1.0)
    for _ in range(120):
        before = walled.distances_m(agents, event[:1])[:, 0]
        share = float(gains.shares(responds, 1.0)[0])
        targets = walled.steered(agents, event, share)
        moved = law_moves(agents, targets, responds, gains, 1.0, 3.0)
        assert walled.area.sees(agents, moved).all()
        after = walled.distances_m(moved, event[:1])[:, 0]
        driven = np.linalg.norm(moved - agents, axis=1)
        assert before - after == pytest.approx(driven, abs=1e-6)
        agents = moved
    assert agents == pytest.approx(event, abs=1e-3)


def test_distances_keep_the_clearance(walled: GeodesicGround) -> None:
    """The path round the end of a wall is that round the wall grown by the clearance."""
    agents, places = np.array([[20.0, 10.0]]), np.array([[44.0, 10.0]])
    corner = np.array([[29.0, 46.0], [35.0, 46.0]])
    wanted = np.linalg.norm(np.diff(np.concatenate((agents, corner, places)), axis=0), axis=1).sum()
    assert walled.distances_m(agents, places)[0, 0] == pytest.approx(wanted, rel=1e-6)
    free = geodesic_ground(OUTLINE, WALLS, 9.0).distances_m(agents, places)[0, 0]
    assert free < wanted - 1.0
