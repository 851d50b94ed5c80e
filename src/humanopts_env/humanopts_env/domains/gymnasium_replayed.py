"""
Gymnasium environments without a table as domains: a state is a seed and the actions since reset.

Any registered environment with a ``Discrete`` action space can be played. Its features are read
from its observations or by an extractor; see ``extractors``.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
import math
import os
import time
from typing import Any, ClassVar

from gymnasium import spaces
from humanopts_env.arrays import Floats
from humanopts_env.domains.base import Action, Domain, DomainError
from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.domains.extractors import ACTIONS, Extractor, find_extractor
from humanopts_env.domains.gymnasium_domain import (
    GAMMA,
    gymnasium_domain,
    make_env,
    MAX_STEPS,
    NoTableError,
)
from humanopts_env.domains.names import GYMNASIUM
from humanopts_env.domains.replayed_domain import check_pace, History, ReplayedDomain, SIGNS
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

# Keep pygame, which draws most environments, from opening a window or a sound device.
for _name, _value in {
    'SDL_VIDEODRIVER': 'dummy',
    'SDL_AUDIODRIVER': 'dummy',
    'PYGAME_HIDE_SUPPORT_PROMPT': '1',
}.items():
    os.environ.setdefault(_name, _value)

WALKS, WALK = 4, 25  # random walks for measuring ranges, and steps of each
FEW = 8  # maximum number of features to ask people about one by one
WORDS_OF_KEYS = (  # key, and words; the first action with one of the words gets the key
    ('left', 'left west minus'),
    ('right', 'right east plus'),
    ('up', 'up north forward main gas faster accelerate'),
    ('down', 'down south backward back brake slower'),
    ('down', 'nothing noop idle coast wait zero'),
)


class Painter:
    """
    Draws the states of an environment with a second one, which takes the same actions.

    Drawing slows many environments down: LunarLander by a factor of ten, since its engines emit
    particles.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        """Store the function that makes the second environment."""
        self._make, self._env, self._seed = make, None, -1
        self._done: list[int] = []  # actions

    def draw(self, seed: int, actions: Sequence[int]) -> NDArray[np.uint8] | str | None:
        """Return the rendering after some actions; the next call continues if it can."""
        env = self._env = self._env or self._make()
        if env.render_mode is None:
            return None
        known = len(self._done)
        if seed != self._seed or self._done != actions[:known]:
            env.reset(seed=seed)
            known = 0
        self._seed = -1  # unknown until all steps are taken
        for action in actions[known:]:
            env.step(action)
        self._seed, self._done = seed, list(actions)
        drawn = env.render()
        return drawn if isinstance(drawn, str) else np.array(drawn, dtype=np.uint8)


class EnvironmentWorld:
    """A Gymnasium environment as a ``World``; features and pictures are copies."""

    def __init__(self, name: str, env: Any, extractor: Extractor, painter: Painter) -> None:
        """
        Wrap an environment.

        :param name: name of the domain, for errors.
        """
        self.name, self.env, self._extractor, self._painter = name, env, extractor, painter
        self._seed, self._actions = -1, list[int]()
        self._first = int(env.action_space.start)
        self._inner = env.unwrapped
        self.observation: Any = None  # the newest

    def reset(self, seed: int) -> None:
        """
        Start an episode.

        :raises DomainError: the environment raised an error.
        """
        try:
            self.observation, _ = self.env.reset(seed=seed)
            self._seed, self._actions = seed, []
        except Exception as error:
            raise self._failed('the reset', error) from error

    def step(self, action: int) -> tuple[float, bool]:
        """
        Take an action; return the reward and whether the episode has terminated.

        Truncation by the environment is ignored; the domain truncates after ``max_steps``.

        :raises DomainError: the environment raised an error.
        """
        try:
            self._actions.append(self._first + action)
            self.observation, reward, terminated, _, _ = self.env.step(self._actions[-1])
            return float(reward), bool(terminated)
        except Exception as error:
            raise self._failed('a step', error) from error

    def features(self) -> Sequence[float]:
        """
        Return the value of every feature.

        :raises DomainError: the extractor raised an error, or a value is not a number.
        """
        try:
            values = self._extractor.read(self._inner, self.observation)
        except Exception as error:
            raise self._failed(f'the features {self._extractor.name}', error) from error
        if any(map(math.isnan, values)):
            names = [feature.name for feature in self._extractor.features]
            lost = ', '.join(name for name, value in zip(names, values) if math.isnan(value))
            raise DomainError(
                f'the features {self._extractor.name} of {self.name} failed: {lost} is nan'
            )
        return values

    def picture(self) -> NDArray[np.uint8] | str | None:
        """
        Return the rendering: an image (H, W, 3), a text, or None if there is none.

        :raises DomainError: the environment raised an error.
        """
        try:
            return self._painter.draw(self._seed, self._actions)
        except Exception as error:
            raise self._failed('the picture', error) from error

    def _failed(self, what: str, error: Exception) -> DomainError:
        return DomainError(f'{what} of {self.name} failed: {type(error).__name__}: {error}')


