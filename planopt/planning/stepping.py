"""State of all robots between steps of a run: beliefs, tracks, plans and target estimates.

A robot's target filter uses its own measurements, the station's those from received packets
(equation 4.9). Packets with estimates carry all past measurements of their senders, so the station
does at least as well as by any fusion of several robots' estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.measurements import Measurements, join
from planopt.channel.posterior import Belief
from planopt.channel.posterior import update as update_belief
from planopt.objectives.measuring import MeasuringRule
from planopt.objectives.tracking import Held
from planopt.planning.free_space import free_target_path
from planopt.planning.plan import History, Plan, Rung, history_of
from planopt.planning.tolerances import STANDSTILL_M
from planopt.planning.values.context import Aim, target_model
from planopt.problems.problem import Problem, problem_at, problem_of_robot
from planopt.problems.settings import Packets
from planopt.targets.information_filter import (
    InformationState,
    Sensor,
    TargetModel,
    information_state,
    noise_covariance_m2,
    position_variance_m2,
    predict,
    predict_target,
    sensing_information,
    simulate_target,
    update,
)
from planopt.world.workspace import Obstacle

MOST_HELD = 8
"""Number of recent steps whose unsent measurements a plan considers; older ones hardly matter."""


@dataclass(frozen=True, eq=False)
class Sent:
    """Target measurements after one step, and whether their packets are delivered."""

    measured_m: Floats  # (n, 2) measured target positions
    positions_m: Floats  # (n, 2) positions of the robots
    seen: Mask  # (n,) whether a robot measured the target
    delivered: Mask  # (n,) whether its packet of this step is delivered


@dataclass(frozen=True, eq=False)
class TargetWatch:
    """Target track and all filters' estimates after some steps of a run."""

    model: TargetModel
    sensor: Sensor
    true_m: Floats  # (max_steps + 1, 2) true positions
    robots: tuple[InformationState, ...]  # Each robot's own filter
    station: InformationState  # The station's filter
    packets: Packets = "measurements"
    delay_steps: int = 0  # Packet delay in steps
    sent: tuple[Sent, ...] = ()  # Measurements and packets after each step
    # (steps, robots) whether the station has received the measurement
    known: Mask = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    # The station's filter at the start and after each step except the last
    past: tuple[InformationState, ...] = ()

    def expected_m(self, robot: int, steps: int) -> Floats:
        """Return the target track (steps, 2) that a robot predicts for the next steps."""
        state = self.robots[robot]
        return predict_target(self.model, state.mean, state.covariance, steps).positions_m

    @property
    def station_mean_m(self) -> Floats:
        """Return the station's estimate (2,) of the target's position."""
        return self.station.mean[:2]

    @property
    def station_variance_m2(self) -> float:
        """Return the trace of the station's covariance of the target's position (tr P)."""
        return float(position_variance_m2(self.station.matrix))


def watch_target(problem: Problem, generator: np.random.Generator) -> TargetWatch | None:
    """Return a random target path with an initial estimate; None without a target."""
    if _sensor(problem) is None or not problem.targets:
        return None
    target = problem.targets[0]
    start = np.array([*target.start_m, *target.velocity_m_s])
    steps = problem.planner.max_steps
    model = target_model(problem)
    path_m = free_target_path(problem, lambda: simulate_target(model, start, steps, generator))
    path_m = path_m[:, :2]
    return _first_watch(problem, path_m, generator.standard_normal(4))


def expected_target(problem: Problem) -> TargetWatch | None:
    """Return the target with the mean initial estimate, without noise; None without a target."""
    return _first_watch(problem, np.zeros((0, 2)), np.zeros(4))


def _sensor(problem: Problem) -> Sensor | None:
    """Return the sensor that tracks the target; None if there is none."""
    sensors = [term.sensor for term in problem.terms if term.sensor is not None]
    return sensors[0] if sensors else None


