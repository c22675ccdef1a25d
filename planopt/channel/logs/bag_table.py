"""Messages of a recording (rosbag2, MCAP), and their table: powers joined by time with positions.

Positions come from odometry, poses, TF or GPS. Those in the frame ``map`` come
first, TF before poses before odometry, and GPS comes last.
"""

import io
import json
import math
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.logs.log_table import ALIASES, LogTable, fold
from planopt.errors import InputError
from planopt.files.reading import LARGEST_BINARY_BYTES, foreign_reader, read_bytes, require_size

NANOSECONDS = 1e9

ENDINGS = (".mcap", ".db3")  # Extensions of recordings

_HEADER = """std_msgs/Header header
"""
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/TransformStamped": (
        f"{_HEADER}string child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service",
}
STANDARD = {
    "nav_msgs/msg/Odometry": (
        f"{_HEADER}string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist"
    ),
    "geometry_msgs/msg/PoseStamped": f"{_HEADER}geometry_msgs/Pose pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        f"{_HEADER}geometry_msgs/PoseWithCovariance pose"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/msg/NavSatFix": (
        f"{_HEADER}sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type"
    ),
    **{
        f"std_msgs/msg/{name}": f"{name.lower()} data"
        for name in ("Float32", "Float64", "Int8", "Int16", "Int32", "Int64")
    },
}
"""Message definitions by type, without the definitions of nested types."""


@dataclass(frozen=True)
class Recorded:
    """Decoded message."""

    topic: str
    kind: str  # Type without its package
    time_s: float  # Time of recording
    content: Any


Wanted = Callable[[str, str, str], bool]
"""Function of topic, message type and definition that returns whether to decode messages."""


def is_recording(path: Path) -> bool:
    """Return whether a path is a recording: an MCAP file, a rosbag2 file or a rosbag2 folder."""
    if path.is_dir():
        return bool(_files_in(path))
    if path.suffix.lower() != ".db3":
        return path.suffix.lower() == ".mcap"
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as held:
            found = held.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    except sqlite3.Error:
        return False
    return {("topics",), ("messages",)} <= set(found)


def _files_in(folder: Path) -> list[Path]:
    return sorted(each for each in folder.iterdir() if each.suffix.lower() in ENDINGS)


def read_messages(path: Path, is_wanted: Wanted) -> Iterator[Recorded]:
    """Yield the messages of wanted topics in a recording file, or in all files of a folder."""
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise InputError(
            "recordings cannot be read without mcap-ros2-support",
            file=path,
            remedy="pip install 'planopt[ros]', or export the log as CSV",
        ) from None
    for file in _files_in(path) if path.is_dir() else [path]:
        read = _of_sqlite if file.suffix.lower() == ".db3" else _of_mcap
        with foreign_reader(file, "a recording"):
            yield from read(file, DecoderFactory(), is_wanted)


def _of_mcap(path: Path, factory: Any, is_wanted: Wanted) -> Iterator[Recorded]:
    from mcap.reader import make_reader

    reader = make_reader(io.BytesIO(read_bytes(path)))
    summary = reader.get_summary()
    for chunk in () if summary is None else summary.chunk_indexes:
        require_size("declares", chunk.uncompressed_size, LARGEST_BINARY_BYTES, path)
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    for schema, channel, message in reader.iter_messages():
        kind = _kind("" if schema is None else schema.name)
        if channel.id not in decoders:
            text = "" if schema is None else schema.data.decode(errors="replace")
            wanted = is_wanted(channel.topic, kind, text)
            decoders[channel.id] = (
                _decoder(factory, channel.message_encoding, schema) if wanted else None
            )
        decode = decoders[channel.id]
        if decode is not None:
            time_s = message.log_time / NANOSECONDS
            yield Recorded(channel.topic, kind, time_s, decode(message.data))


