"""Simulation of an agent network: coverage, event detection, response and return to coverage."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import ArrayLike

from planopt.arrays import Floats, Indices, Mask, finite_array
from planopt.coverage.assignment import NONE, Demand
from planopt.coverage.beliefs import (
    Belief,
    Response,
    choose_teams,
    doubt_sensors,
    estimate_event,
    share_estimates,
    share_readings,
)
from planopt.coverage.control.movers import (
    Aims,
    Gains,
    Mover,
    Partition,
    RecedingMover,
    coverage_aims,
    foreseen_aims,
    held_aims,
)
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.events import Event, Sensing, free_ring_places, packed_places, signals
from planopt.coverage.geodesic import Ground
from planopt.coverage.ground import neighbour_network
from planopt.coverage.limits import Motion
from planopt.coverage.network import Counting, LinkModel, Medium, Network, Tally, tally_step
from planopt.coverage.optima import Deployer
from planopt.errors import InputError

ABSENT = -2  # State of an agent that has not joined yet or has left; `NONE` marks a covering agent
FOLLOWED_M = 1e-6
"""Maximum difference (m, m/s, rad) to a saved motion for which the simulation adopts it."""
Signals = Callable[[int, Indices], Floats]
"""Function of an event number and agent numbers (m,) that returns their present signals (m,)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Problem of a network: ground, events and settings, without the starting positions."""

    ground: Ground
    joins_s: Floats  # (n,): an agent is a member for joins_s <= time < leaves_s
    leaves_s: Floats
    events: tuple[Event, ...]
    demands: tuple[Demand, ...]  # Number of agents that each event requires
    sensing: Sensing | None  # None without events
    # Radius of the ring of responding agents about an event; None: they stop at the event itself
    stand_off_m: float | None
    partition: Partition  # Agents whose cells divide the region
    gains: Gains  # Gains of the control laws, which also set the targets at obstacle corners
    hysteresis_m: float  # Advantage in distance beyond which a new agent replaces an assigned one
    counting: Counting
    links: LinkModel | None  # Loss of messages by distance; None without losses
    flag_rounds: int  # Maximum number of rounds of a flood with losses
    time_step_s: float
    duration_s: float
    settled_m: float  # Distance to its target up to which an agent counts as settled
    stop_when_settled: bool = True  # Whether the run ends once :meth:`has_settled` holds
    # Distance to every member required for joining; None for points, which may coincide
    joins_apart_m: float | None = None
    body_radius_m: float = 0.0  # Radius of the bodies, which pack around an event; 0 for points
    speed_up_s: float = 0.0  # Time of double integrators from rest to full speed; 0 for others

    def due(self, time_s: float) -> Mask:
        """Return a mask (n,) of the agents whose scheduled membership includes `time_s`."""
        return (self.joins_s <= time_s) & (time_s < self.leaves_s)

    def members(self, time_s: float, places_m: Floats, before: Mask) -> Mask:
        """Return a mask ``(n,)`` of the members at a time; agents join only where bodies fit.

        Positions have shape ``(n, 2)``; `before` is the result of the previous step.
        """
        due = self.due(time_s)
        if self.joins_apart_m is None or not before.any():
            return due
        members = due & before
        for number in np.flatnonzero(due & ~before):
            apart_m = np.linalg.norm(places_m[members] - places_m[number], axis=1)
            members[number] = bool((apart_m > self.joins_apart_m).all())
        return members

    def has_settled(self, time_s: float, residual_m: float, known: Mask, members: Mask) -> bool:
        """Return True if all agents have settled and no event or membership will change."""
        # All agents are at their targets, exactly the active events are detected (`known`, (k,)),
        # no agent waits to join, no event moves, and no event or membership changes later.
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
    """Record of a network run with ``T`` steps, ``n`` agents and ``k`` events."""

    times_s: Floats  # (T + 1,)
    positions_m: Floats  # (T + 1, n, 2); those of absent agents do not change
    velocities_m_s: Floats  # (T + 1, n, 2) and (T + 1, n)
    headings_rad: Floats
    # (T, n) event that the agent responds to, `NONE` if it covers, `ABSENT` if no member
    states: Indices
    targets_m: Floats  # (T, n, 2)
    costs: Floats  # (T,) coverage cost of all members before each step
    # (T,) largest distance to a target; for an agent that is held back, the smaller distance for
    # which the law gives the same move; turning and speeding up count as moves
    residuals_m: Floats
    counts: Floats  # (T, n) each agent's estimate of the number of members; NaN for absent agents
    # (T, k) demand for the count of the nearest agent that knows the event; else 0
    wanted: Indices
    # (T, k, 2) best estimate of any agent, and (T, k) its standard deviation; NaN if unknown
    estimates_m: Floats
    stds_m: Floats
    beliefs_m: Floats  # (T, k, n, 2) each agent's estimate of the event's position; NaN without one
    # (T, k, 3) best estimate: readings, step of the earliest, step made; 0 if unknown
    sources: Indices
    readings: tuple[Floats, ...]  # (k,) arrays (r, 4): step, position in metres, and signal
    # (T, 3) transmissions over links: for counting, assignment (estimates and lists), readings
    messages: Indices
    settled: bool  # Whether the last step found all agents settled


def _is_near(own: Motion, saved: Motion) -> bool:
    """Return True if two motions are equal up to rounding."""
    pairs = zip(vars(own).values(), vars(saved).values(), strict=True)
    return all(float(np.abs(one - other).max()) <= FOLLOWED_M for one, other in pairs)


@dataclass(frozen=True, eq=False)
class NetworkStep:
    """Decisions of a network in one step, with ``n`` agents and ``k`` events."""

    motion: Motion  # Positions, velocities and headings of all agents at the end of the step
    states: Indices  # This and the following fields are those of :class:`NetworkRun` in one step
    targets_m: Floats
    cost: float
    residual_m: float
    counts: Floats
    wanted: Indices
    beliefs: tuple[Belief, ...]  # (k,) knowledge of all agents about each event
    messages: tuple[int, ...]
    settled: bool  # Whether all agents are settled permanently


class NetworkController:
    """Stepwise controller of a network, for the simulation or a user's own control loop.

    The controller keeps event estimates and agent counts between calls of :meth:`step`. Each call
    advances the time by ``scene.time_step_s`` seconds.

    Parameters
    ----------
    scene, starts_m, mover
        Problem, starting positions ``(n, 2)`` in metres, and the control law or planner.
    generator
        Random number generator for counting and lost messages.
    """

    def __init__(
        self, scene: Scene, starts_m: Floats, mover: Mover, generator: np.random.Generator
    ) -> None:
        agents, events = len(starts_m), len(scene.events)
        self.scene = scene
        self._mover, self._generator = mover, generator
        self._steps = 0
        self._states = np.full(agents, ABSENT, dtype=np.intp)
        self._beliefs = (Belief.none(agents),) * events
        shares = np.zeros((agents, events), dtype=np.intp)
        self._response = Response(self._states, shares, np.zeros(events, dtype=np.intp), (), 0)
        self._tally: Tally | None = None
        deploys = isinstance(mover, RecedingMover) and mover.deploys
        self._deployer = Deployer(scene.ground, generator) if deploys else None
        self._pending = np.full((agents, 1, 2), np.nan)  # Planned positions (n, N, 2)
        self.motion = Motion.at_rest(starts_m.astype(np.float64))

    def step(
        self,
        positions_m: ArrayLike | None = None,
        readings: ArrayLike | None = None,
        *,
        velocities_m_s: ArrayLike | None = None,
        headings_rad: ArrayLike | None = None,
    ) -> NetworkStep:
        """Return the decisions of the next step.

        Parameters
        ----------
        positions_m, velocities_m_s, headings_rad
            Present state of the agents with shapes ``(n, 2)``, ``(n, 2)`` and ``(n,)``; None means
            the state planned by the last step. Planning starts at the nearest allowed position
            for an agent that is too close to the border or an obstacle.
        readings
            Present signal of each event at each agent with shape ``(k, n)``. Required if the scene
            has events.

        Raises
        ------
        InputError
            An array has a wrong shape or non-finite values, an agent is outside the region or in an
            obstacle, or readings are missing.
        """
        ground, events = self.scene.ground, len(self.scene.events)
        values = (
            ("positions_m", positions_m, self.motion.places_m),
            ("velocities_m_s", velocities_m_s, self.motion.velocities_m_s),
            ("headings_rad", headings_rad, self.motion.headings_rad),
        )
        places, velocities, headings = (
            last if now is None else finite_array(key, now, last.shape, "give a value per agent")
            for key, now, last in values
        )
        allowed = ground.allows(places)
        free = np.asarray(shapely.intersects_xy(ground.free, *places.T), dtype=np.bool_)
        outside = np.flatnonzero(~(allowed | free))
        if len(outside):
            raise InputError(
                "is outside the region or in an obstacle",
                key=f"positions_m[{outside[0]}]",
                remedy="correct the position, or the region",
            )
        places = np.where(allowed[:, None], places, ground.nearest(places))
        motion = Motion(places, velocities, headings)
        if readings is None and events:
            raise InputError(
                "are missing, but the problem has events",
                key="readings",
                remedy="give the signals as an array (events, agents)",
            )
        shape = events, len(places)
        now = np.zeros(shape) if readings is None else readings
        signal = finite_array("readings", now, shape, "give a row per event, a column per agent")
        return self.decide(motion, lambda event, who: signal[event, who])

    def decide(self, motion: Motion, readings: Signals) -> NetworkStep:
        """Return the decisions of the next step for validated arrays."""
        scene, here = self.scene, motion.places_m
        agents, time_s = len(self._states), self._steps * scene.time_step_s
        members = scene.members(time_s, here, self._states != ABSENT)
        states = np.where(members, np.maximum(self._states, NONE), ABSENT)
        who, sent = np.flatnonzero(members), (0, 0, 0)
        counts = np.where(members, float(len(who)), np.nan)
        if scene.events or scene.counting.method != "known":
            network, loss = self._network(motion, who), 0.0
            if scene.links is not None:
                ends = here[who][network.links]
                loss = scene.links.loss(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
            rounds = scene.flag_rounds if np.any(loss) else None
            medium = Medium(network, loss, rounds, self._generator)
            self._tally = tally_step(self._tally, scene.counting, medium, members, self._generator)
            counts = self._tally.estimates
            medium = replace(medium, network=Network(agents, who[network.links]))
            assigning, shared = self._respond(medium, here, states, counts, readings, who)
            states = np.where(members, self._response.states, ABSENT)
            sent = (self._tally.messages, assigning, shared)
        targets, drifts, cost = self._targets(here, states)
        responds = states[who] >= 0
        now = Motion(here[who], motion.velocities_m_s[who], motion.headings_rad[who])
        aims = self._aims(now.places_m, targets[who], responds, who)
        plan = self._mover(scene.ground, now, aims, responds, drifts[who])
        after = plan.motion
        self._pending = np.full((agents, *plan.paths_m.shape[1:]), np.nan)
        self._pending[who] = plan.paths_m
        left = np.linalg.norm(targets[who] - now.places_m, axis=1)
        # Turning counts as the planned move, and full acceleration as a move at full speed.
        moved = np.linalg.norm(plan.paths_m[:, 0] - now.places_m, axis=1)
        changes = np.linalg.norm(after.velocities_m_s - now.velocities_m_s, axis=1)
        moved = np.maximum(moved, scene.speed_up_s * changes)
        moved /= scene.gains.shares(responds, scene.time_step_s)
        residual = float(np.minimum(left, moved).max())
        known = np.array([belief.known.any() for belief in self._beliefs], dtype=np.bool_)
        places, headings = here.copy(), motion.headings_rad.copy()
        velocities = np.zeros((agents, 2))
        places[who], velocities[who] = after.places_m, after.velocities_m_s
        headings[who] = after.headings_rad
        self.motion = Motion(places, velocities, headings)
        self._states = states
        self._steps += 1
        return NetworkStep(
            self.motion, states, targets, cost, residual, counts, self._response.wanted,
            self._beliefs, sent, scene.has_settled(time_s, residual, known, members),
        )  # fmt: skip

    def _aims(self, here_m: Floats, targets_m: Floats, responds: Mask, who: Indices) -> Aims:
        """Return the members' targets over the horizon, from the last plans of all members."""
        scene, mover = self.scene, self._mover
        horizon = mover.horizon if isinstance(mover, RecedingMover) else 1
        if horizon == 1 or self._deployer is not None or responds.all():
            return held_aims(targets_m, horizon)
        assert isinstance(mover, RecedingMover)
        share = scene.gains.shares(responds, scene.time_step_s)
        most_m, kept = mover.limits.speed_m_s * scene.time_step_s, self._pending[who, 1:]
        if np.isnan(kept).any():
            kept = kept[:, :0]
        return foreseen_aims(
            scene.ground, here_m, targets_m, kept, responds, horizon, share, most_m,
            scene.partition,
        )  # fmt: skip

    def _network(self, motion: Motion, who: Indices) -> Network:
        """Return the links between members: Voronoi neighbours, and the radio tree."""
        here = motion.places_m[who]
        network, mover = neighbour_network(self.scene.ground.hull, here), self._mover
        if not isinstance(mover, RecedingMover) or mover.radio is None:
            return network
        parent = radio_tree(here, mover.radio).parent
        child = np.flatnonzero((parent >= 0) & (parent != np.arange(len(who))))
        pairs = np.concatenate((network.links, np.stack((child, parent[child]), axis=1)))
        return Network(len(who), np.unique(np.sort(pairs, axis=1), axis=0))

    def _respond(
        self,
        medium: Medium,
        here_m: Floats,
        states: Indices,
        counts: Floats,
        readings: Signals,
        who: Indices,
    ) -> tuple[int, int]:
        """Update beliefs and responses; return the message counts of assignment and readings."""
        # All arrays are by agent (n,); `who` are the members, which alone measure and have links.
        scene, sensing = self.scene, self.scene.sensing
        if sensing is None:
            return 0, 0
        members, announced, shared = states != ABSENT, 0, 0
        beliefs = list[Belief]()
        for number, before in enumerate(self._beliefs):
            signal = np.full(len(states), -np.inf)
            signal[who] = readings(number, who)
            # An agent that detects an event asks unless it knows that others respond to an event
            # that explains its reading.
            detects = signal > sensing.detection_std * sensing.sensor.noise_std
            detects &= ~before.excluded.diagonal()
            served = before.known & (self._response.shares[:, number] > 0)
            if sensing.memory_s is None:
                served &= before.explains(sensing, here_m, signal)
            asks = members & (detects & ~served | (states == number))
            belief, sent = share_readings(
                before.of(members), sensing, medium, here_m, signal, asks, self._steps,
                scene.time_step_s,
            )  # fmt: skip
            hull = scene.ground.hull
            belief = doubt_sensors(belief, sensing, hull, here_m, signal, asks, self._steps)
            belief = estimate_event(belief, sensing, hull, asks, self._steps, scene.time_step_s)
            belief, passed = share_estimates(belief, medium, self._steps, sensing.silent_steps)
            beliefs.append(belief)
            announced, shared = announced + passed, shared + sent
        self._beliefs = tuple(beliefs)
        self._response = choose_teams(
            beliefs, scene.ground, medium, scene.demands, counts, here_m, states,
            scene.hysteresis_m,
        )  # fmt: skip
        return announced + self._response.messages, shared

    def _targets(self, here_m: Floats, states: Indices) -> tuple[Floats, Floats, float]:
        """Return targets (n, 2), their velocities (n, 2), and the coverage cost of the members."""
        scene, who = self.scene, np.flatnonzero(states != ABSENT)
        agents, responds = here_m[who], states[who] >= 0
        aims = coverage_aims(scene.ground, agents, responds, scene.partition)
        cost = aims.cost
        if scene.partition == "coverage_only" and responds.any():
            cost = coverage_aims(scene.ground, agents, np.zeros_like(responds)).cost
        targets, own, drifts = here_m.copy(), aims.targets_m.copy(), np.zeros_like(here_m)
        covers = ~responds
        if self._deployer is not None and covers.any():
            ends = self._deployer.places_m(who[covers], agents[covers])
            share = min(scene.gains.coverage_per_s * scene.time_step_s, 1.0)
            own[covers] = scene.ground.steered(agents[covers], ends, share)
        share = min(scene.gains.event_per_s * scene.time_step_s, 1.0)
        ends = here_m.copy()
        for team in self._response.teams:
            belief = self._beliefs[team.event]
            mine = np.zeros(len(here_m), dtype=np.bool_)
            mine[team.agents] = True
            for estimate, same in belief.groups(mine):
                event_m, those_m = estimate.value.position_m, here_m[team.members]
                places = np.repeat(event_m[None], len(those_m), axis=0)
                if scene.stand_off_m is not None:
                    known = scene.sensing is None or scene.sensing.strength_known
                    places = free_ring_places(
                        those_m, event_m, scene.stand_off_m, scene.ground, known
                    )
                elif scene.body_radius_m > 0.0:
                    places = packed_places(those_m, event_m, scene.body_radius_m)
                ends[same] = places[np.searchsorted(team.members, same)]
                drifts[same] = estimate.value.velocity_m_s
        if responds.any():
            goals = scene.ground.nearest(ends[who[responds]])
            own[responds] = scene.ground.steered(agents[responds], goals, share)
            # On a path around an obstacle the target is the next corner, which does not move.
            bent = np.linalg.norm(own[responds] - goals, axis=1) > 1e-9 * scene.ground.hull.radius_m
            drifts[who[responds][bent]] = 0.0
        targets[who] = own
        return targets, drifts, cost


