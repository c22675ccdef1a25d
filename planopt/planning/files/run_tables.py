"""Tables of numbers of a run as CSV, to the last digit; a cell is empty where there is no number.

``target.csv`` and ``knowledge.csv`` hold the target and the known channel over a run. Row 0 is the
start. What was delivered belongs to the step that ends there, so row 0 has none.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.planning.files.csv_rows import read_number, read_rows
from planopt.planning.files.record import finite_list
from planopt.planning.loop.log import ChannelLog, TargetLog
from planopt.planning.run import Run
from planopt.problems.problem import Problem

TARGET_FILE, KNOWLEDGE_FILE = "target.csv", "knowledge.csv"

KNOWLEDGE_COLUMNS = (
    *("t_s", "rms_db", "anmse_db", "trace_m_db", "log_det_m"),
    *("rms_without_multipath_db", "path_loss_variance_db2"),
)
FORMER_KNOWLEDGE_COLUMNS = KNOWLEDGE_COLUMNS[:5]
"""Those of files of the former format."""

NumberTable = Mapping[str, NDArray[np.float64]]
"""Columns of equal length by name, NaN where there is no number."""


def table_text(table: NumberTable) -> str:
    """The file of a table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for row in zip(*(finite_list(column) for column in table.values()), strict=True):
        writer.writerow(["" if cell is None else cell for cell in row])
    return text.getvalue()


def read_table(path: Path, columns: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read what :func:`table_text` wrote.

    Raises
    ------
    InputError
        It is missing, not text, has other columns or a cell that is no number.
    """
    found: dict[str, list[float]] = {name: [] for name in columns}
    for line, row in read_rows(path, columns):
        for name in columns:
            found[name].append(read_number(row[name], name, path, line, may_miss=True))
    return {name: np.array(column, dtype=np.float64) for name, column in found.items()}


def target_columns(problem: Problem) -> tuple[str, ...]:
    """The columns of ``target.csv``."""
    return (
        "t_s",
        "true_x_m",
        "true_y_m",
        "estimated_x_m",
        "estimated_y_m",
        "trace_p_m2",
        *(f"delivered_{robot.name}" for robot in problem.robots),
    )


def target_table(problem: Problem, target: TargetLog) -> NumberTable:
    """The target over a run."""
    count = len(target.true_m)
    arrived = np.vstack([np.full((1, len(problem.robots)), np.nan), target.delivered])
    columns = (
        problem.planner.step_s * np.arange(count, dtype=np.float64),
        *target.true_m.T,
        *target.station_mean_m.T,
        target.station_variance_m2,
        *arrived.T,
    )
    return dict(zip(target_columns(problem), columns, strict=True))


def knowledge_table(problem: Problem, channel: ChannelLog) -> NumberTable:
    """How well the channel was known over a run."""
    columns = (
        problem.planner.step_s * np.arange(len(channel.rms_db), dtype=np.float64),
        channel.rms_db,
        channel.anmse_db,
        channel.theta_variance_db,
        channel.log_det_m,
        channel.rms_without_multipath_db,
        channel.path_loss_variance_db2,
    )
    return dict(zip(KNOWLEDGE_COLUMNS, columns, strict=True))


def run_tables(run: Run) -> dict[str, NumberTable]:
    """Return the tables that a run has, by the name of their file."""
    tables: dict[str, NumberTable] = {}
    if run.channel is not None:
        tables[KNOWLEDGE_FILE] = knowledge_table(run.problem, run.channel)
    if run.target is not None:
        tables[TARGET_FILE] = target_table(run.problem, run.target)
    return tables
