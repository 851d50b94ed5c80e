"""Carrying out a policy over options: interruption, modules and limits, by tables and live."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.games import new_games, TableGames
from humanopts_env.seeding import generator
from humanopts_learner import LearnedOption
from humanopts_learner.library import OptionLibrary
from humanopts_learner.options.learned_option import options_from_references, TabularOption
from humanopts_learner.planning.exact_plan import ExactPlan, make_exact_plan, play_plan
from humanopts_learner.planning.interruption import (
    arbitrate,
    as_executed,
    exact_mean_return,
    option_values,
    policy_values,
)
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import (
    Arbitration,
    MODULAR,
    PlanError,
    PlanRequest,
    Sampling,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan, SampledPlan
from humanopts_learner.ros.convert import option_values_from_message, option_values_to_message
from humanopts_learner.run import Arbiter, Run
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest
from random_rules import RandomWorld

PICKUP, DROPOFF = 'go to passenger and pickup', 'go to destination and dropoff'
NEVER_WORSE = (Arbitration.INTERRUPTED, Arbitration.MODULAR_STRONGEST)


def tabled(domain: Any, max_steps: int = 200, names: Sequence[str] = ()) -> list[TabularOption]:
    """Return the reference options of a domain as tables."""
    return [
        TabularOption.of_reference(option, max_steps)
        for name, option in reference_options(domain).items()
        if not names or name in names
    ]


@cache
def rooms_plan(action_set: str, goal: str, max_steps: int = 200) -> ExactPlan:
    """Return a plan over the hallway options."""
    domain = Rooms(goal)
    return make_exact_plan(domain, tabled(domain, max_steps), PlanRequest(action_set))


def assert_never_worse(plan: ExactPlan) -> None:
    """Compare with running to the end, state by state."""
    to_end = policy_values(plan)
    assert to_end == pytest.approx(plan.solution.values, abs=1e-5)
    scale = 1.0 + np.abs(to_end).max()
    for execution in NEVER_WORSE:
        gain = policy_values(as_executed(plan, execution)) - to_end
        assert gain.min() >= -1e-8 * scale, execution


def random_plan(
    seed: int, n_states: int, outcomes: int, action_set: str, limits: Sequence[int]
) -> ExactPlan:
    """Plan with random options, some of which can start nowhere or end nowhere."""
    world, rng = RandomWorld(seed, n_states, outcomes, 0.9), np.random.default_rng(seed + 1)
    options = [
        TabularOption(
            f'option {number}',
            limit,
            rng.integers(0, 3, n_states),
            rng.random(n_states) < 0.6,
            rng.random(n_states) < rng.choice([0.0, 0.3]),
        )
        for number, limit in enumerate(limits)
    ]
    request = PlanRequest(action_set, tol=1e-10)
    return make_exact_plan(world, options, request)  # type: ignore[arg-type]


random_plans = st.builds(
    random_plan,
    st.integers(0, 2**32 - 1),
    st.integers(2, 12),
    st.integers(1, 3),
    st.sampled_from(['human', 'human+primitive']),
    st.lists(st.sampled_from([1, 2, 3, 5, 400]), min_size=1, max_size=3),
)


@pytest.mark.heavy
@settings(max_examples=20)
@given(random_plans)
def test_it_is_never_worse_in_random_worlds_whatever_the_step_limits(plan: ExactPlan) -> None:
    assert_never_worse(plan)


@settings(max_examples=20)
@given(random_plans)
def test_going_on_is_worth_a_run_from_there_or_with_fewer_steps_left_the_best(
    plan: ExactPlan,
) -> None:
    """One step at a time; where no run is cut off, both are the same."""
    table = option_values(plan)
    live = ~plan.domain.over()
    for column, option in enumerate(plan.options):
        worth, best = plan.solution.values, np.full(len(live), -np.inf)
        for _ in range(option.max_steps):
            worth = one_step_more(plan, option, worth)
            best = np.maximum(best, worth)
        found = table.continuation_values[:, column]
        whole, any_left = (np.isclose(found, expected, atol=1e-7) for expected in (worth, best))
        assert (whole | any_left)[live].all()
    both = np.isfinite(table.option_values)
    assert (table.continuation_values[both] >= table.option_values[both] - 1e-9).all()
    assert np.isneginf(table.continuation_values[~live]).all()


def one_step_more(
    plan: ExactPlan, option: TabularOption, ahead: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what going on is worth with one step more left, (S,)."""
    rules, values = plan.domain.transitions(), plan.solution.values
    at = np.arange(len(ahead)), option.action
    to = rules.successor[at]
    follows = np.where(option.termination[to], values[to], ahead[to])
    follows[rules.terminated[at] | plan.domain.over()[to]] = 0.0
    worth = rules.reward[at] + plan.gamma * follows
    found: NDArray[np.float64] = (rules.probability[at] * worth).sum(axis=1)
    return found


