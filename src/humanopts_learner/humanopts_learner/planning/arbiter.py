"""
Arbitration in one game, as the runner asks for it before each command.

An arbiter is made from ``OptionValues``, which a message can carry, and decides as the vectorised
play of exact and sampled plans does. Nothing is drawn, so the same states give the same decisions.
"""

from collections.abc import Sequence
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.arbitration import interruptions, OptionValues, winners
from humanopts_learner.planning.request import Execution, PlanError
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.policies import GreedyPolicy
import numpy as np


class Arbiter:
    """Decides before each step which option of a plan acts."""

    def __init__(
        self,
        values: OptionValues,
        execution: Execution,
        domain: Domain[Any],
        options: Sequence[LearnedOption],
    ) -> None:
        """
        Take the values of a plan.

        :param execution: a polling one.
        :param options: that were planned with, in any order.
        :raises PlanError: an option of the plan is missing, or the values do not fit the domain.
        """
        by_name = {option.name: option for option in options}
        wanted = [name for name in values.names if not name.startswith(PRIMITIVE_PREFIX)]
        missing = [repr(name) for name in wanted if name not in by_name]
        if missing:
            raise PlanError(f'values came for options that are not here: {", ".join(missing)}')
        self._values, self._execution, self._domain = values, execution, domain
        self._options = [by_name[name] for name in wanted]
        if values.sampled:
            actions = ActionSet(domain, values.action_set, self._options)
            if actions.names[: actions.first_fallback] != values.names:
                raise PlanError(f'the values are not for the actions of {domain.name}')
            self._policy = GreedyPolicy(actions, values, execution)
        elif not is_enumerable(domain) or domain.n_states != len(values.states):
            raise PlanError(f'the values are not for every state of {domain.name}')

    def before_step(self, state: Any, running: str) -> str | None:
        """
        Return the option, or action:NAME, that acts in a state in which the task is not over.

        :param running: the option that runs, after its first step; ignored by modules.
        :return: None: the running option is to be stopped, and the policy asked for another.
        """
        names = self._values.names
        option = names.index(running) if running in names else -1
        decide = self._by_abstract_state if self._values.sampled else self._by_state
        stopped, acting = decide(state, option)
        if self._execution is not Execution.INTERRUPTED:
            return acting
        return None if stopped else running

    def _by_state(self, state: Any, option: int) -> tuple[bool, str]:
        """Return whether an option (-1: none) is stopped, and the module that acts."""
        values, names = self._values, self._values.names
        assert is_enumerable(self._domain)
        at = [self._domain.index(state)]
        both = values.option_values[at], values.continuation_values[at]
        if self._execution is Execution.INTERRUPTED:
            stop = interruptions(*both, values.interruption_margin)
            return option >= 0 and bool(stop[0, option]), ''
        action = np.arange(len(names))[None] - len(self._options)
        row = self._domain.feature_values(state)[None]
        for o, one in enumerate(self._options):
            action[:, o] = one.greedy_action(row)
        return False, names[int(winners(self._execution, *both, action)[0])]

    def _by_abstract_state(self, state: Any, option: int) -> tuple[bool, str]:
        """Return whether an option (-1: none) is stopped, and the option that is chosen."""
        seen = self._policy.actions.observe_state(state)
        stopped = self._policy.stops(seen, np.array([option]), np.random.default_rng(0))
        acting = self._policy.decide(seen).option[0]
        return bool(stopped[0]), self._policy.actions.names[int(acting)]
