"""
The world file: the topics, places, features and actions that turn a robot into a world.

It is YAML, checked completely before anything moves. The reference is docs/reference/files.md.
"""

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.names import is_registered
from humanopts_ros.text_files import fault_in, FileError, read_yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
    TypeAdapter,
    ValidationError,
)

SOURCES = (
    *('field', 'distance_to', 'bearing_to', 'heading', 'heading_to'),
    *('scan_min', 'age', 'tf', 'computed'),
)
WAYS = 'twist', 'action', 'service', 'topic'
TF = 'tf2_msgs/msg/TFMessage'
_UNITS = {'distance_to': 'm', 'scan_min': 'm', 'age': 's'}
_ANGLES = 'bearing_to', 'heading', 'heading_to'


class WorldFileError(DomainError):
    """A world file cannot be used; the message names the file, the key and the reason."""


class _Part(BaseModel):
    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True, extra='forbid')


def _word(value: Any) -> Any:
    """Return a value as text, since YAML reads no, yes and 1 as other types."""
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    return str(value) if isinstance(value, int) else value


Word = Annotated[str, BeforeValidator(_word), Field(min_length=1)]
Seconds = Annotated[float, Field(ge=0, le=3600)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(pattern='^[a-z][a-z0-9_]*$')]
TopicName = Annotated[str, Field(pattern='^[/~]?[A-Za-z_][A-Za-z0-9_/]*$')]
MessageType = Annotated[str, Field(pattern='^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$')]
Vector = tuple[Number, Number, Number]
Fields = dict[str, Any]


class Topic(_Part):
    """A topic that the robot publishes."""

    topic: TopicName
    type: MessageType
    stale: Annotated[float, Field(gt=0)] | None = None  # s; None: values stay valid
    latched: bool = False  # published once, also for late subscribers


class Place(_Part):
    """A named place in the frame of the poses."""

    x: Number
    y: Number
    yaw: Number = 0.0  # rad


class FeatureSpec(_Part):
    """One feature, and its source."""

    question: Annotated[str, Field(min_length=1)]
    kind: Literal['continuous', 'ordinal', 'nominal'] | None = None
    values: tuple[Word, ...] = ()
    unit: str | None = None
    range: tuple[Number, Number] | None = None
    clip: bool = False  # clip values out of range, without pausing machines
    field: str | None = None
    distance_to: str | None = None
    bearing_to: str | None = None
    heading: str | tuple[str, str] | None = None
    heading_to: str | None = None
    scan_min: str | None = None
    age: str | None = None
    tf: tuple[str, str] | None = None  # parent and child frame
    computed: Literal[True] | None = None  # by the class of the world
    pose: str | tuple[str, str] | None = None  # pose to measure from
    sector: tuple[Number, Number] = (-180.0, 180.0)  # degrees, to the left of straight ahead
    part: Literal['x', 'y', 'z', 'roll', 'pitch', 'yaw', 'distance', 'bearing'] = 'x'

    @model_validator(mode='after')
    def _check(self) -> Self:
        if len(given := _given(self, SOURCES)) != 1:
            raise ValueError(f'give one of {", ".join(SOURCES)}, not {_listed(given)}')
        if given[0] in ('distance_to', 'bearing_to', 'heading_to') and self.pose is None:
            raise ValueError(f'{given[0]} needs pose: the topic of its position')
        if self.is_number:
            if self.values:
                raise ValueError('a continuous feature has a range, not values')
            if self.limits is None:
                raise ValueError('a number needs its range, such as range: [0, 8]')
            if not self.limits[0] < self.limits[1]:
                raise ValueError(f'the range {list(self.limits)} is empty')
        elif not self.values:
            raise ValueError(f'{self.kind} values are missing, such as values: [no, yes]')
        return self

    @property
    def source(self) -> str:
        """The source of the feature, one of SOURCES."""
        return _given(self, SOURCES)[0]

    @property
    def is_number(self) -> bool:
        """Whether the feature is continuous."""
        return self.kind == 'continuous' or (self.kind is None and not self.values)

    @property
    def is_angle(self) -> bool:
        """Whether the feature is an angle from -pi to pi."""
        of_frames = self.source == 'tf' and self.part in ('roll', 'pitch', 'yaw', 'bearing')
        return self.source in _ANGLES or of_frames

    @property
    def limits(self) -> tuple[float, float] | None:
        """The range of a number; None if it is missing."""
        half = 3.1415926535897931
        return (-half, half) if self.range is None and self.is_angle else self.range

    @property
    def shown_unit(self) -> str:
        """The unit of a number."""
        usual = 'rad' if self.is_angle else 'm' if self.source == 'tf' else ''
        return self.unit if self.unit is not None else _UNITS.get(self.source, usual)


class TwistSpec(_Part):
    """A velocity; a single number means forward (x) or a turn to the left (z)."""

    linear: Number | Vector = 0.0  # m/s
    angular: Number | Vector = 0.0  # rad/s

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """The linear and the angular velocity, each as x, y, z."""
        linear, angular = self.linear, self.angular
        return (
            linear if isinstance(linear, tuple) else (linear, 0.0, 0.0),
            angular if isinstance(angular, tuple) else (0.0, 0.0, angular),
        )


