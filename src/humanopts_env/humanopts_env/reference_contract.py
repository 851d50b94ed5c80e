"""
The contract of the reference options of every domain, as a test class for pytest.

In the tests of a package that adds reference options::

    class TestMyOptions(ReferenceContract):
        def make(self) -> Domain[Any]:
            return MyDomain()
"""

from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

from humanopts_env.domains.base import Domain, feature_columns, is_enumerable
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_env.domains.reference import judge_states, Judgement, ReferenceOption
from humanopts_env.domains.registry import reference_options
from humanopts_env.seeding import generator
import numpy as np

ALL = 2000  # the tests use sampled states of a domain with more
SAMPLE = 600
ONE_BY_ONE = 40  # states that are judged one by one, and runs that are played
LONGEST = 1000  # steps of a run, where the domain has no limit of its own


class ReferenceContract:
    """Tests that reference options satisfy ``humanopts_env.domains.reference``."""

    def make(self) -> Domain[Any]:
        """Return the domain whose options are tested."""
        # not abstract: pytest would report that it cannot make the class, not what is missing
        raise NotImplementedError('make() must return the domain whose options are tested')

    def options(self, domain: Domain[Any]) -> Mapping[str, ReferenceOption]:
        """Return the options to test by name; by default those that are registered."""
        return reference_options(domain)

    def test_a_person_can_be_told_what_each_means(self) -> None:
        """Each has a lower-case name, a sentence, and features in the domain's order."""
        seen = self._seen
        names = [feature.name for feature in seen.domain.features]
        assert seen.options
        for name, option in seen.options.items():
            assert option.name == name == name.strip().lower() != ''
            assert option.definition.endswith('.'), name
            chosen = [names[column] for column in feature_columns(seen.domain, option.features)]
            assert list(option.features) == chosen != [], name

    def test_a_demo_teaches_some_of_them(self) -> None:
        """The options that the domain names are reference options."""
        domain = self._seen.domain
        if isinstance(domain, HasTeachingDefaults):
            assert set(domain.teaching.options) <= set(self._seen.options)

    def test_each_can_start_somewhere(self) -> None:
        """Every initiation set has a state."""
        for name in self._seen.options:
            assert self._seen.of(name).initiation.any(), name

    def test_it_acts_where_it_can_start_and_has_ended_elsewhere(self) -> None:
        """At every step of a run there is an optimal action, or the run has ended."""
        for name in self._seen.options:
            said = self._seen.of(name)
            assert np.array_equal(said.optimal.any(axis=1), said.initiation), name
            assert (said.initiation | said.termination).all(), name

    def test_its_features_tell_where_it_starts_and_ends(self) -> None:
        """States with equal features have equal I and beta, which can thus be learned."""
        seen = self._seen
        for name, option in seen.options.items():
            columns = feature_columns(seen.domain, option.features)
            answers: dict[tuple[int, ...], tuple[bool, bool]] = {}
            said = seen.of(name)
            pairs = zip(said.initiation.tolist(), said.termination.tolist())
            for row, answer in zip(seen.rows[:, columns].tolist(), pairs):
                assert answers.setdefault(tuple(row), answer) == answer, name

    def test_every_run_comes_to_its_end(self) -> None:
        """
        Runs by the first and by the last optimal action end before the episode is truncated.

        Where the task is over, the option has ended and cannot start.
        """
        seen = self._seen
        for name, option in seen.options.items():
            starts = np.flatnonzero(seen.of(name).initiation)
            states = [seen.states[n] for n in starts[:: max(1, len(starts) // ONE_BY_ONE)]]
            for which in (0, -1):
                assert seen.runs_end(option, states, which), name

    def test_one_state_is_judged_as_many_are(self) -> None:
        """Both ways of judging agree."""
        seen = self._seen
        for name, option in seen.options.items():
            said = seen.of(name)
            for number in range(0, len(seen.states), max(1, len(seen.states) // ONE_BY_ONE)):
                state = seen.states[number]
                assert option.can_start(state) == said.initiation[number], name
                assert option.ends(state) == said.termination[number], name
                actions = tuple(np.flatnonzero(said.optimal[number]).tolist())
                assert option.optimal_actions(state) == actions, name

    @property
    def _seen(self) -> '_Seen':
        return _seen_of(cast(Hashable, type(self)))  # mypy looks at the hash of its objects


@lru_cache(maxsize=1)  # pytest makes an object for each test, and runs those of a class in a row
def _seen_of(suite: type[ReferenceContract]) -> '_Seen':
    made = suite()
    domain = made.make()
    return _Seen(domain, made.options(domain))


class _Seen:
    """The options of a domain, and their judgements of its open states or of a sample."""

    def __init__(self, domain: Domain[Any], options: Mapping[str, ReferenceOption]) -> None:
        self.domain, self.options = domain, options
        self.states = self._states()
        self.rows = np.array([domain.feature_values(state) for state in self.states])
        self._said: dict[str, Judgement] = {}

    def of(self, name: str) -> Judgement:
        """Return the judgement of an option in the states."""
        if name not in self._said:
            option = self.options[name]
            self._said[name] = judge_states(option, self.states, len(self.domain.actions))
        return self._said[name]

    def runs_end(self, option: ReferenceOption, states: Sequence[Any], which: int) -> bool:
        """Return whether all runs by the first or the last optimal actions come to their end."""
        domain, n_actions = self.domain, len(self.domain.actions)
        rngs = [generator(0, 'reference contract', option.name, which) for _ in states]
        said = judge_states(option, states, n_actions)
        for _ in range(domain.max_steps or LONGEST):
            actions = [np.flatnonzero(optimal).tolist()[which] for optimal in said.optimal]
            after = [domain.step(*step) for step in zip(states, actions, rngs)]
            said = judge_states(option, [outcome.state for outcome in after], n_actions)
            over = np.array([outcome.terminated for outcome in after], dtype=np.bool_)
            if (over & (said.initiation | ~said.termination)).any():
                return False
            going = np.flatnonzero(~over & ~said.termination)
            if not len(going):
                return True
            states, rngs = [after[n].state for n in going], [rngs[n] for n in going]
            said = Judgement(said.initiation[going], said.termination[going], said.optimal[going])
        return False

    def _states(self) -> list[Any]:
        domain = self.domain
        rng = generator(0, 'reference contract', 'states')
        if is_enumerable(domain) and domain.n_states <= ALL:
            drawn = domain.sample_states(rng, 20 * domain.n_states)
            return list(dict.fromkeys(drawn))
        return domain.sample_states(rng, SAMPLE)