def _decoder(factory: Any, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    """Return the decoder of messages with an encoding and schema; None if it is unknown."""
    if encoding == "json":
        return lambda data: json.loads(data, object_hook=lambda table: SimpleNamespace(**table))
    return factory.decoder_for(encoding, schema)


def _of_sqlite(path: Path, factory: Any, is_wanted: Wanted) -> Iterator[Recorded]:
    from mcap.records import Schema

    connection = sqlite3.connect(":memory:")
    connection.deserialize(read_bytes(path))
    with closing(connection):
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        texts = dict(STANDARD)
        for kind, text in texts.items():
            texts[kind] = "\n".join(_with_parts(text))
        if "message_definitions" in tables:
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            texts |= {kind: text for kind, text in connection.execute(query) if text}
        for number, topic, kind in connection.execute("SELECT id, name, type FROM topics"):
            text = texts.get(kind, "")
            if not text or not is_wanted(topic, _kind(kind), text):
                continue
            schema = Schema(id=number, name=kind, encoding="ros2msg", data=text.encode())
            decode = factory.decoder_for("cdr", schema)
            query = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp"
            for time_ns, data in connection.execute(query, (number,)):
                yield Recorded(topic, _kind(kind), time_ns / NANOSECONDS, decode(data))


def _with_parts(text: str) -> Iterator[str]:
    """Yield a message definition, followed by the definitions of its component types."""
    yield text
    named = re.findall(r"^(\w+/\w+)", text, re.MULTILINE)
    done: list[str] = []
    while named:
        part = named.pop()
        if part not in done:
            done.append(part)
            named += re.findall(r"^(\w+/\w+)", _PARTS[part], re.MULTILINE)
            yield f"{'=' * 80}\nMSG: {part}\n{_PARTS[part]}"


def _kind(name: str) -> str:
    return re.split(r"[/.]", name)[-1]


LONGEST_GAP_S, STANDING_M = 5.0, 1.0
"""Positions are not interpolated over longer gaps (s) in which the robot moved farther (m)."""
IN_MAP = "map"  # Conventional name of the map frame (REP 105)
BASES = ("base_footprint", "base_link", "base")  # Conventional names of a robot's base frame

TRANSFORMS = "TFMessage"
POSES = ("PoseWithCovarianceStamped", "PoseStamped", "PoseInFrame", "Odometry")
FIXES = ("NavSatFix", "LocationFix")
PREFERRED = (TRANSFORMS, *POSES, *FIXES)  # Kinds of positions in order of preference
NOT_DRIVEN = re.compile("goal|initialpose|target|waypoint")
"""Topics with poses that are not the robot's."""

COLUMNS = ("stamp_s", "power_dbm", "transmitter", "topic")


@dataclass(frozen=True)
class _Track:
    """Positions over time from one source."""

    topic: str
    kind: str
    frame: str
    time_s: Floats  # (n,) ascending
    positions: Floats  # (n, 2) metres, or longitude and latitude

    @property
    def in_degrees(self) -> bool:
        return self.kind in FIXES

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Sort key of a track; the preferred track has the smallest key."""
        return self.in_degrees, self.frame != IN_MAP, PREFERRED.index(self.kind)

    def at(self, time_s: Floats) -> Floats:
        """Return interpolated positions; NaN outside the track and in its gaps."""
        found = _interpolated(time_s, self.time_s, self.positions)
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        gap_s = self.time_s[after] - self.time_s[after - 1]
        moved = np.linalg.norm(self.positions[after] - self.positions[after - 1], axis=1)
        lost = (gap_s > LONGEST_GAP_S) & ((moved > STANDING_M) | self.in_degrees)
        outside = (time_s < self.time_s[0]) | (time_s > self.time_s[-1])
        found[lost | outside] = np.nan
        return found


@dataclass(frozen=True)
class _Reading:
    time_s: float
    power: float
    transmitter: str
    topic: str


def read_recording(path: Path) -> LogTable:
    """Return the powers of a recording and the positions at the times of the powers."""
    messages = list(read_messages(path, _is_wanted))
    readings = [one for each in messages if each.kind not in PREFERRED for one in _powers(each)]
    tracks = sorted(_tracks(messages), key=lambda track: track.rank)
    for found, what in ((readings, "powers (rssi, signal_level, ...)"), (tracks, "positions")):
        if not found:
            seen = ", ".join(sorted({each.topic for each in messages})) or "none"
            raise InputError(
                f"has no topic with {what}; topics read: {seen}",
                file=path,
                remedy="record a pose, odometry, TF or GPS topic and one with the signal strength",
            )
    time_s = np.array([each.time_s for each in readings])
    placed = [_cells(track.at(time_s)) for track in tracks]
    names = list(COLUMNS)
    rows: list[tuple[int, list[str]]] = []
    for number, track in enumerate(tracks):
        head = "" if number == 0 else f"{track.topic}."
        axes = ("longitude", "latitude") if track.in_degrees else ("x", "y")
        names += [f"{head}{axis}" for axis in axes]
    for number, each in enumerate(readings):
        own = [repr(each.time_s), repr(each.power), each.transmitter, each.topic]
        rows.append((number + 1, own + [cell for cells in placed for cell in cells[number]]))
    return LogTable(path, tuple(names), rows, header_line=None)


def _cells(positions: Floats) -> list[list[str]]:
    return [["" if math.isnan(x) else repr(x) for x in pair] for pair in positions.tolist()]


def _is_wanted(topic: str, kind: str, definition: str) -> bool:
    """Return whether a topic could contain positions or powers."""
    if kind in PREFERRED:
        return NOT_DRIVEN.search(topic.lower()) is None
    words = {fold(word) for word in re.findall(r"\w+", definition)}
    return _power_name([*words]) is not None or _is_number(topic, words)


def _is_number(topic: str, words: set[str]) -> bool:
    """Return whether a topic has plain numbers and a name that denotes a power."""
    return "data" in words and _power_name(topic.split("/")) is not None


def _power_name(names: Sequence[str]) -> str | None:
    """Return the first of `names` that denotes a power, or None."""
    folded = {fold(name.rsplit(".", 1)[-1]): name for name in names}
    return next((folded[each] for each in ALIASES["power"] if each in folded), None)


def _powers(message: Recorded) -> Iterator[_Reading]:
    """Yield the powers in the fields of a message, and in each entry of its lists."""
    content = message.content
    lists: list[Any] = [value for _, value in _fields(content) if isinstance(value, list)]
    entries = [each for one in lists for each in one if isinstance(each, SimpleNamespace)]
    for entry in (content, *entries):
        fields = dict(_scalars(entry))
        name = _power_name(list(fields))
        if name is None and "data" in fields and _power_name(message.topic.split("/")):
            name = "data"
        if name is None or isinstance(fields[name], str):
            continue
        last = {fold(key.rsplit(".", 1)[-1]): str(value) for key, value in fields.items()}
        labels = (last[each] for each in ALIASES["transmitter"] if last.get(each))
        yield _Reading(
            message.time_s, float(fields[name]), next(labels, message.topic), message.topic
        )


def _scalars(value: Any, head: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of each number or text in a message, except in headers."""
    for name, each in _fields(value):
        if isinstance(each, int | float | str):
            yield head + name, each
        elif isinstance(each, SimpleNamespace) and name not in ("header", "stamp"):
            yield from _scalars(each, f"{head}{name}.")


def _fields(value: Any) -> list[tuple[str, Any]]:
    """Return the names and values of a decoded message's fields."""
    names = cast("Iterable[str]", getattr(value, "__slots__", None) or vars(value))
    return [(name, getattr(value, name)) for name in names]


def _tracks(messages: Sequence[Recorded]) -> Iterator[_Track]:
    """Yield all tracks with at least two positions."""
    places: dict[tuple[str, str, str], list[tuple[float, float, float]]] = {}
    for each in messages:
        content = each.content
        if each.kind in FIXES:
            x, y, frame = content.longitude, content.latitude, ""
            status = getattr(getattr(content, "status", None), "status", 0)
            if status < 0:
                continue
        elif each.kind in POSES:
            pose = getattr(content.pose, "pose", content.pose)
            x, y = pose.position.x, pose.position.y
            frame = getattr(content, "frame_id", "") or content.header.frame_id
        else:
            continue
        if math.isfinite(x) and math.isfinite(y):
            key = each.topic, each.kind, frame.lstrip("/")
            places.setdefault(key, []).append((each.time_s, x, y))
    for (topic, kind, frame), rows in places.items():
        if len(rows) > 1:
            table = np.array(sorted(rows))
            yield _Track(topic, kind, frame, table[:, 0], table[:, 1:])
    yield from _transformed([each for each in messages if each.kind == TRANSFORMS])


def _transformed(messages: Sequence[Recorded]) -> Iterator[_Track]:
    """Yield the positions of the robot's frame in the root frame of the transforms."""
    links: dict[str, tuple[str, list[list[float]]]] = {}
    for message in messages:
        for each in message.content.transforms:
            move, turn = each.transform.translation, each.transform.rotation
            numbers = [move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w]
            parent, child = (n.lstrip("/") for n in (each.header.frame_id, each.child_frame_id))
            links.setdefault(child, (parent, []))[1].append([message.time_s, *numbers])
    frame = next((base for base in BASES if base in links), None)
    chain: list[Floats] = []
    while frame in links and len(chain) < len(links):
        frame, rows = links[frame]
        chain.append(np.array(sorted(rows)))
    moving = [table[:, 0] for table in chain if len(table) > 1]
    if frame is None or not moving:
        return
    time_s = np.unique(np.concatenate(moving))
    time_s = time_s[time_s >= max(table[0, 0] for table in chain if len(table) > 1)]
    place = np.zeros((len(time_s), 3))
    for table in chain:
        found = _interpolated(time_s, table[:, 0], table[:, 1:])
        # Quaternions of any norm
        turn = found[:, 3:] / np.linalg.norm(found[:, 3:], axis=1, keepdims=True)
        twice = 2.0 * np.cross(turn[:, :3], place)
        rotated = place + turn[:, 3:] * twice + np.cross(turn[:, :3], twice)
        place = found[:, :3] + rotated
    if len(time_s) > 1:
        yield _Track("/tf", TRANSFORMS, frame, time_s, place[:, :2])


def _interpolated(time_s: Floats, times_s: Floats, values: Floats) -> Floats:
    """Return values (n, k) interpolated at `time_s`, component by component."""
    # Quaternions of opposite sign are the same rotation.
    if values.shape[1] > 4:
        flipped: Mask = np.sum(values[1:, 3:] * values[:-1, 3:], axis=1) < 0.0
        values = values.copy()
        values[1:, 3:] *= np.where(np.cumsum(flipped) % 2, -1.0, 1.0)[:, None]
    columns: list[Floats] = [np.interp(time_s, times_s, column) for column in values.T]
    return np.column_stack(columns)
