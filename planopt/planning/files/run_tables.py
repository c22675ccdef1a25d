"""Tables of a saved plan or run: ``steps.csv``, ``target.csv`` and ``knowledge.csv``."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.files.tables import REMEDY, Column, Data, table_of
from planopt.planning.loop.log import StepLog, TargetLog
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.robots.dynamics import Drive, Dynamics

STEPS_FILE, TARGET_FILE, KNOWLEDGE_FILE = "steps.csv", "target.csv", "knowledge.csv"


def _connected(log: StepLog) -> NDArray[np.str_]:
    return np.where(np.isnan(log.true_dbm), "", np.where(log.connected, "1", "0"))


STEP_COLUMNS = (
    Column("robot", "name of the robot", kind="text", required=True),
    Column("step", "number of the step; 0 is the start", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("x_m", "position", "m", required=True, source=lambda log: log.positions_m[:, 0]),
    Column("y_m", "position", "m", required=True, source=lambda log: log.positions_m[:, 1]),
    Column(
        "predicted_db",
        "predicted received power, before it was measured",
        "dBm",
        source=lambda log: log.predicted_dbm,
    ),
    Column("deviation_db", "standard deviation of the predicted power", "dB"),
    Column("connectivity", "predicted probability of connection"),
    Column(
        "true_db", "true received power; empty for a plan", "dBm", source=lambda log: log.true_dbm
    ),
    Column(
        "connected", "whether the true power reaches the threshold", kind="flag", source=_connected
    ),
    Column(
        "rung",
        "fallback that produced the plan executed in this step",
        kind="text",
        source=lambda log: np.array([rung.value for rung in log.rung]),
    ),
    Column(
        "verdict",
        "verdict on that plan",
        kind="text",
        source=lambda log: np.array([verdict.value for verdict in log.verdict]),
    ),
)
"""Columns of ``steps.csv``; states and inputs of robots with dynamics follow."""

KNOWLEDGE_COLUMNS = (
    Column("t_s", "time", "s"),
    Column("rms_db", "root mean square error of the predicted power over the workspace", "dB"),
    Column("anmse_db", "average normalised mean square error", "dB"),
    Column(
        "trace_m_db",
        "trace of the path loss covariance over the squared estimate",
        "dB",
        source=lambda log: log.theta_variance_db,
    ),
    Column("log_det_m", "log determinant of the path loss covariance", "nats"),
    Column("rms_without_multipath_db", "as rms_db, against path loss and shadowing alone", "dB"),
    Column("path_loss_variance_db2", "mean variance of the predicted path loss", "dB^2"),
)


def step_columns(problem: Problem) -> tuple[Column, ...]:
    """Return the columns of ``steps.csv`` for the robots of a problem."""
    names = [
        name
        for robot in problem.robots
        if not robot.moves_freely
        for name in drive_names(robot.dynamics)
    ]
    meaning = "state, or input of the step that ends here"
    return (*STEP_COLUMNS, *(Column(name, meaning) for name in dict.fromkeys(names)))


def target_columns(problem: Problem) -> tuple[Column, ...]:
    """Return the columns of ``target.csv``."""
    true, estimated = "true position of the target", "position estimated by the station"

    def arrived(number: int, log: TargetLog) -> Floats:
        return np.concatenate([[np.nan], log.delivered[:, number]])

    return (
        Column("t_s", "time", "s"),
        Column("true_x_m", true, "m", source=lambda log: log.true_m[:, 0]),
        Column("true_y_m", true, "m", source=lambda log: log.true_m[:, 1]),
        Column("estimated_x_m", estimated, "m", source=lambda log: log.station_mean_m[:, 0]),
        Column("estimated_y_m", estimated, "m", source=lambda log: log.station_mean_m[:, 1]),
        Column(
            "trace_p_m2",
            "trace of the covariance of that estimate",
            "m^2",
            source=lambda log: log.station_variance_m2,
        ),
        *(
            Column(
                f"delivered_{robot.name}",
                f"whether the packet of {robot.name} arrived",
                source=partial(arrived, number),
            )
            for number, robot in enumerate(problem.robots)
        ),
    )


def drive_names(dynamics: Dynamics) -> tuple[str, ...]:
    """Return the names of a robot's states other than position, and of its inputs."""
    return (*dynamics.state_names[2:], *dynamics.input_names)


