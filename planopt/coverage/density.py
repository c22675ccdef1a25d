"""Densities over a region: uniform, Gaussian, a function (integrated by quadrature), or on a grid.

Green's theorem turns an integral over a cell into one along its boundary, ``integral of rho dA =
contour integral of F dy`` with ``F(x, y)`` the integral of rho along x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from planopt.arrays import Floats, Indices
from planopt.coverage.voronoi import Boundary, ConvexRegion, Moments, region_boundary
from planopt.errors import InputError
from planopt.world.raster import Raster

NODES = 6  # Number of Gauss points along each side of a quadrature patch
BUMP_NODES = 8
"""Number of Gauss points along a boundary part as long as a Gaussian's standard deviation."""
MAX_PATCHES = 2_000_000  # Largest number of quadrature patches; more take minutes and gigabytes


@dataclass(frozen=True)
class UniformDensity:
    """Constant density with closed-form moments."""

    weight_per_m2: float = 1.0

    def at(self, places_m: Floats) -> Floats:
        """Return the density (m,) at positions (m, 2)."""
        return np.full(len(places_m), self.weight_per_m2)

    def moments(self, boundary: Boundary) -> Moments:
        """Return the moments of cells, each a sum over triangles and circular sectors."""
        u, v, angle = boundary.start_m, boundary.end_m, boundary.angle
        cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        total = u + v
        squares = (u * u + v * v + total * total).sum(axis=1)
        mass = 0.5 * cross
        first = (cross / 6.0)[:, None] * total
        second = cross * squares / 24.0
        arcs = np.flatnonzero(angle)
        if len(arcs):
            range2 = (u[arcs] * u[arcs]).sum(axis=1)
            chord = v[arcs] - u[arcs]
            mass[arcs] = 0.5 * range2 * angle[arcs]
            first[arcs] = (range2 / 3.0)[:, None] * np.stack((chord[:, 1], -chord[:, 0]), axis=1)
            second[arcs] = 0.25 * range2**2 * angle[arcs]
        w = self.weight_per_m2
        sums = _summed(boundary.cell, len(boundary.centres_m), mass, *first.T, second)
        return Moments(w * sums[0], w * np.stack(sums[1:3], axis=1), w * sums[3])


UNIFORM = UniformDensity()