class ReplayedEnvironment(ReplayedDomain):
    """
    The domain of one environment; ``replayed_environment`` creates a class for each id.

    Its parameters are the environment's keyword arguments, ``features`` and measured ``ranges``.
    """

    env_id: ClassVar[str] = ''

    def __init__(
        self, *, features: str = '', ranges: Mapping[str, Any] | None = None, **arguments: Any
    ) -> None:
        """
        Create the environment and find its features.

        :param features: see ``find_extractor``.
        :param ranges: ranges by feature name, in place of declared or measured ones.
        :param arguments: arguments of the environment; JSON values only.
        :raises DomainError: the environment is unknown, refuses the arguments, has no discrete
            actions, or its features cannot be used.
        """
        self.name = GYMNASIUM + self.env_id
        self._arguments = arguments
        env = make_env(self.name, self.env_id, arguments)
        if not isinstance(env.action_space, spaces.Discrete):
            raise DomainError(
                f'{self.name} has the actions {env.action_space}, and only environments with '
                'Discrete actions can be taught; wrap it, or choose a variant with such actions'
            )
        modes = env.metadata.get('render_modes') or ()
        drawn = next((mode for mode in ('rgb_array', 'ansi') if mode in modes), None)
        self._painter = Painter(partial(make_env, self.name, self.env_id, arguments, drawn))
        try:
            self._extractor = find_extractor(
                self.name, features, env, ranges or {}, partial(_walks, self.name, env)
            )
        except DomainError:
            raise
        except Exception as error:
            raise DomainError(
                f'{self.name} or its features {features} failed: {type(error).__name__}: {error}'
            ) from error
        measured = self._extractor.ranges
        self.parameters: dict[str, Any] = {**arguments, 'features': self._extractor.name}
        if measured:
            self.parameters['ranges'] = measured
        self.features = self._extractor.features
        self.actions = named_actions(self.name, env, self._extractor.actions)
        self.gamma = GAMMA
        own = getattr(env.unwrapped, 'max_steps', None)  # as in MiniGrid
        self.max_steps = env.spec.max_episode_steps or (
            own if isinstance(own, int) and own > 0 else MAX_STEPS
        )
        self.feature_groups = groups_of([feature.name for feature in self.features])

    def make_world(self) -> EnvironmentWorld:
        """Return a new environment."""
        env = make_env(self.name, self.env_id, self._arguments)
        self._extractor.prepare(env.unwrapped)
        return EnvironmentWorld(self.name, env, self._extractor, self._painter)

    def read_features(self, env: Any, observation: Any) -> Floats:
        """
        Return the features (F,) of an environment with this id that another program steps.

        :param env: the environment without wrappers.
        """
        return np.array(self._extractor.read(env, observation), dtype=np.float64)

    def caption(self, state: History) -> str:
        """Return the mission of the environment, if it has one."""
        return str(getattr(self.world(state).env.unwrapped, 'mission', ''))  # type: ignore[attr-defined]

    def __reduce__(self) -> tuple[Callable[..., Domain], tuple[str, dict[str, Any]]]:
        """Pickle the id and the parameters."""
        return _make, (self.env_id, self.parameters)


