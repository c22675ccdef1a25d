"""Motion of the agents of a network and its limits: bodies, and links by a law or by a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError

NODES = 120
"""Nodes of a map along the longer side of its bounds."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StationMap:
    """Probabilities that links to stations fail; :func:`station_map` makes it."""

    posteriors: tuple[ChannelPosterior, ...]  # Learnt channel to each of s stations
    nodes_m: Floats  # (m, 2) nodes of an even grid
    radius_m: float  # Radius of the disc that a node represents; the discs cover the bounds
    # (s, m) the largest probability found about each node: of its neighbours, and of measured
    # positions nearby, where the predicted power may have its peaks
    failures: Floats

    def near(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the largest probabilities ``(n, s)`` near lines from starts to ends, (n, 2) each.

        The largest value is taken over the nodes whose discs meet the line.
        """
        worst = np.ones((len(starts_m), len(self.posteriors)))
        for row, start, end in zip(worst, starts_m, ends_m, strict=True):
            met = line_distances_m(self.nodes_m, start, end)[1] <= self.radius_m
            row[:] = self.failures[:, met].max(axis=1, initial=0.0) if met.any() else 1.0
        return worst


def line_distances_m(places_m: Floats, start_m: Floats, end_m: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of a line to positions ``(m, 2)``, and distances ``(m,)``."""
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
    """Map how probably the power from each station is below a threshold."""
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
    """The limits of agents' motion, and the distances they keep."""

    time_step_s: float = 1.0
    speed_m_s: float = math.inf  # Largest speed; infinite without limit
    # Largest acceleration of double integrators; None for single ones, whose velocity may jump
    acceleration_m_s2: float | None = None
    # Largest turn rate of unicycles, which turn on the spot and then drive straight, backwards too;
    # None for agents that move in all directions
    turn_rate_rad_s: float | None = None
    body_radius_m: float = 0.0  # Agents with radius 0 are points that may coincide
    clearance_m: float = 0.0  # Required distance to obstacles and border; at least the body radius

    def __post_init__(self) -> None:
        for value, key in (
            (self.acceleration_m_s2, "agents.acceleration_max_m_s2"),
            (self.turn_rate_rad_s, "agents.turn_rate_max_rad_s"),
        ):
            if value is not None and self.speed_m_s == math.inf:
                raise InputError(
                    "it needs a largest speed", key=key, remedy="give agents.speed_max_m_s"
                )
        if self.acceleration_m_s2 is not None and self.turn_rate_rad_s is not None:
            raise InputError(
                "unicycles with a largest acceleration cannot be planned",
                key="agents.turn_rate_max_rad_s",
                remedy="give one of both limits",
            )

    @property
    def keep_m(self) -> float:
        """Return the distance that agents keep from obstacles and border."""
        return max(self.body_radius_m, self.clearance_m)

    @property
    def longest_stop_m(self) -> float:
        """Return the braking distance at the largest speed, in whole steps."""
        if self.acceleration_m_s2 is None:
            return 0.0
        steps = math.ceil(self.speed_m_s / (self.acceleration_m_s2 * self.time_step_s) - 1e-9)
        return 0.5 * steps * self.speed_m_s * self.time_step_s


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions, velocities and headings of agents."""

    places_m: Floats  # (n, 2)
    # (n, 2) velocities at the end of the last step. A double integrator changes its velocity evenly
    # during a step; other agents have that of the step's end at once.
    velocities_m_s: Floats
    headings_rad: Floats  # (n,); used by unicycles alone

    @classmethod
    def at_rest(cls, places_m: Floats) -> Motion:
        """Return the motion of agents that stand at positions ``(n, 2)``, with headings of 0."""
        return cls(places_m, np.zeros_like(places_m), np.zeros(len(places_m)))


def packing_reach_m(agents: int, body_radius_m: float) -> float:
    """Return the largest distance from an event of bodies that crowd around it; 0 for points.

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

    theta: Floats  # (2,): k_pl_db and n_pl
    deviation_db: float  # Standard deviation of shadowing and multipath together
    theta_covariance: Floats  # (2, 2); zero where path loss is known


@dataclass(frozen=True, eq=False)
class RadioLimits:
    """The links to base stations that agents must keep, directly or over other agents."""

    stations_m: Floats  # (s, 2) positions of base stations
    # Links to a station, by a law of their length or by a map, and the law of links between agents
    station_link: LinkLaw | StationMap
    agent_link: LinkLaw
    threshold_dbm: float  # Power that a link needs
    p_min: float  # Required probability that all links between an agent and a station hold
