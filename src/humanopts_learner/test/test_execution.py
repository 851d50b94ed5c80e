"""One option run, step by step, to each of its ends; and the options that can be run."""

from typing import Any

from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_learner.library import (
    AmbiguousOptionError,
    OptionLibrary,
    UnknownOptionError,
)
from humanopts_learner.option import PrimitiveOption
from humanopts_learner.options.learned_option import (
    LearnedOption,
    option_from_table,
    TabularOption,
)
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.request import Arbitration
from humanopts_learner.run import (
    Arbiter,
    execution_named,
    RefusedError,
    Run,
    RunResult,
    RunStatus,
)
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI = Taxi()
SOUTH, NORTH, EAST, WEST, PICKUP, DROPOFF = range(6)
FAR = TaxiState(row=4, col=0, passenger=0, destination=1)  # the passenger waits at 0,0
HERE = 3, 7  # episode and step where runs begin
ROW, COL = TAXI.feature_table()[:, :2].T


def option(
    action: NDArray[np.integer] | int,
    ends: NDArray[np.bool_] | bool = False,
    name: str = 'drive',
    participant: str = 'ann',
    domain: Taxi = TAXI,
    max_steps: int = 50,
) -> LearnedOption:
    """Return an option that starts where nobody is aboard; its trees say what is given, (S,)."""
    rows, names = domain.feature_table(), [feature.name for feature in domain.features]
    waits = rows[:, names.index('passenger_in_taxi')] == 0
    actions, over = (np.broadcast_to(values, len(rows)) for values in (action, ends))
    table = TabularOption(name, max_steps, actions.astype(np.intp), waits, over.astype(np.bool_))
    return option_from_table(domain, table, names, rows, participant=participant)


def primitive(action: int) -> PrimitiveOption:
    return PrimitiveOption(f'action:{TAXI.actions[action].name}', action, 6)


def drive(
    runs: Any, start: TaxiState = FAR, *args: Any, cut_off: int = 1000, **options: Any
) -> RunResult:
    """Run in the rules of the game until it ends; the episode is cut off after ``cut_off``."""
    state, rng, steps = start, np.random.default_rng(0), 0
    run, ended = Run(runs, TAXI, state, HERE, *args, **options), None
    while ended is None:
        outcome = TAXI.step(state, run.next_action(), rng)
        state, steps = outcome.state, steps + 1
        ended = run.observe(state, outcome.reward, outcome.terminated, steps >= cut_off)
    return ended


def test_a_run_that_reaches_its_end_adds_up_what_it_earned() -> None:
    end = drive(option(NORTH, ROW == 0))
    assert end.discounted_return == pytest.approx(-(1 + 0.99 + 0.99**2 + 0.99**3))
    assert end == RunResult(
        status=RunStatus.REACHED,
        detail=RunStatus.REACHED.value,
        option_name='drive',
        episode=3,
        first_step=7,
        step_count=4,
        total_reward=-4.0,
        discounted_return=end.discounted_return,
        final_state='taxi 0,0 passenger R destination G',
        execution='run_to_end',
        acted_names=('drive',),
        acted_steps=(4,),
    )


EAST_WEST = np.where(COL == 0, EAST, WEST)
AT_GOAL = TaxiState(0, 4, passenger=4, destination=1)


@pytest.mark.parametrize(
    ('runs', 'start', 'options', 'status', 'steps', 'says'),
    [
        # The termination condition is looked at only after a step.
        (option(NORTH, True), FAR, {}, RunStatus.REACHED, 1, 'holds'),
        (primitive(NORTH), FAR, {}, RunStatus.REACHED, 1, 'holds'),
        # It goes before the end of the episode.
        (primitive(DROPOFF), AT_GOAL, {}, RunStatus.REACHED, 1, 'holds'),
        (option(NORTH), FAR, {'cut_off': 2}, RunStatus.EPISODE_OVER, 2, 'at its step limit'),
        (option(NORTH, max_steps=2), FAR, {'cut_off': 2}, RunStatus.EPISODE_OVER, 2, 'limit'),
        (option(NORTH, max_steps=3), FAR, {}, RunStatus.MAX_STEPS, 3, ': 3 steps'),
        (option(NORTH), FAR, {'max_steps': 3}, RunStatus.MAX_STEPS, 3, ': 3 steps'),
        (
            option(EAST_WEST, max_steps=9),
            TaxiState(2, 0, 0, 1),
            {},
            RunStatus.MAX_STEPS,
            9,
            '9 steps; it walked in a circle of 2 through taxi 2,1 passenger R destination G',
        ),
        # Draws may lead out of what looks like a circle.
        (
            option(SOUTH),
            FAR,
            {'max_steps': 3, 'rng': np.random.default_rng(0)},
            RunStatus.MAX_STEPS,
            3,
            ': 3 steps',
        ),
    ],
)
def test_a_run_ends_where_it_must_and_says_so(
    runs: Any, start: TaxiState, options: Any, status: RunStatus, steps: int, says: str
) -> None:
    end = drive(runs, start, **options)
    assert (end.status, end.step_count) == (status, steps)
    assert end.detail.endswith(says)
    assert (end.truncated, end.terminated) == ('cut_off' in options, start is AT_GOAL)


def test_the_end_of_the_task_ends_the_run() -> None:
    run = Run(option(NORTH), TAXI, FAR, HERE)
    run.next_action()
    end = run.observe(TaxiState(0, 0, 1, 1), 1.0, terminated=True, truncated=False)
    assert end is not None
    assert (end.status, end.terminated) == (RunStatus.EPISODE_OVER, True)
    assert 'the task is over' in end.detail


