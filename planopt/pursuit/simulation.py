"""Simulation of pursuits in common time steps, with captures detected within a step."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from planopt.arrays import Floats, Indices, finite_array
from planopt.errors import InputError
from planopt.pursuit.arena import Arena
from planopt.pursuit.certificate import Distances
from planopt.pursuit.detection import RecordSource
from planopt.pursuit.evaders import Behaviour, EvaderView
from planopt.pursuit.pursuers import (
    Driver,
    Mate,
    Motion,
    Policy,
    PursuerView,
    Quest,
    StraightMotion,
)
from planopt.pursuit.service import Record, SnapshotService, Track, UpdateRule, record_floods

STEP_PIECES = 4  # Number of straight segments of a pursuer's step on which captures are detected
STATE = "give x and y in metres, and the heading in rad of a unicycle"
"""Remedy for an invalid state of a pursuer."""
UNKNOWN_M = 1e12
"""Distance assigned to an evader without a record; the assignment needs finite values."""


@dataclass(frozen=True, eq=False)
class Pursuer:
    """Start, motion and policy of a pursuer."""

    start_m: Floats  # (2,)
    motion: Motion
    policy: Policy


@dataclass(frozen=True, eq=False)
class Evader:
    """Start, speed and behaviour of an evader, a single integrator."""

    start_m: Floats  # (2,)
    speed_max_m_s: float
    behaviour: Behaviour


@dataclass(frozen=True, eq=False)
class Scene:
    """Problem of a pursuit: arena, pursuers, evaders and settings."""

    pursuers: tuple[Pursuer, ...]  # At least one pursuer and one evader
    evaders: tuple[Evader, ...]
    source: RecordSource  # Source of the pursuers' records
    capture_radius_m: float  # Distance at which a pursuer captures an evader
    step_s: float
    max_steps: int
    arena: Arena = field(default_factory=Arena)


@dataclass(frozen=True, eq=False)
class Use:
    """First use of a record by a pursuer."""

    pursuer: int  # Index
    evader: int
    time_s: float
    place_m: Floats  # (2,) position of the pursuer at that time
    record: Record
    sampled_m: Floats  # (2,) true position of the evader at the sample time

    @property
    def age_s(self) -> float:
        """Return the age of the record at its first use."""
        return self.time_s - self.record.sampled_s

    @property
    def distance_m(self) -> float:
        """Return the pursuer's distance from the evader's sampled position."""
        return float(np.linalg.norm(self.place_m - self.sampled_m))


@dataclass(frozen=True, eq=False)
class Pursuit:
    """Course of a pursuit with p pursuers, e evaders and n steps."""

    scene: Scene
    times_s: Floats  # (n + 1,)
    pursuers: tuple[Floats, ...]  # States (n + 1, s) of each pursuer
    evaders_m: Floats  # (e, n + 1, 2); captured evaders stay at rest
    chased: NDArray[np.int64]  # (p, n) index of the evader that each pursuer chased
    aims_m: Floats  # (p, n, 2) point that each pursuer drove to
    capture_s: Floats  # (e,) infinite if never captured
    captors: NDArray[np.int64]  # (e,) -1 if never captured
    uses: tuple[Use, ...]  # Records in the order of first use

    @property
    def outcome(self) -> str:
        """Return ``captured`` if all evaders were captured, otherwise ``step_limit``."""
        return "captured" if np.isfinite(self.capture_s).all() else "step_limit"

    def blocks(self, service: SnapshotService, rule: UpdateRule) -> int:
        """Return the number of blocks sent to flood the reports on all evaders under `rule`."""
        receivers = [
            (Track(self.times_s, states[:, :2]), each.motion.speed_max_m_s)
            for states, each in zip(self.pursuers, self.scene.pursuers, strict=True)
        ]
        tracks, lasts_s = (Track(self.times_s, each) for each in self.evaders_m), self.times_s[-1]
        return sum(
            int((area[1] - area[0] + 1).prod())
            for track in tracks
            for *_, area in record_floods(service, track, lasts_s, rule, receivers)
        )

    def bounds_m(
        self, pursuer: int, evader: int, distances: Distances = Distances.STRAIGHT
    ) -> Floats:
        """Return the distance bound (k,) at the start of each stage of a chase."""
        speed = self.scene.evaders[evader].speed_max_m_s
        own = [use for use in self.uses if (use.pursuer, use.evader) == (pursuer, evader)]
        return np.array([self.away_m(use, distances) + speed * use.age_s for use in own])

    def away_m(self, use: Use, distances: Distances) -> float:
        """Return the pursuer's distance from the sampled position at the first use of a record."""
        if distances is Distances.STRAIGHT:
            return use.distance_m
        return float(self.scene.arena.distances_m(use.place_m, use.sampled_m[None])[0])

    @property
    def capture_time_s(self) -> float:
        """Return the time of the last capture; infinite if any evader was not captured."""
        return float(self.capture_s.max())


