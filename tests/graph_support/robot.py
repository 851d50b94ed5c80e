"""A small robot in plain rclpy, driven by a test: it senses, drives, grips and navigates."""

import math
from pathlib import Path
from typing import Any

from geometry_msgs.msg import Twist
from humanopts_interfaces.action import ExecuteOption
from humanopts_ros.qos import LATCHED
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, Empty
from std_srvs.srv import SetBool

from graph_support.live import Graph

PERIOD = 0.05  # s between messages of its sensors
WORLD_FILE = """
name: scout
step: 0.2
topics:
  odom: {topic: /odom, type: nav_msgs/msg/Odometry, stale: 0.5}
  scan: {topic: /scan, type: sensor_msgs/msg/LaserScan, stale: 0.5}
  holds: {topic: /holds, type: std_msgs/msg/Bool, latched: yes}
places:
  charger: {x: 7, y: 0}
features:
  x: {field: odom.pose.pose.position.x, question: how far east it is, unit: m, range: [0, 8]}
  charger: {distance_to: charger, pose: odom, question: how far the charger is, range: [0, 9]}
  ahead: {scan_min: scan, sector: [-20, 20], question: what is ahead, range: [0, 5], clip: yes}
  holding: {field: holds.data, values: [no, yes], question: whether it holds something}
actions:
  forward: {key: up, twist: {linear: 0.5}}
  back: {key: down, twist: {linear: -0.5}}
  wait: {key: ., idle: yes, twist: {}}
  go: {key: g, seconds: 2, action: /go, type: humanopts_interfaces/action/ExecuteOption,
       goal: {option_name: charger, max_steps: 7}}
  grip: {key: c, seconds: 1, settle: 0.2, service: /grip, type: std_srvs/srv/SetBool,
         request: {data: yes}}
  beep: {key: b, seconds: 0, topic: /beep, type: std_msgs/msg/Empty}
reward: {step: -1}
ends: [{when: charger < 0.3, reward: 5}]
safety: {emergency: /emergency_stop}
"""


class Robot:
    """
    A robot on a line, from x = 0 to 8 m. It stops if no velocity arrives for 0.25 s.

    :ivar twists: the velocities that it received, m/s.
    :ivar silent: topics on which it does not publish now.
    :ivar blind: whether a range of the scan is NaN.
    :ivar accepts: whether the action server accepts goals; None: it never answers.
    :ivar goals: the goals that it accepted, as goal handles.
    :ivar ended: the outcome of the goal under way; to be set.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph, node = graph, graph.node
        self.x, self.speed, self.heard = 2.0, 0.0, 0.0
        self.twists: list[float] = []
        self.silent: set[str] = set()
        self.blind = False
        self.accepts: bool | None = True
        self.goals: list[Any] = []
        self.canceled, self.beeps = 0, 0
        self.ended = Future()
        self.grips = True
        self._odom = node.create_publisher(Odometry, '/odom', 5)
        self._scan = node.create_publisher(LaserScan, '/scan', 5)
        self._holds = node.create_publisher(Bool, '/holds', LATCHED)
        self._holds.publish(Bool(data=False))
        node.create_subscription(Twist, '/cmd_vel', self._on_twist, 10)
        node.create_subscription(Empty, '/beep', self._on_beep, 10)
        node.create_service(SetBool, '/grip', self._on_grip)
        self._server = ActionServer(
            node,
            ExecuteOption,
            '/go',
            self._go,
            goal_callback=self._on_goal,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),  # it moves while it does not answer
        )
        node.create_timer(PERIOD, self._move)

    def hold(self, something: bool) -> None:
        """Put something between its fingers, or take it out."""
        self._holds.publish(Bool(data=something))

    def file(self, text: str = WORLD_FILE) -> Path:
        """Write its world file, and return its path."""
        path = self.graph.folder / 'scout.yaml'
        path.write_text(text)
        return path

    @property
    def stands(self) -> bool:
        """Whether its last velocity is zero."""
        return not self.twists or self.twists[-1] == 0

    def _now(self) -> float:
        return self.graph.node.get_clock().now().nanoseconds * 1e-9

    def _on_twist(self, twist: Twist) -> None:
        self.twists.append(twist.linear.x)
        self.speed, self.heard = twist.linear.x, self._now()

    def _move(self) -> None:
        if self._now() - self.heard > 0.25:
            self.speed = 0.0
        self.x = min(max(self.x + self.speed * PERIOD, 0.0), 9.0)
        odom = Odometry()
        odom.pose.pose.position.x = self.x
        if 'odom' not in self.silent:
            self._odom.publish(odom)
        scan = LaserScan(angle_min=-math.pi, angle_increment=math.pi / 4, range_max=10.0)
        scan.ranges = [math.nan if self.blind else max(8.0 - self.x, 0.1)] * 8
        if 'scan' not in self.silent:
            self._scan.publish(scan)

    def _on_beep(self, _: Empty) -> None:
        self.beeps += 1

    def _on_grip(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = self.grips
        response.message = '' if self.grips else 'nothing is between the fingers'
        self._holds.publish(Bool(data=request.data and self.grips))
        return response

    async def _on_goal(self, _: Any) -> GoalResponse:
        if self.accepts is None:
            await Future()
        return GoalResponse.ACCEPT if self.accepts else GoalResponse.REJECT

    def _on_cancel(self, _: Any) -> CancelResponse:
        self.canceled += 1
        self.ended.set_result('canceled')
        return CancelResponse.ACCEPT

    async def _go(self, handle: Any) -> ExecuteOption.Result:
        self.goals.append(handle)
        self.ended = Future()
        handle.publish_feedback(ExecuteOption.Feedback(step_count=3))
        getattr(handle, await self.ended)()
        return ExecuteOption.Result()
