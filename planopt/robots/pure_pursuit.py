"""Pure pursuit: the look-ahead point of a path, which a robot heads for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PurePursuit:
    """Follows a robot along a path without turning back."""

    def __init__(self, path_m: NDArray[np.float64]) -> None:
        lengths = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
        self._path_m = path_m
        self._along_m = np.concatenate([[0.0], np.cumsum(lengths)])
        self._at_m = 0.0
        legs = np.diff(path_m, axis=0)[lengths > 0.0]
        along = legs / np.linalg.norm(legs, axis=1)[:, None]
        # Twice the sine of half of each turn: how much the direction changes.
        self._turn = np.linalg.norm(np.diff(along, axis=0), axis=1)
        self._corner_m = np.cumsum(lengths[lengths > 0.0])

    def ahead_m(
        self, place_m: NDArray[np.float64], lookahead_m: float
    ) -> tuple[NDArray[np.float64], float]:
        """The point (2,) to head for from `place_m` (2,), and how much of the path is left."""
        tried = np.linspace(self._at_m, self._at_m + 1.5 * lookahead_m, 33)
        away = np.linalg.norm(self._points(tried) - place_m, axis=1)
        self._at_m = float(min(tried[int(away.argmin())], self._along_m[-1]))
        target = self._points(np.array([self._at_m + lookahead_m]))[0]
        return target, float(self._along_m[-1] - self._at_m)

    def speed_m_s(self, acceleration_m_s2: float, swing_m: float) -> float:
        """Return the speed from which a robot can stop at the end without swinging out."""
        turn = np.append(self._turn, np.inf)[-len(self._corner_m) :]
        # To change its direction it takes turn v / a seconds, in which it drives twice the swing.
        square = 2.0 * acceleration_m_s2 * swing_m / np.maximum(turn, 1e-9)
        left = self._corner_m - self._at_m
        square = square + 2.0 * acceleration_m_s2 * np.maximum(left, 0.0)
        ahead = left > -1e-9
        return float(np.sqrt(square[ahead].min())) if ahead.any() else 0.0

    def _points(self, along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(
            [np.interp(along_m, self._along_m, self._path_m[:, axis]) for axis in (0, 1)]
        )
