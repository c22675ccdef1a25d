"""The example node for ROS 2, with stand-ins for rclpy and the messages."""

import importlib
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import planopt

FOLDER = Path(__file__).parents[1] / "examples" / "ros2"


class Message:
    """Message whose fields exist as soon as they are used; ``poses`` is a list."""

    def __init__(self) -> None:
        self.poses: list = []

    def __getattr__(self, name: str) -> "Message":
        self.__dict__[name] = Message()
        return self.__dict__[name]


class Time:
    """Time in seconds."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __add__(self, other: "Time") -> "Time":
        return Time(self.seconds + other.seconds)

    def to_msg(self) -> float:
        return self.seconds


class Node:
    """Stand-in for rclpy's node: records what is declared and published."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name: str) -> None:
        self.heard, self.services, self.timers = {}, {}, []
        self.sent: dict[str, list] = defaultdict(list)
        self.logged: list[str] = []

    def declare_parameter(self, name: str, value: object) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters.get(name, value))

    def create_subscription(self, kind: type, topic: str, call: object, qos: object) -> None:
        self.heard[topic] = call

    def create_publisher(self, kind: type, topic: str, qos: object) -> SimpleNamespace:
        return SimpleNamespace(publish=self.sent[topic].append)

    def create_service(self, kind: type, name: str, call: object) -> None:
        self.services[name] = call

    def create_timer(self, period: float, call: object) -> None:
        self.timers.append((period, call))

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: Time(100.0))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(**dict.fromkeys(("info", "warning", "error"), self.logged.append))


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """The node on a copy of a library problem."""
    names = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.duration": {"Duration": Time},
        "rclpy.qos": {
            "QoSProfile": SimpleNamespace,
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1),
        },
        "geometry_msgs.msg": {"PoseStamped": Message, "PoseWithCovarianceStamped": Message},
        "nav_msgs.msg": {"OccupancyGrid": Message, "Path": Message},
        "std_msgs.msg": {"Float32": Message},
        "std_srvs.srv": {"Trigger": SimpleNamespace(Request=Message, Response=Message)},
    }
    for name, content in names.items():
        for module in (name.split(".")[0], name):
            monkeypatch.setitem(sys.modules, module, ModuleType(module))
        vars(sys.modules[name]).update(content)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.delitem(sys.modules, "planopt_contact.contact_node", raising=False)
    field = planopt.load("open_field")
    channel = replace(field.channel, measure_spacing_m=0.1)
    replace(field, channel=channel).save(tmp_path / "field.toml")
    settings = {"problem": str(tmp_path / "field.toml"), "mask_every": 2, "cell_m": 4.0}
    monkeypatch.setattr(Node, "parameters", {**settings, "budget_s": 5.0})
    yield importlib.import_module("planopt_contact.contact_node").ContactNode()
    monkeypatch.delitem(sys.modules, "planopt_contact.contact_node")


def pose_at(x: float, y: float) -> Message:
    message = Message()
    message.header.frame_id = "map"
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    return message


def power_of(dbm: float) -> Message:
    message = Message()
    message.data = dbm
    return message


def places_of(path: Message) -> np.ndarray:
    return np.array([(each.pose.position.x, each.pose.position.y) for each in path.poses])


def test_drives_to_the_goal(node) -> None:
    """Paths start at the pose, have times and readings, and lead nearer to the goal."""
    problem = planopt.load("open_field")
    ((period, tick),) = node.timers
    assert period == problem.planner.step_s
    tick()
    assert not node.sent["contact_path"]  # no pose yet
    here = np.array(problem.robots[0].start_m)
    for _ in range(4):
        node.heard["pose"](pose_at(*here))
        node.heard["signal_strength/base"](power_of(-50.0))
        node.heard["signal_strength/base"](power_of(float("nan")))
        tick()
        path = node.sent["contact_path"][-1]
        places = places_of(path)
        np.testing.assert_allclose(places[0], here, atol=1e-6)
        stamps = [each.header.stamp for each in path.poses]
        np.testing.assert_allclose(np.diff(stamps), problem.planner.step_s)
        ahead = places[1] - places[0]
        turn = path.poses[0].pose.orientation
        assert 2.0 * np.arctan2(turn.z, turn.w) == pytest.approx(np.arctan2(ahead[1], ahead[0]))
        here = places[1]
    assert node.logged == []
    assert len(node._planner.beliefs[0].posterior.measurements) == 120 + 4
    assert len(node.sent["keepout_mask"]) == len(node.sent["weighted_mask"]) == 2


def test_masks(node) -> None:
    """Cells from the lower left corner, from 0 to 100, as the channel estimate predicts."""
    node.heard["pose"](pose_at(32.0, 30.0))
    node.timers[0][1]()
    (mask,) = node.sent["weighted_mask"]
    info = mask.info
    assert (info.width, info.height, info.resolution) == (30, 25, 4.0)
    assert (info.origin.position.x, info.origin.position.y) == (0.0, 0.0)
    x, y = np.meshgrid(2.0 + 4.0 * np.arange(30), 2.0 + 4.0 * np.arange(25))
    posterior = node._planner.beliefs[0].posterior
    chance = posterior.connectivity(np.stack([x.ravel(), y.ravel()], axis=1), -59.0)
    np.testing.assert_array_equal(mask.data, np.minimum(np.rint(100.0 * (1.0 - chance)), 99))
    np.testing.assert_array_equal(node.sent["keepout_mask"][0].data, 100 * (chance < 0.1))


def test_returns_to_contact(node) -> None:
    """The service plans until a reading reaches the threshold; then the goal is planned again."""
    response = node.services["return_to_contact"](None, Message())
    assert response.success is False
    node.heard["pose"](pose_at(100.0, 95.0))
    node.heard["signal_strength/base"](power_of(-75.0))
    node.timers[0][1]()
    response = node.services["return_to_contact"](None, Message())
    assert response.success and "verified" in response.message
    assert node._planner.problem.task == "connect"
    end = places_of(node.sent["contact_path"][-1])[-1]
    base = np.array((60.0, 8.0))
    assert np.linalg.norm(end - base) < np.linalg.norm((100.0, 95.0) - base)
    node.heard["pose"](pose_at(*end))
    node.heard["signal_strength/base"](power_of(-55.0))
    node.timers[0][1]()
    assert node._planner.problem.task == "reach" and "contact regained" in node.logged
    assert np.allclose(node._planner.beliefs[0].posterior.measurements.positions_m[-1], end)


def test_a_pose_in_an_obstacle_stops_the_robot(node) -> None:
    """An error is logged, and the path is empty."""
    node.heard["pose"](pose_at(1000.0, 1000.0))
    node.timers[0][1]()
    assert node.sent["contact_path"][-1].poses == [] and "outside" in node.logged[0]
