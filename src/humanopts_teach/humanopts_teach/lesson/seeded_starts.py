"""Start states of demonstrations and runs in the exam; seeded by person, option and number."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate, simulated
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.games import feature_rows
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind, version_of
from humanopts_learner.options.checks import Check, next_check
from humanopts_learner.options.exam import before_exam
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.missing import missing_start
from humanopts_learner.options.starts import (
    choose_start_state,
    draw_sample,
    nothing_fails,
    Sample,
)
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from humanopts_teach.lesson.history import OptionHistory
import numpy as np

T = TypeVar('T')
FAILURES = 'failures'  # the strategy that uses the learned option
DRAWS, STATES = 5, 200  # maximum draws for the start of an exam run, and states per draw
MAX_PARSED = 8  # cached option objects, which take far more memory than their text


@dataclass(frozen=True, slots=True)
class LessonRules:
    """Rules for questions, for drawing start states, and for ending the lesson on an option."""

    strategy: str = STRATEGY  # one of the learner's ``STRATEGIES``
    budget: int = BUDGET  # maximum demonstrations per option, including "not here" answers
    seed: int = 0
    until_no_failures: bool = True  # with ``failures``: continue while the learned option fails
    method: str = METHOD  # default learning method, one of ``METHODS``
    ask_about_runs: bool = True  # once the criteria are met, before the exam
    derive: tuple[str, ...] = ()  # derived features of every participant, as formulas


class SeededStarts:
    """
    The start states of one lesson.

    A draw depends on the seed, participant, option, number of the demonstration and the learned
    option. In a replayed domain, it depends on all learned options of the participant, which
    are run to reach the start. A repeated demonstration or exam run thus starts in the same state,
    even after a restart.
    """

    def __init__(self, domain: ActableDomain, rules: LessonRules) -> None:
        self.rules = rules
        self._domain = domain
        self._texts: dict[tuple[str, str], str] = {}  # options, by participant and name
        self._parse = lru_cache(MAX_PARSED)(lambda text: option_from_json(text)[0])
        self._replayed = isinstance(domain, ReplayedDomain)
        # Key of the sample for the next start state, the sample, and its generator.
        self._ahead: tuple[Any, Sample | None, np.random.Generator] | None = None
        self._known: dict[str, tuple[Any, Any]] = {}  # newest slow results, with keys

    def learned(self, participant: str, option_name: str, text: str) -> bool:
        """
        Store an option published by the learner.

        :return: whether it has changed.
        :raises OptionError: the text is not a valid option, or belongs to another domain.
        """
        key = participant, option_name
        if self._texts.get(key) == text:
            return False
        self._parse(text).check_domain(self._domain)
        self._texts[key] = text
        return True

    def options(self, participant: str, names: Collection[str]) -> list[LearnedOption]:
        """Return the learned options of a participant; none unless the domain is replayed."""
        texts = [self._texts.get((participant, name)) for name in names if self._replayed]
        return [self._parse(text) for text in texts if text is not None]

    def draw(self, option: OptionHistory, names: Collection[str] = ()) -> str:
        """
        Return the start state of the next demonstration, in the domain's notation.

        :param names: names of all options of the participant, in the order of teaching.
        :raises NeedsRulesError: the domain cannot be simulated.
        """
        domain = simulated(self._domain, 'the choice of a start state')
        self.draw_ahead(option, names)
        assert self._ahead is not None
        (_, drawn, rng), self._ahead = self._ahead, None
        state = choose_start_state(
            self.rules.strategy,
            domain,
            self._option(option),
            option.everything,
            rng,
            drawn,
            self._others(option, names),
        )
        return domain.encode(state)

    def draw_ahead(self, option: OptionHistory, names: Collection[str] = ()) -> None:
        """Draw the sample of candidates for the next start state in advance, since it is slow."""
        if not can_simulate(self._domain):
            return
        others = self._others(option, names)
        taught = tuple(other.uuids for other in others)
        key = option.participant, option.name, option.number, bool(option.demonstrations), taught
        if self._ahead is None or self._ahead[0] != key:
            rng = self._generator('start_state', option)
            parts = self.rules.strategy, self._domain, option.demonstrations, rng, others
            drawn = draw_sample(*parts)
            self._ahead = key, drawn, rng

    def episode_seed(self, option: OptionHistory, repeated: int, *, exam: bool = False) -> int:
        """
        Return the episode seed of the next demonstration or exam run.

        :param repeated: number of repetitions of the demonstration; each has another seed.
        """
        if exam:
            return int(self._exam_generator('exam episode', option).integers(2**63))
        again = (repeated,) if repeated else ()
        return int(self._generator('episode', option, *again).integers(2**63))

    def draw_for_exam(self, option: OptionHistory, names: Collection[str] = ()) -> str:
        """
        Return the start state of the next run in the exam, in the domain's notation.

        It is drawn from the starts of the task where the option can start. If none is found, it is
        the start of a demonstration.

        :param names: as in ``draw``.
        :return: empty: the current state, if the domain cannot be simulated or the option is not
            learned.
        """
        domain, learned = self._domain, self._option(option)
        if not can_simulate(domain) or learned is None:
            return ''
        rng = self._exam_generator('exam', option)
        others = self._others(option, names)
        for _ in range(DRAWS):
            sample = draw_sample('random', domain, option.demonstrations, rng, others)
            if sample is None:
                states = domain.sample_states(rng, STATES)
            else:
                states = [sample.states[n] for n in rng.permutation(len(sample.states))]
            can_start = learned.can_start(feature_rows(domain, states))
            if can_start.any():
                return domain.encode(states[int(can_start.argmax())])
        starts = [demo.states[0] for demo in option.demonstrations if demo.actions]
        return starts[int(rng.integers(len(starts)))]

    def check(
        self, option: OptionHistory, names: Collection[str] = (), *, every_end: bool = False
    ) -> Check | None:
        """
        Return the next question about a run of the option; None: no more questions.

        :param names: as in ``draw``.
        :param every_end: as in ``next_check``.
        """
        learned = self._option(option)
        if not self.rules.ask_about_runs or learned is None or not option.n_trajectories:
            return None
        domain, others = self._domain, self._others(option, names)

        def find() -> Check | None:
            rng = self._generator('check', option)
            return next_check(learned, domain, evidence, rng, others, every_end=every_end)

        evidence = before_exam(option.everything)  # so that no question interrupts an exam
        return self._once('check', find, [each.uuid for each in evidence], learned, others)

    def counts(self, option: OptionHistory, demonstration: Demonstration) -> bool:
        """Return whether the next draw takes a demonstration or its withdrawal into account."""
        if not option.n_trajectories or demonstration.kind is Kind.JUDGED:
            return True
        learned = self._option(option)
        if learned is None:
            return False
        return (demonstration.uuid in learned.uuids) != demonstration.withdrawn

    def exhausted(self, option: OptionHistory, names: Collection[str] = ()) -> bool:
        """Return whether the strategy has no failing start left, if the criteria are met."""
        learned = self._option(option)
        asks_failures = self.rules.until_no_failures and self.rules.strategy == FAILURES
        if not asks_failures or learned is None or not option.demonstrations:
            return True
        if not can_simulate(self._domain):  # failures are only found by running the option
            return True
        domain, others = self._domain, self._others(option, names)

        def find() -> bool:
            rng = self._generator('exhausted', option)
            return nothing_fails(learned, domain, option.everything, rng, others)

        return self._once('exhausted', find, option.number, learned, others)

    def missing(self, option: OptionHistory, passed: Rows) -> str:
        """
        Describe a situation that no demonstration has shown yet; empty: none was found.

        :param passed: (N, F) features of states between demonstrations.
        """
        learned = self._option(option)
        if learned is None or not option.n_trajectories:
            return ''

        def find() -> str:
            demos = option.demonstrations
            return missing_start(learned, self._domain, demos, passed, self.rules.seed)

        return self._once('missing', find, version_of(option.demonstrations), learned, ())

    def _once(
        self,
        what: str,
        find: Callable[[], T],
        state: Any,
        learned: LearnedOption,
        others: Sequence[LearnedOption],
    ) -> T:
        """Return the cached result for the same state of the lesson, or compute it."""
        key = state, learned.participant, learned.name, *(o.uuids for o in (learned, *others))
        if what not in self._known or self._known[what][0] != key:
            self._known[what] = key, find()
        found: T = self._known[what][1]
        return found

    def _option(self, option: OptionHistory) -> LearnedOption | None:
        """Return the learned option; None: not learned yet."""
        text = self._texts.get((option.participant, option.name))
        return self._parse(text) if text is not None else None

    def _others(self, option: OptionHistory, names: Collection[str]) -> list[LearnedOption]:
        """Return the participant's other learned options, if start states depend on them."""
        return self.options(option.participant, [name for name in names if name != option.name])

    def _exam_generator(self, purpose: str, option: OptionHistory) -> np.random.Generator:
        version = version_of(option.demonstrations)
        key = purpose, option.participant, option.name, version, option.exam_runs
        return generator(self.rules.seed, *key)

    def _generator(self, purpose: str, option: OptionHistory, *key: int) -> np.random.Generator:
        known = option.participant, option.name, option.number
        return generator(self.rules.seed, purpose, *known, *key)
