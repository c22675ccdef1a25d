"""How far a motion keeps from what moves, at equal times and all the way.

A robot that cannot stop at will brakes after the last step, which counts at its own times. So do
the other robots, until all stand; moving obstacles count until this one does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.world.least_distance import least_gap
from planopt.world.moving_discs import MovingDiscs
from planopt.world.timed_motion import TimedMotion


@dataclass(frozen=True)
class Apart:
    """What is found of a motion.

    Attributes
    ----------
    min_separation_m
        Least distance from any other robot that a separation is asked from; None without one.
    min_moving_clearance_m
        Least distance from any moving obstacle, as large as it is predicted to be, negative inside
        one; None without one.
    reasons
        Which of them it comes too near to, in which step and by how much.
    """

    min_separation_m: float | None
    min_moving_clearance_m: float | None
    reasons: tuple[str, ...]


def judge_apart(discs: MovingDiscs, motion: TimedMotion, planned: int | None = None) -> Apart:
    """Judge a motion against what moves.

    Parameters
    ----------
    discs
        What moves, over T steps.
    motion
        Of the robot, over at most T steps; after them it stands.
    planned
        Of how many of them the plan is, N; the others brake. None for all of them.
    """
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


def _least(away_m: NDArray[np.float64]) -> float | None:
    return float(away_m.min()) if away_m.size else None
