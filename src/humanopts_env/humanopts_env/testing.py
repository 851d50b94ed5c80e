"""
The contracts of domains and of reference options, as test classes for pytest.

In the tests of a package that adds a domain::

    class TestMyDomain(DomainContract):
        def make(self) -> Domain[Any]:
            return MyDomain()

    class TestMyOptions(ReferenceContract):
        def make(self) -> Domain[Any]:
            return MyDomain()

Tests of enumerable domains or of a capability pass for domains that are not enumerable or lack it.
"""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import lru_cache
import json
from typing import Any, cast

from humanopts_env import colours
from humanopts_env.arrays import Rows
from humanopts_env.board import board_text
from humanopts_env.domains.base import (
    Domain,
    EnumerableDomain,
    feature_columns,
    FeatureKind,
    is_enumerable,
    Outcome,
)
from humanopts_env.domains.capabilities import (
    board_of,
    explanation,
    feature_groups,
    HasBaselines,
    HasPlanningFeatures,
    HasSearchSpace,
    HasStepEffects,
    HasTeachingDefaults,
    step_effect,
)
from humanopts_env.domains.check import (
    check_end,
    check_form,
    check_refusals,
    check_state,
    check_step,
    check_tables,
    refuses,
)
from humanopts_env.domains.reference import judge_states, Judgement, ReferenceOption
from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.tabular import reachable
from humanopts_env.games import games_at, new_games
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

STEPS = 300  # of the random walk of the tests
MANY = 40  # games in a batch of the tests
ALIKE = 10  # states that agree and are drawn alike
DRAWN = 150  # outcomes drawn of one step until that of a batch is among them
LONGEST_EFFECT = 50  # characters
MOST_HELP_ROWS = 18  # that a terminal shows
CHECKED = 400  # states and transitions of an enumerable domain compared one by one
COLOURS = {'', *(value for name, value in vars(colours).items() if name.isupper())}
Step = tuple[Any, int, Outcome[Any]]


ALL = 2000  # the tests use sampled states of a domain with more
SAMPLE = 600
ONE_BY_ONE = 40  # states that are judged one by one, and runs that are played
LONGEST = 1000  # steps of a run, where the domain has no limit of its own


