"""Worst cases within the bounds: records as bad as they may be, and ways to escape.

They show which conditions of the guarantees are needed: an evader escapes where ``a > 1``, however
fresh the records are, and where a pursuer lets an older record replace a fresher one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.guarantees import Chase, contraction
from planopt.pursuit.knowledge import Track
from planopt.pursuit.records import Record
from planopt.pursuit.service import ServiceBounds, require_number
from planopt.pursuit.theorems import Inequality
from planopt.world.least_distance import closest_approach_m

AGES, DIRECTIONS = 48, 24
"""Sample times and directions of the error that are tried for the worst record."""

ANGLES = 2048
"""Directions of the error that are tried for an escape."""


@dataclass(frozen=True)
class AdversarialRecords:
    """The worst record that the bounds allow by the sampled distance, looking one stage ahead.

    Of all records whose age and error are within the bounds at the distance of the pursuer from the
    place sampled, it gives the one that leaves the evader farthest from the reported place when the
    pursuer comes there, if the evader goes on as it did last.
    """

    bounds: ServiceBounds  # What must hold
    chase: Chase  # The speeds
    # Whether no record is older than the last one. Without it the pursuer may be sent back along
    # the trail, unless it keeps rule R itself.
    in_order: bool = True

    def record(
        self,
        track: Track,
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the worst record at a place and time; one without age always is allowed."""
        first_s = last.sampled_s if last is not None and self.in_order else float(track.times_s[0])
        sampled_s = np.linspace(min(first_s, time_s), time_s, AGES)
        sampled_m = track.at(sampled_s)
        away_m = np.linalg.norm(sampled_m - place_m, axis=1)
        allowed_s = np.maximum(self.bounds.age_s_m * away_m, self.bounds.age_floor_s)
        kept = time_s - sampled_s <= allowed_s
        error_m = np.maximum(self.bounds.relative_error * away_m, self.bounds.error_floor_m)[kept]
        angles = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
        turns = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        reported_m = sampled_m[kept][:, None] + error_m[:, None, None] * turns
        drive_s = np.linalg.norm(reported_m - place_m, axis=-1) / self.chase.pursuer_speed_m_s
        here_m, before_m = track.positions_m[-1], track.positions_m[-2:][0]
        lapse_s = track.times_s[-1] - track.times_s[-2:][0]
        velocity = (here_m - before_m) / lapse_s if lapse_s > 0.0 else np.zeros(2)
        left_m = np.linalg.norm(here_m + drive_s[..., None] * velocity - reported_m, axis=-1)
        row, column = np.unravel_index(int(left_m.argmax()), left_m.shape)
        return Record(float(sampled_s[kept][row]), reported_m[row, column], float(error_m[row]))


@dataclass(frozen=True)
class Escape:
    """Stages that never end, from exact times and errors of ``kappa d``.

    In each stage the report is off in a direction that makes this angle with that to the evader,
    and the evader runs straight the other way until the pursuer has come there.
    """

    angle_rad: float  # Between the error and the direction from the pursuer to the evader
    growth: float  # Distance at the end of a stage over that at its start, at least 1
    # Least distance during a stage over that at its start: whatever captures within less of the
    # first distance never does
    nearest_share: float


def find_escape(speed_ratio: float, relative_error: float) -> Escape:
    """Return the escape that keeps farthest away from a pursuer who drives to reports in stages.

    The distance grows by ``kappa + sqrt(1 + 2 kappa cos phi + kappa^2) / alpha`` in a stage, which
    is a for phi = 0. There the paths cross; at a small angle they do not, so that there is an
    escape whenever ``a > 1``.
    """
    require_number(speed_ratio, "speed_ratio", above=1.0)
    require_number(relative_error, "relative_error", least=0.0)
    needed = Inequality("1 below a", 1.0, contraction(speed_ratio, relative_error))
    if not needed.holds:
        raise InputError(str(needed), remedy="no evader escapes at these speeds and errors")
    # The largest angle at which the distance does not shrink.
    cosine = (speed_ratio * (1.0 - relative_error)) ** 2 - 1.0 - relative_error**2
    largest = math.acos(max(-1.0, min(1.0, cosine / (2.0 * relative_error))))
    angles = np.linspace(0.0, largest, ANGLES)
    error = relative_error * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reported = np.array([1.0, 0.0]) + error
    lasts = np.linalg.norm(reported, axis=1) / speed_ratio
    ends = np.array([1.0, 0.0]) - error / relative_error * lasts[:, None]
    nearest = closest_approach_m(np.zeros((1, 2)), reported, np.array([[1.0, 0.0]]), ends)
    best = int(nearest.argmax())
    return Escape(float(angles[best]), float(relative_error + lasts[best]), float(nearest[best]))