def simulate_network(
    scene: Scene,
    starts_m: Floats,  # (n, 2)
    mover: Mover,
    generator: np.random.Generator,
    on_step: Callable[[], None] = lambda: None,
    saved: Sequence[Motion] = (),
) -> NetworkRun:
    """Simulate a network until it has settled or its duration has passed."""
    # Steps follow `saved` motions: closed loops amplify differences between processors.
    controller = NetworkController(scene, starts_m, mover, generator)
    motions, rows = [controller.motion], list[NetworkStep]()
    for step in range(round(scene.duration_s / scene.time_step_s)):
        now = motions[-1]
        if step < len(saved) and _is_near(now, saved[step]):
            now = motions[-1] = saved[step]
        here_m, time_s = now.places_m, step * scene.time_step_s

        def readings(
            event: int, who: Indices, here_m: Any = here_m, time_s: float = time_s
        ) -> Floats:
            """Draw the signals of an event at some agents; called only if there is a sensor."""
            sensing = cast("Sensing", scene.sensing)
            return signals(scene.events[event], sensing, here_m[who], time_s, generator)

        rows.append(controller.decide(now, readings))
        motions.append(rows[-1].motion)
        on_step()
        if rows[-1].settled and scene.stop_when_settled:
            break
    return _run(scene, motions, rows)


def _run(scene: Scene, motions: list[Motion], rows: list[NetworkStep]) -> NetworkRun:
    """Return the record of a run, made from the decisions of all steps."""
    steps, events = len(rows), len(scene.events)
    places, stds = np.full((steps, events, 2), np.nan), np.full((steps, events), np.nan)
    sources = np.zeros((steps, events, 3), dtype=np.intp)
    readings = [[np.zeros((0, 4))] for _ in range(events)]
    for step, row in enumerate(rows):
        for number, belief in enumerate(row.beliefs):
            if belief.best != NONE:
                best = belief.estimates[belief.best]
                places[step, number], stds[step, number] = best.value.position_m, best.std_m
                sources[step, number] = best.source
            new, taken = belief.steps == step, belief.readings
            heard = belief.steps[new].astype(np.float64)
            columns = heard, taken.positions_m[new], taken.signal[new]
            readings[number].append(np.column_stack(columns))
    agents = len(motions[0].places_m)
    believed = np.array([[belief.places_m for belief in row.beliefs] for row in rows])
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
        places,
        stds,
        believed.reshape(steps, events, agents, 2),
        sources,
        tuple(np.concatenate(each) for each in readings),
        np.array([row.messages for row in rows]),
        rows[-1].settled,
    )
