"""Verification of a motion: swept clearance, dynamics, separation, and arrival.

The braking path after the last step belongs to the swept path, so that the next step always has a
plan. Distances at equal times include braking: to other robots until all have stopped, to moving
obstacles until this robot has stopped.
"""

from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, DYNAMICS_TOLERANCE_M, STANDSTILL_M
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, Dynamics, braked_motion, dynamics_defect_m
from planopt.world.clearance import ObstacleIndex, inside_bounds, is_clear, swept_clearance_m
from planopt.world.motion import MovingDiscs, StepCurve, TimedMotion, least_gap


@dataclass(frozen=True)
class Apart:
    """Minimum distances to other robots and to moving obstacles; None if there are none."""

    min_separation_m: float | None  # Distance to any other robot
    min_moving_clearance_m: float | None  # Distance to any predicted disc of an obstacle
    reasons: tuple[str, ...]


def verify_apart(
    discs: MovingDiscs,
    motion: TimedMotion,
    planned: int | None = None,  # Number N of planned steps, before braking; None: all
) -> Apart:
    """Return minimum distances of a motion to moving discs, until both have stopped."""
    if not len(discs):
        return Apart(None, None, ())
    planned = motion.steps if planned is None else planned
    gaps = np.zeros(len(discs))
    reasons: list[str] = []
    for number in range(len(discs)):
        radius = discs.radius_m[number, : discs.counted_steps(number, motion)]
        gaps[number], step = least_gap(motion, discs.motion(number), radius)
        if gaps[number] - discs.least_m[number] >= -CLEARANCE_TOLERANCE_M:
            continue
        kind, key = (
            ("robot", "separation_m")
            if discs.is_robot[number]
            else ("moving obstacle", "clearance_m")
        )
        when = f"in step {step + 1}" if step < planned else "while robots stop after the last step,"
        reasons.append(
            f"{when} the path comes within {gaps[number]:.3f} m of the {kind} "
            f"{discs.names[number]}, constraints.{key} is {discs.least_m[number]:g}"
        )
    return Apart(_least(gaps[discs.is_robot]), _least(gaps[~discs.is_robot]), tuple(reasons))


def _least(away_m: Floats) -> float | None:
    return float(away_m.min()) if away_m.size else None


def swept_motion(problem: Problem, positions_m: Floats, drive: Drive | None) -> TimedMotion:
    """Return the first robot's motion along a path of finite positions, including braking."""
    # If the drive is invalid, which the verifier rejects, straight motion is returned.
    dynamics = problem.robots[0].dynamics
    if drive is None or drive_fault(dynamics, positions_m, drive):
        return TimedMotion(positions_m)
    own = Drive(dynamics, drive.states, drive.inputs)
    return braked_motion(positions_m, own, problem.planner.step_s)


@dataclass(frozen=True)
class MotionFinding:
    """Findings of the verifier on a motion: clearance, defect of the dynamics, violations."""

    clearance_m: float  # Minimum distance of the swept path to an obstacle
    defect_m: float  # Largest violation of the motion model and the input set
    reasons: tuple[str, ...]  # Violated constraints; empty if there are none


def verify_motion(
    problem: Problem,
    index: ObstacleIndex,
    start: Floats,  # (s,) state of the robot
    positions_m: Floats,  # (N + 1, 2)
    drive: Drive | None,  # None for the single integrator
) -> MotionFinding:
    """Return the verifier's findings on the first robot's motion along a path."""
    if problem.robots[0].moves_freely:
        return _straight(problem, index, start, positions_m)
    dynamics = problem.robots[0].dynamics
    fault = drive_fault(dynamics, positions_m, drive)
    if drive is None or fault:
        return MotionFinding(0.0, np.inf, (fault,))
    return _driven(problem, index, start, positions_m, drive, dynamics)


def drive_fault(dynamics: Dynamics, positions_m: Floats, drive: Drive | None) -> str:
    """Return the reason why a drive does not reproduce a path; empty if it does."""
    states, inputs = len(dynamics.state_names), len(dynamics.input_names)
    if (
        drive is None
        or drive.states.shape != (len(positions_m), states)
        or drive.inputs.shape != (len(positions_m) - 1, inputs)
    ):
        return "the states and inputs of the robot are missing"
    if not (np.isfinite(drive.states).all() and np.isfinite(drive.inputs).all()):
        return "not finite"
    return ""


