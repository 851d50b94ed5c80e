"""A robot as a world: its domain, features from messages, rewards and ends of episodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import importlib.util
import inspect
import math
from pathlib import Path
from typing import Any, cast, Protocol

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.check import check_description, ContractError
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.formulas import derive, FeatureColumn, FormulaError, NO_YES
from humanopts_env.domains.names import robot_file
from humanopts_env.worlds.sensors import (
    as_feature,
    checked_value,
    feature_reader,
    Read,
    Sensed,
    SensorError,
    Sensors,
    value_reader,
)
from humanopts_env.worlds.world_file import (
    ActionSpec,
    checked_world,
    read_world_file,
    WorldFile,
    WorldFileError,
)
import numpy as np


class WorldClass(Protocol):
    """
    A class ``ros:FILE.py:CLASS`` for a world that needs code; its constructor takes no arguments.

    ``world`` has the keys of a world file; ``computed: True`` marks the features that
    ``features`` returns. The other two methods are optional.
    """

    world: Mapping[str, Any]

    def features(self, messages: Mapping[str, Any]) -> Mapping[str, Any]:
        """
        Return the value of each computed feature by name.

        :param messages: the newest message of each topic, by its name in ``world``.
        """

    def reward(
        self, before: Mapping[str, float], action: str, after: Mapping[str, float]
    ) -> float:
        """Return the reward of a step, in addition to that in ``world``."""

    def success(self, before: Mapping[str, float], after: Mapping[str, float]) -> bool | None:
        """Return True if the episode ends with success, False if it is cut off, else None."""


@dataclass(frozen=True, slots=True)
class Timing:
    """The duration of an action."""

    seconds: float  # duration if ``timed``, else its maximum
    settle: float = 0.0  # s from its end until its effect can be sensed
    timed: bool = True  # whether it ends after ``seconds``; False: it should end before


@dataclass(frozen=True, slots=True)
class Ending:
    """The reward of a step, and whether the episode has ended."""

    reward: float
    terminated: bool = False  # the task is over
    truncated: bool = False  # the episode is cut off


class World:
    """
    A robot or simulator as a world.

    :ivar file: the world file.
    :ivar domain: features and actions, for all other nodes.
    :ivar timings: timing of each action by name.
    """

    def __init__(self, file: WorldFile, where: str, own: WorldClass | None = None) -> None:
        """
        Check that all parts fit together.

        :param where: name of the file.
        :param own: instance of the world's class, if it has one.
        :raises WorldFileError: the parts do not fit together.
        """
        self.file, self._own = file, own
        self.timings = {
            name: Timing(
                file.seconds_of(spec), file.settle_of(spec), spec.way in ('twist', 'topic')
            )
            for name, spec in file.actions.items()
        }
        try:
            self.domain = _described(file)
            self._readers = {
                name: feature_reader(name, spec, file) for name, spec in file.features.items()
            }
            self._reward = _reward_reader(file)
            self._ends = [_condition(self.domain, end.when, n) for n, end in enumerate(file.ends)]
            self._computed = [name for name, spec in file.features.items() if spec.computed]
            if self._computed and own is None:
                raise WorldFileError(
                    f'features {self._computed[0]}: computed is for a class, ros:FILE.py:CLASS'
                )
        except (WorldFileError, ContractError) as error:
            raise WorldFileError(f'{where}: {error}') from None

    def check_types(self, empty: Mapping[str, Any]) -> None:
        """
        Check that the fields of features exist.

        :param empty: a message of each topic's type, by the topic's name.
        :raises WorldFileError: a type lacks a field.
        """
        sensors = Sensors(self.file.topics)
        for name, message in empty.items():
            sensors.note(name, message, 0.0)
        for name, spec in self.file.features.items():
            try:
                if spec.field is not None:
                    value_reader(self.file, spec.field, name)(sensors)
            except SensorError as error:
                if 'has no field' in str(error):
                    raise WorldFileError(f'features {name}: {error}') from None

    def sense(self, sensors: Sensors) -> Sensed:
        """
        Return the value of each feature, clipped to its range.

        :raises SensorError: a feature cannot be sensed now, or has no valid value.
        """
        found, outside = [], ''
        computed = self._compute(sensors)
        for feature, (name, read) in zip(self.domain.features, self._readers.items()):
            if name in computed:
                value = _checked(feature, self.file.features[name], computed[name])
            else:
                value = read(sensors)
            if not feature.has(value):
                outside = outside or _outside(feature, value)
                value = min(max(value, feature.low), feature.high)
            found.append(value)
        return Sensed(tuple(found), outside)

    def text(self, features: Sequence[float]) -> str:
        """Return the state as a text: each feature with its value."""
        pairs = zip(self.domain.features, features)
        return ', '.join(f'{each.name} {each.text(value)}' for each, value in pairs)

    def ending(
        self, before: Sequence[float], action: str, after: Sequence[float], sensors: Sensors
    ) -> Ending:
        """
        Return the reward of a step, and whether it ends the episode.

        A condition ends the episode only when it becomes true, so that a robot at its goal can be
        driven away.

        :raises SensorError: the reward cannot be read.
        """
        reward = self.file.reward.step + (self._reward(sensors) if self._reward else 0.0)
        states = np.array([before, after], dtype=np.float64)
        now = [column.values(states).tolist() == [0.0, 1.0] for column in self._ends]
        met = [end for end, became in zip(self.file.ends, now) if became]
        reward += sum(end.reward for end in met)
        success = any(end.success for end in met) if met else None
        if self._own is not None:
            names = [*self.file.features]
            old, new = (dict(zip(names, values)) for values in (before, after))
            if hasattr(self._own, 'reward'):
                reward += float(self._own.reward(old, action, new))
            if success is None and hasattr(self._own, 'success'):
                success = self._own.success(old, new)
        if not math.isfinite(reward):
            raise SensorError(f'the reward of {action} is {reward}')
        return Ending(reward, success is True, success is False)

    def _compute(self, sensors: Sensors) -> Mapping[str, Any]:
        if self._own is None or not self._computed:
            return {}
        messages = {name: sensors.message(name) for name in self.file.topics}
        try:
            found = self._own.features(messages)
            return {name: found[name] for name in self._computed}
        except SensorError:
            raise
        except Exception as error:  # in external code
            raise SensorError(
                f'the features of {type(self._own).__name__} cannot be computed: '
                f'{type(error).__name__}: {error}'
            ) from error


def load_world(domain: str) -> World:
    """
    Read a world: ``ros:FILE.yaml`` or ``ros:FILE.py:CLASS``.

    :raises WorldFileError: the world cannot be used.
    """
    path, name = robot_file(domain)
    if path.suffix != '.py':
        return World(read_world_file(path), path.name)
    if not name:
        raise WorldFileError(f'{path.name}: name its class, such as ros:{path.name}:Rover')
    own = _made(path, name)
    return World(checked_world(getattr(own, 'world', None), path.name), path.name, own)


def _made(path: Path, name: str) -> WorldClass:
    """Import a file, and create an instance of its class."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    try:
        if spec is None or spec.loader is None:
            raise ImportError('it is not a Python file')
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        kind = getattr(module, name, None)
        if not inspect.isclass(kind) or not callable(getattr(kind, 'features', None)):
            raise ImportError(f'it has no class {name} with the method features(messages)')
        made: WorldClass = cast(WorldClass, kind())
    except (Exception, SystemExit) as error:  # in external code
        raise WorldFileError(
            f'{path.name} cannot be loaded: {type(error).__name__}: {error}'
        ) from error
    return made