Reports = Callable[[int, int, Record | None], Record | None]
"""Function of pursuer index, evader index and record in use that returns the current record."""


@dataclass(frozen=True, eq=False)
class PursuitStep:
    """Decisions of all pursuers in one step."""

    chased: NDArray[np.int64]  # (p,) index of the chased evader; -1 for none
    aims_m: Floats  # (p, 2) point to drive to
    # Pursuer index, evader index and record, for each record newly taken into use
    records: tuple[tuple[int, int, Record], ...]


class PursuitController:
    """Step-by-step decisions of pursuers, in a simulation or in a user's own loop.

    Each pursuer chases one evader until it is captured. Initially pairs are assigned to minimise
    the total distance according to the first records; later, a free pursuer takes the nearest
    evader that no other chases, or else the nearest one. Each call of :meth:`step` is one step of
    ``scene.step_s`` seconds.

    Parameters
    ----------
    scene
        Arena and pursuers, with their motion and behaviour.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._drivers: list[Driver | None] = [None] * len(scene.pursuers)
        self._chased = np.full(len(scene.pursuers), -1)
        self._aims_m = [each.start_m for each in scene.pursuers]
        self._steps = 0

    def step(
        self,
        states: Sequence[ArrayLike],
        reports: Mapping[tuple[int, int], Record | None],
        captured: Collection[int] = (),
    ) -> PursuitStep:
        """Return the points that pursuers drive to in the next step.

        Parameters
        ----------
        states
            State of each pursuer: x and y in metres (clipped to the bounds), heading of a unicycle.
        reports
            Latest records by pursuer and evader index. Sample times count from the first step.
        captured
            Indices of captured evaders.

        Raises
        ------
        InputError
            The states are not one finite state per pursuer, a pursuer is in an obstacle, a record
            or an index is invalid, or all evaders are captured.
        """
        pursuers, evaders = self.scene.pursuers, range(len(self.scene.evaders))
        rows = list(states) if np.iterable(states) else []
        if len(rows) != len(pursuers):
            words = f"has {len(rows)} entries for {len(pursuers)} pursuers"
            raise InputError(words, key="states", remedy="give a list, one state for each pursuer")
        now = [
            finite_array(f"states[{number}]", state, each.motion.start(each.start_m).shape, STATE)
            for number, (each, state) in enumerate(zip(pursuers, rows, strict=True))
        ]
        arena = self.scene.arena
        now = [np.concatenate((arena.within(state[:2]), state[2:])) for state in now]
        for number, (x, y, *_) in enumerate(now):
            if not arena.is_free(np.array((x, y)), 0.0):
                key, words = f"states[{number}]", f"is at ({x:g}, {y:g}) m, in an obstacle"
                raise InputError(words, key=key, remedy="correct the position or the obstacle")
        caught = list(captured) if np.iterable(captured) else [captured]
        if any(each not in evaders for each in caught):
            raise InputError(
                f"is {captured!r}, should contain only indices of evaders",
                key="captured",
                remedy=f"give a list of numbers below {len(evaders)}",
            )
        left = np.setdiff1d(evaders, np.array(caught, dtype=np.intp))
        if not len(left):
            words = "contains all evaders, so the pursuit is over"
            raise InputError(words, key="captured", remedy="call no further steps")
        pairs, table = set(np.ndindex(len(pursuers), len(evaders))), cast("object", reports)
        if not isinstance(table, Mapping) or not pairs.issuperset(cast("Any", table)):
            raise InputError(
                "is not a dictionary with keys (pursuer index, evader index)",
                key="reports",
                remedy="give records by these keys, such as {(0, 0): record}",
            )
        given = {pair: each for pair, each in reports.items() if each is not None}
        records = {pair: self._valid(f"reports[{pair}]", each) for pair, each in given.items()}
        return self.decide(now, lambda pursuer, evader, _: records.get((pursuer, evader)), left)

    def _valid(self, key: str, record: Record) -> Record:
        """Return a user's record; raise an `InputError` if it is invalid."""
        if not isinstance(cast("object", record), Record):
            raise InputError(
                f"is of type {type(record).__name__}",
                key=key,
                remedy="give a planopt.problems.Record, or None without a report",
            )
        place_m = finite_array(f"{key}.reported_m", record.reported_m, (2,), "give x and y")
        numbers, now_s = (record.sampled_s, record.error_m), self._steps * self.scene.step_s
        sampled_s, error_m = finite_array(key, numbers, (2,), "give sampled_s and error_m")
        if sampled_s > now_s + 1e-6 or error_m < 0.0:
            raise InputError(
                f"has the sample time {sampled_s:g} s at {now_s:g} s, and the error {error_m:g} m",
                key=key,
                remedy="give a sample time that is not in the future, and an error of at least 0",
            )
        return record if place_m is record.reported_m else replace(record, reported_m=place_m)

    def decide(
        self,
        states: Sequence[Floats],
        reports: Reports,
        left: Indices,  # Evaders not yet captured
    ) -> PursuitStep:
        """Return the points that pursuers drive to in the next step, from validated arguments."""
        self._assign(states, reports, left)
        step_s, pursuers = self.scene.step_s, self.scene.pursuers
        taken = list[tuple[int, int, Record]]()
        for number, (driver, state) in enumerate(zip(self._drivers, states, strict=True)):
            if driver is None:
                self._aims_m[number] = state[:2]
                continue
            before, evader = driver.record, int(self._chased[number])

            def ask(held: Record | None, number: int = number, evader: int = evader):
                return reports(number, evader, held)

            mates = [
                Mate(states[k][:2], self._aims_m[k], mate.motion.speed_max_m_s, own.record)
                for k, (mate, own) in enumerate(zip(pursuers, self._drivers, strict=True))
                if k != number and own is not None and self._chased[k] == evader
            ]
            view = PursuerView(self._steps * step_s, step_s, state, ask, mates)
            self._aims_m[number] = driver.aim_m(view)
            if driver.record is not None and driver.record is not before:
                taken.append((number, evader, driver.record))
        self._steps += 1
        return PursuitStep(self._chased.copy(), np.array(self._aims_m), tuple(taken))

    def _assign(self, states: Sequence[Floats], reports: Reports, left: Indices) -> None:
        """Assign an evader to every pursuer without one."""
        free = [number for number, evader in enumerate(self._chased.tolist()) if evader not in left]
        if not free:
            return
        chased = set(np.delete(self._chased, free).tolist())

        def away_m(pursuer: int, evader: int) -> float:
            found = reports(pursuer, evader, None)
            if found is None:
                return UNKNOWN_M
            return float(np.linalg.norm(found.reported_m - states[pursuer][:2]))

        apart_m = np.array([[away_m(number, e) for e in left.tolist()] for number in free])
        alone = np.array([evader not in chased for evader in left.tolist()])
        self._chased[free] = left[apart_m.argmin(axis=1)]
        if alone.any():
            rows, columns = cast(
                "tuple[Indices, Indices]", linear_sum_assignment(apart_m[:, alone])
            )
            self._chased[np.array(free)[rows]] = left[alone][columns]
        fastest = max(each.speed_max_m_s for each in self.scene.evaders)
        for number in free:
            each = self.scene.pursuers[number]
            quest = Quest(each.motion, fastest, self.scene.arena, self.scene.capture_radius_m)
            self._drivers[number] = each.policy(quest)


