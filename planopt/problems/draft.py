"""Draft of a problem file from a power log and an occupancy map, with its assumptions."""

import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from planopt.channel.channel_map import default_cell_m, measured_bounds_m
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fit_channel, floor_pile_dbm
from planopt.channel.estimation.station_fit import MIN_UNCENSORED, QUANTILE, fit_channel_and_station
from planopt.channel.logs.log_format import LogFormat, parse_station
from planopt.channel.logs.log_table import LogTable, alias
from planopt.channel.logs.power_log import (
    FEWEST_READINGS,
    PowerLog,
    labels_of,
    measurements_of,
    rows_of,
)
from planopt.channel.logs.readers import columns_of, read_stations, read_table, readings_of
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station
from planopt.errors import InputError, listed
from planopt.files.writing import toml_text
from planopt.problems.plausibility import grid_warnings, log_warnings, problem_warnings
from planopt.problems.problem import Problem, problem_from_tables
from planopt.problems.schema import MAX_STATIONS, SCHEMA_VERSION
from planopt.world.clearance import clearance_m, index_obstacles, inside_bounds
from planopt.world.geodesy import Origin, east_north_m
from planopt.world.occupancy import OccupancyGrid, grid_obstacles, is_grid, read_grid
from planopt.world.readers import NEAR_DEG, read_obstacles
from planopt.world.workspace import Workspace

ABOVE_FLOOR_DB = 10.0  # Assumed margin of the connection threshold above the log's weakest power
STEP_SHARE = 0.02  # Step length as a share of the world's diagonal
ROUND_STEPS = (1.0, 2.0, 5.0)  # Leading digits to which the step length is rounded
ROUTE_DIAGONALS = 6.0  # Maximum path length of a run in diagonals of the world
MARGIN_SHARE = 0.1
"""Margin of the world around log, start and goal as a share of their extent, without a map."""
SMALL_LOG = 0.03  # Smallest plausible extent of a log as a share of the map's
TRANSMIT_POWER_DBM = 20.0
"""Assumed transmit power; plans do not depend on it, since the log has received powers."""
SEARCHED_CELLS = 200
"""Number of candidate positions, along the world's longer side, for a free position."""


@dataclass(frozen=True)
class DraftSettings:
    """Values of a draft that files do not contain; None for values to be assumed."""

    start: str  # X,Y in metres or LAT,LON in degrees
    goal: str
    stations: tuple[str, ...] = ()  # POSITION, or NAME=POSITION of a transmitter
    stations_file: Path | None = None  # Table of names and positions of transmitters
    transmitters: tuple[str, ...] = ()  # Transmitters that become stations; empty: detected
    threshold_dbm: float | None = None
    p_min: float = 0.9
    speed_m_s: float | None = None
    clearance_m: float | None = None


@dataclass(frozen=True, eq=False)
class DraftStation:
    """Transmitter of a log with its readings and position."""

    name: str
    label: str | None  # Text in the column of transmitters
    measurements: Measurements
    fit: ChannelFit
    is_given: bool  # True for a known position, false for an estimated one

    @property
    def region_m(self) -> float:
        """Return the radius of the disc around the 95 % region of the estimated position."""
        return math.sqrt(QUANTILE) * self.position_std_m

    @property
    def position_std_m(self) -> float:
        """Return the standard deviation of the estimated position along its larger axis."""
        covariance = self.fit.station_covariance_m2
        if covariance is None:
            return 0.0
        largest = np.linalg.eigvalsh(covariance).max() if np.isfinite(covariance).all() else np.inf
        return float(np.sqrt(largest))


