"""Beliefs of agents about events: readings, estimates and teams travel over lossy links.

Agents that respond to an event, or detect it, request readings from their neighbours; all of these
agents pass readings on. The best estimate travels to all agents.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.assignment import (
    NONE,
    Demand,
    deferred_acceptance,
    demanded,
    fair_shares,
    propagate_flags,
)
from planopt.coverage.events import Sensing
from planopt.coverage.geodesic import Ground
from planopt.coverage.localisation import (
    RIVAL,
    Drift,
    EventEstimate,
    Readings,
    joined,
    locate_event,
    pooled,
    single_readings,
)
from planopt.coverage.network import Medium
from planopt.coverage.voronoi import ConvexRegion

GRID_READINGS = 150
"""Number of readings above which the last estimate replaces the grid of initial guesses."""
NEVER = -(10**9)  # Value of the last detection's step for an agent that knows of no detection


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimate of an event with its rank among the estimates of all agents."""

    # Later refutation, more excluded sensors, more readings or, if they age, newer ones
    rank: tuple[int, int, int, int]
    value: EventEstimate
    # Number of readings, step of the earliest one, and step of the estimate
    source: tuple[int, int, int]

    @property
    def std_m(self) -> float:
        """Return the standard deviation of the estimated position in metres."""
        # The root of the covariance trace plus, in quadrature, the distance of the farthest rival.
        rivals_m = np.linalg.norm(self.value.rivals_m - self.value.position_m, axis=1)
        spread_m = float(rivals_m.max(initial=0.0))
        return math.hypot(math.sqrt(float(np.trace(self.value.covariance_m2))), spread_m)


@dataclass(frozen=True, eq=False)
class Belief:
    """Knowledge of `n` agents about one event, with `r` readings in total."""

    steps: Indices  # (r,) step in which each reading was taken
    owners: Indices  # (r,) agent that took each reading
    readings: Readings
    held: Mask  # (n, r) readings that each agent holds
    estimates: tuple[Estimate, ...]  # Estimates that agents hold, of ascending rank
    chosen: Indices  # (n,) index of each agent's estimate; `NONE` for agents without one
    heard: Indices  # (n,) step of the last detection that the agent knows of
    since: Indices  # (n,) last step known to the agent in which readings refuted an estimate
    doubts: Indices  # (n, n) number of bad readings of each sensor (column) known to each agent

    @classmethod
    def none(cls, agents: int) -> Belief:
        """Return the initial belief of agents without any knowledge of the event."""
        return cls(
            np.zeros(0, dtype=np.intp),
            np.zeros(0, dtype=np.intp),
            single_readings(np.zeros((0, 2)), np.zeros(0)),
            np.zeros((agents, 0), dtype=np.bool_),
            (),
            np.full(agents, NONE, dtype=np.intp),
            np.full(agents, NEVER, dtype=np.intp),
            np.full(agents, NEVER, dtype=np.intp),
            np.zeros((agents, agents), dtype=np.intp),
        )

    @property
    def excluded(self) -> Mask:
        """Return a mask (n, n) of the sensors (columns) that each agent excludes as faulty."""
        return self.doubts >= CONTRADICTIONS

    @property
    def known(self) -> Mask:
        """Return a mask (n,) of the agents that consider the event active."""
        return self.chosen != NONE

    @property
    def best(self) -> int:
        """Return the index of the estimate of highest rank; `NONE` without any estimate."""
        return int(self.chosen.max(initial=NONE))

    def groups(self, agents: Mask) -> list[tuple[Estimate, Indices]]:
        """Return the distinct estimates of the agents in a mask (n,), each with its agents."""
        found = [
            (estimate, np.flatnonzero(agents & (self.chosen == number)))
            for number, estimate in enumerate(self.estimates)
        ]
        return [(estimate, who) for estimate, who in found if len(who)]

    @property
    def places_m(self) -> Floats:
        """Return each agent's estimate (n, 2) of the event's position, NaN without one."""
        each = [estimate.value.position_m for estimate in self.estimates]
        return np.array([*each, np.full(2, math.nan)])[self.chosen]

    @property
    def velocities_m_s(self) -> Floats:
        """Return each agent's estimate (n, 2) of the event's velocity in m/s."""
        each = [estimate.value.velocity_m_s for estimate in self.estimates]
        return np.array([*each, np.zeros(2)])[self.chosen]

    @property
    def stds_m(self) -> Floats:
        """Return the standard deviation (n,) of each agent's estimate, NaN without one."""
        return np.array([*(each.std_m for each in self.estimates), math.nan])[self.chosen]

    def explains(self, sensing: Sensing, agents_m: Floats, signal: Floats) -> Mask:
        """Return a mask (n,) of the agents whose reading agrees with their own estimate."""
        strengths = np.array([*(each.value.strength for each in self.estimates), math.nan])
        away_m = np.linalg.norm(agents_m - self.places_m, axis=1)
        off = signal - strengths[self.chosen] * sensing.sensor.profile(away_m)
        return np.asarray((off / sensing.sensor.noise_std) ** 2 < OUTLIER, dtype=np.bool_)

    def of(self, agents: Mask) -> Belief:
        """Return the belief reduced to the knowledge of the agents in a mask (n,)."""
        return replace(
            self,
            held=self.held & agents[:, None],
            chosen=np.where(agents, self.chosen, NONE),
            heard=np.where(agents, self.heard, NEVER),
        )


