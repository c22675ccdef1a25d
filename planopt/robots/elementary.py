"""Sine, cosine and sin(z)/z of NumPy arrays (real or complex) and of CasADi expressions alike.

No branches: what stands here has derivatives everywhere, at zero too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

HALVINGS = 3
"""sin(z)/z is a product of cosines down to z / 8, and a series from there."""


def sine(angle: Any) -> Any:
    """Sine of an angle in rad."""
    return angle.sin() if hasattr(angle, "sin") else np.sin(angle)


def cosine(angle: Any) -> Any:
    """Cosine of an angle in rad."""
    return angle.cos() if hasattr(angle, "cos") else np.cos(angle)


def sinc(angle: Any) -> Any:
    """sin(z) / z, 1 at zero, to round-off for angles of up to about 3 rad.

    From sin(z) = 2 sin(z/2) cos(z/2), applied three times, and the series of the rest.
    """
    rest = angle / 2.0**HALVINGS
    square = rest * rest
    series = 1.0 - square / 6.0 * (
        1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))
    )
    for halving in range(1, HALVINGS + 1):
        series = series * cosine(angle / 2.0**halving)
    return series
