"""
Running one option to its end: the rules of the one runner, without the graph around them.

A caller asks for the next action, sends it to the game, and reports what came back.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.library import RunnableOption
from humanopts_learner.options.option import Mode
import numpy as np
from numpy.typing import NDArray


class Status(IntEnum):
    """How a run ended, or why it was refused; numbers as in ``OptionResult.msg``."""

    REACHED = 1
    EPISODE_OVER = 2
    MAX_STEPS = 3
    NO_PROGRESS = 4
    INTERRUPTED = 5
    CANCELED = 6
    BUSY = 7
    UNKNOWN_OPTION = 8
    NOT_AVAILABLE = 9
    NO_EPISODE = 10
    FAILED = 11


TEXT = {
    Status.REACHED: 'its termination condition holds',
    Status.EPISODE_OVER: 'the episode ended',
    Status.MAX_STEPS: 'it was cut off at its step limit',
    Status.NO_PROGRESS: 'the game did not answer before the deadline',
    Status.INTERRUPTED: 'a person took control, or the game was reset',
    Status.CANCELED: 'it was canceled',
    Status.BUSY: 'refused: another run is under way',
    Status.UNKNOWN_OPTION: 'refused: there is no such option',
    Status.NOT_AVAILABLE: 'refused: the option cannot start in this state',
    Status.NO_EPISODE: 'refused: no episode is under way',
    Status.FAILED: 'it failed',
}


class RunError(RuntimeError):
    """A run was driven out of order; the text says how."""


@dataclass(frozen=True)
class End:
    """How a run ended; fields as in ``OptionResult.msg``."""

    status: Status
    detail: str  # the status in words
    option_name: str
    episode: int = 0
    first_step: int = 0
    step_count: int = 0  # k
    total_reward: float = 0.0  # sum of r[i], i = 0..k-1
    discounted_return: float = 0.0  # sum of gamma**i * r[i]
    final_state: str = ''  # in the domain's notation
    terminated: bool = False
    truncated: bool = False


def refusal(status: Status, option_name: str, detail: str = '') -> End:
    """
    Return the answer to a request that did not become a run.

    :param detail: more about it, put after the status's own text.
    """
    return End(status, _describe(status, detail), option_name)


class OptionRun:
    """
    One run of an option: ``begin``, then ``next_action`` and ``observe`` in turn until an ``End``.

    The option ends, in this order of precedence: REACHED where its termination condition holds,
    which is looked at only after a step, even if the episode ends there too (``End.terminated``
    and ``truncated`` tell); EPISODE_OVER where the episode ended, by the task's end or at its
    step limit; MAX_STEPS after ``max_steps`` steps.
    """

    def __init__(
        self,
        option: RunnableOption,
        domain: Domain[Any],
        gamma: float,
        max_steps: int = 0,
        mode: Mode = Mode.GREEDY,
        rng: np.random.Generator | None = None,
    ) -> None:
        """
        Prepare a run.

        :param max_steps: 0: the option's own limit.
        :param rng: what the sampled mode draws from; the greedy mode draws nothing.
        :raises RunError: the sampled mode has nothing to draw from, or max_steps is negative.
        """
        if mode is Mode.SAMPLED and rng is None:
            raise RunError('the sampled mode needs a random generator')
        if max_steps < 0:
            raise RunError(f'max_steps is {max_steps}, and must be 0 or greater')
        self.option = option
        self.max_steps = max_steps or option.max_steps
        self.step_count = 0
        self.total_reward = 0.0
        self.discounted_return = 0.0
        self._domain, self._gamma, self._mode = domain, gamma, mode
        self._rng = rng or np.random.default_rng(0)  # not drawn from in the greedy mode
        self._state: Any = None
        self._episode = self._first_step = 0
        self._terminated = self._truncated = False
        self._path: list[Any] = []  # states in which it acted
        self._going = False

    def begin(self, state: Any, episode: int, step: int) -> End | None:
        """
        Start in a state of the game.

        :param episode: number of the episode; 0: none was begun yet.
        :return: the refusal, where the option cannot run from here.
        """
        if self._path or self._going:
            raise RunError('the run has begun already')
        self._state, self._episode, self._first_step = state, episode, step
        if episode == 0 or self._domain.is_over(state):
            return self.end(Status.NO_EPISODE)
        if not self.option.can_start(self._row()[None])[0]:
            return self.end(Status.NOT_AVAILABLE, self._domain.encode(state))
        self._going = True
        return None

    def next_action(self) -> int:
        """Return the index of the action to take now."""
        self._check_going()
        return self.option.choose_action(self._row(), self._mode, self._rng)

    def observe(self, state: Any, reward: float, terminated: bool, truncated: bool) -> End | None:
        """
        Take in what the action led to.

        :param terminated: the task is over in ``state``.
        :param truncated: the episode was cut off there.
        :return: how the run ended; None while it goes on.
        """
        self._check_going()
        self._path.append(self._state)
        self._state = state
        self.total_reward += reward
        self.discounted_return += self._gamma**self.step_count * reward
        self.step_count += 1
        self._terminated, self._truncated = terminated, truncated
        if self.option.choose_end(self._row(), self._mode, self._rng):
            return self.end(Status.REACHED)
        if terminated or truncated:
            why = 'the task is over' if terminated else 'at its step limit'
            return self.end(Status.EPISODE_OVER, why)
        if self.step_count >= self.max_steps:
            return self.end(Status.MAX_STEPS, self._cut_off())
        return None

    def end(self, status: Status, detail: str = '') -> End:
        """
        End the run from outside: canceled, interrupted, no progress, failed.

        :param detail: more about it, put after the status's own text.
        """
        self._going = False
        return End(
            status=status,
            detail=_describe(status, detail),
            option_name=self.option.name,
            episode=self._episode,
            first_step=self._first_step,
            step_count=self.step_count,
            total_reward=self.total_reward,
            discounted_return=self.discounted_return,
            final_state='' if self._state is None else self._domain.encode(self._state),
            terminated=self._terminated,
            truncated=self._truncated,
        )

    def _row(self) -> NDArray[np.int32]:
        return self._domain.feature_values(self._state)

    def _check_going(self) -> None:
        if not self._going:
            raise RunError('the run has not begun, or has ended')

    def _cut_off(self) -> str:
        """Say how long the run was, and where it walked in a circle if it did for certain."""
        text = f'{self.max_steps} steps'
        seen: dict[Any, int] = {}
        for step, state in enumerate([*self._path, self._state]):
            if state in seen and self._certain():
                length = step - seen[state]
                where = self._domain.encode(state)
                return f'{text}; it walked in a circle of {length} through {where}'
            seen[state] = step
        return text

    def _certain(self) -> bool:
        """Tell whether a state that comes again must come again and again."""
        domain = self._domain
        greedy = self._mode is Mode.GREEDY
        return greedy and is_enumerable(domain) and domain.transitions().deterministic


def _describe(status: Status, detail: str) -> str:
    return f'{TEXT[status]}: {detail}' if detail else TEXT[status]
