"""Messages of rosbag2 recordings (SQLite and MCAP) and of other MCAP files with JSON."""

import io
import json
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from planopt.errors import InputError
from planopt.files.reading import LARGEST_BINARY_BYTES, foreign_reader, read_bytes, require_size

NANOSECONDS = 1e9

ENDINGS = (".mcap", ".db3")
"""Extensions of recordings."""

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
    """Yield the messages of the wanted topics of a recording, or of all files in its folder."""
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
    """Return the decoder of a channel's messages; None if their encoding is unknown."""
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
