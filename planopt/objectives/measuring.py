"""Rule for the positions of a path at which a robot measures.

A robot measures at the end of a step, unless an earlier measurement is closer than the spacing:
multipath is known there already. The rule is not smooth, so solvers use smooth gates, steep enough
that the loop measures at a solver's optimum, and fully open for steps as long as the spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.neighbours import PlaceTree
from planopt.channel.posterior import ChannelPosterior

SPACING_TOLERANCE_M = 1e-5
"""Tolerance of the spacing: planned steps are slightly shorter than the step length."""
CLOSED_SPACINGS, OPEN_SPACINGS = 0.9, 1.02
"""Distances, in spacings, up to which a gate is closed and from which it is fully open."""
MOST_BESIDE = 8  # Maximum number of nearest earlier measurements that a gate depends on
LONGEST_PATH = 512
"""Number of positions above which a list is treated as a log and compared block by block."""
FEW_KNOWN = 1000
"""Number of measurements up to which a rule has one search tree, built once, for all paths."""


@dataclass(frozen=True, eq=False)
class MeasuringRule:
    """Rule that selects the positions of a path at which the robot measures."""

    spacing_m: float  # Distance to an earlier measurement below which none is taken
    # (n, 2) earlier measuring positions by station; all stations must be measured
    known_m: tuple[Floats, ...]

    @staticmethod
    def of(posteriors: Sequence[ChannelPosterior], spacing_m: float) -> MeasuringRule:
        """Return the rule for the earlier measurements of each station and a spacing."""
        known: list[Floats] = []
        for posterior in posteriors:
            places = posterior.measurements.positions_m
            if not any(np.array_equal(places, other) for other in known):
                known.append(places)
        return MeasuringRule(max(spacing_m - SPACING_TOLERANCE_M, SAME_PLACE_M), tuple(known))

    @cached_property
    def _trees(self) -> tuple[PlaceTree, ...]:
        """Search tree of each station's measurements."""
        return tuple(PlaceTree(known) for known in self.known_m)

    @property
    def open_m(self) -> float:
        """Distance to other measurements, in metres, from which a gate is fully open."""
        return OPEN_SPACINGS * self.spacing_m

    def near(self, paths_m: Floats, beyond_m: float = 0.0) -> MeasuringRule:
        """Return a rule that agrees with this one within `beyond_m` of `paths_m` (..., 2)."""
        places = paths_m.reshape(-1, 2)
        if not len(places) or sum(map(len, self.known_m)) <= FEW_KNOWN:
            return self
        room = beyond_m + self.open_m
        low, high = places.min(axis=0) - room, places.max(axis=0) + room
        return MeasuringRule(
            self.spacing_m,
            tuple(known[((known >= low) & (known <= high)).all(axis=1)] for known in self.known_m),
        )

    def is_open(self, places_m: Floats) -> Mask:
        """Return a mask (n,) of the positions (n, 2) that yield a measurement if visited alone."""
        found = np.zeros(len(places_m), dtype=np.bool_)
        for tree in self.near(places_m)._trees:
            distance, _ = _nearest(places_m, tree, 1, self.spacing_m)
            # A position yields none only if every station was measured within the spacing.
            found |= ~(distance[:, 0] < self.spacing_m)
        return found

    def takes(self, paths_m: Floats) -> Mask:
        """Return a mask of the path positions that yield a measurement if visited in order."""
        # Shapes: paths_m (..., N, 2); returns (..., N).
        if not paths_m.size:
            return np.zeros(paths_m.shape[:-1], dtype=np.bool_)
        if paths_m.ndim == 2 and len(paths_m) > LONGEST_PATH:
            # A long list needs memory linear in its length.
            rows = np.flatnonzero(self.is_open(paths_m))
            taken = rows[:0]
            for start in range(0, len(rows), LONGEST_PATH):
                block = rows[start : start + LONGEST_PATH]
                earlier = MeasuringRule(self.spacing_m, (paths_m[taken],))
                taken = np.concatenate([taken, block[earlier.takes(paths_m[block])]])
            return np.isin(np.arange(len(paths_m)), taken)
        each_path = paths_m.reshape(-1, *paths_m.shape[-2:])
        is_open = self.is_open(each_path.reshape(-1, 2)).reshape(each_path.shape[:2])
        return self._taken(is_open, _squared_between_m2(each_path)).reshape(paths_m.shape[:-1])

    def _taken(self, is_open: Mask, squared_m2: Floats) -> Mask:
        """Return :meth:`takes` for open positions (c, N) and squared distances (c, N, N)."""
        taken, close = is_open, squared_m2 < self.spacing_m**2
        if close.any():
            for k in range(1, taken.shape[1]):
                taken[:, k] &= ~(close[:, k, :k] & taken[:, :k]).any(axis=1)
        return taken

    def gates(self, paths_m: Floats) -> Gates | None:
        """Return smooth gates of paths (c, N, 2); None if all gates nearby are fully open."""
        count, steps = paths_m.shape[:2]
        places = paths_m.reshape(-1, 2)
        distance, offset = self._beside(places)
        squared = _squared_between_m2(paths_m)
        near = distance < self.open_m
        if not near.any() and not (squared < self.open_m**2).any():
            return None
        # The nearest measurement of the station that is farthest away, as in `is_open`.
        is_open = distance[:, 0] >= self.spacing_m
        taken = self._taken(is_open.reshape(count, steps), squared)
        # Earlier measuring positions of the path act like earlier measurements.
        squared = np.where(taken[:, None], squared, np.inf)
        known_log = _log_gate((distance * distance).reshape(count, steps, -1), self)
        own_log = _log_gate(squared, self)
        value = np.exp(known_log[0].sum(axis=2) + own_log[0].sum(axis=2))
        return Gates(value, paths_m, offset.reshape(count, steps, -1, 2), known_log, own_log)

    def _beside(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Return distances (n, m) and offsets (n, m, 2) to measurements that may close a gate."""
        # For several stations, use the one whose nearest measurement is farthest away.
        found: tuple[Floats, Floats] | None = None
        near = self.near(places_m)
        for tree, known in zip(near._trees, near.known_m, strict=True):
            distance, index = _nearest(places_m, tree, MOST_BESIDE, self.open_m)
            offset = np.zeros((*distance.shape, 2))
            if len(known):
                offset = places_m[:, None] - known[index]
            offset[np.isinf(distance)] = 0.0
            if found is None:
                found = distance, offset
                continue
            farther = distance[:, 0] > found[0][:, 0]
            found = (
                np.where(farther[:, None], distance, found[0]),
                np.where(farther[:, None, None], offset, found[1]),
            )
        if found is None:
            raise AssertionError("there is at least one station")
        return found


@dataclass(frozen=True, eq=False)
class Gates:
    """Smooth gates of paths (amplitudes of measurements from 0 to 1), with derivatives."""

    value: Floats  # (c, N) amplitude of the channel in each measurement, in [0, 1]
    _paths_m: Floats
    _offset_m: Floats
    _known: Floats
    _own: Floats

    def jacobian(self) -> Floats:
        """Return derivatives ``(c, N, 2 N)`` of the gates w.r.t. path coordinates x_1, y_1, ..."""
        return self.value[..., None] * self._log_slopes()

    def curvature(self, by_gate: Floats) -> Floats:
        """Return the Hessian ``(2 N, 2 N)`` of one path's gates, weighted by `by_gate` (N,)."""
        steps = len(by_gate)
        by_log = by_gate * self.value[0]
        slopes = self._log_slopes()[0]
        found = slopes.T @ (by_log[:, None] * slopes)
        blocks = found.reshape(steps, 2, steps, 2)
        every, unit = np.arange(steps), np.eye(2)
        # Second derivatives of log s(|o|^2) w.r.t. the offset o: 2 L' I + 4 L'' o o'.
        offset = self._offset_m[0]
        known = 4.0 * np.einsum("im,ima,imb->iab", self._known[2, 0], offset, offset)
        known += 2.0 * self._known[1, 0].sum(axis=1)[:, None, None] * unit
        blocks[every, :, every] += by_log[:, None, None] * known
        between = self._paths_m[0][:, None] - self._paths_m[0]
        own = 4.0 * self._own[2, 0, ..., None, None] * between[..., None] * between[..., None, :]
        own += 2.0 * self._own[1, 0, ..., None, None] * unit
        own *= by_log[:, None, None, None]
        blocks[every, :, every] += own.sum(axis=1) + own.sum(axis=0)
        blocks -= (own + own.transpose(1, 0, 2, 3)).transpose(0, 2, 1, 3)
        return found

    def _log_slopes(self) -> Floats:
        """Return the derivatives ``(c, N, 2 N)`` of log gates w.r.t. path coordinates."""
        steps = int(self.value.shape[1])
        found = np.zeros((len(self.value), steps, steps, 2))
        every = np.arange(steps)
        between = self._paths_m[:, :, None] - self._paths_m[:, None]
        crossed = 2.0 * self._own[1, ..., None] * between
        found -= crossed
        found[:, every, every] += crossed.sum(axis=2)
        found[:, every, every] += 2.0 * (self._known[1, ..., None] * self._offset_m).sum(axis=2)
        return found.reshape(-1, steps, 2 * steps)


def _log_gate(squared_m2: Floats, rule: MeasuringRule) -> Floats:
    """Return ``(3, ...)``: the log of a gate s, and two derivatives in the squared distance."""
    # s = u^3 (10 - 15 u + 6 u^2) rises from 0 (closed) to 1 (fully open) with two continuous
    # derivatives. If s = 0, log s is minus infinity and the derivatives are set to 0, like those of
    # the gate itself.
    low, high = (CLOSED_SPACINGS * rule.spacing_m) ** 2, rule.open_m**2
    found = np.zeros((3, *squared_m2.shape))
    closed = squared_m2 <= low
    found[0][closed] = -np.inf
    ramp = ~closed & (squared_m2 < high)
    u = (squared_m2[ramp] - low) / (high - low)
    s = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    slope = 30.0 * (u * (1.0 - u)) ** 2 / s
    bend = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / s
    found[0][ramp] = np.log(s)
    found[1][ramp] = slope / (high - low)
    found[2][ramp] = (bend - slope * slope) / (high - low) ** 2
    return found


def _squared_between_m2(paths_m: Floats) -> Floats:
    """Return squared distances ``(c, N, N)`` to earlier positions of a path; inf elsewhere."""
    steps = paths_m.shape[1]
    offset = paths_m[:, :, None] - paths_m[:, None]
    offset *= offset
    found = offset[..., 0] + offset[..., 1]
    found[:, np.arange(steps)[:, None] <= np.arange(steps)] = np.inf
    return found


def _nearest(
    places_m: Floats, tree: PlaceTree, count: int, within_m: float
) -> tuple[Floats, Indices]:
    """Return distances to the `count` nearest positions, inf beyond `within_m`, and indices."""
    there = min(count, len(tree))
    if not there:
        nothing = np.full((len(places_m), 1), np.inf)
        return nothing, np.zeros(nothing.shape, dtype=np.intp)
    index, distance = tree.nearest(places_m, there, within_m)
    return distance, np.minimum(index, len(tree) - 1)
