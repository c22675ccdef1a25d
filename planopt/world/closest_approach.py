"""How near two straight motions come to each other at equal times, in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def closest_approach_m(
    first_starts_m: NDArray[np.float64],
    first_ends_m: NDArray[np.float64],
    second_starts_m: NDArray[np.float64],
    second_ends_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Least distance of two points that move straight and evenly over the same time.

    Seen from the second point the first one moves straight, from r to r + d; it is nearest at the
    share ``t = clip(-r . d / d . d, 0, 1)`` of the time, at the distance ``|r + t d|``.

    Parameters
    ----------
    first_starts_m, first_ends_m, second_starts_m, second_ends_m
        ``(..., 2)`` where each begins and ends; they broadcast.

    Returns
    -------
    (...) array
        Metres; NaN where a coordinate is not finite.
    """
    return np.asarray(
        np.linalg.norm(
            nearest_to_origin_m(first_starts_m - second_starts_m, first_ends_m - second_ends_m),
            axis=-1,
        )
    )


def nearest_to_origin_m(
    starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The place of each segment (..., 2) that is nearest to the origin; ``(..., 2)``."""
    along = ends_m - starts_m
    square = (along * along).sum(axis=-1)
    share = -(starts_m * along).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(np.where(square > 0.0, share, 0.0), 0.0, 1.0)
    # Counted from the nearer end, so that an end comes out exactly.
    late = share[..., None] > 0.5
    return np.where(
        late, ends_m - (1.0 - share[..., None]) * along, starts_m + share[..., None] * along
    )
