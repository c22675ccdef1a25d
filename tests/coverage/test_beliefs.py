"""Beliefs of agents: floods, pooled estimates, lost messages, and faulty sensors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered
from scipy.optimize import minimize
from scipy.stats import binom, chi2

from planopt.coverage import (
    NONE,
    ConvexGround,
    Counting,
    Event,
    EventSensor,
    Gains,
    LawMover,
    LinkModel,
    Medium,
    Network,
    NetworkController,
    Scene,
    Sensing,
    agent_neighbours,
    convex_region,
    faulty_reading,
    locate_event,
    measure,
    pooled,
    signals,
    simulate_network,
    single_readings,
    voronoi_cells,
)

REGION = convex_region(np.array([[0, 0], [60, 0], [60, 40], [0, 40]]))
SENSING = Sensing(EventSensor(0.2, 60.0, 3.0))
SMALL = convex_region(np.array([[0, 0], [40, 0], [40, 30], [0, 30]]))
NOISY = Sensing(EventSensor(0.5, 60.0, 3.0))
PLACE_M = (30.0, 20.0)
GAINS = Gains(0.5, 1.0)
LAW = LawMover(GAINS, 1.0, 3.0)
NOTHING_ARRIVES = LinkModel(-300.0, 3.0, 1.0, 300.0)


def scene_of(count: int, *events: Event, wanted: int = 4, **changes: object) -> Scene:
    demand = (lambda agents: min(wanted, agents),) * len(events)
    scene = Scene(
        ConvexGround(REGION), np.zeros(count), np.full(count, np.inf), events, demand, SENSING,
        None, "all", GAINS, 1.0, Counting(), None, 20, 1.0, 60.0, 0.1,
    )  # fmt: skip
    return replace(scene, **changes)


def starts_of(count: int, seed: int) -> NDArray[np.float64]:
    return scattered(REGION, count, np.random.default_rng(seed))


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.6])
def test_floods_along_a_chain(loss: float) -> None:
    """At hop h content has arrived after R rounds unless fewer than h of R messages did."""
    hops, runs, generator = 5, 4000, np.random.default_rng(1)
    chain = Network(hops + 1, np.stack((np.arange(hops), np.arange(1, hops + 1)), axis=1))
    begins = np.arange(hops + 1) == 0
    has = begins.copy()

    def merge(one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.bool_]:
        before = has.copy()
        has[other] |= before[one]
        return has & ~before

    for rounds in (hops, 2 * hops):
        arrived, messages = np.zeros(hops + 1), 0
        medium = Medium(chain, loss, rounds, generator)
        for _ in range(runs):
            has[:] = begins
            messages += medium.flood(begins, merge)
            arrived += has
        exact = binom.sf(np.arange(hops + 1) - 1, rounds, 1.0 - loss)
        assert arrived / runs == pytest.approx(exact, abs=4.5 * 0.5 / math.sqrt(runs))
        # Nothing is sent to a neighbour that has acknowledged the content.
        assert messages >= arrived[1:].sum()
        if loss == 0.0:
            # Every agent but the first sends back as well, the last one after R = hops rounds.
            assert messages == runs * (2 * hops - (rounds == hops))


def test_without_losses_every_agent_has_the_pooled_estimate() -> None:
    """All agents believe the maximum likelihood of all readings that were shared."""
    event, generator = Event("leak", (25.0, 18.0), 2.0), np.random.default_rng(3)
    scene = scene_of(14, event)
    controller = NetworkController(scene, starts_of(14, 3), LAW, np.random.default_rng(0))
    logs, states = list[tuple[NDArray[np.float64], NDArray[np.float64]]](), np.full(14, -1)
    for step in range(10):
        here = controller.motion.places_m
        signal = signals(event, SENSING, here, float(step), generator)
        asks = states == 0
        if not asks.any():
            asks = signal > 5.0 * 0.2
        near = asks.copy()
        for one, other in agent_neighbours(voronoi_cells(REGION, here)):
            near[[one, other]] |= asks[[other, one]]
        found = controller.step(here, signal[None])
        states = found.states
        if asks.any():
            logs.append((here[near], signal[near]))
        believed = found.beliefs[0].places_m
        if not logs:
            assert np.isnan(believed).all()
            continue
        pool = pooled([single_readings(*each) for each in logs])
        assert np.abs(believed - locate_event(SENSING.sensor, pool, REGION).position_m).max() < 1e-9
        assert (states == 0).sum() == 4
    assert len(logs) == 8


def test_agents_without_messages_know_what_they_sense() -> None:
    """If no message arrives, only agents that detect the event respond, each by itself."""
    # Beyond `reach_m` a signal above five standard deviations is practically impossible, within
    # `sure_m` it is practically certain.
    event, sensing = Event("leak", (25.0, 18.0), 5.0, 40.0), Sensing(EventSensor(2.0, 60.0, 3.0))
    reach_m, sure_m = (3.0 * math.sqrt(60.0 / (2.0 * stds) - 1.0) for stds in (0.5, 9.5))
    ignorant = 0
    for seed in range(4):
        scene = scene_of(20, event, sensing=sensing, links=NOTHING_ARRIVES, stop_when_settled=False)
        run = simulate_network(scene, starts_of(20, seed), LAW, np.random.default_rng(seed))
        away_m = np.linalg.norm(run.positions_m[:-1] - np.array(event.place_m), axis=2)
        there = (run.times_s[:-1] >= 5.0) & (run.times_s[:-1] < 40.0)
        sensed = (away_m < reach_m) & there[:, None]
        lately = sensed.copy()
        for delay in (1, 2):
            lately[delay:] |= sensed[:-delay]
        assert not (run.states == 0)[~lately].any()
        certain = (away_m < sure_m) & there[:, None]
        assert (run.states == 0)[certain].all()
        known = np.isfinite(run.beliefs_m[:, 0, :, 0])
        assert (known == (run.states == 0)).all()
        ignorant += int((~known & there[:, None]).sum())
        # Every agent that knows the event has its own estimate of it.
        for step in np.flatnonzero(known.sum(axis=1) > 1).tolist():
            own = run.beliefs_m[step, 0, known[step]]
            assert len(np.unique(own, axis=0)) == len(own)
        assert run.messages[there, 1:].sum() > 0
        # An agent that alone loses its wrong estimate does not hide the good ones of others.
        late = there & (run.times_s[:-1] >= 20.0)
        assert np.linalg.norm(run.estimates_m[late, 0] - event.place_m, axis=1).max() < 1.0
    assert ignorant > 500


def test_numbers_of_agents_do_not_matter() -> None:
    events = Event("a", (15.0, 15.0), 3.0), Event("b", (25.0, 25.0), 6.0, 20.0)
    scene, order = scene_of(16, *events), np.random.default_rng(5).permutation(16)
    starts = starts_of(16, 5)
    plain = NetworkController(scene, starts, LAW, np.random.default_rng(0))
    moved = NetworkController(scene, starts[order], LAW, np.random.default_rng(0))
    generator = np.random.default_rng(6)
    for step in range(25):
        here = plain.motion.places_m
        drawn = np.array([signals(each, SENSING, here, float(step), generator) for each in events])
        one, other = plain.step(here, drawn), moved.step(here[order], drawn[:, order])
        assert (one.states[order] == other.states).all()
        assert one.messages == other.messages
        for known, same in zip(one.beliefs, other.beliefs, strict=True):
            assert known.places_m[order] == pytest.approx(same.places_m, abs=1e-7, nan_ok=True)


def test_losses_are_repaired_by_repetition() -> None:
    """With a third of the messages lost, agents learn of an event and its end nearly at once."""
    links = LinkModel(0.0, 0.1, 100.0, -43.0)
    loss = float(links.loss(np.array([10.0]))[0])
    assert 0.3 < loss < 0.36
    for seed in range(4):
        events = Event("a", (15.0, 15.0), 3.0, 25.0), Event("b", (25.0, 25.0), 6.0)
        scene = scene_of(20, *events, links=links, stop_when_settled=False, duration_s=40.0)
        run = simulate_network(scene, starts_of(20, seed), LAW, np.random.default_rng(seed))
        informed = np.isfinite(run.beliefs_m[..., 0]).sum(axis=2)
        assert (informed[4:24, 0] == 20).mean() > 0.97 and not informed[28:, 0].any()
        assert (informed[7:, 1] == 20).mean() > 0.97
        teams = np.array([(run.states == k).sum(axis=1) for k in range(2)])
        assert (teams[0, 4:24] == 4).mean() > 0.9 and (teams[1, 7:] == 4).mean() > 0.9
        assert (teams[:, 7:24] >= 4).mean() > 0.95


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
    signal = measure(NOISY.sensor, places, event, generator)
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
        found = faulty_reading(single_readings(places, values), NOISY, SMALL)
        assert found == wanted
        assert found in (broken, NONE)


def test_two_readings_do_not_tell_which_is_wrong() -> None:
    """Of two contradictory readings at one position neither is excluded."""
    readings = single_readings(np.array([[20.0, 15.0], [20.0, 15.5]]), np.array([50.0, 0.0]))
    assert faulty_reading(readings, NOISY, SMALL) == NONE


@pytest.mark.parametrize("signal", [None, 2.7])
def test_a_stuck_sensor_does_not_keep_a_team(signal: float | None) -> None:
    """A sensor stuck near an event or just above detection is excluded, and no other one."""
    event, generator = Event("leak", PLACE_M, 0.0, 12.0), np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(5.0, 40.0, 10.0), np.arange(5.0, 30.0, 10.0))
    starts = np.stack((x.ravel(), y.ravel()), axis=1)
    scene = scene_of(
        12, event, wanted=3, ground=ConvexGround(SMALL), sensing=NOISY, stop_when_settled=False
    )
    controller = NetworkController(scene, starts, LAW, np.random.default_rng(0))
    broken = int(np.linalg.norm(starts - np.array(PLACE_M), axis=1).argmin())
    stuck = math.nan
    for step in range(45):
        here = controller.motion.places_m
        readings = signals(event, NOISY, here, float(step), generator)
        if step < 8:
            stuck = readings[broken] if signal is None else signal
        else:
            readings[broken] = stuck
        found = controller.step(readings=readings[None])
        if step == 7:
            assert (found.states == 0).sum() == 3
    assert found.beliefs[0].excluded.any(axis=0).nonzero()[0].tolist() == [broken]
    assert (found.states == NONE).all()
