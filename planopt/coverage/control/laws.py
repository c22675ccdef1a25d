"""The control laws: agents drive to their event, or to the centroid of their cell.

Responding agents follow ``dp/dt = -k_1 (p - s)``, covering ones ``dp/dt = -k_2 (p - C)``. The
functions take any number of dimensions where they take positions and targets alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.ground import Cover, Ground
from planopt.coverage.region import positive
from planopt.coverage.voronoi import merge_coincident
from planopt.errors import InputError

SPLIT = 1e-9
"""Covering agents at one place are taken apart by this share of the region's radius: their common
cell is then cut into sectors, one for each, and they leave each other."""

Partition = Literal["all", "coverage_only"]
"""Whose cells divide the region: those of all agents, or of the covering ones alone."""


@dataclass(frozen=True)
class Gains:
    """Gains of the laws."""

    event_per_s: float = 1.0  # k_1, of agents that respond to an event, in 1/s
    coverage_per_s: float = 1.0  # k_2, of agents that cover, in 1/s

    def __post_init__(self) -> None:
        positive(self.event_per_s, "control.event_gain_per_s")
        positive(self.coverage_per_s, "control.coverage_gain_per_s")

    def shares(self, responds: NDArray[np.bool_], time_step_s: float) -> NDArray[np.float64]:
        """Return the share of the distance to its target that each agent covers in a step; (n,)."""
        largest = max(self.event_per_s, self.coverage_per_s) * time_step_s
        if not 0.0 < largest <= 1.0 + 1e-12:
            raise InputError(
                f"{time_step_s:g} s times the largest gain is {largest:g}",
                key="control.time_step_s",
                remedy="keep it above 0 and at most 1, or agents overshoot",
            )
        return np.minimum(
            time_step_s * np.where(responds, self.event_per_s, self.coverage_per_s), 1.0
        )


def coverage_aims(
    ground: Ground,
    agents_m: NDArray[np.float64],  # (n, 2) all agents
    responds: NDArray[np.bool_],  # (n,) whether an agent responds to an event
    partition: Partition = "all",
) -> Cover:
    """Return where covering agents should drive, and the cost of the partition."""
    alone = partition == "coverage_only" and not responds.all()
    counted = ~responds if alone else np.ones_like(responds)
    found = ground.cover(_apart(ground, agents_m, ~responds)[counted])
    targets = agents_m.copy()
    targets[~responds] = found.targets_m[~responds[counted]]
    return Cover(found.cost, targets)


def _apart(
    ground: Ground, agents_m: NDArray[np.float64], covers: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Agents (n, 2), covering ones at one place moved onto a tiny ring about it."""
    within_m = 0.5 * SPLIT * ground.hull.radius_m
    if np.diff(np.sort(agents_m[covers, 0])).min(initial=np.inf) > within_m:
        return agents_m
    group = merge_coincident(agents_m[covers], within_m)[1]
    size = np.bincount(group)[group]
    order = np.argsort(group, kind="stable")
    rank = np.empty(len(group), dtype=np.intp)
    rank[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    angle = 2.0 * np.pi * rank / size
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1) * (size > 1)[:, None]
    moved = agents_m.copy()
    moved[covers] = ground.nearest(agents_m[covers] + SPLIT * ground.hull.radius_m * ring)
    return moved


def law_moves(
    agents_m: NDArray[np.float64],
    targets_m: NDArray[np.float64],
    responds: NDArray[np.bool_],
    gains: Gains,
    time_step_s: float,
    speed_m_s: float | None = None,
) -> NDArray[np.float64]:
    """Return where agents are after a step of the laws, with targets held and speeds clipped."""
    move = gains.shares(responds, time_step_s)[:, None] * (targets_m - agents_m)
    if speed_m_s is not None:
        most = positive(speed_m_s, "limits.speed_m_s") * time_step_s
        length = np.linalg.norm(move, axis=1)
        move *= np.minimum(1.0, most / np.where(length > 0.0, length, 1.0))[:, None]
    return agents_m + move
