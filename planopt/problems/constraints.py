"""What every plan of a problem must keep."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Constraints:
    """What every plan must keep.

    Attributes
    ----------
    p_min
        Least probability of connection at every step where that is possible; 0 asks for none.
    clearance_m
        Least distance of the whole swept path from every obstacle, and from every moving one.
    goal_radius_m
        The goal is reached within this distance of it.
    separation_m
        Least distance of any two robots at equal times, all the way; 0 asks for none.
    """

    p_min: float
    clearance_m: float
    goal_radius_m: float
    separation_m: float = 0.0
