"""Files of paths by extension, Nav2 masks, and recordings for viewers (MCAP, Rerun)."""

import json
import math
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.channel.channel_map import default_cell_m, serving_map
from planopt.channel.posterior import Belief
from planopt.errors import InputError
from planopt.files.tables import Column, table_text
from planopt.files.writing import write_text, write_whole
from planopt.planning.loop.results import MotionResult, Run, Solution
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.world.geodesy import Origin, longitude_latitude_deg, require_origin
from planopt.world.nav2_masks import MaskLimits, write_masks

STILL_M = 1e-9  # Length of a step below which a robot keeps its heading

NANOSECONDS = 1_000_000_000

ROVER, COPTER = 10, 2  # MAVLink codes of the vehicle types
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
                "is missing, but files of this kind have positions in degrees",
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


Writer = TypeVar("Writer")


def _writer_of(writers: Mapping[str, Writer], file: Path, what: str) -> Writer:
    """Return the writer for the extension of a file."""
    write = writers.get(file.suffix.lower())
    if write is None:
        raise InputError(
            f"{what} cannot be written as {file.suffix or 'a file without ending'!r}",
            file=file,
            remedy=f"end the name in one of {', '.join(writers)}",
        )
    return write


def save_path(
    path: RobotPath, file: Path, origin_deg: Origin | None = None, altitude_m: float = 0.0
) -> None:
    """Write a robot's path to a file in the format of its extension."""
    write = _writer_of(WRITERS, file, "paths")
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
    """Write Nav2 masks; `p_min` defaults to that of the problem or, if 0, of `MaskLimits`."""
    asked = problem.constraints.p_min or None if p_min is None else p_min
    limits = MaskLimits(keepout_below) if asked is None else MaskLimits(keepout_below, asked)
    bounds = problem.workspace.bounds_m
    thresholds = [station.threshold_dbm for station in problem.stations]
    cell = default_cell_m(bounds) if cell_m is None else cell_m
    found = serving_map(belief.posteriors, bounds, cell, thresholds)
    write_masks(folder, found.connectivity, limits)


FRAME = "map"


FLOAT32 = 7  # Code of the numeric type in Foxglove's grids
LINE_LOOP = 1  # Code of a closed line in Foxglove's scenes

OBSTACLE_COLOUR = {"r": 0.35, "g": 0.35, "b": 0.35, "a": 1.0}


@dataclass(frozen=True, eq=False)
class _Track:
    """Motion of a robot: times, poses, numbers to plot, and the plan made at each step."""

    robot: str
    t_s: Floats
    positions_m: Floats  # (n, 2)
    numbers: Mapping[str, Floats]  # (n,) by name
    plans: Sequence[Plan]


def _tracks(result: MotionResult) -> Iterator[_Track]:
    """Yield the motion of each robot of a solution or run."""
    if isinstance(result, Solution):
        for plan in result.plans:
            yield _Track(
                plan.robot, plan.t_s, plan.positions_m, _numbers(plan.mean_dbm, plan), [plan]
            )
    elif isinstance(result, Run):
        for run, plans in zip(result.runs, result.plans, strict=True):
            log = run.log
            numbers = {**_numbers(log.predicted_dbm, log), "received_dbm": log.true_dbm}
            yield _Track(run.robot, log.t_s, log.positions_m, numbers, plans)


