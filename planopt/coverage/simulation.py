"""A network at work: it covers, notices events, sends agents there, counts itself, and goes back.

In every step agents talk to their Voronoi neighbours, measure, assign themselves and move. All that
is random comes from one generator, so that a seed gives one run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.coverage.assignment import (
    NONE,
    Demand,
    deferred_acceptance,
    demanded,
    fair_shares,
    propagate_flags,
)
from planopt.coverage.control.movers import Gains, Motion, Mover, Partition, coverage_aims
from planopt.coverage.events import Event, Sensing, Watch, event_places, signals, watched
from planopt.coverage.geodesic import Ground
from planopt.coverage.ground import neighbour_network
from planopt.coverage.network import Counting, LinkModel, Loss, Network, Tally, tally_step
from planopt.coverage.voronoi import positive
from planopt.errors import InputError


@dataclass(frozen=True)
class Circumstance:
    """The events, counts and agents that an assignment was made for."""

    agents: frozenset[int]  # Names of the agents that take part
    # Estimated place (x, y) in metres of each event, by its name
    events: dict[str, tuple[float, float]]


def is_due(last: Circumstance | None, now: Circumstance, moved_m: float) -> bool:
    """Return whether an assignment has to be made again."""
    positive(moved_m, "moved_m", zero=True)
    if last is None or last.agents != now.agents or last.events.keys() != now.events.keys():
        return True
    return any(
        np.hypot(x - last.events[name][0], y - last.events[name][1]) > moved_m
        for name, (x, y) in now.events.items()
    )


ABSENT = -2
"""The state of an agent that has not joined yet or has left; `NONE` is that of one that covers."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The task and the settings of a network."""

    ground: Ground  # What is covered
    starts_m: NDArray[np.float64]  # (n, 2) where agents are at first
    # (n,): an agent takes part from the first time up to before the second
    joins_s: NDArray[np.float64]
    leaves_s: NDArray[np.float64]
    events: tuple[Event, ...]  # What appears, and how many agents each event asks for
    demands: tuple[Demand, ...]
    sensing: Sensing | None  # How agents measure; None without events
    # Radius of the ring about an event that responding agents stand on; None for the event
    stand_off_m: float | None
    partition: Partition  # Whose cells divide the region
    gains: Gains  # Of the laws; they also set how agents pass the corners of obstacles
    # An agent is exchanged for one that is nearer by more than the first; agents assign themselves
    # again when an estimate has moved by more than the second
    hysteresis_m: float
    moved_m: float
    counting: Counting  # How agents know their number
    links: LinkModel | None  # Loss of messages by distance; None without losses
    flag_rounds: int  # Rounds of flag propagation in a step, with losses
    time_step_s: float  # Length of a step and of the run
    duration_s: float
    settled_m: float  # Agents this near to their targets have settled
    # Whether the run ends when they have and nothing more is to come
    stop_when_settled: bool = True
    # An agent that is to join waits until all others are farther away than that; None for points,
    # which may share a place
    joins_apart_m: float | None = None
    # Radius of the agents' bodies, which crowd around an event; 0 for points
    body_radius_m: float = 0.0

    def due(self, time_s: float) -> NDArray[np.bool_]:
        """Return who is to take part at a time; (n,)."""
        return (self.joins_s <= time_s) & (time_s < self.leaves_s)

    def members(
        self, time_s: float, places_m: NDArray[np.float64], before: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return who takes part at a time ``(n,)``: bodies join only where there is room."""
        # Shapes: places_m (n, 2); before (n,).
        due = self.due(time_s)
        if self.joins_apart_m is None or not before.any():
            return due
        members = due & before
        for number in np.flatnonzero(due & ~before):
            apart_m = np.linalg.norm(places_m[members] - places_m[number], axis=1)
            members[number] = bool((apart_m > self.joins_apart_m).all())
        return members

    def has_settled(
        self,
        time_s: float,
        residual_m: float,
        known: NDArray[np.bool_],  # (k,) which events are known
        members: NDArray[np.bool_],  # (n,) who takes part
    ) -> bool:
        """Return whether agents are settled for good.

        They are near their targets, know of all events that are there and of no others, nobody
        waits for room to join, and nothing is to begin, to end or to move on.
        """
        there = np.array([each.is_there(time_s) for each in self.events], dtype=np.bool_)
        if residual_m > self.settled_m or (known != there).any():
            return False
        if (members != self.due(time_s)).any():
            return False
        ends = [each for event in self.events for each in (event.appears_s, event.ends_s)]
        every = np.concatenate((ends, self.joins_s, self.leaves_s))
        moving = any(any(e.velocity_m_s) and e.is_there(time_s) for e in self.events)
        return not moving and not ((every > time_s) & (every < self.duration_s)).any()


@dataclass(frozen=True, eq=False)
class NetworkRun:
    """The run of a network; ``T`` steps, ``n`` agents, ``k`` events."""

    times_s: NDArray[np.float64]  # (T + 1,)
    positions_m: NDArray[np.float64]  # (T + 1, n, 2) places; those of absent agents do not change
    velocities_m_s: NDArray[np.float64]  # (T + 1, n, 2) and (T + 1, n)
    headings_rad: NDArray[np.float64]
    # (T, n) number of the event that an agent responds to in the step, `NONE` if it covers,
    # `ABSENT` if it does not take part
    states: NDArray[np.intp]
    targets_m: NDArray[np.float64]  # (T, n, 2) where it drives to
    costs: NDArray[np.float64]  # (T,) coverage cost of all agents that take part, before each step
    residuals_m: NDArray[np.float64]  # (T,) :func:`residual_m` of each step
    # (T, n) how many agents each believes there are; NaN for absent ones
    counts: NDArray[np.float64]
    # (T, k) how many agents each event asks for, as the agent nearest to it reckons; 0 for an event
    # that is not known
    wanted: NDArray[np.intp]
    # (T, k, 2) and (T, k) estimated places and their uncertainty; NaN if not known
    estimates_m: NDArray[np.float64]
    stds_m: NDArray[np.float64]
    # (T, 3) transmissions over single links in the step: for counting, for assignment, and of
    # readings
    messages: NDArray[np.intp]
    settled: bool  # Whether the last step found all agents settled


Readings = Callable[[int, NDArray[np.intp]], NDArray[np.float64]]
"""Gives the signals of an event, by its number, that some agents (m,) read now; (m,)."""


FOLLOWED_M = 1e-6
"""Largest difference to a saved motion (m, m/s, rad) with which a simulation follows it."""


def _is_near(own: Motion, saved: Motion) -> bool:
    """Return whether two motions are the same but for rounding."""
    pairs = (
        (own.places_m, saved.places_m),
        (own.velocities_m_s, saved.velocities_m_s),
        (own.headings_rad, saved.headings_rad),
    )
    return all(float(np.abs(one - other).max()) <= FOLLOWED_M for one, other in pairs)


@dataclass(frozen=True, eq=False)
class NetworkStep:
    """The decisions of a network in one step; ``n`` agents, ``k`` events."""

    motion: Motion  # Positions, velocities and headings of all agents at the end of the step
    states: NDArray[np.intp]  # These and the following are as in :class:`NetworkRun`
    targets_m: NDArray[np.float64]
    cost: float
    residual_m: float
    counts: NDArray[np.float64]
    wanted: NDArray[np.intp]
    watches: tuple[Watch, ...]  # (k,) what is known of each event
    messages: tuple[int, ...]
    settled: bool  # Whether all agents are settled for good


class NetworkController:
    """The decisions of a network's agents, step by step: a simulation's, or those of a user's loop.

    What agents know of events, of each other and of their number is kept between calls of
    :meth:`step`; each call is one step of ``scene.time_step_s`` seconds.

    Parameters
    ----------
    scene, mover
        What is covered, and the law by which agents move.
    generator
        Source of the randomness in counting and in lost messages.
    """

    def __init__(self, scene: Scene, mover: Mover, generator: np.random.Generator) -> None:
        agents, events = len(scene.starts_m), len(scene.events)
        self.scene = scene
        self._mover, self._generator = mover, generator
        self._steps = 0
        self._states = np.full(agents, ABSENT, dtype=np.intp)
        self._watches, self._wanted = (Watch(),) * events, np.zeros(events, dtype=np.intp)
        self._assigned_for: Circumstance | None = None
        self._tally: Tally | None = None
        start = scene.starts_m.astype(np.float64)
        self.motion = Motion(start, np.zeros((agents, 2)), np.zeros(agents))

    def step(
        self,
        positions_m: ArrayLike | None = None,
        readings: Readings | ArrayLike | None = None,
        *,
        velocities_m_s: ArrayLike | None = None,
        headings_rad: ArrayLike | None = None,
    ) -> NetworkStep:
        """Return what the agents do in the next step.

        Parameters
        ----------
        positions_m, velocities_m_s, headings_rad
            ``(n, 2)``, ``(n, 2)`` and ``(n,)`` of the agents now; by default as the last step
            planned.
        readings
            ``(k, n)`` signal of each event at each agent now, or a function that gives the signals
            of an event at some agents. Needed where there are events.

        Raises
        ------
        InputError
            An array has another shape or is not finite, an agent is outside the region, or readings
            are missing.
        """
        agents, events = len(self._states), len(self.scene.events)
        last = self.motion
        motion = Motion(
            last.places_m
            if positions_m is None
            else _numbers("positions_m", positions_m, (agents, 2)),
            last.velocities_m_s
            if velocities_m_s is None
            else _numbers("velocities_m_s", velocities_m_s, (agents, 2)),
            last.headings_rad
            if headings_rad is None
            else _numbers("headings_rad", headings_rad, (agents,)),
        )
        outside = np.flatnonzero(~self.scene.ground.allows(motion.places_m))
        if len(outside):
            raise InputError(
                "is outside the region, in an obstacle or too near to one",
                key=f"positions_m[{outside[0]}]",
                remedy="correct the position, or the region",
            )
        if readings is None:
            if events:
                raise InputError(
                    "are left out, and there are events",
                    key="readings",
                    remedy="give (k, n) signals",
                )
            return self.decide(motion, lambda event, who: np.zeros(len(who)))
        if callable(readings):
            return self.decide(motion, readings)
        signals_now = _numbers("readings", readings, (events, agents))
        return self.decide(motion, lambda event, who: signals_now[event, who])

    def decide(self, motion: Motion, readings: Readings) -> NetworkStep:
        """Return what the agents do in the next step, from checked arrays."""
        scene, generator, here = self.scene, self._generator, motion.places_m
        agents, time_s = len(self._states), self._steps * scene.time_step_s
        members = scene.members(time_s, here, self._states != ABSENT)
        states = np.where(members, np.maximum(self._states, NONE), ABSENT)
        who, sent = np.flatnonzero(members), [0, 0, 0]
        talks = len(scene.events) > 0 or scene.counting.method != "known"
        network = neighbour_network(scene.ground.hull, here[who]) if talks else None
        counts = np.where(members, float(len(who)), np.nan)
        if network is not None:
            loss = _loss(scene, network, here[who])
            self._tally = tally_step(self._tally, scene.counting, network, members, generator, loss)
            counts, sent[0] = self._tally.estimates, self._tally.messages
            self._watches, sent[2] = _noticed(
                scene, self._watches, network, loss, here[who], states[who], time_s, generator,
                lambda event: readings(event, who),
            )  # fmt: skip
            wanted = _wanted(scene, self._watches, here[who], counts[who])
            now = _circumstance(scene, self._watches, who)
            changed = bool(np.any(loss)) or bool((wanted != self._wanted).any())
            if changed or is_due(self._assigned_for, now, scene.moved_m):
                states[who], sent[1] = _assigned(
                    scene, self._watches, network, loss, here[who], states[who], wanted,
                    counts[who], generator,
                )  # fmt: skip
                self._assigned_for, self._wanted = now, wanted
        targets, drifts, cost = _aims(scene, self._watches, here, states)
        responds = states[who] >= 0
        velocities, headings = np.zeros((agents, 2)), motion.headings_rad.copy()
        now = Motion(here[who], motion.velocities_m_s[who], headings[who])
        after = self._mover(scene.ground, now, targets[who], responds, drifts[who])
        residual = residual_m(scene.gains, scene.time_step_s, now, after, targets[who], responds)
        known = np.array([watch.is_known for watch in self._watches], dtype=np.bool_)
        settled = scene.has_settled(time_s, residual, known, members)
        there = here.copy()
        there[who], velocities[who], headings[who] = (
            after.places_m,
            after.velocities_m_s,
            after.headings_rad,
        )
        self.motion = Motion(there, velocities, headings)
        self._states = states
        self._steps += 1
        return NetworkStep(
            self.motion, states, targets, cost, residual, counts, self._wanted, self._watches,
            tuple(sent), settled,
        )  # fmt: skip


def _numbers(key: str, given: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return finite numbers of a shape."""
    try:
        found = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != shape or not np.isfinite(found).all():
        raise InputError(
            f"has shape {found.shape} or numbers that are not finite",
            key=key,
            remedy=f"give finite numbers of shape {shape}",
        )
    return found


def simulate_network(
    scene: Scene,
    mover: Mover,
    generator: np.random.Generator,
    on_step: Callable[[], None] = lambda: None,
    saved: Sequence[Motion] = (),
) -> NetworkRun:
    """Simulate a network from its start until it has settled, or the time is over.

    Each step starts from the `saved` motion where that agrees within `FOLLOWED_M`: closed loops
    amplify the rounding of another processor, single steps do not.
    """
    controller = NetworkController(scene, mover, generator)
    motions, rows = [controller.motion], list[NetworkStep]()
    for step in range(round(scene.duration_s / scene.time_step_s)):
        now = motions[-1]
        if step < len(saved) and _is_near(now, saved[step]):
            now = motions[-1] = saved[step]
        here_m, time_s = now.places_m, step * scene.time_step_s

        def readings(
            event: int, who: NDArray[np.intp], here_m: Any = here_m, time_s: float = time_s
        ) -> NDArray[np.float64]:
            """Draw what agents read of an event; only networks with a sensor ask."""
            sensing = cast("Sensing", scene.sensing)
            return signals(scene.events[event], sensing, here_m[who], time_s, generator)

        rows.append(controller.decide(now, readings))
        motions.append(rows[-1].motion)
        on_step()
        if rows[-1].settled and scene.stop_when_settled:
            break
    return _run(scene, motions, rows)


def _loss(scene: Scene, network: Network, agents_m: NDArray[np.float64]) -> Loss:
    """Loss of each link by its length."""
    if scene.links is None:
        return 0.0
    ends = agents_m[network.links]
    return scene.links.loss(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))