def _straight(
    problem: Problem, index: ObstacleIndex, start_m: Floats, positions_m: Floats
) -> MotionFinding:
    swept = swept_clearance_m(index, positions_m)
    clearance = float(np.min(swept, initial=np.inf))
    reasons = _clearance_reasons(problem, swept, "the swept path")
    if not inside_bounds(problem.workspace, positions_m).all():
        reasons.append("the path leaves world.bounds_m")
    defect = dynamics_defect_m(positions_m, start_m, problem.step_length_m)
    if defect > DYNAMICS_TOLERANCE_M:
        reasons.append(f"a step is {defect:.3g} m longer than robots[0].speed_max_m_s allows")
    return MotionFinding(clearance, defect, tuple(reasons))


def _driven(
    problem: Problem,
    index: ObstacleIndex,
    start: Floats,
    positions_m: Floats,
    drive: Drive,
    dynamics: Dynamics,
) -> MotionFinding:
    step_s = problem.planner.step_s
    states = drive.states
    unit_m = np.array(dynamics.unit_m(step_s))
    curves = dynamics.curves(states[:-1], drive.inputs, step_s)
    each = np.array([curve.clearance_m(index) for curve in curves])
    clearance = float(np.min(each, initial=np.inf))
    reasons = _clearance_reasons(problem, each, "the swept path")
    if not all(_within(problem, curve) for curve in curves):
        reasons.append("the path leaves world.bounds_m")
    stop = dynamics.stop_curve(states[-1], step_s)
    if stop is not None:
        after = np.array([stop.clearance_m(index)])
        clearance = min(clearance, float(after[0]))
        reasons += _clearance_reasons(problem, after, "the braking path after the last step")
        if not _within(problem, stop):
            reasons.append("the braking path after the last step leaves world.bounds_m")

    reached = np.column_stack(dynamics.step(tuple(states[:-1].T), tuple(drive.inputs.T), step_s))
    jump = float(np.max(np.abs(states[0] - start) * unit_m))
    jump = max(jump, float(np.max(np.abs(states[:, :2] - positions_m))))
    off = float(np.max(np.abs(reached - states[1:]) * unit_m, initial=0.0))
    over = max(0.0, dynamics.excess_m(states, drive.inputs, step_s))
    moving = np.abs(np.array(dynamics.stop_rows(tuple(states[-1]), step_s), dtype=np.float64))
    still = float(np.max(moving * unit_m, initial=0.0) if moving.size else 0.0)
    for defect, words in (
        (jump, "the states do not begin where the robot is, or are not those of the path"),
        (off, "the inputs do not lead from state to state"),
        (over, "an input or a speed is over its limit"),
        (still, "the robot cannot stop after the last step"),
    ):
        if not defect <= DYNAMICS_TOLERANCE_M:
            reasons.append(f"{words}, by {defect:.3g} m a step")
    return MotionFinding(clearance, max(jump, off, over, still), tuple(reasons))


def _clearance_reasons(problem: Problem, swept: Floats, what: str) -> list[str]:
    constraints = problem.constraints
    if is_clear(swept, constraints.clearance_m, CLEARANCE_TOLERANCE_M).all():
        return []
    return [
        f"{what} comes within {swept.min():.3f} m of an obstacle, "
        f"constraints.clearance_m is {constraints.clearance_m:g}"
    ]


def _within(problem: Problem, curve: StepCurve) -> bool:
    """Return whether the whole curve is in the workspace, up to round-off."""
    places, within = curve.points_m()
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    low = places.min(axis=0) - within + 2.0 * CLEARANCE_TOLERANCE_M
    high = places.max(axis=0) + within - 2.0 * CLEARANCE_TOLERANCE_M
    return bool(low[0] >= x_min and low[1] >= y_min and high[0] <= x_max and high[1] <= y_max)


def is_at_goal(problem: Problem, place_m: Floats) -> bool:
    """Return whether a position (2,) is within the goal's radius."""
    away = float(np.linalg.norm(place_m - np.asarray(problem.goal_m)))
    return away <= problem.constraints.goal_radius_m


def stands(problem: Problem, state: Floats) -> bool:
    """Return whether the first robot is at rest in a state (s,)."""
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    control = dynamics.braking(state, step_s, 1)[0]
    after = np.array(dynamics.step(tuple(state), tuple(control), step_s), dtype=np.float64)
    return float(np.linalg.norm(after[:2] - state[:2])) <= STANDSTILL_M


def stops_at_goal(problem: Problem, state: Floats) -> bool:
    """Return whether a robot with dynamics is at the goal and comes to rest there by braking."""
    dynamics = problem.robots[0].dynamics
    if not is_at_goal(problem, state[:2]):
        return False
    stop = dynamics.stop_curve(state, problem.planner.step_s)
    return stands(problem, state) if stop is None else is_at_goal(problem, stop.points_m()[0][-1])
