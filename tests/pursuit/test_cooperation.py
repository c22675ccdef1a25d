"""Cooperation of pursuers: the consistent set, times of capture, and teams against their parts."""

from functools import partial

import numpy as np
import pytest

from planopt.pursuit import (
    Arena,
    DriveToReport,
    Evader,
    Fleeing,
    Mate,
    Pursuer,
    PursuerView,
    Quest,
    RecedingHorizon,
    Record,
    Scene,
    SnapshotRecords,
    SnapshotService,
    StraightMotion,
    blocking_aim_m,
    consistent_m,
    simulate_pursuit,
)


def record(x, y, error_m=1.0, sampled_s=0.0):
    return Record(sampled_s, np.array([x, y]), error_m)


def hunt(place_m, speed_m_s, mates=(), radius_m=10.0):
    """The problem and the view of a pursuer of an evader with 2 m/s."""
    quest = Quest(StraightMotion(speed_m_s), 2.0, Arena(), radius_m)
    return quest, PursuerView(0.0, 1.0, np.array(place_m), lambda held: held, mates)


def test_consistent_positions():
    """They are within the range of every record and within the bounds, and spread over both."""
    records = [record(0.0, 0.0, 2.0), record(6.0, 0.0, 1.0, 1.0)]
    centre, places = consistent_m(records, 3.0, 1.5, Arena((-20.0, -1.0, 20.0, 20.0)))
    assert (np.hypot(*places.T) <= 2.0 + 4.5 + 1e-9).all()
    assert (np.hypot(places[:, 0] - 6.0, places[:, 1]) <= 1.0 + 3.0 + 1e-9).all()
    assert (places[:, 1] >= -1.0).all() and 3.0 < centre[0] < 6.0
    alone, _ = consistent_m(records[:1], 3.0, 1.5, Arena())
    assert np.hypot(*alone) < 0.5


def test_alone_the_centre_is_best():
    """In open space nothing beats the report: the set is a disc (docs/theory/pursuit.md)."""
    centre, places = consistent_m([record(100.0, 30.0, 5.0)], 4.0, 2.0, Arena())
    aim = blocking_aim_m(*hunt((0.0, 0.0), 5.0), centre, places, 30.0)
    np.testing.assert_allclose(aim, centre)


def worst_and_mean_s(quest, view, aim, centre, places):
    """The value of an aim, by a dense grid of times instead of roots."""
    speed_m_s = quest.motion.speed_max_m_s
    ahead_s = np.hypot(*(centre - view.place_m)) / speed_m_s
    times_s = np.linspace(0.0, 120.0, 24_001)
    pairs = [(view.place_m, aim, speed_m_s)]
    pairs += [(each.place_m, each.aim_m, each.speed_m_s) for each in view.mates]
    values = []
    for place in places[::6]:
        flights = []
        for turn in np.arange(24) * (2.0 * np.pi / 24):
            run = place + np.outer(ahead_s + times_s, 2.0 * np.array([np.cos(turn), np.sin(turn)]))
            soonest = []
            for start, goal, speed in pairs:
                share = min(1.0, speed * ahead_s / np.hypot(*(goal - start)))
                away = np.hypot(*(run - start - share * (goal - start)).T)
                soonest.append(times_s[np.argmax(away <= speed * times_s + quest.capture_radius_m)])
            flights.append(min(soonest))
        values.append(max(flights) + np.mean(flights))
    return np.mean(values)


def test_the_aim_is_better_than_others():
    """Beside a mate that comes from the left, by an independent evaluation of equation 8.20."""
    centre, places = consistent_m([record(100.0, 0.0, 0.1)], 0.0, 2.0, Arena())
    mate = Mate(np.array([40.0, 0.0]), np.array([100.0, 0.0]), 5.0, None)
    case = hunt((100.0, 80.0), 5.0, [mate])
    aim = blocking_aim_m(*case, centre, places, 20.0)
    best_s = worst_and_mean_s(*case, aim, centre, places)
    assert best_s < worst_and_mean_s(*case, centre, centre, places) - 0.05
    for turn in np.arange(0, 16, 3) * (2.0 * np.pi / 16):
        other = centre + 32.0 * np.array([np.cos(turn), np.sin(turn)])
        assert best_s <= worst_and_mean_s(*case, other, centre, places) + 0.02


def team(policy, seed, count=3):
    generator = np.random.default_rng(seed)
    start = generator.uniform(-1000.0, 1000.0, 2)
    turn = generator.uniform(0.0, 2.0 * np.pi, count)
    away = generator.uniform(150.0, 450.0, (count, 1)) * np.stack([np.cos(turn), np.sin(turn)], 1)
    scene = Scene(
        tuple(Pursuer(start + each, StraightMotion(5.0), policy) for each in away),
        (Evader(start, 2.0, Fleeing()),),
        SnapshotRecords(SnapshotService(8, 10.0, 0.1, 5, endless=True)),
        15.0,
        0.5,
        2000,
    )
    return simulate_pursuit(scene, generator)


def test_team_against_its_parts():
    """On average a team that cooperates is sooner than pursuers that each chase the report."""
    found = {"cooperates": [], "alone": []}
    planning = partial(RecedingHorizon, horizon=10, plan_step_s=2.0, manoeuvre_s=60.0)
    for seed in range(4):
        found["cooperates"].append(team(planning, seed).capture_time_s)
        found["alone"].append(team(partial(DriveToReport, retarget=True), seed).capture_time_s)
    assert np.isfinite(found["cooperates"]).all()
    assert np.mean(found["cooperates"]) < np.mean(found["alone"])


@pytest.mark.parametrize("speed", [2.0, 1.0])
def test_slow_mates(speed):
    """A pursuer that is no faster than the evader still plans."""
    centre, places = consistent_m([record(50.0, 0.0)], 0.0, 2.0, Arena())
    mate = Mate(np.array([90.0, 0.0]), np.array([60.0, 0.0]), 5.0, None)
    case = hunt((0.0, 0.0), speed, [mate], 5.0)
    assert np.isfinite(blocking_aim_m(*case, centre, places, 20.0)).all()
