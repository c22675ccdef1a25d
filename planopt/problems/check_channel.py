"""The tables of a channel fit each other, and the truth fits into memory."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.channel_setup import ModelTruth, SampledMeasurements
from planopt.problems.problem import Problem

MAX_TRUTH_CELLS = 4_000_000
"""A drawn truth of more cells than this would not fit the memory of a small machine."""


def check_channel(problem: Problem) -> None:
    """Measurements come from something, and no place without signal counts as connected."""
    truth = problem.channel.truth
    if truth is None:
        if isinstance(problem.channel.measurements, SampledMeasurements):
            raise InputError(
                "measurements cannot be taken from a truth that is not given",
                file=problem.file,
                key="channel.measurements.count",
                remedy="add [channel.truth], or give the file of a log",
            )
        return
    if isinstance(truth, ModelTruth):
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        cells = (x_max - x_min) / truth.cell_m * (y_max - y_min) / truth.cell_m
        if cells > MAX_TRUTH_CELLS:
            raise InputError(
                f"is {truth.cell_m:g}, which makes {cells:.3g} cells, "
                f"more than {MAX_TRUTH_CELLS:.3g}",
                file=problem.file,
                key="channel.truth.cell_m",
                remedy="larger cells, or smaller bounds",
            )
    for index, station in enumerate(problem.stations):
        if truth.floor_db is None:
            continue
        floor_dbm = station.transmit_power_dbm + truth.floor_db
        if floor_dbm >= station.threshold_dbm:
            raise InputError(
                f"is {station.threshold_dbm:g}, not above the receiver's floor of {floor_dbm:g} "
                "dBm, so that places without signal would count as connected",
                file=problem.file,
                key=f"stations[{index}].threshold_dbm",
                remedy="the floor is transmit_power_dbm + channel.truth.floor_db",
            )
