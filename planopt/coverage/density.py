"""The density of a region, the weight of each place: uniform, or smooth by quadrature.

A density is anything with the two methods of :class:`Density`; densities on a grid are in
:mod:`planopt.coverage.raster_density`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.boundary import Boundary, Moments, region_boundary
from planopt.coverage.region import ConvexRegion, positive
from planopt.errors import InputError

NODES = 6
"""Gauss points along either side of a patch."""

PATCH_SHARE = 1.0
"""Patches for a Gaussian mixture are at most this share of the least standard deviation wide: six
points then leave a relative error below 1e-9."""

MAX_PATCHES = 2_000_000
"""More patches take minutes and gigabytes: the resolution is a mistake."""


class Density(Protocol):
    """A non-negative weight per square metre."""

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density at places ``(m, 2)``; (m,)."""
        ...

    def moments(self, boundary: Boundary) -> Moments:
        """Return the density's integrals over cells that are given by their boundaries."""
        ...


@dataclass(frozen=True)
class UniformDensity:
    """The same weight everywhere; its moments are closed forms."""

    weight_per_m2: float = 1.0  # The weight, more than 0

    def __post_init__(self) -> None:
        positive(self.weight_per_m2, "density.weight_per_m2")

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weight for each place ``(m, 2)``; (m,)."""
        return np.full(len(places_m), self.weight_per_m2)

    def moments(self, boundary: Boundary) -> Moments:
        """Return the sums of the moments of triangles and sectors."""
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
        sums = _summed(boundary, mass, first[:, 0], first[:, 1], second)
        return Moments(w * sums[0], w * np.stack(sums[1:3], axis=1), w * sums[3])


@dataclass(frozen=True)
class CallableDensity:
    """Any smooth density, integrated by Gauss quadrature over patches of the cells."""

    # Takes places (m, 2) and returns their densities (m,), none negative
    density: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    resolution_m: float  # The density is close to a polynomial of degree 10 over this length

    def __post_init__(self) -> None:
        positive(self.resolution_m, "density.resolution_m")

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density at places ``(m, 2)``; (m,)."""
        values = np.asarray(self.density(places_m), dtype=np.float64)
        if values.shape != (len(places_m),):
            raise InputError(
                f"the density returns shape {values.shape} for {len(places_m)} places",
                key="density",
            )
        wrong = ~(np.isfinite(values) & (values >= 0.0))
        if wrong.any():
            which = int(wrong.argmax())
            x, y = places_m[which]
            raise InputError(
                f"the density at ({x:g}, {y:g}) is {values[which]:g}",
                key="density",
                remedy="densities are finite and at least 0",
            )
        return values

    def moments(self, boundary: Boundary) -> Moments:
        """Return integrals over the patches between the cells' centres and their boundaries."""
        return fan_moments(self.at, boundary, self.resolution_m)


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """A sum of Gaussian bumps."""

    # (c,) mass of each bump over the whole plane, none negative, one positive
    weights: NDArray[np.float64]
    means_m: NDArray[np.float64]  # (c, 2) their centres
    covariances_m2: NDArray[np.float64]  # (c, 2, 2) their covariances, positive definite
    floor_per_m2: float = 0.0  # Uniform density that is added
    _whitening: NDArray[np.float64] = field(init=False, repr=False)
    _least_std_m: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = len(self.weights)
        shapes = np.shape(self.weights), np.shape(self.means_m), np.shape(self.covariances_m2)
        if shapes != ((count,), (count, 2), (count, 2, 2)) or not count:
            raise InputError(
                f"weights, means and covariances have the shapes {shapes}", key="density"
            )
        weights = np.asarray(self.weights, dtype=np.float64)
        if not np.isfinite(weights).all() or (weights < 0.0).any() or not (weights > 0.0).any():
            raise InputError("weights are finite, at least 0, and not all 0", key="density.weights")
        if not np.isfinite(self.means_m).all():
            raise InputError("a mean is not finite", key="density.means_m")
        positive(self.floor_per_m2, "density.floor_per_m2", zero=True)
        covariances = np.asarray(self.covariances_m2, dtype=np.float64)
        even = np.isfinite(covariances).all() and np.allclose(
            covariances, np.swapaxes(covariances, 1, 2)
        )
        eigenvalues = np.linalg.eigvalsh(covariances) if even else np.zeros(1)
        if not eigenvalues.min() > 0.0:
            raise InputError(
                "a covariance is not symmetric positive definite", key="density.covariances_m2"
            )
        object.__setattr__(self, "_whitening", np.linalg.inv(np.linalg.cholesky(covariances)))
        object.__setattr__(self, "_least_std_m", float(np.sqrt(eigenvalues.min())))

    def at(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density at places ``(m, 2)``; (m,)."""
        values = np.full(len(places_m), self.floor_per_m2)
        for weight, mean, white in zip(self.weights, self.means_m, self._whitening, strict=True):
            offset = (places_m - mean) @ white.T
            height = weight * abs(white[0, 0] * white[1, 1]) / (2.0 * np.pi)
            values += height * np.exp(-0.5 * (offset * offset).sum(axis=1))
        return values

    def moments(self, boundary: Boundary) -> Moments:
        """Return integrals over patches that are narrow against the narrowest bump."""
        return fan_moments(self.at, boundary, PATCH_SHARE * self._least_std_m)


def checked_mass(region: ConvexRegion, density: Density) -> float:
    """Return the mass of a density over a region."""
    mass = float(density.moments(region_boundary(region)).mass[0])
    if not np.isfinite(mass) or not mass > 0.0:
        raise InputError(
            f"the density's mass over the region is {mass:g}",
            key="density",
            remedy="give a density that is positive somewhere in the region",
        )
    return mass


def fan_moments(
    density: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    boundary: Boundary,
    patch_m: float,
) -> Moments:
    """Integrate a density over cells by Gauss quadrature.

    The triangle or sector between a centre and a piece of boundary is cut into patches, along the
    piece and away from the centre. Each has `NODES` by `NODES` points.
    """
    u, v, angle = boundary.start_m, boundary.end_m, boundary.angle
    reach = np.sqrt(np.maximum((u * u).sum(axis=1), (v * v).sum(axis=1)))
    width = np.where(angle > 0.0, reach * angle, np.hypot(v[:, 0] - u[:, 0], v[:, 1] - u[:, 1]))
    along = np.maximum(np.ceil(width / patch_m), 1.0)
    out = np.maximum(np.ceil(reach / patch_m), 1.0)
    if not (along * out).sum() <= MAX_PATCHES:
        raise InputError(
            f"a resolution of {patch_m:g} m needs {(along * out).sum():.2g} patches",
            key="density",
            remedy="give a smoother density or a larger resolution",
        )
    counts = (along * out).astype(np.intp)
    piece = np.repeat(np.arange(len(u)), counts)
    number = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    column, row = np.divmod(number, out[piece].astype(np.intp))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
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
    patch = Boundary(boundary.centres_m, cell, u[piece], v[piece], angle[piece])
    first = (mass[..., None] * offsets).sum(axis=(1, 2))
    square = (offsets * offsets).sum(axis=3)
    sums = _summed(
        patch, mass.sum(axis=(1, 2)), first[:, 0], first[:, 1], (mass * square).sum(axis=(1, 2))
    )
    return Moments(sums[0], np.stack(sums[1:3], axis=1), sums[3])


def _rays(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    angle: NDArray[np.float64],
    t: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (p, k, 2) on pieces at shares `t` (p, k), and twice the area a unit of `t` sweeps."""
    rays = u[:, None] + t[..., None] * (v - u)[:, None]
    stretch = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    arcs = np.flatnonzero(angle)
    turn = t[arcs] * angle[arcs, None]
    across = np.stack((-u[arcs, 1], u[arcs, 0]), axis=1)
    rays[arcs] = np.cos(turn)[..., None] * u[arcs, None] + np.sin(turn)[..., None] * across[:, None]
    stretch[arcs] = (u[arcs] * u[arcs]).sum(axis=1) * angle[arcs]
    return rays, stretch


def _summed(boundary: Boundary, *values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Sum values (e,) of pieces by cell; (g,) each."""
    count = len(boundary.centres_m)
    sums = (np.bincount(boundary.cell, value, minlength=count) for value in values)
    return [np.asarray(one, dtype=np.float64) for one in sums]