@dataclass(frozen=True, eq=False)
class Draft:
    """Problem file made from a log and a map.

    Attributes
    ----------
    text
        Content of the problem file.
    problem
        Problem that the file defines.
    grid
        Occupancy grid of the map; None without one.
    stations
        Transmitters with readings and positions.
    assumptions
        Sentences on detected and assumed values.
    warnings
        Sentences on implausible and uncertain values.
    """

    text: str
    problem: Problem
    grid: OccupancyGrid | None
    stations: tuple[DraftStation, ...]
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass
class _Notes:
    """Collected assumptions and warnings of a draft."""

    assumptions: list[str] = field(default_factory=list[str])
    warnings: list[str] = field(default_factory=list[str])

    def assume(self, *sentences: str) -> None:
        self.assumptions += sentences

    def warn(self, *sentences: str) -> None:
        self.warnings += [each for each in sentences if each not in self.warnings]


def draft_problem(
    log: Path | str,
    file: Path | str,
    settings: DraftSettings,
    *,
    map_file: Path | str | None = None,
    log_format: LogFormat | None = None,
    transmitter_column: str | None = None,
) -> Draft:
    """Draft the problem of reaching a goal from a log and a map.

    Parameters
    ----------
    log
        Power log, as for :func:`planopt.channel.read_log`.
    file
        Problem file to be written; the names of log and map in it are relative to its folder.
    settings
        Start, goal and further values.
    map_file
        Occupancy grid or obstacles; without it, the world is empty and extends around the log.
    log_format
        Columns, units and origin of the log; by default everything is detected.
    transmitter_column
        Column of the log that names the transmitter; detected by default.

    Raises
    ------
    InputError
        A file cannot be read, something is missing that cannot be detected, or start or goal are
        not free.
    """
    log, file, notes = Path(log), Path(file), _Notes()
    map_path = None if map_file is None else Path(map_file)
    table, log_format = _read(log, log_format or LogFormat(), map_path, notes)
    column, labels = _transmitters(table, transmitter_column, settings, notes)
    powers = {label: _readings(table, log_format, column, label) for label in labels}
    log_format = _with_details(log_format, list(powers.values()), notes)
    powers = {label: _readings(table, log_format, column, label) for label in labels}
    pooled = np.concatenate([each.measurements.positions_m for each in powers.values()])
    for each in powers.values():
        notes.warn(*log_warnings(each))
    positions = _given_stations(settings, labels, log_format.origin_deg)
    stations = [
        _station(label, each.measurements, positions.get(label), number, notes)
        for number, (label, each) in enumerate(powers.items())
    ]
    if column is None and stations[0].fit.status == "degenerate":
        notes.warn(
            "no column is known to name transmitters: if the log has several of them, give "
            f"--transmitter-column (the columns are {listed(table.names)}), else --station"
        )
    grid = read_grid(map_path) if map_path is not None and is_grid(map_path) else None
    start, goal = (
        _place(text, f"--{key}", log_format.origin_deg, pooled, grid, notes)
        for key, text in (("start", settings.start), ("goal", settings.goal))
    )
    origin_deg = log_format.origin_deg
    workspace = _workspace(map_path, grid, pooled, (start, goal), origin_deg, notes)
    _check_alignment(workspace, pooled, map_path is not None, notes)
    for each in stations:
        place = np.array([each.fit.parameters.station.position_m])
        if map_path is not None and not each.is_given and not inside_bounds(workspace, place).all():
            notes.warn(
                f"{each.name} is located outside the map (if it is not there, give --station)"
            )
    tables, comments = _tables(
        (log, map_path, file),
        log_format,
        column,
        stations,
        (start, goal),
        workspace,
        settings,
        notes,
    )
    heading = "\n".join(
        f"# {line}"
        for line in (
            "Made by planopt import. Assumptions:",
            *(f"- {each}" for each in notes.assumptions),
        )
    )
    text = f"{heading}\n\n{toml_text(tables, comments)}"
    folder = file.absolute().parent
    problem = problem_from_tables(tomllib.loads(text), folder=folder, file=file)
    # The grid's warnings are known, and an older problem file may still be in place.
    notes.warn(*problem_warnings(replace(problem, file=None)))
    return Draft(
        text, problem, grid, tuple(stations), tuple(notes.assumptions), tuple(notes.warnings)
    )


