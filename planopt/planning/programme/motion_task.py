"""The data of a robot with dynamics that one polish needs, as the solver's arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.motion_rows import MotionShape, motion_row_values, motion_rows
from planopt.planning.programme.nlp_functions import Bounds
from planopt.planning.programme.pivot import GoalCharge, goal_cost_gradient
from planopt.robots.drive import Drive
from planopt.world.separation import SeparatingLines


def _none() -> NDArray[np.float64]:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class MotionTask:
    """The start of a polish.

    Attributes
    ----------
    shape
        Structure of the rows.
    drive
        Along the start path, from the robot's state on.
    stop_lines
        Separating lines of the way of stopping after it, of one segment.
    """

    shape: MotionShape
    drive: Drive
    stop_lines: SeparatingLines


@dataclass(frozen=True, eq=False)
class MotionNumbers:
    """A task as arrays; all empty for the single integrator.

    Attributes
    ----------
    start
        First guess of the variables w.
    parameters
        What the solver is told beside the lines of the path.
    rows
        Bounds of the rows.
    task, line
        What it is of, and all lines, flat.
    """

    start: NDArray[np.float64] = field(default_factory=_none)
    parameters: NDArray[np.float64] = field(default_factory=_none)
    rows: Bounds = field(default_factory=lambda: Bounds(_none(), _none()))
    task: MotionTask | None = None
    line: NDArray[np.float64] = field(default_factory=_none)

    def values(
        self, positions_m: NDArray[np.float64], w: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (m,) of the rows and gradients (m, 2 N + len(w)), without CasADi."""
        if self.task is None:
            return _none(), np.zeros((0, positions_m.size))
        state = self.task.drive.states[0]
        return motion_row_values(self.task.shape, positions_m, w, state, self.line)

    def gradient(
        self,
        positions_m: NDArray[np.float64],
        w: NDArray[np.float64],
        charge: GoalCharge | None,
    ) -> NDArray[np.float64]:
        """Return the gradient of the way's cost (2 N + len(w),); zero where none is charged."""
        if self.task is None or charge is None:
            return np.zeros(positions_m.size + len(w))
        state = self.task.drive.states[0]
        return goal_cost_gradient(self.task.shape, positions_m, w, state, charge)


def motion_numbers(
    task: MotionTask | None,
    line: NDArray[np.float64],
    stop_line: NDArray[np.float64],
    bounds_m: tuple[float, float, float, float],
) -> MotionNumbers:
    """The arrays of a task.

    Parameters
    ----------
    task
        None for the single integrator.
    line, stop_line
        ``(N, lines, 4)`` and ``(1, lines, 4)`` normals and offsets at end and start, clearance
        included.
    bounds_m
        The workspace.
    """
    if task is None:
        return MotionNumbers()
    shape, drive = task.shape, task.drive
    start = shape.variables_of(drive)
    every = np.concatenate([line.ravel(), stop_line.ravel()])
    state = tuple(drive.states[0])
    rows = motion_rows(shape, drive.states[1:, :2].ravel(), start, state, every)
    return MotionNumbers(
        start=start,
        parameters=np.concatenate([drive.states[0, 2:], stop_line.ravel()]),
        rows=Bounds(*rows.bounds(bounds_m)),
        task=task,
        line=every,
    )
