"""The tables of a saved plan or run: ``steps.csv``, ``target.csv`` and ``knowledge.csv``.

``steps.csv`` has a row for every place of every robot; ``target.csv`` and ``knowledge.csv`` hold
the target and the known channel over a run. Row 0 is the start.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.tables import REMEDY, Column, Data
from planopt.planning.loop.log import ChannelLog, RobotRun, TargetLog
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.robots.dynamics import Dynamics

if TYPE_CHECKING:
    from planopt.planning.run import Run

STEPS_FILE, TARGET_FILE, KNOWLEDGE_FILE = "steps.csv", "target.csv", "knowledge.csv"

STEP_COLUMNS = (
    Column("robot", "name of the robot", kind="text", required=True),
    Column("step", "number of the step; 0 is the start", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("x_m", "position", "m", required=True),
    Column("y_m", "position", "m", required=True),
    Column("predicted_db", "predicted received power, before it was measured", "dBm"),
    Column("deviation_db", "standard deviation of the predicted power", "dB"),
    Column("connectivity", "predicted probability of connection"),
    Column("true_db", "true received power; empty for a plan", "dBm"),
    Column("connected", "whether the true power reaches the threshold", kind="flag"),
    Column("rung", "fallback that released the plan that led here", kind="text"),
    Column("verdict", "verdict on that plan", kind="text"),
)
"""Columns of ``steps.csv``; states and inputs of robots with dynamics follow."""

KNOWLEDGE_COLUMNS = (
    Column("t_s", "time", "s"),
    Column("rms_db", "root mean square error of the predicted power over the workspace", "dB"),
    Column("anmse_db", "average normalised mean square error", "dB"),
    Column("trace_m_db", "trace of the path loss covariance over the squared estimate", "dB"),
    Column("log_det_m", "log determinant of the path loss covariance", "nats"),
    Column("rms_without_multipath_db", "as rms_db, against path loss and shadowing alone", "dB"),
    Column("path_loss_variance_db2", "mean variance of the predicted path loss", "dB^2"),
)


def step_columns(problem: Problem) -> tuple[Column, ...]:
    """Return the columns of ``steps.csv`` for the robots of a problem."""
    names = [name for robot in problem.robots for name in drive_names(robot.dynamics)]
    meaning = "state, or input of the step that ends here"
    return (*STEP_COLUMNS, *(Column(name, meaning) for name in dict.fromkeys(names)))


def target_columns(problem: Problem) -> tuple[Column, ...]:
    """Return the columns of ``target.csv``."""
    return (
        Column("t_s", "time", "s"),
        Column("true_x_m", "true position of the target", "m"),
        Column("true_y_m", "true position of the target", "m"),
        Column("estimated_x_m", "position estimated by the station", "m"),
        Column("estimated_y_m", "position estimated by the station", "m"),
        Column("trace_p_m2", "trace of the covariance of that estimate", "m^2"),
        *(
            Column(f"delivered_{robot.name}", f"whether the packet of {robot.name} arrived")
            for robot in problem.robots
        ),
    )


def drive_names(dynamics: Dynamics | None) -> tuple[str, ...]:
    """Return the names of a robot's states beyond the position, and of its inputs."""
    return () if dynamics is None else (*dynamics.state_names[2:], *dynamics.input_names)


def drive_table(drive: Drive | None) -> dict[str, NDArray[np.float64]]:
    """Return columns (N + 1,) of states and inputs; the first row has no input."""
    if drive is None:
        return {}
    inputs = np.vstack([np.full((1, drive.inputs.shape[1]), np.nan), drive.inputs])
    columns = np.hstack([drive.states[:, 2:], inputs]).T
    return dict(zip(drive_names(drive.dynamics), columns, strict=True))


def drive_json(drive: Drive | None) -> dict[str, dict[str, list[float | None]]]:
    """Return the key ``drive`` with these columns; nothing for a single integrator."""
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
    positions_m: NDArray[np.float64],  # (N + 1, 2)
    table: Mapping[str, Sequence[float | None]] | None,
    file: Path,
    key: str,
) -> Drive | None:
    """Return the drive of saved columns; None for a single integrator."""
    if dynamics is None:
        return None
    columns: list[NDArray[np.float64]] = []
    for name in drive_names(dynamics):
        column = None if table is None else table.get(name)
        if column is None or len(column) != len(positions_m):
            message = f"should have {name} for each of {len(positions_m)} places"
            raise InputError(message, file=file, key=key, remedy=REMEDY)
        numbers = np.array([np.nan if value is None else value for value in column], dtype=float)
        needed = numbers[1:] if name in dynamics.input_names else numbers
        if not np.isfinite(needed).all():
            raise InputError("lacks a number", file=file, key=f"{key}.{name}", remedy=REMEDY)
        columns.append(numbers)
    split = len(dynamics.state_names) - 2
    states = np.column_stack([positions_m, *columns[:split]])
    return Drive(dynamics, states, np.column_stack([column[1:] for column in columns[split:]]))