def share_readings(
    belief: Belief,
    sensing: Sensing,
    medium: Medium,
    agents_m: Floats,  # (n, 2)
    signal: Floats,  # (n,); negative infinity for absent agents
    asks: Mask,  # (n,) mask of the agents that request readings from their neighbours
    step: int,
    time_step_s: float,
) -> tuple[Belief, int]:
    """Exchange new and missing readings; return the belief and the number of messages."""
    sender, receiver = medium.network.directed
    count, near = len(signal), asks.copy()
    near[receiver[asks[sender]]] = True
    owners = np.flatnonzero(near)
    column = np.full(count, NONE, dtype=np.intp)
    column[owners] = np.arange(len(owners))
    now = np.zeros((count, len(owners)), dtype=np.bool_)
    now[asks, column[asks]] = True
    partly = belief.held[near].any(axis=0) & ~belief.held[near].all(axis=0)
    work = np.concatenate((now, belief.held[:, partly]), axis=1)

    def merge(senders: Indices, receivers: Indices) -> Mask:
        """Add each receiver's new reading and its senders' readings to its own readings."""
        changed, order = np.zeros(count, dtype=np.bool_), np.argsort(receivers, kind="stable")
        first = np.flatnonzero(np.diff(receivers[order], prepend=NONE))
        if len(first):
            who = receivers[order][first]
            before = work[who]
            after = before | np.logical_or.reduceat(work[senders[order]], first, axis=0)
            after[np.arange(len(who)), column[who]] = True
            work[who], changed[who] = after, (after != before).any(axis=1)
        return changed

    messages = medium.flood(asks, merge, asks)
    loud = signal > sensing.detection_std * sensing.sensor.noise_std
    loud &= ~belief.excluded.diagonal()
    fresh = work[:, : len(owners)] & ~belief.excluded[:, owners]
    # Without a detection the event may just have ended; such readings would bias the estimate.
    hears: Mask = np.asarray(fresh[:, loud[owners]].any(axis=1), dtype=np.bool_)
    held = belief.held.copy()
    held[:, partly] = work[:, len(owners) :]
    held = np.concatenate((held, fresh & hears[:, None]), axis=1)
    steps = np.concatenate((belief.steps, np.full(len(owners), step, dtype=np.intp)))
    taken_by = np.concatenate((belief.owners, owners))
    new = single_readings(agents_m[owners], signal[owners])
    heard = np.where(hears | loud, step, belief.heard)
    kept = np.asarray(held.any(axis=0), dtype=np.bool_)
    if sensing.memory_s is not None:
        kept &= (step - steps) * time_step_s < sensing.memory_s
    readings = taken(joined((belief.readings, new)), kept)
    return replace(
        belief, steps=steps[kept], owners=taken_by[kept], readings=readings, held=held[:, kept],
        heard=heard,
    ), messages  # fmt: skip