def test_interruption_gains_where_an_option_passes_by_the_goal() -> None:
    """In the rooms with G2, a cell that hallway options come to by chance only."""
    plan, starts = rooms_plan('human', 'G2'), Rooms('G2').start_states()
    to_end = policy_values(plan)[starts]
    for execution in (*NEVER_WORSE, Arbitration.MODULAR_MASS):
        gain = policy_values(as_executed(plan, execution))[starts] - to_end
        assert gain.min() > 0.003, execution
        assert gain.mean() > 0.2 * to_end.mean(), execution


@pytest.mark.parametrize('execution', Arbitration)
def test_play_earns_what_the_linear_solve_says(execution: Arbitration) -> None:
    """Without chance exactly; with chance within five standard errors."""
    taxi = Taxi()
    plan = make_exact_plan(taxi, tabled(taxi, 4), PlanRequest('human'))
    acting, starts = as_executed(plan, execution), taxi.start_states()
    returns, values = play_plan(acting, starts, max_steps=2000), policy_values(acting)
    assert returns.discounted == pytest.approx(values[starts], abs=1e-6)
    acting = as_executed(rooms_plan('human+primitive', 'G2'), execution)
    starts = np.tile(Rooms('G2').start_states(), 30)
    found = play_plan(acting, starts, max_steps=400, seed=3).discounted
    error = found.std() / np.sqrt(len(found))
    assert found.mean() == pytest.approx(policy_values(acting)[starts].mean(), abs=5 * error)


def test_an_option_that_walks_in_a_circle_is_stopped() -> None:
    """Driving north for ever is at no place better than what the plan would choose there."""
    taxi = Taxi()
    everywhere, up = ~taxi.over(), np.ones(taxi.n_states, dtype=np.intp)
    north = TabularOption('north', 50, up, everywhere, taxi.over())
    options = [*tabled(taxi, 200, (PICKUP, DROPOFF)), north]
    plan = make_exact_plan(taxi, options, PlanRequest('human'))
    stop = as_executed(plan, Arbitration.INTERRUPTED).options[2].termination
    away = plan.solution.values > option_values(plan).continuation_values[:, 2] + 1e-6
    assert (stop == away)[everywhere].all()
    at_the_wall = taxi.transitions().successor[:, 1, 0] == np.arange(taxi.n_states)
    assert stop[everywhere & at_the_wall].all()


def test_modules_of_the_greatest_mass_outvote_a_single_strong_one() -> None:
    """By hand: strengths 5, 4, 3 and 0 by action 0, 1, 1 and 2."""
    continuation_values = np.array([[15.0, 14.0, 13.0, 10.0], [15.0, -np.inf, 13.0, 10.0]])
    action = np.array([[0, 1, 1, 2], [0, 1, 1, 2]])
    values = continuation_values, continuation_values, action
    assert arbitrate(Arbitration.MODULAR_STRONGEST, *values).tolist() == [0, 0]
    assert arbitrate(Arbitration.MODULAR_MASS, *values).tolist() == [1, 0]


@pytest.mark.parametrize(
    ('field', 'change', 'text'),
    [
        ('continuation_values', lambda values: values[1:], 'continuation_values has'),
        ('states', lambda values: values[::-1], 'ascend'),
        ('option_values', lambda values: [np.nan] * len(values), 'NaN'),
        ('interruption_margin', lambda value: -1.0, 'interruption_margin'),
    ],
)
def test_a_message_that_contradicts_itself_is_refused(
    field: str, change: Callable[[Any], Any], text: str
) -> None:
    message = option_values_to_message(option_values(rooms_plan('human', 'G1')), 'one', 'eve')
    setattr(message, field, change(getattr(message, field)))
    with pytest.raises(PlanError, match=text):
        option_values_from_message(message)


