"""Warnings about valid but implausible values, such as a wrong sign, unit, frame or scale.

A warning names the implausible value and a remedy; it is never an error.
"""

from collections.abc import Iterator

import numpy as np

from planopt.channel.logs.power_log import DETECTED_MW, PowerLog
from planopt.channel.measurements import Measurements
from planopt.errors import InputError
from planopt.problems.library import read_toml
from planopt.problems.problem import Problem
from planopt.world.occupancy import OccupancyGrid, is_grid, read_grid

DEGREE_NAMES = ("lat", "lon", "lng")  # Parts of column names that indicate degrees
DEGREES_SPAN = 0.5
"""Extent of a log's coordinates below which they may be degrees instead of metres."""
THRESHOLDS_DBM = (-150.0, -10.0)  # Plausible range of connection thresholds
STRONGEST_DBM = 30.0  # Largest plausible received power (1 W), next to an antenna
LARGEST_STEP_SHARE = 0.5  # Largest plausible step length as a share of the diagonal of the world
LONGEST_STEP_M = 100.0  # Largest plausible step length; steps must resolve obstacles and shadows
FARTHEST_STATION = 10.0
"""Largest plausible distance of a station in diagonals of the world (within `FARTHEST_M`)."""
FARTHEST_M = (2_000.0, 50_000.0)  # Bounds of the largest plausible distance of a station
COARSEST_CELL_M = 5.0  # Largest plausible cell side of an occupancy grid; robots map at centimetres
JUMP_STEPS = 10.0  # Largest plausible distance between a robot and its plan, in step lengths


def log_warnings(log: PowerLog) -> Iterator[str]:
    """Yield warnings about a log, such as degrees read as metres or powers in another unit."""
    columns = log.columns
    if columns.reader is not None and columns.reader.remark is not None:
        yield columns.reader.remark
    if log.power_unit == DETECTED_MW:
        yield f"powers are in {DETECTED_MW}, and become dBm (else give --power-unit dBm)"
    if len(log.transmitters) > 1:
        column, first = columns.transmitter, next(iter(log.transmitters))
        yield (
            f"column {column} names {len(log.transmitters)} transmitters, which are fitted as one "
            f"(select one with --where {column}={first}, or fit each with --each {column})"
        )
    if not columns.in_degrees and len(log.measurements):
        x, y = log.measurements.positions_m.T
        names = [name.lower() for name in (columns.x, columns.y)]
        named = all(any(part in name for part in DEGREE_NAMES) for name in names)
        within = np.abs(x).max() <= 180.0 and np.abs(y).max() <= 90.0
        span = max(np.ptp(x), np.ptp(y))
        if within and (named or 0.0 < span < DEGREES_SPAN):
            yield (
                f"columns {columns.x} and {columns.y} look like degrees, and "
                f"count as metres: the log extends over {span:.3g} m (give --origin LAT,LON)"
            )
    yield from measured_warnings(log.measurements, "the log")


def measured_warnings(measurements: Measurements, source: str = "measurements") -> Iterator[str]:
    """Yield warnings about the powers of a log, or of initial or new measurements."""
    power = measurements.power_dbm
    if not len(power):
        return
    least, most = float(power.min()), float(power.max())
    if 0.0 <= least and most <= 1.0:
        yield (
            f"the powers of {source}, {least:.3g} to {most:.3g}, look like milliwatts and count as "
            "dBm (give --power-unit mW, or 10 log10 of the power in mW)"
        )
    elif np.median(power) > 0.0:
        yield (
            f"most powers of {source} are positive, {least:.3g} to {most:.3g} dBm: no receiver "
            "measures this (write the minus sign)"
        )
    elif most > STRONGEST_DBM:
        yield f"{source}: a power of {most:g} dBm is implausible (check its sign and unit)"


def problem_warnings(problem: Problem) -> Iterator[str]:
    """Yield warnings about the values of a problem and its map files."""
    low, high = np.reshape(problem.workspace.bounds_m, (2, 2))
    diagonal_m, step_s = float(np.hypot(*(high - low))), problem.planner.step_s
    for number, robot in enumerate(problem.robots):
        step_m = robot.speed_max_m_s * step_s
        if step_m > min(LARGEST_STEP_SHARE * diagonal_m, LONGEST_STEP_M):
            yield (
                f"planner.step_s {step_s:g} s: robots[{number}] may drive {step_m:g} m in a step, "
                f"in a world of {diagonal_m:,.0f} m (reduce planner.step_s, or check speeds "
                "in m/s)"
            )
    farthest_m = float(np.clip(FARTHEST_STATION * diagonal_m, *FARTHEST_M))
    for number, station in enumerate(problem.stations):
        key = f"stations[{number}]"
        place = np.array(station.position_m)
        away_m = float(np.linalg.norm(place - np.clip(place, low, high)))
        if away_m > farthest_m:
            yield (
                f"{key}.position_m is {away_m / 1000.0:,.0f} km from the world (give metres in the "
                "frame of world.bounds_m)"
            )
        if not station.position_known:
            yield (
                f"{key}.position_m of {station.name} is a placeholder: the log does not determine "
                "it, and P(connected) away from the readings is unreliable (measure the position, "
                "drive closer to the transmitter, or leave it out)"
            )
        for name in ("threshold_dbm", "receive_threshold_dbm"):
            value = getattr(station, name)
            if value is not None and not THRESHOLDS_DBM[0] <= value <= THRESHOLDS_DBM[1]:
                yield (
                    f"{key}.{name} {value:g} dBm is implausible: thresholds lie between "
                    f"{THRESHOLDS_DBM[0]:g} and {THRESHOLDS_DBM[1]:g} dBm (check sign and unit)"
                )
    if problem.file is None:
        return
    try:
        tables = read_toml(problem.file).get("world", {}).get("obstacles", [])
        found = [table for table in tables if is_grid(table.get("file"))]
        grids = [read_grid(problem.file.parent / table["file"]) for table in found]
    except (InputError, AttributeError, TypeError):
        return  # Saved problem, or file changed in the meantime
    for table, grid in zip(found, grids, strict=True):
        yield from grid_warnings(table["file"], grid)
        if grid.unknown.any():
            yield (
                f"{table['file']}: {100.0 * grid.unknown.mean():.1f} % of the cells are unknown "
                f"and count as {table.get('unknown', 'occupied')}"
            )


def grid_warnings(name: str, grid: OccupancyGrid) -> Iterator[str]:
    """Yield warnings about an occupancy grid."""
    share = grid.grey_free_cells / grid.occupied.size
    if grid.grey_free_cells:
        yield (
            f"{name}: {100.0 * share:.1f} % of the cells are grey 205, which mapping tools write "
            "for unknown, and count as free (free_thresh: 0.196 makes them unknown)"
        )
    if grid.resolution_m > COARSEST_CELL_M:
        yield (
            f"{name}: cells of {grid.resolution_m:g} m are implausibly large (resolution is "
            "metres per cell)"
        )