def simulate_pursuit(
    scene: Scene, generator: np.random.Generator, on_step: Callable[[], None] = lambda: None
) -> Pursuit:
    """Simulate a pursuit until all evaders are captured or `max_steps` is reached."""
    steps, step_s, count = scene.max_steps, scene.step_s, len(scene.evaders)
    times_s = np.linspace(0.0, steps * step_s, steps + 1)
    states = [np.tile(each.motion.start(each.start_m), (steps + 1, 1)) for each in scene.pursuers]
    places = np.empty((count, steps + 1, 2))
    places[:, 0] = [each.start_m for each in scene.evaders]
    chased = np.full((len(states), steps), -1)
    aims_m = np.zeros((len(states), steps, 2))
    capture_s, captors = np.full(count, np.inf), np.full(count, -1)
    uses: list[Use] = []
    behaviours = [each.behaviour.begin(generator) for each in scene.evaders]
    controller = PursuitController(scene)
    fastest = max(each.motion.speed_max_m_s for each in scene.pursuers)
    step, tracks = 0, list[Track]()

    def report(pursuer: int, evader: int, held: Record | None) -> Record | None:
        here_m, pair = states[pursuer][step, :2], (pursuer, evader)
        return scene.source.record(tracks, pair, here_m, float(times_s[step]), held)

    while step < steps and np.isinf(capture_s).any():
        now = [each[step] for each in states]
        here_m = np.array([state[:2] for state in now])
        tracks = [Track(times_s[: step + 1], each[: step + 1]) for each in places]
        decided = controller.decide(now, report, np.flatnonzero(np.isinf(capture_s)))
        chased[:, step], aims_m[:, step] = decided.chased, decided.aims_m
        for pursuer, evader, record in decided.records:
            sampled_m = tracks[evader].at(np.array(record.sampled_s))
            time_s = float(times_s[step])
            uses.append(Use(pursuer, evader, time_s, here_m[pursuer], record, sampled_m))
        for number, each in enumerate(scene.evaders):
            place = there = places[number, step]
            if np.isinf(capture_s[number]) and each.speed_max_m_s > 0.0:
                view = EvaderView(
                    *(place, each.speed_max_m_s, here_m, decided.aims_m, fastest, step_s),
                    scene.arena,
                )
                wanted = behaviours[number](view)
                there = StraightMotion(each.speed_max_m_s).towards(place, wanted, step_s)
            places[number, step + 1] = there
        for number, (each, aim) in enumerate(zip(scene.pursuers, decided.aims_m, strict=True)):
            states[number][step + 1] = each.motion.towards(now[number], aim, step_s)
        for evader in np.flatnonzero(np.isinf(capture_s)).tolist():
            begin, end = places[evader, step : step + 2]
            shares = [
                _captured_after(scene, each.motion, now[number], aims_m[number, step], begin, end)
                for number, each in enumerate(scene.pursuers)
            ]
            share = min(shares)
            if np.isfinite(share):
                capture_s[evader] = times_s[step] + share * step_s
                captors[evader] = int(np.argmin(shares))
                places[evader, step + 1] = begin + share * (end - begin)
        step += 1
        on_step()
    return Pursuit(
        scene,
        times_s[: step + 1],
        tuple(each[: step + 1] for each in states),
        places[:, : step + 1],
        chased[:, :step],
        aims_m[:, :step],
        capture_s,
        captors,
        tuple(uses),
    )


