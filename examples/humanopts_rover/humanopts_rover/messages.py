"""The messages of the rover's sensors, with values of the simulation."""

import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PointStamped, Quaternion, TransformStamped
from humanopts_rover.simulation import BEAMS, MAX_RANGE, MIN_RANGE, Odometry, Simulation
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Bool, Header

FRAME, BASE, LASER = 'odom', 'base_link', 'laser'


def stamped(seconds: float, frame: str) -> Header:
    """Return the header of a measurement at a time, s."""
    sec = math.floor(seconds)
    return Header(stamp=Time(sec=sec, nanosec=int((seconds - sec) * 1e9)), frame_id=frame)


def quaternion(yaw: float) -> Quaternion:
    """Return the rotation about the vertical axis by an angle, rad."""
    return Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def yaw_of(turned: Quaternion) -> float:
    """Return the angle of a rotation about the vertical axis, rad."""
    return math.atan2(
        2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * (turned.y**2 + turned.z**2)
    )


def odometry_message(measured: Odometry, seconds: float = 0.0) -> OdometryMessage:
    """Return the measured pose in the frame ``odom``, and the speeds in ``base_link``."""
    message = OdometryMessage(header=stamped(seconds, FRAME), child_frame_id=BASE)
    at = message.pose.pose
    at.position.x, at.position.y, at.orientation = measured.x, measured.y, quaternion(measured.yaw)
    message.twist.twist.linear.x = measured.linear
    message.twist.twist.angular.z = measured.angular
    return message


def transform_message(measured: Odometry, seconds: float = 0.0) -> TransformStamped:
    """Return the measured pose as the transform from ``odom`` to ``base_link``."""
    message = TransformStamped(header=stamped(seconds, FRAME), child_frame_id=BASE)
    at = message.transform
    at.translation.x, at.translation.y = measured.x, measured.y
    at.rotation = quaternion(measured.yaw)
    return message


def scan_message(rover: Simulation, seconds: float = 0.0) -> LaserScan:
    """Return a scan of all directions, counterclockwise from behind."""
    step = 2 * math.pi / BEAMS
    return LaserScan(
        header=stamped(seconds, LASER),
        angle_min=-math.pi,
        angle_max=math.pi - step,
        angle_increment=step,
        range_min=MIN_RANGE,
        range_max=MAX_RANGE,
        ranges=rover.scan().tolist(),
    )


def waypoint_message(rover: Simulation, place: str, seconds: float = 0.0) -> PointStamped:
    """Return the next corner of the path to a place; the place itself if there is no path."""
    x, y = rover.waypoint(place)
    return PointStamped(header=stamped(seconds, FRAME), point=Point(x=x, y=y))


def battery_message(rover: Simulation, seconds: float = 0.0) -> BatteryState:
    """Return the charge of the battery, 0 to 1."""
    charging = rover.is_charging()
    return BatteryState(
        header=stamped(seconds, BASE),
        voltage=11.0 + 2.0 * rover.battery,
        percentage=rover.battery,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_CHARGING
        if charging
        else BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        present=True,
    )


def sensed(rover: Simulation) -> dict[str, Any]:
    """Return the current sensor messages, by topic name in ``worlds/rover.yaml``."""
    return {
        'odom': odometry_message(rover.odometry()),
        'scan': scan_message(rover),
        'battery': battery_message(rover),
        'door': Bool(data=rover.doors['door']),
        **{f'to_{place}': waypoint_message(rover, place) for place in ('charger', 'east', 'dock')},
    }
