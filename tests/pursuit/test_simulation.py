"""The loop: closed forms of capture, several pursuers and evaders, unicycles, obstacles."""

from functools import partial
from itertools import combinations

import networkx as nx
import numpy as np
import pytest
import shapely
from pursuit_scene import ExactRecords, pursue
from refusals import refused

from planopt import Obstacle, Workspace
from planopt.problems import Unicycle
from planopt.pursuit import (
    DriveToReport,
    Evader,
    Fleeing,
    Pursuer,
    Record,
    Scene,
    SnapshotRecords,
    SnapshotService,
    Static,
    StraightMotion,
    UnicycleMotion,
    Wandering,
    arena_of,
    first_within,
    fresher,
    simulate_pursuit,
)
from planopt.world import clearance_m


def test_first_within():
    generator = np.random.default_rng(0)
    starts, ends = generator.uniform(-3, 3, (2, 300, 2))
    found = first_within(starts, ends, 1.0)
    shares = np.linspace(0.0, 1.0, 4001)
    places = starts[:, None] + shares[:, None] * (ends - starts)[:, None]
    within = np.linalg.norm(places, axis=-1) <= 1.0
    sampled = np.where(within.any(axis=1), shares[within.argmax(axis=1)], np.inf)
    grazes = np.isinf(sampled) & np.isfinite(found)
    assert grazes.sum() < 3
    np.testing.assert_allclose(found[~grazes], sampled[~grazes], atol=3e-4)
    still = first_within(
        np.array([[0.5, 0.0], [2.0, 0.0]]), np.array([[0.5, 0.0], [2.0, 0.0]]), 1.0
    )
    assert still.tolist() == [0.0, np.inf]


@pytest.mark.parametrize("step_s", [0.01, 0.37, 5.0])
def test_static_evader(step_s):
    """Caught after distance less radius over speed, whatever the step."""
    pursuit = pursue(ExactRecords(), Static(), 0, step_s=step_s)
    assert pursuit.outcome == "captured" and pursuit.captors.tolist() == [0]
    assert pursuit.capture_time_s == pytest.approx(57.0 / 2.0, rel=1e-9)


def test_fleeing_evader():
    """A straight chase closes at the difference of speeds."""
    policy = partial(DriveToReport, retarget=True)
    pursuit = pursue(ExactRecords(), Fleeing(), 0, step_s=0.05, policy=policy)
    assert pursuit.capture_time_s == pytest.approx(57.0, rel=1e-3)
    steps = np.linalg.norm(np.diff(pursuit.evaders_m[0], axis=0), axis=1)
    np.testing.assert_allclose(steps[:-1], 0.05, rtol=1e-9)


def test_rule_r():
    """Sample times of records in use never fall, and of equal ones the more exact is taken."""
    service = SnapshotService(8, 1.0, 0.15, 2, rate_divisor=3, endless=True)
    for policy in (DriveToReport, partial(DriveToReport, retarget=True)):
        pursuit = pursue(SnapshotRecords(service), Wandering(), 1, policy=policy)
        sampled = [use.record.sampled_s for use in pursuit.uses]
        assert len(sampled) > 3 and (np.diff(sampled) >= 0.0).all()
        assert all(use.age_s >= 0.0 for use in pursuit.uses)
        for use in pursuit.uses:
            off = np.linalg.norm(use.record.reported_m - use.sampled_m)
            assert off <= use.record.error_m + 1e-9
    coarse, fine = Record(1.0, np.zeros(2), 2.0), Record(1.0, np.zeros(2), 1.0)
    assert fresher(fine, coarse) and not fresher(coarse, fine) and not fresher(fine, fine)


def test_lost_rounds():
    """Lost rounds make records older on average; if all are lost there are no records."""
    service = SnapshotService(8, 1.0, 0.05, 3, endless=True)
    ages = []
    for probability in (0.0, 0.5):
        lost = np.random.default_rng(0).random((9, 64)) < probability
        runs = [pursue(SnapshotRecords(service, lost), Fleeing(), seed) for seed in range(5)]
        assert all(run.outcome == "captured" for run in runs)
        ages.append(np.mean([use.age_s / use.distance_m for run in runs for use in run.uses]))
    assert ages[1] > 1.1 * ages[0]
    nothing = SnapshotRecords(service, np.ones((9, 1), dtype=bool))
    blind = pursue(nothing, Static(), 0, max_steps=20)
    assert blind.outcome == "step_limit" and blind.uses == ()


def many(pursuers, evaders, behaviour, **options):
    return simulate_pursuit(
        Scene(
            tuple(
                Pursuer(np.array(place), StraightMotion(2.0), partial(DriveToReport, retarget=True))
                for place in pursuers
            ),
            tuple(Evader(np.array(place), 1.0, behaviour) for place in evaders),
            ExactRecords(),
            1.0,
            0.1,
            5000,
            **options,
        ),
        np.random.default_rng(0),
    )


def test_pairs_are_least_apart_together():
    """The nearest evader of one pursuer goes to the other if that is less for both together."""
    pursuit = many([[0.0, 0.0], [9.0, 0.0]], [[8.0, 0.0], [-30.0, 0.0]], Static())
    assert pursuit.chased[:, 0].tolist() == [1, 0]
    assert pursuit.captors.tolist() == [1, 0]
    np.testing.assert_allclose(pursuit.capture_s, [0.0, 14.5], atol=1e-9)


