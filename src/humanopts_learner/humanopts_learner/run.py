"""
A run of one option, or of options as modules, in a live game: the rules of the runner.

``Execution`` implements the rules; messages are exchanged between its ``act`` and ``observe``. An
``Arbiter`` decides whether a plan interrupts the option, and which module acts. Like the
vectorised play of plans, it uses ``OptionValues``, which can be sent in a message.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import ActableDomain, Domain, is_enumerable
from humanopts_env.games import Steps
from humanopts_learner.execution import Execution, Fixed, RowOptions, SeenRows
from humanopts_learner.library import RunnableOption
from humanopts_learner.option import DrawnOption, Option
from humanopts_learner.options.learned_option import LearnedOption, loops_of
from humanopts_learner.options.rollout import is_deterministic
from humanopts_learner.planning.action_set import ActionSet, Observation
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.request import Arbitration, MODULAR, PlanError
from humanopts_learner.planning.sampled_plan import GreedyPolicy
import numpy as np

_ONE = np.zeros(1, dtype=np.intp)  # index of the only game, and of its only option


class RunStatus(Enum):
    """How a run ended, or why it was refused; names match OptionResult's constants."""

    REACHED = 'its termination condition holds'
    EPISODE_OVER = 'the episode ended'
    MAX_STEPS = 'it was cut off at its step limit'
    NO_PROGRESS = 'the game did not answer before the deadline'
    INTERRUPTED = 'it was interrupted'
    CANCELED = 'it was canceled'
    BUSY = 'refused: another run is under way'
    UNKNOWN_OPTION = 'refused: the option does not exist'
    NOT_AVAILABLE = 'refused: the option cannot start in this state'
    NO_EPISODE = 'refused: no episode is under way'
    FAILED = 'it failed'
    STOPPED_BY_PLAN = 'another choice is worth more than continuing'
    EXECUTION_CHANGED = 'the execution was changed'
    NO_VALUES = 'refused: the option values of the plan are missing or do not fit'
    BAD_REQUEST = 'refused'

    def explained(self, detail: str) -> str:
        """Return the text of the status, with details."""
        return f'{self.value}: {detail}' if detail else self.value


class RefusedError(PlanError):
    """A run was refused; the message has the details."""

    def __init__(self, status: RunStatus, detail: str = '') -> None:
        super().__init__(detail)
        self.status = status


@dataclass(frozen=True)
class RunResult:
    """How a run ended, or why it was refused; fields as in ``OptionResult.msg``."""

    status: RunStatus
    detail: str  # text of the status
    option_name: str
    run_id: str = ''
    episode: int = 0
    first_step: int = 0
    step_count: int = 0  # k
    random_moves: int = 0  # number taken because the run repeated itself
    total_reward: float = 0.0  # sum of r[i], i = 0..k-1
    discounted_return: float = 0.0  # sum of gamma**i * r[i]
    final_state: str = ''  # in the domain's notation
    terminated: bool = False
    truncated: bool = False
    execution: str = ''
    acted_names: tuple[str, ...] = ()  # options that acted, in order of first use
    acted_steps: tuple[int, ...] = ()  # number of steps of each


def execution_named(name: str) -> Arbitration:
    """
    Return the execution with a name; empty: run to the end.

    :raises RefusedError: the name is unknown; the message lists the executions.
    """
    try:
        return Arbitration(name or Arbitration.RUN_TO_END)
    except ValueError:
        detail = f'unknown execution {name!r}; choose from {", ".join(Arbitration)}'
        raise RefusedError(RunStatus.BAD_REQUEST, detail) from None


