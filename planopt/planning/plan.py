"""Plan of one robot, and history of the run before the plan."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.bounds.bound import Bound
from planopt.channel.neighbours import NOWHERE, PlaceIndex
from planopt.planning.certificate import Certificate, Hole
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, rolled_out
from planopt.short_repr import short_repr

LEAST_BASE = 0.01
"""Minimum ratio of lattice to refined objective; below it, relative gains are undefined."""


class Termination(StrEnum):
    """Reason why the solver stopped; it does not measure the plan's quality."""

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    LATTICE_ONLY = "lattice_only"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    INFEASIBLE = "infeasible"
    NUMERICAL_FAILURE = "numerical_failure"
    NO_PATH = "no_path"
    STOPPED = "stopped"


class Verdict(StrEnum):
    """Verdict of the verifier on a plan.

    ``verified``: every constraint holds, except p_min at steps that the verifier excuses.
    ``feasible_unverified``: not rejected, but a part of the proof is missing. ``violated``: a
    constraint does not hold. ``none``: there is no plan.
    """

    VERIFIED = "verified"
    FEASIBLE_UNVERIFIED = "feasible_unverified"
    VIOLATED = "violated"
    NONE = "none"


class Rung(StrEnum):
    """Fallback that produced a released plan.

    ``reserved`` is the remainder of the last plan, verified or not, used if waiting would block
    moving obstacles or robots; the other robots avoid it. ``direct`` is the shortest path to a
    goal after long wandering, regardless of connection. ``give_way`` is a robot's part of paths
    planned jointly for all robots. ``leave`` is a step away from a forbidden position: too close
    to an obstacle, or out of bounds.
    """

    PLAN = "plan"
    COLD_RETRY = "cold_retry"
    LATTICE = "lattice"
    RELAXED = "relaxed"
    SHIFTED = "shifted"
    RESERVED = "reserved"
    DIRECT = "direct"
    GIVE_WAY = "give_way"
    LEAVE = "leave"
    STOP = "stop"


@dataclass(frozen=True)
class Pivot:
    """Terminal waypoint beyond the horizon, with the cost of the remaining route.

    Attributes
    ----------
    position_m
        ``(2,)`` position of the waypoint.
    cost_m
        Cost from the waypoint to the goal in metres, with outage at its price.
    metre_cost
        Cost per metre on the route to the waypoint, at least 1.
    """

    position_m: Floats
    cost_m: float
    metre_cost: float = 1.0


@dataclass(frozen=True)
class Plan:
    """Plan of one robot over N steps.

    Attributes
    ----------
    robot
        Name of the robot.
    t_s
        ``(N + 1,)`` times from now.
    positions_m
        ``(N + 1, 2)`` current position and positions after each step; motion is straight between.
    mean_dbm, deviation_db, connectivity
        ``(N + 1,)`` predicted power, its standard deviation and P(connected) at these positions,
        from the exact posterior; future measurements are not anticipated (equation 3.2).
    objective
        With a goal, a cost in seconds to be minimised: time, effort and outage at their prices,
        including cost-to-go; not a travel time. Otherwise the weighted sum of terms, maximised.
    lattice_objective
        Objective of the lattice path that the refinement started from.
    termination, verdict, rung, certificate
        Solver's termination, verdict, fallback, and results of the verifier.
    wall_s, solve_s, iterations
        Wall time of the whole step, solver time within it, and number of solver iterations.
    multipliers
        Named constraint multipliers of the solver, for reports.
    message
        Reason why there is no better plan; empty if the plan meets all requirements.
    rejected
        Reasons why the path of a user-defined planner was rejected; empty if it was released.
    pivot
        Terminal waypoint of the cost-to-go; None without one.
    sense
        Direction of the objective: minimised or maximised.
    drive
        States and inputs along the path; None for the single integrator.
    route_m
        ``(r, 2)`` route from the last position to the goal, smoothed by :func:`planopt.solve`. The
        smoothed route ends just inside the goal's radius.
    holes
        Coverage holes on path and route to a goal.
    bound
        Proven bound on the objective; None unless a proof was required. A proof also improves
        `route_m` and the steps.
    """

    robot: str
    t_s: Floats
    positions_m: Floats
    mean_dbm: Floats
    deviation_db: Floats
    connectivity: Floats
    objective: float
    lattice_objective: float
    termination: Termination
    verdict: Verdict
    rung: Rung
    certificate: Certificate
    wall_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0
    multipliers: dict[str, Floats] = field(default_factory=dict[str, Floats])
    message: str = ""
    rejected: str = ""
    pivot: Pivot | None = None
    sense: Literal["min", "max"] = "min"
    drive: Drive | None = None
    route_m: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    holes: tuple[Hole, ...] = ()
    bound: Bound | None = None

    __repr__ = short_repr

    @property
    def next_state(self) -> Floats:
        """``(s,)`` state of the robot after the first step."""
        return self.positions_m[1] if self.drive is None else self.drive.states[1]

    @property
    def next_position_m(self) -> Floats:
        """``(2,)`` position of the robot after the first step."""
        return self.positions_m[1]

    @property
    def next_input(self) -> Floats:
        """``(m,)`` input during the first step; for a single integrator its velocity in m/s."""
        if self.drive is None:
            return (self.positions_m[1] - self.positions_m[0]) / (self.t_s[1] - self.t_s[0])
        return self.drive.inputs[0]

    @property
    def gain(self) -> float:
        """Return the objective's gain over the lattice path, positive if the plan is better."""
        saved = self.lattice_objective - self.objective
        return saved if self.sense == "min" else -saved

    @property
    def polish_gain(self) -> float:
        """Return the gain relative to the lattice path's objective, by :func:`share_gained`."""
        return share_gained(self.gain, self.lattice_objective, self.objective)