@dataclass(frozen=True)
class CallableDensity:
    """Smooth density given as a function and integrated by Gauss quadrature over patches."""

    density: Callable[[Floats], Floats]  # Maps positions (m, 2) to non-negative densities (m,)
    resolution_m: float  # Length over which a polynomial of degree 10 approximates the density well

    def at(self, places_m: Floats) -> Floats:
        """Return the density (m,) at positions (m, 2)."""
        values = np.asarray(self.density(places_m), dtype=np.float64)
        shape = (len(places_m),)
        if values.shape != shape or not (np.isfinite(values) & (values >= 0.0)).all():
            fault = "negative, NaN or infinite values"
            if values.shape != shape:
                fault = f"values of shape {values.shape} for {len(places_m)} positions"
            raise InputError(
                f"returned {fault}",
                key="density",
                remedy=f"return finite values of at least 0 with shape {shape}",
            )
        return values

    def moments(self, boundary: Boundary) -> Moments:
        """Return the moments of cells by quadrature over patches from centre to boundary."""
        return fan_moments(self.at, boundary, self.resolution_m)


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """Sum of isotropic Gaussian bumps."""

    weights: Floats  # (c,) mass of each bump over the whole plane; none negative, one positive
    means_m: Floats  # (c, 2)
    stds_m: Floats  # (c,)
    floor_per_m2: float = 0.0  # Uniform density added to the bumps

    def __post_init__(self) -> None:
        if not self.weights.any():
            raise InputError("are all 0", key="density.weights", remedy="give a positive weight")

    def at(self, places_m: Floats) -> Floats:
        """Return the density (m,) at positions (m, 2)."""
        values = np.full(len(places_m), self.floor_per_m2)
        for weight, mean, std in zip(self.weights, self.means_m, self.stds_m, strict=True):
            offset = (places_m - mean) / std
            height = weight / (2.0 * np.pi * std**2)
            values += height * np.exp(-0.5 * (offset * offset).sum(axis=1))
        return values

    def moments(self, boundary: Boundary) -> Moments:
        """Return the moments of cells from contour integrals, with errors below 1e-9."""
        patch_m = float(self.stds_m.min())
        length = np.linalg.norm(boundary.end_m - boundary.start_m, axis=1)
        arc = np.hypot(boundary.start_m[:, 0], boundary.start_m[:, 1]) * boundary.angle
        most = np.maximum(np.maximum(length, arc) / patch_m, boundary.angle / ARC_TURN)
        along = np.maximum(np.ceil(most), 1.0)
        _require_patches(along.sum(), patch_m)
        piece = np.repeat(np.arange(len(along)), along.astype(np.intp))
        number = np.arange(len(piece)) - np.repeat(np.cumsum(along) - along, along.astype(np.intp))
        nodes, weights = _gauss(BUMP_NODES)
        t = (number[:, None] + nodes) / along[piece, None]
        u, v, angle = boundary.start_m[piece], boundary.end_m[piece], boundary.angle[piece]
        x, y = _rays(u, v, angle, t)[0].transpose(2, 0, 1)
        turn = angle[:, None]
        bent = turn * (u[:, :1] * np.cos(t * turn) - u[:, 1:] * np.sin(t * turn))
        rise = np.where(turn > 0.0, bent, (v - u)[:, 1:]) * weights / along[piece, None]
        cell, sums = boundary.cell[piece], np.zeros((4, len(piece)))
        for weight, mean, std in zip(self.weights, self.means_m, self.stds_m, strict=True):
            dx, dy = (mean - boundary.centres_m[cell])[:, :, None].transpose(1, 0, 2)
            # Integrals start on the nearer side, so that masses in a tail keep their precision.
            side = np.where(dx < 0.0, -1.0, 1.0)
            at, off = (x - dx) / std, (y - dy) / std
            bell = np.exp(-0.5 * at * at) / np.sqrt(2.0 * np.pi)
            nearer: Floats = side * at
            below = side * ndtr(nearer)
            row = weight / (np.sqrt(2.0 * np.pi) * std) * np.exp(-0.5 * off * off) * rise
            first = dx * below - std * bell
            square = std * std * (below - at * bell) - 2.0 * std * dx * bell + dx * dx * below
            values = (below, first, y * below, square + y * y * below)
            sums += [np.einsum("pk,pk->p", row, value) for value in values]
        found = _summed(cell, len(boundary.centres_m), *sums)
        flat = UniformDensity(self.floor_per_m2).moments(boundary)
        first = np.stack(found[1:3], axis=1)
        return Moments(flat.mass + found[0], flat.first + first, flat.second + found[3])


def _require_patches(count: float, patch_m: float) -> None:
    """Raise `InputError` if quadrature needs more than `MAX_PATCHES` patches."""
    if not count <= MAX_PATCHES:
        raise InputError(
            f"needs {count:.2g} patches at a resolution of {patch_m:g} m, which is too many",
            key="density",
            remedy="give a smoother density or a larger resolution",
        )


def checked_mass(region: ConvexRegion, density: Density) -> float:
    """Return the mass of a density over a region."""
    mass = float(density.moments(region_boundary(region)).mass[0])
    if not np.isfinite(mass) or not mass > 0.0:
        raise InputError(
            f"has the mass {mass:g} over the region",
            key="density",
            remedy="give a density that is positive somewhere in the region",
        )
    return mass


