"""The worst records that the bounds of a service allow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.pursuit import Chase, Record, ServiceBounds, Track

AGES, DIRECTIONS = 48, 24
"""Sample times and directions of the error that are tried for the worst record."""


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
        tracks: list[Track],
        pair: tuple[int, int],
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the worst record at a place and time; one without age always is allowed."""
        track = tracks[pair[1]]
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