def doubt_sensors(
    belief: Belief,
    sensing: Sensing,
    hull: ConvexRegion,
    agents_m: Floats,  # (n, 2)
    signal: Floats,  # (n,)
    asks: Mask,
    step: int,
) -> Belief:
    """Test the step's readings at requesting agents; drop readings that are faulty or outdated."""
    doubts, since = belief.doubts.copy(), belief.since.copy()
    now = belief.held & (belief.steps == step)
    for rows, agents in _groups(now, asks & now.any(axis=1)):
        fresh, mine, level = taken(belief.readings, rows), int(belief.chosen[agents[0]]), 1.0
        if mine != NONE:
            level = misfit_level(fresh, sensing, belief.estimates[mine].value)
            if level > GLOBAL_LEVEL:
                continue
        found = faulty_reading(fresh, sensing, hull)
        if found != NONE:
            doubts[agents, belief.owners[rows][found]] += 1
        elif level < OUTLIER_LEVEL and sensing.memory_s is None:
            group = np.isin(np.arange(len(asks)), agents)
            for every, same in _groups(belief.held, group):
                # An uncertain estimate is not refuted if another position explains all readings.
                joint = _located(
                    taken(belief.readings, every), np.zeros(int(every.sum())), sensing, hull, None
                )
                if misfit_level(fresh, sensing, joint) < OUTLIER_LEVEL:
                    since[same] = step
    doubted = replace(belief, doubts=doubts)
    # If only others still report detections, an agent refutes the event by its own reading.
    last = np.where(belief.held, belief.steps, NEVER).max(axis=1, initial=NEVER)
    silent = asks & belief.known & (step - last >= sensing.silent_steps)
    silent &= step - belief.heard < sensing.silent_steps
    silent &= ~belief.explains(sensing, agents_m, signal) & ~doubted.excluded.diagonal()
    since[silent] = step
    if sensing.memory_s is not None:
        since = belief.since
    valid = ~doubted.excluded[:, belief.owners] & (belief.steps >= since[:, None])
    return replace(doubted, since=since, held=belief.held & valid)


def _groups(held: Mask, agents: Mask) -> list[tuple[Mask, list[int]]]:
    """Return the distinct rows of the mask `held` (n, r), each with its agents."""
    groups: dict[bytes, list[int]] = {}
    for agent in np.flatnonzero(agents).tolist():
        groups.setdefault(held[agent].tobytes(), []).append(agent)
    return [(held[same[0]], same) for same in groups.values()]


def estimate_event(
    belief: Belief, sensing: Sensing, hull: ConvexRegion, asks: Mask, step: int, time_step_s: float
) -> Belief:
    """Update the estimate of each requesting agent from the agent's own readings."""
    moves = sensing.speed_std_m_s is not None
    fresh = belief.held if moves else belief.held[:, belief.steps == step]
    # Agents with equal readings have equal estimates.
    groups = _groups(belief.held, asks & fresh.any(axis=1))
    if not groups:
        return belief
    ranked = belief.groups(belief.known)
    for rows, agents in groups:
        mine = int(belief.chosen[agents[0]])
        last = None if mine == NONE else belief.estimates[mine].value
        age_s = time_step_s * (step - belief.steps[rows]).astype(np.float64)
        found = _located(taken(belief.readings, rows), age_s, sensing, hull, last)
        size = int(rows.sum())
        rank = (size, step) if sensing.memory_s is None else (step, size)
        excluded = int(belief.excluded[agents[0]].sum())
        since = int(belief.since[agents[0]])
        source = size, int(belief.steps[rows].min()), step
        ranked.append((Estimate((since, excluded, *rank), found, source), np.array(agents)))
    ranked.sort(key=lambda one: one[0].rank)
    chosen = np.full(len(belief.chosen), NONE, dtype=np.intp)
    for number, (_, agents) in enumerate(ranked):
        chosen[agents] = number
    return replace(belief, estimates=tuple(one[0] for one in ranked), chosen=chosen)


def _located(
    readings: Readings,
    ages_s: Floats,
    sensing: Sensing,
    hull: ConvexRegion,
    last: EventEstimate | None,
) -> EventEstimate:
    """Locate an event from readings of given ages; `last` is an earlier estimate."""
    drift = None
    if sensing.speed_std_m_s is None:
        readings = pooled([readings])
    else:
        # The signal of a moving event changes, so readings at one position are not averaged.
        guess = np.zeros(2) if last is None else last.velocity_m_s
        drift = Drift(ages_s, sensing.speed_std_m_s, guess)
    near = None
    if last is not None and len(readings.signal) > GRID_READINGS:
        near = np.concatenate((last.position_m[None], last.rivals_m))
    return locate_event(
        sensing.sensor, readings, hull, strength_known=sensing.strength_known, near_m=near,
        drift=drift,
    )  # fmt: skip