def test_the_exact_mean_return_is_that_of_episodes_from_every_start() -> None:
    """A policy that never ends has none."""
    taxi = Taxi()
    plan = make_exact_plan(taxi, tabled(taxi, 4), PlanRequest('human'))
    played = play_plan(plan, taxi.start_states(), max_steps=2000).total
    assert exact_mean_return(plan) == pytest.approx(played.mean())
    plan = make_exact_plan(taxi, [], PlanRequest('primitive', gamma=1.0))
    stuck = np.minimum(plan.solution.best, 1)  # north for ever
    plan = replace(plan, solution=replace(plan.solution, best=stuck))
    with pytest.raises(PlanError, match='gamma below 1'):
        policy_values(plan)
    assert exact_mean_return(plan) is None


TAXI_OPTIONS = ('go to passenger', 'go to destination', 'pickup/dropoff')
LIMIT = 60


class TaxiGames(TableGames):
    """Games whose abstract states hide where the passenger is."""

    def planning_features(self) -> NDArray[np.integer]:
        """Return the places of the taxi and the destination."""
        return np.stack([self.state // 20, self.state % 4], axis=1)


class AliasedTaxi(Taxi):
    """Taxi whose games are cut off soon."""

    def __init__(self) -> None:
        """Cut games off soon."""
        super().__init__()
        self.max_steps = LIMIT

    def games(self, states: Sequence[Any]) -> TaxiGames:
        """Return games in given states."""
        return TaxiGames.at(self, states)


@cache
def options_of(domain: Any) -> list[LearnedOption]:
    """Return ready options of Taxi or the rooms."""
    known = reference_options(domain)
    names = known if isinstance(domain, Rooms) else TAXI_OPTIONS
    return options_from_references(domain, [known[name] for name in names])


TAXI, ALIASED, ROOMS = Taxi(), AliasedTaxi(), Rooms('G2')


def library_of(domain: Any) -> OptionLibrary:
    """Return the options of Taxi or the rooms, and their actions."""
    library = OptionLibrary(domain)
    library.replace(options_of(domain))
    return library


def arbiter_of(plan: ExactPlan | SampledPlan, execution: Arbitration) -> Arbiter:
    """Return the arbiter that is made of what a message carries."""
    values = option_values(plan) if isinstance(plan, ExactPlan) else plan.policy.values
    library = library_of(plan.domain)
    options = {name: library.resolve(name) for name in (*plan.names, *library.primitive_names)}
    sent = option_values_from_message(option_values_to_message(values, '', ''))
    return Arbiter(sent, execution, plan.domain, options)


class LiveGame:
    """One game as a runner drives it: who acted in each step, and what came of it."""

    def __init__(self, plan: ExactPlan | SampledPlan, execution: Arbitration, start: Any) -> None:
        """Play to the end, or for LIMIT steps."""
        self._plan, self._domain, self.state = plan, plan.domain, start
        self._library, self._rng = library_of(plan.domain), generator(0, 'live')
        self._arbiter, self._execution = arbiter_of(plan, execution), execution
        self.actors: list[str] = []
        self.rewards: list[float] = []
        self.decisions = 0
        while len(self.actors) < LIMIT and not self._domain.is_over(self.state):
            if execution in MODULAR:
                self._module()
            else:
                self._run()

    def _module(self) -> None:
        option = self._arbiter.module(self.state)
        row = self._domain.feature_values(self.state)[None]
        self._step(option.name, int(option.action(row)[0]))
        self.decisions += 1

    def _run(self) -> None:
        """Run an option until it ends or is stopped."""
        name = self._plan.choose(self.state).name
        position = 1, len(self.actors)
        run = Run(self._library.resolve(name), self._domain, self.state, position)
        self.decisions += 1
        while len(self.actors) < LIMIT:
            ended = self._step(name, run.next_action(), run)
            if ended or self._arbiter.stops(self.state, name):
                return

    def _step(self, name: str, action: int, run: Run | None = None) -> bool:
        outcome = self._domain.step(self.state, action, self._rng)
        self.state = outcome.state
        self.actors.append(name)
        self.rewards.append(outcome.reward)
        end = run and run.observe(outcome.state, outcome.reward, outcome.terminated, False)
        return end is not None


@cache
def exact_plan() -> ExactPlan:
    """Return a plan on Taxi whose values prefer what is near: with gamma 0.8."""
    return make_plan(TAXI, options_of(TAXI), PlanRequest('human', gamma=0.8))


@cache
def sampled_plan(
    execution: Arbitration = Arbitration.RUN_TO_END, columns: tuple[str, ...] = ()
) -> SampledPlan:
    """Return a plan over aliased abstract states, so that options are often stopped."""
    config = Sampling(n_games=200, game_steps=LIMIT, interruption_margin=0.0)
    return make_sampled_plan(
        ALIASED,
        options_of(ALIASED),
        PlanRequest(
            'human',
            0.8,
            game_steps=6_000,
            seed=1,
            execution=execution,
            columns=columns,
            sampling=config,
        ),
    )


@pytest.mark.parametrize('execution', Arbitration)
def test_a_live_game_is_the_vectorised_one_with_exact_values(execution: Arbitration) -> None:
    plan, starts = exact_plan(), TAXI.start_states()[::25]
    returns = play_plan(as_executed(plan, execution), starts, max_steps=LIMIT)
    for episode, start in enumerate(starts.tolist()):
        game = LiveGame(plan, execution, TAXI.state_at(start))
        assert sum(game.rewards) == returns.total[episode]
        assert len(game.rewards) == returns.steps[episode]
        assert game.decisions == returns.decisions[episode]


@pytest.mark.heavy
def test_a_live_game_is_the_vectorised_one_with_sampled_values() -> None:
    plan, actors = sampled_plan(), {}
    for execution in Arbitration:
        actors[execution] = list[list[str]]()
        for seed in range(12):
            first = new_games(ALIASED, 1, generator(seed, 'play_games')).states()[0]
            game = LiveGame(plan, execution, first)
            returns = plan.play(seed, 1, execution)
            assert sum(game.rewards) == returns.total[0]
            assert game.decisions == returns.decisions[0]
            actors[execution].append(game.actors)
    to_end = actors.pop(Arbitration.RUN_TO_END)
    assert all(differ != to_end for differ in actors.values())  # or this would show nothing


def test_a_live_game_uses_the_columns_of_its_plan() -> None:
    plan = sampled_plan(columns=('taxi_row', 'passenger_in_taxi'))
    for seed in range(4):
        start = new_games(ALIASED, 1, generator(seed, 'play_games')).states()[0]
        game = LiveGame(plan, Arbitration.MODULAR_STRONGEST, start)
        returns = plan.play(seed, 1, Arbitration.MODULAR_STRONGEST)
        assert (sum(game.rewards), game.decisions) == (returns.total[0], returns.decisions[0])
    plan = replace(
        plan, policy=replace(plan.policy, values=replace(plan.policy.values, columns=()))
    )
    wrong = LiveGame(plan, Arbitration.MODULAR_STRONGEST, start)
    assert wrong.actors != game.actors  # or this would show nothing


@pytest.mark.parametrize('execution', Arbitration)
def test_rulings_in_the_rooms_follow_the_policy_that_is_carried_out(
    execution: Arbitration,
) -> None:
    """In every state, by the tables that exact evaluation uses."""
    plan = make_plan(ROOMS, options_of(ROOMS), PlanRequest('human'))
    acting, arbiter = as_executed(plan, execution), arbiter_of(plan, execution)
    for index in np.flatnonzero(~ROOMS.over()).tolist():
        state = ROOMS.state_at(index)
        if execution in MODULAR:
            winner = plan.names[acting.solution.best[index]]
            assert arbiter.module(state).name == winner
            continue
        with pytest.raises(PlanError, match=f'{execution} runs no modules'):
            arbiter.module(state)
        for before, after in zip(plan.options, acting.options):
            if not before.termination[index]:
                assert arbiter.stops(state, before.name) == bool(after.termination[index])


def test_values_that_do_not_fit_the_domain_are_refused() -> None:
    options = {option.name: option for option in options_of(TAXI)}
    values = option_values(exact_plan())
    with pytest.raises(PlanError, match='every state of taxi'):
        Arbiter(values, Arbitration.INTERRUPTED, Taxi(6, 6), options)
    values = replace(sampled_plan().policy.values, action_set='human+primitive')
    with pytest.raises(PlanError, match='the actions of taxi'):
        Arbiter(values, Arbitration.INTERRUPTED, ALIASED, options)