class ActionSpec(_Part):
    """One action of the world, and how it is carried out."""

    key: Word
    description: str = ''
    seconds: Seconds | None = None
    settle: Seconds | None = None  # s after its end before the next state is sensed
    idle: bool = False
    twist: TwistSpec | None = None
    action: TopicName | None = None
    service: TopicName | None = None
    topic: TopicName | None = None
    type: str = ''
    goal: Fields = Field(default_factory=dict)
    request: Fields = Field(default_factory=dict)
    message: Fields = Field(default_factory=dict)

    @model_validator(mode='after')
    def _check(self) -> Self:
        if len(given := _given(self, WAYS)) != 1:
            raise ValueError(f'give one of {", ".join(WAYS)}, not {_listed(given)}')
        way = given[0]
        interface = {'action': 'action', 'service': 'srv', 'topic': 'msg'}.get(way)
        parts = self.type.split('/')
        if interface and not (len(parts) == 3 and all(parts) and parts[1] == interface):
            raise ValueError(f'{way} needs its type, such as type: package/{interface}/Type')
        if interface is None and self.type:
            raise ValueError('type is not for twist')
        if way in ('action', 'service') and not self.seconds:
            raise ValueError(f'{way} needs seconds: the longest time that it may take')
        for name, of in (('goal', 'action'), ('request', 'service'), ('message', 'topic')):
            if getattr(self, name) and way != of:
                raise ValueError(f'{name} is for {of}, not for {way}')
        return self

    @property
    def way(self) -> str:
        """The way to act, one of WAYS."""
        return _given(self, WAYS)[0]

    @property
    def fields(self) -> Fields:
        """The fields of the goal, request or message."""
        return self.goal or self.request or self.message


class Velocity(_Part):
    """The topic for velocities."""

    topic: TopicName = '/cmd_vel'
    type: Literal['geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped'] = (
        'geometry_msgs/msg/Twist'
    )
    frame: str = 'base_link'  # frame of a TwistStamped


class Reward(_Part):
    """The reward of a step: a constant, plus a field of a topic when the step has ended."""

    step: Number = 0.0
    field: str | None = None


class End(_Part):
    """A condition that ends an episode when it becomes true."""

    when: str  # a formula over features
    success: bool = True  # False: the episode is cut off, but the task is not over
    reward: Number = 0.0  # in addition to that of the step


class Safety(_Part):
    """The conditions for motion of the robot."""

    emergency: TopicName | None = None  # std_msgs/msg/Bool; true: it must not move
    supervised: bool = True  # nothing moves before a person has taken control
    settle: Seconds = 0.0  # s after each action, unless the action has its own


class WorldFile(_Part):
    """A whole world file."""

    name: Name
    step: Annotated[float, Field(ge=0.02, le=60)] = 0.2  # s, default duration of a twist or topic
    gamma: Annotated[float, Field(gt=0, le=1)] = 0.99
    max_steps: Annotated[int, Field(ge=0, lt=2**31)] = 0
    topics: dict[Name, Topic] = Field(default_factory=dict)
    places: dict[Name, Place] = Field(default_factory=dict)
    features: dict[Name, FeatureSpec]
    actions: dict[Name, ActionSpec]
    velocity: Velocity | None = None  # None: the defaults, if an action is a twist
    reward: Reward = Field(default_factory=Reward)
    ends: tuple[End, ...] = ()
    safety: Safety = Field(default_factory=Safety)
    use_sim_time: bool = False  # take the time from /clock

    @model_validator(mode='after')
    def _check(self) -> Self:
        types: dict[str, str] = {}
        for each in self.topics.values():
            if types.setdefault(each.topic, each.type) != each.type:
                raise ValueError(
                    f'topics: {each.topic} has two types, {types[each.topic]} and {each.type}'
                )
        return self

    @property
    def velocity_topic(self) -> Velocity | None:
        """The topic for velocities; None if the robot does not drive."""
        drives = any(action.twist is not None for action in self.actions.values())
        return self.velocity or (Velocity() if drives else None)

    def seconds_of(self, action: ActionSpec) -> float:
        """Return the maximum duration of an action, without the time to settle, s."""
        return self.step if action.seconds is None else action.seconds

    def settle_of(self, action: ActionSpec) -> float:
        """Return the time to settle after an action, s."""
        return self.safety.settle if action.settle is None else action.settle


def read_world_file(path: Path) -> WorldFile:
    """
    Read and check a world file.

    :raises WorldFileError: the file cannot be used.
    """
    try:
        values = read_yaml(path)
    except FileError as error:
        raise WorldFileError(str(error)) from error
    return checked_world(values, path.name)


def checked_world(values: Any, where: str) -> WorldFile:
    """
    Check the values of a world file.

    :param where: name of the file.
    :raises WorldFileError: the values are not a valid world.
    """
    if not isinstance(values, Mapping):
        raise WorldFileError(f'{where}: it must have the keys name, topics, features and actions')
    try:  # as JSON, so that lists are accepted as tuples
        file = _ADAPTER.validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        known = _known_keys(error.errors(include_url=False)[0]['loc'])
        raise WorldFileError(f'{where}: {fault_in(error, known)}') from None
    except (TypeError, ValueError) as error:
        raise WorldFileError(f'{where}: {error}') from None
    if is_registered(file.name):
        raise WorldFileError(f'{where}: name: {file.name} is a game of humanopts; choose another')
    return file


_ADAPTER = TypeAdapter(WorldFile)
_KINDS: dict[str, type[_Part]] = {
    'topics': Topic,
    'places': Place,
    'features': FeatureSpec,
    'actions': ActionSpec,
    'velocity': Velocity,
    'reward': Reward,
    'safety': Safety,
    'ends': End,
}
T = TypeVar('T')


def _known_keys(place: tuple[int | str, ...]) -> tuple[str, ...]:
    """Return the keys that are allowed in the place of an unknown key."""
    if 'twist' in place[:-1]:
        return (*TwistSpec.model_fields,)
    kind = _KINDS.get(str(place[0]), WorldFile) if len(place) > 1 else WorldFile
    return (*kind.model_fields,)


def _given(part: _Part, names: tuple[str, ...]) -> list[str]:
    return [name for name in names if getattr(part, name) is not None]


def _listed(names: list[str]) -> str:
    return ' and '.join(names) or 'none'