def share_estimates(
    belief: Belief, medium: Medium, step: int, silent_steps: int
) -> tuple[Belief, int]:
    """Exchange estimates and detection times; return the belief and the number of messages."""
    doubted = belief.doubts.any(axis=0)
    known = np.column_stack((belief.chosen, belief.heard, belief.since, belief.doubts[:, doubted]))

    def merge(senders: Indices, receivers: Indices) -> Mask:
        """Raise each receiver's rank, times and doubts to the maximum over its senders."""
        before = known.copy()
        np.maximum.at(known, receivers, before[senders])
        return np.asarray((known != before).any(axis=1), dtype=np.bool_)

    active = (belief.chosen != NONE) & (step - belief.heard < silent_steps)
    messages = medium.flood(active | (belief.since == step), merge)
    (chosen, heard, since), doubts = known[:, :3].T, belief.doubts.copy()
    doubts[:, doubted] = known[:, 3:]
    made = np.array([*(each.rank[0] for each in belief.estimates), NEVER])
    chosen = np.where(made[chosen] < since, NONE, chosen)  # Refuted meanwhile
    shared = replace(belief, chosen=chosen, heard=heard, since=since, doubts=doubts)
    return shared.of((chosen != NONE) & (step - heard < silent_steps)), messages


@dataclass(frozen=True, eq=False)
class Team:
    """Agents that respond to one event and have the same view of their team."""

    event: int
    agents: Indices  # (a,) agents with this view
    members: Indices  # (m,) agents that they expect to respond


@dataclass(frozen=True, eq=False)
class Response:
    """Decisions of `n` agents on `k` events."""

    states: Indices  # (n,) event that each agent responds to; `NONE` if it covers
    shares: Indices  # (n, k) number of agents that each agent expects to respond to each event
    wanted: Indices  # (k,) demand of each event, evaluated by the nearest agent that knows it
    teams: tuple[Team, ...]
    messages: int


def choose_teams(
    beliefs: Sequence[Belief],
    ground: Ground,
    medium: Medium,
    demands: Sequence[Demand],
    counts: Floats,  # (n,) each agent's estimate of the number of members; NaN without one
    agents_m: Floats,  # (n, 2)
    states: Indices,  # (n,) event that each agent responded to in the last step
    hysteresis_m: float,
) -> Response:
    """Let each agent choose its event from its own belief and its lists of nearest agents."""
    agents, events = len(counts), len(beliefs)
    known = np.array([belief.known for belief in beliefs]).reshape(events, agents).T
    distances = np.full((agents, events), np.inf)
    for number, belief in enumerate(beliefs):
        for estimate, who in belief.groups(belief.known):
            place = estimate.value.position_m[None]
            distances[who, number] = ground.distances_m(agents_m[who], place)[:, 0]
    nearest = distances.argmin(axis=0)
    wants, shares = _shares(known, demands, counts)
    wanted = np.where(known.any(axis=0), wants[nearest, np.arange(events)], 0)
    distances += hysteresis_m * (states[:, None] != np.arange(events))
    lists: list[tuple[Indices, ...]] = []
    flagged, messages = np.zeros((agents, events), dtype=np.bool_), 0
    for number in range(events):
        found = propagate_flags(medium, distances[:, number], shares.sum(axis=1))
        lists.append(found.lists)
        flagged[:, number], messages = found.flagged, messages + found.messages
    views: dict[bytes, list[int]] = {}  # Agents with equal lists decide equally
    for agent in np.flatnonzero(flagged.any(axis=1)).tolist():
        own = [known[agent], shares[agent], *(lists[k][agent] for k in range(events))]
        views.setdefault(b"|".join(each.tobytes() for each in own), []).append(agent)
    after, teams = np.full(agents, NONE, dtype=np.intp), list[Team]()
    for same in views.values():
        mine = np.flatnonzero(known[same[0]])
        listed = np.unique(np.concatenate([lists[k][same[0]] for k in mine.tolist()]))
        match = deferred_acceptance(distances[np.ix_(listed, mine)], shares[same[0], mine])
        event_of = np.full(agents, NONE, dtype=np.intp)
        event_of[listed[match != NONE]] = mine[match[match != NONE]]
        after[same] = event_of[same]
        for number in range(events):
            who = np.array(same)[event_of[same] == number]
            if len(who):
                teams.append(Team(number, who, np.flatnonzero(event_of == number)))
    return Response(after, shares, wanted, tuple(teams), messages)


