"""Driving to a pose, without ROS: first along a path, then turning in place."""

from dataclasses import dataclass
from itertools import pairwise
import math

from humanopts_rover.simulation import Point, Pose, turn

CLOSE, ALIGNED = 0.05, 0.1  # m, rad; tolerances of a reached goal
SLOW = 0.6  # m from the goal at which the rover slows down
FAST, TURNING = 0.4, 1.0  # maximum speeds, m/s, rad/s


@dataclass(frozen=True, slots=True)
class Drive:
    """The speeds for following a path, and its remaining length."""

    linear: float  # m/s
    angular: float  # rad/s
    remaining: float  # m
    reached: bool


def drive(pose: Pose, path: list[Point], goal: Pose) -> Drive:
    """
    Return the speeds at a pose.

    :param path: corners of the path from ``pose`` to ``goal``, both included.
    """
    remaining = sum(math.dist(a, b) for a, b in pairwise(path))
    if remaining < CLOSE:
        off = turn(goal.yaw - pose.yaw)
        reached = abs(off) < ALIGNED
        return Drive(0.0, 0.0 if reached else _steer(off), remaining, reached)
    ahead = next(point for point in path[1:] if math.dist(point, path[0]) > 1e-6)
    off = turn(math.atan2(ahead[1] - pose.y, ahead[0] - pose.x) - pose.yaw)
    speed = FAST * min(1.0, max(remaining / SLOW, 0.15)) * (abs(off) < 0.3)
    return Drive(speed, _steer(off), remaining, False)


def _steer(off: float) -> float:
    return min(max(2.0 * off, -TURNING), TURNING)
