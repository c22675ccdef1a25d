"""History of a run before a plan, for rules over the whole run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import Certificate
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class History:
    """One robot's run so far; a step is connected if its end truly is."""

    steps: int = 0
    connected_steps: int = 0
    # Steps since the last connected step, or since the start
    outage_steps: int = 0
    outage_m: float = 0.0
    delivered_mbit: float = 0.0  # Data delivered before the deadline, if data are required
    # Whether the robot once circled for `CIRCLING_STEPS` steps; False with moving obstacles
    has_circled: bool = False
    # For a goal: cost of the driven steps that violate p_min, and its excess over the cheapest
    # paths
    crossing_cost_m: float = 0.0
    crossing_excess_m: float = 0.0
    # (n, 2) end positions of earlier steps without connection
    missed_m: NDArray[np.float64] = field(
        default_factory=lambda: np.zeros((0, 2)), repr=False, compare=False
    )


CIRCLING_STEPS = 15
"""Number of steps within one longest step of a position that count as waiting or circling."""

BEGINNING = History()
"""History at the start of a run."""


def history_of(
    problem: Problem,
    track_m: NDArray[np.float64],  # (n + 1, 2) start position first
    connected: NDArray[np.bool_],  # (n,) true connection after each step
    certificates: Iterable[Certificate] = (),
    *,
    gave_way: Sequence[bool] = (),
) -> History:
    """Return the history of a run along a track."""
    priced = [each for each in certificates if each.step_excess_m is not None]
    count = len(connected)
    ends = np.flatnonzero(connected)
    since = int(ends[-1]) + 1 if len(ends) else 0
    legs = np.linalg.norm(np.diff(track_m, axis=0), axis=1)
    return History(
        steps=count,
        connected_steps=len(ends),
        outage_steps=count - since,
        outage_m=float(legs[since:].sum()),
        delivered_mbit=float(data_of_steps_mbit(problem, 0, count) @ connected),
        missed_m=track_m[1:-1][~connected[:-1]],
        crossing_cost_m=sum(each.step_cost_m or 0.0 for each in priced),
        crossing_excess_m=sum(each.step_excess_m or 0.0 for each in priced),
        has_circled=not problem.workspace.moving
        and _circled(track_m, problem.step_length_m, gave_way),
    )


def _circled(track_m: NDArray[np.float64], step_length_m: float, gave_way: Sequence[bool]) -> bool:
    """Return whether a track (n + 1, 2) once stayed near one position without giving way."""
    if len(track_m) <= CIRCLING_STEPS:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(track_m, CIRCLING_STEPS + 1, axis=0)
    away = np.linalg.norm(windows - windows[..., :1], axis=1).max(axis=1)
    circles = away <= step_length_m
    if any(gave_way):
        waited = np.lib.stride_tricks.sliding_window_view(np.array(gave_way), CIRCLING_STEPS)
        circles &= ~waited.any(axis=1)
    return bool(circles.any())


def data_of_steps_mbit(problem: Problem, first: int, count: int) -> NDArray[np.float64]:
    """Return the data (n,) that connected steps after step `first` deliver by the deadline."""
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    if rule.deadline_s is None or rule.rate_mbit_s is None:
        return np.zeros(count)
    ends_s = np.minimum(step_s * np.arange(first, first + count + 1), rule.deadline_s)
    return rule.rate_mbit_s * np.diff(ends_s)
