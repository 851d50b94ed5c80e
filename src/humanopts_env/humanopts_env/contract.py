"""
The contract of domains: a test class for pytest, and a quick check before a game is played.

In the tests of a package that adds a domain::

    class TestMyDomain(DomainContract):
        def make(self) -> Domain[Any]:
            return MyDomain()

``make_domain`` checks a domain of another package with ``check_domain`` before it returns it.

Tests of enumerable domains or of a capability pass for domains that are not enumerable or lack it.
"""

from collections.abc import Iterator
import json
import math
import re
import time
from typing import Any

from humanopts_env import colours
from humanopts_env.arrays import Rows
from humanopts_env.board import Board, board_text
from humanopts_env.domains.base import (
    ActableDomain,
    Action,
    Domain,
    DomainError,
    EnumerableDomain,
    Feature,
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
NAME = re.compile(r'[a-z][a-z0-9_]*')
NAMED_KEYS = {'up', 'down', 'left', 'right'}
COLOURS = {'', *(value for name, value in vars(colours).items() if name.isupper())}
Step = tuple[Any, int, Outcome[Any]]


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


def refuses(call: Any) -> bool:
    """Return whether a call raises DomainError."""
    try:
        call()
    except DomainError:
        return True
    return False


QUICK_STEPS = 60  # of the random walk
SECONDS = 0.025  # after which no more steps are taken
SMALL = 20_000  # largest number of states whose tables are checked
PARTS = dict.fromkeys(
    part
    for kind in (ActableDomain, Domain)
    for part in (*kind.__annotations__, *vars(kind))
    if not part.startswith('_')
)


class ContractError(DomainError):
    """A domain breaks the contract; the text says which domain and what is wrong."""


class Breach(AssertionError):  # noqa: N818 - a test fails by it; or it becomes a ContractError
    """What a domain does against the contract, in words."""


def check_domain(domain: Domain[Any], name: str) -> None:
    """
    Check by sampling that a domain satisfies the contract that a game relies on.

    It takes some hundredths of a second, so it finds gross errors only; the tests of
    ``DomainContract`` check everything.

    :param name: the name under which the domain is registered.
    :raises ContractError: the domain breaks the contract, or raises an unexpected error.
    """
    try:
        missing = [part for part in PARTS if not hasattr(domain, part)]
        _expect(not missing, f'it has no {", ".join(missing)}')
        _expect(domain.name == name, f'it calls itself {domain.name!r}')
        check_form(domain)
        _check_walk(domain)
        check_refusals(domain)
        if is_enumerable(domain) and domain.n_states <= SMALL:
            check_tables(domain)
    except Breach as breach:
        raise ContractError(f'{name} breaks the contract of domains: {breach}') from None
    except (Exception, SystemExit) as error:  # whatever a plug-in raises
        raise ContractError(
            f'{name} breaks the contract of domains: it raised {type(error).__name__}: {error}'
        ) from error


def _expect(kept: object, breach: str) -> None:
    if not kept:
        raise Breach(breach)


def check_description(domain: ActableDomain) -> None:
    """
    Check what a domain says of itself.

    :raises ContractError: it cannot be used.
    """
    try:
        check_form(domain)
    except Breach as breach:
        raise ContractError(f'{domain.name!r} cannot be used: {breach}') from None


def check_form(domain: ActableDomain) -> None:
    """
    Check names, keys, numbers and parameters.

    :raises Breach: one of them cannot be used; as all checks below.
    """
    json.dumps(dict(domain.parameters))
    _expect(0 < domain.gamma <= 1, f'gamma is {domain.gamma}, not above 0 and at most 1')
    _expect(domain.max_steps >= 0, f'max_steps is {domain.max_steps}')
    _expect(all(isinstance(f, Feature) for f in domain.features), 'a feature is no Feature')
    _expect(all(isinstance(a, Action) for a in domain.actions), 'an action is no Action')
    for kind, names in (
        ('feature', [feature.name for feature in domain.features]),
        ('action', [action.name for action in domain.actions]),
    ):
        _expect(names, f'it has no {kind}')
        _expect(len(set(names)) == len(names), f'two {kind}s have one name: {names}')
        for one in names:
            _expect(NAME.fullmatch(one), f'the {kind} name {one!r} is not snake_case')
    for feature in domain.features:
        if feature.kind is FeatureKind.CONTINUOUS:
            _expect(
                math.isfinite(feature.span) and feature.low < feature.high,
                f'the feature {feature.name} has the range {feature.low} to {feature.high}',
            )
        else:
            _expect(feature.values, f'the feature {feature.name} has no values')
    keys = [action.key for action in domain.actions]
    _expect(len(set(keys)) == len(keys), f'two actions have one key: {keys}')
    for key in keys:
        _expect(len(key) == 1 or key in NAMED_KEYS, f'{key!r} is no key')


def _check_walk(domain: Domain[Any]) -> None:
    """Take random steps, each twice with the same generator, until the time is over."""
    began, rng = time.perf_counter(), generator(0, 'check')
    state = domain.reset(rng)
    _expect(not domain.is_over(state), f'it begins where the task is over: {state}')
    for number in range(QUICK_STEPS):
        check_state(domain, state)
        action = int(rng.integers(len(domain.actions)))
        outcome, again = (domain.step(state, action, generator(1, number)) for _ in range(2))
        where = f'{domain.actions[action].name} in {domain.encode(state)!r}'
        same = outcome == again or math.isnan(outcome.reward)  # nan is refused below
        _expect(same, f'{where} is not the same again with the same generator')
        check_step(domain, state, action, outcome)
        if outcome.terminated:
            check_end(domain, outcome.state)
        state = domain.reset(rng) if outcome.terminated else outcome.state
        if time.perf_counter() - began > SECONDS:
            break


def check_step(domain: Domain[Any], state: Any, action: int, outcome: Outcome[Any]) -> None:
    """Check the outcome of a step."""
    where = f'{domain.actions[action].name} in {domain.encode(state)!r}'
    _expect(math.isfinite(outcome.reward), f'{where} has the reward {outcome.reward}')
    over = domain.is_over(outcome.state)
    _expect(outcome.terminated == over, f'{where}: terminated and is_over disagree')
    _expect(domain.can_follow(state, action, outcome.state), f'can_follow denies {where}')


def check_state(domain: Domain[Any], state: Any) -> None:
    """Check text, feature values and board of a state."""
    text, values = domain.encode(state), domain.feature_values(state)
    _expect(len(text.splitlines()) == 1, f'{text!r} is not one line')
    _expect(domain.decode(text) == state, f'{text!r} is read back as another state')
    _expect(values.shape == (len(domain.features),), f'{text!r} has {values.shape} features')
    _check_values(domain, values[None], text)
    board = board_of(domain, state)
    _expect(board != Board(), f'{text!r} is drawn as nothing')
    for mark in board.marks:
        inside = 0 <= mark.cell[0] < board.rows and 0 <= mark.cell[1] < board.cols
        _expect(inside, f'{mark.name} is drawn outside the board in {text!r}')


def _check_values(domain: Domain[Any], rows: Rows, where: str) -> None:
    for feature, column in zip(domain.features, rows.T):
        high = feature.low + feature.span
        for value in np.unique(column):
            _expect(
                feature.has(value),
                f'the feature {feature.name} is {value:g} in {where}, out of its range '
                f'{feature.low:g}..{high:g}',
            )


def check_refusals(domain: Domain[Any]) -> None:
    """Check that actions and texts that are not in the domain are refused."""
    rng = generator(0, 'check', 'refusals')
    state = domain.reset(rng)
    for action in (-1, len(domain.actions)):
        refused = refuses(lambda action=action: domain.step(state, action, rng))
        _expect(refused, f'it takes the action {action}, of {len(domain.actions)}')
    refused = refuses(lambda: domain.decode('no state at all'))
    _expect(refused, 'it reads "no state at all" as a state')


def check_end(domain: Domain[Any], state: Any) -> None:
    """Check that no step is taken where the task is over."""
    for action in range(len(domain.actions)):
        refused = refuses(lambda a=action: domain.step(state, a, generator(0, 'check', 'end')))
        _expect(refused, f'it takes a step after the end, in {domain.encode(state)!r}')


def check_tables(domain: EnumerableDomain[Any]) -> None:
    """Check the tables of a domain whose states can all be listed."""
    table = domain.transitions()
    _expect(np.allclose(table.probability.sum(axis=2), 1), 'probabilities do not sum to 1')
    _expect(table.probability.min() >= 0, 'a probability is negative')
    inside = (table.successor >= 0) & (table.successor < domain.n_states)
    _expect(inside.all(), 'a transition leads to no state')
    _check_values(domain, domain.feature_table(), 'its feature table')
    for index in np.flatnonzero(domain.over())[:5]:
        check_end(domain, domain.state_at(int(index)))
