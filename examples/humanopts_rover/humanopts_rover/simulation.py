"""
The physics of the rover and its house, without ROS.

A node or an experiment steps a ``Simulation``::

    rover = Simulation(seed=1)
    rover.place_randomly()
    rover.step(linear=0.3, angular=0.0, seconds=0.2)
    rover.odometry().x, rover.scan(), rover.path('charger'), rover.battery

Lengths are in metres, angles in radians counterclockwise from the x axis (east), times in seconds.
"""

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 8.0, 5.0  # of the house
RADIUS = 0.18  # of the rover, a disc
CLEAR = RADIUS + 0.02  # minimum distance from a planned path to walls
PASSED = 0.15  # distance within which a corner of a path is passed
BEFORE_DOCK = 0.8  # distance from which the rover drives straight into the dock
MAX_LINEAR, MAX_ANGULAR = 0.6, 1.6  # m/s, rad/s
ACCELERATION = 3.0, 12.0  # m/s^2, rad/s^2; the rover stops from full speed within 0.2 s
BEAMS, MIN_RANGE, MAX_RANGE = 24, 0.05, 10.0
TICK = 0.02  # s, integration step
CHARGING_RADIUS = 0.4  # m around the charger
DRAIN, DRAIN_MOVING, CHARGE = 0.0005, 0.002, 0.05  # share of the battery per second
GRIP, RANGE_NOISE, POSE_NOISE = 0.03, 0.01, 0.004  # standard deviations: share of speed, m, m

Point = tuple[float, float]
Segment = tuple[float, float, float, float]  # x, y of both ends


