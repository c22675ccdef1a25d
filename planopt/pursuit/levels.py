"""Bounds of pursuits that use nested rounds of snapshots, level by level (theorem 6).

The finest level that shows the evader limits the age and the error of a record, and the next finer
level, which does not show it, limits the distance from below. Both guarantees and their verifier
use these bounds; docs/theory/pursuit.md has the proof.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Indices

SIZES = np.exp2(np.arange(60.0))  # Sides of the cells of all levels, in units of the finest cell
MAX_STAGES = 100_000  # Number of stages after which a capture time counts as unbounded


@dataclass(frozen=True)
class LevelBounds:
    """Chase with records from nested rounds, whose cells and durations double with each level."""

    evader_m_s: float
    pursuer_m_s: float  # Above the evader's speed
    delay_s: float  # Time of a stage in addition to straight driving and waiting
    spacing_m: float  # Side of a level-0 cell
    round_s: float  # Time from sample to delivery of a level-0 round
    period_s: float  # Time between level-0 samples
    error: float  # Error is at most max(error d, least_error_m)
    least_error_m: float
    open_space: bool = True  # Whether distances are straight and pursuers drive straight

    @property
    def lag(self) -> float:
        """Return the evader displacement between rounds per half cell side; below 1."""
        return 2.0 * self.evader_m_s * self.period_s / self.spacing_m

    @cached_property
    def _unseen_m(self) -> Floats:
        """Return, by level, the least distance at which the next finer level misses the evader."""
        return np.append(0.0, SIZES[:-1]) * self.spacing_m

    @cached_property
    def _least_m(self) -> Floats:
        """Return the least distance bound (levels,) at which each level is used."""
        moved_m = self.evader_m_s * self.round_s * SIZES[:-1]
        return self._unseen_m + np.append(0.0, moved_m)

    @cached_property
    def _error_m(self) -> Floats:
        return np.maximum(self.error * self._unseen_m, self.least_error_m)

    @cached_property
    def _oldest_m(self) -> Floats:
        """Return, by level, the largest displacement of the evader during the age of a record."""
        return self.evader_m_s * (self.round_s + self.period_s) * SIZES

    @cached_property
    def _waited(self) -> tuple[Floats, Floats]:
        """Return the distance bound after a wait and the longest wait, by level."""
        # A record is older than the one in use only at levels whose cells are as small as errors.
        unseen_m = (1.0 - self.lag) * self._unseen_m
        level = np.searchsorted(unseen_m, self._error_m, side="right") - 1
        moved_m = self._oldest_m[level]
        wait_s = moved_m / self.evader_m_s - self.round_s * SIZES
        bound_m = self._error_m + moved_m + self.evader_m_s * self.delay_s
        return np.where(wait_s > 0.0, bound_m, -np.inf), np.maximum(wait_s, 0.0)

    def _level(self, bound_m: Floats) -> Indices:
        """Return the coarsest level whose record a stage with initial bound `bound_m` may use."""
        return np.searchsorted(self._least_m, bound_m, side="right") - 1

    def start_m(self, distance_m: float) -> float:
        """Return the distance bound at the first record, from the evader's sampled distance."""
        unseen_m = (1.0 - self.lag) * self._unseen_m
        level = int(np.searchsorted(unseen_m, distance_m, side="right")) - 1
        return distance_m + float(self._oldest_m[level])

    def next_bound_m(self, bound_m: Floats) -> Floats:
        """Return the largest distance bound after a driving stage or a waiting stage."""
        level = self._level(bound_m)
        lasting = np.maximum.accumulate(self._waited[0])
        return np.maximum(self._driven_m(bound_m, level), lasting[level])

    def _driven_m(self, bound_m: Floats, level: Indices) -> Floats:
        """Return the largest distance bound after a drive with a level's record (equation 8.18)."""
        ratio = self.evader_m_s / self.pursuer_m_s
        # A record of the finer level is at least as old as its round; periods double per level.
        aged_m = bound_m - self._unseen_m[level] + self.evader_m_s * self.period_s * SIZES[level]
        aged_m = np.where(level > 0, np.minimum(aged_m, self._oldest_m[level]), self._oldest_m[0])
        left_m = ratio * bound_m + (1.0 + ratio) * self._error_m[level] + (1.0 - ratio) * aged_m
        return left_m + self.evader_m_s * self.delay_s

    def floor_m(self) -> float:
        """Return the largest distance bound without guaranteed reduction."""
        # Below the age limit of a level W changes by a constant, above it W / alpha plus a constant
        # has one fixed point; the constant is negative if and only if this point is below the
        # limit.
        ratio = self.evader_m_s / self.pursuer_m_s
        fixed_m = self._oldest_m + (
            (1.0 + ratio) * self._error_m + self.evader_m_s * self.delay_s
        ) / (1.0 - ratio)
        limit_m = self._unseen_m + self.evader_m_s * self.round_s * SIZES
        limit_m[0] = 0.0
        used_until_m = np.append(self._least_m[1:], np.inf)
        driving = np.where(fixed_m >= limit_m, np.minimum(fixed_m, used_until_m), 0.0)
        waited_m = self._waited[0]
        waiting = np.where(waited_m >= self._least_m, waited_m, 0.0)
        return float(max(driving.max(), waiting.max()))

    def capture_time_s(self, distance_m: float, radius_m: float) -> float:
        """Return the bound on the capture time from the first sampled distance (equation 8.19)."""
        if not self.floor_m() < radius_m:
            return math.inf
        bound_m = first_m = self.start_m(distance_m)
        if first_m <= radius_m:
            return 0.0
        waited_m, wait_s = self._waited
        # A wait that ends within the capture radius would have been a capture.
        waits_m = self.pursuer_m_s * np.where(waited_m > radius_m, wait_s, 0.0)
        lost_m = np.maximum.accumulate(2.0 * self._error_m + waits_m)
        lost_m += self.pursuer_m_s * self.delay_s
        total_m = first_m - (radius_m if self.open_space else 0.0)
        for _ in range(MAX_STAGES):
            level = int(self._level(np.array(bound_m)))
            total_m += float(lost_m[level])
            bound_m = float(self.next_bound_m(np.array(bound_m)))
            if bound_m <= radius_m:
                return total_m / (self.pursuer_m_s - self.evader_m_s)
        return math.inf
