"""
Our domains as Gymnasium environments.

Importing this module registers them, so any of these works::

    import humanopts_env.gym_env
    env = gymnasium.make('humanopts/Taxi-v0', rows=10, cols=10)

    env = gymnasium.make('humanopts_env.gym_env:humanopts/Taxi-v0')
"""

from functools import cached_property
from typing import Any

import gymnasium
from humanopts_env.domains.base import DomainError, is_enumerable, Parameter
from humanopts_env.domains.registry import make_domain
import numpy as np

ENVIRONMENTS = {  # Gymnasium id: domain
    'humanopts/Rooms-v0': 'rooms',
    'humanopts/Taxi-v0': 'taxi',
}

# P[state][action] lists (probability, successor, reward, terminated)
Tabular = dict[int, dict[int, list[tuple[float, int, float, bool]]]]


class DomainEnv(gymnasium.Env[Any, Any]):
    """
    An enumerable domain; observations are state indices, actions are action indices.

    :ivar domain: the rules, with ``features``, ``actions`` and ``decode``.
    """

    metadata: dict[str, Any] = {'render_modes': ['ansi'], 'render_fps': 4}

    def __init__(
        self, domain: str, render_mode: str | None = None, **parameters: Parameter
    ) -> None:
        """
        Make the environment of a registered domain.

        :param domain: its name; ``parameters`` are its own, such as rows.
        :param render_mode: 'ansi' for text, or None.
        :raises DomainError: no such domain, it refuses the parameters or is not enumerable.
        """
        rules = make_domain(domain, parameters)
        if not is_enumerable(rules):
            raise DomainError(f'the states of {domain} cannot be listed, as Gymnasium needs here')
        self.domain = rules
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Discrete(rules.n_states)
        self.action_space = gymnasium.spaces.Discrete(len(rules.actions))
        self._state: Any = None
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """
        Begin an episode.

        :param options: ``{'state': text}`` begins in a state in the domain's notation.
        :raises StateError: that text is not a state.
        """
        super().reset(seed=seed)
        self._steps = 0
        text = (options or {}).get('state')
        self._state = (
            self.domain.reset(self.np_random) if text is None else self.domain.decode(text)
        )
        return self.domain.index(self._state), {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """
        Take one primitive action; the episode is truncated at the domain's ``max_steps``.

        :raises DomainError: no such action, or the episode has ended.
        """
        outcome = self.domain.step(self._state, int(action), self.np_random)
        self._state, self._steps = outcome.state, self._steps + 1
        truncated = not outcome.terminated and 0 < self.domain.max_steps <= self._steps
        return self.domain.index(outcome.state), outcome.reward, outcome.terminated, truncated, {}

    def render(self) -> str | None:
        """Return the drawing of the state in render mode 'ansi', else None."""
        return self.domain.render(self._state) if self.render_mode == 'ansi' else None

    @cached_property
    def P(self) -> Tabular:  # noqa: N802, Gymnasium's own name
        """The transitions in Gymnasium's tabular form, built when first asked for."""
        table = self.domain.transitions()
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
    def initial_state_distrib(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Probability of each state (S,) to be the first, in Gymnasium's tabular form."""
        starts = self.domain.start_states()
        share = np.zeros(self.domain.n_states)
        share[starts] = 1 / len(starts)
        return share


def register_all() -> None:
    """Register our environments with Gymnasium, once."""
    for name, domain in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point='humanopts_env.gym_env:DomainEnv',
                kwargs={'domain': domain},
            )


register_all()
