"""
Execution of one option, or of options as modules: the rules of the runner, without the graph.

The caller asks for the next action, sends it to the game, and reports the state that it led to.
Between two actions an ``Arbiter`` says whether a plan interrupts the option. It decides by
``OptionValues``, which a message can carry, and as the vectorised play of plans does.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import ActableDomain, Domain, is_enumerable
from humanopts_env.games import Steps
from humanopts_learner.execution import (
    Choice,
    Execution,
    Fixed,
    RowOptions,
    Seen,
    SeenRows,
)
from humanopts_learner.library import RunnableOption
from humanopts_learner.option import DrawnOption, Mode
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.rollout import is_deterministic
from humanopts_learner.planning.action_set import ActionSet
from humanopts_learner.planning.interruption import arbitrate, interruptions, OptionValues
from humanopts_learner.planning.request import Arbitration, MODULAR, PlanError
from humanopts_learner.planning.sampled_policies import GreedyPolicy
import numpy as np

_ONE = np.zeros(1, dtype=np.intp)  # the number of the only game


class RunStatus(IntEnum):
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
    STOPPED_BY_PLAN = 12
    EXECUTION_CHANGED = 13
    NO_VALUES = 14
    BAD_REQUEST = 15


TEXT = {
    RunStatus.REACHED: 'its termination condition holds',
    RunStatus.EPISODE_OVER: 'the episode ended',
    RunStatus.MAX_STEPS: 'it was cut off at its step limit',
    RunStatus.NO_PROGRESS: 'the game did not answer before the deadline',
    RunStatus.INTERRUPTED: 'a person or another node acted, or the game was reset',
    RunStatus.CANCELED: 'it was canceled',
    RunStatus.BUSY: 'refused: another run is under way',
    RunStatus.UNKNOWN_OPTION: 'refused: there is no such option',
    RunStatus.NOT_AVAILABLE: 'refused: the option cannot start in this state',
    RunStatus.NO_EPISODE: 'refused: no episode is under way',
    RunStatus.FAILED: 'it failed',
    RunStatus.STOPPED_BY_PLAN: 'choosing anew is worth more than going on',
    RunStatus.EXECUTION_CHANGED: 'the execution was changed',
    RunStatus.NO_VALUES: 'refused: the option values of the plan are missing or do not fit',
    RunStatus.BAD_REQUEST: 'refused',
}


class RunError(RuntimeError):
    """The methods of a run were called out of order, or a request is wrong; the text says how."""


@dataclass(frozen=True)
class RunResult:
    """How a run ended; fields as in ``OptionResult.msg``."""

    status: RunStatus
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
    acted: Mapping[str, int] = field(default_factory=dict)  # steps by the option that acted


def execution_named(name: str) -> Arbitration:
    """
    Return the execution of a name; an empty name means to run to the end.

    :raises RunError: no execution has this name; the text lists them.
    """
    try:
        return Arbitration(name or Arbitration.RUN_TO_END)
    except ValueError as error:
        known = ', '.join(execution.value for execution in Arbitration)
        raise RunError(f'no execution {name!r}; there is {known}') from error


def refusal(status: RunStatus, option_name: str, detail: str = '') -> RunResult:
    """
    Return the answer to a request that did not become a run.

    :param detail: more about it, put after the status's own text.
    """
    return RunResult(status, _describe(status, detail), option_name)


class Arbiter:
    """
    Decides before each step, by the values of a plan, which option acts; nothing is drawn.

    :ivar execution: by which it decides.
    """

    def __init__(
        self,
        values: OptionValues,
        execution: Arbitration,
        domain: Domain[Any],
        options: Mapping[str, RunnableOption],
    ) -> None:
        """
        Take the values of a plan.

        :param options: by name: all of the plan, and every primitive action.
        :raises PlanError: the values do not fit the domain.
        """
        self.execution, self._values, self._domain = execution, values, domain
        self._options = options
        among = [options[name] for name in values.names]
        learned = [option for option in among if isinstance(option, LearnedOption)]
        if values.sampled:
            actions = ActionSet(domain, values.action_set, learned)
            if actions.names[: actions.first_fallback] != values.names:
                raise PlanError(f'the values are not for the actions of {domain.name}')
            self._policy = GreedyPolicy(actions, values, execution)
        elif not is_enumerable(domain) or domain.n_states != len(values.states):
            raise PlanError(f'the values are not for every state of {domain.name}')

    def stops(self, state: Any, running: str) -> bool:
        """
        Return whether an option is stopped in a state in which the task is not over.

        :param running: name of the option, after its first step. Only interruption stops options.
        """
        if self.execution is not Arbitration.INTERRUPTED or running not in self._values.names:
            return False
        option = self._values.names.index(running)
        if self._values.sampled:
            seen = self._policy.actions.observe_state(state)
            stopped = self._policy.stops(seen, np.array([option]))
            return stopped is not None and bool(stopped[0])
        worse = interruptions(*self._values_at(state), self._values.interruption_margin)
        return bool(worse[0, option])

    @property
    def modules(self) -> list[RunnableOption]:
        """The options of the plan, which compete in a modular execution."""
        names = self._policy.actions.names if self._values.sampled else self._values.names
        return [self._options[name] for name in names]

    def module(self, state: Any) -> int:
        """
        Return the index of the module that acts in a state in which the task is not over.

        :raises PlanError: the execution is not modular.
        """
        if self.execution not in MODULAR:
            raise PlanError(f'{self.execution} runs no modules')
        if self._values.sampled:
            seen = self._policy.actions.observe_state(state)
            return int(self._policy.choose(seen, _ONE).option[0])
        row = self._domain.feature_values(state)[None]
        action = np.stack([module.action(row) for module in self.modules], axis=1)
        return int(arbitrate(self.execution, *self._values_at(state), action)[0])

    def _values_at(self, state: Any) -> tuple[Floats, Floats]:
        """Return the exact option and continuation values of a state, (1, O)."""
        assert is_enumerable(self._domain)
        at = [self._domain.index(state)]
        return self._values.option_values[at], self._values.continuation_values[at]


class _Modules:
    """The policy of modules: in every step the arbiter chooses the one that acts."""

    def __init__(self, arbiter: Arbiter) -> None:
        self._arbiter = arbiter
        self.state: Any = None

    def choose(self, seen: Seen, games: Ints) -> Choice:
        return Choice(np.array([self._arbiter.module(self.state)]))

    def stops(self, seen: Seen, option: Ints) -> Flags | None:
        return np.ones(len(option), dtype=np.bool_)


class Run:
    """
    One run of an option or of modules: ``begin``, then ``next_action`` and ``observe`` in turn.

    It ends, in this order of precedence: REACHED where the option's termination condition holds,
    which is looked at only after a step, even if the episode ends there too
    (``RunResult.terminated`` and ``truncated`` tell); EPISODE_OVER where the episode ended, by the
    task's end or at its step limit; MAX_STEPS after ``max_steps`` steps. Modules never reach an
    end of their own.

    :ivar name: of the option; empty for modules.
    :ivar max_steps: 0: none but the domain's.
    :ivar acting: the option that took the last action.
    :ivar acted: steps by the name of the option that acted.
    """

    def __init__(
        self,
        runs: RunnableOption | Arbiter,
        domain: ActableDomain,
        gamma: float,
        max_steps: int = 0,
        mode: Mode = Mode.GREEDY,
        rng: np.random.Generator | None = None,
    ) -> None:
        """
        Prepare a run.

        :param runs: an option; or the arbiter of a modular execution, for modules.
        :param max_steps: 0: the option's own limit; for modules none but the domain's.
        :param rng: what the sampled mode draws from; the greedy mode draws nothing.
        :raises RunError: the sampled mode has nothing to draw from, max_steps is negative, or
            modules would never be cut off.
        """
        if mode is Mode.SAMPLED and rng is None:
            raise RunError('the sampled mode needs a random generator')
        if max_steps < 0:
            raise RunError(f'max_steps is {max_steps}, and must be 0 or greater')
        self._policy: _Modules | Fixed
        if isinstance(runs, Arbiter):
            if not (max_steps or domain.max_steps):
                raise RunError(f'{domain.name} never cuts an episode off: give max_steps')
            self._policy = _Modules(runs)
            self.name, self.max_steps, each = '', max_steps, runs.modules
        else:
            self._policy = Fixed(np.zeros(1, dtype=np.intp))
            self.name, self.max_steps, each = runs.name, max_steps or runs.max_steps, [runs]
        self._each, drawn = each, mode is Mode.SAMPLED
        self._options = RowOptions(
            [DrawnOption(option, rng) if drawn and rng else option for option in each]
        )
        limits = np.array([self.max_steps or np.iinfo(np.intp).max])
        self._execution = Execution(self._options, self._policy, 1, gamma, limits)
        self.acting = each[0]
        self.step_count = 0
        self.total_reward = 0.0
        self.discounted_return = 0.0
        self.acted: Counter[str] = Counter()
        self._domain, self._gamma, self._mode = domain, gamma, mode
        self._state: Any = None
        self._episode = self._first_step = 0
        self._terminated = self._truncated = False
        self._path: list[Any] = []  # states in which it acted
        self._going = False

    def begin(self, state: Any, episode: int, step: int) -> RunResult | None:
        """
        Start in a state of the game.

        :param episode: number of the episode; 0: none was begun yet.
        :return: the refusal, where it cannot run from here.
        """
        if self._path or self._going:
            raise RunError('the run has begun already')
        self._state, self._episode, self._first_step = state, episode, step
        if episode == 0 or self._domain.is_over(state):
            return self.end(RunStatus.NO_EPISODE)
        if self.name and not self._seen().startable[0, 0]:
            return self.end(RunStatus.NOT_AVAILABLE, self._domain.encode(state))
        self._going = True
        return None

    def next_action(self) -> int:
        """Return the index of the action to take now."""
        self._check_going()
        if isinstance(self._policy, _Modules):
            self._policy.state = self._state
        action = self._execution.act(self._seen())
        self.acting = self._each[int(self._execution.option[0])]
        return int(action[0])

    def observe(
        self, state: Any, reward: float, terminated: bool, truncated: bool
    ) -> RunResult | None:
        """
        Record the state that the action led to.

        :param terminated: the task is over in ``state``.
        :param truncated: the episode was cut off there.
        :return: how the run ended; None while it continues.
        """
        self._check_going()
        self._path.append(self._state)
        self._state = state
        self.total_reward += reward
        self.discounted_return += self._gamma**self.step_count * reward
        self.step_count += 1
        self.acted[self.acting.name] += 1
        self._terminated, self._truncated = terminated, truncated
        steps = Steps(np.array([reward]), np.array([terminated]))
        ended = self._execution.observe(self._seen(), steps, truncated)
        if self.name and ended.reached.any():
            return self.end(RunStatus.REACHED)
        if terminated or truncated:
            why = 'the task is over' if terminated else 'at its step limit'
            return self.end(RunStatus.EPISODE_OVER, why)
        if self.step_count == self.max_steps:
            return self.end(RunStatus.MAX_STEPS, self._cut_off())
        return None

    def stopped(self, arbiter: Arbiter) -> RunResult | None:
        """
        Ask a plan whether to stop the option before its next action, but not before the first.

        :return: how the run ended; None while it continues.
        """
        self._check_going()
        stops = arbiter.stops(self._state, self.name)
        return self.end(RunStatus.STOPPED_BY_PLAN) if stops else None

    def end(self, status: RunStatus, detail: str = '') -> RunResult:
        """
        End the run from outside: canceled, interrupted, no progress, failed.

        :param detail: more about it, put after the status's own text.
        """
        self._going = False
        return RunResult(
            status=status,
            detail=_describe(status, detail),
            option_name=self.name,
            episode=self._episode,
            first_step=self._first_step,
            step_count=self.step_count,
            total_reward=self.total_reward,
            discounted_return=self.discounted_return,
            final_state='' if self._state is None else self._domain.encode(self._state),
            terminated=self._terminated,
            truncated=self._truncated,
            acted=dict(self.acted),
        )

    def _seen(self) -> SeenRows:
        return SeenRows(self._options.options, self._domain.feature_values(self._state)[None])

    def _check_going(self) -> None:
        if not self._going:
            raise RunError('the run has not begun, or has ended')

    def _cut_off(self) -> str:
        """Return the length of the run in words, and its circle if it certainly walked in one."""
        text = f'{self.max_steps} steps'
        certain = self._mode is Mode.GREEDY and is_deterministic(self._domain)
        seen: dict[Any, int] = {}
        for step, state in enumerate([*self._path, self._state]):
            if state in seen and certain:
                length = step - seen[state]
                where = self._domain.encode(state)
                return f'{text}; it walked in a circle of {length} through {where}'
            seen[state] = step
        return text


def _describe(status: RunStatus, detail: str) -> str:
    return f'{TEXT[status]}: {detail}' if detail else TEXT[status]
