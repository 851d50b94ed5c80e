"""
The domains of this package as Gymnasium environments.

Importing this module registers them, so any of these works::

    import humanopts_env.gym_env
    env = gymnasium.make('humanopts/Taxi-v0', rows=10, cols=10)

    env = gymnasium.make('humanopts_env.gym_env:humanopts/PacMan-v0', ghosts='chase')
"""

from abc import abstractmethod
from functools import cached_property
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec
from humanopts_env.domains.base import Domain, DomainError, is_enumerable, Parameter
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.paths import HAS_MOVE
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

ENVIRONMENTS = {  # Gymnasium id: class and domain
    'humanopts/PacMan-v0': ('PacManEnv', {}),
    'humanopts/Rooms-v0': ('TableEnv', {'domain': 'rooms'}),
    'humanopts/Taxi-v0': ('TableEnv', {'domain': 'taxi'}),
}

# P[state][action] lists (probability, successor, reward, terminated)
Tabular = dict[int, dict[int, list[tuple[float, int, float, bool]]]]
Mask = NDArray[np.int8]


class DomainEnv(gymnasium.Env[Any, Any]):
    """
    A domain; actions are action indices.

    ``info['action_mask']`` (A,) is 1 for the actions that can change something, as in Gymnasium's
    Taxi; ``action_space.sample(mask)`` draws among them. The others are allowed too.

    :ivar domain: the rules, with ``features``, ``actions`` and ``decode``.
    """

    metadata: dict[str, Any] = {'render_modes': ['ansi'], 'render_fps': 4}
    domain: Domain[Any]

    def __init__(self, domain: Domain[Any], render_mode: str | None) -> None:
        """
        Make the environment of a domain.

        :param render_mode: 'ansi' for text, or None.
        """
        self.domain = domain
        self.render_mode = render_mode
        self.action_space = gymnasium.spaces.Discrete(len(domain.actions))
        self._now: Any = None
        self._steps = 0

    @abstractmethod
    def observe(self, state: Any) -> Any:
        """Return the observation of a state."""

    @abstractmethod
    def action_mask(self, state: Any) -> Mask:
        """Return (A,): 1 for the actions that can change something."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """
        Begin an episode.

        :param options: ``{'state': text}`` begins in a state in the domain's notation;
            ``{'game_seed': number}`` uses the random draws of the node game after a reset with
            that seed.
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

        :raises ResetNeeded: no episode was begun.
        :raises DomainError: there is no such action, or the episode has ended.
        """
        outcome = self.domain.step(self._state('step'), int(action), self.np_random)
        self._now, self._steps = outcome.state, self._steps + 1
        truncated = not outcome.terminated and 0 < self.domain.max_steps <= self._steps
        info = {'action_mask': self.action_mask(self._now)}
        return self.observe(self._now), outcome.reward, outcome.terminated, truncated, info

    def render(self) -> str | None:
        """
        Return the drawing of the state in render mode 'ansi', else None.

        :raises ResetNeeded: no episode was begun.
        """
        state = self._state('render')
        return self.domain.render(state) if self.render_mode == 'ansi' else None

    def _state(self, call: str) -> Any:
        if self._now is None:
            raise gymnasium.error.ResetNeeded(f'call env.reset() before env.{call}()')
        return self._now


class TableEnv(DomainEnv):
    """An enumerable domain; observations are state indices."""

    def __init__(
        self, domain: str, render_mode: str | None = None, **parameters: Parameter
    ) -> None:
        """
        Make the environment of a registered domain.

        :param domain: the domain's name; ``parameters`` are those of the domain, such as rows.
        :raises DomainError: there is no such domain, it refuses the parameters, or it is not
            enumerable.
        """
        rules = make_domain(domain, parameters)
        if not is_enumerable(rules):
            raise DomainError(f'the states of {domain} cannot be listed, as Gymnasium needs here')
        super().__init__(rules, render_mode)
        self._table = rules
        self.observation_space = gymnasium.spaces.Discrete(rules.n_states)

    def observe(self, state: Any) -> int:
        """Return the index of a state."""
        return self._table.index(state)

    def action_mask(self, state: Any) -> Mask:
        """Return (A,): 1 for the actions that can lead to another state."""
        mask: Mask = self._masks[self._table.index(state)]
        return mask.copy()

    @cached_property
    def _masks(self) -> Mask:
        """(S, A)."""
        table = self._table.transitions()
        other = table.successor != np.arange(self._table.n_states)[:, None, None]
        masks: Mask = (other & (table.probability > 0)).any(axis=2).astype(np.int8)
        return masks

    @cached_property
    def P(self) -> Tabular:  # noqa: N802, Gymnasium's own name
        """The transitions in Gymnasium's tabular form, built when they are first used."""
        table = self._table.transitions()
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
    def initial_state_distrib(self) -> NDArray[np.float64]:
        """Probability of each state (S,) to be the first, in Gymnasium's tabular form."""
        starts = self._table.start_states()
        share = np.zeros(self._table.n_states)
        share[starts] = 1 / len(starts)
        return share


class PacManEnv(DomainEnv):
    """
    Pac-Man; observations are the values of its features, in the order of ``domain.features``.

    Each value is an index into the feature's ``values``: a row, a direction, a number of steps.
    """

    domain: PacMan

    def __init__(self, render_mode: str | None = None, **parameters: Parameter) -> None:
        """
        Make the environment of a maze.

        :param parameters: those of ``PacMan``: maze, ghosts, lives, max_steps and features.
        :raises DomainError: Pac-Man refuses the parameters.
        """
        super().__init__(make_domain('pacman', parameters), render_mode)
        sizes = [len(feature.values) for feature in self.domain.features]
        self.observation_space = gymnasium.spaces.MultiDiscrete(sizes, dtype=np.int32)

    def observe(self, state: Any) -> NDArray[np.int32]:
        """Return the value of every feature, (F,)."""
        return self.domain.feature_values(state)

    def action_mask(self, state: Any) -> Mask:
        """Return (A,): 1 for the moves that no wall blocks."""
        legal = self.domain.rules.paths.legal[state.pacman]
        mask: Mask = HAS_MOVE[legal].astype(np.int8)
        return mask


def spec_of(domain: Domain[Any]) -> EnvSpec:
    """
    Return the specification from which ``gymnasium.make`` makes a domain's environment.

    :raises DomainError: the domain is not enumerable, and has no environment of its own.
    """
    ours = f'humanopts/{domain.name}-v0'.lower()
    name = next((name for name in ENVIRONMENTS if name.lower() == ours), None)
    if name is not None:
        kind, kwargs = ENVIRONMENTS[name]
    elif is_enumerable(domain):
        name, kind, kwargs = 'humanopts/Table-v0', 'TableEnv', {'domain': domain.name}
    else:
        raise DomainError(f'there is no Gymnasium environment of {domain.name}')
    point = f'humanopts_env.gym_env:{kind}'
    return EnvSpec(name, point, kwargs={**kwargs, **domain.parameters})


def register_all() -> None:
    """Register the environments of this package with Gymnasium, once."""
    for name, (kind, kwargs) in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name, entry_point=f'humanopts_env.gym_env:{kind}', kwargs=dict(kwargs)
            )


register_all()
