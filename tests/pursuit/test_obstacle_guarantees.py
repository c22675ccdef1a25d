"""Guarantees among obstacles: detours, captures within bounds, and a wall that breaks bounds."""

import numpy as np
import pytest
import shapely
from refusals import refused

from planopt import Obstacle, Workspace
from planopt.pursuit import (
    EVADER_SHARE,
    Chase,
    Distances,
    DriveToReport,
    Evader,
    Fleeing,
    Pursuer,
    Scene,
    ServiceBounds,
    SnapshotRecords,
    SnapshotService,
    Static,
    StraightMotion,
    Theorem,
    Wandering,
    Zigzag,
    arena_of,
    capture_guarantees,
    guarantees_among_obstacles,
    simulate_pursuit,
)


def arena(*polygons, clearance_m=1e-6, bounds_m=(0.0, 0.0, 60.0, 60.0)):
    obstacles = tuple(Obstacle(f"o{number}", each) for number, each in enumerate(polygons))
    return arena_of(Workspace(bounds_m, obstacles), clearance_m)


ROUND = shapely.Point(30, 30).buffer(5, quad_segs=6)
COURT = shapely.Polygon([(20, 20), (40, 20), (40, 40), (36, 40), (36, 24), (20, 24)])


@pytest.mark.parametrize(
    ("polygons", "factor"),
    [
        # Between middles of opposite sides: half the way round over the width.
        ([shapely.box(20, 20, 30, 30)], 2.0),
        ([shapely.box(20, 20, 50, 24)], 34 / 4),
        ([shapely.box(20, 20, 50, 24), shapely.box(5, 40, 8, 50)], 34 / 4),
        # At a corner of 30 degrees: 1 / sin 15 degrees.
        ([shapely.Polygon([(20, 20), (44, 20 - 24 / 3.7320508), (44, 20 + 24 / 3.7320508)])], None),
        ([ROUND], np.pi / 2),
        # Attached to a wall of the room: all the way round.
        ([shapely.box(28, 0, 32, 30)], 64 / 4),
    ],
)
def test_detour_of_simple_shapes(polygons, factor):
    found = arena(*polygons).detour
    expected = 1.0 / np.sin(np.pi / 12) if factor is None else factor
    assert found == pytest.approx(expected, rel=8e-3)


@pytest.mark.parametrize("polygons", [[COURT], [shapely.box(20, 20, 26, 30), ROUND]])
def test_no_detour_is_longer(polygons):
    """Shortest paths between free places are at most the factor times the straight line."""
    free = arena(*polygons, clearance_m=0.5)
    generator = np.random.default_rng(0)
    places = generator.uniform(15.0, 45.0, (90, 2))
    places = places[[free.is_free(place) for place in places]]
    shares = []
    for place in places[:15]:
        straight_m = np.linalg.norm(places - place, axis=1)
        near = straight_m > 0.0
        shares.append((free.distances_m(place, places[near]) / straight_m[near]).max())
    assert 1.3 < max(shares) <= free.detour + 1e-9


def test_too_many_corners():
    """Paths would lead through obstacles: refused, with the number."""
    posts = [shapely.box(x, y, x + 1, y + 1) for x in range(2, 58, 4) for y in range(2, 58, 4)]
    with refused():
        arena(*posts)


PILLARS = arena(
    shapely.box(20, 20, 28, 28),
    shapely.box(40, 22, 48, 32),
    shapely.box(24, 42, 34, 50),
    clearance_m=0.4,
    bounds_m=(0.0, 0.0, 64.0, 64.0),
)
SERVICE = SnapshotService(8, 0.25, 0.004, 7)
STEP_S = 0.02


@pytest.mark.parametrize("behaviour", [Wandering(), Fleeing(), Zigzag(period_s=3.0), Static()])
def test_capture_among_obstacles(behaviour):
    """With paths or straight distances: stages within bounds, capture within the time."""
    chase = Chase(1.0, 4.0, (1 + PILLARS.corners) * STEP_S)
    found = guarantees_among_obstacles(chase, SERVICE.bounds, PILLARS.detour)
    holding = [
        each
        for theorems in found.values()
        for theorem, each in theorems.items()
        if each.holds and theorem in (Theorem.ANY_INSTANT, Theorem.SNAPSHOTS)
    ]
    assert {each.distances for each in holding} == set(Distances) and len(holding) == 4
    radius_m = 1.02 * max(each.floor_m for each in holding)
    for seed in range(1 if behaviour == Fleeing() else 3):
        generator = np.random.default_rng(seed)
        scene = Scene(
            (Pursuer(start(generator), StraightMotion(4.0), DriveToReport),),
            (Evader(start(generator), 1.0, behaviour),),
            SnapshotRecords(SERVICE),
            radius_m,
            STEP_S,
            8000,
            PILLARS,
        )
        pursuit = simulate_pursuit(scene, generator)
        assert pursuit.outcome == "captured"
        for each in holding:
            first_m = pursuit.away_m(pursuit.uses[0], each.distances)
            assert pursuit.capture_time_s <= each.capture_time_s(first_m, radius_m)
            bounds = pursuit.bounds_m(0, 0, each.distances)
            assert (bounds[1:] <= each.next_bound_m(bounds[:-1]) * (1 + 1e-9)).all()


def start(generator):
    while True:
        place = generator.uniform(2.0, 62.0, 2)
        if PILLARS.is_free(place, EVADER_SHARE):
            return place


def test_a_wall_breaks_the_bounds_of_open_space():
    """A report across a thin wall sends the pursuer round it, though a < 1 and lengths are paths'.

    The evader stands just north of the wall, and the centre of its sub-cell is south of it.
    """
    wall = arena(shapely.box(10, 29.6, 410, 29.8), clearance_m=0.1, bounds_m=(0, 0, 420, 64))
    service = SnapshotService(9, 1.0, 0.01, 3)
    chase = Chase(0.5, 3.0, (1 + wall.corners) * 0.05)
    open_space = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS]
    radius_m = 4.0
    assert open_space.holds and open_space.captures(radius_m).holds
    scene = Scene(
        (Pursuer(np.array([150.0, 30.5]), StraightMotion(3.0), DriveToReport),),
        (Evader(np.array([210.0, 30.2]), 0.5, Static()),),
        SnapshotRecords(service),
        radius_m,
        0.05,
        8000,
        wall,
    )
    pursuit = simulate_pursuit(scene, np.random.default_rng(0))
    first = pursuit.uses[0]
    assert first.record.reported_m[1] < 29.6 < first.sampled_m[1]
    first_m = pursuit.away_m(first, Distances.PATHS)
    assert first_m < 61.0
    assert pursuit.capture_time_s > 2.0 * open_space.capture_time_s(first_m, radius_m)
    among = guarantees_among_obstacles(chase, service.bounds, wall.detour)
    assert not any(each.holds for theorems in among.values() for each in theorems.values())
    assert Distances.STRAIGHT not in among


def test_factors():
    """Without detours only a report inside an obstacle widens errors; none is below 1."""
    chase, bounds = Chase(1.0, 3.0), ServiceBounds(0.2, 0.05, 0.1, 0.3)
    wide = capture_guarantees(chase, ServiceBounds(0.2, 0.1, 0.1, 0.6))
    for theorems in guarantees_among_obstacles(chase, bounds, 1.0).values():
        for theorem, each in theorems.items():
            assert (each.ratio, each.floor_m) == (wide[theorem].ratio, wide[theorem].floor_m)