def steps_of_plans(problem: Problem, plans: Iterable[Plan]) -> Data:
    """Return ``steps.csv`` of plans; true powers are unknown."""
    return _joined(
        problem,
        [
            {
                **_trajectory(plan.robot, plan.t_s, plan.positions_m),
                "predicted_db": plan.mean_dbm,
                "deviation_db": plan.deviation_db,
                "connectivity": plan.connectivity,
                "true_db": np.full(len(plan.t_s), np.nan),
                "connected": np.full(len(plan.t_s), ""),
                "rung": np.full(len(plan.t_s), plan.rung.value),
                "verdict": np.full(len(plan.t_s), plan.verdict.value),
                **drive_table(plan.drive),
            }
            for plan in plans
        ],
    )


def steps_of_runs(problem: Problem, runs: Iterable[RobotRun]) -> Data:
    """Return ``steps.csv`` of a run."""
    return _joined(
        problem,
        [
            {
                **_trajectory(run.robot, run.log.t_s, run.log.positions_m),
                "predicted_db": run.log.predicted_dbm,
                "deviation_db": run.log.deviation_db,
                "connectivity": run.log.connectivity,
                "true_db": run.log.true_dbm,
                "connected": np.where(run.log.connected, "1", "0"),
                "rung": np.array([rung.value for rung in run.log.rung]),
                "verdict": np.array([verdict.value for verdict in run.log.verdict]),
                **drive_table(run.drive),
            }
            for run in runs
        ],
    )


def _trajectory(
    robot: str, t_s: NDArray[np.float64], positions_m: NDArray[np.float64]
) -> dict[str, NDArray[Any]]:
    return {
        "robot": np.full(len(t_s), robot),
        "step": np.arange(len(t_s)),
        "t_s": t_s,
        "x_m": positions_m[:, 0],
        "y_m": positions_m[:, 1],
    }


def _joined(problem: Problem, parts: Sequence[Data]) -> Data:
    """Return one table of several robots' rows."""
    return {
        column.name: np.concatenate(
            [part.get(column.name, np.full(len(part["t_s"]), np.nan)) for part in parts]
        )
        for column in step_columns(problem)
    }


def run_tables(run: Run) -> dict[str, tuple[Sequence[Column], Data]]:
    """Return columns and data of every table of a run, by the name of its file."""
    problem = run.problem
    tables: dict[str, tuple[Sequence[Column], Data]] = {
        STEPS_FILE: (step_columns(problem), steps_of_runs(problem, run.runs))
    }
    if run.channel is not None:
        tables[KNOWLEDGE_FILE] = KNOWLEDGE_COLUMNS, _knowledge(problem, run.channel)
    if run.target is not None:
        tables[TARGET_FILE] = target_columns(problem), _target(problem, run.target)
    return tables


def columns_of_run(problem: Problem) -> dict[str, Sequence[Column]]:
    """Return the columns of every table that a run of a problem has, by file name."""
    columns: dict[str, Sequence[Column]] = {STEPS_FILE: step_columns(problem)}
    if problem.task != "reach":
        columns[KNOWLEDGE_FILE] = KNOWLEDGE_COLUMNS
    if problem.targets and any(term.sensor is not None for term in problem.terms):
        columns[TARGET_FILE] = target_columns(problem)
    return columns


def _target(problem: Problem, target: TargetLog) -> Data:
    arrived = np.vstack([np.full((1, len(problem.robots)), np.nan), target.delivered])
    columns = (
        problem.planner.step_s * np.arange(len(target.true_m), dtype=np.float64),
        *target.true_m.T,
        *target.station_mean_m.T,
        target.station_variance_m2,
        *arrived.T,
    )
    return {
        column.name: values for column, values in zip(target_columns(problem), columns, strict=True)
    }


def _knowledge(problem: Problem, channel: ChannelLog) -> Data:
    columns = (
        problem.planner.step_s * np.arange(len(channel.rms_db), dtype=np.float64),
        channel.rms_db,
        channel.anmse_db,
        channel.theta_variance_db,
        channel.log_det_m,
        channel.rms_without_multipath_db,
        channel.path_loss_variance_db2,
    )
    return {column.name: values for column, values in zip(KNOWLEDGE_COLUMNS, columns, strict=True)}
