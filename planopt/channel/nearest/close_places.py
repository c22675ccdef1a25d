"""Places told apart into groups that share measurements, because they lie close together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]
"""Numbers of places."""


def close_together(
    places_m: NDArray[np.float64], near: NDArray[np.intp], most: float
) -> list[Rows]:
    """Split places until each part needs at most `most` measurements, or is one place."""
    # Shapes: places_m (n, 2); near (n, count).
    done: list[Rows] = []
    parts = [np.arange(len(places_m))]
    while parts:
        part = parts.pop()
        if len(part) == 1 or _different(near[part]) <= most:
            done.append(part)
        else:
            parts.extend(halves(places_m, part))
    return done


def halves(places_m: NDArray[np.float64], rows: Rows) -> tuple[Rows, Rows]:
    """Split `rows` of places (n, 2) in two of the same size, across their longer side."""
    places = places_m[rows]
    along = places[:, int(np.ptp(places, axis=0).argmax())]
    middle = len(rows) // 2
    order = np.argpartition(along, middle)
    return rows[order[:middle]], rows[order[middle:]]


def _different(numbers: NDArray[np.intp]) -> int:
    return len(np.unique(numbers))
