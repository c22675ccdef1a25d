"""The measurements nearest to a place, at a cost that hardly grows with their number.

A k-d tree holds most of the measured places. Those that came after it was built are compared one by
one, and the tree is built anew once they are many: a robot's measurements come singly, and a tree
of 50,000 places takes 15 ms.

Groups of neighbouring measurements, each with others beside it: many small problems for one.

Measurements are cut into blocks of neighbours by medians. A window is a block with the measurements
nearest to it, either all (what the others say of the block) or those of blocks that come before it
(Vecchia's factorisation of a density into conditional ones). The order of blocks is from coarse to
fine: each next one is the farthest from those before. Everything depends on where the measurements
are, not on the order in which they are given, but for ties.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree as ScipyKDTree

# SciPy ships no types.
KDTree: Any = ScipyKDTree


class PlaceTree:
    """Places in the plane, to be searched by distance."""

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        self._tree = KDTree(positions_m, balanced_tree=False)

    def __len__(self) -> int:
        return int(self._tree.n)

    def nearest(
        self, centres_m: NDArray[np.float64], count: int, within_m: float = np.inf
    ) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Indices of the `count` places nearest to each of `centres_m` (k, 2), and distances.

        Both ``(k, count)``, from the nearest to the farthest; `count` is at most n. Only places
        nearer than `within_m` are found: instead of others index n and an infinite distance stand.
        """
        distances, indices = self._tree.query(centres_m, count, distance_upper_bound=within_m)
        # One neighbour each comes without an axis of its own.
        shape = len(centres_m), count
        return np.asarray(indices, dtype=np.intp).reshape(shape), distances.reshape(shape)


MOST_UNTREED = 256
"""Places compared one by one at least, before a tree is worth its time."""

UNTREED_SHARE = 1.0 / 16.0
"""Places compared one by one at most, as a share of those in the tree."""


@dataclass(frozen=True, eq=False)
class PlaceIndex:
    """Measured places, to be searched by distance."""

    positions_m: NDArray[np.float64]  # (n, 2)
    tree: PlaceTree | None = None  # Of the first of them; None while they are few

    @staticmethod
    def of(positions_m: NDArray[np.float64]) -> PlaceIndex:
        """Index `positions_m` (n, 2)."""
        return PlaceIndex(positions_m).grown(positions_m)

    def grown(self, positions_m: NDArray[np.float64]) -> PlaceIndex:
        """The index of `positions_m` (n, 2), which begin with those of this one."""
        treed = 0 if self.tree is None else len(self.tree)
        keep = len(positions_m) - treed <= max(MOST_UNTREED, UNTREED_SHARE * treed)
        return PlaceIndex(positions_m, self.tree if keep else PlaceTree(positions_m))

    def nearest(
        self, centres_m: NDArray[np.float64], count: int
    ) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """The `count` places nearest to each centre, in no order, and how far the farthest is."""
        # Shapes: centres_m (k, 2).
        total = len(self.positions_m)
        if count >= total:
            everyone = np.broadcast_to(np.arange(total), (len(centres_m), total))
            return everyone, np.full(len(centres_m), np.inf)
        if self.tree is None:
            return _fewest(None, _squared_distances_m2(centres_m, self.positions_m), count)
        indices, distance_m = self.tree.nearest(centres_m, min(count, len(self.tree)))
        squared = distance_m * distance_m
        if len(self.tree) == total:
            return indices, squared[:, -1]
        late_squared = _squared_distances_m2(centres_m, self.positions_m[len(self.tree) :])
        nearer = (late_squared < squared[:, -1:]).any(axis=0)
        if count <= len(self.tree):
            if not nearer.any():
                return indices, squared[:, -1]
            # A place that is nowhere nearer than the farthest so far is no one's neighbour.
            late = len(self.tree) + np.flatnonzero(nearer)
            late_squared = late_squared[:, nearer]
        else:
            late = np.arange(len(self.tree), total)
        indices = np.concatenate(
            [indices, np.broadcast_to(late, (len(centres_m), len(late)))], axis=1
        )
        return _fewest(indices, np.concatenate([squared, late_squared], axis=1), count)


