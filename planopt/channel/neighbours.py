"""Nearest-neighbour search in measurements, and blocks of measurements with their neighbours.

Later positions are compared one by one until the k-d tree is rebuilt, because measurements arrive
singly and a tree of 50,000 takes 15 ms to build. Blocks are ordered from coarse to fine: each is
the farthest from all earlier ones. Windows do not depend on the order of rows, except for ties.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import KDTree as ScipyKDTree

from planopt.arrays import Floats, Indices

# SciPy ships no types.
KDTree: Any = ScipyKDTree

MOST_UNTREED = 256  # Maximum number of positions outside the search tree, unless the tree is large
UNTREED_SHARE = 1.0 / 16.0
"""Maximum number of positions outside the search tree, as a share of those in it."""
BLOCK, BLOCK_NEIGHBOURS = 48, 128
"""Block size, and number of neighbours in Vecchia's factorisation. On the three campus logs (3,401
to 4,585 exact powers) the estimates of xi, omega and beta are then within 0.07 standard errors of
the exact ones, and theta within 0.11. 32 and 64 give 0.46 and 0.24; 64 and 192 take twice the time
without a gain."""
NO_ROWS = np.zeros(0, dtype=np.intp)
OBLIQUE = np.array([math.cos(1.0), math.sin(1.0)])
"""Direction along which the nodes of a lattice differ."""
PRESELECTED = 4
"""Number of candidates per required neighbour, preselected by distance from the block's box."""


class PlaceTree:
    """Search tree of positions in the plane."""

    def __init__(self, positions_m: Floats) -> None:
        self._positions_m = positions_m

    @cached_property
    def _tree(self) -> Any:
        return KDTree(self._positions_m, balanced_tree=False)

    @cached_property
    def _sorted(self) -> tuple[Indices, Floats]:
        """Order of the positions along `OBLIQUE`, and their sorted coordinates."""
        along_m = self._positions_m @ OBLIQUE
        order = along_m.argsort(kind="stable")
        return order, along_m[order]

    def __len__(self) -> int:
        return len(self._positions_m)

    def nearest(
        self, centres_m: Floats, count: int, within_m: float = np.inf
    ) -> tuple[Indices, Floats]:
        """Return indices and distances of the `count` positions nearest to each centre (k, 2)."""
        # Both are ``(k, count)``, sorted; positions beyond `within_m` have index n.
        distances, indices = self._tree.query(centres_m, count, distance_upper_bound=within_m)
        # The tree drops the last axis for a single neighbour.
        shape = len(centres_m), count
        return np.asarray(indices, dtype=np.intp).reshape(shape), distances.reshape(shape)

    def within(self, centres_m: Floats, reach_m: float) -> tuple[Indices, Indices]:
        """Return index pairs (centre, position) within a short distance of centres (k, 2)."""
        along_m, (order, sorted_m) = centres_m @ OBLIQUE, self._sorted
        first = sorted_m.searchsorted(along_m - reach_m)
        count = sorted_m.searchsorted(along_m + reach_m, side="right") - first
        if not count.any():
            return NO_ROWS, NO_ROWS
        centres = np.arange(len(count)).repeat(count)
        before = (count.cumsum() - count - first).repeat(count)
        rows = order[np.arange(len(centres)) - before]
        offset = self._positions_m[rows] - centres_m[centres]
        near = np.hypot(offset[:, 0], offset[:, 1]) <= reach_m
        return centres[near], rows[near]


@dataclass(frozen=True, eq=False)
class PlaceIndex:
    """Nearest-neighbour index of measured positions, with a tree of earlier positions."""

    positions_m: Floats  # (n, 2)
    tree: PlaceTree | None = None  # None if there are few positions

    @staticmethod
    def of(positions_m: Floats) -> PlaceIndex:
        """Return a nearest-neighbour index of `positions_m` (n, 2)."""
        return PlaceIndex(positions_m).grown(positions_m)

    def grown(self, positions_m: Floats) -> PlaceIndex:
        """Return an index of `positions_m`; their first rows must be this index's positions."""
        treed = self._treed
        keep = len(positions_m) - treed <= max(MOST_UNTREED, UNTREED_SHARE * treed)
        return PlaceIndex(positions_m, self.tree if keep else PlaceTree(positions_m))

    def nearest(
        self,
        centres_m: Floats,  # (k, 2)
        count: int,
    ) -> tuple[Indices, Floats]:
        """Return indices (k, count) of nearest positions, and largest squared distances (k,)."""
        # Indices are unsorted. Up to `count` positions are all returned, with infinite distances.
        total = len(self.positions_m)
        if count >= total:
            everyone = np.broadcast_to(np.arange(total), (len(centres_m), total))
            return everyone, np.full(len(centres_m), np.inf)
        treed = self._treed
        late = np.arange(treed, total)
        difference = centres_m[:, None] - self.positions_m[None, treed:]
        squared_m2 = difference[..., 0] ** 2 + difference[..., 1] ** 2
        indices = np.broadcast_to(late, squared_m2.shape)
        if self.tree is not None:
            in_tree, distance_m = self.tree.nearest(centres_m, min(count, treed))
            in_tree_m2 = distance_m * distance_m
            if count <= treed:
                # Later positions beyond the farthest neighbour so far are not candidates.
                nearer = (squared_m2 < in_tree_m2[:, -1:]).any(axis=0)
                if not nearer.any():
                    return in_tree, in_tree_m2[:, -1]
                indices, squared_m2 = indices[:, nearer], squared_m2[:, nearer]
            indices = np.concatenate([in_tree, indices], axis=1)
            squared_m2 = np.concatenate([in_tree_m2, squared_m2], axis=1)
        chosen = np.argpartition(squared_m2, count - 1, axis=1)[:, :count]
        # Partitioning puts the farthest neighbour into the last column.
        farthest = np.take_along_axis(squared_m2, chosen[:, -1:], axis=1)[:, 0]
        return np.take_along_axis(indices, chosen, axis=1), farthest

    def within(self, centres_m: Floats, reach_m: float) -> tuple[Indices, Indices]:
        """Return sorted index pairs (centre, position) within `reach_m` for centres (k, 2)."""
        found = [
            (centres, first + rows)
            for first, tree in ((0, self.tree), (self._treed, self._late_tree))
            if tree is not None
            for centres, rows in (tree.within(centres_m, reach_m),)
            if len(centres)
        ]
        if not found:
            return NO_ROWS, NO_ROWS
        centres, rows = (np.concatenate(each) for each in zip(*found, strict=True))
        order = np.lexsort((rows, centres))
        return centres[order], rows[order]

    @property
    def _treed(self) -> int:
        """Number of positions in the tree."""
        return 0 if self.tree is None else len(self.tree)

    @cached_property
    def _late_tree(self) -> PlaceTree | None:
        """Tree of the positions outside the main tree; None if there are none."""
        late = self.positions_m[self._treed :]
        return PlaceTree(late) if len(late) else None


