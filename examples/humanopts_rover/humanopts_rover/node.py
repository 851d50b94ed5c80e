"""
The node ``rover``: a typical robot driver in plain ROS 2.

Publishes ``odom``, ``scan``, ``battery``, ``waypoint/PLACE`` (the next corner of the path there),
``doors/DOOR`` and, with tf2_msgs, ``/tf``. Obeys each command on ``cmd_vel`` for 0.25 s, and the
action ``drive_to``. The services ``doors/DOOR/set`` and ``carry_somewhere`` and the topic
``carry_to`` act as people's hands.
"""

import math
import time
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, Twist
from humanopts_rover import messages
from humanopts_rover.driving import drive
from humanopts_rover.simulation import DOORS, PLACES, Pose, Simulation, TICK
from humanopts_rover_interfaces.action import DriveTo
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None

COMMAND_TIMEOUT = 0.25  # s of simulated time for which a command is obeyed
SENSORS_EVERY, WAYS_EVERY, SLOW_EVERY = 2, 4, 10  # ticks of TICK s between messages
STUCK = 5.0  # s without progress after which a goal is aborted
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FAULTS = {
    'scan_fault': ('none', 'stopped', 'nan'),
    'odom_fault': ('none', 'stopped', 'nan'),
    'drive_to_fault': ('none', 'no_answer', 'no_result'),
}


class Goal:
    """An active goal of ``drive_to``."""

    def __init__(self, handle: ServerGoalHandle, now: float) -> None:
        at = handle.request.pose.pose
        self.handle = handle
        self.pose = Pose(at.position.x, at.position.y, messages.yaw_of(at.orientation))
        self.closest, self.since = math.inf, now