def _numbers(mean_dbm: Floats, source: Any) -> dict[str, Floats]:
    return {
        "predicted_dbm": mean_dbm,
        "deviation_db": source.deviation_db,
        "connectivity": source.connectivity,
    }


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _several(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _COUNT, _TEXT = {"type": "number"}, {"type": "integer", "minimum": 0}, {"type": "string"}
_TIME = _object("time", sec=_COUNT, nsec=_COUNT)
_PLACE = {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER}
_POSE = _object(
    "foxglove.Pose",
    position=_object("foxglove.Vector3", **_PLACE),
    orientation=_object("foxglove.Quaternion", **_PLACE, w=_NUMBER),
)
_STAMPED = {"timestamp": _TIME, "frame_id": _TEXT}
_COLOUR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE = _object(
    "foxglove.LinePrimitive",
    type=_COUNT,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_several(_object("foxglove.Point3", **_PLACE)),
    color=_COLOUR,
    colors=_several(_COLOUR),
    indices=_several(_COUNT),
)
_ENTITY = _object(
    "foxglove.SceneEntity",
    **_STAMPED,
    id=_TEXT,
    lifetime=_object("duration", sec={"type": "integer"}, nsec=_COUNT),
    frame_locked={"type": "boolean"},
    lines=_several(_LINE),
)
_GRID = {
    "pose": _POSE,
    "column_count": _COUNT,
    "cell_size": _object("foxglove.Vector2", x=_NUMBER, y=_NUMBER),
    "row_stride": _COUNT,
    "cell_stride": _COUNT,
    "fields": _several(
        _object("foxglove.PackedElementField", name=_TEXT, offset=_COUNT, type=_COUNT)
    ),
    "data": {"type": "string", "contentEncoding": "base64"},
}
_OPTIONAL = {"type": ["number", "null"]}
SCHEMAS = {
    each["title"]: each
    for each in (
        _object("foxglove.PoseInFrame", **_STAMPED, pose=_POSE),
        _object("foxglove.PosesInFrame", **_STAMPED, poses=_several(_POSE)),
        _object("foxglove.Grid", **_STAMPED, **_GRID),
        _object("foxglove.SceneUpdate", deletions=_several({}), entities=_several(_ENTITY)),
        _object(
            "planopt.Link",
            timestamp=_TIME,
            predicted_dbm=_OPTIONAL,
            deviation_db=_OPTIONAL,
            connectivity=_OPTIONAL,
            received_dbm=_OPTIONAL,
        ),
    )
}
"""JSON schemas of the messages by name; those of Foxglove have the parts that are written."""


def _pose(place: Sequence[float], heading_rad: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading_rad / 2.0), "w": math.cos(heading_rad / 2.0)}
    return {"position": {"x": place[0], "y": place[1], "z": 0.0}, "orientation": turn}


def _headings(positions_m: Floats) -> list[float]:
    """Return the heading at each position; a stationary robot keeps its last heading."""
    steps = np.diff(positions_m, axis=0, append=positions_m[-1:])
    found: list[float] = []
    for dx, dy in steps.tolist():
        found.append(math.atan2(dy, dx) if dx or dy else (found[-1] if found else 0.0))
    return found


def _stamp(time_s: float) -> dict[str, int]:
    whole = round(time_s * NANOSECONDS)
    return {"sec": whole // NANOSECONDS, "nsec": whole % NANOSECONDS}


def _messages(result: MotionResult) -> Iterator[tuple[float, str, str, dict[str, Any]]]:
    """Yield time, topic, schema name and content of all messages, ordered within each topic."""

    def head(time_s: float) -> dict[str, Any]:
        return {"timestamp": _stamp(time_s), "frame_id": FRAME}

    bounds, posteriors = result.problem.workspace.bounds_m, result.belief_of(0).posteriors
    thresholds = [station.threshold_dbm for station in result.problem.stations]
    maps = serving_map(posteriors, bounds, default_cell_m(bounds), thresholds)
    layers = {
        "connectivity": maps.connectivity,
        "mean_dbm": maps.mean_db,
        "deviation_db": maps.deviation_db,
    }
    cells = np.stack([each.values for each in layers.values()], axis=-1).astype("<f4")
    (wide, high), (x, y) = maps.mean_db.cell_m, (maps.mean_db.x_m[0], maps.mean_db.y_m[0])
    grid = {
        "pose": _pose((float(x) - wide / 2.0, float(y) - high / 2.0)),
        "column_count": cells.shape[1],
        "cell_size": {"x": wide, "y": high},
        "row_stride": cells[0].nbytes,
        "cell_stride": cells[0, 0].nbytes,
        "fields": [
            {"name": name, "offset": 4 * number, "type": FLOAT32}
            for number, name in enumerate(layers)
        ],
        "data": b64encode(cells.tobytes()).decode(),
    }
    yield 0.0, "/map", "foxglove.Grid", {**head(0.0), **grid}
    entities = [
        {
            **head(0.0),
            "id": each.name,
            "lifetime": {"sec": 0, "nsec": 0},
            "frame_locked": False,
            "lines": [_line(ring) for ring in (each.polygon.exterior, *each.polygon.interiors)],
        }
        for each in result.problem.workspace.obstacles
    ]
    scene = {"deletions": list[Any](), "entities": entities}
    yield 0.0, "/obstacles", "foxglove.SceneUpdate", scene
    for track in _tracks(result):
        headings = _headings(track.positions_m)
        places = track.positions_m.tolist()
        for row, time_s in enumerate(track.t_s.tolist()):
            topic = f"/{track.robot}"
            pose = {**head(time_s), "pose": _pose(places[row], headings[row])}
            yield time_s, f"{topic}/pose", "foxglove.PoseInFrame", pose
            own = {name: float(each[row]) for name, each in track.numbers.items()}
            numbers = {name: value if math.isfinite(value) else None for name, value in own.items()}
            link = {"timestamp": _stamp(time_s), **numbers}
            yield time_s, f"{topic}/link", "planopt.Link", link
            if row < len(track.plans):
                ahead = track.plans[row].positions_m
                turned = zip(ahead.tolist(), _headings(ahead), strict=True)
                plan = {**head(time_s), "poses": [_pose(*each) for each in turned]}
                yield time_s, f"{topic}/plan", "foxglove.PosesInFrame", plan


def _line(ring: shapely.LinearRing) -> dict[str, Any]:
    """Return the outline of an obstacle as a closed line two pixels wide."""
    points = shapely.get_coordinates(ring)[:-1].tolist()
    return {
        "type": LINE_LOOP,
        "pose": _pose((0.0, 0.0)),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": [{"x": x, "y": y, "z": 0.0} for x, y in points],
        "color": OBSTACLE_COLOUR,
        "colors": [],
        "indices": [],
    }


def write_mcap(path: Path, result: MotionResult) -> None:
    """Write a result as MCAP with JSON messages."""
    writing = _package("mcap.writer", "ros")
    with path.open("wb") as file:
        writer = writing.Writer(file)
        writer.start(library="planopt")
        schemas = {
            name: writer.register_schema(name, "jsonschema", json.dumps(content).encode())
            for name, content in SCHEMAS.items()
        }
        channels: dict[str, int] = {}
        for time_s, topic, schema, content in _messages(result):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schemas[schema])
            at = round(time_s * NANOSECONDS)
            data = json.dumps(content, allow_nan=False).encode()
            writer.add_message(channels[topic], at, data, at)
        writer.finish()


