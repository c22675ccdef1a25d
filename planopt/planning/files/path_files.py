"""Files of paths by extension, and Nav2 masks of the channel belief."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.channel.channel_map import default_cell_m, serving_map
from planopt.channel.posterior import Belief
from planopt.errors import InputError
from planopt.files.tables import Column, table_text
from planopt.files.writing import write_text
from planopt.planning.loop.results import MotionResult, Run, Solution
from planopt.problems.problem import Problem
from planopt.world.geodesy import Origin, longitude_latitude_deg, require_origin
from planopt.world.nav2_masks import MaskLimits, write_masks

STILL_M = 1e-9
"""Length of a step below which a robot keeps its heading."""

NANOSECONDS = 1_000_000_000

ROVER, COPTER = 10, 2
"""MAVLink codes of the vehicle types."""
WAYPOINT, RELATIVE_ALTITUDE, PX4 = 16, 3, 12
"""MAVLink codes of the waypoint command, its coordinate frame and the autopilot."""


@dataclass(frozen=True, eq=False)
class RobotPath:
    """Path of a robot for export: times, positions and probabilities of connection."""

    robot: str
    t_s: Floats  # (n,)
    positions_m: Floats  # (n, 2)
    connectivity: Floats  # (n,) predicted probability of connection; NaN if unknown
    speed_m_s: float
    frame: str = "map"
    altitude_m: float = 0.0
    origin_deg: Origin | None = None  # Latitude and longitude of (0, 0)

    @property
    def degrees(self) -> Floats:
        """Return longitude and latitude of each position as an array ``(n, 2)``."""
        if self.origin_deg is None:
            raise InputError(
                "is missing, and this file has degrees",
                key="--origin",
                remedy="give the latitude and longitude of (0, 0) as LAT,LON (origin_deg)",
            )
        return np.round(longitude_latitude_deg(self.positions_m, self.origin_deg), 9)

    @property
    def headings_rad(self) -> Floats:
        """Return the heading at each position; a stationary robot keeps its last heading."""
        steps = np.diff(self.positions_m, axis=0)
        moves = np.linalg.norm(steps, axis=1) > STILL_M
        heading = np.arctan2(steps[:, 1], steps[:, 0])
        found = np.zeros(len(self.positions_m))
        last = heading[np.argmax(moves)] if moves.any() else 0.0
        for number, (moving, angle) in enumerate(zip(moves, heading, strict=True)):
            last = angle if moving else last
            found[number] = last
        found[-1] = last
        return found


def ros_text(path: RobotPath) -> str:
    """Return a path as the JSON of a ``nav_msgs/msg/Path``."""

    def header(time_s: float) -> dict[str, Any]:
        whole = round(time_s * NANOSECONDS)
        stamp = {"sec": whole // NANOSECONDS, "nanosec": whole % NANOSECONDS}
        return {"stamp": stamp, "frame_id": path.frame}

    poses = [
        {
            "header": header(time),
            "pose": {
                "position": {"x": x, "y": y, "z": path.altitude_m},
                "orientation": {
                    "x": 0.0,
                    "y": 0.0,
                    "z": math.sin(heading / 2.0),
                    "w": math.cos(heading / 2.0),
                },
            },
        }
        for time, (x, y), heading in zip(
            path.t_s.tolist(), path.positions_m.tolist(), path.headings_rad.tolist(), strict=True
        )
    ]
    return json.dumps({"header": header(0.0), "poses": poses}, indent=1) + "\n"


def geojson_text(path: RobotPath) -> str:
    """Return a path as a GeoJSON feature (RFC 7946) with times and probabilities."""
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": path.degrees.tolist()},
        "properties": {
            "name": path.robot,
            "t_s": path.t_s.tolist(),
            "connectivity": _known(path.connectivity),
        },
    }
    return json.dumps({"type": "FeatureCollection", "features": [feature]}, indent=1) + "\n"


def qgroundcontrol_text(path: RobotPath) -> str:
    """Return a path as a QGroundControl mission, for a rover or for a copter at an altitude."""
    height = path.altitude_m
    items = [
        {
            "type": "SimpleItem",
            "command": WAYPOINT,
            "frame": RELATIVE_ALTITUDE,
            "params": [0, 0, 0, None, latitude, longitude, height],
            "autoContinue": True,
            "doJumpId": number,
            "Altitude": height,
            "AltitudeMode": 1,
            "AMSLAltAboveTerrain": None,
        }
        for number, (longitude, latitude) in enumerate(path.degrees.tolist(), start=1)
    ]
    longitude, latitude = path.degrees[0].tolist()
    mission = {
        "version": 2,
        "firmwareType": PX4,
        "vehicleType": COPTER if height > 0.0 else ROVER,
        "globalPlanAltitudeMode": 1,
        "cruiseSpeed": path.speed_m_s,
        "hoverSpeed": path.speed_m_s,
        "plannedHomePosition": [latitude, longitude, 0.0],
        "items": items,
    }
    plan: dict[str, Any] = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": mission,
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(plan, indent=1) + "\n"


PATH_COLUMNS = (
    Column("t_s", "time", "s"),
    Column("x_m", "position", "m"),
    Column("y_m", "position", "m"),
    Column("heading_rad", "direction of motion from the x axis", "rad"),
    Column("connectivity", "predicted probability of connection"),
)
DEGREE_COLUMNS = (Column("latitude_deg", "WGS 84", "deg"), Column("longitude_deg", "WGS 84", "deg"))


def csv_text(path: RobotPath) -> str:
    """Return a path as CSV text, with degrees if the origin is known."""
    x, y = path.positions_m.T
    values = {
        "t_s": path.t_s,
        "x_m": x,
        "y_m": y,
        "heading_rad": path.headings_rad,
        "connectivity": path.connectivity,
    }
    if path.origin_deg is None:
        return table_text(PATH_COLUMNS, values)
    longitude, latitude = path.degrees.T
    degrees = {"latitude_deg": latitude, "longitude_deg": longitude}
    return table_text((*PATH_COLUMNS, *DEGREE_COLUMNS), {**values, **degrees})


WRITERS: dict[str, Callable[[RobotPath], str]] = {
    ".json": ros_text,
    ".geojson": geojson_text,
    ".plan": qgroundcontrol_text,
    ".csv": csv_text,
}
"""Writers of paths by file extension."""


def path_of_result(result: MotionResult, robot: int | str = 0) -> RobotPath:
    """Return a robot's path: the plan of a solution, or the driven path of a run."""
    names = [each.name for each in result.problem.robots]
    number = names.index(robot) if robot in names else robot
    if not isinstance(number, int) or not 0 <= number < len(names):
        raise InputError(
            f"is {robot!r}, but the problem has no such robot",
            key="robot",
            remedy=f"give one of {', '.join(names)}, or an index, counted from 0",
        )
    source: Any
    if isinstance(result, Solution):
        source = result.plans[number]
    else:
        source = cast("Run", result).runs[number].log
    return RobotPath(
        names[number],
        source.t_s,
        source.positions_m,
        source.connectivity,
        result.problem.robots[number].speed_max_m_s,
        origin_deg=result.problem.channel.origin_deg,
    )


