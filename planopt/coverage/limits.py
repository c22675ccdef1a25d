"""Limits of the agents of a network: motion, bodies, and radio links by a law or by a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.posterior import ChannelPosterior
from planopt.coverage.region import positive
from planopt.errors import InputError

NODES = 120
"""Nodes of a map along the longer side of its bounds."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StationMap:
    """Probabilities that links to stations fail; :func:`station_map` makes it."""

    posteriors: tuple[ChannelPosterior, ...]  # The channel to each of s stations, as learnt
    nodes_m: Floats  # (m, 2) nodes of an even grid
    # Each node stands for a disc of this radius; the discs hold all places within the bounds
    radius_m: float
    # (s, m) the largest probability found about each node: of its neighbours, and of measured
    # places nearby, where the predicted power may have its peaks
    failures: Floats

    def near(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the largest probabilities ``(n, s)`` near lines from starts to ends, (n, 2) each.

        The places are those within the radius of a node whose disc meets the line.
        """
        worst = np.ones((len(starts_m), len(self.posteriors)))
        for row, start, end in zip(worst, starts_m, ends_m, strict=True):
            met = line_distances_m(self.nodes_m, start, end)[1] <= self.radius_m
            row[:] = self.failures[:, met].max(axis=1, initial=0.0) if met.any() else 1.0
        return worst


def line_distances_m(places_m: Floats, start_m: Floats, end_m: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of a line to places, ``(m, 2)``, and distances ``(m,)``."""
    # Shapes: places_m (m, 2); start_m, end_m (2,).
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
    longest = max(x_max - x_min, y_max - y_min)
    if not posteriors or not (x_min < x_max and y_min < y_max):
        raise InputError("no station, or nothing to map", key="radio.survey")
    side = longest / NODES
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