def _noticed(
    scene: Scene,
    watches: tuple[Watch, ...],
    network: Network,
    loss: Loss,
    agents_m: NDArray[np.float64],
    states: NDArray[np.intp],
    time_s: float,
    generator: np.random.Generator,
    readings: Callable[[int], NDArray[np.float64]],
) -> tuple[tuple[Watch, ...], int]:
    """Return the knowledge after all have measured, and how many readings were sent.

    Who responds to an event, or detects it, collects its neighbours' readings.
    """
    sensing, sent = scene.sensing, 0
    if sensing is None:
        return watches, 0
    found: list[Watch] = []
    sender, receiver = network.directed
    lost = np.any(loss)
    for number, watch in enumerate(watches):
        signal = readings(number)
        collects = states == number
        if not collects.any():
            collects = signal > sensing.detection_std * sensing.sensor.noise_std
        asked = collects[receiver] & ~collects[sender]
        sent += int(asked.sum())
        if lost:
            asked &= generator.random(len(asked)) >= np.tile(np.asarray(loss), 2)
        shared = collects.copy()
        shared[sender[asked]] = True
        hull = scene.ground.hull
        found.append(watched(watch, sensing, hull, agents_m, signal, shared, time_s))
    return tuple(found), sent


def _wanted(
    scene: Scene,
    watches: tuple[Watch, ...],
    agents_m: NDArray[np.float64],
    counts: NDArray[np.float64],
) -> NDArray[np.intp]:
    """Return the demand of each known event (k,), by the count of its nearest agent."""
    wanted = np.zeros(len(watches), dtype=np.intp)
    for number, (watch, demand) in enumerate(zip(watches, scene.demands, strict=True)):
        if watch.is_known:
            nearest = int(np.linalg.norm(agents_m - watch.place_m, axis=1).argmin())
            believed = counts[nearest]
            wanted[number] = demanded(demand, round(believed)) if np.isfinite(believed) else 0
    return wanted


