"""
A robot of the simulator IR-SIM on ROS 2 topics: odometry and scan out, velocities in.

Run ``pip install ir-sim``, then ``python driver.py yard.yaml``.
"""

import math
import sys
import time

from geometry_msgs.msg import Twist
import irsim
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

COMMAND_TIMEOUT = 0.25  # s


class Driver(Node):
    """Step the simulator in real time."""

    def __init__(self, yard: str) -> None:
        super().__init__('irsim')
        self._yard = irsim.make(yard, display=False)
        self._velocity, self._heard = (0.0, 0.0), 0.0
        self._odom = self.create_publisher(Odometry, 'odom', 10)
        self._scan = self.create_publisher(LaserScan, 'scan', 10)
        self.create_subscription(Twist, 'cmd_vel', self._obey, 10)
        self.create_timer(self._yard.step_time, self._step)

    def _obey(self, twist: Twist) -> None:
        self._velocity, self._heard = (twist.linear.x, twist.angular.z), time.monotonic()

    def _step(self) -> None:
        late = time.monotonic() - self._heard > COMMAND_TIMEOUT
        self._yard.step(np.array((0.0, 0.0) if late else self._velocity).reshape(2, 1))
        x, y, yaw = map(float, self._yard.robot.state.ravel())
        odom, scan = Odometry(child_frame_id='base_link'), LaserScan()
        odom.header.frame_id, odom.header.stamp = 'odom', self.get_clock().now().to_msg()
        at = odom.pose.pose
        at.position.x, at.position.y = x, y
        at.orientation.z, at.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        speed = odom.twist.twist
        speed.linear.x, speed.angular.z = map(float, self._yard.robot.velocity.ravel())
        seen = self._yard.get_lidar_scan()
        scan.header.frame_id, scan.header.stamp = 'base_link', odom.header.stamp
        for name in ('angle_min', 'angle_max', 'angle_increment', 'range_min', 'range_max'):
            setattr(scan, name, float(seen[name]))
        scan.ranges = [float(each) for each in seen['ranges']]
        self._odom.publish(odom)
        self._scan.publish(scan)


def main() -> None:
    """Run the node until it is shut down."""
    rclpy.init()
    try:
        rclpy.spin(Driver(sys.argv[1]))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