class Arbiter:
    """
    Decides before each step, by the values of a plan, which option acts; deterministic.

    :ivar execution: the rule of arbitration.
    :ivar modules: the options that compete in a modular execution.
    """

    def __init__(
        self,
        values: OptionValues,
        execution: Arbitration,
        domain: Domain,
        options: Mapping[str, RunnableOption],
    ) -> None:
        """
        Use the values of a plan.

        :param options: all options of the plan and all primitive actions, by name.
        :raises PlanError: the values do not fit the domain.
        """
        self.execution, self._domain = execution, domain
        self._policy, names = GreedyPolicy(values, execution), values.names
        self._actions: ActionSet | None = None
        if values.sampled:
            among = [options[name] for name in names]
            learned = [option for option in among if isinstance(option, LearnedOption)]
            self._actions = actions = ActionSet(domain, values.action_set, learned, values.columns)
            if actions.names[: actions.first_fallback] != names:
                raise PlanError(f'the values are not for the actions of {domain.name}')
            names = actions.names
        elif not is_enumerable(domain) or domain.n_states != len(values.states):
            raise PlanError(f'the values are not for every state of {domain.name}')
        self.modules = [options[name] for name in names]

    def stops(self, state: Any, running: str) -> bool:
        """
        Return whether interruption stops an option in a state where the task is not over.

        :param running: name of the option, which has taken at least one step.
        """
        names = self._policy.values.names
        if self.execution is not Arbitration.INTERRUPTED or running not in names:
            return False
        stopped = self._policy.stops(self._observe(state), np.array([names.index(running)]))
        return stopped is not None and bool(stopped[0])

    def module(self, state: Any) -> RunnableOption:
        """
        Return the module that acts in a state where the task is not over.

        :raises PlanError: the execution is not modular.
        """
        if self.execution not in MODULAR:
            raise PlanError(f'{self.execution} runs no modules')
        return self.modules[int(self._policy.choose(self._observe(state), _ONE)[0])]

    def _observe(self, state: Any) -> Observation:
        """Return the observation of a state; exact values show where options can start."""
        if self._actions is not None:
            return self._actions.observe_state(state)
        assert is_enumerable(self._domain)
        row, known = (
            self._domain.feature_values(state)[None],
            np.ones((1, len(self.modules)), bool),
        )
        return Observation(
            states=np.array([self._domain.index(state)]),
            startable=known,
            wanted=np.stack([module.action(row) for module in self.modules], axis=1),
            ending=known,
            fallback=np.array([-1]),
            n_options=len(self.modules),
        )


