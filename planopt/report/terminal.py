"""Frames of a run in characters, for a terminal: map, paths, plans, and a line for each robot."""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem

FREE, OBSTACLE, DRIVEN, PLANNED, GOAL, STATION = " ", "#", ".", "o", "G", "^"
"""Characters of the map; robots have the digits from 1."""
ASPECT = 2.0
"""Height over width of a character."""

DIGITS = "123456789"


class TerminalMap:
    """Map of a problem in characters, with the paths driven so far."""

    def __init__(self, problem: Problem, columns: int, rows: int) -> None:
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        # The wider of both scales, so that the whole world fits.
        self._cell_m = max((x_max - x_min) / columns, (y_max - y_min) / (ASPECT * rows))
        self._corner = np.array([x_min, y_max])
        shape = (
            max(1, min(rows, round((y_max - y_min) / (ASPECT * self._cell_m)))),
            max(1, min(columns, round((x_max - x_min) / self._cell_m))),
        )
        row, column = np.indices(shape)
        centre_x = x_min + self._cell_m * (column + 0.5)
        centre_y = y_max - ASPECT * self._cell_m * (row + 0.5)
        polygons = [each.polygon for each in problem.workspace.obstacles]
        union = shapely.union_all(polygons)
        shapely.prepare(union)
        blocked = shapely.contains_xy(union, centre_x.ravel(), centre_y.ravel()).reshape(shape)
        self._ground = np.where(blocked, OBSTACLE, FREE)
        self._problem = problem
        for mark, places in (
            (STATION, [each.position_m for each in problem.stations]),
            (GOAL, [each.goal_m for each in problem.robots if each.goal_m is not None]),
        ):
            self._put(self._ground, np.array(places, dtype=np.float64).reshape(-1, 2), mark)

    def frame(self, step: int, plans: Sequence[Plan]) -> str:
        """Return the frame of a step, and store the robots' positions."""
        picture = self._ground.copy()
        for number, plan in enumerate(plans):
            length = plan.positions_m[-1] - plan.positions_m[0]
            dense = max(2, int(np.abs(length).sum() / self._cell_m) * 2)
            at = np.linspace(0.0, len(plan.t_s) - 1.0, dense * len(plan.t_s))
            along = np.arange(len(plan.t_s), dtype=np.float64)
            ahead = [np.interp(at, along, plan.positions_m[:, axis]) for axis in (0, 1)]
            self._put(picture, np.stack(ahead, axis=1), PLANNED)
            self._put(picture, plan.positions_m[:1], DIGITS[number % len(DIGITS)])
            self._put(self._ground, plan.positions_m[:1], DRIVEN)
        edge = "+" + "-" * picture.shape[1] + "+"
        rows = ["|" + "".join(row) + "|" for row in picture.tolist()]
        return "\n".join([edge, *rows, edge, *step_lines(self._problem, step, plans)])

    def _put(self, picture: NDArray[np.str_], places_m: Floats, mark: str) -> None:
        """Write a character at all positions inside the picture."""
        cell = np.array([self._cell_m, -ASPECT * self._cell_m])
        column, row = np.floor((places_m - self._corner) / cell).astype(int).T
        inside = (row >= 0) & (row < picture.shape[0]) & (column >= 0) & (column < picture.shape[1])
        picture[row[inside], column[inside]] = mark


def step_lines(problem: Problem, step: int, plans: Sequence[Plan]) -> list[str]:
    """Return a line for each robot with its position and the values of its plan."""
    time_s = (step - 1) * problem.planner.step_s
    lines: list[str] = []
    for plan in plans:
        x, y = plan.positions_m[0]
        lines.append(
            f"{time_s:7.1f} s  {plan.robot} at ({x:.1f}, {y:.1f}) m: {plan.verdict.value}, "
            f"{plan.mean_dbm[0]:.1f} dBm, P(connected) {plan.connectivity[0]:.2f}, "
            f"at least {plan.connectivity.min():.2f} ahead"
        )
    return lines