class DomainContract:
    """Tests that a domain keeps the promises of ``humanopts_env.domains.base``."""

    def make(self) -> Domain[Any]:
        """Return the domain to test; a new one at every call."""
        # not abstract: pytest would report that it cannot make the class, not what is missing
        raise NotImplementedError('make() must return the domain to test')

    def test_names_keys_and_questions_are_distinct_and_well_formed(self) -> None:
        """People and messages can name every feature and action; returns are finite."""
        domain = self.make()
        check_form(domain)
        assert domain.name.strip() == domain.name != ''
        assert isinstance(domain.max_steps, int)
        questions = [feature.question for feature in domain.features]
        assert len(set(questions)) == len(questions), f'not distinct: {questions}'
        for feature in domain.features:
            assert feature.question == feature.question.strip(' ?') != ''
            assert len(set(feature.values)) == len(feature.values), feature.name
        assert all(action.description.strip() for action in domain.actions)

    def test_parameters_make_an_equal_domain(self) -> None:
        """A message or a file with the parameters identifies the game."""
        domain = self.make()
        again = type(domain)(**dict(domain.parameters))
        for field in ('name', 'gamma', 'max_steps'):
            assert getattr(again, field) == getattr(domain, field)
        assert dict(again.parameters) == dict(domain.parameters)
        assert list(again.features) == list(domain.features)
        assert list(again.actions) == list(domain.actions)
        assert _walk(again, 1) == _walk(domain, 1)

    def test_the_same_seed_plays_the_same_game(self) -> None:
        """All chance comes from the generator that is passed."""
        domain = self.make()
        assert _walk(domain, 2) == _walk(domain, 2)
        count = 20
        draws = [domain.sample_states(_rng('sample'), count) for _ in range(2)]
        assert draws[0] == draws[1]

    def test_a_state_has_feature_values_and_a_text(self) -> None:
        """Every feature value has a name; one line of text holds a whole state."""
        domain = self.make()
        for state in _states(domain):
            check_state(domain, state)
            assert domain.feature_values(state).dtype == np.float64
            assert hash(domain.decode(domain.encode(state))) == hash(state)

    def test_text_that_is_no_state_is_refused(self) -> None:
        """Only what ``encode`` writes is a state."""
        domain = self.make()
        text = domain.encode(domain.reset(_rng('bad text')))
        for bad in ('', 'nonsense', text + ' ', ' ' + text, text + '\n', text + text):
            assert refuses(lambda bad=bad: domain.decode(bad)), f'{bad!r} was not refused'

    def test_an_action_that_is_not_in_the_domain_is_refused(self) -> None:
        """Indices are checked, including negative ones."""
        check_refusals(self.make())

    def test_no_step_is_taken_after_the_end(self) -> None:
        """A task that is over stays over."""
        domain = self.make()
        ends = [outcome.state for _, _, outcome in _walk(domain, 3) if outcome.terminated]
        if is_enumerable(domain):
            ends += [domain.state_at(int(i)) for i in np.flatnonzero(domain.over())[:CHECKED]]
        for state in ends:
            assert domain.is_over(state)
            check_end(domain, state)

    def test_what_a_step_did_can_follow(self) -> None:
        """
        A recorded trajectory is always accepted, and one that jumps is not.

        An outcome is terminated exactly if its state is over, and every reward is a number.
        """
        domain = self.make()
        steps = _walk(domain, 5)
        for step in steps:
            check_step(domain, *step)
        allowed = [
            domain.can_follow(state, action, other.state)
            for (state, action, _), (_, _, other) in zip(steps, steps[len(steps) // 2 :])
        ]
        assert not all(allowed), 'any state can follow any other'

    def test_states_to_start_from_are_not_over(self) -> None:
        """A person is never asked to demonstrate where no step can be taken."""
        domain = self.make()
        states = domain.sample_states(_rng('sample'), 50)
        assert len(states) == 50
        assert domain.sample_states(_rng('sample'), 0) == []
        assert not any(domain.is_over(state) for state in states)
        assert not any(domain.is_over(domain.reset(_rng('reset', i))) for i in range(20))

    def test_what_is_on_the_board_is_in_its_cells(self) -> None:
        """Marks stand where something can be, and what cannot move is the same in every state."""
        domain = self.make()
        fixed = set()
        for state in _states(domain):
            for shown in (None, ()):
                board = board_of(domain, state, shown)
                fixed.add((board.rows, board.cols, board.blocks, board.walls, board.colour))
                cells = {mark.cell for mark in board.marks}
                assert cells.isdisjoint(board.blocks)
                for row, col in cells | set(board.blocks):
                    assert 0 <= row < board.rows
                    assert 0 <= col < board.cols
                for top, left, bottom, right in board.walls:
                    assert 0 <= top <= bottom <= board.rows
                    assert 0 <= left <= right <= board.cols
                    assert (top == bottom) != (left == right)
                assert all(len(mark.kind) == 1 and mark.kind.isprintable() for mark in board.marks)
                assert all(mark.name for mark in board.marks)
                assert {mark.colour for mark in board.marks} | {board.colour} <= COLOURS
        assert len(fixed) == 1

    def test_the_board_shows_all_that_may_be_seen(self) -> None:
        """States that differ in a feature that is shown are drawn differently."""
        domain = self.make()
        states = _states(domain)
        rows = _rows(domain, states)
        for shown in (*_single_features(domain), None):
            alike = _alike(domain, states, rows, shown, in_words=True)
            drawn = {board_text(board_of(domain, group[0], shown)) for group in alike}
            assert len(drawn) == len(alike), f'{shown} cannot be seen on the board'

    def test_the_board_shows_nothing_else(self) -> None:
        """States that agree in the features that are shown are drawn alike."""
        domain = self.make()
        states = _states(domain)
        rows = _rows(domain, states)
        half = {feature.name for feature in domain.features[::2]}
        for shown in (*_single_features(domain), half, set()):
            for group in _alike(domain, states, rows, shown):
                drawn = {board_of(domain, state, shown) for state in group[:ALIKE]}
                assert len(drawn) == 1, f'more than {sorted(shown)} can be seen'

    def test_states_are_numbered_without_gaps(self) -> None:
        """``index`` and ``state_at`` are inverse to each other."""
        domain = self.make()
        if is_enumerable(domain):
            for index in _sample(domain):
                assert domain.index(domain.state_at(index)) == index
            for bad in (-1, domain.n_states):
                assert refuses(lambda bad=bad: domain.state_at(bad))

    def test_tables_have_their_shapes_and_cannot_be_changed(self) -> None:
        """Shared arrays are read-only."""
        domain = self.make()
        if not is_enumerable(domain):
            return
        table, count = domain.transitions(), domain.n_states
        shape = (count, len(domain.actions), table.successor.shape[2])
        arrays: dict[str, tuple[NDArray[Any], type, tuple[int, ...]]] = {
            'successor': (table.successor, np.int32, shape),
            'probability': (table.probability, np.float64, shape),
            'reward': (table.reward, np.float64, shape),
            'terminated': (table.terminated, np.bool_, shape),
            'feature_table': (domain.feature_table(), np.float64, (count, len(domain.features))),
            'over': (domain.over(), np.bool_, (count,)),
            'start_states': (domain.start_states(), np.int32, domain.start_states().shape),
        }
        for name, (array, dtype, expected) in arrays.items():
            assert array.shape == expected, name
            assert array.dtype == dtype, name
            assert not array.flags.writeable, f'{name} can be written to'
        assert domain.transitions() is table, 'the transitions are built again at every call'

    def test_transitions_are_probabilities_of_states(self) -> None:
        """The probabilities of each state and action sum to 1."""
        domain = self.make()
        if is_enumerable(domain):
            check_tables(domain)
            assert np.isfinite(domain.transitions().reward).all()

    def test_tables_agree_with_the_states(self) -> None:
        """Planning from tables and playing state by state are the same game."""
        domain = self.make()
        if is_enumerable(domain):
            for index in _sample(domain):
                state = domain.state_at(index)
                row = domain.feature_table()[index]
                assert np.array_equal(domain.feature_values(state), row)
                assert domain.is_over(state) == domain.over()[index]

    def test_steps_agree_with_the_transitions(self) -> None:
        """Every drawn outcome is in the table, and states outside the table cannot follow."""
        domain = self.make()
        if not is_enumerable(domain):
            return
        table = domain.transitions()
        for number, index in enumerate(_sample(domain)):
            if domain.over()[index]:
                continue
            state, action = domain.state_at(index), number % len(domain.actions)
            outcome = domain.step(state, action, _rng('table', number))
            successors = table.successor[index, action]
            possible = table.probability[index, action] > 0
            match = possible & (successors == domain.index(outcome.state))
            match &= table.reward[index, action] == outcome.reward
            match &= table.terminated[index, action] == outcome.terminated
            assert match.any(), f'{domain.actions[action].name} in {domain.encode(state)}'
            far = (index + domain.n_states // 2) % domain.n_states
            may = far in successors[possible]
            assert domain.can_follow(state, action, domain.state_at(far)) == may

    def test_reset_draws_every_start_state_and_no_other(self) -> None:
        """``start_states`` is what ``reset`` draws from."""
        domain = self.make()
        if is_enumerable(domain):
            starts = domain.start_states()
            assert len(set(starts.tolist())) == len(starts) > 0
            assert not domain.over()[starts].any()
            drawn = {domain.index(domain.reset(_rng('starts', i))) for i in range(50)}
            assert drawn <= set(starts.tolist())
            assert len(drawn) > 1 or len(starts) == 1

    def test_layouts_are_those_of_the_board(self) -> None:
        """They name states by cell, and walls are where no step leads from cell to cell."""
        domain = self.make()
        for layout in domain.board_slices() if is_enumerable(domain) else ():
            assert is_enumerable(domain)
            states = layout.states
            assert layout.title
            assert ((states >= -1) & (states < domain.n_states)).all()
            first = domain.state_at(int(states[states >= 0][0]))
            board = board_of(domain, first, ())
            assert states.shape == (board.rows, board.cols)
            assert {tuple(cell) for cell in np.argwhere(states < 0).tolist()} == set(board.blocks)
            walled = set()
            for top, left, bottom, right in board.walls:
                walled |= {((row, left - 1), (row, left)) for row in range(top, bottom)}
                walled |= {((top - 1, col), (top, col)) for col in range(left, right)}
            table, going_on = domain.transitions(), reachable(domain) & ~domain.over()
            cell_of = {
                int(s): cell for cell, s in np.ndenumerate(states) if s >= 0 and going_on[s]
            }
            steps = {
                (cell, cell_of.get(to))
                for state, cell in cell_of.items()
                for to in table.successor[state][table.probability[state] > 0].tolist()
            }
            for row, col in cell_of.values():
                for beside in {(row, col + 1), (row + 1, col)} & set(cell_of.values()):
                    pair = (row, col), beside
                    leads = not steps.isdisjoint((pair, pair[::-1]))
                    assert leads != (pair in walled), pair

    def test_many_games_are_the_same_game(self) -> None:
        """Features, end and step outcome of each game agree with those of its state."""
        domain, rng = self.make(), _rng('games')
        states = [s for s in _states(domain) if not domain.is_over(s)][:MANY]
        games = games_at(domain, states)
        assert games.domain is domain
        assert games.states() == states
        assert np.array_equal(games.features(), _rows(domain, states))
        assert not games.over().any()
        actions = rng.integers(len(domain.actions), size=len(states))
        steps = games.step(actions, rng)
        rows = games.features()
        assert np.array_equal(games.over(), steps.over)
        after = games.states()
        for number in range(0, len(states), max(1, len(states) // 8)):
            assert domain.can_follow(states[number], int(actions[number]), after[number])
            if any(feature.kind is FeatureKind.CONTINUOUS for feature in domain.features):
                continue  # no outcome is drawn twice
            came = (float(steps.reward[number]), bool(steps.over[number]), rows[number].tolist())
            outcomes = (
                domain.step(states[number], int(actions[number]), _rng('games', number, draw))
                for draw in range(DRAWN)
            )
            assert any(
                (o.reward, o.terminated, domain.feature_values(o.state).tolist()) == came
                for o in outcomes
            ), domain.encode(states[number])
        assert all(len(values) == len(states) for values in games.outcomes().values())

    def test_many_games_with_chance_of_their_own_are_single_games(self) -> None:
        """Each comes to what a step of the rules comes to, and draws the same from its chance."""
        domain, rng = self.make(), _rng('games', 'each')
        states = [s for s in _states(domain) if not domain.is_over(s)][:MANY]
        actions = rng.integers(len(domain.actions), size=len(states))
        ours, theirs = ([_rng('each', n) for n in range(len(states))] for _ in range(2))
        games = games_at(domain, states)
        steps = games.step(actions, ours)
        outcomes = [domain.step(*each) for each in zip(states, actions.tolist(), theirs)]
        assert list(steps.reward) == [outcome.reward for outcome in outcomes]
        assert list(steps.over) == [outcome.terminated for outcome in outcomes]
        assert games.states() == [outcome.state for outcome in outcomes]
        assert [own.random() for own in ours] == [own.random() for own in theirs]

    def test_games_are_copied_begun_and_over_by_themselves(self) -> None:
        """Copies are independent; games that are over do not change and earn nothing."""
        domain, rng = self.make(), _rng('games', 'copies')
        states = _states(domain)[:MANY]
        games = games_at(domain, states)
        some = games.take(np.array([0, len(states) - 1, 0]))
        assert some.states() == [states[0], states[-1], states[0]]
        for _ in range(5):
            some.step(rng.integers(len(domain.actions), size=3), rng)
        assert games.states() == states
        games.reset(np.array([1]), rng)
        assert games.states()[2:] == states[2:]
        begun = new_games(domain, MANY, rng)
        assert len(begun) == MANY
        assert not begun.over().any()
        for _ in range(100):
            over, before = begun.over(), begun.states()
            steps = begun.step(rng.integers(len(domain.actions), size=MANY), rng)
            assert not steps.reward[over].any()
            assert steps.over[over].all()
            after = begun.states()
            assert [after[n] for n in np.flatnonzero(over)] == [
                before[n] for n in np.flatnonzero(over)
            ]

    def test_planning_features_are_whole_numbers_from_0(self) -> None:
        domain = self.make()
        games = games_at(domain, _states(domain))
        if not isinstance(games, HasPlanningFeatures):
            return
        values = games.planning_features()
        assert values.ndim == 2
        assert len(values) == len(games)
        assert (values >= 0).all()

    def test_a_search_space_is_whole(self) -> None:
        """Steps lead to states of the space, every cell has a name, and features differ."""
        domain = self.make()
        if not isinstance(domain, HasSearchSpace):
            return
        space = domain.search_space()
        table, count = space.transitions, len(space.over)
        assert np.allclose(table.probability.sum(axis=2), 1)
        assert table.successor.shape[:2] == (count, len(domain.actions))
        assert ((table.successor >= 0) & (table.successor < count)).all()
        assert space.starts.size
        assert space.goals is None or space.goals.any()
        assert set(np.unique(space.cell)) == set(range(len(space.cell_names)))
        assert len(set(space.cell_names)) == len(space.cell_names)
        assert set(np.unique(space.situation)) == set(range(space.situation.max() + 1))
        if space.events:
            assert space.status.max() < len(space.events)
        assert space.rows.shape == (count, len(domain.features))
        if space.board is not None:
            assert space.board.states.max() < count

    def test_teaching_defaults_are_known(self) -> None:
        """No option is named twice; the reference options' tests check their names."""
        domain = self.make()
        if isinstance(domain, HasTeachingDefaults):
            assert len(set(domain.teaching.options)) == len(domain.teaching.options)

    def test_a_step_is_told_in_words(self) -> None:
        """A few words for each step; a step that changes nothing is said to have no effect."""
        domain = self.make()
        if not isinstance(domain, HasStepEffects):
            return
        for state, action, outcome in _walk(domain, 7):
            effect = step_effect(domain, state, action, outcome.state)
            where = f'{domain.actions[action].name} in {domain.encode(state)}: {effect}'
            assert effect.text == effect.text.strip(' .\n') != '', where
            assert len(effect.text.splitlines()) == 1, where
            assert len(effect.text) <= LONGEST_EFFECT, where
            assert effect.changed or not outcome.terminated, where
            assert outcome.state != state or not effect.changed, where
            again = [domain.decode(domain.encode(each)) for each in (state, outcome.state)]
            assert step_effect(domain, again[0], action, again[1]) == effect, where

    def test_its_explanation_fits_on_a_screen_and_names_signs_that_are_drawn(self) -> None:
        """The first line says what to do, and no sign is explained twice."""
        domain = self.make()
        rows = explanation(domain)
        signs = [sign for row, _ in rows for sign in row.split()]
        assert len(set(signs)) == len(signs)
        assert all(words == words.strip() != '' and len(words) <= 90 for _, words in rows)
        assert [row for row, _ in rows].index('') == 0 if rows else True
        assert len(rows) + len(domain.actions) <= MOST_HELP_ROWS

    def test_a_feature_is_in_one_group_at_most(self) -> None:
        """Groups have names of their own, and several features of the domain."""
        domain = self.make()
        groups = feature_groups(domain)
        grouped = [name for group in groups for name in group.features]
        assert len(set(grouped)) == len(grouped), f'twice in a group: {grouped}'
        assert set(grouped) <= {feature.name for feature in domain.features}
        assert all(len(group.features) > 1 for group in groups)
        words = [group.words for group in groups]
        assert len(set(words)) == len(words)
        assert all(each == each.strip(' .?') != '' for each in words)

    def test_baselines_play_the_same_game(self) -> None:
        """Variants can be made, and a heuristic depends on the seed only."""
        domain = self.make()
        if not isinstance(domain, HasBaselines):
            return
        found = domain.baselines()
        for changed in found.variants.values():
            variant = type(domain)(**{**domain.parameters, **changed})
            assert variant.name == domain.name
            assert list(variant.features) == list(domain.features)
        if found.heuristic is not None:
            played, again = (found.heuristic(5, 1) for _ in range(2))
            assert played.total.shape == (5,)
            assert np.array_equal(played.total, again.total)
            assert all(values.shape == (5,) for values in played.outcomes.values())


def _rng(*purpose: str | int) -> np.random.Generator:
    return generator(0, 'contract', *purpose)


def _walk(domain: Domain[Any], seed: int) -> list[Step]:
    """Return random steps, with a reset after every end."""
    rng = _rng('walk', seed)
    steps: list[Step] = []
    state = domain.reset(rng)
    for _ in range(STEPS):
        action = int(rng.integers(len(domain.actions)))
        outcome = domain.step(state, action, rng)
        steps.append((state, action, outcome))
        state = domain.reset(rng) if outcome.terminated else outcome.state
    return steps


def _states(domain: Domain[Any]) -> list[Any]:
    """Return the states of a random walk, with its ends, and some sampled states."""
    game = (type(domain), json.dumps(dict(domain.parameters)))
    if game not in _SEEN:
        _SEEN.clear()  # pytest runs the tests of a class in a row
        walk = [s for before, _, outcome in _walk(domain, 6) for s in (before, outcome.state)]
        sampled = domain.sample_states(_rng('states'), 50)
        _SEEN[game] = list(dict.fromkeys([*walk, *sampled]))
    return _SEEN[game]


_SEEN: dict[tuple[type, str], list[Any]] = {}  # states of the game that was tested last


def _rows(domain: Domain[Any], states: list[Any]) -> Rows:
    return np.array([domain.feature_values(state) for state in states])


def _sample(domain: EnumerableDomain[Any]) -> Iterator[int]:
    """Return all indices of a small domain, or evenly spaced ones of a large domain."""
    yield from range(0, domain.n_states, max(1, domain.n_states // CHECKED))


def _single_features(domain: Domain[Any]) -> list[set[str]]:
    return [{feature.name} for feature in domain.features]


def _alike(
    domain: Domain[Any],
    states: list[Any],
    rows: Rows,
    shown: set[str] | None,
    *,
    in_words: bool = False,
) -> list[list[Any]]:
    """
    Return the states in groups that agree in the features that are shown.

    :param rows: feature values (S, F) of the states.
    :param shown: names of features; None: all.
    :param in_words: agree in the texts of their values, which continuous values are rounded for.
    """
    seen = [(k, f) for k, f in enumerate(domain.features) if shown is None or f.name in shown]
    groups: dict[tuple[float | str, ...], list[Any]] = {}
    for state, row in zip(states, rows.tolist()):
        key = tuple(feature.text(row[k]) if in_words else row[k] for k, feature in seen)
        groups.setdefault(key, []).append(state)
    return list(groups.values())


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
