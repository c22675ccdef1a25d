"""ROS 2 node around `planopt.Planner`: paths that keep contact, masks for Nav2, return to contact.

| name | type | content |
|---|---|---|
| `pose` (in) | geometry_msgs/PoseWithCovarianceStamped | position of the robot in the map's frame |
| `signal_strength/STATION` (in) | std_msgs/Float32 | received power in dBm, one topic per station |
| `contact_path` (out) | nav_msgs/Path | plan of the step, times as stamps |
| `keepout_mask`, `weighted_mask` (out) | nav_msgs/OccupancyGrid | masks for Nav2, latched |
| `return_to_contact` (service) | std_srvs/Trigger | drive towards contact until it is regained |

Parameters: `problem` (file of `planopt import`), `mask_every` (steps between masks, 0 for none),
`keepout_below` (probability of connection), `cell_m` (side of a mask's cell), `budget_s` (time of a
plan). A plan is made every `planner.step_s` seconds of the problem, for one robot in the plane.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

import planopt
from planopt.channel import serving_map
from planopt.objectives import TermsObjective, UntilConnectedTerm

HEAVIEST = 99
"""Largest value of the weighted mask; 100 would be an obstacle."""


class ContactNode(Node):
    """Node that plans one step after another."""

    def __init__(self) -> None:
        super().__init__("planopt_contact")
        self._problem = planopt.load(self.declare_parameter("problem", "").value)
        self._mask_every = self.declare_parameter("mask_every", 10).value
        self._keepout_below = self.declare_parameter("keepout_below", 0.1).value
        self._cell_m = self.declare_parameter("cell_m", 1.0).value
        self._budget_s = self.declare_parameter("budget_s", 0.5).value
        self._planner = planopt.Planner(self._problem, budget_s=self._budget_s)
        self._is_returning = False
        self._frame, self._position_m, self._steps = "map", None, 0
        stations = self._problem.stations
        self._readings: list[list[tuple[float, float, float]]] = [[] for _ in stations]
        self.create_subscription(PoseWithCovarianceStamped, "pose", self._on_pose, 10)
        for number, station in enumerate(stations):
            name = re.sub(r"\W", "_", station.name)
            heard = partial(self._on_power, number)
            self.create_subscription(Float32, f"signal_strength/{name}", heard, 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._path = self.create_publisher(Path, "contact_path", 1)
        self._masks = {
            name: self.create_publisher(OccupancyGrid, f"{name}_mask", latched)
            for name in ("keepout", "weighted")
        }
        self.create_service(Trigger, "return_to_contact", self._on_return)
        self.create_timer(self._problem.planner.step_s, self._on_timer)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        self._frame = message.header.frame_id or self._frame
        position = message.pose.pose.position
        self._position_m = (position.x, position.y)

    def _on_power(self, station: int, message: Float32) -> None:
        """Take a reading at the last pose; without one, or with NaN, it is dropped."""
        if self._position_m is not None and math.isfinite(message.data):
            self._readings[station].append((*self._position_m, message.data))

    def _on_timer(self) -> None:
        """Plan the next step, and publish it."""
        if self._position_m is None:
            return
        readings, self._readings = self._readings, [[] for _ in self._readings]
        if self._is_returning and self._is_connected(readings):
            self.get_logger().info("contact regained")
            self._replan(is_returning=False)
        self._step(readings)

    def _step(self, readings: Sequence[Sequence[tuple[float, float, float]]]) -> str:
        """Publish the plan from the last pose, and return its verdict."""
        tables = [
            dict(zip(("x_m", "y_m", "power_dbm"), np.reshape(each, (-1, 3)).T, strict=True))
            for each in readings
        ]
        try:
            plan = self._planner.step(self._position_m, tables)
        except planopt.PlanoptError as error:
            # An empty path tells the controller to stop.
            self.get_logger().error(str(error))
            self._publish_path(np.zeros(0), np.zeros((0, 2)))
            return "none"
        if plan.verdict is not planopt.Verdict.VERIFIED:
            self.get_logger().warning(f"plan is {plan.verdict.value}: {plan.message}")
        self._publish_path(plan.t_s, plan.positions_m)
        if self._mask_every and self._steps % self._mask_every == 0:
            self._publish_masks()
        self._steps += 1
        return plan.verdict.value

    def _on_return(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Search for contact from here until a reading reaches a station's threshold."""
        if self._position_m is None:
            response.success, response.message = False, "no pose has been received"
            return response
        self._replan(is_returning=True)
        verdict = self._step([[] for _ in self._readings])
        response.success = verdict != "none"
        response.message = f"plan towards contact: {verdict}"
        return response

    def _replan(self, *, is_returning: bool) -> None:
        """Make the planner to the goal, or to contact, with all that has been measured."""
        problem = self._problem
        robot = replace(problem.robots[0], start_m=self._position_m)
        if is_returning:
            problem = replace(
                problem,
                objective=TermsObjective((UntilConnectedTerm(),)),
                robots=(replace(robot, goal_m=None),),
                constraints=replace(problem.constraints, p_min=0.0),
            )
        measured = [each.measurements for each in self._planner.beliefs[0].posteriors]
        self._planner = planopt.Planner(problem, measurements=measured, budget_s=self._budget_s)
        self._is_returning = is_returning

    def _is_connected(self, readings: Sequence[Sequence[tuple[float, float, float]]]) -> bool:
        """Return whether the latest reading of some station reaches its threshold."""
        pairs = zip(readings, self._problem.stations, strict=True)
        return any(each[-1][2] >= station.threshold_dbm for each, station in pairs if each)

    def _publish_path(self, t_s: np.ndarray, positions_m: np.ndarray) -> None:
        path = Path()
        path.header.frame_id = self._frame
        now = self.get_clock().now()
        path.header.stamp = now.to_msg()
        heading = 0.0
        for number, ((x, y), time) in enumerate(zip(positions_m, t_s, strict=True)):
            if number + 1 < len(positions_m):
                ahead = positions_m[number + 1] - positions_m[number]
                heading = math.atan2(ahead[1], ahead[0]) if ahead.any() else heading
            pose = PoseStamped()
            pose.header.frame_id = self._frame
            pose.header.stamp = (now + Duration(seconds=float(time))).to_msg()
            pose.pose.position.x, pose.pose.position.y = float(x), float(y)
            pose.pose.orientation.z = math.sin(heading / 2.0)
            pose.pose.orientation.w = math.cos(heading / 2.0)
            path.poses.append(pose)
        self._path.publish(path)

    def _publish_masks(self) -> None:
        """Publish the masks of the current channel estimate."""
        problem = self._problem
        maps = serving_map(
            self._planner.beliefs[0].posteriors,
            problem.workspace.bounds_m,
            self._cell_m,
            [station.threshold_dbm for station in problem.stations],
        ).connectivity
        values = {
            "keepout": np.where(maps.values < self._keepout_below, 100, 0),
            "weighted": np.minimum(np.rint(100.0 * (1.0 - maps.values)), HEAVIEST),
        }
        for name, cells in values.items():
            grid = OccupancyGrid()
            grid.header.frame_id = self._frame
            grid.header.stamp = self.get_clock().now().to_msg()
            grid.info.resolution = self._cell_m
            grid.info.height, grid.info.width = cells.shape
            corner = grid.info.origin
            corner.position.x = float(maps.x_m[0]) - self._cell_m / 2.0
            corner.position.y = float(maps.y_m[0]) - self._cell_m / 2.0
            corner.orientation.w = 1.0
            grid.data = cells.astype(int).ravel().tolist()
            self._masks[name].publish(grid)


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    node = ContactNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