def write_rerun(path: Path, result: MotionResult) -> None:
    """Write a result as a Rerun recording, with the y axis down as in Rerun's plane views."""
    rerun = _package("rerun", "rerun")
    recording = rerun.RecordingStream("planopt")
    recording.save(path)
    rings = [
        shapely.get_coordinates(ring)
        for each in result.problem.workspace.obstacles
        for ring in (each.polygon.exterior, *each.polygon.interiors)
    ]
    recording.log("world/obstacles", rerun.LineStrips2D(_up(rings)), static=True)
    stations = result.problem.stations
    places = [np.array([each.position_m]) for each in stations]
    labels = [each.name for each in stations]
    recording.log(
        "world/stations", rerun.Points2D(np.vstack(_up(places)), labels=labels), static=True
    )
    for track in _tracks(result):
        driven = rerun.LineStrips2D(_up([track.positions_m]))
        recording.log(f"world/{track.robot}/driven", driven, static=True)
        for row, time_s in enumerate(track.t_s.tolist()):
            recording.set_time("time", duration=time_s)
            here = np.vstack(_up([track.positions_m[row : row + 1]]))
            recording.log(f"world/{track.robot}/position", rerun.Points2D(here))
            if row < len(track.plans):
                ahead = rerun.LineStrips2D(_up([track.plans[row].positions_m]))
                recording.log(f"world/{track.robot}/plan", ahead)
            for name, values in track.numbers.items():
                if math.isfinite(values[row]):
                    recording.log(f"link/{track.robot}/{name}", rerun.Scalars(float(values[row])))
    recording.flush()
    recording.disconnect()


def _up(lines_m: Sequence[Floats]) -> list[Floats]:
    """Return lines with the sign of y changed."""
    return [each * np.array([1.0, -1.0]) for each in lines_m]


def _package(name: str, extra: str) -> Any:
    """Return a module, or raise an InputError that names the extra if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"the package {name.partition('.')[0]} is not installed",
            remedy=f"pip install 'planopt[{extra}]'",
        ) from error


RECORDERS: dict[str, Callable[[Path, MotionResult], None]] = {
    ".mcap": write_mcap,
    ".rrd": write_rerun,
}
"""Writers of recordings by file extension."""


def save_recording(result: MotionResult, file: Path) -> None:
    """Write a solution or run to a recording in the format of its extension, atomically."""
    write = _writer_of(RECORDERS, file, "recordings")
    try:
        write_whole(file, lambda temporary: write(temporary, result))
    except InputError as error:
        raise error.located(file) from error.__cause__