def _captured_after(
    scene: Scene, motion: Motion, state: Floats, aim_m: Floats, begin_m: Floats, end_m: Floats
) -> float:
    """Return the fraction of a step at which an evader is captured; infinite if it is not."""
    radius_m, step_s = scene.capture_radius_m, scene.step_s
    reach_m = radius_m + motion.speed_max_m_s * step_s + np.linalg.norm(end_m - begin_m)
    if np.linalg.norm(state[:2] - begin_m) > reach_m:
        return np.inf
    shares = np.linspace(0.0, 1.0, STEP_PIECES + 1)
    pursuer_m = [motion.towards(state, aim_m, share * step_s)[:2] for share in shares]
    apart_m = begin_m + shares[:, None] * (end_m - begin_m) - np.array(pursuer_m)
    piece = first_within(apart_m[:-1], apart_m[1:], radius_m)
    return float(((np.arange(STEP_PIECES) + piece) / STEP_PIECES).min())


def first_within(starts_m: Floats, ends_m: Floats, radius_m: float) -> Floats:
    """Return the fraction (k,) of each segment at which it comes within a radius of the origin."""
    # A fraction is the smaller root t of ``|start + t move| = radius``, 0 if the segment starts
    # within the radius, and infinite if it never comes that close.
    moves_m = ends_m - starts_m
    square = (moves_m * moves_m).sum(axis=1)
    half = (starts_m * moves_m).sum(axis=1)
    over = (starts_m * starts_m).sum(axis=1) - radius_m * radius_m
    inside = half * half - square * over
    share = (-half - np.sqrt(np.maximum(inside, 0.0))) / np.where(square > 0.0, square, 1.0)
    hits = (inside >= 0.0) & (share >= 0.0) & (share <= 1.0) & (square > 0.0)
    return np.where(over <= 0.0, 0.0, np.where(hits, share, np.inf))
