"""A problem in full as plain data, in the tables and keys of a problem file, and back.

Saved plans and runs carry it, so that they can be judged from their own files: obstacles stand in
it as polygons at full precision. The truth's map and a log of measurements, which the judgement
does not need, are named by their absolute path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import shapely

from planopt.channel.fields.multipath import Lognormal, Multipath, Nakagami, Rician
from planopt.problems.base_station import BaseStation
from planopt.problems.channel_setup import (
    ArrayTruth,
    ChannelSetup,
    FittedTruth,
    FunctionTruth,
    LoggedMeasurements,
    ModelTruth,
    RasterTruth,
    SampledMeasurements,
)
from planopt.problems.load import problem_from_tables
from planopt.problems.problem import Problem, ReachObjective, Term
from planopt.problems.schema import SCHEMA_VERSION
from planopt.problems.schema_constraints import constraints_table
from planopt.problems.schema_robot import robot_table
from planopt.world.moving_obstacle import MovingObstacle
from planopt.world.workspace import Obstacle


def problem_to_dict(problem: Problem) -> dict[str, Any]:
    """`problem` as JSON-serialisable tables; :func:`problem_from_dict` reads them.

    Keys that have no value are left out, as they are in a problem file.
    """
    channel: dict[str, Any] = {
        "measurements": _measurements(problem.channel),
        "fit": {"method": problem.channel.fit_method},
    }
    truth, given = problem.channel.truth, problem.channel.given
    if given is not None:
        channel["fit"]["given"] = _plain(asdict(given))
    if isinstance(truth, RasterTruth | ModelTruth | FittedTruth):
        channel["truth"] = _truth(truth)
    tables: dict[str, Any] = {
        "problem": {
            "schema": SCHEMA_VERSION,
            "name": problem.name,
            "task": problem.task,
            "description": problem.description,
        },
        "world": {
            "bounds_m": _array(problem.workspace.bounds_m),
            "obstacles": [
                obstacle_table(obstacle)
                for obstacle in (*problem.workspace.lasting, *problem.workspace.timed)
            ],
            "moving": [_moving(obstacle) for obstacle in problem.workspace.moving],
        },
        "channel": channel,
        "robots": [_plain(robot_table(robot)) for robot in problem.robots],
        "stations": [_station(station) for station in problem.stations],
        "targets": [_plain(asdict(target)) for target in problem.targets],
        "objective": _objective(problem),
        "constraints": _constraints(problem),
        "planner": _plain(asdict(problem.planner)),
        "report": asdict(problem.report),
    }
    return tables if problem.compare is None else {**tables, "compare": problem.compare.table()}


def problem_from_dict(data: Mapping[str, Any], *, file: Path | None = None) -> Problem:
    """The problem that :func:`problem_to_dict` wrote, validated as a problem file is.

    Parameters
    ----------
    data
        The tables, for instance from ``json.load``.
    file
        Where they came from, for messages; relative file names in them start at its folder.

    Raises
    ------
    InputError
        As for a problem file, except that the truth's map and the log need not be there.
    """
    folder = Path.cwd() if file is None else file.absolute().parent
    return problem_from_tables(data, folder=folder, file=file)


def _objective(problem: Problem) -> dict[str, Any]:
    if isinstance(problem.objective, ReachObjective):
        return asdict(problem.objective)
    return {"terms": [_term(term) for term in problem.objective.terms]}


def _term(term: Term) -> dict[str, Any]:
    table = {"kind": term.kind, **_plain(asdict(term))}
    return {key: value for key, value in table.items() if key not in term.left_out}


def _constraints(problem: Problem) -> dict[str, Any]:
    table = constraints_table(problem.constraints)
    if not any(robot.goal_m is not None for robot in problem.robots):
        del table["goal_radius_m"]
    return table


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """`table` without empty keys, with arrays for tuples and text for paths."""
    plain: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, tuple):
            plain[key] = list(cast("tuple[object, ...]", value))
        elif isinstance(value, Path):
            plain[key] = str(value.absolute())
        elif value is not None:
            plain[key] = value
    return plain


def _array(value: Any) -> Any:
    """Return a tuple as an array; anything else as it is, for the schema to refuse."""
    return list(cast("tuple[object, ...]", value)) if isinstance(value, tuple) else value


def _truth(truth: RasterTruth | ModelTruth | FittedTruth) -> dict[str, Any]:
    if isinstance(truth, FittedTruth):
        return {"kind": "fitted", **_plain(asdict(truth))}
    kind = "raster" if isinstance(truth, RasterTruth) else "model"
    table = {"kind": kind, **_plain(asdict(replace(truth, multipath=None)))}
    law = truth.multipath
    if isinstance(truth, RasterTruth) and isinstance(law, Rician) and law.k_factor > 0.0:
        return {**table, "rician_k": law.k_factor}
    if law is not None:
        table.pop("multipath_std_db", None)
        table["multipath"] = _multipath(law)
    return table


def _multipath(law: Multipath) -> dict[str, Any]:
    match law:
        case Rician():
            return {"kind": "rician", "k": law.k_factor}
        case Nakagami():
            return {"kind": "nakagami", "m": law.m}
        case Lognormal():
            return {"kind": "lognormal", "std_db": law.std_db}


def _measurements(channel: ChannelSetup) -> dict[str, Any]:
    given = channel.measurements
    if isinstance(given, SampledMeasurements) and isinstance(
        channel.truth, ArrayTruth | FunctionTruth
    ):
        # What they were taken from is in no file.
        given = SampledMeasurements()
    table = _plain(asdict(given))
    if isinstance(channel.measurements, LoggedMeasurements):
        table["columns"] = dict(zip(("x", "y", "power"), table["columns"], strict=True))
    if channel.share_measurements:
        table["shared"] = True
    return {**table, "spacing_m": channel.measure_spacing_m}


OPTIONAL_OF_STATION = (
    *("receive_threshold_dbm", "gain_file", "gain_variable"),
    *("log_file", "power_column", "censored_column"),
)
"""Keys that a station may have."""


def _station(station: BaseStation) -> dict[str, Any]:
    return {
        "name": station.name,
        "position_m": list(station.position_m),
        "height_m": station.height_m,
        "transmit_power_dbm": station.transmit_power_dbm,
        "threshold_dbm": station.threshold_dbm,
        **_plain({name: getattr(station, name) for name in OPTIONAL_OF_STATION}),
    }


def obstacle_table(obstacle: Obstacle) -> dict[str, Any]:
    """Return an obstacle as an entry of ``world.obstacles``."""
    polygon = obstacle.polygon
    table: dict[str, Any] = {"name": obstacle.name, "polygon": _ring(polygon.exterior)}
    if obstacle.known_from_s > 0.0:
        table["known_from_s"] = obstacle.known_from_s
    if obstacle.until_s < math.inf:
        table["until_s"] = obstacle.until_s
    holes = [_ring(ring) for ring in shapely.get_rings(polygon)[1:]]
    return {**table, "holes": holes} if holes else table


def _moving(obstacle: MovingObstacle) -> dict[str, Any]:
    table = {
        **_plain(asdict(obstacle)),
        "positions_m": [list(place) for place in obstacle.positions_m],
    }
    if not obstacle.is_uncertain:
        del table["probability"]
    return table


def _ring(ring: shapely.LinearRing) -> list[list[float]]:
    return shapely.get_coordinates(ring).tolist()
