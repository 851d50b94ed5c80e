"""Start states by the learner's strategies, from the options as they are learned so far."""

from collections.abc import Sequence
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.failures import nothing_fails
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.start_states import choose_start_state
import numpy as np

FAILURES = 'failures'  # the strategy that looks at what was learned


class LearnedStarts:
    """The ``StartStates`` of the lesson node, told of each option that was learned."""

    def __init__(self, domain: Domain[Any], strategy: str, *, until_no_failures: bool) -> None:
        """
        Begin with nothing learned.

        :param strategy: one of the learner's ``STRATEGIES``.
        :param until_no_failures: with ``failures``, there is something left to ask as long as
            there is a state from which the learned option fails.
        """
        self._domain = domain
        self._strategy = strategy
        self._until_no_failures = until_no_failures
        self._options: dict[tuple[str, str], LearnedOption] = {}
        self._texts: dict[tuple[str, str], str] = {}

    def learned(self, participant: str, option_name: str, text: str) -> None:
        """
        Take in an option as the learner publishes it.

        :raises OptionError: it is not an option, or one of another domain.
        """
        key = (participant, option_name)
        if self._strategy == FAILURES and self._texts.get(key) != text:
            option, _ = option_from_json(text)
            option.check_domain(self._domain)
            self._options[key], self._texts[key] = option, text

    def choose(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> Any:
        """Draw the state from which the person is asked to demonstrate next."""
        option = self._options.get((participant, option_name))
        return choose_start_state(self._strategy, self._domain, option, demonstrations, rng)

    def knows(self, demonstration: Demonstration) -> bool:
        """Tell whether start states are drawn with this one counted in; out, if withdrawn."""
        if self._strategy != FAILURES:
            return True
        option = self._options.get((demonstration.participant, demonstration.option_name))
        return (
            option is not None and (demonstration.uuid in option.uuids) != demonstration.withdrawn
        )

    def exhausted(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> bool:
        """Tell whether there is nothing left to ask, once the criteria hold."""
        option = self._options.get((participant, option_name))
        asks_failures = self._until_no_failures and self._strategy == FAILURES
        if not asks_failures or option is None or not demonstrations:
            return True
        return nothing_fails(option, self._domain, demonstrations, rng)