def _read(
    log: Path, log_format: LogFormat, map_path: Path | None, notes: _Notes
) -> tuple[LogTable, LogFormat]:
    """Return the readings of a log, and its format completed by columns and an origin."""
    table = read_table(log)
    if log_format.origin_deg is None:
        # Any origin reveals whether positions are in degrees.
        trial = columns_of(table, replace(log_format, origin_deg=(0.0, 0.0)))
        plain = alias(table, "x") is not None and alias(table, "y") is not None
        if trial.in_degrees and not plain and log_format.columns[0] is None:
            log_format = _with_origin(table, trial.x, trial.y, log_format, map_path, notes)
    columns = columns_of(table, log_format)
    missing = [name for name in (columns.x, columns.y, columns.power) if name not in table.names]
    if missing:
        raise InputError(
            f"there is no column {' or '.join(missing)}; the columns are {listed(table.names)}",
            file=log,
            row=table.header_line,
            remedy="name the columns by --columns x=NAME,y=NAME,power=NAME",
        )
    unit = "degrees" if columns.in_degrees else "metres"
    who = "" if columns.reader_name is None else f"log of {columns.reader_name}: "
    delimiter = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
    notes.assume(
        f"{who}columns {columns.x}, {columns.y} ({unit}) and {columns.power}, separated by "
        f"{delimiter.get(table.delimiter, table.delimiter)}"
    )
    readings = readings_of(table, columns)
    if len(readings.rows) < len(table.rows):
        notes.assume(
            f"{len(table.rows) - len(readings.rows)} of {len(table.rows)} rows are no readings "
            "with a position"
        )
    if not readings.rows:
        raise InputError(
            "contains no measurements", file=log, remedy="give a log with at least one row"
        )
    return readings, replace(log_format, columns=(columns.x, columns.y, columns.power))


def _with_origin(
    table: LogTable, x: str, y: str, log_format: LogFormat, map_path: Path | None, notes: _Notes
) -> LogFormat:
    """Return the format with the first position as origin; raise an error if there is a map."""
    table.index(x)
    table.index(y)
    if not table.rows:
        raise InputError(
            "contains no measurements", file=table.file, remedy="give at least one row"
        )
    longitude, latitude = table.numbers(x)[0].number(), table.numbers(y)[0].number()
    if map_path is not None:
        raise InputError(
            f"is missing: the columns {x} and {y} are in degrees, but the map is in metres",
            file=table.file,
            key="--origin",
            row=table.header_line,
            remedy="give the latitude and longitude of the map's point (0, 0); the first row is at "
            f"{latitude:g},{longitude:g}",
        )
    notes.assume(f"the origin is the first position of the log, {latitude:.7f},{longitude:.7f}")
    return replace(log_format, origin_deg=(latitude, longitude))


def _transmitters(
    table: LogTable, column: str | None, settings: DraftSettings, notes: _Notes
) -> tuple[str | None, list[str]]:
    """Return the transmitter column and the labels of transmitters that become stations."""
    if column is None:
        column = alias(table, "transmitter")
        if column is None:
            notes.assume("all readings belong to one transmitter")
            return None, ["station"]
        notes.assume(f"column {column} names the transmitter")
    counts = labels_of(table, column)
    unknown = [label for label in settings.transmitters if label not in counts]
    if unknown:
        raise InputError(
            f"no row has {column}={unknown[0]}",
            file=table.file,
            key="--transmitter",
            remedy=f"{column} has {listed(counts)}",
        )
    if settings.transmitters:
        return column, list(settings.transmitters)
    kept = [label for label, count in counts.items() if count >= FEWEST_READINGS][:MAX_STATIONS]
    if not kept:
        raise InputError(
            f"has no transmitter with at least {FEWEST_READINGS} measurements; "
            f"{next(iter(counts))} has the most, {max(counts.values())}",
            file=table.file,
            key=column,
            remedy="choose another column by --transmitter-column, or give a longer log",
        )
    if len(kept) < len(counts):
        notes.assume(
            f"{len(counts) - len(kept)} of {len(counts)} transmitters are left out: at most "
            f"{MAX_STATIONS} with at least {FEWEST_READINGS} readings are used (choose them with "
            "--transmitter)"
        )
    return column, kept