def _circumstance(scene: Scene, watches: tuple[Watch, ...], who: NDArray[np.intp]) -> Circumstance:
    """Return the circumstance that an assignment now would be made for."""
    places = {
        event.name: (float(watch.place_m[0]), float(watch.place_m[1]))
        for event, watch in zip(scene.events, watches, strict=True)
        if watch.is_known
    }
    return Circumstance(frozenset(who.tolist()), places)


def _assigned(
    scene: Scene,
    watches: tuple[Watch, ...],
    network: Network,
    loss: Loss,
    agents_m: NDArray[np.float64],
    states: NDArray[np.intp],
    wanted: NDArray[np.intp],
    counts: NDArray[np.float64],
    generator: np.random.Generator,
) -> tuple[NDArray[np.intp], int]:
    """New states (n,) of the members, and how many messages it took.

    An agent that does not respond yet announces a distance that is larger by the hysteresis, so
    that it replaces another only if it is nearer by more than that.
    """
    known = [number for number, watch in enumerate(watches) if watch.is_known]
    after = np.full(len(states), NONE, dtype=np.intp)
    if not known:
        return after, 0
    places = np.array([watches[number].place_m for number in known])
    distances = scene.ground.distances_m(agents_m, places)
    distances += scene.hysteresis_m * (states[:, None] != np.array(known))
    rounds = scene.flag_rounds if np.any(loss) else None
    if len(known) == 1:
        demand = scene.demands[known[0]]
        own = np.array([demanded(demand, round(c)) if np.isfinite(c) else 0 for c in counts])
        found = propagate_flags(
            network, distances[:, 0], own, rounds=rounds, loss=loss, generator=generator
        )
        after[found.flagged] = known[0]
        return after, found.messages
    # The lists are long enough to replace every agent that takes another event.
    shares = fair_shares(wanted[known], len(states))
    length, messages = int(shares.sum()), 0
    for column in distances.T:
        messages += propagate_flags(
            network, column, length, rounds=rounds, loss=loss, generator=generator
        ).messages
    match = deferred_acceptance(distances, shares)
    chosen = match.event_of != NONE
    after[chosen] = np.array(known)[match.event_of[chosen]]
    return after, messages + match.asked + match.released


