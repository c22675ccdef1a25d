"""Target filters of the robots and of their base station.

A robot's filter uses its own measurements. The station's filter uses those of received packets
(equation 4.9). Packets with estimates carry all past measurements of their senders, which bounds
any fusion of several robots' estimates. One generator draws all randomness about the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.tracking import Held
from planopt.planning.free_space import free_target_path
from planopt.planning.values.context import Aim, target_model
from planopt.problems.problem import Problem
from planopt.problems.settings import Packets
from planopt.targets.information_filter import (
    InformationState,
    TargetModel,
    information_state,
    position_variance_m2,
    predict,
    predict_target,
    simulate_target,
    update,
)
from planopt.targets.sensor import Sensor, noise_covariance_m2, sensing_information

MOST_HELD = 8
"""Number of recent steps whose unsent measurements a plan uses; older ones hardly matter."""


@dataclass(frozen=True, eq=False)
class Sent:
    """Target measurements after one step, and the delivery of their packets."""

    measured_m: NDArray[np.float64]  # (n, 2) measured target positions
    positions_m: NDArray[np.float64]  # (n, 2) positions of the robots
    seen: NDArray[np.bool_]  # (n,) whether a robot measured the target
    delivered: NDArray[np.bool_]  # (n,) whether its packet of this step is delivered


@dataclass(frozen=True, eq=False)
class TargetWatch:
    """Target and its estimates after some steps."""

    model: TargetModel
    sensor: Sensor
    true_m: NDArray[np.float64]  # (max_steps + 1, 2) true positions
    robots: tuple[InformationState, ...]  # Each robot's own filter
    station: InformationState  # The station's filter
    packets: Packets = "measurements"
    delay_steps: int = 0  # Packet delay in steps
    sent: tuple[Sent, ...] = ()  # Measurements and packets after each step
    # (steps, robots) whether the station has received the measurement
    known: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    # The station's filter at the start and after each step except the last
    past: tuple[InformationState, ...] = ()

    def expected_m(self, robot: int, steps: int) -> NDArray[np.float64]:
        """Return the target track (steps, 2) that a robot predicts from now."""
        state = self.robots[robot]
        return predict_target(self.model, state.mean, state.covariance, steps).positions_m

    @property
    def station_mean_m(self) -> NDArray[np.float64]:
        """Return the station's estimate (2,) of the target's position."""
        return self.station.mean[:2]

    @property
    def station_variance_m2(self) -> float:
        """Return the trace of the station's covariance of the target's position (tr P)."""
        return float(position_variance_m2(self.station.matrix))


def watch_target(problem: Problem, generator: np.random.Generator) -> TargetWatch | None:
    """Draw the target's path and its initial estimate; None for a problem without a target."""
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
    """Return the target with the problem's expected estimate, without draws; None without one."""
    return _first_watch(problem, np.zeros((0, 2)), np.zeros(4))


def _sensor(problem: Problem) -> Sensor | None:
    """Return the sensor that tracks the target; None if there is none."""
    sensors = [term.sensor for term in problem.terms if term.sensor is not None]
    return sensors[0] if sensors else None


def _first_watch(
    problem: Problem, true_m: NDArray[np.float64], error: NDArray[np.float64]
) -> TargetWatch | None:
    """Return the initial estimate of a target with an error (4,) in standard deviations."""
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
    """Return a robot's information that the station lacks; None unless packets carry estimates."""
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
    measured_m: NDArray[np.float64],  # (n, 2)
    positions_m: NDArray[np.float64],  # (n, 2) positions of the robots
    delivered: NDArray[np.bool_],  # (n,) whether a robot's packet reaches the station
) -> TargetWatch:
    """Return all filters one step later, updated with measurements of the target."""
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
    # Packets about earlier steps also update the station's later estimates.
    before = watch.known if len(watch.known) else known[:0]
    changed = np.flatnonzero((known[:-1] != before).any(axis=1))
    first = int(changed[0]) if len(changed) else len(known) - 1
    states = list(past[: first + 1])
    for step, arrived in zip(sent[first:], known[first:], strict=True):
        states.append(_counted(watch, states[-1], step.measured_m, step.positions_m, arrived))
    return replace(
        watch,
        robots=robots,
        station=states[-1],
        sent=sent,
        known=known,
        past=tuple(states[:-1]),
    )


def _known(sent: Sequence[Sent], packets: Packets, delay_steps: int) -> NDArray[np.bool_]:
    """Return which measurements the station has after the last step; ``(steps, robots)``."""
    arrived = np.array([step.delivered for step in sent])
    arrived[len(sent) - min(delay_steps, len(sent)) :] = False
    if packets == "estimates":
        # An estimate includes all earlier measurements.
        arrived = np.logical_or.accumulate(arrived[::-1], axis=0)[::-1]
    return arrived & np.array([step.seen for step in sent])


def _counted(
    watch: TargetWatch,
    state: InformationState,
    measured_m: NDArray[np.float64],
    positions_m: NDArray[np.float64],
    delivered: NDArray[np.bool_],
) -> InformationState:
    """Return a filter one step later, with sensor noise evaluated at its own target estimate."""
    ahead = predict(watch.model, state)
    noise = noise_covariance_m2(watch.sensor, positions_m, ahead.mean[:2])
    return update(ahead, measured_m, noise, delivered)