def _first_watch(problem: Problem, true_m: Floats, error: Floats) -> TargetWatch | None:
    """Return the initial state of all filters, with an error (4,) in standard deviations."""
    sensor = _sensor(problem)
    if sensor is None or not problem.targets:
        return None
    target = problem.targets[0]
    deviation = np.repeat([target.position_std_m, target.velocity_std_m_s], 2)
    start = np.array([*target.start_m, *target.velocity_m_s])
    first = information_state(start + deviation * error, np.diag(deviation**2))
    robots = (first,) * len(problem.robots)
    return TargetWatch(
        target_model(problem),
        sensor,
        true_m,
        robots,
        first,
        target.packets,
        target.packet_delay_steps,
    )


def aim_of(watch: TargetWatch | None, robot: int, steps: int) -> Aim:
    """Return the external inputs of a robot's objective over `steps` steps, without steering."""
    if watch is None:
        return Aim(None, None)
    expected_m = watch.expected_m(robot, steps)
    return Aim(expected_m, None, watch.station.matrix, held=_held(watch, robot))


def _held(watch: TargetWatch, robot: int) -> Held | None:
    """Return a robot's unsent measurements; None unless packets carry estimates."""
    if watch.packets != "estimates":
        return None
    count = len(watch.sent)
    seen = np.array([step.seen for step in watch.sent]).reshape(count, len(watch.robots))
    unknown = seen[:, robot] & ~watch.known[:, robot] if count else np.zeros(0, dtype=np.bool_)
    recent = np.flatnonzero(unknown[max(count - MOST_HELD, 0) :])
    first = max(count - MOST_HELD, 0) + int(recent[0]) if len(recent) else count
    states = (*watch.past, watch.station)
    known, sent = np.zeros((2, count - first))
    for number, step in enumerate(range(first, count)):
        ahead = predict(watch.model, states[step])
        each = 0.5 * sensing_information(watch.sensor, watch.sent[step].positions_m, ahead.mean[:2])
        known[number] = each @ watch.known[step]
        sent[number] = each[robot] * unknown[step]
    return Held(states[first].matrix, known, sent)


def counted(
    watch: TargetWatch,
    measured_m: Floats,  # (n, 2)
    positions_m: Floats,  # (n, 2) positions of the robots
    delivered: Mask,  # (n,) whether a robot's packet reaches the station
) -> TargetWatch:
    """Return target and filters after one more step, updated with measurements."""
    seen = np.asarray(np.isfinite(measured_m).all(axis=1), dtype=np.bool_)
    measured = np.where(seen[:, None], measured_m, positions_m)
    robots = tuple(
        _counted(watch, state, measured[i : i + 1], positions_m[i : i + 1], seen[i : i + 1])
        for i, state in enumerate(watch.robots)
    )
    arrives = np.asarray(delivered, dtype=np.bool_)
    sent = (*watch.sent, Sent(measured, positions_m, seen, arrives))
    known = _known(sent, watch.packets, watch.delay_steps)
    past = (*watch.past, watch.station)
    # Delayed packets also update the station's estimates after their steps.
    before = watch.known if len(watch.known) else known[:0]
    changed = np.flatnonzero((known[:-1] != before).any(axis=1))
    first = int(changed[0]) if len(changed) else len(known) - 1
    states = list(past[: first + 1])
    for step, arrived in zip(sent[first:], known[first:], strict=True):
        states.append(_counted(watch, states[-1], step.measured_m, step.positions_m, arrived))
    return replace(
        watch, robots=robots, station=states[-1], sent=sent, known=known, past=tuple(states[:-1])
    )


def _known(sent: Sequence[Sent], packets: Packets, delay_steps: int) -> Mask:
    """Return a mask (steps, robots) of the measurements that the station has received."""
    arrived = np.array([step.delivered for step in sent])
    arrived[len(sent) - min(delay_steps, len(sent)) :] = False
    if packets == "estimates":
        # An estimate includes all earlier measurements.
        arrived = np.logical_or.accumulate(arrived[::-1], axis=0)[::-1]
    return arrived & np.array([step.seen for step in sent])


