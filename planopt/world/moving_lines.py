"""Separating lines between path segments and moving discs, for the solver.

Seen from a disc's centre, the robot moves straight during a step; that segment must stay outside a
disc about the origin. A line through the place nearest to the centre, with its normal n fixed from
the start path, gives two linear rows with offsets of their own::

    n . (q_{k-1} - c_{k-1}) >= R,    n . (q_k - c_k) >= R

Where both hold, the whole step keeps the distance R.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.world.closest_approach import nearest_to_origin_m
from planopt.world.moving_discs import MovingDiscs
from planopt.world.separation import EMPTY_OFFSET_M, SeparatingLines

TOUCHING_M = 1e-9
"""A segment that passes a centre this near is separated across its own direction."""


def moving_lines(
    discs: MovingDiscs,
    path_m: NDArray[np.float64],
    clearance_m: float,
    count: int,
    reach_m: float,
    needed: NDArray[np.bool_] | None = None,
    pad_m: float = 0.0,
) -> SeparatingLines:
    """Lines of every segment from the discs nearest to it.

    Like lines of obstacles they touch the disc, and the clearance is still to be kept from them: a
    disc that asks for another distance counts as so much larger or smaller.

    Parameters
    ----------
    discs
        What moves.
    path_m
        ``(N + 1, 2)`` the start path, the robot's own place first.
    clearance_m
        What will be kept from the lines.
    count
        Lines a segment, at most.
    reach_m
        Discs farther away than this are left out.
    needed
        ``(m, N)`` which discs come before all others, whatever their distance.
    pad_m
        How much larger discs count, for what is not known of where the robot is on its way when.
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
