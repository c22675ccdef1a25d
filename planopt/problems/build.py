"""Build the plain data of a problem from the validated tables of its file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from planopt.channel.fields.multipath import Rician
from planopt.errors import InputError
from planopt.problems.base_station import BaseStation
from planopt.problems.channel_setup import (
    ChannelSetup,
    FittedTruth,
    LoggedMeasurements,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
)
from planopt.problems.problem import Problem, ReachObjective, TermsObjective
from planopt.problems.schema import ProblemFile
from planopt.problems.schema_channel import (
    ChannelTable,
    ColumnsTable,
    FittedTruthTable,
    MeasurementsTable,
    RasterTruthTable,
    TruthTable,
)
from planopt.problems.schema_world import ObstacleTable
from planopt.world.footprints import footprint
from planopt.world.readers import obstacle_from_wkt, read_obstacles
from planopt.world.workspace import Obstacle, Workspace


def build(tables: ProblemFile, folder: Path, file: Path | None) -> Problem:
    """The problem that `tables` describe."""
    return Problem(
        name=tables.problem.name,
        description=tables.problem.description,
        workspace=Workspace(
            tables.world.bounds_m,
            tuple(
                replace(
                    obstacle,
                    known_from_s=table.known_from_s,
                    until_s=math.inf if table.until_s is None else table.until_s,
                )
                for index, table in enumerate(tables.world.obstacles)
                for obstacle in obstacles_of(table, index, folder)
            ),
            tuple(table.obstacle for table in tables.world.moving),
        ),
        channel=_channel(tables.channel, folder),
        robots=tuple(table.robot for table in tables.robots),
        stations=tuple(
            BaseStation(
                name=table.name,
                position_m=table.position_m,
                height_m=table.height_m,
                transmit_power_dbm=table.transmit_power_dbm,
                threshold_dbm=table.threshold_dbm,
                receive_threshold_dbm=table.receive_threshold_dbm,
                gain_file=None if table.gain_file is None else folder / table.gain_file,
                gain_variable=table.gain_variable,
                log_file=None if table.log_file is None else folder / table.log_file,
                power_column=table.power_column,
                censored_column=table.censored_column,
            )
            for table in tables.stations
        ),
        objective=_objective(tables),
        targets=tuple(tables.targets),
        constraints=tables.constraints.constraints,
        planner=tables.planner,
        file=file,
        report=tables.report,
        compare=tables.compare,
        checked=True,
    )


def _objective(tables: ProblemFile) -> ReachObjective | TermsObjective:
    table = tables.objective
    if tables.problem.task == "reach":
        return ReachObjective(
            table.effort_weight_s2_m2, table.cost_to_go, table.outage_price, table.outage_charge
        )
    return TermsObjective(tuple(table.terms))


def obstacles_of(table: ObstacleTable, index: int, folder: Path) -> tuple[Obstacle, ...]:
    """Return the obstacles of one entry of ``world.obstacles``; errors carry its key."""
    key = f"world.obstacles[{index}]"
    name = f"obstacle {index}" if table.name is None else table.name
    try:
        if table.file is not None:
            return read_obstacles(folder / table.file, table.unknown)
        if table.wkt is not None:
            return (obstacle_from_wkt(name, table.wkt),)
        return (footprint(name, table.polygon, table.holes),)
    except InputError as error:
        raise InputError(
            error.message,
            file=error.file,
            key=error.key or key,
            row=error.row,
            remedy=error.remedy,
        ) from error


def _channel(table: ChannelTable, folder: Path) -> ChannelSetup:
    """The channel's truth, first measurements and fit."""
    return ChannelSetup(
        truth=None if table.truth is None else _truth(table.truth, folder),
        measurements=_measurements(table.measurements, folder),
        fit_method=table.fit.method,
        given=table.fit.given,
        measure_spacing_m=table.measurements.spacing_m,
        share_measurements=table.measurements.shared,
    )


def _truth(table: TruthTable, folder: Path) -> RasterTruth | ModelTruth | FittedTruth:
    if isinstance(table, FittedTruthTable):
        return FittedTruth(cell_m=table.cell_m, floor_db=table.floor_db)
    if isinstance(table, RasterTruthTable):
        multipath = None if table.rician_k is None else Rician(table.rician_k)
        if table.multipath is not None:
            multipath = table.multipath.law
        return RasterTruth(
            file=folder / table.file,
            variable=table.variable,
            quantity=table.quantity,
            floor_db=table.floor_db,
            multipath=multipath,
        )
    multipath = None if table.multipath is None else table.multipath.law
    # The schema lets exactly one of multipath and its deviation be absent.
    deviation = (table.multipath_std_db or 0.0) if multipath is None else multipath.std_db
    return ModelTruth(
        k_pl_db=table.k_pl_db,
        n_pl=table.n_pl,
        shadow_std_db=table.shadow_std_db,
        decorrelation_m=table.decorrelation_m,
        multipath_std_db=deviation,
        cell_m=table.cell_m,
        floor_db=table.floor_db,
        multipath=multipath,
    )


def _measurements(
    table: MeasurementsTable, folder: Path
) -> SampledMeasurements | LoggedMeasurements:
    if table.file is None:
        # The schema lets exactly one of file and count be absent.
        return SampledMeasurements(table.count or 0)
    columns = table.columns or ColumnsTable()
    return LoggedMeasurements(
        folder / table.file,
        (columns.x, columns.y, columns.power),
        table.censored_column,
        table.floor_dbm,
    )