class Run:
    """
    One run of an option, or of the modules of a plan, from its first state.

    Call ``next_action`` and ``observe`` in turn. After a step, a run ends with the first status
    that applies: REACHED if the termination condition of the option holds, even if the episode
    also ends there (see ``RunResult.terminated`` and ``truncated``); EPISODE_OVER if the task is
    over or the episode reaches its step limit; MAX_STEPS after ``max_steps`` steps. Modules have
    no termination condition.

    ``Execution`` treats the run as an option, whichever module acts.

    :ivar name: name of the option; empty for modules.
    :ivar domain: domain of the game.
    :ivar state: current state of the game.
    :ivar acting: option that took the last action.
    :ivar arbiter: arbiter that stops the option, or chooses the module that acts; None: none.
    """

    def __init__(
        self,
        option: RunnableOption | None,
        domain: ActableDomain,
        state: Any,
        position: tuple[int, int],
        max_steps: int = 0,
        *,
        arbiter: Arbiter | None = None,
        rng: np.random.Generator | None = None,
        unstick: np.random.Generator | None = None,
    ) -> None:
        """
        Begin in a state of the game.

        :param option: option to run; None: the modules of the arbiter.
        :param position: episode and step of the state; episode 0: none has begun yet.
        :param max_steps: maximum number of steps; 0: the option's limit, or the domain's for
            modules.
        :param rng: generator for sampled decisions; None: decisions are greedy.
        :param unstick: generator of random moves if the run repeats itself; None: no random moves.
            Modules and sampled decisions never take any.
        :raises RefusedError: the run cannot begin here, or modules would have no step limit.
        """
        self.name = '' if option is None else option.name
        self.max_steps = max_steps or (domain if option is None else option).max_steps
        if not self.max_steps:
            detail = f'{domain.name} has no step limit: give max_steps'
            raise RefusedError(RunStatus.BAD_REQUEST, detail)
        if not position[0] or domain.is_over(state):
            raise RefusedError(RunStatus.NO_EPISODE)
        self.domain, self._rng, self._modular = domain, rng, option is None
        self.state, self._position, self.arbiter = state, position, arbiter
        if option is None:
            assert arbiter is not None
            option = arbiter.modules[0]
        self.acting = option
        checked = unstick is not None and rng is None and not self._modular
        loops = loops_of(domain, [option], 1, unstick) if checked else None
        self._execution = Execution(RowOptions([self]), Fixed(_ONE), 1, domain.gamma, loops=loops)
        self._acted: Counter[str] = Counter()
        self._terminated = self._truncated = False
        self._path: list[Any] = []  # states in which the run acted
        if not self._seen().startable[0, 0]:
            raise RefusedError(RunStatus.NOT_AVAILABLE, domain.encode(state))

    @property
    def execution(self) -> Arbitration:
        """The current execution."""
        return Arbitration.RUN_TO_END if self.arbiter is None else self.arbiter.execution

    @property
    def position(self) -> tuple[int, int]:
        """Episode and step of the state."""
        episode, first_step = self._position
        return episode, first_step + self.step_count

    @property
    def step_count(self) -> int:
        """Number of steps taken so far."""
        return len(self._path)

    @property
    def random_moves(self) -> int:
        """Number of random moves so far, taken because the run repeated itself."""
        loops = self._execution.loops
        return 0 if loops is None else int(loops.moves[0])

    @property
    def total_reward(self) -> float:
        """Undiscounted return so far."""
        return float(self._execution.total[0])

    def can_start(self, rows: Rows) -> Flags:
        return np.ones(1, dtype=np.bool_) if self._modular else self._decisions().can_start(rows)

    def action(self, rows: Rows) -> Ints:
        if self._modular:
            assert self.arbiter is not None
            self.acting = self.arbiter.module(self.state)
        return self._decisions().action(rows)

    def ends(self, rows: Rows) -> Flags:
        return np.zeros(1, dtype=np.bool_) if self._modular else self._decisions().ends(rows)

    def next_action(self) -> int:
        """Return the index of the action to take now."""
        return int(self._execution.act(self._seen())[0])

    def observe(
        self, state: Any, reward: float, terminated: bool, truncated: bool
    ) -> RunResult | None:
        """
        Record the state after the action.

        :param terminated: whether the task is over in ``state``.
        :param truncated: whether the episode was cut off in ``state``.
        :return: result of the run; None: the run continues.
        """
        self._path.append(self.state)
        self.state, self._terminated, self._truncated = state, terminated, truncated
        self._acted[self.acting.name] += 1
        steps = Steps(np.array([reward]), np.array([terminated]))
        seen = self._seen()
        ended = self._execution.observe(seen, steps, truncated, seen.rows)
        if not ended.game.size:
            return None
        if ended.reached[0]:
            return self.end(RunStatus.REACHED)
        if terminated or truncated:
            why = 'the task is over' if terminated else 'at its step limit'
            return self.end(RunStatus.EPISODE_OVER, why)
        return self.end(RunStatus.MAX_STEPS, self._cut_off())

    def stopped(self) -> RunResult | None:
        """Return the result if the plan stops the run before its next action; None otherwise."""
        if self.arbiter is None or not self.arbiter.stops(self.state, self.name):
            return None
        return self.end(RunStatus.STOPPED_BY_PLAN)

    def end(self, status: RunStatus, detail: str = '') -> RunResult:
        """
        Return the result; called externally if canceled, interrupted, without progress or failed.

        :param detail: details appended to the text of the status.
        """
        return RunResult(
            status=status,
            detail=status.explained(detail),
            option_name=self.name,
            episode=self._position[0],
            first_step=self._position[1],
            step_count=self.step_count,
            random_moves=self.random_moves,
            total_reward=self.total_reward,
            discounted_return=float(self._execution.discounted[0]),
            final_state=self.domain.encode(self.state),
            terminated=self._terminated,
            truncated=self._truncated,
            execution=self.execution,
            acted_names=tuple(self._acted),
            acted_steps=tuple(self._acted.values()),
        )

    def _decisions(self) -> Option:
        """Return the acting option, with sampled decisions unless they are greedy."""
        return self.acting if self._rng is None else DrawnOption(self.acting, self._rng)

    def _seen(self) -> SeenRows:
        return SeenRows([self], self.domain.feature_values(self.state)[None])

    def _cut_off(self) -> str:
        """Return the length of the run as text, and its cycle if it is certain to be in one."""
        text, back = f'{self.max_steps} steps', self._path[::-1]
        if self._rng is None and is_deterministic(self.domain) and self.state in back:
            length, where = back.index(self.state) + 1, self.domain.encode(self.state)
            text += f'; it walked in a circle of {length} through {where}'
        return text
