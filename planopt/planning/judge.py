"""The judge of one step's candidates: worth by the objective, verdict by the verifier.

Drive a robot away from where it must not be: too near to an obstacle or robot, or out of bounds.

Drift carries a robot a little nearer to an obstacle than its clearance. Every path from there keeps
too little distance on its first step, so that no plan is sound; standing still would last for ever.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.candidate import Candidate
from planopt.planning.message import plan_message
from planopt.planning.plan import Plan, Rung, Termination
from planopt.planning.proof.circumstances import Circumstances
from planopt.planning.proof.verify import judge
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex, clearance_m, segment_clearance_m
from planopt.world.moving_discs import MovingDiscs, ways_gap_m
from planopt.world.workspace import Workspace

DIRECTIONS, LENGTHS = 48, 8
"""Moves that are tried: directions all around, and lengths up to the longest step."""

NEARER_M = 1e-9
"""A move comes no nearer to anything than the robot is by more than this."""


def leaving_path(
    problem: Problem, index: ObstacleIndex, moving: MovingDiscs, position_m: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return the places (N, 2) of a robot that moves out of its way in one step and stands there.

    Of the moves that come no nearer to anything than the robot is now, the shortest of those that
    lack least at their end.

    Parameters
    ----------
    problem
        Of one robot that is a single integrator.
    index, moving
        Obstacles that stand, and what moves.
    position_m
        ``(2,)`` where the robot is.

    Returns
    -------
    (N, 2) array or None
        None where it lacks nothing here, or no such move is better than standing.
    """
    horizon = problem.planner.horizon
    lengths = (problem.step_length_m - STEP_PAD_M) * np.arange(1, LENGTHS + 1) / LENGTHS
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    moves = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = np.vstack([position_m, (position_m + lengths[:, None, None] * moves).reshape(-1, 2)])
    wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
    away = clearance_m(index, ends)
    outside = _outside_m(problem.workspace, ends)
    ways = np.repeat(ends[:, None], horizon + 1, axis=1)
    ways[:, 0] = position_m
    gap = ways_gap_m(moving, ways)
    static = np.maximum(wanted - away, 0.0) + outside
    if static[0] + _too_near_now_m(moving, position_m) == 0.0:
        return None
    lacks = static + _too_near_m(moving, ways)
    swept = segment_clearance_m(index, np.broadcast_to(position_m, ends.shape), ends)
    allowed = swept >= min(float(away[0]), wanted) - NEARER_M
    allowed &= (swept > 0.0) & (outside <= outside[0] + NEARER_M)
    allowed &= gap >= min(float(gap[0]), 0.0) - NEARER_M
    allowed[0] = True
    rows = np.flatnonzero(allowed)
    # Rows are in order of length: of equal ones the first is the shortest.
    best = int(rows[np.argmin(np.round(lacks[rows], 6))])
    return None if best == 0 else ways[best, 1:]


def _too_near_now_m(moving: MovingDiscs, position_m: NDArray[np.float64]) -> float:
    """By how much a place (2,) is too near to what moves, before the first step."""
    if not len(moving):
        return 0.0
    away = np.linalg.norm(position_m - moving.centres_m[:, 0], axis=-1)
    return float(np.maximum(moving.apart_m[:, 0] - away, 0.0).max())


