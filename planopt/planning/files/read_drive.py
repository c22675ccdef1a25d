"""Read states and inputs of a robot back from a saved table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.planning.files.drive_table import drive_names
from planopt.planning.files.solution_json import REMEDY
from planopt.robots.drive import Drive
from planopt.robots.dynamics import Dynamics


def drive_of(
    dynamics: Dynamics | None,
    positions_m: NDArray[np.float64],
    table: Mapping[str, Sequence[float | None] | NDArray[np.float64]] | None,
    file: Path,
    key: str,
) -> Drive | None:
    """The drive that a table of a saved file says; None of a single integrator.

    Parameters
    ----------
    dynamics
        Of the robot.
    positions_m
        ``(N + 1, 2)`` its places.
    table
        Columns by name.
    file, key
        Where they stand.

    Raises
    ------
    InputError
        A column is missing, has another length or lacks a number.
    """
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