class Pose(NamedTuple):
    """The position and heading of the rover."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Odometry:
    """A measured pose and the speeds of the rover."""

    x: float
    y: float
    yaw: float
    linear: float
    angular: float


def _box(x: float, y: float, width: float, height: float) -> tuple[Segment, ...]:
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return tuple((*a, *b) for a, b in zip(corners, corners[1:] + corners[:1]))


TABLES = (1.5, 1.5, 0.8, 0.6), (5.7, 2.0, 0.6, 0.6)  # x, y of a corner, width, height
WALL = 4.0  # x of the wall between the rooms
WALLS: tuple[Segment, ...] = (
    *_box(0.0, 0.0, WIDTH, HEIGHT),
    (WALL, 0.0, WALL, 2.0),
    (WALL, 3.0, WALL, 4.1),
    *_box(*TABLES[0]),
    *_box(*TABLES[1]),
)
DOORS: dict[str, Segment] = {'door': (WALL, 2.0, WALL, 3.0), 'side_door': (WALL, 4.1, WALL, 5.0)}
ROOMS = {'west': (0.0, WALL), 'east': (WALL, WIDTH)}  # range of x
PLACES = {
    'charger': Pose(7.2, 0.8, 0.0),
    'dock': Pose(0.6, 4.0, math.pi),
    'west': Pose(3.2, 2.5, math.pi),
    'east': Pose(4.8, 2.5, 0.0),
}


def turn(angle: float) -> float:
    """Return the equivalent angle from -pi to pi."""
    return math.remainder(angle, 2 * math.pi)


class Simulation:
    """
    A rover in its house.

    :ivar pose: the true pose.
    :ivar linear: the true speed, m/s.
    :ivar angular: the true turning speed, rad/s.
    :ivar battery: charge, 0 to 1; an empty rover does not move.
    :ivar bumped: whether a wall or a closed door stopped the rover in the last step.
    :ivar doors: whether each door is open.
    """

    def __init__(self, seed: int = 0, *, noise: bool = True) -> None:
        """
        Put the rover into the west room.

        :param seed: seed of slipping wheels, sensor noise, and random places.
        :param noise: whether wheels and sensors are noisy.
        """
        self._wheels, self._sensors, self._hand = map(
            np.random.default_rng, np.random.SeedSequence(seed).spawn(3)
        )
        self._noise = float(noise)
        self.pose = Pose(2.0, 3.5, -math.pi / 2)
        self.linear = self.angular = 0.0
        self.battery = 1.0
        self.bumped = False
        self.doors = {'door': True, 'side_door': False}
        self._furnish()

    def step(self, linear: float, angular: float, seconds: float) -> None:
        """
        Drive with a commanded speed, as far as acceleration, walls and battery allow.

        :param linear: forward, m/s; limited to ``MAX_LINEAR``.
        :param angular: counterclockwise, rad/s; limited to ``MAX_ANGULAR``.
        """
        self.bumped = False
        power = float(self.battery > 0.0)
        goal = (
            power * min(max(linear, -MAX_LINEAR), MAX_LINEAR),
            power * min(max(angular, -MAX_ANGULAR), MAX_ANGULAR),
        )
        grip = 1.0 + GRIP * self._noise * self._wheels.standard_normal(2)
        ticks = max(1, round(seconds / TICK))
        for _ in range(ticks):
            self._tick(goal, grip, seconds / ticks)
        moving = abs(self.linear) > 1e-3 or abs(self.angular) > 1e-3
        used = DRAIN + moving * DRAIN_MOVING - self.is_charging() * CHARGE
        self.battery = min(max(self.battery - used * seconds, 0.0), 1.0)

    def _tick(self, goal: tuple[float, float], grip: NDArray[np.float64], dt: float) -> None:
        self.linear, self.angular = (
            min(max(wanted, now - limit * dt), now + limit * dt)
            for now, wanted, limit in zip((self.linear, self.angular), goal, ACCELERATION)
        )
        x, y, yaw = self.pose
        turned = self.angular * grip[1] * dt
        way, heading = self.linear * grip[0] * dt, yaw + turned / 2
        to = x + way * math.cos(heading), y + way * math.sin(heading)
        if way and not self._is_free(to) and self.clearance(to) < self.clearance((x, y)):
            to, self.linear, self.bumped = (x, y), 0.0, True
        self.pose = Pose(float(to[0]), float(to[1]), turn(float(yaw + turned)))

    def is_charging(self) -> bool:
        """Return whether the rover is at the charger."""
        return math.dist(self.pose[:2], PLACES['charger'][:2]) < CHARGING_RADIUS

    def odometry(self) -> Odometry:
        """Measure pose and speeds."""
        x, y, yaw = self.pose + POSE_NOISE * self._noise * self._sensors.standard_normal(3)
        return Odometry(float(x), float(y), turn(float(yaw)), self.linear, self.angular)

    def scan(self) -> NDArray[np.float64]:
        """Measure the ranges (BEAMS,); beam i is at -pi + i * 2 pi / BEAMS."""
        x, y, yaw = self.pose
        angles = yaw - math.pi + np.arange(BEAMS) * (2 * math.pi / BEAMS)
        way = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]  # (BEAMS, 1, 2)
        far, share = _crossings(np.array([x, y]), way, self._solid)
        hit = (far >= 0) & (share >= -1e-9) & (share <= 1 + 1e-9)
        ranges = np.where(hit, far, np.inf).min(axis=1)
        ranges += RANGE_NOISE * self._noise * self._sensors.standard_normal(BEAMS)
        return np.asarray(ranges.clip(MIN_RANGE, MAX_RANGE))

    def path(self, place: str) -> list[Point]:
        """
        Return the corners of the shortest path from the true pose to a place, both included.

        :return: empty if closed doors block every path.
        :raises KeyError: there is no such place.
        """
        return self.path_to(PLACES[place][:2])

    def waypoint(self, place: str) -> Point:
        """
        Return the next corner of the path to a place; the place itself if there is no path.

        A corner is passed within ``PASSED`` of it. The path into the dock leads through a point in
        front of the dock until the rover is aligned with it.
        """
        x, y, yaw = PLACES[place]
        if place == 'dock':
            before = (x - self.pose.x) * math.cos(yaw) + (y - self.pose.y) * math.sin(yaw)
            aside = abs((y - self.pose.y) * math.cos(yaw) - (x - self.pose.x) * math.sin(yaw))
            if before <= 0 or aside >= 0.06 + 0.15 * max(before - PASSED, 0.0):
                x, y = x - BEFORE_DOCK * math.cos(yaw), y - BEFORE_DOCK * math.sin(yaw)
        corners = self.path_to((x, y))[1:-1]
        ahead = (corner for corner in corners if math.dist(self.pose[:2], corner) > PASSED)
        return next(ahead, (x, y))

    def path_to(self, goal: Point) -> list[Point]:
        """Return the corners of the shortest path to a point, as ``path`` does."""
        here, corners = self.pose[:2], self._corners
        if not self.is_free(*goal):
            return []
        if goal not in self._near:
            self._near[goal] = self._reach(goal, corners)
        begin = self._reach(here, np.vstack([corners, goal]))
        through = begin[:-1, None] + self._lengths + self._near[goal]
        first, last = (int(i) for i in np.unravel_index(through.argmin(), through.shape))
        if begin[-1] <= through[first, last]:
            return [here, goal] if math.isfinite(begin[-1]) else []
        way = [first]
        while way[-1] != last:
            way.append(int(self._next[way[-1], last]))
        return [here, *((float(x), float(y)) for x, y in corners[way]), goal]

    def _reach(self, here: Point, there: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (N,) to points (N, 2); infinite if no straight path is free."""
        margin = min(CLEAR, self.clearance(here) - 0.01)
        away = np.hypot(*(there - here).T)
        return np.where(self._sees(here, there, margin), away, np.inf)

    def place(self, x: float, y: float, yaw: float) -> None:
        """
        Carry the rover to a pose by hand.

        :raises ValueError: the rover would be in a wall or outside of the house.
        """
        if not (0 < x < WIDTH and 0 < y < HEIGHT and math.isfinite(yaw)) or not self.is_free(x, y):
            raise ValueError(f'the rover has no room at x {x:.2f} m, y {y:.2f} m')
        self.pose, self.linear, self.angular = Pose(x, y, turn(yaw)), 0.0, 0.0

    def place_randomly(self, room: str | None = None, margin: float = 0.1) -> None:
        """
        Carry the rover to a random pose, in the given room if any.

        :param margin: minimum distance between the rover and a wall, m.
        """
        left, right = ROOMS[room] if room else (0.0, WIDTH)
        while True:
            x, y = self._hand.uniform((left, 0.0), (right, HEIGHT))
            if self.is_free(x, y, margin):
                break
        self.place(float(x), float(y), float(self._hand.uniform(-math.pi, math.pi)))

    def set_door(self, name: str, is_open: bool) -> None:
        """
        Open or close a door.

        :raises KeyError: there is no such door.
        :raises ValueError: the rover is in the doorway.
        """
        if not is_open and _distances(np.array(self.pose[:2]), np.array(DOORS[name])) < RADIUS:
            raise ValueError(f'the rover is in the way of {name}')
        if self.doors[name] != is_open:
            self.doors[name] = is_open
            self._furnish()

    def is_free(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Return whether the rover fits between the walls and tables at a point."""
        inside = any(
            left < x < left + width and low < y < low + height
            for left, low, width, height in TABLES
        )
        return not inside and self._is_free((x, y), margin)

    def _is_free(self, at: Point, margin: float = 0.0) -> bool:
        return self.clearance(at) >= RADIUS + margin

    def clearance(self, at: Point) -> float:
        """Return the distance from a point to the nearest wall."""
        return float(_distances(np.array(at), self._solid).min())

    def _furnish(self) -> None:
        """Find the shortest paths between doorways and corners of tables (Floyd's algorithm)."""
        shut = [DOORS[name] for name, is_open in self.doors.items() if not is_open]
        self._solid = np.array([*WALLS, *shut])
        corners: list[Point] = []
        for _, low, _, high in (DOORS[name] for name, is_open in self.doors.items() if is_open):
            middle = (low + high) / 2
            corners += [(WALL - 0.35, middle), (WALL, middle), (WALL + 0.35, middle)]
        for x, y, width, height in TABLES:
            xs, ys = (x - 0.3, x + width + 0.3), (y - 0.3, y + height + 0.3)
            corners += [(a, b) for a in xs for b in ys]
        self._corners = np.array(corners)
        count = len(corners)
        self._near: dict[Point, NDArray[np.float64]] = {}  # distances from goals to corners
        self._lengths = np.array([self._reach(corner, self._corners) for corner in corners])
        self._next = np.tile(np.arange(count), (count, 1))
        for middle in range(count):
            through = self._lengths[:, middle, None] + self._lengths[None, middle]
            shorter = through < self._lengths - 1e-9
            self._lengths = np.where(shorter, through, self._lengths)
            self._next = np.where(shorter, self._next[:, middle, None], self._next)

    def _sees(self, here: Point, there: NDArray[np.float64], margin: float) -> NDArray[np.bool_]:
        """Return which points (N, 2) a disc of radius ``margin`` reaches in a straight line."""
        solid, at = self._solid, np.array(here)
        ways = np.column_stack([np.broadcast_to(at, there.shape), there])
        ends = np.concatenate([solid[:, :2], solid[:, 2:]])
        gaps = [
            np.broadcast_to(_distances(at, solid).min(), len(there)),
            _distances(there[:, None], solid).min(axis=1),
            _distances(ends[:, None], ways).min(axis=0),
        ]
        far, share = _crossings(at, (there - at)[:, None], solid)
        crossed = (far > 0) & (far < 1) & (share > 0) & (share < 1)
        return np.asarray((np.min(gaps, axis=0) >= margin) & ~crossed.any(axis=1))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _crossings(
    here: NDArray[np.float64], ways: NDArray[np.float64], segments: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return where vectors (N, 1, 2) from a point cross segments (M, 4).

    :return: as shares of the vector and of the segment, (N, M) each; infinite or NaN if parallel.
    """
    start, along = segments[:, :2] - here, segments[:, 2:] - segments[:, :2]
    with np.errstate(divide='ignore', invalid='ignore'):
        cross = _cross(ways, along)
        return _cross(start, along) / cross, _cross(start, ways) / cross


def _distances(at: NDArray[np.float64], segments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (...) from points (..., 2) to segments (..., 4)."""
    start, along = segments[..., :2], segments[..., 2:] - segments[..., :2]
    share = ((at - start) * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-12)
    away = start + np.clip(share, 0.0, 1.0)[..., None] * along - at
    return np.asarray(np.hypot(away[..., 0], away[..., 1]))
