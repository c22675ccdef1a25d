"""The tables of a channel fit each other, and the truth fits into memory."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.channel_setup import (
    ArrayTruth,
    FunctionTruth,
    ModelTruth,
    SampledMeasurements,
)
from planopt.problems.problem import Problem
from planopt.world.footprints import LARGEST_COORDINATE_M

MAX_TRUTH_CELLS = 4_000_000
"""A drawn truth of more cells than this would not fit the memory of a small machine."""


def check_channel(problem: Problem) -> None:
    """Measurements come from something, and no place without signal counts as connected."""
    truth = problem.channel.truth
    measurements = problem.channel.measurements
    if truth is None:
        if isinstance(measurements, SampledMeasurements) and measurements.count > 0:
            raise InputError(
                "measurements cannot be taken from a truth that is not given",
                file=problem.file,
                key="channel.measurements.count",
                remedy="add [channel.truth], or give the file of a log",
            )
        return
    if isinstance(truth, ModelTruth | FunctionTruth):
        _check_cells(problem, truth.cell_m)
    for index, station in enumerate(problem.stations):
        if isinstance(truth, ArrayTruth | FunctionTruth):
            floor_dbm, remedy = truth.floor_dbm, "lower channel.truth.floor_dbm"
        else:
            floor_db = truth.floor_db
            floor_dbm = None if floor_db is None else station.transmit_power_dbm + floor_db
            remedy = "the floor is transmit_power_dbm + channel.truth.floor_db"
        if floor_dbm is not None and floor_dbm >= station.threshold_dbm:
            raise InputError(
                f"is {station.threshold_dbm:g}, not above the receiver's floor of {floor_dbm:g} "
                "dBm, so that places without signal would count as connected",
                file=problem.file,
                key=f"stations[{index}].threshold_dbm",
                remedy=remedy,
            )


def _check_cells(problem: Problem, cell_m: float) -> None:
    """Refuse cells so small that the truth would not fit into memory."""
    if not 0.0 < cell_m <= LARGEST_COORDINATE_M:
        raise InputError(
            f"is {cell_m!r}, which is no cell side",
            file=problem.file,
            key="channel.truth.cell_m",
            remedy="give metres above 0",
        )
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    cells = (x_max - x_min) / cell_m * (y_max - y_min) / cell_m
    if cells > MAX_TRUTH_CELLS:
        raise InputError(
            f"is {cell_m:g}, which makes {cells:.3g} cells, more than {MAX_TRUTH_CELLS:.3g}",
            file=problem.file,
            key="channel.truth.cell_m",
            remedy="larger cells, or smaller bounds",
        )
