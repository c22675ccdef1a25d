"""Recordings of robots: written by the library of the format, or after rosbag2's tables."""

import io
import json
import sqlite3
from pathlib import Path
from types import SimpleNamespace as Part

import numpy as np
import pytest

mcap_ros2 = pytest.importorskip("mcap_ros2.writer")

from mcap.writer import Writer  # noqa: E402

from planopt import InputError  # noqa: E402
from planopt.channel import LogFormat, read_log  # noqa: E402
from planopt.channel.logs.bag_table import STANDARD, _with_parts  # noqa: E402
from planopt.channel.logs.power_log import read_power_log, transmitters_of  # noqa: E402
from planopt.cli import main  # noqa: E402

WIFI = "wifi_msgs/msg/Scan", "string bssid\nint32 rssi"
SCAN = (
    "wifi_msgs/msg/Networks",
    "wifi_msgs/Network[] networks\n" + "=" * 80 + "\nMSG: wifi_msgs/Network\n" + WIFI[1],
)
SECOND = 1_000_000_000
SPEED = 0.5  # m/s along x
TIMES = np.arange(0.0, 20.0, 0.1)
HEARD = np.arange(0.25, 18.0, 1.0)


def header(frame: str) -> Part:
    return Part(stamp=Part(sec=0, nanosec=0), frame_id=frame)


def pose(x: float, y: float) -> Part:
    turn = Part(x=0.0, y=0.0, z=0.0, w=1.0)
    return Part(position=Part(x=x, y=y, z=0.0), orientation=turn)


def odometry(x: float, y: float) -> Part:
    zero = Part(x=0.0, y=0.0, z=0.0)
    twist = Part(twist=Part(linear=zero, angular=zero), covariance=[0.0] * 36)
    at = Part(pose=pose(x, y), covariance=[0.0] * 36)
    return Part(header=header("odom"), child_frame_id="base_link", pose=at, twist=twist)


def fix(latitude: float, longitude: float) -> Part:
    return Part(
        header=header("gps"),
        status=Part(status=0, service=1),
        latitude=latitude,
        longitude=longitude,
        altitude=0.0,
        position_covariance=[0.0] * 9,
        position_covariance_type=0,
    )


def link(parent: str, child: str, x: float, y: float, yaw: float) -> Part:
    turn = Part(x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2))
    move = Part(translation=Part(x=x, y=y, z=0.0), rotation=turn)
    return Part(header=header(parent), child_frame_id=child, transform=move)


def definition(kind: str) -> str:
    return "\n".join(_with_parts(STANDARD[kind]))


def heard(power: float, name: str = "ap") -> Part:
    return Part(bssid=name, rssi=round(power))


Message = tuple[str, str, str, float, Part]
"""Topic, type, definition, time and content."""


def drive(with_tf: bool = False) -> list[Message]:
    """Odometry along x, and readings between its messages; the map is turned by 90 degrees."""
    odom = "nav_msgs/msg/Odometry"
    found: list[Message] = [
        ("/odom", odom, definition(odom), t, odometry(SPEED * t, 2.0)) for t in TIMES
    ]
    found += [("/wifi", *WIFI, t, heard(-50.0 - t)) for t in HEARD]
    if with_tf:
        tf = "tf2_msgs/msg/TFMessage"
        static = Part(transforms=[link("map", "odom", 10.0, 20.0, np.pi / 2)])
        found.append(("/tf_static", tf, definition(tf), 0.0, static))
        for t in TIMES:
            moved = Part(transforms=[link("odom", "base_link", SPEED * t, 2.0, 0.3)])
            found.append(("/tf", tf, definition(tf), t, moved))
    return found


def written(path: Path, messages: list[Message]) -> Path:
    with path.open("wb") as stream:
        writer = mcap_ros2.Writer(stream)
        kinds = {kind: text for _, kind, text, _, _ in messages}
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in kinds.items()}
        for topic, kind, _, time_s, content in messages:
            writer.write_message(topic, schemas[kind], content, round(time_s * SECOND))
        writer.finish()
    return path