@pytest.mark.parametrize(
    ('state', 'position', 'status', 'detail'),
    [
        (
            TaxiState(2, 2, passenger=4, destination=0),
            HERE,
            RunStatus.NOT_AVAILABLE,
            'taxi 2,2 passenger aboard destination R',
        ),
        (FAR, (0, 0), RunStatus.NO_EPISODE, ''),
        (TaxiState(0, 0, 1, 1), HERE, RunStatus.NO_EPISODE, ''),
    ],
)
def test_a_run_that_cannot_begin_is_refused(
    state: TaxiState, position: tuple[int, int], status: RunStatus, detail: str
) -> None:
    with pytest.raises(RefusedError) as refused:
        Run(option(NORTH), TAXI, state, position)
    assert (refused.value.status, str(refused.value)) == (status, detail)


def test_a_run_ended_from_outside_keeps_what_it_did() -> None:
    run = Run(option(NORTH), TAXI, FAR, HERE)
    run.next_action()
    run.observe(TaxiState(3, 0, 0, 1), -1.0, False, False)
    end = run.end(RunStatus.CANCELED, 'because')
    assert (end.status, end.step_count, end.total_reward) == (RunStatus.CANCELED, 1, -1.0)
    assert end.detail == 'it was canceled: because'
    assert end.final_state.startswith('taxi 3,0')


def arbiter(
    better: NDArray[np.bool_], execution: Arbitration = Arbitration.MODULAR_STRONGEST
) -> Arbiter:
    """Return what decides between going up and to the right, which is better where (S,) says."""
    options = {'drive': option(NORTH), 'right': option(EAST, name='right')}
    worth = np.stack([~better, better], axis=1).astype(np.float64)
    states = np.arange(TAXI.n_states)
    values = OptionValues('human', tuple(options), states, worth, worth, 0.0, sampled=False)
    return Arbiter(values, execution, TAXI, options)


def test_in_a_run_of_modules_the_winner_of_each_step_acts_and_is_counted() -> None:
    """From row 4 up to row 3 and then to the right; it goes on where a module would end."""
    modules = arbiter(ROW % 2 == 1)
    end = drive(None, FAR, 4, arbiter=modules)
    assert (end.status, end.step_count, end.option_name) == (RunStatus.MAX_STEPS, 4, '')
    assert dict(zip(end.acted_names, end.acted_steps)) == {'drive': 1, 'right': 3}
    assert end.discounted_return == pytest.approx(-(1 + 0.99 + 0.99**2 + 0.99**3))
    end = drive(None, arbiter=modules, cut_off=9)
    assert (end.status, end.truncated, end.step_count) == (RunStatus.EPISODE_OVER, True, 9)
    endless = Taxi()
    endless.max_steps = 0
    with pytest.raises(RefusedError, match='give max_steps'):
        Run(None, endless, FAR, HERE, arbiter=modules)


def test_a_plan_stops_a_run_before_its_next_action() -> None:
    run = Run(option(NORTH), TAXI, FAR, HERE, arbiter=arbiter(ROW == 2, Arbitration.INTERRUPTED))
    for row in (3, 2):
        assert run.stopped() is None
        run.next_action()
        assert run.observe(TaxiState(row, 0, 0, 1), -1.0, False, False) is None
    end = run.stopped()
    assert end is not None
    assert (end.status, end.acted_steps) == (RunStatus.STOPPED_BY_PLAN, (2,))
    assert (end.execution, run.position) == ('interrupted', (3, 9))


def test_an_execution_is_found_by_its_name_and_none_means_to_the_end() -> None:
    assert execution_named('') is Arbitration.RUN_TO_END
    assert [execution_named(execution) for execution in Arbitration] == list(Arbitration)
    text = "unknown execution 'fly'; choose from run_to_end, interrupted"
    with pytest.raises(RefusedError, match=text):
        execution_named('fly')


def library(*options: LearnedOption) -> OptionLibrary:
    made = OptionLibrary(TAXI)
    assert made.replace(options) == []
    return made


def test_options_are_found_by_name_and_participant() -> None:
    ann, bob = option(NORTH), option(SOUTH, participant='bob')
    other = option(EAST, name='other')
    held = library(other, bob, ann)
    assert held.options() == [ann, bob, other]
    assert held.options('bob') == [bob]
    assert held.resolve('drive', 'bob') is bob
    assert held.resolve('other') is other
    assert held.resolve('action:dropoff', 'bob') == primitive(DROPOFF)
    with pytest.raises(AmbiguousOptionError, match='ann, bob'):
        held.resolve('drive')


def test_an_unknown_option_is_answered_with_what_there_is() -> None:
    held = library(option(NORTH))
    for name, participant in (('fly', ''), ('drive', 'bob'), ('action:fly', '')):
        with pytest.raises(UnknownOptionError, match=r"'drive' \(ann\).*action:south"):
            held.resolve(name, participant)


def test_a_library_holds_what_can_be_run_and_says_why_others_cannot() -> None:
    held = library(option(NORTH))
    strange = option(0, domain=Taxi(6, 6)), option(0, name='action:south')
    faults = held.replace([strange[0], option(SOUTH, name='new'), strange[1]])
    assert ['was learned in taxi' in faults[0], 'primitive action' in faults[1]] == [True, True]
    assert [o.name for o in held.options()] == ['new']


def test_a_primitive_action_can_be_queried_like_an_option() -> None:
    rows = TAXI.feature_table()[:3]
    action = primitive(WEST)
    assert action.action_probabilities(rows).tolist() == [[0, 0, 0, 1, 0, 0]] * 3
    assert action.initiation_probability(rows).tolist() == [1, 1, 1]
    assert action.termination_probability(rows).tolist() == [1, 1, 1]
