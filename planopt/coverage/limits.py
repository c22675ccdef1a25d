"""Limits of the agents of a network: motion, bodies, and radio links."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.region import positive
from planopt.coverage.station_map import StationMap
from planopt.errors import InputError


@dataclass(frozen=True)
class MoveLimits:
    """The limits of agents' motion, and the distances they keep."""

    time_step_s: float = 1.0  # Length of a step in s
    speed_m_s: float = math.inf  # Largest speed; infinite without limit
    # Largest acceleration of double integrators; None for single ones, whose velocity may jump
    acceleration_m_s2: float | None = None
    # Largest turn rate of unicycles, which turn on the spot and then drive straight, backwards too;
    # None for agents that move in all directions
    turn_rate_rad_s: float | None = None
    # Radius of the bodies; agents with 0 are points that may share a place
    body_radius_m: float = 0.0
    # What an agent's place keeps from obstacles and from the border; at least the body radius is
    # kept
    clearance_m: float = 0.0

    def __post_init__(self) -> None:
        positive(self.time_step_s, "control.time_step_s")
        if self.speed_m_s != math.inf:
            positive(self.speed_m_s, "limits.speed_m_s")
        positive(self.body_radius_m, "limits.body_radius_m", zero=True)
        positive(self.clearance_m, "limits.clearance_m", zero=True)
        for value, key in (
            (self.acceleration_m_s2, "limits.acceleration_m_s2"),
            (self.turn_rate_rad_s, "limits.turn_rate_rad_s"),
        ):
            if value is None:
                continue
            positive(value, key)
            if self.speed_m_s == math.inf:
                raise InputError(
                    "it needs a largest speed", key=key, remedy="give limits.speed_m_s"
                )
        if self.acceleration_m_s2 is not None and self.turn_rate_rad_s is not None:
            raise InputError(
                "unicycles with a largest acceleration cannot be planned",
                key="limits.turn_rate_rad_s",
                remedy="give one of both limits",
            )

    @property
    def keep_m(self) -> float:
        """Return the distance that an agent's place keeps from obstacles and border."""
        return max(self.body_radius_m, self.clearance_m)

    @property
    def longest_stop_m(self) -> float:
        """The way on which an agent at its largest speed brakes, in whole steps."""
        if self.acceleration_m_s2 is None:
            return 0.0
        steps = math.ceil(self.speed_m_s / (self.acceleration_m_s2 * self.time_step_s) - 1e-9)
        return 0.5 * steps * self.speed_m_s * self.time_step_s


def packing_reach_m(agents: int, body_radius_m: float) -> float:
    """Return how far from an event bodies that crowd around it may stand; 0 for points.

    In the hexagonal packing, ``m`` shells about a middle body hold ``1 + 3 m (m + 1)`` of them, the
    outermost at ``2 m`` radii. Bodies that got there one by one leave gaps: one shell more is
    allowed.
    """
    shells = math.ceil((math.sqrt(9.0 + 12.0 * max(agents - 1, 0)) - 3.0) / 6.0 - 1e-9)
    return 2.0 * (shells + 1) * body_radius_m if agents > 1 else body_radius_m


@dataclass(frozen=True, eq=False)
class LinkLaw:
    """The law by which the power of a link falls with its length.

    Power at distance d is normal with mean ``k_pl_db - 10 n_pl log10 d``. Its variance is that of
    shadowing and multipath and that of the uncertain path loss.
    """

    theta: NDArray[np.float64]  # (2,): k_pl_db and n_pl
    deviation_db: float  # Standard deviation of shadowing and multipath together
    theta_covariance: NDArray[np.float64]  # (2, 2); zero where path loss is known

    def __post_init__(self) -> None:
        if np.shape(self.theta) != (2,) or np.shape(self.theta_covariance) != (2, 2):
            raise InputError("path loss has two parameters, and their covariance", key="radio.link")
        numbers = [*np.ravel(self.theta), *np.ravel(self.theta_covariance)]
        if not np.isfinite(numbers).all() or not self.theta[1] > 0.0:
            raise InputError(
                f"path loss {list(self.theta)} is not finite, or does not fall with distance",
                key="radio.link",
            )
        positive(self.deviation_db, "radio.link.deviation_db", zero=True)
        if float(np.linalg.eigvalsh(self.theta_covariance).min()) < -1e-9:
            raise InputError("a covariance is not positive semidefinite", key="radio.link")


@dataclass(frozen=True, eq=False)
class RadioLimits:
    """The links to base stations that agents must keep, directly or over other agents."""

    stations_m: NDArray[np.float64]  # (s, 2) places of base stations
    # Links to a station, by a law of their length or by a map of places, and the law of links
    # between agents
    station_link: LinkLaw | StationMap
    agent_link: LinkLaw
    threshold_dbm: float  # Power that a link needs
    # Probability with which all links between an agent and a station have to hold together
    p_min: float

    def __post_init__(self) -> None:
        shape = np.shape(self.stations_m)
        if len(shape) != 2 or shape[1] != 2 or not shape[0]:
            raise InputError(f"stations of shape {shape}", key="radio.stations")
        if not np.isfinite(self.stations_m).all():
            raise InputError("a station is not at a finite place", key="radio.stations")
        link = self.station_link
        if isinstance(link, StationMap) and len(link.posteriors) != len(self.stations_m):
            raise InputError("a map for each station is needed", key="radio.stations")
        if not math.isfinite(self.threshold_dbm):
            raise InputError("it is not finite", key="radio.threshold_dbm")
        if not 0.0 < self.p_min < 1.0:
            raise InputError(f"{self.p_min!r} is not between 0 and 1", key="radio.p_min")