def drive_table(drive: Drive | None) -> dict[str, Floats]:
    """Return states and inputs of a drive as columns (N + 1,); the first row has no input."""
    if drive is None:
        return {}
    inputs = np.vstack([np.full((1, drive.inputs.shape[1]), np.nan), drive.inputs])
    columns = np.hstack([drive.states[:, 2:], inputs]).T
    return dict(zip(drive_names(drive.dynamics), columns, strict=True))


def drive_of(
    robot: Robot,
    positions_m: Floats,  # (N + 1, 2)
    table: Mapping[str, Sequence[float | None]] | None,
    file: Path,
    key: str,
) -> Drive | None:
    """Return states and inputs of a robot from saved columns; None for a single integrator."""
    if robot.moves_freely:
        return None
    dynamics = robot.dynamics
    columns: list[Floats] = []
    for name in drive_names(dynamics):
        column = None if table is None else table.get(name)
        if column is None or len(column) != len(positions_m):
            message = f"should have {name} for each of {len(positions_m)} places"
            raise InputError(message, file=file, key=key, remedy=REMEDY)
        numbers = np.array(column, dtype=np.float64)
        if not np.isfinite(numbers[1 if name in dynamics.input_names else 0 :]).all():
            raise InputError(
                "has an empty cell where a number is needed",
                file=file,
                key=f"{key}.{name}",
                remedy=REMEDY,
            )
        columns.append(numbers)
    split = len(dynamics.state_names) - 2
    states = np.column_stack([positions_m, *columns[:split]])
    return Drive(dynamics, states, np.column_stack([column[1:] for column in columns[split:]]))


def _robots(result: Solution | Run) -> list[tuple[str, StepLog, Drive | None]]:
    """Return name, step log and drive of each robot; logs of plans have no true powers."""
    if isinstance(result, Run):
        return [(run.robot, run.log, run.drive) for run in result.runs]
    return [(plan.robot, _log_of_plan(plan), plan.drive) for plan in result.plans]


def _log_of_plan(plan: Plan) -> StepLog:
    """Return the step log of a robot that follows a plan exactly."""
    unknown = np.full(len(plan.t_s), np.nan)
    return StepLog(
        t_s=plan.t_s,
        positions_m=plan.positions_m,
        predicted_dbm=plan.mean_dbm,
        deviation_db=plan.deviation_db,
        connectivity=plan.connectivity,
        true_dbm=unknown,
        connected=np.zeros(len(unknown), dtype=np.bool_),
        step_s=unknown,
        polish_gain_s=unknown,
        relaxation_db=unknown,
        rung=(plan.rung,) * len(unknown),
        verdict=(plan.verdict,) * len(unknown),
    )


def _steps(result: Solution | Run) -> tuple[Sequence[Column], Data]:
    """Return columns and data of ``steps.csv``; missing states and inputs are empty."""
    columns, parts = step_columns(result.problem), list[Data]()
    for name, log, drive in _robots(result):
        rows = len(log.t_s)
        other = {column.name: np.full(rows, np.nan) for column in columns[len(STEP_COLUMNS) :]}
        own = {"robot": np.full(rows, name), "step": np.arange(rows), **drive_table(drive)}
        parts.append(table_of(columns, log, **{**other, **own}))
    names = [column.name for column in columns]
    return columns, {name: np.concatenate([part[name] for part in parts]) for name in names}


def tables_of(result: Solution | Run) -> dict[str, tuple[Sequence[Column], Data]]:
    """Return columns and data of every table of a result, by file name."""
    problem = result.problem
    tables = {STEPS_FILE: _steps(result)}
    if isinstance(result, Run):
        columns = columns_of_run(problem)
        for name, log in ((KNOWLEDGE_FILE, result.channel), (TARGET_FILE, result.target)):
            if log is not None:
                t_s = problem.planner.step_s * np.arange(len(log), dtype=np.float64)
                tables[name] = columns[name], table_of(columns[name], log, t_s=t_s)
    return tables


def columns_of_run(problem: Problem) -> dict[str, Sequence[Column]]:
    """Return the columns of every table of a run, by file name."""
    columns: dict[str, Sequence[Column]] = {STEPS_FILE: step_columns(problem)}
    if not problem.has_goal:
        columns[KNOWLEDGE_FILE] = KNOWLEDGE_COLUMNS
    if problem.targets and any(term.sensor is not None for term in problem.terms):
        columns[TARGET_FILE] = target_columns(problem)
    return columns
