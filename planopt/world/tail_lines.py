"""Lines that keep a robot from what moves while it stops after its last step, for the solver.

How it stops is a consequence of where and how fast the last step ends. After the start path the way
of stopping keeps ``g = min_t n . (p(t) - c(t)) - R`` more than it must from a disc, the normal n
fixed where they are nearest. Where neither the last place nor the place of standstill moves more
than g towards the disc, no place between does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.world.closest_approach import nearest_to_origin_m
from planopt.world.moving_discs import MovingDiscs
from planopt.world.moving_lines import TOUCHING_M
from planopt.world.separation import EMPTY_OFFSET_M, SeparatingLines
from planopt.world.timed_motion import TimedMotion

FAR_M = 1e4
"""A line that asks nothing at the begin of a step is this far behind where it is at the end."""


def tail_lines(
    discs: MovingDiscs,
    motion: TimedMotion,
    planned: int,
    standstill_m: NDArray[np.float64],
    clearance_m: float,
    count: int,
    reach_m: float,
) -> tuple[SeparatingLines, SeparatingLines]:
    """Lines of the last place, as of N segments of which only the last has some, and of standstill.

    Parameters
    ----------
    discs
        What moves, over T steps.
    motion
        Of the start path and of stopping after it.
    planned
        N, of its steps.
    standstill_m
        ``(2,)`` where it stands after it, or a place beyond that, of which the lines will be asked.
    clearance_m
        What will be kept from the lines.
    count
        Lines at most.
    reach_m
        Discs farther away than this are left out.
    """
    last, still = _empty(planned, count), _empty(1, count)
    whole = motion.lasting(discs.steps)
    own, bulges = whole.places_m[planned:], whole.bulges_m[planned:]
    found: list[tuple[float, NDArray[np.float64]]] = []
    for number in range(len(discs)):
        steps = discs.counted_steps(number, motion)
        if steps <= planned:
            continue
        size = discs.apart_m[number, planned:steps] + bulges[: steps - planned] - clearance_m
        relative = (own - discs.centres_m[number, planned:])[: steps - planned + 1]
        nearest = nearest_to_origin_m(relative[:-1], relative[1:])
        distance = np.linalg.norm(nearest, axis=1)
        at = int(np.argmin(distance - size))
        if distance[at] - size[at] > reach_m or distance[at] <= TOUCHING_M:
            continue
        normal = nearest[at] / distance[at]
        along = relative @ normal
        gap = float((np.minimum(along[:-1], along[1:]) - size).min())
        found.append((gap, normal))
    found.sort(key=lambda each: each[0])
    for row, (gap, normal) in enumerate(found[:count]):
        ends = np.stack([own[0], standstill_m]) @ normal - gap
        for lines, segment, end in ((last, planned - 1, ends[0]), (still, 0, ends[1])):
            lines.normals[segment, row] = normal
            lines.offsets[segment, row] = end
            lines.at_start[segment, row] = end - FAR_M if lines is last else end
            lines.gaps[segment, row] = gap
            lines.piece[segment, row] = row
    return last, still


def _empty(segments: int, count: int) -> SeparatingLines:
    return SeparatingLines(
        normals=np.zeros((segments, count, 2)),
        offsets=np.full((segments, count), EMPTY_OFFSET_M),
        gaps=np.full((segments, count), np.inf),
        piece=np.full((segments, count), -1, dtype=np.int64),
        start_offsets=np.full((segments, count), EMPTY_OFFSET_M),
    )