class Rover(Node):
    """Step the simulation by a timer, publish the measurements, and execute commands."""

    def __init__(self, **options: Any) -> None:
        super().__init__('rover', **options)
        fixed = ParameterDescriptor(read_only=True)
        seed = self.declare_parameter('seed', 0, fixed).value
        noise = self.declare_parameter('noise', True, fixed).value
        speed = self.declare_parameter('speed', 1.0, fixed).value
        # Whether to publish /clock, which is needed at any speed other than 1.
        self._has_clock = self.declare_parameter('clock', speed != 1.0, fixed).value
        for name in FAULTS:
            self.declare_parameter(name, 'none')
        self.add_on_set_parameters_callback(self._check)
        self.rover = Simulation(seed, noise=noise)
        self._ticks, self._now = 0, 0.0 if self._has_clock else time.time()
        self._last = time.monotonic()
        self._command, self._commanded = Twist(), -math.inf
        self._goal: Goal | None = None
        self._out = {
            'odom': self.create_publisher(Odometry, 'odom', 10),
            'scan': self.create_publisher(LaserScan, 'scan', 10),
            'battery': self.create_publisher(BatteryState, 'battery', 10),
            **{
                f'waypoint/{p}': self.create_publisher(PointStamped, f'waypoint/{p}', 10)
                for p in PLACES
            },
            **{f'doors/{d}': self.create_publisher(Bool, f'doors/{d}', LATCHED) for d in DOORS},
        }
        if self._has_clock:
            self._out['/clock'] = self.create_publisher(Clock, '/clock', 10)
        if TFMessage:
            self._out['/tf'] = self.create_publisher(TFMessage, '/tf', 100)
            self._out['/tf_static'] = self.create_publisher(TFMessage, '/tf_static', LATCHED)
            mount = TransformStamped(header=messages.stamped(self._now, messages.BASE))
            mount.child_frame_id, mount.transform.translation.z = messages.LASER, 0.2
            self._out['/tf_static'].publish(TFMessage(transforms=[mount]))
        self.create_subscription(Twist, 'cmd_vel', self._obey, 10)
        self.create_subscription(PoseStamped, 'carry_to', self._carry_to, 10)
        self.create_service(Trigger, 'carry_somewhere', self._carry_somewhere)
        for door in DOORS:
            self.create_service(
                SetBool, f'doors/{door}/set', lambda ask, reply, d=door: self._move(d, ask, reply)
            )
        ActionServer(
            self,
            DriveTo,
            'drive_to',
            execute_callback=lambda handle: DriveTo.Result(),  # _end returns the actual result
            goal_callback=self._asked,
            handle_accepted_callback=self._accept,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
            result_timeout=10,
        )
        self.create_timer(TICK / speed, self._tick)

    def _fault(self, name: str) -> str:
        return str(self.get_parameter(name).value)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        for given in parameters:
            if given.name in FAULTS and given.value not in FAULTS[given.name]:
                choices = ', '.join(FAULTS[given.name])
                return SetParametersResult(
                    successful=False, reason=f'{given.name} must be one of {choices}'
                )
        return SetParametersResult(successful=True)

    def _tick(self) -> None:
        """Step by the elapsed time; by one tick if the node publishes /clock."""
        now = time.monotonic()
        dt = TICK if self._has_clock else min(now - self._last, 0.5)
        self._last, self._ticks, self._now = now, self._ticks + 1, self._now + dt
        if self._now - self._commanded > COMMAND_TIMEOUT:
            self._command = Twist()
        if self._goal:
            self._pursue(self._goal)
        self.rover.step(self._command.linear.x, self._command.angular.z, dt)
        if self._has_clock:
            stamp = messages.stamped(self._now, '').stamp
            self._out['/clock'].publish(Clock(clock=stamp))
        if self._ticks % SENSORS_EVERY == 0:
            self._measure()
        if self._ticks % WAYS_EVERY == 0:
            for place in PLACES:
                corner = messages.waypoint_message(self.rover, place, self._now)
                self._out[f'waypoint/{place}'].publish(corner)
        if self._ticks % SLOW_EVERY == 0:
            self._out['battery'].publish(messages.battery_message(self.rover, self._now))
            for door, is_open in self.rover.doors.items():
                self._out[f'doors/{door}'].publish(Bool(data=is_open))

    def _measure(self) -> None:
        measured, fault = self.rover.odometry(), self._fault('odom_fault')
        odometry = messages.odometry_message(measured, self._now)
        if fault == 'nan':
            odometry.pose.pose.position.x = math.nan
        if fault != 'stopped':
            self._out['odom'].publish(odometry)
        scan, fault = messages.scan_message(self.rover, self._now), self._fault('scan_fault')
        if fault == 'nan':
            scan.ranges = [math.nan] * len(scan.ranges)
        if fault != 'stopped':
            self._out['scan'].publish(scan)
        if TFMessage:
            moved = messages.transform_message(measured, self._now)
            self._out['/tf'].publish(TFMessage(transforms=[moved]))

    def _obey(self, command: Twist) -> None:
        self._command, self._commanded = command, self._now
        if self._goal:
            self._end(DriveTo.Result.STATUS_OVERRIDDEN, 'a Twist took over')

    def _carry_to(self, to: PoseStamped) -> None:
        at = to.pose
        try:
            self.rover.place(at.position.x, at.position.y, messages.yaw_of(at.orientation))
        except ValueError as error:
            self.get_logger().warning(str(error))

    def _carry_somewhere(self, _: Trigger.Request, reply: Trigger.Response) -> Trigger.Response:
        self.rover.place_randomly()
        x, y, yaw = self.rover.pose
        reply.success, reply.message = True, f'x {x:.2f} m, y {y:.2f} m, yaw {yaw:.2f} rad'
        return reply

    def _move(self, door: str, ask: SetBool.Request, reply: SetBool.Response) -> SetBool.Response:
        try:
            self.rover.set_door(door, ask.data)
            reply.success = True
        except ValueError as error:
            reply.message = str(error)
        return reply

    async def _asked(self, goal: DriveTo.Goal) -> GoalResponse:
        if self._fault('drive_to_fault') == 'no_answer':
            await Future()
        return GoalResponse.ACCEPT

    def _accept(self, handle: ServerGoalHandle) -> None:
        if self._goal:
            self._end(DriveTo.Result.STATUS_OVERRIDDEN, 'a later goal took over')
        self._goal = Goal(handle, self._now)

    def _pursue(self, goal: Goal) -> None:
        """Drive towards the goal of the action for one tick, or end the goal."""
        if self._fault('drive_to_fault') == 'no_result':
            return
        if goal.handle.is_cancel_requested:
            self._end(DriveTo.Result.STATUS_CANCELED, 'canceled')
            return
        path = self.rover.path_to(goal.pose[:2])
        if not path:
            self._end(DriveTo.Result.STATUS_NO_PATH, 'no way leads there')
            return
        now = drive(self.rover.pose, path, goal.pose)
        if now.remaining < goal.closest - 0.02 or now.remaining < 0.1:
            goal.closest, goal.since = now.remaining, self._now
        if now.reached:
            self._end(DriveTo.Result.STATUS_REACHED)
        elif self._now - goal.since > STUCK:
            self._end(DriveTo.Result.STATUS_STUCK, f'no closer for {STUCK:.0f} s')
        else:
            self._command = Twist()
            self._command.linear.x, self._command.angular.z = now.linear, now.angular
            self._commanded = self._now
            if self._ticks % SLOW_EVERY == 0:
                goal.handle.publish_feedback(DriveTo.Feedback(distance_remaining=now.remaining))

    def _end(self, status: int, message: str = '') -> None:
        """End the goal of the action; it is executed only now that its result is known."""
        goal, self._goal = self._goal, None
        if status != DriveTo.Result.STATUS_OVERRIDDEN:
            self._command = Twist()

        def finish(handle: ServerGoalHandle) -> DriveTo.Result:
            if status == DriveTo.Result.STATUS_REACHED:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return DriveTo.Result(status=status, message=message)

        goal.handle.execute(finish)


def main(args: list[str] | None = None) -> None:
    """Run the node until it is shut down."""
    rclpy.init(args=args)
    try:
        rclpy.spin(Rover())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
