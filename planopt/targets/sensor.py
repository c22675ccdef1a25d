"""Sensor model of a robot: measurement noise as a function of the distance to the target.

[GM11] specifies ``tr Phi^-1 = 1 / g(r)`` but not Phi. Here Phi = 2 g I_2, which has this trace: the
noise is isotropic, and g is half the variance per axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.targets.rounding import Derivatives, radial, rounded_radius

CUSP_SHARE = 0.1
"""Radius within which the cusp at the target is smoothed, as a share of `sweet_spot_m`."""


@dataclass(frozen=True)
class Sensor:
    """Sensor with noise ``g(r) = varpi (r - r_s)^2 + nu`` at distance r (equation 4.8)."""

    growth: float  # varpi > 0: growth of the noise away from the sweet spot, m^2 per m^2
    least_noise_m2: float  # nu > 0: g at the sweet spot r_s
    sweet_spot_m: float  # r_s >= 0: distance to the target with the least noise

    def __post_init__(self) -> None:
        for key in ("growth", "least_noise_m2", "sweet_spot_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and (value > 0.0 or (value, key) == (0.0, "sweet_spot_m"))):
                raise InputError(
                    f"is {value!r}, which is out of range", key=key, remedy="give a number above 0"
                )


def sensing_information(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Floats:
    """Return the information of a packet, ``tr Phi^-1(q, p) = 1 / g(|q - p|)``, per m^2."""
    # Shapes: positions_m (..., 2); target_m (..., 2).
    # Computed in place, because searches evaluate all reachable nodes at every step.
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


def noise_covariance_m2(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Floats:
    """Return the noise covariance Lambda = Phi(q, p) = 2 g I_2; ``(..., 2, 2)``."""
    information = sensing_information(sensor, positions_m, target_m)
    return (2.0 / information)[..., None, None] * np.eye(2)


def sense(
    sensor: Sensor,
    positions_m: Floats,  # (n, 2) positions of the robots
    target_m: Floats,  # (2,) position of the target
    generator: np.random.Generator,
) -> Floats:
    """Return a drawn target measurement per robot, z = p + noise of covariance Phi(q, p)."""
    deviation = np.sqrt(2.0 / sensing_information(sensor, positions_m, target_m))
    return target_m + deviation[:, None] * generator.standard_normal(positions_m.shape)


def sensing_derivatives(sensor: Sensor, positions_m: Floats, target_m: Floats) -> Derivatives:
    """Return the information 1 / g of a packet with gradient and Hessian w.r.t. q.

    The result is exact at distances of at least `CUSP_SHARE` r_s from the target. At smaller
    distances it uses the smoothed distance of :mod:`planopt.targets.rounding`; g is then too small
    by at most 3/4 `CUSP_SHARE` varpi r_s^2.
    """
    offset = positions_m - target_m
    sweet = sensor.sweet_spot_m
    square = np.einsum("...i,...i->...", offset, offset)
    # If r_s = 0, g has no cusp and the factor of the length below is zero.
    width = CUSP_SHARE * sweet if sweet > 0.0 else 1.0
    length, slope, bend = rounded_radius(np.sqrt(square), width)
    growth = 2.0 * sensor.growth
    loss = growth * (0.5 * square - sweet * length + 0.5 * sweet**2) + sensor.least_noise_m2
    information = 1.0 / loss
    # Slope and bend of g, then of 1 / g.
    steep, bent = growth - (growth * sweet) * slope, (-growth * sweet) * bend
    falling = -information * information
    slope = falling * steep
    bend = falling * bent - 2.0 * slope * steep * information
    return radial(offset, information, slope, bend)