def _aims(
    scene: Scene,
    watches: tuple[Watch, ...],
    here_m: NDArray[np.float64],
    states: NDArray[np.intp],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Targets (n, 2) of all agents, their velocities, and the coverage cost of who takes part."""
    who = np.flatnonzero(states != ABSENT)
    agents, responds = here_m[who], states[who] >= 0
    aims = coverage_aims(scene.ground, agents, responds, scene.partition)
    cost = aims.cost
    if scene.partition == "coverage_only" and responds.any():
        cost = coverage_aims(scene.ground, agents, np.zeros_like(responds)).cost
    targets, own, drifts = here_m.copy(), aims.targets_m.copy(), np.zeros_like(here_m)
    for number in range(len(watches)):
        team = states[who] == number
        if not team.any():
            continue
        ends = event_places(
            agents[team], watches[number].place_m, scene.stand_off_m, scene.body_radius_m
        )
        share = min(scene.gains.event_per_s * scene.time_step_s, 1.0)
        ends = scene.ground.nearest(ends)
        own[team] = scene.ground.steered(agents[team], ends, share)
        # On the way round an obstacle the next corner is the target; it stands.
        straight = np.linalg.norm(own[team] - ends, axis=1) <= 1e-9 * scene.ground.hull.radius_m
        drifts[who[team]] = straight[:, None] * watches[number].velocity_m_s
    targets[who] = own
    return targets, drifts, cost


def residual_m(
    gains: Gains,
    time_step_s: float,
    now: Motion,
    after: Motion,
    targets_m: NDArray[np.float64],
    responds: NDArray[np.bool_],
) -> float:
    """Return how far the farthest agent still has to go in one step.

    That is the distance to its target, or less if limits such as radio links let it move less: then
    the distance for which the laws would ask for this move.
    """
    left = np.linalg.norm(targets_m - now.places_m, axis=1)
    moved = np.linalg.norm(after.places_m - now.places_m, axis=1)
    return float(np.minimum(left, moved / gains.shares(responds, time_step_s)).max())


def _run(scene: Scene, motions: list[Motion], rows: list[NetworkStep]) -> NetworkRun:
    """The records of all steps as arrays."""
    steps, events = len(rows), len(scene.events)
    places = np.array([[watch.place_m for watch in row.watches] for row in rows])
    stds = np.array([[watch.std_m for watch in row.watches] for row in rows])
    return NetworkRun(
        np.arange(steps + 1, dtype=np.float64) * scene.time_step_s,
        np.array([each.places_m for each in motions]),
        np.array([each.velocities_m_s for each in motions]),
        np.array([each.headings_rad for each in motions]),
        np.array([row.states for row in rows]),
        np.array([row.targets_m for row in rows]),
        np.array([row.cost for row in rows]),
        np.array([row.residual_m for row in rows]),
        np.array([row.counts for row in rows]),
        np.array([row.wanted for row in rows]).reshape(steps, events),
        places.reshape(steps, events, 2),
        stds.reshape(steps, events),
        np.array([row.messages for row in rows]),
        rows[-1].settled,
    )
