"""Exact distance between a circular arc and straight segments.

The nearest two points of an arc and a segment are a crossing, or an end of either, or where the
segment's foot from the centre is seen along a ray that meets the arc.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def arc_segment_distances_m(
    start_m: NDArray[np.float64],
    heading_rad: float,
    length_m: float,
    turn_rad: float,
    from_m: NDArray[np.float64],
    to_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Distance of an arc from each of n segments; (n,).

    Parameters
    ----------
    start_m
        ``(2,)`` where the arc begins.
    heading_rad
        Direction of its tangent there.
    length_m, turn_rad
        Its length, negative where it is driven backward, and its turn, which is not 0.
    from_m, to_m
        ``(n, 2)`` ends of the segments.
    """
    signed = length_m / turn_rad
    radius = abs(signed)
    centre = start_m + signed * np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    first = math.atan2(start_m[1] - centre[1], start_m[0] - centre[0])

    def on_arc(angles: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the arc passes through these directions from its centre."""
        gone = (angles - first) if turn_rad > 0.0 else (first - angles)
        return np.mod(gone, 2.0 * math.pi) <= abs(turn_rad)

    last = first + turn_rad
    end = centre + radius * np.array([math.cos(last), math.sin(last)])
    along = to_m - from_m
    square = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)

    def foot(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where on the line of each segment the foot of a place is, and how far away."""
        t = ((place - from_m) * along).sum(axis=1) / square
        near = from_m + np.clip(t, 0.0, 1.0)[:, None] * along
        return t, np.linalg.norm(place - near, axis=1)

    def radial(places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance to the arc along the ray from its centre; infinite where that misses it."""
        offset = places - centre
        away = np.abs(np.hypot(offset[:, 0], offset[:, 1]) - radius)
        return np.where(on_arc(np.arctan2(offset[:, 1], offset[:, 0])), away, math.inf)

    t, _ = foot(centre)
    feet = from_m + t[:, None] * along
    inside = (t >= 0.0) & (t <= 1.0)
    best = np.minimum.reduce([foot(start_m)[1], foot(end)[1], radial(from_m), radial(to_m)])
    best = np.where(inside, np.minimum(best, radial(feet)), best)
    # Crossings: at the feet, half a chord to either side.
    apart = ((feet - centre) ** 2).sum(axis=1)
    half = np.sqrt(np.maximum(radius * radius - apart, 0.0) / square)
    for side in (-half, half):
        crossing = from_m + (t + side)[:, None] * along
        offset = crossing - centre
        hit = (apart <= radius * radius) & (t + side >= 0.0) & (t + side <= 1.0)
        hit &= on_arc(np.arctan2(offset[:, 1], offset[:, 0]))
        best = np.where(hit, 0.0, best)
    return best
