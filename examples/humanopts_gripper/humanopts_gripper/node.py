"""
The node ``gripper``: a device controlled by services, in plain ROS 2.

Publishes ``joint_states``, ``object`` (its pose, from the camera in the gripper), ``holding`` and
``in_bin``. Each motion is a service of std_srvs/Trigger that answers when the motion has ended:
``left``, ``right``, ``lower``, ``raise``, ``open``, ``close``. ``stop`` ends a motion.
``put_object`` acts as a person's hand.
"""

import threading
import time
from typing import Any

from geometry_msgs.msg import PoseStamped
from humanopts_gripper.simulation import Gripper, MOTIONS
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

TICK = 0.04  # s
LONGEST = 5.0  # s, timeout of a motion


class GripperNode(Node):
    """Step the mechanics by a timer; the motion services wait in a separate thread."""

    def __init__(self, **options: Any) -> None:
        super().__init__('gripper', **options)
        self.gripper = Gripper(self.declare_parameter('seed', 0).value)
        self._last, self._done = time.monotonic(), threading.Event()
        self._joints = self.create_publisher(JointState, 'joint_states', 10)
        self._object = self.create_publisher(PoseStamped, 'object', 10)
        self._holding = self.create_publisher(Bool, 'holding', 10)
        self._in_bin = self.create_publisher(Bool, 'in_bin', 10)
        one_at_a_time = MutuallyExclusiveCallbackGroup()
        for motion in MOTIONS:
            self.create_service(
                Trigger,
                motion,
                lambda _, reply, m=motion: self._move(m, reply),
                callback_group=one_at_a_time,
            )
        self.create_service(Trigger, 'stop', self._stop)
        self.create_service(Trigger, 'put_object', self._put_object)
        self.create_timer(TICK, self._tick)

    def _move(self, motion: str, reply: Trigger.Response) -> Trigger.Response:
        self._done.clear()
        try:
            self.gripper.begin(motion)
        except ValueError as error:
            reply.message = str(error)
            return reply
        reply.success = self._done.wait(LONGEST)
        reply.message = '' if reply.success else 'the motion did not end'
        return reply

    def _stop(self, _: Trigger.Request, reply: Trigger.Response) -> Trigger.Response:
        self.gripper.stop()
        reply.success = True
        return reply

    def _put_object(self, _: Trigger.Request, reply: Trigger.Response) -> Trigger.Response:
        self.gripper.put_object()
        reply.success, reply.message = True, f'the object is at {self.gripper.object:.2f} m'
        return reply

    def _tick(self) -> None:
        now, gripper = time.monotonic(), self.gripper
        gripper.step(min(now - self._last, 0.5))
        self._last, stamp = now, self.get_clock().now().to_msg()
        joints = JointState(name=[*gripper.joints], position=[*gripper.joints.values()])
        joints.header.stamp, joints.header.frame_id = stamp, 'rail'
        self._joints.publish(joints)
        at = PoseStamped(header=joints.header)
        at.header.frame_id = 'gripper'
        at.pose.position.x = gripper.object - gripper.joints['slider']
        self._object.publish(at)
        self._holding.publish(Bool(data=gripper.holding))
        self._in_bin.publish(Bool(data=gripper.is_in_bin()))
        if not gripper.is_moving():
            self._done.set()


def main(args: list[str] | None = None) -> None:
    """Run the node until it is shut down."""
    rclpy.init(args=args)
    try:
        executor = MultiThreadedExecutor(num_threads=2)
        executor.add_node(GripperNode())
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
