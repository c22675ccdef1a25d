"""Motion states of agents and their limits: dynamics, bodies and required radio links."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.ndimage import maximum_filter

from planopt.arrays import Floats
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError

NODES = 120  # Number of map nodes along the longer side of the bounds


@dataclass(frozen=True, eq=False)
class StationMap:
    """Map of failure probabilities of links to base stations; :func:`station_map` builds it."""

    posteriors: tuple[ChannelPosterior, ...]  # Channel posterior of each of s stations
    nodes_m: Floats  # (m, 2) nodes of a regular grid
    radius_m: float  # Radius of the disc that a node represents; the discs cover the bounds
    # (s, m) largest probability at the node, its neighbours and nearby measured positions
    failures: Floats

    def near(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the largest failure probability (n, s) of links to each station on each line."""
        worst = np.ones((len(starts_m), len(self.posteriors)))
        for row, start, end in zip(worst, starts_m, ends_m, strict=True):
            met = line_distances_m(self.nodes_m, start, end)[1] <= self.radius_m
            row[:] = self.failures[:, met].max(axis=1, initial=0.0) if met.any() else 1.0
        return worst


def line_distances_m(places_m: Floats, start_m: Floats, end_m: Floats) -> tuple[Floats, Floats]:
    """Return the point of a segment nearest to each position (m, 2), and its distance (m,)."""
    along, offset = end_m - start_m, places_m - start_m
    square = float(along @ along)
    share = np.clip(offset @ along / (square if square > 0.0 else 1.0), 0.0, 1.0)
    foot = start_m + share[:, None] * along
    return foot, np.linalg.norm(places_m - foot, axis=1)


def station_map(
    posteriors: Sequence[ChannelPosterior],
    threshold_dbm: float,
    bounds_m: tuple[float, float, float, float],  # (x_min, y_min, x_max, y_max)
) -> StationMap:
    """Return a map of the probabilities that each station's power is below a threshold."""
    x_min, y_min, x_max, y_max = bounds_m
    side = max(x_max - x_min, y_max - y_min) / NODES
    x, y = np.arange(x_min, x_max + side, side), np.arange(y_min, y_max + side, side)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    failures = np.empty((len(posteriors), len(nodes)))
    for row, posterior in zip(failures, posteriors, strict=True):
        fails = 1.0 - posterior.connectivity(nodes, threshold_dbm)
        measured = posterior.measurements.positions_m
        at = np.rint((measured - (x_min, y_min)) / side).astype(np.intp)
        inside = ((at >= 0) & (at < (len(x), len(y)))).all(axis=1)
        cell = at[inside, 1] * len(x) + at[inside, 0]
        np.maximum.at(fails, cell, 1.0 - posterior.connectivity(measured[inside], threshold_dbm))
        image = fails.reshape(len(y), len(x))
        row[:] = np.ravel(cast("Floats", maximum_filter(image, size=3, mode="nearest")))
    return StationMap(tuple(posteriors), nodes, side / np.sqrt(2.0), failures)


@dataclass(frozen=True)
class MoveLimits:
    """Motion limits and clearances of agents."""

    time_step_s: float = 1.0
    speed_m_s: float = math.inf  # Largest speed; infinite without limit
    # Largest acceleration of double integrators; None for single integrators
    acceleration_m_s2: float | None = None
    # Largest turn rate of unicycles, which turn on the spot; None for holonomic agents
    turn_rate_rad_s: float | None = None
    body_radius_m: float = 0.0  # Radius of the body; 0 for points, which may coincide
    clearance_m: float = 0.0  # Required distance to obstacles and outer boundary

    def __post_init__(self) -> None:
        for value, key in (
            (self.acceleration_m_s2, "agents.acceleration_max_m_s2"),
            (self.turn_rate_rad_s, "agents.turn_rate_max_rad_s"),
        ):
            if value is not None and self.speed_m_s == math.inf:
                raise InputError(
                    "needs a maximum speed", key=key, remedy="give agents.speed_max_m_s in m/s"
                )
        if self.acceleration_m_s2 is not None and self.turn_rate_rad_s is not None:
            raise InputError(
                "cannot be combined with agents.acceleration_max_m_s2: agents have either a "
                "turn rate or an acceleration limit",
                key="agents.turn_rate_max_rad_s",
                remedy="leave out one of the two limits",
            )

    @property
    def longest_stop_m(self) -> float:
        """Return the braking distance from full speed, over a whole number of steps."""
        if self.acceleration_m_s2 is None:
            return 0.0
        steps = math.ceil(self.speed_m_s / (self.acceleration_m_s2 * self.time_step_s) - 1e-9)
        return 0.5 * steps * self.speed_m_s * self.time_step_s


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion state of agents: positions, velocities and headings."""

    places_m: Floats  # (n, 2)
    # (n, 2) velocities at the end of the last step. A double integrator has a constant acceleration
    # during a step; other agents change their velocity instantly.
    velocities_m_s: Floats
    headings_rad: Floats  # (n,); used only by unicycles

    @classmethod
    def at_rest(cls, places_m: Floats) -> Motion:
        """Return the state of stationary agents at positions ``(n, 2)`` with zero headings."""
        return cls(places_m, np.zeros_like(places_m), np.zeros(len(places_m)))


def packing_reach_m(agents: int, body_radius_m: float) -> float:
    """Return the largest distance from an event to bodies packed around it; 0 for points."""
    # In the hexagonal packing, ``m`` shells about a central body hold ``1 + 3 m (m + 1)`` bodies,
    # the outermost at ``2 m`` radii. One more shell is allowed because bodies that arrive one by
    # one leave gaps.
    shells = math.ceil((math.sqrt(9.0 + 12.0 * max(agents - 1, 0)) - 3.0) / 6.0 - 1e-9)
    return 2.0 * (shells + 1) * body_radius_m if agents > 1 else body_radius_m


@dataclass(frozen=True, eq=False)
class LinkLaw:
    """Log-distance path loss law of a link with uncertain parameters."""

    # The power in dBm at distance d is Gaussian with mean ``k_pl_db - 10 n_pl log10 d``. Its
    # variance is the sum of the variances of fading (shadowing and multipath) and of the path
    # loss.

    theta: Floats  # (2,): k_pl_db and n_pl
    deviation_db: float  # Standard deviation of shadowing and multipath together
    theta_covariance: Floats  # (2, 2) covariance of theta; zero for known path loss


@dataclass(frozen=True, eq=False)
class RadioLimits:
    """Requirement that agents stay connected to base stations, directly or via other agents."""

    stations_m: Floats  # (s, 2) positions of base stations
    # Model of links to a station, a law or a map, and law of links between agents
    station_link: LinkLaw | StationMap
    agent_link: LinkLaw
    threshold_dbm: float  # Power required for a link
    p_min: float  # Required probability that all links on an agent's path to a station hold