def _squared_distances_m2(
    centres_m: NDArray[np.float64], places_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Between every centre and every place; (k, 2) and (n, 2) -> (k, n)."""
    dx = centres_m[:, None, 0] - places_m[None, :, 0]
    dy = centres_m[:, None, 1] - places_m[None, :, 1]
    return dx * dx + dy * dy


def _fewest(
    indices: NDArray[np.intp] | None, squared_m2: NDArray[np.float64], count: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The `count` of least `squared_m2` (k, n); `indices` (k, n) are their numbers, if not 0..n."""
    chosen = np.argpartition(squared_m2, count - 1, axis=1)[:, :count]
    # Partitioning leaves the farthest of the chosen in the last column.
    each = np.arange(len(chosen))
    farthest = squared_m2[each, chosen[:, -1]]
    if indices is not None:
        chosen = indices[each[:, None], chosen]
    return chosen, farthest


BLOCK, BESIDE = 48, 128
"""Measurements of a block, and beside it in Vecchia's factorisation. On the three campus logs
(3,401 to 4,585 exact powers) the most likely xi, omega and beta are then within 0.07 standard
errors of those by one factor of all, and theta within 0.11; with 32 and 64 they were up to 0.46 and
0.24 off, and 64 and 192 take twice the time for no more."""

PRESELECTED = 4
"""Candidates by their distance from the block's box, as a multiple of those wanted; of these the
nearest to any of its members are taken."""


@dataclass(frozen=True, eq=False)
class Window:
    """A block of measurements and those it is conditioned on."""

    beside: NDArray[np.intp]  # (h,) numbers of the measurements it is conditioned on
    own: NDArray[np.intp]  # (b,) numbers of the block's

    @property
    def rows(self) -> NDArray[np.intp]:
        """``(h + b,)`` all of them, those beside first."""
        return np.concatenate([self.beside, self.own])


def place_blocks(coordinates: NDArray[np.float64], most: int) -> tuple[NDArray[np.intp], ...]:
    """Cut places (n, k) into blocks of `most` or few less; numbers ascend within each.

    Always along the widest side, so that blocks are compact.
    """
    blocks: list[NDArray[np.intp]] = []
    pending = [(np.arange(len(coordinates)), -(-len(coordinates) // most))]
    while pending:
        rows, parts = pending.pop()
        if parts <= 1:
            blocks.extend([np.sort(rows)] if len(rows) else [])
            continue
        widest = int(np.argmax(np.ptp(coordinates[rows], axis=0)))
        ranked = rows[np.argsort(coordinates[rows, widest], kind="stable")]
        cut = round(len(rows) * (parts // 2) / parts)
        pending += [(ranked[:cut], parts // 2), (ranked[cut:], parts - parts // 2)]
    return tuple(blocks)


def earlier_windows(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...], count: int
) -> tuple[Window, ...]:
    """Order blocks from coarse to fine, and give each the `count` nearest of those before it."""
    # Shapes: coordinates (n, k).
    windows: list[Window] = []
    before = np.zeros(0, dtype=np.intp)
    for number in _coarse_to_fine(coordinates, blocks):
        own = blocks[number]
        windows.append(Window(_nearest_to(coordinates, own, before, count), own))
        before = np.concatenate([before, own])
    return tuple(windows)


def later_windows(
    coordinates: NDArray[np.float64], index: PlaceIndex, count: int
) -> tuple[Window, ...]:
    """Give each row of `coordinates` (n, 2) beyond `index` the `count` nearest rows before it."""
    windows: list[Window] = []
    for row in range(len(index.positions_m), len(coordinates)):
        index = index.grown(coordinates[:row])
        near, _ = index.nearest(coordinates[row : row + 1], count)
        windows.append(Window(near[0], np.array([row])))
    return tuple(windows)


def surrounding_windows(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...], count: int
) -> tuple[Window, ...]:
    """Give each block the `count` nearest of all that are not in it."""
    everyone = np.arange(len(coordinates))
    windows: list[Window] = []
    for own in blocks:
        others = np.delete(everyone, own)
        windows.append(Window(_nearest_to(coordinates, own, others, count), own))
    return tuple(windows)


def _coarse_to_fine(
    coordinates: NDArray[np.float64], blocks: tuple[NDArray[np.intp], ...]
) -> list[int]:
    """Numbers of the blocks: the most central one, then always the farthest from all before."""
    if not blocks:
        return []
    centres = np.array([coordinates[own].mean(axis=0) for own in blocks])
    number = int(np.argmin(((centres - centres.mean(axis=0)) ** 2).sum(axis=1)))
    squared_m2 = np.full(len(blocks), np.inf)
    order: list[int] = []
    for _ in blocks:
        order.append(number)
        squared_m2 = np.minimum(squared_m2, ((centres - centres[number]) ** 2).sum(axis=1))
        # Those that are taken come last, whatever coincides with them.
        squared_m2[number] = -1.0
        number = int(np.argmax(squared_m2))
    return order


def _nearest_to(
    coordinates: NDArray[np.float64],
    own: NDArray[np.intp],
    others: NDArray[np.intp],
    count: int,
) -> NDArray[np.intp]:
    """Numbers of the `count` of `others` that are nearest to any of `own`; ascending."""
    for reach, distance in ((PRESELECTED * count, _beyond_box_m2), (count, _to_any_m2)):
        if len(others) > reach:
            squared_m2 = distance(coordinates[own], coordinates[others])
            others = others[np.argpartition(squared_m2, reach - 1)[:reach]]
    return np.sort(others)


def _beyond_box_m2(own: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance of each of `others` (m, k) from the box around `own` (b, k); ``(m,)``."""
    low, high = own.min(axis=0), own.max(axis=0)
    beyond = np.maximum(np.maximum(low - others, others - high), 0.0)
    return np.einsum("mk,mk->m", beyond, beyond)


def _to_any_m2(own: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance of each of `others` (m, k) from the nearest of `own` (b, k); ``(m,)``."""
    apart = others[:, None] - own
    return np.einsum("mbk,mbk->mb", apart, apart).min(axis=1)
