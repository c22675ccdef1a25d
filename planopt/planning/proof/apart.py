"""How far a path keeps from what moves, at equal times and all the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.world.moving_discs import MovingDiscs, path_distances_m


@dataclass(frozen=True)
class Apart:
    """What is found of a path.

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


def judge_apart(discs: MovingDiscs, path_m: NDArray[np.float64], straight: bool = True) -> Apart:
    """Judge a path (N + 1, 2) against what moves during its N steps.

    Distances are of ways that are straight and even in each step. Of any other nothing is known, so
    that it is objected to where something is asked.
    """
    if not len(discs):
        return Apart(None, None, ())
    away = path_distances_m(discs, path_m) - discs.radius_m
    reasons: list[str] = []
    if not straight and (~discs.is_robot | (discs.least_m > 0.0)).any():
        reasons.append("how far the path keeps from what moves is known of single integrators only")
    for number in np.flatnonzero(
        (away - discs.least_m[:, None]).min(axis=1) < -CLEARANCE_TOLERANCE_M
    ):
        step = int(np.argmin(away[number]))
        kind, key = (
            ("robot", "separation_m")
            if discs.is_robot[number]
            else ("moving obstacle", "clearance_m")
        )
        reasons.append(
            f"in step {step + 1} the path comes within {away[number, step]:.3f} m of the {kind} "
            f"{discs.names[number]}, constraints.{key} is {discs.least_m[number]:g}"
        )
    return Apart(_least(away[discs.is_robot]), _least(away[~discs.is_robot]), tuple(reasons))


def _least(away_m: NDArray[np.float64]) -> float | None:
    return float(away_m.min()) if away_m.size else None