def _counted(
    watch: TargetWatch,
    state: InformationState,
    measured_m: Floats,
    positions_m: Floats,
    delivered: Mask,
) -> InformationState:
    """Return a filter's state after one step, with noise for the predicted target position."""
    ahead = predict(watch.model, state)
    noise = noise_covariance_m2(watch.sensor, positions_m, ahead.mean[:2])
    return update(ahead, measured_m, noise, delivered)


def learn_measured(problem: Problem, belief: Belief, measured: Sequence[Measurements]) -> Belief:
    """Return a belief updated with the measurements that keep the spacing to earlier ones."""
    if not any(len(each) for each in measured):
        return belief
    rule = MeasuringRule.of(belief.posteriors, problem.channel.measure_spacing_m)
    taken = [each.take(rule.takes(each.positions_m)) for each in measured]
    return update_belief(belief, *taken) if any(map(len, taken)) else belief


@dataclass(frozen=True, eq=False)
class TeamMoment:
    """Input of a planning step: all robots' states, beliefs, tracks and previous plans."""

    beliefs: Sequence[Belief]
    states: Sequence[Floats]  # (s,)
    watched: Sequence[Aim]  # External inputs of the objectives
    histories: Sequence[History]
    warm: Sequence[Plan | None]  # Previous plans
    driven_m: Sequence[Floats] = ()  # (k, 2) positions after the steps so far

    @property
    def driven(self) -> int:
        """Number of steps of the run so far."""
        return self.histories[0].steps


PlanStep = Callable[[TeamMoment], tuple[list[Plan], list[Aim]]]
"""Function that maps a `TeamMoment` to one plan per robot and its objective's external inputs."""
Planning = Callable[[Problem, Sequence[Floats]], PlanStep]
"""Function that maps a problem with the obstacles known so far, and all states, to a `PlanStep`."""


