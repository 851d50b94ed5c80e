"""
Arbitration in one game, as the runner asks for it before each command.

An arbiter is made from ``OptionValues``, which a message can carry, and decides as the vectorised
play of exact and sampled plans does. Nothing is drawn, so the same states give the same decisions.
"""

from collections.abc import Sequence
from typing import Any, Protocol

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import LearnedOption, tabulate
from humanopts_learner.planning.arbitration import OptionValues
from humanopts_learner.planning.interruption import interruptions, winners
from humanopts_learner.planning.request import batch_games, Execution, PlanError
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.policies import as_executed, GreedyPolicy
from humanopts_learner.planning.sampled.sampled_models import StateIndex
from humanopts_learner.planning.sampled.state_abstraction import StateAbstraction
import numpy as np
from numpy.typing import NDArray


class Arbiter(Protocol):
    """Decides before each step which option acts."""

    def before_step(self, state: Any, running: str) -> str | None:
        """
        Return the option, or action:NAME, that acts in a state in which the task is not over.

        :param running: the option that runs, after its first step; ignored by modules.
        :return: None: the running option is to be stopped, and the policy asked for another.
        """
        ...


def make_arbiter(
    values: OptionValues,
    execution: Execution,
    domain: Domain[Any],
    options: Sequence[LearnedOption],
) -> Arbiter:
    """
    Return the arbiter of a plan.

    :param options: that were planned with, in any order.
    :raises PlanError: an option of the plan is missing, or the values do not fit the domain.
    :raises PlanError: the domain, or an option, cannot be used for a plan of this kind.
    """
    by_name = {option.name: option for option in options}
    wanted = [name for name in values.names if not name.startswith(PRIMITIVE_PREFIX)]
    missing = [repr(name) for name in wanted if name not in by_name]
    if missing:
        raise PlanError(f'values came for options that are not here: {", ".join(missing)}')
    used = [by_name[name] for name in wanted]
    if execution is Execution.RUN_TO_END:
        return _NoArbiter()
    if values.sampled:
        return _SampledArbiter(values, execution, domain, used)
    return _ExactArbiter(values, execution, domain, used)


class _NoArbiter:
    """Runs every option to its end."""

    def before_step(self, state: Any, running: str) -> str | None:
        return running


class _ExactArbiter:
    """Finds the decision of a state of an enumerable domain in a table."""

    def __init__(
        self,
        values: OptionValues,
        execution: Execution,
        domain: Domain[Any],
        options: Sequence[LearnedOption],
    ) -> None:
        if not is_enumerable(domain) or domain.n_states != len(values.states):
            raise PlanError(f'the values are not for every state of {domain.name}')
        self._domain, self._names = domain, values.names
        self._interruptions = interruptions(values)
        self._winner: NDArray[np.int32] | None = None
        if execution is Execution.INTERRUPTED:
            return
        action = np.tile(np.arange(len(values.names)) - len(options), (domain.n_states, 1))
        for o, option in enumerate(options):
            action[:, o] = tabulate(option, domain).action
        self._winner = winners(values, execution, action, domain.over())

    def before_step(self, state: Any, running: str) -> str | None:
        at = self._domain.index(state)
        if self._winner is not None:
            return str(self._names[self._winner[at]])
        stop = running in self._names and self._interruptions[at, self._names.index(running)]
        return None if stop else running


class _SampledArbiter:
    """Decides by abstract states, with a policy for one game at a time."""

    def __init__(
        self,
        values: OptionValues,
        execution: Execution,
        domain: Domain[Any],
        options: Sequence[LearnedOption],
    ) -> None:
        self._execution = execution
        self._actions = ActionSet(domain, values.action_set, options)
        if self._actions.names[: self._actions.first_fallback] != values.names:
            raise PlanError(f'the values are not for the actions of {domain.name}')
        greedy = GreedyPolicy(self._actions, StateIndex(values.states), values.option_values)
        self._policy = as_executed(
            greedy, values.continuation_values, execution, values.interruption_margin
        )
        self._abstraction = StateAbstraction(batch_games(domain), values.action_set)

    def before_step(self, state: Any, running: str) -> str | None:
        seen = self._abstraction.observe(self._abstraction.games.batch_of([state]))
        names, unused = self._actions.names, np.random.default_rng(0)
        if self._execution is not Execution.INTERRUPTED:
            return names[int(self._policy(seen, unused).option[0])]
        option = names.index(running) if running in names else -1
        stop = self._policy.stops(seen, np.array([option]), unused)[0]
        return None if stop else running
