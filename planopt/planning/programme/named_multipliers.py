"""Multipliers of a programme's rows by the names of the rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def named_multipliers(
    rows: NDArray[np.float64], horizon: int, lines: int, bounds: int
) -> dict[str, NDArray[np.float64]]:
    """Those of :mod:`~planopt.planning.programme.path_rows`, which come first, and of connectivity.

    Parameters
    ----------
    rows
        Of all rows, in the programme's order.
    horizon, lines
        N, and separating lines a segment.
    bounds
        How many rows bound connectivity, the last ones.
    """
    speed, line_end, line_start = np.split(
        rows[: horizon * (1 + 2 * lines) - lines], [horizon, horizon * (1 + lines)]
    )
    found = {
        "speed": speed,
        "line_end": line_end.reshape(horizon, lines),
        "line_start": line_start.reshape(horizon - 1, lines),
    }
    return found | ({"connectivity": rows[len(rows) - bounds :]} if bounds else {})