def _readings(table: LogTable, log_format: LogFormat, column: str | None, label: str) -> PowerLog:
    """Return the readings of one transmitter."""
    where = log_format.where if column is None else (*log_format.where, (column, label))
    chosen = replace(log_format, where=where)
    rows = rows_of(table, chosen)
    return measurements_of(rows, columns_of(rows, chosen), chosen)


def _with_details(log_format: LogFormat, logs: Sequence[PowerLog], notes: _Notes) -> LogFormat:
    """Return the format completed by receiver floor and rounding step, if detectable."""
    power = np.concatenate([each.measurements.power_dbm for each in logs])
    if logs[0].power_unit != "dBm":
        notes.assume(f"powers are in {logs[0].power_unit}")
    else:
        notes.assume(f"powers are in dBm, from {power.min():g} to {power.max():g}")
    if log_format.floor_dbm is None and log_format.censored_column is None:
        floor = floor_pile_dbm(power)
        if floor is not None:
            notes.assume(
                f"the receiver's floor is {floor:g} dBm, since so many readings have this least "
                "power; they are upper limits"
            )
            log_format = replace(log_format, floor_dbm=floor)
    if log_format.resolution_db == 0.0 and len(power) > 1 and (power == np.round(power)).all():
        notes.assume("powers are rounded to 1 dB")
        log_format = replace(log_format, resolution_db=1.0)
    if log_format.position_std_m == 0.0:
        notes.assume("measured positions are exact (--position-error)")
    return log_format


def _given_stations(
    settings: DraftSettings, labels: Sequence[str], origin_deg: Origin | None
) -> dict[str, Station]:
    """Return the known positions of transmitters by label; options override the file."""
    found: dict[str, Station] = {}
    if settings.stations_file is not None:
        found = read_stations(settings.stations_file, labels, origin_deg)
    for text in settings.stations:
        label, equals, position = text.rpartition("=")
        if not equals:
            if len(labels) != 1:
                raise InputError(
                    f"is {text!r}, but the log has several transmitters",
                    key="--station",
                    remedy=f"write {labels[0]}={text}; the transmitters are {listed(labels)}",
                )
            label = labels[0]
        if label not in labels:
            raise InputError(
                f"names the transmitter {label!r}, which is not in the log",
                key="--station",
                remedy=f"the transmitters are {listed(labels)}",
            )
        station = parse_station(position, origin_deg)
        if station is not None:
            found[label] = station
    return found


