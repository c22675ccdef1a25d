"""Array types, checks of user numbers, and values with derivatives; shapes are in comments."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

LARGEST = 1e12  # Maximum magnitude of numbers from a user's control loop
LONGEST_PROOF_S = 1e6  # Largest time limit of a proof, in seconds


def finite_array(key: str, given: object, shape: tuple[int, ...], remedy: str) -> Floats:
    """Return user values as an array of a shape; raise `InputError` naming the wrong entry."""
    try:
        found = np.asarray(given)
    except ValueError:  # Rows of different lengths
        found = np.asarray(None)
    # NumPy would convert text to numbers and drop imaginary parts.
    if found.dtype.kind not in "iuf":
        raise InputError("is not an array of numbers", key=key, remedy=remedy)
    if found.shape != shape:
        words = f"has shape {found.shape}, should have shape {shape}"
        raise InputError(words, key=key, remedy=remedy)
    for entry in np.argwhere(~(np.abs(found) <= LARGEST)):
        words = f"contains {found[tuple(entry)]} at index {entry.tolist()}"
        raise InputError(words, key=key, remedy=f"give finite numbers up to {LARGEST:g}")
    return found.astype(np.float64, copy=False)


def require_seed(seed: object) -> None:
    """Raise an `InputError` unless a random seed is an integer >= 0."""
    if not isinstance(seed, int | np.integer) or seed < 0:
        words = f"is {seed!r}, should be a whole number of at least 0"
        raise InputError(words, key="seed", remedy="give 0, 1, ...")


def proof_seconds(given: Any) -> float:
    """Return the time limit of a proof; raise an `InputError` if it is invalid."""
    if not issubclass(type(given), Real) or not 0.0 < given <= LONGEST_PROOF_S:
        remedy = f"give seconds above 0, at most {LONGEST_PROOF_S:,.0f}"
        raise InputError(f"is {given!r}", key="prove_s", remedy=remedy)
    return float(given)


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Values at positions with their first and second derivatives."""

    value: Floats  # (...)
    gradient: Floats  # (..., 2) per metre
    hessian: Floats  # (..., 3) per square metre: xx, xy, yy

    @staticmethod
    def of(rows: Floats) -> Derivatives:
        """Return derivatives stored in `rows` (..., 6), without a copy; see :attr:`rows`."""
        found = Derivatives(rows[..., 0], rows[..., 1:3], rows[..., 3:])
        object.__setattr__(found, "_rows", rows)
        return found

    @property
    def rows(self) -> Floats:
        """``(..., 6)`` value and derivatives x, y, xx, xy, yy in one array."""
        rows: Floats | None = getattr(self, "_rows", None)
        if rows is None:
            return np.concatenate([self.value[..., None], self.gradient, self.hessian], axis=-1)
        return rows


def rounded_length(offset_m: Floats, width_m: float) -> Derivatives:
    """Return the length of `offset_m` (..., 2), smoothed where it is less than `width_m` > 0."""
    distance = np.hypot(offset_m[..., 0], offset_m[..., 1])
    return radial(offset_m, *rounded_radius(distance, width_m))


def radial(offset_m: Floats, value: Floats, slope: Floats, bend: Floats) -> Derivatives:
    """Return f(|x|), from value, slope and bend, with derivatives w.r.t. x at offsets (..., 2)."""
    # Shapes: value f, slope f' / r, bend (f'' - f' / r) / r^2, all (...).
    rows = np.empty((*value.shape, 6))
    rows[..., 0] = value
    steep = slope[..., None]
    np.multiply(steep, offset_m, out=rows[..., 1:3])
    bent = bend[..., None] * offset_m
    np.multiply(bent, offset_m[..., :1], out=rows[..., 3:5])
    np.multiply(bent[..., 1], offset_m[..., 1], out=rows[..., 5])
    rows[..., 3::2] += steep
    return Derivatives.of(rows)


def add_products(hessian: Floats, a: Floats, b: Floats) -> None:
    """Add a b' + b a' to `hessian` (..., 3) with entries xx, xy, yy; a and b are (..., 2)."""
    crossed = a * b
    crossed += crossed
    hessian[..., ::2] += crossed
    hessian[..., 1] += a[..., 0] * b[..., 1]
    hessian[..., 1] += a[..., 1] * b[..., 0]


def rounded_positive_part(x: Floats, width: float) -> tuple[Floats, Floats, Floats]:
    """Return max{0, x} smoothed for |x| < width (error at most 3/16 width), slope and curvature."""
    value, slope, bend = rounded_radius(np.abs(x), width)
    return 0.5 * (x + value), 0.5 * (1.0 + slope * x), 0.5 * (slope + bend * x * x)


def rounded_radius(r: Floats, width: float) -> tuple[Floats, Floats, Floats]:
    """Return a smoothed radius rho(r) with slope and bend for :func:`radial`, finite at 0."""
    if r.min(initial=np.inf) >= width:
        inverse = 1.0 / r
        return r, inverse, -inverse * inverse * inverse
    # For r >= width, s = 1 and the factors below are those of the exact radius.
    far = np.maximum(r, width)
    s = r / far
    s *= s
    value = np.where(r < width, width * (0.375 + 0.75 * s - 0.125 * s * s), r)
    return value, (1.5 - 0.5 * s) / far, -1.0 / (far * far * far)