def _too_near_m(moving: MovingDiscs, ways_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much each way (c, N + 1, 2) is too near to what moves after its first step; (c,)."""
    if not len(moving):
        return np.zeros(len(ways_m))
    places = int(ways_m.shape[1])
    centres, apart = moving.centres_m[:, 1:places], moving.apart_m[:, : places - 1]
    away = np.linalg.norm(ways_m[:, None, 1:] - centres, axis=-1)
    return np.maximum(apart - away, 0.0).max(axis=(1, 2))


def _outside_m(workspace: Workspace, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each place (n, 2) is out of bounds; (n,)."""
    bounds = np.reshape(workspace.bounds_m, (2, 2))
    beyond = np.maximum(np.maximum(bounds[0] - places_m, places_m - bounds[1]), 0.0)
    return np.linalg.norm(beyond, axis=1)


@dataclass(frozen=True)
class Judge:
    """Everything a candidate of one step is judged by.

    Attributes
    ----------
    problem, index, belief
        The problem, its obstacles, and what is believed of the channel.
    position_m
        ``(2,)`` where the robot is.
    objective
        What a path (N, 2) from there is worth.
    circumstances
        What else is known at the step.
    reserved_m
        ``(N, 2)`` the rest of the last plan, which the other robots keep clear of; None without.
    rest
        What the robot's state has beyond its place; nothing of a single integrator.
    objective_of_drive
        What a drive is worth, where that is not only by its places; None where it is.
    """

    problem: Problem
    index: ObstacleIndex
    belief: Belief
    position_m: NDArray[np.float64]
    objective: Callable[[NDArray[np.float64]], float]
    circumstances: Circumstances = field(default_factory=Circumstances)
    reserved_m: NDArray[np.float64] | None = None
    rest: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    objective_of_drive: Callable[[Drive], float] | None = None

    @property
    def state(self) -> NDArray[np.float64]:
        """``(s,)`` the robot's state, its place first."""
        return np.concatenate([self.position_m, self.rest])

    def margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Connectivity margins of the step's problem."""
        return margins_asked_db(self.problem, power)

    def candidate(
        self,
        path_m: NDArray[np.float64],
        rung: Rung,
        termination: Termination,
        drive: Drive | None = None,
    ) -> Candidate:
        """Make a candidate of a path, not yet verified; `drive` says how it is driven."""
        # A solver may give back places that are no numbers.
        found = self.sense * -np.inf
        if np.isfinite(path_m).all():
            by_drive = None if drive is None else self.objective_of_drive
            found = self.objective(path_m) if by_drive is None or drive is None else by_drive(drive)
        return Candidate(path_m, found, found, rung, termination, drive=drive)

    @property
    def sense(self) -> float:
        """1 where more of the objective is better, -1 where less is: times this it is a worth."""
        return 1.0 if self.problem.sense == "max" else -1.0

    def worth(self, candidate: Candidate) -> float:
        """More is better, whatever the sense of the problem."""
        return self.sense * candidate.objective

    def judged(self, candidate: Candidate) -> Candidate:
        """Ask the verifier."""
        path = np.vstack([self.position_m, candidate.path_m])
        judgement = judge(
            self.problem,
            self.index,
            self.belief.posterior,
            self.state,
            path,
            candidate.kkt_residual,
            self.circumstances,
            candidate.drive,
        )
        return replace(
            candidate,
            certificate=judgement.certificate,
            verdict=judgement.verdict,
            sound=judgement.sound,
            power=judgement.power,
        )

    def standing(self, horizon: int) -> Candidate:
        """Stand still for N = `horizon` steps; if that is not sound go on as reserved, or leave.

        Every robot's plan keeps clear of what the others have reserved, so that this is the last
        resort that no other robot is in the way of. A robot that is where it must not be moves
        away (:func:`planopt.planning.judge.leaving_path`).
        """
        place = np.tile(self.position_m, (horizon, 1))
        standing = self.judged(self.candidate(place, Rung.STOP, Termination.NO_PATH))
        if standing.sound:
            return standing
        rest = standing
        if self.reserved_m is not None and not np.array_equal(self.reserved_m, place):
            rest = self.judged(self.candidate(self.reserved_m, Rung.RESERVED, Termination.STOPPED))
            if rest.sound:
                return rest
        moving = self.circumstances.moving
        path = leaving_path(self.problem, self.index, moving, self.position_m)
        if path is None:
            return rest
        return self.judged(self.candidate(path, Rung.LEAVE, Termination.NO_PATH))

    def plan_from(self, chosen: Candidate, wall_s: float) -> Plan:
        """Write a judged candidate out as a plan."""
        if chosen.certificate is None or chosen.power is None:
            raise AssertionError("only judged candidates are released")
        power = chosen.power
        positions = np.vstack([self.position_m, chosen.path_m])
        radio = self.problem.stations[0]
        return Plan(
            robot=self.problem.robots[0].name,
            t_s=self.problem.planner.step_s * np.arange(len(positions), dtype=np.float64),
            positions_m=positions,
            mean_dbm=power.mean_db,
            deviation_db=power.deviation_db,
            connectivity=connection_probability(
                power.mean_db, power.deviation_db, radio.threshold_dbm
            ),
            objective=chosen.objective,
            lattice_objective=chosen.lattice_objective,
            termination=chosen.termination,
            verdict=chosen.verdict,
            rung=chosen.rung,
            certificate=chosen.certificate,
            wall_s=wall_s,
            solve_s=chosen.solve_s,
            iterations=chosen.iterations,
            multipliers=chosen.multipliers,
            message=plan_message(chosen.certificate, positions),
            sense=self.problem.sense,
            drive=chosen.drive,
        )
