"""A lattice path at cruising speed: same way, better timing, and so a better start.

A lattice path moves at the speeds that its moves happen to have. The separating lines of a polish
belong to segments, so that a path which passes a corner a step late keeps the polished one late
too. Sampled anew at cruising speed it passes the corner in time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.world.lattice import REACH_TOLERANCE_M


def retime(
    start_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
    beyond_m: NDArray[np.float64],
    step_m: float,
) -> NDArray[np.float64]:
    """Sample the way of a path anew, N places `step_m` apart.

    Parameters
    ----------
    start_m
        ``(2,)`` where the robot is.
    path_m
        ``(N, 2)`` its path; where it stands still at its end it has arrived.
    beyond_m
        ``(b, 2)`` the way beyond, used only by a path that has not arrived.
    step_m
        Longest step.

    Returns
    -------
    NDArray
        ``(N, 2)``. A way that ends earlier is walked in equal steps, then it stands.
    """
    horizon = len(path_m)
    arrived = horizon > 1 and bool((path_m[-1] == path_m[-2]).all())
    way = np.vstack([start_m, path_m] if arrived else [start_m, path_m, beyond_m])
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    way = way[np.concatenate([[True], lengths > 0.0])]
    travelled = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
    total = float(travelled[-1])
    if total == 0.0:
        return path_m
    # A lattice path of n longest moves is n steps long but for rounding, and takes n steps.
    steps = max(int(np.ceil((total - REACH_TOLERANCE_M) / step_m)), 1)
    if steps <= horizon:
        step_m = total / steps
    stops = np.minimum(step_m * np.arange(1, horizon + 1), total)
    return np.stack(
        [np.interp(stops, travelled, way[:, 0]), np.interp(stops, travelled, way[:, 1])], axis=1
    )
