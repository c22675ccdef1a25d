"""States and inputs of a robot by name, as files have them.

A row is a place: the state there beyond x and y, and the input of the step that ends there, so that
the first row has none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.files.record import REMEDY
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.robots.dynamics import Dynamics


def drive_names(dynamics: Dynamics | None) -> tuple[str, ...]:
    """The columns of a robot's states and inputs; none of a single integrator."""
    return () if dynamics is None else (*dynamics.state_names[2:], *dynamics.input_names)


def drive_columns(problem: Problem) -> tuple[str, ...]:
    """Every column that some robot of a problem has, in their order."""
    names = [name for robot in problem.robots for name in drive_names(robot.dynamics)]
    return tuple(dict.fromkeys(names))


def drive_table(drive: Drive | None) -> dict[str, NDArray[np.float64]]:
    """``(N + 1,)`` columns by name, NaN where a first row has no input."""
    if drive is None:
        return {}
    inputs = np.vstack([np.full((1, drive.inputs.shape[1]), np.nan), drive.inputs])
    columns = np.hstack([drive.states[:, 2:], inputs]).T
    return dict(zip(drive_names(drive.dynamics), columns, strict=True))


def drive_json(drive: Drive | None) -> dict[str, dict[str, list[float | None]]]:
    """The key ``drive`` with the columns; nothing for a single integrator."""
    if drive is None:
        return {}
    return {
        "drive": {
            name: [None if math.isnan(value) else value for value in column.tolist()]
            for name, column in drive_table(drive).items()
        }
    }


def drive_of(
    dynamics: Dynamics | None,
    positions_m: NDArray[np.float64],  # (N + 1, 2) its places
    table: Mapping[str, Sequence[float | None] | NDArray[np.float64]] | None,
    file: Path,
    key: str,
) -> Drive | None:
    """The drive that a table of a saved file says; None of a single integrator."""
    if dynamics is None:
        return None
    columns: list[NDArray[np.float64]] = []
    for name in drive_names(dynamics):
        column = None if table is None else table.get(name)
        if column is None or len(column) != len(positions_m):
            raise InputError(
                f"should have {name} for each of {len(positions_m)} places",
                file=file,
                key=key,
                remedy=REMEDY,
            )
        numbers = np.array([np.nan if value is None else value for value in column], dtype=float)
        needed = numbers[1:] if name in dynamics.input_names else numbers
        if not np.isfinite(needed).all():
            raise InputError("lacks a number", file=file, key=f"{key}.{name}", remedy=REMEDY)
        columns.append(numbers)
    split = len(dynamics.state_names) - 2
    states = np.column_stack([positions_m, *columns[:split]])
    return Drive(dynamics, states, np.column_stack([column[1:] for column in columns[split:]]))
