"""Runs that a plan decides, by values that went through a message: as the vectorised play."""

from dataclasses import replace
from functools import cache
from typing import Any

from humanopts_env.domains.capabilities import Abstraction
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options as rooms_options
from humanopts_env.domains.tabular_games import TabularGames
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options as taxi_options
from humanopts_env.seeding import generator
from humanopts_learner.execution import Arbiter, Run
from humanopts_learner.library import OptionLibrary
from humanopts_learner.options.option import LearnedOption, Mode, options_from_references
from humanopts_learner.planning.evaluate import play
from humanopts_learner.planning.exact import ExactPlan
from humanopts_learner.planning.interruption import as_executed, option_values
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import Execution, PlanError, PlanRequest, Sampling
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan
from humanopts_learner.ros.convert import option_values_from_message, option_values_to_message
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI_OPTIONS = ('go to passenger', 'go to destination', 'pickup/dropoff')
MODULAR = (Execution.MODULAR_MASS, Execution.MODULAR_STRONGEST)
LIMIT = 60


class TaxiGames(TabularGames):
    """Games whose abstract states hide where the passenger is."""

    def abstraction(self, *, fine: bool) -> Abstraction:
        """Abstract a state to the places of the taxi and the destination."""
        return Abstraction((25, 4))

    def abstract_features(
        self, batch: NDArray[np.int64], rows: NDArray[np.int32], *, fine: bool
    ) -> NDArray[np.int32]:
        """Abstract a state to the places of the taxi and the destination."""
        return np.stack([batch[0] // 20, batch[0] % 4], axis=1).astype(np.int32)


class BatchTaxi(Taxi):
    """Taxi that brings its batched form."""

    def __init__(self) -> None:
        """Cut games off soon."""
        super().__init__()
        self.max_steps = LIMIT

    def batch_games(self) -> TaxiGames:
        """Return it."""
        return TaxiGames(self)


@cache
def options_of(domain: Any) -> list[LearnedOption]:
    """Return ready options of Taxi or the rooms."""
    if isinstance(domain, Rooms):
        return options_from_references(domain, rooms_options(domain).values())
    return options_from_references(domain, [taxi_options(domain)[name] for name in TAXI_OPTIONS])


TAXI, BATCH_TAXI, ROOMS = Taxi(), BatchTaxi(), Rooms('G2')


def library_of(domain: Any) -> OptionLibrary:
    """Return the options of Taxi or the rooms, and their actions."""
    library = OptionLibrary(domain)
    library.replace(options_of(domain))
    return library


def arbiter_of(plan: ExactPlan | SampledPlan, execution: Execution) -> Arbiter:
    """Return the arbiter that is made of what a message carries."""
    values = option_values(plan) if isinstance(plan, ExactPlan) else plan.policy.values
    library = library_of(plan.domain)
    options = {name: library.resolve(name) for name in (*plan.names, *library.primitive_names)}
    sent = option_values_from_message(option_values_to_message(values, '', ''))
    return Arbiter(sent, execution, plan.domain, options)


class LiveGame:
    """One game as a runner drives it: who acted in each step, and what came of it."""

    def __init__(self, plan: ExactPlan | SampledPlan, execution: Execution, start: Any) -> None:
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
        option, row = self._arbiter.module(self.state), self._domain.feature_values(self.state)
        self._step(option.name, option.choose_action(row, Mode.GREEDY, self._rng))
        self.decisions += 1

    def _run(self) -> None:
        """Run an option until it ends or is stopped."""
        name = self._plan.choose(self.state).name
        run = Run(self._library.resolve(name), self._domain, self._plan.gamma)
        assert run.begin(self.state, 1, len(self.actors)) is None
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
def sampled_plan(execution: Execution = Execution.RUN_TO_END) -> SampledPlan:
    """Return a plan over aliased abstract states, so that options are often stopped."""
    config = Sampling(n_games=200, game_steps=LIMIT, interruption_margin=0.1)
    return make_sampled_plan(
        BATCH_TAXI,
        options_of(BATCH_TAXI),
        PlanRequest('human', game_steps=24_000, seed=1, execution=execution, sampling=config),
    )


@pytest.mark.parametrize('execution', Execution)
def test_a_live_game_is_the_vectorised_one_with_exact_values(execution: Execution) -> None:
    plan, starts = exact_plan(), TAXI.start_states()[::13]
    returns = play(as_executed(plan, execution), starts, max_steps=LIMIT)
    for episode, start in enumerate(starts.tolist()):
        game = LiveGame(plan, execution, TAXI.state_at(start))
        assert sum(game.rewards) == returns.total[episode]
        assert len(game.rewards) == returns.steps[episode]
        assert game.decisions == returns.decisions[episode]


@pytest.mark.heavy
@pytest.mark.parametrize('execution', Execution)
def test_a_live_game_is_the_vectorised_one_with_sampled_values(execution: Execution) -> None:
    plan = sampled_plan()
    for seed in range(12):
        first = TaxiGames(TAXI).batch_reset(1, generator(seed, 'play_games'))
        game = LiveGame(plan, execution, TAXI.state_at(int(first[0, 0])))
        returns = plan.play(seed, 1, execution)
        assert sum(game.rewards) == returns.total[0]
        assert game.decisions == returns.decisions[0]
        assert BATCH_TAXI.index(game.state) == returns.outcomes['state'][0]


def test_the_executions_differ_where_values_are_aliased() -> None:
    """Or the comparison above would show nothing."""
    starts = [TAXI.state_at(s) for s in TAXI.start_states()[::40].tolist()]
    actors = {
        execution: [LiveGame(sampled_plan(), execution, start).actors for start in starts]
        for execution in Execution
    }
    assert actors[Execution.INTERRUPTED] != actors[Execution.RUN_TO_END]
    assert actors[Execution.MODULAR_MASS] != actors[Execution.RUN_TO_END]


@pytest.mark.parametrize('execution', [Execution.INTERRUPTED, *MODULAR])
def test_rulings_in_the_rooms_follow_the_policy_that_is_carried_out(execution: Execution) -> None:
    """In every state, by the tables that exact evaluation uses."""
    plan = make_plan(ROOMS, options_of(ROOMS), PlanRequest('human'))
    acting, arbiter = as_executed(plan, execution), arbiter_of(plan, execution)
    for index in np.flatnonzero(~ROOMS.over()).tolist():
        state = ROOMS.state_at(index)
        if execution in MODULAR:
            winner = plan.names[acting.solution.best[index]]
            assert arbiter.module(state).name == winner
            continue
        for before, after in zip(plan.options, acting.options):
            if not before.termination[index]:
                assert arbiter.stops(state, before.name) == bool(after.termination[index])


@pytest.mark.parametrize('plan', [exact_plan, sampled_plan])
def test_only_interruption_stops_options_and_only_modules_act_as_such(plan: Any) -> None:
    state = TAXI.state_at(int(TAXI.start_states()[0]))
    to_end, stopping = (arbiter_of(plan(), e) for e in list(Execution)[:2])
    for arbiter in (to_end, stopping):
        with pytest.raises(PlanError, match=f'{arbiter.execution} runs no modules'):
            arbiter.module(state)
    states = [TAXI.state_at(int(index)) for index in TAXI.start_states()]
    assert any(stopping.stops(s, name) for s in states for name in TAXI_OPTIONS)
    for execution in (Execution.RUN_TO_END, *MODULAR):
        arbiter = arbiter_of(plan(), execution)
        assert not any(arbiter.stops(s, name) for s in states for name in TAXI_OPTIONS)


def test_values_that_do_not_fit_the_domain_are_refused() -> None:
    options = {option.name: option for option in options_of(TAXI)}
    values = option_values(exact_plan())
    with pytest.raises(PlanError, match='every state of taxi'):
        Arbiter(values, Execution.INTERRUPTED, Taxi(6, 6), options)
    values = replace(sampled_plan().policy.values, action_set='human+primitive')
    with pytest.raises(PlanError, match='the actions of taxi'):
        Arbiter(values, Execution.INTERRUPTED, BATCH_TAXI, options)
