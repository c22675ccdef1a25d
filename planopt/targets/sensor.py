"""The sensor of a robot: the noise of measuring the target by its distance.

[GM11] gives ``tr Phi^-1 = 1 / g(r)`` and not Phi itself. Here Phi = 2 g I_2, which has that
trace: noise alike in every direction, g half the variance of a coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.targets.rounding import Derivatives, radial, rounded_radius

CUSP_SHARE = 0.1
"""The derivatives round the cusp at the target within this share of the sweet spot's radius."""


@dataclass(frozen=True)
class Sensor:
    """The sensor model ``g(r) = varpi (r - r_s)^2 + nu`` (equation 4.8)."""

    growth: float  # varpi > 0: how fast noise grows away from the sweet spot, m^2 per m^2
    least_noise_m2: float  # nu > 0: g at the sweet spot
    sweet_spot_m: float  # r_s >= 0: the distance to the target that is best

    def __post_init__(self) -> None:
        for key in ("growth", "least_noise_m2", "sweet_spot_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and (value > 0.0 or (value, key) == (0.0, "sweet_spot_m"))):
                raise InputError(f"{value!r} is out of range", key=key, remedy="give more than 0")


def sensing_information(
    sensor: Sensor, positions_m: NDArray[np.float64], target_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the information of a packet, ``tr Phi^-1(q, p) = 1 / g(|q - p|)``, per m^2."""
    # Shapes: positions_m (..., 2); target_m (..., 2).
    # In place: searches ask for all nodes within reach, step after step.
    found = np.asarray(positions_m[..., 0] - target_m[..., 0])
    found *= found
    across = np.asarray(positions_m[..., 1] - target_m[..., 1])
    across *= across
    found += across
    found = np.sqrt(found)
    found -= sensor.sweet_spot_m
    found *= found
    found *= sensor.growth
    found += sensor.least_noise_m2
    return 1.0 / found


def noise_covariance_m2(
    sensor: Sensor, positions_m: NDArray[np.float64], target_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return Lambda = Phi(q, p) = 2 g I_2; ``(..., 2, 2)``."""
    information = sensing_information(sensor, positions_m, target_m)
    return (2.0 / information)[..., None, None] * np.eye(2)


def sense(
    sensor: Sensor,
    positions_m: NDArray[np.float64],  # (n, 2) where the robots are
    target_m: NDArray[np.float64],  # (2,) where the target is
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw measured positions z = p + noise of covariance Phi(q, p), one a robot."""
    deviation = np.sqrt(2.0 / sensing_information(sensor, positions_m, target_m))
    return target_m + deviation[:, None] * generator.standard_normal(positions_m.shape)


def sensing_derivatives(
    sensor: Sensor, positions_m: NDArray[np.float64], target_m: NDArray[np.float64]
) -> Derivatives:
    """Return 1 / g with gradient and Hessian by q.

    Exact from `CUSP_SHARE` r_s of the target on. Closer than that the distance is rounded
    (:mod:`planopt.targets.rounding`) in the value too, so that it belongs to its derivatives; g is
    then smaller than the exact one by at most 3/4 `CUSP_SHARE` varpi r_s^2.
    """
    offset = positions_m - target_m
    sweet = sensor.sweet_spot_m
    square = np.einsum("...i,...i->...", offset, offset)
    # Without a sweet spot g has no cusp, and the length's factor below is zero.
    width = CUSP_SHARE * sweet if sweet > 0.0 else 1.0
    length, slope, bend = rounded_radius(np.sqrt(square), width)
    growth = 2.0 * sensor.growth
    loss = growth * (0.5 * square - sweet * length + 0.5 * sweet**2) + sensor.least_noise_m2
    information = 1.0 / loss
    # Slope and bend of g, then of its reciprocal.
    steep, bent = growth - (growth * sweet) * slope, (-growth * sweet) * bend
    falling = -information * information
    slope = falling * steep
    bend = falling * bent - 2.0 * slope * steep * information
    return radial(offset, information, slope, bend)
