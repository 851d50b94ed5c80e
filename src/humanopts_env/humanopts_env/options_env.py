"""Options as the actions of a Gymnasium environment, for learners of any library."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import partial
from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs
from humanopts_env.arrays import Flags, Floats
from humanopts_env.domains.base import Domain, DomainError, is_enumerable
from humanopts_env.domains.names import GYMNASIUM
from humanopts_env.domains.registry import make_domain
from humanopts_env.gym_env import DomainEnv
from humanopts_env.option import Option, runs_end
import numpy as np

MAX_REFUSALS = 100  # per episode
REFUSED = 'refused'


class OptionsEnv(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """
    An environment in which an action runs an option to its end (a semi-Markov decision process).

    The reward of a run of k steps is its discounted return, the sum of gamma**i * r[i]. An option
    that cannot start is refused and takes no step. The end or truncation of the episode ends the
    run. The episode is also truncated where no option can start, and after 100 refusals.

    Besides the entries of the last step, ``info`` has:

    ==================  ======================================================================
    ``duration``        k, the number of primitive steps; 0: refused
    ``discount``        gamma**k, the weight of the value of the next state; 0 if terminated
    ``undiscounted``    the sum of the rewards
    ``option_end``      ``reached`` (the termination condition holds), ``terminated``,
                        ``truncated``, ``max_steps`` or ``refused``
    ``action_mask``     (O,) 1 for the options that can start, for ``action_space.sample(mask)``
    ==================  ======================================================================

    After ``reset``, ``info`` has only ``action_mask`` of these.

    :ivar gamma: discount per primitive step.
    :ivar option_names: (O,) names of the options, then of primitive actions as ``action:NAME``.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        options: Sequence[Option],
        primitives: bool = False,
        gamma: float | None = None,
        features: str = '',
    ) -> None:
        """
        Replace the actions with options.

        :param options: options of the domain of the environment, such as learned ones; action n
            runs the n-th.
        :param primitives: whether to add the primitive actions after the options.
        :param gamma: discount per primitive step; None: that of the domain.
        :param features: extractor, as in the parameter of ``gymnasium:ID``; empty: the default.
        :raises DomainError: the primitive actions are not ``Discrete``, or there are no actions.
        """
        given = {'options': options, 'primitives': primitives, 'gamma': gamma}
        RecordConstructorArgs.__init__(self, **given, features=features, _disable_deepcopy=True)
        super().__init__(env)
        if not isinstance(env.action_space, gymnasium.spaces.Discrete):
            raise DomainError(f'options choose among numbered actions, not {env.action_space}')
        domain, self._feature_values = _features_of(env, features)
        self.gamma = domain.gamma if gamma is None else gamma
        self._options = tuple(options)
        self._first_action = int(env.action_space.start)
        actions = [f'action:{action.name}' for action in domain.actions] if primitives else []
        self.option_names = (*(option.name for option in options), *actions)
        if not self.option_names:
            raise DomainError('there are no options, and the primitive actions are left out')
        self.action_space = gymnasium.spaces.Discrete(len(self.option_names))

    def features(self) -> Floats:
        """Return the current values of the features of the domain, (F,)."""
        return self._row.copy()

    def action_masks(self) -> Flags:
        """
        Return (O,): whether each option can start; all True if none can.

        sb3-contrib uses this name. If no option can start, the episode is over, but a mask must
        leave a choice.
        """
        return self._startable.copy() if self._startable.any() else ~self._startable

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._row, self._refusals = self._feature_values(observation), 0
        self._arrive(observation)
        return observation, {**info, 'action_mask': self.action_masks().astype(np.int8)}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run an option to its end."""
        if not self._startable[action]:
            self._refusals += 1
            given_up = self._refusals >= MAX_REFUSALS or not self._startable.any()
            refusal = self._info(REFUSED, 0, 0.0, terminated=False)
            return deepcopy(self._observation), 0.0, False, given_up, refusal
        option = self._options[action] if action < len(self._options) else None
        primitive = self._first_action + int(action) - len(self._options)
        steps, discounted, undiscounted, ended = 0, 0.0, 0.0, False
        while not ended:
            taken = primitive
            if option is not None:
                taken = self._first_action + int(option.action(self._row[None])[0])
            observation, reward, terminated, truncated, info = self.env.step(taken)
            self._row = self._feature_values(observation)
            discounted += self.gamma**steps * float(reward)
            undiscounted += float(reward)
            steps += 1
            reached, ended = True, True
            if option is not None:
                ends = option.ends(self._row[None])
                reached = bool(ends[0])
                ended = bool(runs_end(ends, terminated or truncated, steps, option.max_steps)[0])
        ends_by = {'reached': reached, 'terminated': terminated, 'truncated': truncated}
        end = next((name for name, holds in ends_by.items() if holds), 'max_steps')
        self._arrive(observation)
        stuck = not terminated and not self._startable.any()
        info = {**info, **self._info(end, steps, undiscounted, terminated=terminated)}
        return observation, discounted, terminated, truncated or stuck, info

    def _arrive(self, observation: Any) -> None:
        """Keep the observation for refusals, and find the options that can start."""
        self._observation = deepcopy(observation)
        self._startable = np.ones(len(self.option_names), dtype=np.bool_)
        for number, option in enumerate(self._options):
            self._startable[number] = option.can_start(self._row[None])[0]

    def _info(
        self, end: str, steps: int, undiscounted: float, *, terminated: bool
    ) -> dict[str, Any]:
        return {
            'duration': steps,
            'discount': 0.0 if terminated else self.gamma**steps,
            'undiscounted': undiscounted,
            'option_end': end,
            'action_mask': self.action_masks().astype(np.int8),
        }


def _features_of(
    env: gymnasium.Env[Any, Any], features: str
) -> tuple[Domain, Callable[[Any], Floats]]:
    """
    Return the domain of an environment, and a function from an observation to the features (F,).

    :raises DomainError: the environment was not made by ``gymnasium.make``, or cannot be a domain.
    """
    inner: Any = env.unwrapped
    if isinstance(inner, DomainEnv):
        return inner.domain, lambda _: inner.features()
    if env.spec is None:
        raise DomainError(f'{inner} has no id: make it with gymnasium.make')
    arguments = {name: value for name, value in env.spec.kwargs.items() if name != 'render_mode'}
    extractor = {'features': features} if features else {}
    domain: Any = make_domain(f'{GYMNASIUM}{env.spec.id}', {**arguments, **extractor})
    if is_enumerable(domain):
        return domain, lambda _: domain.feature_values(inner.s)
    return domain, partial(domain.read_features, inner)
