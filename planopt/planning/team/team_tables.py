"""``target.csv`` and ``knowledge.csv``: the target and the known channel over a run.

Row 0 is the start. What was delivered belongs to the step that ends there, so row 0 has none.
"""

from __future__ import annotations

import numpy as np

from planopt.planning.files.number_table import NumberTable
from planopt.planning.team.team_run import ChannelLog, TargetLog
from planopt.problems.problem import Problem

TARGET_FILE, KNOWLEDGE_FILE = "target.csv", "knowledge.csv"

KNOWLEDGE_COLUMNS = ("t_s", "rms_db", "anmse_db", "trace_m_db", "log_det_m")


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
    )
    return dict(zip(KNOWLEDGE_COLUMNS, columns, strict=True))