def save_path(
    path: RobotPath, file: Path, origin_deg: Origin | None = None, altitude_m: float = 0.0
) -> None:
    """Write a robot's path to a file in the format of its extension."""
    write = WRITERS.get(file.suffix.lower())
    if write is None:
        raise InputError(
            f"paths cannot be written as {file.suffix or 'a file without ending'!r}",
            file=file,
            remedy=f"end the name in one of {', '.join(WRITERS)}",
        )
    if not math.isfinite(altitude_m):
        raise InputError(f"is {altitude_m!r}", key="altitude_m", remedy="give an altitude in m")
    if origin_deg is not None:
        path = replace(path, origin_deg=require_origin(origin_deg, "origin_deg"))
    write_text(file, write(replace(path, altitude_m=float(altitude_m))))


def _known(values: Floats) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def save_masks(
    problem: Problem,
    belief: Belief,
    folder: Path,
    keepout_below: float,
    p_min: float | None,
    cell_m: float | None,
) -> None:
    """Write Nav2 masks; `p_min` defaults to the problem's value if this is positive."""
    asked = problem.constraints.p_min or None if p_min is None else p_min
    limits = MaskLimits(keepout_below) if asked is None else MaskLimits(keepout_below, asked)
    bounds = problem.workspace.bounds_m
    thresholds = [station.threshold_dbm for station in problem.stations]
    cell = default_cell_m(bounds) if cell_m is None else cell_m
    found = serving_map(belief.posteriors, bounds, cell, thresholds)
    write_masks(folder, found.connectivity, limits)
