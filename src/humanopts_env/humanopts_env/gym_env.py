"""
The domains of this package as Gymnasium environments.

Importing this module registers them, so either of these works::

    import humanopts_env.gym_env
    env = gymnasium.make('humanopts/Taxi-v0', rows=10, cols=10)

    env = gymnasium.make('humanopts_env.gym_env:humanopts/PacMan-v0', ghosts='chase')
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec
from humanopts_env.arrays import Floats
from humanopts_env.board import board_text
from humanopts_env.domains.base import (
    Domain,
    EnumerableDomain,
    Feature,
    FeatureKind,
    is_enumerable,
    Parameter,
    Transitions,
)
from humanopts_env.domains.capabilities import board_of, HasActionMask
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

ENVIRONMENTS = {  # by Gymnasium id: the domain
    'humanopts/PacMan-v0': 'pacman',
    'humanopts/Rooms-v0': 'rooms',
    'humanopts/Taxi-v0': 'taxi',
}
_ENTRY_POINT = 'humanopts_env.gym_env:DomainEnv'

# P[state][action] lists (probability, successor, reward, terminated)
Tabular = dict[int, dict[int, list[tuple[float, int, float, bool]]]]
Mask = NDArray[np.int8]


class DomainEnv(gymnasium.Env[Any, Any]):
    """
    A domain as an environment; actions are indices into ``domain.actions``.

    An observation is the index of the state if states can be listed. Otherwise it has the value
    of every feature, in the order of ``domain.features``: as indices into the features' ``values``
    or, if any feature is continuous, in a ``Box`` of float64.

    ``info['action_mask']`` (A,) is 1 for the actions that can change the state, as in Gymnasium's
    Taxi, and for all actions if that is unknown; ``action_space.sample(mask)`` draws among them.
    The other actions are allowed, too.

    :ivar domain: the rules, with ``features``, ``actions`` and ``decode``.
    """

    metadata: dict[str, Any] = {'render_modes': ['ansi'], 'render_fps': 4}

    def __init__(
        self, domain: str, render_mode: str | None = None, **parameters: Parameter
    ) -> None:
        """
        Create the environment of a registered domain.

        :param domain: name of the domain; ``parameters`` are its parameters, such as rows.
        :param render_mode: 'ansi' for text, or None.
        :raises DomainError: the domain is unknown, or it refuses the parameters.
        """
        self.domain: Domain = make_domain(domain, parameters)
        self.render_mode = render_mode
        self.action_space = gymnasium.spaces.Discrete(len(self.domain.actions))
        if is_enumerable(self.domain):
            self.observation_space = gymnasium.spaces.Discrete(self.domain.n_states)
        else:
            self.observation_space = _feature_space(self.domain.features)
        self._now: Any = None
        self._steps = 0

    def observe(self, state: Any) -> Any:
        """Return the observation of a state."""
        if is_enumerable(self.domain):
            return self.domain.index(state)
        return self.domain.feature_values(state).astype(self.observation_space.dtype)

    @property
    def state(self) -> Any:
        """
        The current state of the domain.

        :raises ResetNeeded: no episode was started.
        """
        return self._state('state')

    def features(self) -> Floats:
        """
        Return the current value of every feature of the domain, (F,).

        :raises ResetNeeded: no episode was started.
        """
        return self.domain.feature_values(self._state('features'))

    def action_mask(self, state: Any) -> Mask:
        """Return (A,): 1 for the actions that can change the state."""
        if isinstance(self.domain, HasActionMask):
            return self.domain.action_mask(state)
        if not is_enumerable(self.domain):
            return np.ones(len(self.domain.actions), dtype=np.int8)
        mask: Mask = self._masks[self._listed.index(state)]
        return mask.copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """
        Start an episode.

        :param options: ``{'state': text}`` sets the start state in the domain's notation;
            ``{'game_seed': number}`` uses the same random draws as the node game after a reset
            with this seed.
        :raises StateError: the text is not a state.
        """
        super().reset(seed=seed)
        text, game_seed = map((options or {}).get, ('state', 'game_seed'))
        if game_seed is not None:
            self.np_random = generator(game_seed, 'episode', self.domain.name)
        self._now = self.domain.reset(self.np_random) if text is None else self.domain.decode(text)
        self._steps = 0
        return self.observe(self._now), {'action_mask': self.action_mask(self._now)}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """
        Take one primitive action; the episode is truncated at the domain's ``max_steps``.

        :raises ResetNeeded: no episode was started.
        :raises DomainError: the action is unknown, or the episode has ended.
        """
        outcome = self.domain.step(self._state('step'), int(action), self.np_random)
        self._now, self._steps = outcome.state, self._steps + 1
        truncated = not outcome.terminated and 0 < self.domain.max_steps <= self._steps
        info = {'action_mask': self.action_mask(self._now)}
        return self.observe(self._now), outcome.reward, outcome.terminated, truncated, info

    def render(self) -> str | None:
        """
        Return the drawing of the state in render mode 'ansi', else None.

        :raises ResetNeeded: no episode was started.
        """
        state = self._state('render')
        return board_text(board_of(self.domain, state)) if self.render_mode == 'ansi' else None

    def _state(self, call: str) -> Any:
        if self._now is None:
            raise gymnasium.error.ResetNeeded(f'call env.reset() before env.{call}()')
        return self._now

    @property
    def _listed(self) -> EnumerableDomain:
        if not is_enumerable(self.domain):
            raise AttributeError(f'the states of {self.domain.name} cannot be listed')
        return self.domain

    @cached_property
    def _masks(self) -> Mask:
        """(S, A): 1 for the actions that can lead to another state."""
        table: Transitions = self._listed.transitions()
        other = table.successor != np.arange(len(table.successor))[:, None, None]
        masks: Mask = (other & (table.probability > 0)).any(axis=2).astype(np.int8)
        return masks

    @cached_property
    def P(self) -> Tabular:  # noqa: N802, Gymnasium's own name
        """The transitions in Gymnasium's tabular form, built on first use."""
        table = self._listed.transitions()
        axes = table.probability, table.successor, table.reward, table.terminated
        rows = zip(*(axis.tolist() for axis in axes))
        return {
            state: {
                action: [entry for entry in zip(*outcomes) if entry[0] > 0]
                for action, outcomes in enumerate(zip(*row))
            }
            for state, row in enumerate(rows)
        }

    @cached_property
    def initial_state_distrib(self) -> Floats:
        """Probability of each start state, (S,), in Gymnasium's tabular form."""
        starts = self._listed.start_states()
        share = np.zeros(self._listed.n_states)
        share[starts] = 1 / len(starts)
        return share


def spec_of(domain: Domain) -> EnvSpec:
    """Return the specification of a domain's environment for ``gymnasium.make``."""
    names = {known: name for name, known in ENVIRONMENTS.items()}
    name = names.get(domain.name, 'humanopts/Table-v0')
    return EnvSpec(name, _ENTRY_POINT, kwargs={'domain': domain.name, **domain.parameters})


def _feature_space(features: Sequence[Feature]) -> gymnasium.Space[Any]:
    if all(feature.kind is not FeatureKind.CONTINUOUS for feature in features):
        sizes = [len(feature.values) for feature in features]
        return gymnasium.spaces.MultiDiscrete(sizes, dtype=np.int32)
    lowest = np.array([feature.low for feature in features])  # 0 for other features
    highest = lowest + [feature.span for feature in features]
    return gymnasium.spaces.Box(lowest, highest, dtype=np.float64)


def register_all() -> None:
    """Register the environments of this package with Gymnasium, once."""
    for name, domain in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=_ENTRY_POINT, kwargs={'domain': domain})


register_all()
