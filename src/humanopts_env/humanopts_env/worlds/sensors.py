"""
The sensors of a robot: features from the newest messages of its topics.

Messages are read by the names of their fields, so this code needs no ROS.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
import math
import re
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import DomainError, Feature, FeatureKind
from humanopts_env.worlds.world_file import (
    FeatureSpec,
    Place,
    TF,
    Topic,
    WorldFile,
    WorldFileError,
)
import numpy as np

_STEP = re.compile(r'([A-Za-z_][A-Za-z0-9_]*)((?:\[-?\d+\])*)')  # step of a path: name[index]
MAX_FRAMES = 10_000


class SensorError(DomainError):
    """The world cannot be sensed now; the message names the topic or feature and the reason."""


@dataclass(frozen=True, slots=True)
class Sensed:
    """
    The features of a world, each within its range.

    :ivar outside: description of a clipped value; empty if none.
    """

    features: tuple[float, ...]
    outside: str = ''


@dataclass(frozen=True, slots=True)
class _Edge:
    """The newest transform of a frame."""

    parent: str
    transform: Any  # message: pose of the frame in its parent
    topic: str  # name of the topic in the file
    heard: float  # time of arrival, s


class Sensors:
    """
    The newest message of each topic, and the transforms between frames.

    :ivar now: time of the last ``note`` or ``check``, s.
    """

    def __init__(self, topics: Mapping[str, Topic]) -> None:
        self._topics = topics
        self._heard: dict[str, tuple[Any, float]] = {}
        self._frames: dict[str, _Edge] = {}
        self.now = 0.0

    def note(self, name: str, message: Any, now: float) -> None:
        """
        Store a message.

        :param name: name of the topic in the file.
        :param now: time of its arrival, s.
        """
        self._heard[name], self.now = (message, now), now
        if self._topics[name].type != TF:
            return
        for each in message.transforms:
            child = each.child_frame_id.lstrip('/')
            if child in self._frames or len(self._frames) < MAX_FRAMES:
                parent = each.header.frame_id.lstrip('/')
                self._frames[child] = _Edge(parent, each.transform, name, now)

    def check(self, now: float) -> None:
        """
        Check that every topic has a message, and that none is stale.

        :raises SensorError: a message is missing or too old.
        """
        self.now = now
        for name, topic in self._topics.items():
            if name not in self._heard:
                raise SensorError(f'no message has arrived on {topic.topic} ({topic.type})')
            if topic.stale is not None and self.age(name) > topic.stale:
                raise SensorError(
                    f'{topic.topic} is stale: its last message is {self.age(name):.1f} s old, '
                    f'and {topic.stale:g} s are allowed'
                )

    def has(self, name: str) -> bool:
        """Return whether a topic has a message."""
        return name in self._heard

    def message(self, name: str) -> Any:
        """Return the newest message of a topic."""
        return self._heard[name][0]

    def age(self, name: str) -> float:
        """Return the time since the newest message of a topic arrived, s."""
        return max(self.now - self._heard[name][1], 0.0)

    def transform(self, parent: str, child: str) -> Floats:
        """
        Return the pose of a frame in another frame, (4, 4), along any chain of transforms.

        :raises SensorError: no chain connects the frames, or one of its transforms is stale.
        """
        below = dict(self._upwards(child))
        for frame, pose in self._upwards(parent):
            if frame in below:
                found: Floats = np.linalg.inv(pose) @ below[frame]
                return found
        raise SensorError(f'no transforms connect {parent} and {child}')

    def _upwards(self, frame: str) -> Iterator[tuple[str, Floats]]:
        """Yield a frame and its ancestors, each with the pose of the frame in it."""
        pose: Floats = np.eye(4)
        yield frame, pose
        for _ in range(len(self._frames)):  # also ends in a cycle
            edge = self._frames.get(frame)
            if edge is None:
                return
            stale, age = self._topics[edge.topic].stale, self.now - edge.heard
            if stale is not None and age > stale:
                raise SensorError(
                    f'the transform from {edge.parent} to {frame} is stale: it is {age:.1f} s '
                    f'old, and {stale:g} s are allowed'
                )
            step = edge.transform
            frame, pose = edge.parent, _matrix(step.translation, step.rotation) @ pose
            yield frame, pose


Read = Callable[[Sensors], Any]


def value_reader(file: WorldFile, path: str, key: str) -> Read:
    """
    Return the reader of a field, such as ``odom.pose.pose.position.x`` or ``arm.position[2]``.

    :param key: location of the path in the file.
    :raises WorldFileError: the path is invalid, or begins with an unknown topic.
    """
    steps: list[str | int] = []
    for part in path.split('.'):
        match = _STEP.fullmatch(part)
        if match is None:
            raise WorldFileError(f'{key}: {path!r} is not a field, such as odom.twist.linear.x')
        steps += [match[1], *(int(index) for index in re.findall(r'-?\d+', match[2]))]
    topic = str(steps[0])
    if topic not in file.topics:
        known = ', '.join(file.topics) or 'none'
        raise WorldFileError(f'{key}: unknown topic {topic!r}; the file has {known}')

    def read(sensors: Sensors) -> Any:
        value = sensors.message(topic)
        for step in steps[1:]:
            try:
                value = getattr(value, step) if isinstance(step, str) else value[step]
            except AttributeError:
                kind = file.topics[topic].type
                raise SensorError(f'{path}: {kind} has no field {step!r} there') from None
            except (IndexError, TypeError):
                raise SensorError(f'{path}: there is no element {step} now') from None
        return value

    return read


def feature_reader(name: str, spec: FeatureSpec, file: WorldFile) -> Callable[[Sensors], float]:
    """
    Return the reader of a feature's value; a number may be out of its range.

    :raises WorldFileError: its source is not in the file.
    """
    raw, feature = _raw_reader(spec, file, f'features {name}'), as_feature(name, spec)

    def read(sensors: Sensors) -> float:
        try:
            return checked_value(feature, spec, raw(sensors))
        except SensorError as error:
            raise SensorError(f'the feature {name} cannot be read: {error}') from None

    return read


def as_feature(name: str, spec: FeatureSpec) -> Feature:
    """Return the feature that a world file describes."""
    if spec.limits is not None and spec.is_number:
        return Feature.continuous(name, spec.question, *spec.limits, spec.shown_unit)
    kind = FeatureKind.ORDINAL if spec.kind == 'ordinal' else FeatureKind.NOMINAL
    return Feature(name, spec.question, kind, spec.values)


def checked_value(feature: Feature, spec: FeatureSpec, value: Any) -> float:
    """
    Convert a sensed value to a value of a feature.

    A text must be one of the feature's values; a bool or a whole number is an index into them. The
    value of a continuous feature may be out of its range.

    :raises SensorError: the feature cannot have the value.
    """
    if isinstance(value, str) and not spec.is_number:
        if value not in feature.values:
            raise SensorError(f'it is {value!r}, but can only be {", ".join(feature.values)}')
        return float(feature.values.index(value))
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise SensorError(f'it is {type(value).__name__}, not a number') from None
    if spec.clip and spec.is_number and not math.isnan(number):
        number = min(max(number, feature.low), feature.high)
    if not math.isfinite(number):
        raise SensorError(f'it is {number}')
    if not spec.is_number and not feature.has(number):
        raise SensorError(f'it is {number:g}, and has {len(feature.values)} values')
    return number


def _raw_reader(spec: FeatureSpec, file: WorldFile, key: str) -> Read:
    def alias(topic: str) -> str:
        value_reader(file, topic, key)
        return topic

    match spec.source:
        case 'field':
            return value_reader(file, str(spec.field), key)
        case 'age':
            aged = alias(str(spec.age))
            return lambda sensors: sensors.age(aged)
        case 'scan_min':
            scan, sector = alias(str(spec.scan_min)), spec.sector
            return lambda sensors: scan_minimum(sensors.message(scan), *map(math.radians, sector))
        case 'tf':
            assert spec.tf is not None
            (parent, child), part = _frames(file, spec.tf, key), spec.part
            return lambda sensors: _part_of(sensors.transform(parent, child), part)
        case 'heading':
            heading = _pose_reader(file, spec.heading, key)
            return lambda sensors: heading(sensors)[2]
        case 'computed':
            return lambda sensors: None  # provided by the class of the world
    own, source = _pose_reader(file, spec.pose, key), spec.source
    target = _target_reader(file, str(getattr(spec, source)), key)

    def read(sensors: Sensors) -> float:
        (x, y, yaw), (to_x, to_y, to_yaw) = own(sensors), target(sensors)
        if source == 'distance_to':
            return math.hypot(to_x - x, to_y - y)
        turn = to_yaw if source == 'heading_to' else math.atan2(to_y - y, to_x - x)
        return wrapped(turn - yaw)

    return read


Pose = tuple[float, float, float]  # x, y, yaw


def _target_reader(file: WorldFile, text: str, key: str) -> Callable[[Sensors], Pose]:
    """Return the reader of a place, or of a pose on a topic, such as the next waypoint."""
    if text.partition('.')[0] not in file.topics:
        place = file.places.get(text)
        if place is None:
            known = ', '.join([*file.places, *file.topics]) or 'none'
            raise WorldFileError(f'{key}: unknown place {text!r}; choose from {known}')
        return lambda sensors: (place.x, place.y, place.yaw)
    return _pose_reader(file, text, key)


def _pose_reader(
    file: WorldFile, of: str | tuple[str, str] | None, key: str
) -> Callable[[Sensors], Pose]:
    if isinstance(of, tuple):
        parent, child = _frames(file, of, key)

        def from_frames(sensors: Sensors) -> Pose:
            pose = sensors.transform(parent, child)
            return float(pose[0, 3]), float(pose[1, 3]), _part_of(pose, 'yaw')

        return from_frames
    value = value_reader(file, str(of), key)
    return lambda sensors: planar(value(sensors))


def _frames(file: WorldFile, names: tuple[str, str], key: str) -> tuple[str, str]:
    if all(topic.type != TF for topic in file.topics.values()):
        raise WorldFileError(f'{key}: the frames {" and ".join(names)} need a topic of type {TF}')
    return names[0].lstrip('/'), names[1].lstrip('/')


def planar(message: Any) -> Pose:
    """
    Return x, y and yaw of a message that has a pose or a point.

    :raises SensorError: the message has neither.
    """
    for name in ('pose', 'pose', 'point'):  # Odometry has pose.pose
        message = getattr(message, name, message)
    position = getattr(message, 'position', message)
    if not hasattr(position, 'x') or not hasattr(position, 'y'):
        raise SensorError(f'{type(message).__name__} has no position')
    turn = getattr(message, 'orientation', None)
    yaw = 0.0 if turn is None else _part_of(_matrix(position, turn), 'yaw')
    return float(position.x), float(position.y), yaw


def placed(place: Place) -> dict[str, Any]:
    """Return the fields of a pose message at a place."""
    half = place.yaw / 2
    return {
        'position': {'x': place.x, 'y': place.y, 'z': 0.0},
        'orientation': {'x': 0.0, 'y': 0.0, 'z': math.sin(half), 'w': math.cos(half)},
    }


def scan_minimum(scan: Any, start: float, end: float) -> float:
    """
    Return the smallest range of a ``LaserScan`` in a sector, m.

    Ranges are clipped to range_min and range_max; a beam without an echo (inf) has range_max.

    :param start: right end of the sector, rad to the left of straight ahead.
    :param end: left end of the sector, rad.
    :raises SensorError: no beam is in the sector, or a range is NaN.
    """
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    width = end - start
    slack = abs(scan.angle_increment) * 1e-3
    inside = ((angles - start + slack) % math.tau <= width + 2 * slack) | (width >= math.tau)
    if not inside.any():
        raise SensorError('the scan has no beam in its sector')
    nearest = ranges[inside].min()  # NaN if any range is
    if math.isnan(nearest):
        raise SensorError('a range of the scan is nan')
    return float(min(max(nearest, scan.range_min), scan.range_max))


def wrapped(angle: float) -> float:
    """Return an angle wrapped to -pi to pi, rad."""
    return math.atan2(math.sin(angle), math.cos(angle))


def _matrix(translation: Any, rotation: Any) -> Floats:
    """Return the homogeneous matrix of a translation and a quaternion, (4, 4)."""
    x, y, z, w = (float(getattr(rotation, name)) for name in 'xyzw')
    size = x * x + y * y + z * z + w * w
    if not math.isfinite(size) or size < 1e-12:
        raise SensorError('its orientation is not a rotation')
    s = 2 / size
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), translation.x],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w), translation.y],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y), translation.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _part_of(pose: Floats, part: str) -> float:
    """Return a part of a pose (4, 4); angles are those of fixed axes (roll, pitch, yaw)."""
    x, y, z = pose[:3, 3]
    found = {
        'x': x,
        'y': y,
        'z': z,
        'distance': math.sqrt(x * x + y * y + z * z),
        'bearing': math.atan2(y, x),
        'roll': math.atan2(pose[2, 1], pose[2, 2]),
        'pitch': math.atan2(-pose[2, 0], math.hypot(pose[0, 0], pose[1, 0])),
        'yaw': math.atan2(pose[1, 0], pose[0, 0]),
    }
    return float(found[part])
