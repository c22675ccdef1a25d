"""Pursuits in steps: evaders and pursuers move at once, and capture is looked for all along."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import (
    linear_sum_assignment,  # pyright: ignore[reportUnknownVariableType]
)

from planopt.errors import InputError
from planopt.pursuit.arena import Arena
from planopt.pursuit.evaders import Behaviour, Decide, EvaderView
from planopt.pursuit.motion import Motion, StraightMotion
from planopt.pursuit.pursuers import Driver, Policy, PursuerView, Quest
from planopt.pursuit.records import Record, RecordSource, Track
from planopt.pursuit.service import require_count, require_number
from planopt.pursuit.theorems import Distances

STEP_PIECES = 4
"""Pieces that a pursuer's step is cut into where capture is looked for: each counts as straight."""


@dataclass(frozen=True, eq=False)
class Pursuer:
    """A pursuer."""

    start_m: NDArray[np.float64]  # (2,)
    motion: Motion  # How it moves
    policy: Policy  # How it decides


@dataclass(frozen=True, eq=False)
class Evader:
    """An evader, a single integrator."""

    start_m: NDArray[np.float64]  # (2,)
    speed_max_m_s: float  # Largest speed
    behaviour: Behaviour  # How it decides


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything about a pursuit but its randomness."""

    pursuers: tuple[Pursuer, ...]  # At least one of each
    evaders: tuple[Evader, ...]
    source: RecordSource  # Where pursuers have their records from
    capture_radius_m: float  # An evader is caught once a pursuer is so near
    step_s: float  # Everybody decides so often
    max_steps: int  # It is given up after so many
    arena: Arena = field(default_factory=Arena)  # Where it takes place

    def __post_init__(self) -> None:
        if not self.pursuers or not self.evaders:
            raise InputError("a pursuit needs a pursuer and an evader", key="pursuers")
        require_number(self.capture_radius_m, "capture_radius_m", above=0.0)
        require_number(self.step_s, "step_s", above=0.0)
        require_count(self.max_steps, "max_steps", 1)
        for each in self.evaders:
            require_number(each.speed_max_m_s, "speed_max_m_s", least=0.0)


@dataclass(frozen=True, eq=False)
class Use:
    """A record that a pursuer began to use."""

    pursuer: int  # Their numbers
    evader: int
    time_s: float  # When and where
    place_m: NDArray[np.float64]
    record: Record  # What it was told
    sampled_m: NDArray[np.float64]  # (2,) where the evader truly was when it was sampled

    @property
    def age_s(self) -> float:
        """Return the age of the record."""
        return self.time_s - self.record.sampled_s

    @property
    def distance_m(self) -> float:
        """d: from the pursuer to where the evader was sampled."""
        return float(np.linalg.norm(self.place_m - self.sampled_m))


@dataclass(frozen=True, eq=False)
class Pursuit:
    """The course of a pursuit."""

    scene: Scene  # Who pursued whom
    times_s: NDArray[np.float64]  # (n + 1,)
    pursuers: tuple[NDArray[np.float64], ...]  # For each, its states (n + 1, s)
    evaders_m: NDArray[np.float64]  # (e, n + 1, 2); they stay where they are caught
    chased: NDArray[np.int64]  # (p, n) which evader each pursuer was after; -1 once all are caught
    aims_m: NDArray[np.float64]  # (p, n, 2) where each pursuer drove to in each step
    # (e,) when each evader was caught, infinite if never, and by whom, -1 if by nobody
    capture_s: NDArray[np.float64]
    captors: NDArray[np.int64]
    uses: tuple[Use, ...]  # Records in the order in which pursuers began to use them

    @property
    def outcome(self) -> str:
        """``captured`` if all evaders were, else ``step_limit``."""
        return "captured" if np.isfinite(self.capture_s).all() else "step_limit"

    def bounds_m(
        self, pursuer: int, evader: int, distances: Distances = Distances.STRAIGHT
    ) -> NDArray[np.float64]:
        """Return W at the start of each stage of a pursuer after an evader, ``(k,)``."""
        speed = self.scene.evaders[evader].speed_max_m_s
        return np.array(
            [
                self.away_m(use, distances) + speed * use.age_s
                for use in self.uses
                if (use.pursuer, use.evader) == (pursuer, evader)
            ]
        )

    def away_m(self, use: Use, distances: Distances) -> float:
        """Return d: straight, or the length of the shortest path, to where the evader was."""
        if distances is Distances.STRAIGHT:
            return use.distance_m
        return float(self.scene.arena.distances_m(use.place_m, use.sampled_m[None])[0])

    @property
    def capture_time_s(self) -> float:
        """Return the time of the last capture; infinite if one evader was not caught."""
        return float(self.capture_s.max())


def simulate_pursuit(
    scene: Scene, generator: np.random.Generator, on_step: Callable[[], None] = lambda: None
) -> Pursuit:
    """Run a pursuit until all evaders are captured or `max_steps` are over."""
    return _Run(scene, generator, on_step).finish()


Reports = Callable[[int, int, Record | None], Record | None]
"""Gives the record that a pursuer gets of an evader now, both by number, with the one in use."""


@dataclass(frozen=True, eq=False)
class PursuitStep:
    """The decisions of pursuers in one step."""

    chased: NDArray[np.int64]  # (p,) number of the evader that each pursues; -1 for none
    aims_m: NDArray[np.float64]  # (p, 2) where each drives to
    # Pursuer and evader of each record that was taken into use, and the record
    records: tuple[tuple[int, int, Record], ...]


class PursuitController:
    """The decisions of pursuers, step by step: a simulation's, or those of a user's loop.

    Each pursuer pursues one evader until that is captured: first the pairs that are together the
    least apart by their first records, then a free pursuer takes the nearest evader that no other
    pursues, or the nearest at all. Each call of :meth:`step` is one step of ``scene.step_s``
    seconds.

    Parameters
    ----------
    scene
        Pursuers, with how they move and decide, and the arena.
    generator
        Source of the randomness of policies.
    """

    def __init__(self, scene: Scene, generator: np.random.Generator) -> None:
        self.scene = scene
        self._generator = generator
        self._drivers: list[Driver | None] = [None] * len(scene.pursuers)
        self._after = np.full(len(scene.pursuers), -1)
        self._steps = 0

    def step(
        self,
        states: Sequence[ArrayLike],
        reports: Reports | Mapping[tuple[int, int], Record],
        captured: Collection[int] = (),
    ) -> PursuitStep:
        """Return where pursuers drive to in the next step.

        Parameters
        ----------
        states
            State of each pursuer: x and y in metres, and the heading of one that must turn.
        reports
            Records by the numbers of pursuer and evader, or a function that gives them.
        captured
            Numbers of the evaders that have been captured.

        Raises
        ------
        InputError
            There is not one finite state for each pursuer, or all evaders are captured.
        """
        pursuers = self.scene.pursuers
        sizes = [len(each.motion.start(each.start_m)) for each in pursuers]
        now = [np.asarray(state, dtype=np.float64) for state in states]
        if [each.shape for each in now] != [(size,) for size in sizes] or not all(
            np.isfinite(each).all() for each in now
        ):
            raise InputError(
                f"{len(now)} states for {len(pursuers)} pursuers, or of another size",
                key="states",
                remedy=f"give finite states of sizes {sizes}",
            )
        left = np.setdiff1d(np.arange(len(self.scene.evaders)), list(captured))
        if not len(left):
            raise InputError("are all evaders", key="captured", remedy="the pursuit is over")
        if callable(reports):
            return self.decide(now, reports, left)
        given = dict(reports)
        return self.decide(now, lambda pursuer, evader, _: given.get((pursuer, evader)), left)

    def decide(
        self,
        states: Sequence[NDArray[np.float64]],
        reports: Reports,
        left: NDArray[np.intp],  # Evaders that are not captured
    ) -> PursuitStep:
        """Return where pursuers drive to in the next step, from checked arguments."""
        self._assign(states, reports, left)
        time_s, aims = self._steps * self.scene.step_s, list[NDArray[np.float64]]()
        taken = list[tuple[int, int, Record]]()
        for number, (driver, state) in enumerate(zip(self._drivers, states, strict=True)):
            if driver is None:
                aims.append(state[:2])
                continue
            before, evader = driver.record, int(self._after[number])
            view = PursuerView(
                time_s,
                self.scene.step_s,
                state,
                lambda held, number=number, evader=evader: reports(number, evader, held),
            )
            aims.append(driver.aim_m(view))
            if driver.record is not None and driver.record is not before:
                taken.append((number, evader, driver.record))
        self._steps += 1
        return PursuitStep(self._after.copy(), np.array(aims), tuple(taken))

    def _assign(
        self,
        states: Sequence[NDArray[np.float64]],
        reports: Reports,
        left: NDArray[np.intp],
    ) -> None:
        """Give every pursuer without an evader one."""
        free = [number for number, evader in enumerate(self._after.tolist()) if evader not in left]
        if not free:
            return
        chased = set(np.delete(self._after, free).tolist())

        def away_m(pursuer: int, evader: int) -> float:
            """Return the distance to the reported evader."""
            found = reports(pursuer, evader, None)
            if found is None:
                # Farther than anything that is known, but not infinite: assignments need numbers.
                return 1e12
            return float(np.linalg.norm(found.reported_m - states[pursuer][:2]))

        apart_m = np.array([[away_m(number, e) for e in left.tolist()] for number in free])
        alone = np.array([evader not in chased for evader in left.tolist()])
        self._after[free] = left[apart_m.argmin(axis=1)]
        if alone.any():
            rows, columns = _assigned(apart_m[:, alone])
            self._after[np.array(free)[rows]] = left[alone][columns]
        for number in free:
            each = self.scene.pursuers[number]
            quest = Quest(
                each.motion,
                max(other.speed_max_m_s for other in self.scene.evaders),
                self.scene.capture_radius_m,
                self.scene.arena,
                self._generator,
            )
            self._drivers[number] = each.policy.begin(quest)


class _Run:
    """The world of a pursuit: positions so far, evaders, and captures."""

    def __init__(
        self, scene: Scene, generator: np.random.Generator, on_step: Callable[[], None]
    ) -> None:
        self._scene, self._generator, self._on_step = scene, generator, on_step
        steps, count = scene.max_steps, len(scene.evaders)
        self._times_s = np.linspace(0.0, steps * scene.step_s, steps + 1)
        self._states = [
            np.tile(each.motion.start(each.start_m), (steps + 1, 1)) for each in scene.pursuers
        ]
        self._places = np.empty((count, steps + 1, 2))
        self._places[:, 0] = [each.start_m for each in scene.evaders]
        self._decides: list[Decide] = [each.behaviour.begin(generator) for each in scene.evaders]
        self._controller = PursuitController(scene, generator)
        self._chased = np.full((len(scene.pursuers), steps), -1)
        self._aims_m = np.zeros((len(scene.pursuers), steps, 2))
        self._capture_s, self._captors = np.full(count, np.inf), np.full(count, -1)
        self._uses: list[Use] = []
        self._step = 0

    def finish(self) -> Pursuit:
        while self._step < self._scene.max_steps and np.isinf(self._capture_s).any():
            states = [each[self._step] for each in self._states]
            left = np.flatnonzero(np.isinf(self._capture_s))
            decided = self._controller.decide(states, self._report, left)
            aims = list(decided.aims_m)
            self._chased[:, self._step] = decided.chased
            self._aims_m[:, self._step] = aims
            self._uses += [self._use(*each) for each in decided.records]
            self._move_evaders(decided.aims_m)
            for number, each in enumerate(self._scene.pursuers):
                states = self._states[number]
                states[self._step + 1] = each.motion.towards(
                    states[self._step], aims[number], self._scene.step_s
                )
            self._note_captures(aims)
            self._step += 1
            self._on_step()
        end = self._step + 1
        return Pursuit(
            self._scene,
            self._times_s[:end],
            tuple(states[:end] for states in self._states),
            self._places[:, :end],
            self._chased[:, : self._step],
            self._aims_m[:, : self._step],
            self._capture_s,
            self._captors,
            tuple(self._uses),
        )

    def _track(self, evader: int) -> Track:
        end = self._step + 1
        return Track(self._times_s[:end], self._places[evader, :end])

    def _place_m(self, pursuer: int) -> NDArray[np.float64]:
        return self._states[pursuer][self._step, :2]

    def _report(self, pursuer: int, evader: int, held: Record | None) -> Record | None:
        return self._scene.source.record(
            self._track(evader), self._place_m(pursuer), float(self._times_s[self._step]), held
        )

    def _use(self, pursuer: int, evader: int, record: Record) -> Use:
        sampled_m = self._track(evader).at(np.array(record.sampled_s))
        time_s = float(self._times_s[self._step])
        return Use(pursuer, evader, time_s, self._place_m(pursuer), record, sampled_m)

    def _move_evaders(self, aims_m: NDArray[np.float64]) -> None:
        pursuers_m = np.array([self._place_m(number) for number in range(len(aims_m))])
        fastest = max(each.motion.speed_max_m_s for each in self._scene.pursuers)
        for number, each in enumerate(self._scene.evaders):
            here = self._places[number, self._step]
            there = here
            if np.isinf(self._capture_s[number]) and each.speed_max_m_s > 0.0:
                view = EvaderView(
                    here,
                    each.speed_max_m_s,
                    pursuers_m,
                    aims_m,
                    fastest,
                    self._scene.step_s,
                    self._scene.arena,
                )
                wanted = self._decides[number](view)
                there = StraightMotion(each.speed_max_m_s).towards(here, wanted, self._scene.step_s)
            self._places[number, self._step + 1] = there

    def _note_captures(self, aims: list[NDArray[np.float64]]) -> None:
        """Look for captures in the step that was just made; whoever is caught stays there."""
        step_s = self._scene.step_s
        for evader in np.flatnonzero(np.isinf(self._capture_s)).tolist():
            here, there = self._places[evader, self._step : self._step + 2]
            shares = [
                self._caught_after(number, aim, here, there) for number, aim in enumerate(aims)
            ]
            share = min(shares)
            if np.isfinite(share):
                self._capture_s[evader] = self._times_s[self._step] + share * step_s
                self._captors[evader] = int(np.argmin(shares))
                self._places[evader, self._step + 1] = here + share * (there - here)

    def _caught_after(
        self,
        number: int,
        aim_m: NDArray[np.float64],
        here_m: NDArray[np.float64],
        there_m: NDArray[np.float64],
    ) -> float:
        """The share of the step after which an evader is within the radius; infinite if never."""
        motion, radius_m = self._scene.pursuers[number].motion, self._scene.capture_radius_m
        state, step_s = self._states[number][self._step], self._scene.step_s
        reach_m = radius_m + motion.speed_max_m_s * step_s + np.linalg.norm(there_m - here_m)
        if np.linalg.norm(state[:2] - here_m) > reach_m:
            return np.inf
        shares = np.linspace(0.0, 1.0, STEP_PIECES + 1)
        pursuer_m = [motion.towards(state, aim_m, share * step_s)[:2] for share in shares]
        apart_m = here_m + shares[:, None] * (there_m - here_m) - np.array(pursuer_m)
        piece = first_within(apart_m[:-1], apart_m[1:], radius_m)
        when = (np.arange(STEP_PIECES) + piece) / STEP_PIECES
        return float(when.min())


def _assigned(
    costs: NDArray[np.float64],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the assignment of least total cost."""
    return cast("tuple[NDArray[np.intp], NDArray[np.intp]]", linear_sum_assignment(costs))


def first_within(
    starts_m: NDArray[np.float64], ends_m: NDArray[np.float64], radius_m: float
) -> NDArray[np.float64]:
    """Return after which share of straight ways (k, 2) the origin is within a radius; ``(k,)``.

    It is the smaller root t of ``|start + t way| = radius``, 0 if the way begins within it, and
    infinite if it never comes so near.
    """
    ways_m = ends_m - starts_m
    square = (ways_m * ways_m).sum(axis=1)
    half = (starts_m * ways_m).sum(axis=1)
    over = (starts_m * starts_m).sum(axis=1) - radius_m * radius_m
    inside = half * half - square * over
    share = (-half - np.sqrt(np.maximum(inside, 0.0))) / np.where(square > 0.0, square, 1.0)
    hits = (inside >= 0.0) & (share >= 0.0) & (share <= 1.0) & (square > 0.0)
    return np.where(over <= 0.0, 0.0, np.where(hits, share, np.inf))
