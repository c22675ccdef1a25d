"""Lines that keep paths from what moves, during the steps and while a robot stops after them.

Seen from a disc's centre, the robot moves straight during a step; that segment must stay outside a
disc about the origin. A line through the place nearest to the centre, with its normal n fixed from
the start path, gives two linear rows with offsets of their own::

    n . (q_{k-1} - c_{k-1}) >= R,    n . (q_k - c_k) >= R

If both hold, the whole step keeps the distance R.

The way of stopping is a consequence of where and how fast the last step ends. After the start path
it keeps ``g = min_t n . (p(t) - c(t)) - R`` more than it must from a disc, the normal n fixed where
they are nearest. If neither the last place nor the place of standstill moves more than g towards
the disc, no place between does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.world.least_distance import nearest_to_origin_m
from planopt.world.moving_obstacle import MovingDiscs
from planopt.world.separation import EMPTY_OFFSET_M, SeparatingLines
from planopt.world.timed_motion import TimedMotion

TOUCHING_M = 1e-9
"""A segment that passes a centre this near is separated across its own direction."""


def moving_lines(
    discs: MovingDiscs,
    path_m: NDArray[np.float64],  # (N + 1, 2) the start path, the robot's own place first
    clearance_m: float,
    count: int,
    reach_m: float,
    needed: NDArray[np.bool_] | None = None,  # (m, N)
    pad_m: float = 0.0,
) -> SeparatingLines:
    """Lines of every segment from the discs nearest to it.

    Like lines of obstacles they touch the disc, and the clearance is still to be kept from them: a
    disc that asks for another distance counts as so much larger or smaller.
    """
    steps = len(path_m) - 1
    lines = SeparatingLines(
        normals=np.zeros((steps, count, 2)),
        offsets=np.full((steps, count), EMPTY_OFFSET_M),
        gaps=np.full((steps, count), np.inf),
        piece=np.full((steps, count), -1, dtype=np.int64),
        start_offsets=np.full((steps, count), EMPTY_OFFSET_M),
    )
    relative = path_m - discs.centres_m[:, : len(path_m)]
    begin, end = relative[:, :-1], relative[:, 1:]
    nearest = nearest_to_origin_m(begin, end)
    distance = np.linalg.norm(nearest, axis=-1)
    along = end - begin
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal = np.where(distance[..., None] > TOUCHING_M, nearest, across)
    length = np.linalg.norm(normal, axis=-1)
    normal = np.where(length[..., None] > 0.0, normal, [1.0, 0.0])
    normal = normal / np.where(length > 0.0, length, 1.0)[..., None]
    size = discs.apart_m[:, :steps] - clearance_m + pad_m
    gaps = distance - size
    first = np.zeros(gaps.shape) if needed is None else np.where(needed, -np.inf, 0.0)
    order = np.argsort(np.minimum(gaps, np.inf) + first, axis=0, kind="stable")[:count]
    for row, disc in enumerate(order):
        step = np.arange(steps)
        kept = (gaps[disc, step] <= reach_m) | np.isinf(first[disc, step])
        disc, step = disc[kept], step[kept]
        n = normal[disc, step]
        lines.normals[step, row] = n
        centre_end = discs.centres_m[disc, step + 1]
        centre_begin = discs.centres_m[disc, step]
        lines.offsets[step, row] = (n * centre_end).sum(axis=1) + size[disc, step]
        lines.at_start[step, row] = (n * centre_begin).sum(axis=1) + size[disc, step]
        lines.gaps[step, row] = gaps[disc, step]
        lines.piece[step, row] = disc
    return lines


FAR_M = 1e4
"""A line that asks nothing at the begin of a step is this far behind where it is at the end."""


def tail_lines(
    discs: MovingDiscs,
    motion: TimedMotion,
    planned: int,
    standstill_m: NDArray[np.float64],  # (2,)
    clearance_m: float,
    count: int,
    reach_m: float,
) -> tuple[SeparatingLines, SeparatingLines]:
    """Separating lines of the last position, as of N segments, and of a stationary robot."""
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