class Stepper:
    """State of all robots of one run, updated by alternate planning and observation."""

    def __init__(
        self, problem: Problem, belief: Belief, planning: Planning, watch: TargetWatch | None
    ) -> None:
        numbers = range(len(problem.robots))
        self.states = [[robot.start_state] for robot in problem.robots]
        self._planning = planning
        self._know(problem)
        self.beliefs = [belief for _ in numbers]
        self.plans: list[list[Plan]] = [[] for _ in numbers]
        self.aims: list[list[Aim]] = [[] for _ in numbers]
        self.learnt: list[list[bool]] = [[] for _ in numbers]
        self.connected = np.zeros((0, len(numbers)), dtype=np.bool_)
        self._observed: list[bool] = []  # By step, whether the connections were observed
        self.watches = [watch]
        self._warm: list[Plan | None] = [None for _ in numbers]

    def kept(self) -> dict[str, Any]:
        """Return the state without its planner, to be copied to another process."""
        return {name: value for name, value in vars(self).items() if "_plan" not in name}

    @classmethod
    def restored(cls, kept: Mapping[str, Any], planning: Planning) -> Stepper:
        """Return a stepper from the state that :meth:`kept` returned, with a new planner."""
        made = cls.__new__(cls)
        vars(made).update(kept, _planning=planning)
        made._know(made.problem)
        return made

    def plan(self) -> list[Plan]:
        """Return a plan for each robot, from the current states."""
        now = problem_at(self.problem, len(self.connected))
        if now is not self.problem:
            self._know(now)
        warm = self._warm
        # An error leaves no previous plan.
        self._warm = [None for _ in warm]
        moment = TeamMoment(
            beliefs=self.beliefs,
            states=[driven[-1] for driven in self.states],
            watched=[
                aim_of(self.watches[-1], number, self.problem.planner.horizon)
                for number in range(len(self.owns))
            ],
            histories=[
                history_of(
                    own,
                    np.array(driven)[:, :2],
                    self.connected[:, number],
                    [plan.certificate for plan in made],
                    gave_way=[plan.rung is Rung.GIVE_WAY for plan in made],
                    observed=np.array(self._observed, dtype=np.bool_),
                )
                for number, (own, driven, made) in enumerate(
                    zip(self.owns, self.states, self.plans, strict=True)
                )
            ],
            warm=warm,
            driven_m=[np.array(driven)[1:, :2] for driven in self.states],
        )
        plans, aims = self._plan_step(moment)
        for number, (plan, aim) in enumerate(zip(plans, aims, strict=True)):
            self.plans[number].append(plan)
            self.aims[number].append(aim)
        self._warm = list(plans)
        return plans

    def _know(self, problem: Problem) -> None:
        """Adopt the workspace of `problem`, and create a new planner."""
        self._plan_step = self._planning(problem, [driven[-1] for driven in self.states])
        self.problem = problem
        self.owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]

    def add_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """Add newly discovered obstacles to the workspace."""
        now_s = len(self.connected) * self.problem.planner.step_s
        workspace = self.problem.workspace
        later = [replace(one, known_from_s=now_s) for one in obstacles]
        more = replace(workspace, timed=(*workspace.timed, *later))
        self.problem = replace(self.problem, workspace=more)

    def place(self, states: Sequence[Floats], measured: Sequence[Sequence[Measurements]]) -> None:
        """Set the initial states, and add measurements made at the start."""
        self.beliefs = self._learnt(measured)
        self.states = [[state] for state in states]

    def observe(
        self,
        states: Sequence[Floats],
        measured: Sequence[Sequence[Measurements]],
        connected: Sequence[bool] | Mask,
        target_m: Floats | None = None,  # (robots, 2)
        *,
        observed: bool = True,  # False for connections inferred from readings or predictions
    ) -> None:
        """Record the outcome of a step; if an error is raised, all robots stay unchanged."""
        beliefs = self._learnt(measured)
        links = np.vstack([self.connected, np.asarray(connected, dtype=np.bool_)])
        watch = self.watches[-1]
        if watch is not None:
            here = np.array([state[:2] for state in states])
            seen = np.full_like(here, np.nan) if target_m is None else target_m
            watch = counted(watch, seen, here, links[-1])
        for number, (state, belief) in enumerate(zip(states, beliefs, strict=True)):
            if not self._goes_on(number, state):
                self._warm[number] = None
            self.states[number].append(state)
            self.learnt[number].append(belief is not self.beliefs[number])
        self.beliefs, self.connected = beliefs, links
        self._observed.append(observed)
        self.watches.append(watch)

    def _learnt(self, measured: Sequence[Sequence[Measurements]]) -> list[Belief]:
        """Return the robots' beliefs, each updated with its own measurements of each station."""
        if self.problem.channel.share_measurements:
            # A shared belief needs only one update.
            taken = [each for each in measured if each]
            everyone = [reduce(join, station) for station in zip(*taken, strict=True)]
            return [learn_measured(self.problem, self.beliefs[0], everyone)] * len(self.beliefs)
        return [
            learn_measured(self.problem, belief, taken)
            for belief, taken in zip(self.beliefs, measured, strict=True)
        ]

    def _goes_on(self, number: int, state: Floats) -> bool:
        """Return whether a robot's state allows its previous plan to continue."""
        # Off its plan, a robot cannot drive the remainder, and other robots do not avoid it.
        plan, robot = self._warm[number], self.problem.robots[number]
        if plan is None:
            return False
        step_s = self.problem.planner.step_s
        unit = np.array(robot.dynamics.unit_m(step_s))
        if float(np.linalg.norm((state - plan.next_state) * unit)) <= STANDSTILL_M:
            return True
        return robot.moves_freely and not self.problem.has_separation