def _station(
    label: str, measurements: Measurements, given: Station | None, number: int, notes: _Notes
) -> DraftStation:
    """Return a station with its channel fit; its position is estimated if unknown."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", label).strip("-")[:40] or f"station_{number + 1}"
    if given is None and int((~measurements.censored).sum()) < MIN_UNCENSORED:
        raise InputError(
            f"is needed for {label}: fewer than {MIN_UNCENSORED} measurements above the "
            "receiver's sensitivity cannot locate it",
            key="--station",
            remedy=f"add --station {label}=X,Y, or select other transmitters by --transmitter",
        )
    fit = (
        fit_channel_and_station(measurements, height_m=None)
        if given is None
        else fit_channel(measurements, given)
    )
    found = DraftStation(name, label, measurements, fit, given is not None)
    (x, y), within_m = fit.parameters.station.position_m, found.region_m
    if given is None:
        words = (
            f"located from {len(measurements)} readings within {within_m:.3g} m (95 %); plans use "
            "this position as if it were exact"
        )
        if not math.isfinite(within_m):
            words = (
                "a placeholder: the readings do not determine it (measure it and give --station "
                f"{label}=X,Y, drive closer to the transmitter, or leave it out by --transmitter)"
            )
        notes.assume(f"{label} is at ({x:.1f}, {y:.1f}) m, {words}")
    # An assumption says that the position is estimated.
    said = [each for each in fit.warnings if not each.endswith("estimated, not given")]
    notes.warn(*(f"{label}: {warning}" for warning in said))
    return found


def _place(
    text: str,
    key: str,
    origin_deg: Origin | None,
    near_m: np.ndarray[Any, np.dtype[np.float64]],
    grid: OccupancyGrid | None,
    notes: _Notes,
) -> tuple[float, float]:
    """Parse a position, in degrees if this puts it near the log or the map, else in metres."""
    match = re.fullmatch(r"\s*([^,\s]+)\s*,\s*([^,\s]+?)\s*(m|deg)?\s*", text)
    try:
        first, second = (float(part) for part in (match.groups()[:2] if match else ("", "")))
    except ValueError:
        first = second = math.nan
    if match is None or not math.isfinite(first + second):
        raise InputError(
            f"cannot read {text!r}",
            key=key,
            remedy="write X,Y in metres, or LAT,LON in degrees with --origin",
        )
    if match[3] == "deg" and origin_deg is None:
        raise InputError(
            f"is {text!r}, in degrees, but the map has no origin",
            key=key,
            remedy="add --origin LAT,LON, or give X,Y in metres",
        )
    if match[3] == "m" or origin_deg is None:
        return first, second
    (place,) = east_north_m(np.array([second]), np.array([first]), origin_deg)
    low, high = near_m.min(axis=0), near_m.max(axis=0)
    if grid is not None:
        low = np.minimum(low, grid.bounds_m[:2])
        high = np.maximum(high, grid.bounds_m[2:])
    extent = high - low
    is_near = bool((place >= low - extent).all() and (place <= high + extent).all())
    if match[3] == "deg" or is_near:
        x, y = place.tolist()
        if match[3] is None:
            notes.assume(f"{key} {text} is in degrees: ({x:.1f}, {y:.1f}) m")
        return round(x, 3), round(y, 3)
    nearby = np.abs(np.array([[first, second], [second, first]]) - origin_deg[:2]) < NEAR_DEG
    if nearby.all(axis=1).any():
        raise InputError(
            f"is {text!r}: in degrees it is far from the map and the log",
            key=key,
            remedy=f"write LAT,LON, or {first:g},{second:g}m if these are metres",
        )
    return first, second


def _workspace(
    map_path: Path | None,
    grid: OccupancyGrid | None,
    positions_m: np.ndarray[Any, np.dtype[np.float64]],
    places: Sequence[tuple[float, float]],
    origin_deg: Origin | None,
    notes: _Notes,
) -> Workspace:
    """Return the world with the extent of the grid, or of all positions plus a margin."""
    if grid is not None and map_path is not None:
        unknown = float(grid.unknown.mean())
        notes.warn(*grid_warnings(map_path.name, grid))
        if unknown > 0.0:
            notes.assume(f"unknown cells ({100.0 * unknown:.0f} % of the map) are occupied")
        return Workspace(grid.bounds_m, grid_obstacles(grid, map_path.stem))
    obstacles = () if map_path is None else read_obstacles(map_path, origin_deg=origin_deg)
    known = Measurements(
        np.vstack([positions_m, np.array(places)]), np.zeros(len(positions_m) + len(places))
    )
    x_min, y_min, x_max, y_max = measured_bounds_m(known)
    margin = MARGIN_SHARE * max(x_max - x_min, y_max - y_min)
    bounds = (x_min - margin, y_min - margin, x_max + margin, y_max + margin)
    bounds = tuple(round(each, 1) for each in bounds)
    notes.assume(
        f"the world surrounds log, start and goal: {', '.join(f'{b:g}' for b in bounds)} m"
        + ("; there are no obstacles (give --map)" if map_path is None else "")
    )
    return Workspace(bounds, obstacles)


GPS_SHARE = 0.02  # Maximum share of measurements on obstacles that position errors explain


def _check_alignment(
    workspace: Workspace,
    positions_m: np.ndarray[Any, np.dtype[np.float64]],
    has_map: bool,
    notes: _Notes,
) -> None:
    """Add a warning if the log lies outside the map or on obstacles."""
    inside = inside_bounds(workspace, positions_m)
    log_m = float(np.hypot(*np.ptp(positions_m, axis=0)))
    x_min, y_min, x_max, y_max = workspace.bounds_m
    map_m = math.hypot(x_max - x_min, y_max - y_min)
    if has_map and log_m < SMALL_LOG * map_m:
        notes.warn(
            f"the log spans {log_m:,.0f} m of a map of {map_m:,.0f} m (check the resolution of the "
            "map, in metres per cell)"
        )
    if not inside.all():
        notes.warn(
            f"{100.0 * (1.0 - inside.mean()):.0f} % of the measurements are outside the map (check "
            "--origin and the origin of the map)"
        )
    if inside.any() and workspace.obstacles:
        away = clearance_m(index_obstacles(workspace), positions_m[inside])
        blocked = float((away <= 0.0).mean())
        if 0.0 < blocked <= GPS_SHARE:
            notes.assume(
                f"{100.0 * blocked:.1f} % of the measurements are in occupied or unknown cells, "
                "probably because of position errors (--position-error)"
            )
        elif blocked > GPS_SHARE:
            notes.warn(
                f"{100.0 * blocked:.1f} % of the measurements on the map are in occupied or "
                "unknown cells (check --origin LAT,LON,ANGLE; ANGLE is the direction of "
                "the map's x axis in degrees counter-clockwise from east)"
            )


def _tables(
    files: tuple[Path, Path | None, Path],
    log_format: LogFormat,
    column: str | None,
    stations: Sequence[DraftStation],
    places: tuple[tuple[float, float], tuple[float, float]],
    workspace: Workspace,
    settings: DraftSettings,
    notes: _Notes,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tables of the problem file and comments on assumed values."""
    log, map_path, file = files
    folder = file.absolute().parent
    x_min, y_min, x_max, y_max = workspace.bounds_m
    diagonal = math.hypot(x_max - x_min, y_max - y_min)
    speed = 1.0 if settings.speed_m_s is None else settings.speed_m_s
    clearance = 0.3 if settings.clearance_m is None else settings.clearance_m
    wanted = STEP_SHARE * diagonal
    tens = 10.0 ** math.floor(math.log10(wanted))
    steps = [digit * tens * scale for scale in (1.0, 10.0) for digit in ROUND_STEPS]
    step = float(f"{min(steps, key=lambda each: abs(math.log(each / wanted))):.1g}")
    _require_free(workspace, places, clearance)
    weakest = min(float(each.measurements.power_dbm.min()) for each in stations)
    threshold = weakest + ABOVE_FLOOR_DB
    if settings.threshold_dbm is not None:
        threshold = settings.threshold_dbm
    else:
        notes.assume(
            f"a robot is connected at {threshold:g} dBm or more, {ABOVE_FLOOR_DB:g} dB above the "
            "weakest reading (--threshold)"
        )
    if settings.speed_m_s is None:
        notes.assume(f"the robot drives at {speed:g} m/s (--speed)")
    if settings.clearance_m is None:
        notes.assume(f"its centre keeps {clearance:g} m from obstacles (--clearance)")
    notes.assume(
        f"steps are {step:g} m long, P(connected) should be at least {settings.p_min:g}",
        f"transmit powers are {TRANSMIT_POWER_DBM:g} dBm; plans do not depend on them",
        "simulations draw channels from the fit to the log",
    )
    obstacles: list[dict[str, Any]] = []
    if map_path is not None:
        place = None if is_grid(map_path) else log_format.origin_deg
        obstacles = [{"file": _relative(map_path, folder), "origin_deg": place}]
    tables: dict[str, Any] = {
        "problem": {
            "schema": SCHEMA_VERSION,
            "name": re.sub(r"[^A-Za-z0-9_-]+", "_", file.stem) or "problem",
            "task": "reach",
            "description": f"Made from {log.name}"
            + ("" if map_path is None else f" and {map_path.name}")
            + ".",
        },
        "world": {"bounds_m": list(workspace.bounds_m), "obstacles": obstacles},
        "channel": {
            "truth": {"kind": "fitted", "cell_m": default_cell_m(workspace.bounds_m)},
            "measurements": {
                "file": _relative(log, folder),
                "transmitter_column": column,
                **log_format.to_keys(),
                "spacing_m": step,
            },
            "fit": {"method": "map"},
        },
        "stations": [
            {
                "name": each.name,
                "transmitter": None if column is None else each.label,
                "position_m": [round(float(x), 2) for x in each.fit.parameters.station.position_m],
                "position_known": None if math.isfinite(each.region_m) else False,
                "height_m": each.fit.parameters.station.height_m,
                "transmit_power_dbm": TRANSMIT_POWER_DBM,
                "threshold_dbm": threshold,
            }
            for each in stations
        ],
        "robots": [
            {
                "name": "robot",
                "start_m": list(places[0]),
                "goal_m": list(places[1]),
                "speed_max_m_s": speed,
            }
        ],
        "constraints": {"p_min": settings.p_min, "clearance_m": clearance},
        "planner": {
            "name": "auto",
            "horizon": 10,
            "step_s": step / speed,
            "max_steps": math.ceil(ROUTE_DIAGONALS * diagonal / step),
        },
    }
    comments = {
        "planner.step_s": f"{step:g} m a step",
        "stations.transmit_power_dbm": "assumed; plans do not depend on it",
    }
    if log_format.origin_deg is not None:
        comments["channel.measurements.origin_deg"] = "latitude and longitude of (0, 0)"
    if settings.threshold_dbm is None:
        comments["stations.threshold_dbm"] = "assumed"
    for number, each in enumerate(stations):
        if not each.is_given:
            comments[f"stations[{number}].position_m"] = (
                f"located within {each.region_m:.3g} m (95 %)"
                if math.isfinite(each.region_m)
                else "placeholder: the readings do not determine it"
            )
    return tables, comments