def _make(env_id: str, parameters: Mapping[str, Any]) -> Domain:
    return replayed_environment(env_id)(**parameters)


@cache
def replayed_environment(env_id: str) -> type[ReplayedEnvironment]:
    """Return the domain of one environment id, such as ``MiniGrid-DoorKey-8x8-v0``."""
    return type('ReplayedEnvironment', (ReplayedEnvironment,), {'env_id': env_id})


@cache
def domain_of_environment(env_id: str) -> Callable[..., Domain]:
    """
    Return the constructor of the domain of an environment.

    The domain is read from the environment's table if there is one and neither ``features`` nor
    ``ranges`` are given; otherwise it is replayed.
    """

    def make(**arguments: Any) -> Domain:
        if not {'features', 'ranges'} & arguments.keys():
            try:
                return gymnasium_domain(env_id)(**arguments)
            except NoTableError:
                pass
        return replayed_environment(env_id)(**arguments)

    return make


def named_actions(name: str, env: Any, given: Mapping[str, str]) -> tuple[Action, ...]:
    """
    Return the actions of an environment.

    The names come from the extractor, ``ACTIONS`` (for documented environments) or the
    environment's ``get_action_meanings``. Otherwise the actions are numbered.

    :raises DomainError: there are more actions than keys, or than names.
    """
    count, inner = int(env.action_space.n), env.unwrapped
    if count > len(SIGNS):
        raise DomainError(f'{name} has {count} actions, and there are keys for {len(SIGNS)}')
    if given and len(given) < count:
        raise DomainError(f'{name} has {count} actions, and ACTIONS names {len(given)}')
    names: Iterable[str] = given or ACTIONS.get(env.spec.name, ())
    if not names and hasattr(inner, 'get_action_meanings'):
        names = [str(each).lower().replace(' ', '_') for each in inner.get_action_meanings()]
    names = [*names][:count] or [f'action_{number}' for number in range(count)]
    keys: dict[str, str] = {}  # by name
    for key, words in WORDS_OF_KEYS:
        fitting = [n for n in names if n not in keys and {*n.split('_')} & {*words.split()}]
        if fitting and key not in keys.values():
            keys[fitting[0]] = key
    for each in names:
        letters = each.rpartition('_')[2] + each.replace('_', '') + SIGNS
        if each not in keys:
            keys[each] = next(key for key in letters if key not in keys.values())
    return tuple(
        Action(each, keys[each], given.get(each, each.replace('_', ' '))) for each in names
    )


def groups_of(names: Sequence[str]) -> list[FeatureGroup]:
    """Group the features of each object, such as key_row and key_path, if there are many."""
    groups = dict[str, list[str]]()
    for name in names:
        groups.setdefault(name.rpartition('_')[0], []).append(name)
    return [
        FeatureGroup(f'the {thing.replace("_", " ")}', tuple(members))
        for thing, members in groups.items()
        if thing and 1 < len(members) < len(names) and len(names) > FEW
    ]


def _walks(name: str, env: Any) -> Iterator[tuple[Any, Any]]:
    """Take random walks; yield the environment and its observation after each step."""
    steps, began = 0, time.perf_counter()
    for seed in range(WALKS):
        seen, _ = env.reset(seed=seed)
        yield env.unwrapped, seen
        for action in generator(seed, 'walk').integers(int(env.action_space.n), size=WALK):
            seen, _, terminated, _, _ = env.step(int(env.action_space.start + action))
            yield env.unwrapped, seen
            steps += 1
            check_pace(name, began, steps)
            if terminated:
                break
