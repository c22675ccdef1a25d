"""Densities that are constant on each cell of a grid, integrated exactly.

Green's theorem turns an integral over a cell into one along its boundary:
``integral of rho dA = contour integral of F dy`` with ``F(x, y)`` the integral of rho along x from
the grid's left edge. Boundaries are cut where they cross the grid, F is a polynomial on each part.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.boundary import Boundary, Moments
from planopt.coverage.region import ConvexRegion
from planopt.errors import InputError
from planopt.world.raster import Raster

STRAIGHT_NODES = 2
"""Gauss points along a straight part: F dy is a cubic there, so that two are exact."""

ARC_NODES = 8
"""Gauss points along an arc; parts of arcs turn by less than `ARC_TURN`."""

ARC_TURN = 0.5
"""Arcs are cut at least every so many rad: eight points then leave an error below 1e-15."""


@dataclass(frozen=True, eq=False)
class RasterDensity:
    """A density that is constant on each cell of a raster and zero outside it."""

    raster: Raster  # Values per square metre, finite, none negative, one positive
    _edges: tuple[NDArray[np.float64], NDArray[np.float64]] = field(init=False, repr=False)
    _running: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = self.raster.values
        wrong = ~(np.isfinite(values) & (values >= 0.0))
        if wrong.any():
            iy, ix = np.unravel_index(int(wrong.argmax()), values.shape)
            raise InputError(
                f"the density in row {iy}, column {ix} is {values[iy, ix]:g}",
                key="density",
                remedy="densities are finite and at least 0",
            )
        if not values.any():
            raise InputError("the density is zero everywhere", key="density")
        side_x, side_y = self.raster.cell_m
        middle = self._middle_m
        x = self.raster.x_m[0] - middle[0] + side_x * (np.arange(len(self.raster.x_m) + 1) - 0.5)
        y = self.raster.y_m[0] - middle[1] + side_y * (np.arange(len(self.raster.y_m) + 1) - 0.5)
        powers = np.stack([np.diff(x ** (k + 1)) / (k + 1) for k in range(3)])
        sums = np.cumsum(powers[:, None] * values, axis=2)
        running = np.concatenate((np.zeros((3, len(values), 1)), sums[:, :, :-1]), axis=2)
        object.__setattr__(self, "_edges", (x, y))
        object.__setattr__(self, "_running", running)

    @property
    def _middle_m(self) -> NDArray[np.float64]:
        """Middle of the raster (2,): coordinates around it cost no precision."""
        x, y = self.raster.x_m, self.raster.y_m
        return 0.5 * np.array([x[0] + x[-1], y[0] + y[-1]])

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density at places ``(m, 2)``; (m,)."""
        ix, iy = self._cells(places_m - self._middle_m)
        inside = (ix >= 0) & (iy >= 0) & (ix < len(self.raster.x_m)) & (iy < len(self.raster.y_m))
        values = np.zeros(len(places_m))
        values[inside] = self.raster.values[iy[inside], ix[inside]]
        return values

    def covers(self, region: ConvexRegion) -> bool:
        """Return whether the raster reaches over the whole region."""
        x, y = self._edges
        low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
        corners, slack = region.corners_m - self._middle_m, 1e-9 * region.radius_m
        return bool(((corners >= low - slack) & (corners <= high + slack)).all())

    def moments(self, boundary: Boundary) -> Moments:
        """Return exact integrals over cells."""
        centres = boundary.centres_m - self._middle_m
        start = boundary.start_m + centres[boundary.cell]
        end = boundary.end_m + centres[boundary.cell]
        arc = boundary.angle > 0.0
        lines = self._along_lines(start[~arc], end[~arc])
        arcs = self._along_arcs(
            centres[boundary.cell[arc]], boundary.start_m[arc], boundary.angle[arc]
        )
        sums = np.zeros((5, len(centres)))
        for cell, values in ((boundary.cell[~arc], lines), (boundary.cell[arc], arcs)):
            for k in range(5):
                sums[k] += np.bincount(cell, values[k], minlength=len(centres))
        mass, about = sums[0], sums[1:3].T
        second = sums[3] + sums[4] - 2.0 * (centres * about).sum(axis=1)
        second += mass * (centres * centres).sum(axis=1)
        return Moments(mass, about - mass[:, None] * centres, second)

    def _along_lines(
        self, start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Contour integrals (5, e) along straight pieces from ends (e, 2) about the middle."""
        along = end - start
        cuts: list[tuple[NDArray[np.intp], NDArray[np.float64]]] = []
        for axis, edges in enumerate(self._edges):
            piece, line = _between(edges, start[:, axis], end[:, axis])
            cuts.append((piece, (edges[line] - start[piece, axis]) / along[piece, axis]))
        piece, low, high = _parts(len(start), cuts)
        nodes, weights = _gauss(STRAIGHT_NODES)
        share = low[:, None] + nodes * (high - low)[:, None]
        places = start[piece, None] + share[..., None] * along[piece, None]
        rise = (high - low)[:, None] * weights * along[piece, 1, None]
        return self._summed(piece, places, rise, len(start))

    def _along_arcs(
        self,
        centre: NDArray[np.float64],
        start: NDArray[np.float64],
        angle: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Contour integrals (5, e) along arcs about centres (e, 2) from offsets (e, 2)."""
        radius = np.hypot(start[:, 0], start[:, 1])
        begin = np.arctan2(start[:, 1], start[:, 0])
        even = np.ceil(angle / ARC_TURN)
        piece = np.repeat(np.arange(len(angle)), even.astype(np.intp))
        number = np.arange(len(piece)) - np.repeat(np.cumsum(even) - even, even.astype(np.intp))
        cuts = [(piece, number / even[piece])]
        for axis, edges in enumerate(self._edges):
            piece, line = _between(edges, centre[:, axis] - radius, centre[:, axis] + radius)
            ratio = (edges[line] - centre[piece, axis]) / radius[piece]
            turn = np.arccos(np.clip(ratio, -1.0, 1.0))
            # A line is crossed twice: at the angles turn and -turn from its axis.
            for at in (turn, -turn):
                past = (at + axis * 0.5 * np.pi - begin[piece]) % (2.0 * np.pi)
                cuts.append((piece, past / angle[piece]))
        piece, low, high = _parts(len(angle), cuts)
        nodes, weights = _gauss(ARC_NODES)
        width = ((high - low) * angle[piece])[:, None]
        at = (begin[piece] + low * angle[piece])[:, None] + nodes * width
        ray = radius[piece, None, None] * np.stack((np.cos(at), np.sin(at)), axis=2)
        rise = width * weights * ray[..., 0]
        return self._summed(piece, centre[piece, None] + ray, rise, len(angle))

    def _summed(
        self,
        piece: NDArray[np.intp],
        places: NDArray[np.float64],
        rise: NDArray[np.float64],
        count: int,
    ) -> NDArray[np.float64]:
        """Sum F dy over points (p, k, 2) of parts with steps dy (p, k) by piece; (5, count).

        The rows are of the density times 1, x, y, x^2 and y^2.
        """
        # All points of a part are in the cell of its middle.
        ix, iy = self._cells(places.mean(axis=1))
        rows, columns = self.raster.values.shape
        held = (iy >= 0) & (iy < rows) & (ix >= 0)
        row, column = np.clip(iy, 0, rows - 1), np.clip(ix, 0, columns - 1)
        edge = self._edges[0]
        # Right of the grid F stays what it is at its right edge.
        x = np.minimum(places[..., 0], edge[-1])
        y = places[..., 1]
        value = self.raster.values[row, column][:, None]
        left = edge[column][:, None]
        powers = [
            self._running[k, row, column][:, None]
            + value * (x ** (k + 1) - left ** (k + 1)) / (k + 1)
            for k in range(3)
        ]
        flux = (powers[0], powers[1], y * powers[0], powers[2], y * y * powers[0])
        sums = np.zeros((len(flux), count))
        for row_of_sums, f in zip(sums, flux, strict=True):
            along = np.where(held, (f * rise).sum(axis=1), 0.0)
            row_of_sums += np.bincount(piece, along, minlength=count)
        return sums

    def _cells(self, places: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Column and row of places (m, 2) about the middle; beyond the grid outside its range."""
        x, y = self._edges
        ix = np.searchsorted(x, places[:, 0], side="right") - 1
        iy = np.searchsorted(y, places[:, 1], side="right") - 1
        return ix, iy


def _gauss(nodes: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and weights of Gauss quadrature over [0, 1]."""
    points, weights = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (points + 1.0), 0.5 * weights


def _between(
    edges: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the grid lines (l,) strictly between pairs of coordinates (e,): pair and line."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    begin = np.searchsorted(edges, low, side="right")
    counts = np.maximum(np.searchsorted(edges, high, side="left") - begin, 0)
    pair = np.repeat(np.arange(len(start)), counts)
    number = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    return pair, begin[pair] + number


def _parts(
    count: int, cuts: list[tuple[NDArray[np.intp], NDArray[np.float64]]]
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Cut pieces at shares in [0, 1]: each part's piece, and where it begins and ends on it."""
    every = np.arange(count)
    piece = np.concatenate((every, every, *(c[0] for c in cuts)))
    share = np.concatenate((np.zeros(count), np.ones(count), *(c[1] for c in cuts)))
    kept = (share >= 0.0) & (share <= 1.0)
    piece, share = piece[kept], share[kept]
    order = np.lexsort((share, piece))
    piece, share = piece[order], share[order]
    whole = (piece[1:] == piece[:-1]) & (share[1:] > share[:-1])
    return piece[:-1][whole], share[:-1][whole], share[1:][whole]
