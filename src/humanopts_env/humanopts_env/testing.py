"""
The contracts of domains and of reference options, as test classes for pytest.

Use them in the tests of a package that adds a domain::

    class TestMyDomain(DomainContract):
        def make(self) -> Domain:
            return MyDomain()

    class TestMyOptions(ReferenceContract):
        def make(self) -> Domain:
            return MyDomain()

A contract is a list of claims: functions that raise an AssertionError if the claim does not hold.
Each becomes a test. Claims about tables or a capability pass for domains without them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

from humanopts_env import colours
from humanopts_env.board import board_text
from humanopts_env.domains.base import (
    Domain,
    is_enumerable,
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
from humanopts_env.domains.check import Breach, CLAIMS, Evidence, refuses
from humanopts_env.domains.formulas import feature_columns, stacked
from humanopts_env.domains.reference import judge_states, Judgement, ReferenceOption
from humanopts_env.domains.registry import reference_options
from humanopts_env.games import games_at, new_games, StateGames
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

STEPS, SAMPLES = 300, 50  # steps of the random walk; additional sampled states
MANY = 40  # games played in parallel
ALIKE = 10  # states with equal features that must be drawn equally
MAX_STATES = 400  # states of an enumerable domain compared one by one
MAX_EFFECT, MAX_WORDS = 50, 90  # characters
MAX_HELP_ROWS = 18  # rows that fit on a terminal
COLOURS = {'', *(value for name, value in vars(colours).items() if name.isupper())}
ALL, SAMPLE = 2000, 600  # maximum states to evaluate fully; sample size otherwise
ONE_BY_ONE = 40  # states evaluated one by one, and runs played
MAX_RUN = 1000  # steps of a run in a domain without a limit


def its_parameters_make_an_equal_domain(seen: Evidence) -> None:
    domain = seen.domain
    again: Any = type(domain)(**dict(domain.parameters))
    for part in ('name', 'gamma', 'max_steps', 'parameters', 'features', 'actions'):
        one, other = (getattr(each, part) for each in (domain, again))
        alike = one == other or list(one) == list(other)
        assert alike, f'made again from its parameters, it has other {part}'
    walked = Evidence(again, len(seen.steps)).steps
    assert walked == seen.steps, 'made again from its parameters, it plays another game'


def sampled_states_are_never_over_and_depend_on_the_generator_alone(seen: Evidence) -> None:
    domain = seen.domain
    draws = [domain.sample_states(seen.rng('sample'), 20) for _ in range(2)]
    assert draws[0] == draws[1], 'the same generator draws other states'
    assert len(draws[0]) == 20, f'20 states were asked for, and {len(draws[0])} are drawn'
    assert domain.sample_states(seen.rng(), 0) == [], 'no states were asked for, and some drawn'
    begun = [domain.reset(seen.rng('reset', number)) for number in range(20)]
    for state in (*draws[0], *begun):
        assert not domain.is_over(state), f'the task is over in {domain.encode(state)!r}'


def not_every_state_can_follow(seen: Evidence) -> None:
    steps = seen.steps
    allowed = [
        seen.domain.can_follow(state, action, other.state)
        for (state, action, _), (_, _, other) in zip(steps, steps[len(steps) // 2 :])
    ]
    assert not all(allowed), 'any state can follow any other'


def marks_are_in_open_cells_and_what_cannot_move_is_always_the_same(seen: Evidence) -> None:
    fixed = set()
    for state in seen.states:
        for shown in (None, ()):
            board, where = board_of(seen.domain, state, shown), seen.domain.encode(state)
            fixed.add((board.rows, board.cols, board.blocks, board.walls, board.colour))
            cells = {mark.cell for mark in board.marks}
            assert cells.isdisjoint(board.blocks), f'a mark is in a block in {where!r}'
            inside = {*product(range(board.rows), range(board.cols))}
            assert inside.issuperset(board.blocks), f'a block is outside the board in {where!r}'
            for wall in board.walls:
                top, left, bottom, right = wall
                assert (top == bottom) != (left == right), f'the wall {wall} slants, or is a point'
                on_board = 0 <= top <= bottom <= board.rows and 0 <= left <= right <= board.cols
                assert on_board, f'the wall {wall} is outside the board'
            for mark in board.marks:
                named = len(mark.kind) == 1 and mark.kind.isprintable() and mark.name
                assert named, f'{mark} has no name, or its kind is not one character'
            used = {mark.colour for mark in board.marks} | {board.colour}
            assert used <= COLOURS, f'{used - COLOURS} is not in humanopts_env.colours'
    assert len(fixed) == 1, 'size, blocks, walls or colour of the board change'


def a_board_shows_the_chosen_features_and_nothing_else(seen: Evidence) -> None:
    domain, states = seen.domain, seen.states
    rows = np.array([domain.feature_values(state) for state in states]).tolist()
    single = [{feature.name} for feature in domain.features]
    half = {feature.name for feature in domain.features[::2]}
    for shown in (*single, half, set[str](), None):
        columns = [k for k, f in enumerate(domain.features) if shown is None or f.name in shown]
        alike: dict[tuple[float, ...], list[Any]] = {}
        for state, row in zip(states, rows):
            alike.setdefault(tuple(row[k] for k in columns), []).append(state)
        drawn: dict[str, set[str]] = {}  # board -> values that it should show
        for values, group in alike.items():
            boards = {board_of(domain, state, shown) for state in group[:ALIKE]}
            if shown is not None:
                assert len(boards) == 1, f'with {sorted(shown)} shown, the board shows more'
            words = [domain.features[k].text(value) for k, value in zip(columns, values)]
            drawn.setdefault(board_text(boards.pop()), set()).add(', '.join(words))
        if shown is None or len(shown) == 1:
            hidden = [texts for texts in drawn.values() if len(texts) > 1]
            assert not hidden, f'{shown} cannot be seen on the board: {hidden[:1]}'


def tables_agree_with_states_and_steps(seen: Evidence) -> None:
    domain = seen.domain
    if not is_enumerable(domain):
        return
    count, table, over = domain.n_states, domain.transitions(), domain.over()
    for bad in (-1, count):
        assert refuses(domain.state_at, bad), f'there is a state {bad}'
    assert domain.transitions() is table, 'the transitions are built again at every call'
    shape = (count, len(domain.actions), table.successor.shape[2])
    starts = domain.start_states()
    arrays: tuple[tuple[str, NDArray[Any], Any, tuple[int, ...]], ...] = (
        ('successor', table.successor, np.int32, shape),
        ('probability', table.probability, np.float64, shape),
        ('reward', table.reward, np.float64, shape),
        ('terminated', table.terminated, np.bool_, shape),
        ('feature_table', domain.feature_table(), np.float64, (count, len(domain.features))),
        ('over', over, np.bool_, (count,)),
        ('start_states', starts, np.int32, (len(starts),)),
    )
    for name, array, dtype, axes in arrays:
        assert array.shape == axes, f'{name} has the shape {array.shape}, but must have {axes}'
        assert array.dtype == dtype, f'{name} has the type {array.dtype}, but must have {dtype}'
        assert not array.flags.writeable, f'{name} can be written to'
    for index in range(0, count, max(1, count // MAX_STATES)):
        state, action = domain.state_at(index), index % len(domain.actions)
        where = seen.where(state, action)
        assert domain.index(state) == index, f'{where} has another index than {index}'
        row = domain.feature_table()[index]
        assert np.array_equal(domain.feature_values(state), row), f'feature_table differs: {where}'
        assert domain.is_over(state) == over[index], f'over and is_over disagree in {where}'
        if over[index]:
            continue
        outcome, at = domain.step(state, action, seen.rng('table', index)), (index, action)
        possible = table.probability[at] > 0
        match = possible & (table.successor[at] == domain.index(outcome.state))
        match &= table.reward[at] == outcome.reward
        match &= table.terminated[at] == outcome.terminated
        assert match.any(), f'the outcome of {where} is not in the transitions'
        far = (index + count // 2) % count
        may = domain.can_follow(state, action, domain.state_at(far))
        assert may == (far in table.successor[at][possible]), f'can_follow differs: {where}'
    assert len(set(starts.tolist())) == len(starts) > 0, 'there are no start states, or one twice'
    assert not over[starts].any(), 'the task is over in a start state'
    drawn = {domain.index(domain.reset(seen.rng('starts', n))) for n in range(50)}
    assert drawn <= set(starts.tolist()), 'reset draws a state that is not in start_states'
    assert len(drawn) > 1 or len(starts) == 1, 'reset draws one of several start states only'


def layouts_are_as_large_as_the_board_and_leave_out_its_blocks(seen: Evidence) -> None:
    domain = seen.domain
    for layout in domain.board_slices() if is_enumerable(domain) else ():
        states, board = layout.states, board_of(domain, seen.states[0], ())
        known = (states >= -1) & (states < domain.n_states)  # type: ignore[attr-defined]
        assert known.all(), f'the layout {layout.title!r} names states that there are not'
        empty = tuple(map(tuple, np.argwhere(states < 0).tolist()))
        same = states.shape == (board.rows, board.cols) and empty == tuple(sorted(board.blocks))
        assert same, f'the layout {layout.title!r} has another size or blocks than the board'


def many_games_are_single_games(seen: Evidence) -> None:
    """With its own generator, each game is the same as a single one; copies are independent."""
    domain, rng = seen.domain, seen.rng('games')
    states = [state for state in seen.states if not domain.is_over(state)][:MANY]
    games, single = games_at(domain, states), StateGames(domain, list(states))
    assert games.domain is domain, 'games are of another domain'
    some = games.take(np.array([0, len(states) - 1, 0]))
    assert some.states() == [states[0], states[-1], states[0]], 'copied games are others'
    some.step(rng.integers(len(domain.actions), size=3), rng)
    assert games.states() == states, 'a step of copied games changes these'
    ours, theirs = ([seen.rng('own', n) for n in range(len(states))] for _ in range(2))
    for _ in range(5):
        same = np.array_equal(games.features(), single.features())
        assert same, 'many games have other features than single ones'
        actions = rng.integers(len(domain.actions), size=len(states))
        steps, wanted = games.step(actions, ours), single.step(actions, theirs)
        for part in ('reward', 'over'):
            same = np.array_equal(getattr(steps, part), getattr(wanted, part))
            assert same, f'many games come to another {part} than single ones'
        assert np.array_equal(games.over(), steps.over), 'over() and the step disagree'
        assert games.states() == single.states(), 'many games come to other states'
    for game in np.flatnonzero(~games.over()):
        alike = ours[game].random() == theirs[game].random()
        assert alike, 'many games draw more or less from their chance than single ones'
    for values in games.outcomes().values():
        assert len(values) == len(states), 'there is not one outcome for each game'
    games.reset(np.array([1]), rng)
    assert games.states()[2:] == single.states()[2:], 'a reset changes other games'


def games_with_one_chance_play_by_the_rules_and_stay_over(seen: Evidence) -> None:
    domain, rng = seen.domain, seen.rng('games', 'one chance')
    games = new_games(domain, MANY, rng)
    assert games.over().tolist() == [False] * MANY, 'new games are over or too few'
    for _ in range(100):
        over, before = games.over(), games.states()
        actions = rng.integers(len(domain.actions), size=MANY)
        steps, after = games.step(actions, rng), games.states()
        assert not steps.reward[over].any(), 'a game earns something after its end'
        for game in np.flatnonzero(over):
            assert after[game] == before[game], 'a game that was over goes on'
        for game in np.flatnonzero(~over)[:1]:
            at = before[game], int(actions[game])
            can = domain.can_follow(*at, after[game])
            assert can, f'many games: {seen.where(*at)} leads where it cannot'
    if isinstance(games, HasPlanningFeatures):
        values = games.planning_features()
        assert values.shape[0] == MANY, 'there is not one row of planning features for each game'
        assert (values >= 0).all(), 'a planning feature is negative'


def a_search_space_is_whole(seen: Evidence) -> None:
    if not isinstance(seen.domain, HasSearchSpace):
        return
    space = seen.domain.search_space()
    table, count, actions = space.transitions, len(space.over), len(seen.domain.actions)
    assert table.successor.shape[:2] == (count, actions), 'its transitions have another shape'
    inside = (table.successor >= 0) & (table.successor < count)
    assert inside.all(), 'a step leads out of the search space'
    assert space.starts.size, 'no task can begin in the search space'
    assert space.goals is None or space.goals.any(), 'no state of the search space is a goal'
    assert set(space.cell) == set(range(len(space.cell_names))), 'a cell is empty or nameless'
    _assert_once(space.cell_names, 'names of cells')
    assert not space.events or space.status.max() < len(space.events), 'an event has no name'


def an_effect_is_described_in_a_few_words(seen: Evidence) -> None:
    domain = seen.domain
    for state, action, outcome in seen.steps if isinstance(domain, HasStepEffects) else ():
        effect = step_effect(domain, state, action, outcome.state)
        where, text = f'{seen.where(state, action)}: {effect}', effect.text
        words = 0 < len(text) <= MAX_EFFECT and text == text.strip(' .\n')
        assert words, f'{where} is not a few words without a stop'
        assert effect.changed or not outcome.terminated, f'{where}, and the task is over'
        assert outcome.state != state or not effect.changed, f'{where}, and nothing changed'
        again = [domain.decode(domain.encode(each)) for each in (state, outcome.state)]
        assert step_effect(domain, again[0], action, again[1]) == effect, f'{where} changes'


def texts_are_short_and_unique(seen: Evidence) -> None:
    """Check the options to teach, the feature groups, and the explanation of the game."""
    domain = seen.domain
    if isinstance(domain, HasTeachingDefaults):
        _assert_once(domain.teaching.options, 'options to teach')
    groups, rows = feature_groups(domain), explanation(domain)
    grouped = [name for group in groups for name in group.features]
    _assert_once(grouped, 'features in groups')
    _assert_once([group.words for group in groups], 'names of groups')
    known = {feature.name for feature in domain.features}
    assert set(grouped) <= known, f'groups name unknown features: {set(grouped) - known}'
    assert all(len(group.features) > 1 for group in groups), 'a group has one feature'
    _assert_once([sign for signs, _ in rows for sign in signs.split()], 'signs explained')
    assert not rows or rows[0][0] == '', 'the explanation does not begin with what to do'
    fits = len(rows) + len(domain.actions) <= MAX_HELP_ROWS
    assert fits, f'the explanation and the keys do not fit in {MAX_HELP_ROWS} rows'
    for words in (*(group.words for group in groups), *(words for _, words in rows)):
        assert 0 < len(words) <= MAX_WORDS, f'{words!r} is empty or long'


def baselines_play_the_same_game(seen: Evidence) -> None:
    domain = seen.domain
    if not isinstance(domain, HasBaselines):
        return
    found = domain.baselines()
    for changed in found.variants.values():
        variant: Any = type(domain)(**{**domain.parameters, **changed})
        assert list(variant.features) == list(domain.features), f'{changed} is another game'
    if found.heuristic is not None:
        actions = found.heuristic(games_at(domain, [step[0] for step in seen.steps[:MANY]]))
        inside = (actions >= 0) & (actions < len(domain.actions))
        assert inside.all(), 'the rule written by hand takes actions that there are not'


DOMAIN_CLAIMS = (
    *CLAIMS,
    its_parameters_make_an_equal_domain,
    sampled_states_are_never_over_and_depend_on_the_generator_alone,
    not_every_state_can_follow,
    marks_are_in_open_cells_and_what_cannot_move_is_always_the_same,
    a_board_shows_the_chosen_features_and_nothing_else,
    tables_agree_with_states_and_steps,
    layouts_are_as_large_as_the_board_and_leave_out_its_blocks,
    many_games_are_single_games,
    games_with_one_chance_play_by_the_rules_and_stay_over,
    a_search_space_is_whole,
    an_effect_is_described_in_a_few_words,
    texts_are_short_and_unique,
    baselines_play_the_same_game,
)


def _assert_once(names: Collection[str], what: str) -> None:
    assert len(set(names)) == len(names), f'not distinct: {what}: {", ".join(names)}'


class OptionEvidence:
    """The options of a domain, evaluated in its open states or in a sample of them."""

    def __init__(self, domain: Domain, options: Mapping[str, ReferenceOption]) -> None:
        self.domain, self.options = domain, options

    @cached_property
    def states(self) -> list[Any]:
        rng, domain = generator(0, 'reference contract', 'states'), self.domain
        if is_enumerable(domain) and domain.n_states <= ALL:
            return list(dict.fromkeys(domain.sample_states(rng, 20 * domain.n_states)))
        return domain.sample_states(rng, SAMPLE)

    @cached_property
    def judged(self) -> dict[str, Judgement]:
        """The evaluation of each option in the states."""
        actions = len(self.domain.actions)
        return {
            name: judge_states(option, self.states, actions)
            for name, option in self.options.items()
        }


def each_has_a_name_a_definition_and_features_in_order(seen: OptionEvidence) -> None:
    assert seen.options, 'there are no reference options'
    for name, option in seen.options.items():
        good = option.name == name == name.strip().lower() != ''
        assert good, f'{name!r} is not the lower-case name {option.name!r}'
        assert option.definition.endswith('.'), f'the definition of {name} is not a sentence'
        columns = feature_columns(seen.domain, option.features)
        chosen = [column.feature.name for column in columns]
        assert list(option.features) == chosen != [], f'the features of {name} are out of order'
    if isinstance(seen.domain, HasTeachingDefaults):
        unknown = set(seen.domain.teaching.options) - set(seen.options)
        assert not unknown, f'a demo teaches unknown options: {unknown}'


def each_acts_where_it_can_start_and_has_ended_elsewhere(seen: OptionEvidence) -> None:
    for name, said in seen.judged.items():
        assert said.initiation.any(), f'{name} cannot start anywhere'
        acts = np.array_equal(said.optimal.any(axis=1), said.initiation)
        assert acts, f'{name} has no optimal action where it can start, or one elsewhere'
        ended = (said.initiation | said.termination).all()
        assert ended, f'{name} can neither start nor has it ended'


def its_features_determine_where_each_starts_and_ends(seen: OptionEvidence) -> None:
    rows = np.array([seen.domain.feature_values(state) for state in seen.states])
    for name, option in seen.options.items():
        values = stacked(feature_columns(seen.domain, option.features), rows)
        answers: dict[tuple[float, ...], tuple[bool, bool]] = {}
        said = seen.judged[name]
        pairs = zip(said.initiation.tolist(), said.termination.tolist())
        for row, answer in zip(values.tolist(), pairs):
            same = answers.setdefault(tuple(row), answer) == answer
            assert same, f'{name} starts or ends otherwise where its features are {row}'


def every_run_comes_to_its_end(seen: OptionEvidence) -> None:
    """Take the first or the last optimal action; no option can start once the task is over."""
    for name, said in seen.judged.items():
        starts = np.flatnonzero(said.initiation)
        states = [seen.states[n] for n in starts[:: max(1, len(starts) // ONE_BY_ONE)]]
        for which in (0, -1):
            _run(seen.domain, seen.options[name], states, which)


def _run(domain: Domain, option: ReferenceOption, states: Sequence[Any], which: int) -> None:
    rng, count = generator(0, 'reference contract', option.name, which), len(domain.actions)
    for _ in range(domain.max_steps or MAX_RUN):
        best = judge_states(option, states, count).optimal
        actions = [int(np.flatnonzero(each)[which]) for each in best]
        after = [domain.step(*each, rng) for each in zip(states, actions)]
        said = judge_states(option, [outcome.state for outcome in after], count)
        over = np.array([outcome.terminated for outcome in after])
        assert not (over & said.initiation).any(), f'{option.name} goes on where the task is over'
        ended = over | said.termination
        states = [outcome.state for outcome, ends in zip(after, ended) if not ends]
        if not states:
            return
    raise Breach(f'{option.name} never ends from where {domain.encode(states[0])!r} is reached')


def one_state_is_judged_as_many_are(seen: OptionEvidence) -> None:
    for name, option in seen.options.items():
        said = seen.judged[name]
        for n in range(0, len(seen.states), max(1, len(seen.states) // ONE_BY_ONE)):
            state = seen.states[n]
            best = tuple(sorted(option.optimal_actions(state)))
            one: Any = option.can_start(state), option.ends(state), best
            many = said.initiation[n], said.termination[n], tuple(np.flatnonzero(said.optimal[n]))
            where = seen.domain.encode(state)
            assert one == many, f'{name} is judged otherwise among many states: {where!r}'


OPTION_CLAIMS = (
    each_has_a_name_a_definition_and_features_in_order,
    each_acts_where_it_can_start_and_has_ended_elsewhere,
    its_features_determine_where_each_starts_and_ends,
    every_run_comes_to_its_end,
    one_state_is_judged_as_many_are,
)


class DomainContract:
    """Tests that a domain satisfies the contract of ``humanopts_env.domains.base``."""

    def make(self) -> Domain:
        """Return a new instance of the domain to test."""
        # not abstract: pytest would only report that it cannot create the class
        raise NotImplementedError('make() must return the domain to test')


class ReferenceContract:
    """Tests that reference options satisfy ``humanopts_env.domains.reference``."""

    def make(self) -> Domain:
        """Return a new instance of the domain of the options."""
        # not abstract, as in DomainContract
        raise NotImplementedError('make() must return the domain whose options are tested')

    def options(self, domain: Domain) -> Mapping[str, ReferenceOption]:
        """Return the options to test by name; default: the registered ones."""
        return reference_options(domain)


@lru_cache(maxsize=1)  # one object per test class: its tests run in sequence
def _evidence(suite: Callable[[], Any]) -> Any:
    made, domain = suite(), suite().make()
    if isinstance(made, ReferenceContract):
        return OptionEvidence(domain, made.options(domain))
    return Evidence(domain, STEPS, SAMPLES)


def _test_of(claim: Callable[[Any], None]) -> Callable[[Any], None]:
    def test(self: Any) -> None:
        suite: Any = type(self)
        claim(_evidence(suite))

    return test


for _suite, _claims in ((DomainContract, DOMAIN_CLAIMS), (ReferenceContract, OPTION_CLAIMS)):
    for _claim in _claims:
        setattr(_suite, f'test_{_claim.__name__}', _test_of(_claim))