def test_more_evaders_than_pursuers():
    """One pursuer catches three, one after the other; who is caught stays and is left alone."""
    pursuit = many([[0.0, 0.0]], [[20.0, 0.0], [-50.0, 10.0], [25.0, 5.0]], Fleeing())
    assert pursuit.outcome == "captured"
    assert len(set(pursuit.capture_s.tolist())) == 3
    for evader, caught_s in enumerate(pursuit.capture_s):
        later = pursuit.times_s >= caught_s
        assert (np.ptp(pursuit.evaders_m[evader][later], axis=0) == 0.0).all()
        begun = pursuit.times_s[:-1] >= caught_s
        assert not (pursuit.chased[0][begun] == evader).any()


def test_more_pursuers_than_evaders():
    """All of them go after the one, also from both sides."""
    pursuit = many([[0.0, 0.0], [40.0, 0.0], [10.0, 30.0]], [[15.0, 0.0]], Fleeing())
    assert (pursuit.chased == 0).all()
    assert pursuit.capture_time_s < 14.0
    assert pursuit.capture_time_s < many([[0.0, 0.0]], [[15.0, 0.0]], Fleeing()).capture_time_s


UNICYCLE = UnicycleMotion(Unicycle(2.0, 0.8))


def test_unicycle_arrives_in_time():
    """Any point is reached after half a turn and a straight line, in steps of any length."""
    generator = np.random.default_rng(3)
    states = np.column_stack([generator.uniform(-5, 5, (200, 2)), generator.uniform(-9, 9, 200)])
    aims = generator.uniform(-15, 15, (200, 2))
    away = np.linalg.norm(aims - states[:, :2], axis=1)
    limit_s = away / 2.0 + UNICYCLE.turning_s
    for step_s in (0.05, 0.7):
        here, late = states, np.zeros(200, dtype=int)
        for _ in range(int(limit_s.max() / step_s) + 2):
            late += np.linalg.norm(here[:, :2] - aims, axis=1) > 1e-6
            here = UNICYCLE.towards(here, aims, step_s)
        assert np.linalg.norm(here[:, :2] - aims, axis=1).max() < 1e-6
        assert (late * step_s <= limit_s + step_s).all()
    np.testing.assert_allclose(UNICYCLE.towards(here, aims, 1.0)[:, :2], aims, atol=1e-6)


ROOM = arena_of(
    Workspace(
        (0.0, 0.0, 60.0, 40.0),
        (
            Obstacle("wall", shapely.box(28, 0, 32, 30)),
            Obstacle("block", shapely.box(8, 10, 16, 18)),
        ),
    ),
    0.5,
)


def room(behaviour, evader_m=(45.0, 8.0), **options):
    """A pursuer left of the wall, an evader right of it."""
    scene = Scene(
        (
            Pursuer(
                np.array([5.0, 5.0]), StraightMotion(2.0), partial(DriveToReport, retarget=True)
            ),
        ),
        (Evader(np.array(evader_m), 1.0, behaviour),),
        ExactRecords(),
        1.0,
        0.4,
        2000,
        ROOM,
    )
    return simulate_pursuit(scene, np.random.default_rng(0))


def test_geodesic_pursuit():
    """The pursuer takes the shortest path round the wall, and keeps its clearance."""
    pursuit = room(Static())
    assert pursuit.outcome == "captured"
    driven = np.linalg.norm(np.diff(pursuit.pursuers[0], axis=0), axis=1).sum()
    # From corner to corner of the obstacles themselves it is a little shorter.
    corners = [(5, 5), (45, 8), (28, 30), (32, 30)]
    corners += [(x, y) for x in (8, 16) for y in (10, 18)]
    graph = nx.Graph()
    inside = shapely.union_all(shapely.buffer(ROOM.obstacles.polygons, -1e-6))
    for first, second in combinations(corners, 2):
        line = shapely.LineString([first, second])
        if not line.crosses(inside):
            graph.add_edge(first, second, weight=line.length)
    shortest = nx.shortest_path_length(graph, (5, 5), (45, 8), weight="weight")
    assert shortest < driven + 1.0 < shortest + 2.0
    assert clearance_m(ROOM.obstacles, pursuit.pursuers[0]).min() >= 0.5 - 1e-9


def test_fleeing_round_obstacles():
    """An evader flees by the length of the pursuer's path, keeps its clearance, and is caught."""
    pursuit = room(Fleeing(), evader_m=(35.0, 5.0))
    assert pursuit.outcome == "captured"
    assert clearance_m(ROOM.obstacles, pursuit.evaders_m[0]).min() >= 0.499
    assert clearance_m(ROOM.obstacles, pursuit.pursuers[0]).min() >= 0.5 - 1e-9
    # By the air line it would run away from the wall at once, by the path it has time.
    assert pursuit.capture_time_s > room(Static(), evader_m=(35.0, 5.0)).capture_time_s


def test_report_inside_an_obstacle():
    found = ROOM.free_m(np.array([29.0, 15.0]))
    assert clearance_m(ROOM.obstacles, found[None])[0] == pytest.approx(0.5, rel=0.12)
    assert found[0] < 28.0 and found[1] == pytest.approx(15.0)
    np.testing.assert_array_equal(ROOM.free_m(np.array([-3.0, 5.0])), [0.0, 5.0])


def test_no_path():
    closed = arena_of(
        Workspace((0, 0, 20, 10), (Obstacle("wall", shapely.box(9, -1, 11, 11)),)), 0.5
    )
    with refused():
        closed.route_m(np.array([2.0, 2.0]), np.array([15.0, 5.0]))