def _shares(known: Mask, demands: Sequence[Demand], counts: Floats) -> tuple[Indices, Indices]:
    """Return each agent's demands (n, k) for the events it knows, and the fair shares (n, k)."""
    wants, shares = (np.zeros(known.shape, dtype=np.intp) for _ in range(2))
    done: dict[tuple[bytes, int], tuple[Indices, Indices]] = {}
    for agent in np.flatnonzero(known.any(axis=1) & np.isfinite(counts)).tolist():
        count = round(counts[agent])
        key = known[agent].tobytes(), count
        if key not in done:
            want = [
                demanded(demands[k], count) if known[agent, k] else 0 for k in range(len(demands))
            ]
            done[key] = np.array(want, dtype=np.intp), fair_shares(np.array(want), count)
        wants[agent], shares[agent] = done[key]
    return wants, shares


GLOBAL_LEVEL = 1e-3  # Level of the test whether all readings of a step fit one event, or none
OUTLIER_LEVEL = 1e-6
"""Level at which a single reading is an outlier, and at which readings refute an estimate."""
OUTLIER = float(chdtri(1, OUTLIER_LEVEL))
"""Decrease of the misfit above which a single reading is an outlier."""
CONTRADICTIONS = 3  # Number of contradictions after which a sensor is excluded


def taken(readings: Readings, rows: Mask) -> Readings:
    """Return the readings that the mask `rows` selects."""
    return Readings(readings.positions_m[rows], readings.signal[rows], readings.counts[rows])


def misfit_level(readings: Readings, sensing: Sensing, event: EventEstimate) -> float:
    """Return the significance level at which the readings of one step refute an estimate."""
    away_m = np.linalg.norm(readings.positions_m - event.position_m, axis=1)
    expected = event.strength * sensing.sensor.profile(away_m)
    misfit = float((((readings.signal - expected) / sensing.sensor.noise_std) ** 2).sum())
    return float(chdtrc(len(readings.signal), misfit))


def faulty_reading(readings: Readings, sensing: Sensing, hull: ConvexRegion) -> int:
    """Return the index of the reading that contradicts the other readings, else `NONE`.

    The test is that of equation (7.22).

    Parameters
    ----------
    readings, sensing, hull
        Readings of one step, the sensor's model, and the region that contains the event.

    Examples
    --------
    >>> from planopt.coverage import EventSensor, convex_region, single_readings
    >>> import numpy as np
    >>> square = convex_region(np.array([[0, 0], [40, 0], [40, 40], [0, 40]]))
    >>> places_m = np.array([[20.0, 20.0], [21.0, 20.0], [20.0, 21.0], [30.0, 30.0]])
    >>> readings = single_readings(places_m, np.array([0.1, 54.0, -0.2, 0.3]))
    >>> faulty_reading(readings, Sensing(EventSensor(0.5, 60.0, 3.0)), square)
    1
    """
    count, deviation = len(readings.signal), readings.signal / sensing.sensor.noise_std
    every = _misfit(readings, deviation, sensing, hull)
    if count < 3 or every < float(chdtri(count, GLOBAL_LEVEL)):
        return NONE
    rest = np.array(
        [
            _misfit(taken(readings, kept), deviation[kept], sensing, hull)
            for kept in ~np.eye(count, dtype=np.bool_)
        ]
    )
    best, second = np.sort(rest)[:2]
    # If removal of either of two readings fits nearly as well, the fault is ambiguous.
    found = every - best > OUTLIER and second - best > RIVAL
    return int(rest.argmin()) if found else NONE


def _misfit(readings: Readings, deviation: Floats, sensing: Sensing, hull: ConvexRegion) -> float:
    """Return the smaller misfit of readings: without an event, or with one at its best position."""
    silent = float((deviation**2).sum())
    if silent < OUTLIER:
        return silent
    event = locate_event(sensing.sensor, readings, hull, strength_known=sensing.strength_known)
    return min(silent, event.misfit)