def _described(file: WorldFile) -> DescribedDomain:
    domain = DescribedDomain(
        file.name,
        {},
        [as_feature(name, spec) for name, spec in file.features.items()],
        [
            Action(
                name,
                spec.key,
                spec.description or _description(name, spec, file),
                file.seconds_of(spec) + file.settle_of(spec),
                spec.idle,
            )
            for name, spec in file.actions.items()
        ],
        file.gamma,
        file.max_steps,
    )
    check_description(domain)
    return domain


def _description(name: str, spec: ActionSpec, file: WorldFile) -> str:
    if spec.twist is not None:
        return f'{name.replace("_", " ")}, {file.seconds_of(spec):g} s'
    return f'{name.replace("_", " ")} ({getattr(spec, spec.way)})'


def _reward_reader(file: WorldFile) -> Callable[[Sensors], float] | None:
    if file.reward.field is None:
        return None
    read: Read = value_reader(file, file.reward.field, 'reward field')

    def number(sensors: Sensors) -> float:
        value = read(sensors)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise SensorError(f'the reward is {type(value).__name__}, not a number') from None

    return number


def _condition(domain: DescribedDomain, text: str, number: int) -> FeatureColumn:
    try:
        column = derive(domain, text)
    except FormulaError as error:
        raise WorldFileError(f'ends {number + 1} when: {error}') from None
    if column.feature.values != NO_YES:
        raise WorldFileError(
            f'ends {number + 1} when: {text!r} is a number; compare it, as in {text} < 0.2'
        )
    return column


def _checked(feature: Feature, spec: Any, value: Any) -> float:
    try:
        return checked_value(feature, spec, value)
    except SensorError as error:
        raise SensorError(f'the feature {feature.name} cannot be used: {error}') from None


def _outside(feature: Feature, value: float) -> str:
    return (
        f'the feature {feature.name} is out of its range {feature.low:g} to {feature.high:g}: it '
        f'is {value:g}; only a person can drive it back (or widen the range, or add clip: yes)'
    )