def fan_moments(density: Callable[[Floats], Floats], boundary: Boundary, patch_m: float) -> Moments:
    """Return the moments of a density over cells by Gauss quadrature."""
    # Patches with `NODES` by `NODES` points cover the sectors of the boundary pieces.
    u, v, angle = boundary.start_m, boundary.end_m, boundary.angle
    reach = np.sqrt(np.maximum((u * u).sum(axis=1), (v * v).sum(axis=1)))
    width = np.where(angle > 0.0, reach * angle, np.hypot(v[:, 0] - u[:, 0], v[:, 1] - u[:, 1]))
    along = np.maximum(np.ceil(width / patch_m), 1.0)
    out = np.maximum(np.ceil(reach / patch_m), 1.0)
    _require_patches((along * out).sum(), patch_m)
    counts = (along * out).astype(np.intp)
    piece = np.repeat(np.arange(len(u)), counts)
    number = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    column, row = np.divmod(number, out[piece].astype(np.intp))
    nodes, weights = _gauss(NODES)
    t = (column[:, None] + nodes) / along[piece, None]
    s = (row[:, None] + nodes) / out[piece, None]
    rays, stretch = _rays(u[piece], v[piece], angle[piece], t)
    offsets = s[:, :, None, None] * rays[:, None]
    mass = (s * weights / out[piece, None])[:, :, None] * (
        stretch[:, None] * weights / along[piece, None]
    )[:, None]
    cell = boundary.cell[piece]
    places = offsets + boundary.centres_m[cell][:, None, None]
    mass *= density(places.reshape(-1, 2)).reshape(mass.shape)
    first = (mass[..., None] * offsets).sum(axis=(1, 2))
    square = (offsets * offsets).sum(axis=3)
    sums = _summed(
        cell,
        len(boundary.centres_m),
        *(mass.sum(axis=(1, 2)), *first.T, (mass * square).sum(axis=(1, 2))),
    )
    return Moments(sums[0], np.stack(sums[1:3], axis=1), sums[3])