def _relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with forward slashes."""
    return Path(os.path.relpath(path.absolute(), folder)).as_posix()


def _require_free(
    workspace: Workspace, places: Sequence[tuple[float, float]], clearance: float
) -> None:
    """Raise an InputError that names the nearest free position if start or goal is not free."""
    index = index_obstacles(workspace)
    for key, place in zip(("--start", "--goal"), places, strict=True):
        at = np.array([place])
        if inside_bounds(workspace, at).all() and clearance_m(index, at)[0] >= clearance:
            continue
        x_min, y_min, x_max, y_max = workspace.bounds_m
        side = max(x_max - x_min, y_max - y_min) / SEARCHED_CELLS
        x, y = np.arange(x_min, x_max, side), np.arange(y_min, y_max, side)
        nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        free = nodes[clearance_m(index, nodes) >= clearance]
        where = (
            "outside the map"
            if not inside_bounds(workspace, at).all()
            else (f"less than the clearance of {clearance:g} m from an obstacle or unknown space")
        )
        nearest = "there is no free position; reduce --clearance"
        if len(free):
            x, y = free[np.argmin(np.linalg.norm(free - at, axis=1))].tolist()
            nearest = f"the nearest free position is {x:.2f},{y:.2f}"
        raise InputError(f"({place[0]:g}, {place[1]:g}) m is {where}", key=key, remedy=nearest)
