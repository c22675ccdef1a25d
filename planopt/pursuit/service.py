"""A distance-sensitive snapshot service: a grid of motes that knows near objects better.

Motes stand on a square grid and hear their eight neighbours. Level-j cells are squares of 2^j by
2^j motes. A level-j round samples the cells, gathers each cell's state at the cell's head, and
floods it over the cell and the eight around it. So a mote has fresh and exact reports of what is
near, and old and coarse ones of what is far. Time is counted in TDMA frames, in which each mote
sends once: a hop takes a frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError

MAX_LEVELS = 12
"""A grid of 4096 x 4096 motes: beyond it maps of what motes know no longer fit in memory."""

HOPS_PER_ROUND = 3
"""Frames of a level-0 round: 2^j hops to the head and 2 * 2^j hops from it fit into 3 * 2^j."""

ROUNDING = 1e-9
"""Share of a round by which a time may miss an end of a round through rounding."""

INTERFERENCE_SIDE = 3
"""Motes of equal slot are three apart: neighbours of a mote then never send at once."""


@dataclass(frozen=True)
class ServiceBounds:
    """The bounds of a service on every record in use, at distance d of the object.

    Its age is at most ``max(age_s_m * d, age_floor_s)``, its error at most
    ``max(relative_error * d, error_floor_m)``.
    """

    age_s_m: float  # sigma: seconds of age a metre, latency and time since the last round together
    relative_error: float  # kappa = 1/k: metres of error a metre
    age_floor_s: float = 0.0  # What age and error may be however near the object is
    error_floor_m: float = 0.0
    # Seconds between rounds a metre, for services whose rounds are nested as those of
    # :class:`SnapshotService` are; None for others
    period_s_m: float | None = None

    def __post_init__(self) -> None:
        for key in ("age_s_m", "relative_error", "age_floor_s", "error_floor_m"):
            require_number(getattr(self, key), key, least=0.0)
        if self.period_s_m is not None:
            require_number(self.period_s_m, "period_s_m", least=0.0)


@dataclass(frozen=True)
class SnapshotService:
    """Snapshots on a grid of ``2^levels`` by ``2^levels`` motes."""

    levels: int  # L: the one cell of level L is the whole grid
    # Distance between neighbours. Mote (0, 0) stands half of it from both edges.
    mote_spacing_m: float
    frame_s: float  # A TDMA frame: slots a frame times slot width
    # c: a cell's report tells positions to 2^-c of its side, but no finer than one mote
    bits_per_axis: int
    # Frames of a level-0 round. More than the least, 3, leave time to repeat lost hops.
    hops_per_round: int = HOPS_PER_ROUND
    rate_divisor: int = 1  # r: a level's rounds start every r rounds' lengths
    # Whether the grid goes on beyond its edges, for pursuits in open space: cells of level L then
    # have neighbours too
    endless: bool = False

    def __post_init__(self) -> None:
        require_count(self.levels, "levels", 1, MAX_LEVELS)
        require_number(self.mote_spacing_m, "mote_spacing_m", above=0.0)
        require_number(self.frame_s, "frame_s", above=0.0)
        require_count(self.bits_per_axis, "bits_per_axis", 1)
        require_count(self.hops_per_round, "hops_per_round", HOPS_PER_ROUND)
        require_count(self.rate_divisor, "rate_divisor", 1)

    @property
    def motes_per_side(self) -> int:
        """N = 2^L."""
        return 1 << self.levels

    @property
    def side_m(self) -> float:
        """Side of the square from (0, 0) that the grid observes."""
        return self.motes_per_side * self.mote_spacing_m

    @property
    def bounds(self) -> ServiceBounds:
        """Return what holds for every mote at every time.

        Where a level j > 0 is used, the object was at least two cells of level j - 1 away at the
        sample of that level, so that ``2^j < 2 d`` in mote spacings. A round of ``B 2^j`` frames
        that starts every r lengths makes an age below ``(1 + r) B 2^j < 2 (1 + r) B d`` frames, 12
        for B = 3 and r = 1, and half the diagonal of a sub-cell is ``2^(j - c) / sqrt 2``.
        """
        frame_s_m = 2.0 * self.hops_per_round * self.frame_s / self.mote_spacing_m
        return ServiceBounds(
            age_s_m=(1 + self.rate_divisor) * frame_s_m,
            relative_error=relative_error(self.bits_per_axis),
            age_floor_s=(1 + self.rate_divisor) * self.hops_per_round * self.frame_s,
            error_floor_m=math.sqrt(0.5) * self.mote_spacing_m,
            period_s_m=self.rate_divisor * frame_s_m,
        )

    @property
    def rounds_s(self) -> NDArray[np.float64]:
        """``(L + 1,)`` length of a round of each level, from the sample to the last mote."""
        return self.hops_per_round * self.frame_s * np.exp2(np.arange(self.levels + 1))

    @property
    def periods_s(self) -> NDArray[np.float64]:
        """``(L + 1,)`` time between the samples of each level."""
        return self.rate_divisor * self.rounds_s

    def sample_numbers(self, time_s: float) -> NDArray[np.int64]:
        """Return which round of each level was the last to end by `time_s`; ``(L + 1,)``.

        Round k of a level samples at k of its periods. The network has always been running:
        numbers may be negative.
        """
        ended = (time_s - self.rounds_s) / self.periods_s
        return np.floor(ended + ROUNDING).astype(np.int64)

    def cells(self, positions_m: NDArray[np.float64], level: int) -> NDArray[np.int64]:
        """Return the level-j cell (column, row) of each position (..., 2), as ``(..., 2)``."""
        finest = np.floor(positions_m / self.mote_spacing_m).astype(np.int64)
        if not self.endless:
            # The far edges belong to the last motes.
            finest = np.clip(finest, 0, self.motes_per_side - 1)
        return finest >> level

    def reported_m(self, positions_m: NDArray[np.float64], level: int) -> NDArray[np.float64]:
        """Return the centre of the sub-cell that a level-j report tells for positions (..., 2)."""
        fine = max(0, level - self.bits_per_axis)
        side_m = self.mote_spacing_m * (1 << fine)
        return np.asarray((self.cells(positions_m, fine) + 0.5) * side_m, dtype=np.float64)

    def error_bound_m(self, level: int) -> float:
        """Return half the diagonal of a level-j report's sub-cell."""
        fine = max(0, level - self.bits_per_axis)
        return math.sqrt(0.5) * self.mote_spacing_m * (1 << fine)