def _rays(u: Floats, v: Floats, angle: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return points (p, k, 2) on boundary pieces at parameters `t`, and area factors (p,)."""
    rays = u[:, None] + t[..., None] * (v - u)[:, None]
    stretch = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    arcs = np.flatnonzero(angle)
    turn = t[arcs] * angle[arcs, None]
    across = np.stack((-u[arcs, 1], u[arcs, 0]), axis=1)
    rays[arcs] = np.cos(turn)[..., None] * u[arcs, None] + np.sin(turn)[..., None] * across[:, None]
    stretch[arcs] = (u[arcs] * u[arcs]).sum(axis=1) * angle[arcs]
    return rays, stretch


def _summed(cell: Indices, count: int, *values: Floats) -> list[Floats]:
    """Sum each of `values` (e,) over the boundary pieces of each cell; return arrays (g,)."""
    sums = (np.bincount(cell, value, minlength=count) for value in values)
    return [np.asarray(one, dtype=np.float64) for one in sums]


STRAIGHT_NODES = 2
"""Number of Gauss points along a straight part; exact, because F dy is a cubic there."""
ARC_NODES = 8  # Number of Gauss points along a part of an arc that turns by at most `ARC_TURN`
ARC_TURN = 0.5
"""Maximum angle of a part of an arc in rad; the error of eight points is then below 1e-15."""


@dataclass(frozen=True, eq=False)
class RasterDensity:
    """Density that is constant on each cell of a raster and zero outside the raster."""

    raster: Raster  # Finite values per square metre; none negative, one positive
    _edges: tuple[Floats, Floats] = field(init=False, repr=False)
    _running: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = self.raster.values
        wrong = ~(np.isfinite(values) & (values >= 0.0))
        if wrong.any():
            iy, ix = np.unravel_index(int(wrong.argmax()), values.shape)
            raise InputError(
                f"is {values[iy, ix]:g} in row {iy}, column {ix}",
                key="density",
                remedy="give finite densities of at least 0",
            )
        if not values.any():
            raise InputError("is 0 everywhere", key="density", remedy="give a positive value")
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
    def _middle_m(self) -> Floats:
        """Return the centre (2,) of the raster, the origin of the computations."""
        x, y = self.raster.x_m, self.raster.y_m
        return 0.5 * np.array([x[0] + x[-1], y[0] + y[-1]])

    def at(self, places_m: Floats) -> Floats:
        """Return the density (m,) at positions (m, 2)."""
        ix, iy = self._cells(places_m - self._middle_m)
        inside = (ix >= 0) & (iy >= 0) & (ix < len(self.raster.x_m)) & (iy < len(self.raster.y_m))
        values = np.zeros(len(places_m))
        values[inside] = self.raster.values[iy[inside], ix[inside]]
        return values

    def covers(self, region: ConvexRegion) -> bool:
        """Return whether the raster covers the whole region."""
        x, y = self._edges
        low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
        corners, slack = region.corners_m - self._middle_m, 1e-9 * region.radius_m
        return bool(((corners >= low - slack) & (corners <= high + slack)).all())

    def moments(self, boundary: Boundary) -> Moments:
        """Return the exact moments of cells."""
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

    def _along_lines(self, start: Floats, end: Floats) -> Floats:
        """Return the contour integrals (5, e) of straight boundary pieces with ends (e, 2)."""
        along = end - start
        cuts: list[tuple[Indices, Floats]] = []
        for axis, edges in enumerate(self._edges):
            piece, line = _between(edges, start[:, axis], end[:, axis])
            cuts.append((piece, (edges[line] - start[piece, axis]) / along[piece, axis]))
        piece, low, high = _parts(len(start), cuts)
        nodes, weights = _gauss(STRAIGHT_NODES)
        share = low[:, None] + nodes * (high - low)[:, None]
        places = start[piece, None] + share[..., None] * along[piece, None]
        rise = (high - low)[:, None] * weights * along[piece, 1, None]
        return self._summed(piece, places, rise, len(start))

    def _along_arcs(self, centre: Floats, start: Floats, angle: Floats) -> Floats:
        """Return the contour integrals (5, e) of arcs that begin at offsets `start` (e, 2)."""
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
            # The arc crosses a grid line at the angles turn and -turn from the normal to that line.
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

    def _summed(self, piece: Indices, places: Floats, rise: Floats, count: int) -> Floats:
        """Return the contour integrals (5, count) of pieces by Gauss points on their parts."""
        # All points of a part are in the raster cell of its midpoint.
        ix, iy = self._cells(places.mean(axis=1))
        rows, columns = self.raster.values.shape
        held = (iy >= 0) & (iy < rows) & (ix >= 0)
        row, column = np.clip(iy, 0, rows - 1), np.clip(ix, 0, columns - 1)
        edge = self._edges[0]
        # Right of the grid F is constant.
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
        along = (np.where(held, (each * rise).sum(axis=1), 0.0) for each in flux)
        return np.array(_summed(piece, count, *along))

    def _cells(self, places: Floats) -> tuple[Indices, Indices]:
        """Return columns and rows of positions (m, 2), out of range for positions off the grid."""
        x, y = self._edges
        ix = np.searchsorted(x, places[:, 0], side="right") - 1
        iy = np.searchsorted(y, places[:, 1], side="right") - 1
        return ix, iy


Density = UniformDensity | CallableDensity | GaussianMixture | RasterDensity
"""Non-negative density of weight per square metre over a region."""


def _gauss(nodes: int) -> tuple[Floats, Floats]:
    """Return the points and weights of Gauss quadrature on [0, 1]."""
    points, weights = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (points + 1.0), 0.5 * weights


def _between(edges: Floats, start: Floats, end: Floats) -> tuple[Indices, Indices]:
    """Return index pairs of an interval and a grid line strictly inside it."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    begin = np.searchsorted(edges, low, side="right")
    counts = np.maximum(np.searchsorted(edges, high, side="left") - begin, 0)
    pair = np.repeat(np.arange(len(start)), counts)
    number = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    return pair, begin[pair] + number


def _parts(count: int, cuts: list[tuple[Indices, Floats]]) -> tuple[Indices, Floats, Floats]:
    """Cut boundary pieces at parameters in [0, 1]; return each part's piece, start and end."""
    every = np.arange(count)
    piece = np.concatenate((every, every, *(c[0] for c in cuts)))
    share = np.concatenate((np.zeros(count), np.ones(count), *(c[1] for c in cuts)))
    kept = (share >= 0.0) & (share <= 1.0)
    piece, share = piece[kept], share[kept]
    order = np.lexsort((share, piece))
    piece, share = piece[order], share[order]
    whole = (piece[1:] == piece[:-1]) & (share[1:] > share[:-1])
    return piece[:-1][whole], share[:-1][whole], share[1:][whole]
