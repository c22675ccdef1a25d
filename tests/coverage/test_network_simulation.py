"""Networks at work: teams against sorting, counts against the truth, failures and losses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered
from scipy.optimize import linear_sum_assignment

from planopt.coverage import (
    ABSENT,
    ConvexGround,
    Counting,
    Demand,
    Event,
    EventSensor,
    Gains,
    LawMover,
    LinkModel,
    MoveLimits,
    NetworkRun,
    RecedingMover,
    Scene,
    Sensing,
    convex_region,
    simulate_network,
)

REGION = convex_region(np.array([[0, 0], [60, 0], [60, 40], [0, 40]]))
SENSING = Sensing(EventSensor(0.2, 60.0, 3.0))
GAINS = Gains(0.5, 1.0)


def demand_of(number: int) -> Demand:
    return lambda agents: min(number, agents)


def scene_of(count: int, *events: Event, wanted: int = 3) -> Scene:
    return Scene(
        ConvexGround(REGION),
        np.zeros(count),
        np.full(count, np.inf),
        events,
        (demand_of(wanted),) * len(events),
        SENSING,
        None,
        "all",
        GAINS,
        0.0,
        Counting(),
        None,
        20,
        1.0,
        120.0,
        0.1,
    )


def starts_of(scene: Scene, seed: int) -> NDArray[np.float64]:
    return scattered(REGION, len(scene.joins_s), np.random.default_rng(seed))


def run_of(scene: Scene, starts: int, seed: int = 0) -> NetworkRun:
    """What it does by the laws, from random starts."""
    generator = np.random.default_rng(seed)
    return simulate_network(scene, starts_of(scene, starts), LawMover(GAINS, 1.0, 3.0), generator)


def test_the_nearest_respond_when_an_event_appears() -> None:
    """In the step of detection the team is the three agents nearest to the estimate."""
    for seed in range(6):
        run = run_of(scene_of(14, Event("leak", (25.0, 18.0), 6.0)), seed, seed)
        step = int(np.isfinite(run.estimates_m[:, 0, 0]).argmax())
        away = np.linalg.norm(run.positions_m[step] - run.estimates_m[step, 0], axis=1)
        assert set(np.flatnonzero(run.states[step] == 0)) == set(np.argsort(away)[:3])
        assert ((run.states[step:] == 0).sum(axis=1) == 3).all()
        assert run.settled


def test_everybody_returns_when_it_ends() -> None:
    """After an event the cost is again as low as without it, within the spread of local optima."""
    run = run_of(
        replace(scene_of(14, Event("leak", (25.0, 18.0), 30.0, 60.0)), duration_s=300.0), 1
    )
    calm = run_of(replace(scene_of(14), duration_s=300.0), 1)
    assert run.settled and (run.states[-1] < 0).all()
    assert run.costs[58] > 1.1 * calm.costs[-1]
    assert run.costs[-1] < 1.1 * calm.costs[-1]


def test_hysteresis_bounds_the_changes_of_a_team() -> None:
    """While an event moves, teams change as little as the hysteresis allows."""
    event = Event("plume", (10.0, 20.0), 5.0, math.inf, (1.6, 0.0))
    scene = replace(
        scene_of(16, event),
        hysteresis_m=1.5,
        sensing=replace(SENSING, memory_s=6.0),
        duration_s=32.0,
    )
    run = run_of(scene, 2)
    held = np.zeros(16, dtype=np.bool_)
    first = True
    for step in np.flatnonzero(np.isfinite(run.estimates_m[:, 0, 0])):
        away = np.linalg.norm(run.positions_m[step] - run.estimates_m[step, 0], axis=1)
        before, held = held, run.states[step] == 0
        moved = (run.estimates_m[step] != run.estimates_m[step - 1]).any()
        if first or moved:
            assert held.sum() == 3 and away[held].max() <= away[~held].min() + 1.5
        # An agent is only replaced by one that is nearer by more than the hysteresis.
        for released in away[before & ~held]:
            assert moved and released > away[held & ~before].min() + 1.5
        first = False
    eager = run_of(replace(scene, hysteresis_m=0.0), 2)
    changes = [
        int((np.diff((one.states == 0).astype(int), axis=0) == 1).sum()) for one in (run, eager)
    ]
    assert 3 <= changes[0] < changes[1]


def test_several_events_share_the_agents() -> None:
    """Teams are disjoint and full, not much farther in total than the best assignment."""
    events = (Event("a", (15.0, 15.0), 10.0), Event("b", (25.0, 25.0), 10.0))
    run = run_of(scene_of(12, *events, wanted=4), 3)
    assert [(run.states[-1] == k).sum() for k in range(2)] == [4, 4]
    first = int(np.isfinite(run.estimates_m).all(axis=(1, 2)).argmax())
    away = np.linalg.norm(run.positions_m[first][:, None] - run.estimates_m[first], axis=2)
    seats = np.repeat(away, 4, axis=1)
    best = seats[linear_sum_assignment(seats)].sum()
    team = run.states[first]
    assert best <= away[team >= 0, team[team >= 0]].sum() + 1e-9 <= 1.3 * best
    few = run_of(scene_of(5, *events, wanted=4), 3)
    assert sorted((few.states[-1] == k).sum() for k in range(2)) == [2, 3]


@pytest.mark.parametrize("method", ["leader", "running", "minima"])
def test_counts_follow_who_joins_and_leaves(method: str) -> None:
    """Agents that count themselves find the new number after some leave and others join."""
    rounds = {"leader": (80, 400), "running": (600, 15000), "minima": (8, 16)}[method]
    count = Counting(method, *rounds, draws=900, innovation=0.01)  # pyright: ignore[reportArgumentType]
    joins, leaves = np.zeros(15), np.full(15, np.inf)
    joins[[0, 1]], leaves[[14, 3, 4, 5]] = 5.0, 15.0
    scene = replace(
        scene_of(15), counting=count, joins_s=joins, leaves_s=leaves, duration_s=30.0,
        stop_when_settled=False,
    )  # fmt: skip
    run = run_of(scene, 4)
    tolerance = 0.5 if method != "minima" else 4.0 * 15 / math.sqrt(898)
    for step, true in ((0, 13), (14, 15), (29, 11)):
        here = run.counts[step, run.states[step] != ABSENT]
        assert len(here) == true
        assert np.abs(here - true).max() < tolerance
    assert np.isnan(run.counts[run.states == ABSENT]).all()
    assert (run.positions_m[-1, 14] == run.positions_m[15, 14]).all()


def test_an_agent_that_fails_is_replaced() -> None:
    """When one of the team leaves, the team is full again in the same step."""
    scene = scene_of(10, Event("leak", (25.0, 18.0), 0.0))
    lost = int(np.flatnonzero(run_of(scene, 5).states[10] == 0)[0])
    leaves = np.full(10, np.inf)
    leaves[lost] = 11.0
    run = run_of(replace(scene, leaves_s=leaves), 5)
    assert run.states[10, lost] == 0 and run.states[11, lost] == ABSENT
    assert (run.states[11] == 0).sum() == 3


def test_lossy_links_cost_messages_and_still_agree() -> None:
    """With a fifth of the messages lost the right team responds, and messages are repeated."""
    links = LinkModel(-30.0, 3.0, 6.0, -69.0)
    scene = scene_of(14, Event("leak", (25.0, 18.0), 6.0))
    lossy = run_of(replace(scene, links=links), 6)
    calm = run_of(scene, 6)
    typical = float(links.loss(np.array([13.0]))[0])
    assert 0.05 < typical < 0.4
    assert (lossy.states[-1] == 0).sum() == 3 and lossy.settled
    assert (lossy.messages[6:30, 1:].sum(axis=0) > 1.05 * calm.messages[6:30, 1:].sum(axis=0)).all()


def test_moving_events_are_located_within_their_deviation() -> None:
    """With its velocity estimated, the reported deviation is true; taken as static, it is not."""
    plume = Event("plume", (50.0, 30.0), 4.0, 34.0, (-0.6, -0.5))
    within, wrongly, errors = list[bool](), list[bool](), list[float]()
    for seed in range(20, 24):
        scene = replace(scene_of(12, plume), duration_s=34.0)
        for speed_std, found in ((1.0, within), (None, wrongly)):
            sensing = replace(SENSING, memory_s=8.0, speed_std_m_s=speed_std)
            run = run_of(replace(scene, sensing=sensing), seed, seed)
            known = np.isfinite(run.estimates_m[:, 0, 0]) & (run.times_s[:-1] < 34.0)
            true = np.array([plume.place_at(time_s) for time_s in run.times_s[:-1][known].tolist()])
            error_m = np.linalg.norm(run.estimates_m[known, 0] - true, axis=1)
            found += (error_m <= 3.0 * run.stds_m[known, 0]).tolist()
            if speed_std is not None:
                errors += error_m.tolist()
    assert len(within) > 80
    assert np.mean(within) >= 0.9 and np.mean(wrongly) < 0.6
    assert np.median(errors) < 0.3


def test_plans_that_lead_keep_nearer_to_a_moving_event() -> None:
    """The estimated velocity brings the team nearer to the event than its place alone."""
    plume = Event("plume", (12.0, 20.0), 3.0, math.inf, (1.2, 0.0))
    sensing = replace(SENSING, memory_s=6.0, speed_std_m_s=1.0)
    scene = replace(scene_of(12, plume), sensing=sensing, duration_s=30.0)
    lags_m = list[float]()
    for lead in (False, True):
        mover = RecedingMover(GAINS, MoveLimits(speed_m_s=3.0), 3, lead=lead)
        run = simulate_network(scene, starts_of(scene, 30), mover, np.random.default_rng(30))
        places = np.array([plume.place_at(time_s) for time_s in run.times_s[1:].tolist()])
        off_m = np.linalg.norm(run.positions_m[1:] - places[:, None], axis=2)
        lags_m.append(float(off_m[20:][run.states[20:] == 0].mean()))
    assert lags_m[1] < 0.5 * lags_m[0]
    assert lags_m[0] > 0.8


def test_stand_off_ring_learns_on() -> None:
    """On the ring the estimate's uncertainty goes on falling; at the event it stops."""
    at = replace(scene_of(12, Event("leak", (30.0, 20.0), 0.0)), stop_when_settled=False)
    ring = replace(at, stand_off_m=SENSING.sensor.best_distance_m)
    stds = [run_of(scene, 7).stds_m[:, 0] for scene in (at, ring)]
    assert stds[0][-1] > 0.8 * stds[0][40]
    assert stds[1][-1] < 0.7 * stds[1][40]
    # Three agents at equal angles: 4 sigma^2 / (P g^2) for each step there.
    slope = 60.0 * abs(float(SENSING.sensor.slope(np.array(SENSING.sensor.best_distance_m))))
    limit = 2.0 * 0.2 / slope / math.sqrt(3 * 120)
    assert stds[1][-1] == pytest.approx(limit, rel=0.15)