def relative_error(bits_per_axis: float) -> float:
    """Return kappa = sqrt 2 * 2^-c: the largest error a metre of distance, above the floor."""
    return math.sqrt(2.0) * 2.0**-bits_per_axis


def slots_per_frame() -> int:
    """Return how many slots a colouring of the grid needs: no two of a mote's neighbours share one.

    Motes within two of each other must differ. A block of 3 by 3 motes needs nine colours, and the
    remainders of column and row by three are such a colouring.
    """
    return INTERFERENCE_SIDE * INTERFERENCE_SIDE


def slots(motes_per_side: int) -> NDArray[np.int64]:
    """Return the slot of every mote, ``(n, n)``, rows being y."""
    places = np.arange(motes_per_side) % INTERFERENCE_SIDE
    return INTERFERENCE_SIDE * places[:, None] + places


def require_number(
    value: float, key: str, *, least: float | None = None, above: float | None = None
) -> float:
    """Return a finite number at least `least` or above `above`, else raise an InputError."""
    if not math.isfinite(value):
        raise InputError(f"{value!r} is not a finite number", key=key)
    if least is not None and value < least:
        raise InputError(f"{value!r} is below {least:g}", key=key)
    if above is not None and value <= above:
        raise InputError(f"{value!r} is not above {above:g}", key=key)
    return value


def require_count(value: int, key: str, least: int, most: int | None = None) -> int:
    """Return a whole number in a range, else raise an InputError."""
    if isinstance(value, bool) or int(value) != value:
        raise InputError(f"{value!r} is not a whole number", key=key)
    if value < least or (most is not None and value > most):
        among = f"at least {least}" if most is None else f"from {least} to {most}"
        raise InputError(f"{value!r} is out of range", key=key, remedy=f"give a number {among}")
    return value
