"""A point to head for, a little ahead on a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Carrot:
    """Follows a robot along a path without turning back.

    Parameters
    ----------
    path_m
        ``(n, 2)`` corners of the path, n at least 1.
    """

    def __init__(self, path_m: NDArray[np.float64]) -> None:
        lengths = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
        self._path_m = path_m
        self._along_m = np.concatenate([[0.0], np.cumsum(lengths)])
        self._at_m = 0.0

    def ahead_m(
        self, place_m: NDArray[np.float64], lookahead_m: float
    ) -> tuple[NDArray[np.float64], float]:
        """The point (2,) to head for from `place_m` (2,), and how much of the path is left.

        Parameters
        ----------
        place_m
            Where the robot is. The nearest point of the path is looked for from where it was last
            time up to one and a half lookaheads farther.
        lookahead_m
            How far ahead of it the point is.
        """
        tried = np.linspace(self._at_m, self._at_m + 1.5 * lookahead_m, 33)
        away = np.linalg.norm(self._points(tried) - place_m, axis=1)
        self._at_m = float(min(tried[int(away.argmin())], self._along_m[-1]))
        target = self._points(np.array([self._at_m + lookahead_m]))[0]
        return target, float(self._along_m[-1] - self._at_m)

    def _points(self, along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(
            [np.interp(along_m, self._along_m, self._path_m[:, axis]) for axis in (0, 1)]
        )
