"""Where demonstrations start: drawn by a strategy, keyed by person, option and number."""

from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import HasStateSamples
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.start_states import choose_start_state, draw_samples, nothing_fails
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from humanopts_teach.lesson.history import OptionHistory
import numpy as np

FAILURES = 'failures'  # the strategy that looks at what was learned
AHEAD = 8  # demonstrations whose samples are drawn at once, in Pac-Man in the time of three


@dataclass(frozen=True, slots=True)
class LessonRules:
    """How start states are drawn, and when the lesson on an option ends."""

    strategy: str = STRATEGY  # one of the learner's ``STRATEGIES``
    budget: int = BUDGET  # the most that is asked for one option, "not here" answers included
    seed: int = 0
    until_no_failures: bool = True  # strategy failures: ask on while the learned option fails
    method: str = METHOD  # of learning, one of ``METHODS``, where the person asks for no other


class SeededStarts:
    """
    The start states of one lesson.

    A draw depends on seed, participant, option, the number of the demonstration and, with the
    strategy ``failures``, on what was learned; so a demonstration that is tried again, or after a
    restart, starts in the same state.
    """

    def __init__(self, domain: Domain[Any], rules: LessonRules) -> None:
        self.rules = rules
        self._domain = domain
        self._options: dict[tuple[str, str], LearnedOption] = {}  # by participant and name
        # samples that were drawn ahead, each with its generator, which goes on
        self._ahead: dict[Any, tuple[list[Any], np.random.Generator]] = {}

    def learned(self, participant: str, option_name: str, text: str) -> bool:
        """
        Keep an option as the learner publishes it, where the strategy looks at it.

        :return: whether it is another than before.
        :raises OptionError: it is not an option, or one of another domain.
        """
        if self.rules.strategy != FAILURES:
            return False
        option, _ = option_from_json(text)
        option.check_domain(self._domain)
        key = participant, option_name
        before, self._options[key] = self._options.get(key), option
        return option != before

    def draw(self, participant: str, option: OptionHistory) -> str:
        """Return the start state of the next demonstration, in the domain's notation."""
        drawn, rng = self._ahead.pop(_key(participant, option), (None, None))
        rng = rng or self._generator('start_state', participant, option)
        learned = self._options.get((participant, option.name))
        state = choose_start_state(
            self.rules.strategy, self._domain, learned, option.demonstrations, rng, drawn
        )
        return self._domain.encode(state)

    def draw_ahead(self, participant: str, option: OptionHistory) -> None:
        """
        Draw the sample of states that the next start state is chosen from; that takes time.

        Those of the next demonstrations are drawn with it where the domain has a way to.
        """
        if _key(participant, option) in self._ahead:
            return
        count = AHEAD if isinstance(self._domain, HasStateSamples) else 1
        rngs = [self._generator('start_state', participant, option, n) for n in range(count)]
        drawn = draw_samples(self.rules.strategy, self._domain, option.demonstrations, rngs) or ()
        keys = (_key(participant, option, later) for later in range(count))
        self._ahead = dict(zip(keys, zip(drawn, rngs)))

    def episode_seed(self, participant: str, option: OptionHistory) -> int:
        """Return the seed of the chance in the next demonstration's episode."""
        return int(self._generator('episode', participant, option).integers(2**63))

    def counts(self, option: OptionHistory, demonstration: Demonstration) -> bool:
        """Return whether the next draw has counted this one in; out, where it is withdrawn."""
        if not option.n_trajectories or self.rules.strategy != FAILURES:
            return True
        learned = self._options.get((demonstration.participant, option.name))
        if learned is None:
            return False
        return (demonstration.uuid in learned.uuids) != demonstration.withdrawn

    def exhausted(self, participant: str, option: OptionHistory) -> bool:
        """Return whether the strategy has nothing left to ask, once the criteria hold."""
        learned = self._options.get((participant, option.name))
        asks_failures = self.rules.until_no_failures and self.rules.strategy == FAILURES
        if not asks_failures or learned is None or not option.demonstrations:
            return True
        rng = self._generator('exhausted', participant, option)
        return nothing_fails(learned, self._domain, option.demonstrations, rng)

    def _generator(
        self, purpose: str, participant: str, option: OptionHistory, later: int = 0
    ) -> np.random.Generator:
        """Return the generator of the next demonstration, or of one that is so many later."""
        number = option.number + later
        return generator(self.rules.seed, purpose, participant, option.name, number)


def _key(participant: str, option: OptionHistory, later: int = 0) -> tuple[str, str, int, bool]:
    """Return what the sample for a start state depends on; ``later`` as in ``_generator``."""
    return participant, option.name, option.number + later, bool(option.demonstrations)
