"""Optima of the likelihood of the station's position: minima on a grid, and climbs from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.damped_newton import minimise_damped
from planopt.channel.station.station_surface import StationSurface, gauss_newton, losses
from planopt.errors import InputError

GRID = 41
"""Positions along each side of the grid."""

GRID_MARGIN = 0.5
"""The grid reaches beyond the measurements by this share of their extent."""

MARGIN = 2.0
"""The climbs may go so far: from there all distances are the same within a factor of 2."""

STARTS = 4
"""Minima of the grid that are climbed from."""

TOLERANCE = 1e-6
"""A climb ends when a step promises less than this, in units of log-likelihood."""


@dataclass(frozen=True)
class Box:
    """Where the station is looked for.

    Attributes
    ----------
    low_m, high_m
        ``(2,)`` corners.
    """

    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]

    def grid_m(self, number: int) -> NDArray[np.float64]:
        """A lattice of `number` x `number` positions, rows along x; ``(number^2, 2)``."""
        iy, ix = np.divmod(np.arange(number**2), number)
        share = np.column_stack([ix, iy]) / (number - 1)
        return self.low_m + share * (self.high_m - self.low_m)


def box_about(positions_m: NDArray[np.float64], margin: float) -> Box:
    """The box about measured positions (n, 2), and beyond by `margin` times their extent."""
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    reach = margin * extent_m(positions_m)
    return Box(low - reach, high + reach)


def extent_m(positions_m: NDArray[np.float64]) -> float:
    """Diagonal of the bounding box of positions (n, 2)."""
    return float(np.hypot(*np.ptp(positions_m, axis=0)))


def grid_starts(surface: StationSurface) -> list[NDArray[np.float64]]:
    """The best minima of the likelihood on the grid.

    Raises
    ------
    InputError
        The power falls with the distance from no position of the grid.
    """
    grid = box_about(surface.positions_m, GRID_MARGIN).grid_m(GRID)
    loss = losses(surface, grid).loss.reshape(GRID, GRID)
    if not np.isfinite(loss).any():
        raise InputError(
            "power grows with the distance from every position tried",
            remedy="give the station's position",
        )
    padded = np.pad(loss, 1, constant_values=np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min(axis=(2, 3))
    found = np.flatnonzero((loss <= around) & np.isfinite(loss))
    best = found[np.argsort(loss.flat[found])][:STARTS]
    return list(grid[best])


def best_climb(surface: StationSurface, starts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The best optimum reached from `starts`."""
    climbs = [climb(surface, start) for start in starts]
    return min(climbs, key=lambda climb: climb[0])[1]


def climb(surface: StationSurface, start: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """The loss reached from `start`, and where."""
    # Lengths in tenths of the extent, so that the minimiser's longest step is of the box's size.
    unit = 0.1 * extent_m(surface.positions_m)
    box = box_about(surface.positions_m, MARGIN)

    def objective(
        moved: NDArray[np.float64],
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        loss, gradient, curvature = gauss_newton(surface, start + unit * moved)
        return loss, unit * gradient, unit**2 * curvature

    loss, moved = minimise_damped(
        objective,
        np.zeros(2),
        (box.low_m - start) / unit,
        (box.high_m - start) / unit,
        TOLERANCE,
    )
    return loss, start + unit * moved
