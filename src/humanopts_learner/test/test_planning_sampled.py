"""Sampled models and plans against exact ones, in domains small enough to have both."""

from functools import cache
from typing import Any

from humanopts_env.domains.base import Feature
from humanopts_env.domains.registry import make_domain
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_env.games import TableGames
from humanopts_env.seeding import generator
from humanopts_learner import LearnedOption, solve_smdp
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import options_from_references
from humanopts_learner.planning.abstraction import Abstraction, Column, StateRows
from humanopts_learner.planning.action_set import ActionSet, AnyOption
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import (
    Arbitration,
    ignore_progress,
    PlanCanceled,
    PlanError,
    PlanRequest,
    Progress,
    Sampling,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan, SampledPlan
from humanopts_learner.planning.sampling import SampleCounts, Sampler, Samples, samples_of
import numpy as np
import pytest

pytestmark = pytest.mark.heavy

GAMMA = 0.9
EXACT = Sampling(n_games=2000, game_steps=100, explore=0.5, interruption_margin=0.0)


@pytest.mark.parametrize('count', [0, 1, 2, 1000])
def test_the_row_of_a_state_is_where_it_is_in_the_table(count: int) -> None:
    rng = np.random.default_rng(count)
    least, most = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    states = rng.integers(least, most, size=count)
    states[: count // 2] = np.arange(-5, count // 2 - 5)  # in one bucket
    states = rng.permutation(states)
    asked = np.append(rng.integers(least, most, size=100), states)
    row = {state: number for number, state in enumerate(states.tolist())}
    assert StateRows(states)(asked).tolist() == [row.get(one, -1) for one in asked.tolist()]


def rooms_options(domain: Rooms) -> list[LearnedOption]:
    """Return the eight hallway options."""
    return options_from_references(domain, reference_options(domain).values())


def new_plan(
    action_set: str,
    steps: int = 200_000,
    progress: Progress = ignore_progress,
    goal: str = 'G1',
    **kwargs: Any,
) -> SampledPlan:
    """Plan in the rooms from samples."""
    domain = Rooms(goal)
    settings: dict[str, Any] = {'seed': 1, 'sampling': EXACT, **kwargs}
    request = PlanRequest(action_set, game_steps=steps, **settings)
    return make_sampled_plan(domain, rooms_options(domain), request, progress)


rooms_plan = cache(new_plan)  # plans are read only


@pytest.mark.parametrize('action_set', ['human', 'primitive', 'human+primitive'])
def test_values_come_near_those_of_exact_models(action_set: str) -> None:
    """Where starts are drawn from, after 200,000 steps; Rooms has chance and eight options."""
    plan = rooms_plan(action_set)
    domain = Rooms()
    exact = make_plan(domain, rooms_options(domain), PlanRequest(action_set)).solution.values
    starts = domain.start_states()
    rows = plan.actions.see(TableGames(domain, starts.astype(np.intp))).states
    number = plan.policy.values.states.searchsorted(rows)
    assert (plan.policy.values.states[number] == rows).all()
    assert plan.solution.values[number] == pytest.approx(exact[starts], abs=0.03)


def samples(*rows: tuple[int, int, float, float, int]) -> Samples:
    """Return samples: state, option, reward, discount, successor."""
    state, option, reward, discount, successor = (np.array(part) for part in zip(*rows))
    return Samples(state, option, reward.astype(float), discount.astype(float), successor)


def test_a_model_is_the_mean_of_its_samples() -> None:
    """By hand: pair (7, a) has rewards 1 and 3, and ends in 9 after one step and after two."""
    counts = SampleCounts(('a', 'b'))
    counts.add(samples((7, 0, 1.0, 0.9, 9), (9, 1, 5.0, 0.0, 9)))
    counts.add(samples((7, 0, 3.0, 0.81, 9), (9, 1, 5.0, 0.0, 9)))
    model = counts.model(min_samples=2)
    assert counts.states.tolist() == [7, 9]
    assert model.available.tolist() == [[True, False], [False, True]]
    assert model.reward[0, 0] == pytest.approx(2.0)
    assert model.rows.toarray()[0] == pytest.approx([0, (0.9 + 0.81) / 2])
    assert model.rows.toarray()[2 + 1].sum() == 0.0
    assert solve_smdp(model).values[1] == pytest.approx(5.0)
    # State 3 was left once only; what leads to it alone cannot be valued.
    counts, few = SampleCounts(('a',)), [*[(1, 0, 0.0, 0.9, 2)] * 2, *[(2, 0, 0.0, 0.9, 3)] * 2]
    counts.add(samples(*few, (3, 0, 9.0, 0.0, 3)))
    assert not counts.model(min_samples=2).available.any()
    assert counts.model(min_samples=1).available.all()


def test_successors_that_nothing_is_known_of_count_as_the_known_ones() -> None:
    """Of three samples one ended in an unknown state: the others' mean discount stays."""
    counts = SampleCounts(('a',))
    counts.add(samples((1, 0, 0.0, 0.9, 2), (1, 0, 0.0, 0.9, 2), (1, 0, 0.0, 0.6, 3)))
    counts.add(samples(*[(2, 0, 1.0, 0.0, 2)] * 2))
    model = counts.model(min_samples=2)
    one, two, three = map(counts.states.tolist().index, [1, 2, 3])
    assert model.rows.toarray()[one, two] == pytest.approx(0.8)
    assert model.rows.toarray()[one, three] == 0.0


def test_what_cannot_be_chosen_makes_no_state_known() -> None:
    """State 2 was only passed by a run that could not have started there."""
    counts = SampleCounts(('a', 'going on: a'), choosable=1)
    counts.add(samples(*[(1, 0, 0.0, 0.9, 2)] * 2, *[(2, 1, 0.0, 0.9, 3)] * 2))
    assert not counts.model(min_samples=2).available.any()
    counts.add(samples(*[(3, 0, 1.0, 0.0, 3)] * 2))
    model = counts.model(min_samples=2)
    one, two, three = map(counts.states.tolist().index, [1, 2, 3])
    expected = [[False, False], [False, True], [True, False]]
    assert model.available[[one, two, three]].tolist() == expected
    assert model.rows.toarray()[3 + two, three] == pytest.approx(0.9)


def test_every_end_of_a_run_is_a_sample_of_its_own() -> None:
    """By hand: one game, a run of three steps and one of two that ends the task."""
    # state, option (which cannot start in 2), sampled, reward, ended, over, state after the step
    steps = [
        (1, 0, True, 1.0, False, False, 2),
        (2, 0, False, 2.0, False, False, 3),
        (3, 0, True, 4.0, True, False, 4),
        (4, 1, True, 0.0, False, False, 5),
        (5, 1, True, 10.0, True, True, 6),
    ]
    found = samples_of([tuple(np.array([value]) for value in step) for step in steps], 0.5)
    assert found.state.tolist() == [1, 3, 4, 5]
    assert found.option.tolist() == [0, 0, 1, 1]
    assert found.reward.tolist() == [3.0, 4.0, 5.0, 10.0]
    assert found.discount.tolist() == [0.125, 0.5, 0.0, 0.0]
    assert found.successor.tolist() == [4, 4, 6, 6]


def test_a_plan_chooses_as_it_plays() -> None:
    """One state at a time, an available option, and a fallback only where no option can start."""
    plan, domain = rooms_plan('human'), Rooms()
    for state in domain.sample_states(generator(1, 'states'), 20):
        decision = plan.choose(state)
        row = domain.feature_values(state)[None]
        startable = {o.name for o in rooms_options(domain) if o.can_start(row)[0]}
        assert (decision.name in startable) is not decision.fallback
        assert decision.fallback is not bool(startable)
    with pytest.raises(PlanError, match='over'):
        plan.choose(domain.state_at(int(np.flatnonzero(domain.over())[0])))
    with pytest.raises(PlanError, match='cannot play 0 episodes'):
        plan.play(3, 0)


def test_play_counts_what_happens() -> None:
    """Rooms pays 1 at the goal, so return is success, and discounted return falls with steps."""
    returns = rooms_plan('human').play(3, 200)
    assert np.array_equal(returns.total, returns.successes)
    assert returns.successes.mean() > 0.99
    won = returns.successes
    assert returns.discounted[won] == pytest.approx(GAMMA ** (returns.steps[won] - 1.0))
    assert (returns.decisions >= returns.fallbacks).all()
    assert (returns.steps >= returns.decisions).all()


@pytest.mark.parametrize('execution', [Arbitration.INTERRUPTED, Arbitration.MODULAR_STRONGEST])
def test_interruption_gains_where_options_pass_by_the_goal(execution: Arbitration) -> None:
    """With G2 as with exact models, in a plan that was sampled so or by runs to the end."""
    for sampled_by in (Arbitration.RUN_TO_END, execution):
        plan = rooms_plan('human', 100_000, goal='G2', execution=sampled_by)
        to_end = plan.play(3, 400, Arbitration.RUN_TO_END).discounted
        gain = Interval.of(plan.play(3, 400, execution).discounted - to_end)
        assert gain.low > 0.0
        assert gain.mean > 0.1 * to_end.mean()


def test_progress_rises_and_can_cancel() -> None:
    """Over all rounds; what it raises passes through. The same seed gives the same plan."""
    seen: list[float] = []

    def note(stage: str, fraction: float, sweeps: int, residual: float) -> None:
        if stage == 'models':
            seen.append(fraction)
        if fraction > most:
            raise PlanCanceled

    most = 1.0
    first, again, other = (new_plan('human', 20_000, note, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.solution.values, again.solution.values)
    assert not np.array_equal(first.solution.values, other.solution.values)
    seen = seen[: len(seen) // 3]
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0, abs=0.01)  # parts of the budget are not quite used up
    most = 0.3
    with pytest.raises(PlanCanceled):
        new_plan('human', 20_000, note)


def test_games_begin_again_where_they_are_over_or_cut_off() -> None:
    """So that no game goes farther than three steps lead: to ten cells."""
    lake = make_domain('gymnasium:FrozenLake-v1', {'is_slippery': False})
    lake.max_steps = 3
    actions, rng = ActionSet(lake, 'primitive', []), generator(1, 'test')
    counts, reported = SampleCounts(actions.names), list[int]()
    sampler = Sampler(actions, counts, 20, GAMMA, rng)
    assert sampler.play(AnyOption(rng), 2_019, reported.append) == reported[-1] == 2_000
    assert len(counts.states) == 10


def test_games_with_equal_columns_are_in_one_abstract_state() -> None:
    """Named features, in bins or each value by itself, and any number of symbols."""
    domain = Rooms()
    games = TableGames(domain, np.arange(domain.n_states))
    rows = games.features()
    symbol = rows[:, 0] == rows[:, 1]
    many = [np.zeros_like(symbol)] * 2000

    def count(columns: list[str], symbols: list[Any]) -> int:
        return len(set(Abstraction(domain, columns).codes(games, rows, symbols).tolist()))

    assert count([], []) == domain.n_states
    assert count(['row'], []) == len(set(rows[:, 0].tolist()))
    assert count(['row:4', 'col:4'], []) == 4
    assert count(['row'], [symbol]) == len(set(zip(rows[:, 0].tolist(), symbol.tolist())))
    assert count(['row:99'], [*many, symbol]) == 2
    for column, complaint in (
        ('colour', 'no feature'),
        ('row:1,x', 'could not convert'),
        ('row:3,2', 'do not ascend'),
    ):
        with pytest.raises(PlanError, match=complaint):
            Abstraction(domain, [column])


def test_a_continuous_feature_has_the_given_bins_or_ten(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = Rooms()
    rows = TableGames(domain, np.arange(domain.n_states)).features()
    features = list(domain.features)
    features[0] = Feature.continuous('row', 'where it is', -5.0, 5.0, 'm')
    monkeypatch.setattr(domain, 'features', features)
    rows[:4, 0] = [-0.7, -0.5, 0.2, 0.3]
    assert Column('row:-0.5,0.25', domain).bins(rows[:4]).tolist() == [0, 1, 1, 2]
    rows[:4, 0] = [-5.0, -0.5, 0.0, 5.0]
    assert Column('row', domain).bins(rows[:4]).tolist() == [0, 4, 5, 9]


def test_where_no_option_can_start_the_likeliest_one_acts() -> None:
    """Its action is taken, as a fallback."""
    domain = Rooms()
    options = rooms_options(domain)[:2]
    actions = ActionSet(domain, 'human', options)
    games = TableGames(domain, np.flatnonzero(~domain.over()))
    rows, seen = games.features(), actions.see(games)
    stuck = np.flatnonzero(~np.any([option.can_start(rows) for option in options], axis=0))
    assert np.array_equal(np.flatnonzero(seen.fallback >= 0), stuck)
    chance = np.stack([option.initiation_probability(rows) for option in options])
    wanted = np.stack([option.action(rows) for option in options])
    most_probable = wanted[chance.argmax(axis=0), np.arange(len(rows))]
    assert np.array_equal(seen.fallback[stuck] - len(options), most_probable[stuck])
