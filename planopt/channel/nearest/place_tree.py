# pyright: basic
"""A k-d tree with types: the boundary to SciPy's, which has none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree


class PlaceTree:
    """Places in the plane, to be searched by distance."""

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        self._tree = KDTree(positions_m, balanced_tree=False)

    def __len__(self) -> int:
        return self._tree.n

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