NOWHERE = PlaceIndex(np.zeros((0, 2)))  # Index of no positions


@dataclass(frozen=True, eq=False)
class Window:
    """Block of measurements with the neighbours on which it is conditioned."""

    near: Indices  # (h,) indices of the neighbours
    own: Indices  # (b,) indices of the block's measurements

    @property
    def rows(self) -> Indices:
        """Indices (h + b,) of the h neighbours, then of the b measurements of the block."""
        return np.concatenate([self.near, self.own])


def place_blocks(coordinates: Floats, most: int) -> tuple[Indices, ...]:
    """Divide positions (n, k) into compact blocks of about `most`; return ascending indices."""
    blocks: list[Indices] = []
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
    coordinates: Floats,  # (n, k)
    blocks: tuple[Indices, ...],
    count: int,
) -> tuple[Window, ...]:
    """Return blocks from coarse to fine, each with the `count` nearest earlier measurements."""
    windows: list[Window] = []
    before = np.zeros(0, dtype=np.intp)
    for number in _coarse_to_fine(coordinates, blocks):
        own = blocks[number]
        windows.append(Window(_nearest_to(coordinates, own, before, count), own))
        before = np.concatenate([before, own])
    return tuple(windows)


def later_windows(coordinates: Floats, index: PlaceIndex, count: int) -> tuple[Window, ...]:
    """Return a window with earlier neighbours for each position (n, 2) that is not in `index`."""
    windows: list[Window] = []
    for row in range(len(index.positions_m), len(coordinates)):
        index = index.grown(coordinates[:row])
        near, _ = index.nearest(coordinates[row : row + 1], count)
        windows.append(Window(near[0], np.array([row])))
    return tuple(windows)


def surrounding_windows(
    coordinates: Floats, blocks: tuple[Indices, ...], count: int
) -> tuple[Window, ...]:
    """Return each block with the `count` nearest measurements outside the block."""
    everyone = np.arange(len(coordinates))
    return tuple(
        Window(_nearest_to(coordinates, own, np.delete(everyone, own), count), own)
        for own in blocks
    )


def _coarse_to_fine(coordinates: Floats, blocks: tuple[Indices, ...]) -> list[int]:
    """Return the order of blocks: the most central, then repeatedly the farthest one."""
    if not blocks:
        return []
    centres = np.array([coordinates[own].mean(axis=0) for own in blocks])
    number = int(np.argmin(((centres - centres.mean(axis=0)) ** 2).sum(axis=1)))
    squared_m2 = np.full(len(blocks), np.inf)
    order: list[int] = []
    for _ in blocks:
        order.append(number)
        squared_m2 = np.minimum(squared_m2, ((centres - centres[number]) ** 2).sum(axis=1))
        # Blocks already in the order come last, even if other blocks coincide with them.
        squared_m2[number] = -1.0
        number = int(np.argmax(squared_m2))
    return order


def _nearest_to(coordinates: Floats, own: Indices, others: Indices, count: int) -> Indices:
    """Return the `count` indices in `others` nearest to any of `own`, in ascending order."""
    for reach, distance in ((PRESELECTED * count, _beyond_box_m2), (count, _to_any_m2)):
        if len(others) > reach:
            squared_m2 = distance(coordinates[own], coordinates[others])
            others = others[np.argpartition(squared_m2, reach - 1)[:reach]]
    return np.sort(others)


def _beyond_box_m2(own: Floats, others: Floats) -> Floats:
    """Return the squared distances (m,) of `others` from the bounding box of `own`."""
    low, high = own.min(axis=0), own.max(axis=0)
    beyond = np.maximum(np.maximum(low - others, others - high), 0.0)
    return np.einsum("mk,mk->m", beyond, beyond)


def _to_any_m2(own: Floats, others: Floats) -> Floats:
    """Return the squared distance (m,) of each of `others` from the nearest point of `own`."""
    apart = others[:, None] - own
    return np.einsum("mbk,mbk->mb", apart, apart).min(axis=1)
