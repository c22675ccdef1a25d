"""The measurements nearest to a place, at a cost that hardly grows with their number.

A k-d tree holds most of the measured places. Those that came after it was built are compared one by
one, and the tree is built anew once they are many: a robot's measurements come singly, and a tree
of 50,000 places takes 15 ms.
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