def stored(path: Path, messages: list[Message], with_definitions: bool) -> Path:
    """A rosbag2 SQLite file, with the CDR messages of the library."""
    from mcap.reader import make_reader

    content = written(path.with_suffix(".mcap"), messages).read_bytes()
    path.with_suffix(".mcap").unlink()
    base = sqlite3.connect(path)
    base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, format TEXT)")
    base.execute(
        "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    )
    if with_definitions:
        base.execute(
            "CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, "
            "encoded_message_definition TEXT)"
        )
    topics: dict[str, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages():
        assert schema is not None
        if channel.topic not in topics:
            topics[channel.topic] = len(topics) + 1
            row = (topics[channel.topic], channel.topic, schema.name, "cdr")
            base.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
            if with_definitions:
                row = (schema.name, "ros2msg", schema.data.decode())
                base.execute("INSERT INTO message_definitions VALUES (?, ?, ?)", row)
        row = (0, topics[channel.topic], message.log_time, message.data)
        base.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
    base.commit()
    base.close()
    return path


def test_odometry_is_interpolated(tmp_path: Path) -> None:
    """Positions at the times of the readings, from MCAP, SQLite and the folder of a bag."""
    sources = [
        written(tmp_path / "a.mcap", drive()),
        stored(tmp_path / "b.db3", drive(), with_definitions=True),
    ]
    folder = tmp_path / "bag"
    folder.mkdir()
    sources.append(written(folder / "bag_0.mcap", drive()).parent)
    for source in sources:
        log = read_power_log(source)
        found = log.measurements
        assert log.columns.reader_name == "recording"
        np.testing.assert_allclose(found.positions_m[:, 0], SPEED * HEARD, atol=1e-9)
        np.testing.assert_array_equal(found.positions_m[:, 1], 2.0)
        np.testing.assert_array_equal(found.power_dbm, np.round(-50.0 - HEARD))
        np.testing.assert_allclose(np.diff(found.time_s), 1.0)
        assert transmitters_of(source, "transmitter") == {"ap": len(HEARD)}


def test_transforms_come_first(tmp_path: Path) -> None:
    """The robot in the frame map: 90 degrees turn east into north. Odometry can be chosen."""
    source = written(tmp_path / "tf.mcap", drive(with_tf=True))
    expected = np.column_stack([10.0 - 2.0 * np.ones(len(HEARD)), 20.0 + SPEED * HEARD])
    np.testing.assert_allclose(read_log(source).positions_m, expected, atol=1e-9)
    by_odometry = read_log(source, LogFormat(columns=("/odom.x", "/odom.y", None)))
    np.testing.assert_allclose(by_odometry.positions_m[:, 0], SPEED * HEARD, atol=1e-9)


def test_scans_gaps_and_goals(tmp_path: Path) -> None:
    """Each network of a scan is a reading; a goal is no position; a gap has no positions."""
    kind = "geometry_msgs/msg/PoseStamped"
    text = definition(kind)
    messages: list[Message] = [
        ("/goal_pose", kind, text, t, Part(header=header("map"), pose=pose(99.0, 99.0)))
        for t in (0.0, 19.0)
    ]
    messages += [
        ("/pose", kind, text, t, Part(header=header("map"), pose=pose(t, 0.0)))
        for t in (0.0, 1.0, 2.0, 12.0, 13.0)
    ]
    for t in (0.5, 1.5, 6.0, 12.5, 30.0):
        networks = [heard(-50.0, "one"), heard(-60.0, "two")]
        messages.append(("/scan", *SCAN, t, Part(networks=networks)))
    source = written(tmp_path / "scan.mcap", messages)
    log = read_log(source, LogFormat(where=(("transmitter", "two"),)))
    np.testing.assert_allclose(log.positions_m[:, 0], [0.5, 1.5, 12.5])
    np.testing.assert_array_equal(log.power_dbm, -60.0)


def test_old_bags_of_standard_messages(tmp_path: Path) -> None:
    """Without definitions, a number is a power by the name of its topic; GPS needs an origin."""
    number, gps = "std_msgs/msg/Float32", "sensor_msgs/msg/NavSatFix"
    north = np.linspace(48.1374, 48.1383, 20)
    messages: list[Message] = [
        ("/fix", gps, definition(gps), float(t), fix(north[t], 11.5755)) for t in range(20)
    ]
    messages += [
        ("/wifi/rssi", number, definition(number), t + 0.5, Part(data=-40.0 - t)) for t in range(19)
    ]
    source = stored(tmp_path / "old.db3", messages, with_definitions=False)
    log = read_log(source, LogFormat(origin_deg=(48.1374, 11.5755)))
    np.testing.assert_allclose(log.positions_m[:, 0], 0.0, atol=1e-6)
    np.testing.assert_allclose(log.positions_m[[0, -1], 1], [2.63, 97.44], atol=0.02)
    with pytest.raises(InputError, match="in degrees"):
        read_log(source)


def test_foxglove_json(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name, topic, contents in (
            ("foxglove.PoseInFrame", "/pose", [{"frame_id": "map", "pose": None} for _ in TIMES]),
            ("Signal", "/signal", [{"signal_strength": -60.5, "ap": "x"} for _ in HEARD]),
        ):
            fields = {key: {} for key in contents[0]}
            schema = writer.register_schema(
                name, "jsonschema", json.dumps({"properties": fields}).encode()
            )
            channel = writer.register_channel(topic, "json", schema)
            for t, each in zip(TIMES if topic == "/pose" else HEARD, contents, strict=True):
                if topic == "/pose":
                    each["pose"] = {"position": {"x": float(t), "y": 1.0, "z": 0.0}}
                time_ns = round(t * SECOND)
                writer.add_message(channel, time_ns, json.dumps(each).encode(), time_ns)
        writer.finish()
    log = read_log(path)
    np.testing.assert_allclose(log.positions_m[:, 0], HEARD, atol=1e-9)
    np.testing.assert_array_equal(log.power_dbm, -60.5)


def test_fit_takes_a_recording(tmp_path: Path, capsys) -> None:
    """The command, and messages for recordings without powers and for damaged ones."""
    source = written(tmp_path / "a.mcap", drive())
    assert main(["fit", str(source), "--station", "0,5", "--json"]) in (0, 3)
    assert json.loads(capsys.readouterr().out)["measurements"] == len(HEARD)
    silent = written(tmp_path / "silent.mcap", [m for m in drive() if m[0] == "/odom"])
    with pytest.raises(InputError, match="no topic with powers"):
        read_log(silent)
    content = source.read_bytes()
    for damaged in (content[:200], content[: len(content) // 2], b"", b"\x89MCAP0\r\n" * 9):
        source.write_bytes(damaged)
        with pytest.raises(InputError):
            read_log(source)
    other = tmp_path / "other.db3"
    other.write_bytes(b"SQLite format 3\0" + bytes(99))
    with pytest.raises(InputError):
        read_log(other)