def share_gained(gain: float, lattice: float, refined: float) -> float:
    """Return a gain relative to the lattice objective; NaN for an objective close to zero."""
    if gain == 0.0:
        return 0.0
    return gain / abs(lattice) if abs(lattice) >= LEAST_BASE * abs(refined) > 0.0 else math.nan


def shifted_drive(problem: Problem, warm: Plan | None) -> Drive | None:
    """Return the last plan's drive, shifted by one step and braking at its end, or None."""
    # The plan need not be verified, since the swept area does not depend on the channel.
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if warm is None or warm.drive is None:
        return None
    last = dynamics.braking(warm.drive.states[-1], step_s, 1)
    inputs = np.vstack([warm.drive.inputs[1:], last])
    return rolled_out(dynamics, warm.drive.states[1], inputs, step_s)


@dataclass(frozen=True)
class History:
    """History of a robot's run; a step counts as connected if its end is truly connected."""

    steps: int = 0
    connected_steps: int = 0
    # Number of steps since the last connected step, or since the start
    outage_steps: int = 0
    outage_m: float = 0.0
    delivered_mbit: float = 0.0  # Data delivered before the deadline, if data are required
    # Whether the robot has ever circled for `CIRCLING_STEPS` steps; False with moving obstacles
    has_circled: bool = False
    # For a goal: cost of driven steps that violate p_min, and excess over cheapest paths
    crossing_cost_m: float = 0.0
    crossing_excess_m: float = 0.0
    # (n, 2) end positions of earlier steps without connection
    missed_m: Floats = field(default_factory=lambda: np.zeros((0, 2)), repr=False, compare=False)
    # End positions of steps with a known connection, not a predicted one
    connected: PlaceIndex = field(default=NOWHERE, repr=False, compare=False)


CIRCLING_STEPS = 15
"""Number of consecutive steps within one step length of a position that count as circling."""
BEGINNING = History()  # History at the start of a run


def history_of(
    problem: Problem,
    track_m: Floats,  # (n + 1, 2) start position first
    connected: Mask,  # (n,) true connection after each step
    certificates: Iterable[Certificate] = (),
    *,
    gave_way: Sequence[bool] = (),
    observed: Mask | None = None,  # (n,) whether `connected` was observed; None: always
) -> History:
    """Return the history of a run whose robot moved along a track."""
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
        connected=PlaceIndex.of(
            track_m[1:][connected if observed is None else connected & observed]
        ),
        crossing_cost_m=sum(each.step_cost_m or 0.0 for each in priced),
        crossing_excess_m=sum(each.step_excess_m or 0.0 for each in priced),
        has_circled=not problem.workspace.moving
        and _circled(track_m, problem.step_length_m, gave_way),
    )


def _circled(track_m: Floats, step_length_m: float, gave_way: Sequence[bool]) -> bool:
    """Return whether a track (n + 1, 2) stayed near one position without giving way to others."""
    if len(track_m) <= CIRCLING_STEPS:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(track_m, CIRCLING_STEPS + 1, axis=0)
    away = np.linalg.norm(windows - windows[..., :1], axis=1).max(axis=1)
    circles = away <= step_length_m
    if any(gave_way):
        waited = np.lib.stride_tricks.sliding_window_view(np.array(gave_way), CIRCLING_STEPS)
        circles &= ~waited.any(axis=1)
    return bool(circles.any())


def data_of_steps_mbit(problem: Problem, first: int, count: int) -> Floats:
    """Return the data (count,) in Mbit that steps from `first` on can deliver by the deadline."""
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    if rule.deadline_s is None or rule.rate_mbit_s is None:
        return np.zeros(count)
    ends_s = np.minimum(step_s * np.arange(first, first + count + 1), rule.deadline_s)
    return rule.rate_mbit_s * np.diff(ends_s)


def data_pace_mbit(problem: Problem, history: History, count: int) -> float:
    """Return the data in Mbit required in `count` steps, at a constant rate until the deadline."""
    rule = problem.constraints.rule
    data_mbit, deadline_s, rate_mbit_s = rule.data_mbit, rule.deadline_s, rule.rate_mbit_s
    left_s = (deadline_s or 0.0) - history.steps * problem.planner.step_s
    missing = max((data_mbit or 0.0) - history.delivered_mbit, 0.0)
    if rate_mbit_s is None or left_s <= 0.0 or missing == 0.0:
        return 0.0
    most = float(data_of_steps_mbit(problem, history.steps, count).sum())
    return missing * most / (rate_mbit_s * left_s)
