"""Records that a pursuer uses, and where it has them from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.pursuit.knowledge import Track, snapshot
from planopt.pursuit.service import SnapshotService


@dataclass(frozen=True, eq=False)
class Record:
    """The record of an evader."""

    sampled_s: float  # When it was seen
    reported_m: NDArray[np.float64]  # (2,) where, as far as is told
    error_m: float  # How far off that is at most


class RecordSource(Protocol):
    """The source of a pursuer's records."""

    def record(
        self,
        track: Track,
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return what is known at a place and time of the evader on `track`; None for nothing.

        `last` is the record in use. The track ends now.
        """
        ...


@dataclass(frozen=True, eq=False)
class SnapshotRecords:
    """Records of the mote that the pursuer stands at: the freshest level that shows the evader."""

    service: SnapshotService  # The grid
    # (L + 1, k) which rounds of each level have no report of the evader at the pursuer's mote,
    # because it was missed or hops were lost; round n is column n modulo k. None if none are.
    lost: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        rows = self.service.levels + 1
        if self.lost is not None and (self.lost.ndim != 2 or len(self.lost) != rows):
            raise InputError(f"lost rounds need {rows} rows, one a level", key="lost")

    def record(
        self,
        track: Track,
        place_m: NDArray[np.float64],
        time_s: float,
        last: Record | None,
    ) -> Record | None:
        """Return the report of the finest level that shows the evader to the mote here."""
        now = snapshot(self.service, track, time_s)
        shown = now.shown_at(self.service.cells(place_m, 0))
        if self.lost is not None:
            rounds = self.service.sample_numbers(time_s) % self.lost.shape[1]
            shown &= ~self.lost[np.arange(len(rounds)), rounds]
        if not shown.any():
            return None
        level = int(shown.argmax())
        return Record(
            float(now.sampled_s[level]), now.reported_m[level], self.service.error_bound_m(level)
        )


def draw_lost_rounds(
    service: SnapshotService, probability: float, rounds: int, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Draw which rounds are lost, each on its own, for :class:`SnapshotRecords`."""
    return generator.random((service.levels + 1, rounds)) < probability
