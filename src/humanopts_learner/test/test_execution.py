"""One option run, step by step, to each of its ends."""

from pathlib import Path
import re

from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_learner.library import (
    AmbiguousOptionError,
    OptionLibrary,
    UnknownOptionError,
)
from humanopts_learner.option import Mode, PrimitiveOption
from humanopts_learner.options.learned_option import (
    LearnedOption,
    option_from_table,
    OptionError,
    TabularOption,
)
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.request import Arbitration
from humanopts_learner.run import (
    Arbiter,
    execution_named,
    refusal,
    Run,
    RunError,
    RunResult,
    RunStatus,
    TEXT,
)
import numpy as np
from numpy.typing import NDArray
import pytest

TAXI = Taxi()
SOUTH, NORTH, EAST, WEST, PICKUP, DROPOFF = range(6)
FAR = TaxiState(row=4, col=0, passenger=0, destination=1)  # the passenger waits at 0,0
MESSAGE = Path(__file__).parents[2] / 'humanopts_interfaces' / 'msg' / 'OptionResult.msg'


def option(
    action: NDArray[np.integer] | int,
    ends: NDArray[np.bool_] | bool,
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


def feature(name: str) -> NDArray[np.float64]:
    """Return one feature of every state, (S,)."""
    column: NDArray[np.float64] = TAXI.feature_table()[
        :, [f.name for f in TAXI.features].index(name)
    ]
    return column


def drive(run: Run, start: TaxiState, cut_off: int = 1000) -> RunResult:
    """Run in the rules of the game until it ends; episodes are cut off after so many steps."""
    state, rng = start, np.random.default_rng(0)
    ended = run.begin(state, episode=3, step=7)
    for step in range(1, 1000):
        if ended is not None:
            return ended
        outcome = TAXI.step(state, run.next_action(), rng)
        state = outcome.state
        ended = run.observe(state, outcome.reward, outcome.terminated, step >= cut_off)
    raise AssertionError('the run never ended')


def test_statuses_are_those_of_the_message() -> None:
    constants = re.findall(r'^uint8 STATUS_(\w+)=(\d+)', MESSAGE.read_text(), re.MULTILINE)
    wanted = {name: int(value) for name, value in constants if name != 'UNKNOWN'}
    assert {status.name: status.value for status in RunStatus} == wanted
    assert set(TEXT) == set(RunStatus)
    assert len(set(TEXT.values())) == len(RunStatus)


def test_a_run_that_reaches_its_end_adds_up_what_it_earned() -> None:
    run = Run(option(NORTH, feature('taxi_row') == 0), TAXI, gamma=0.9)
    end = drive(run, FAR)
    assert end.discounted_return == pytest.approx(-(1 + 0.9 + 0.81 + 0.729))
    assert end == RunResult(
        status=RunStatus.REACHED,
        detail=TEXT[RunStatus.REACHED],
        option_name='drive',
        episode=3,
        first_step=7,
        step_count=4,
        total_reward=-4.0,
        discounted_return=end.discounted_return,
        final_state='taxi 0,0 passenger R destination G',
        acted={'drive': 4},
    )


def test_termination_is_looked_at_only_after_a_step() -> None:
    end = drive(Run(option(NORTH, True), TAXI, 0.9), FAR)
    assert (end.status, end.step_count) == (RunStatus.REACHED, 1)


def test_reached_goes_before_the_end_of_the_episode() -> None:
    at_goal = TaxiState(0, 4, passenger=4, destination=1)
    end = drive(Run(primitive(DROPOFF), TAXI, 0.9), at_goal)
    assert (end.status, end.terminated, end.total_reward) == (RunStatus.REACHED, True, 1.0)


def test_the_end_of_the_task_ends_the_run() -> None:
    run = Run(option(NORTH, False), TAXI, 0.9)
    assert run.begin(FAR, 1, 0) is None
    end = run.observe(TaxiState(0, 0, 1, 1), 1.0, terminated=True, truncated=False)
    assert end is not None
    assert (end.status, end.terminated) == (RunStatus.EPISODE_OVER, True)
    assert 'the task is over' in end.detail


def test_the_step_limit_of_the_episode_ends_the_run_and_says_so() -> None:
    end = drive(Run(option(NORTH, False), TAXI, 0.9, max_steps=2), FAR, cut_off=2)
    assert (end.status, end.truncated, end.step_count) == (RunStatus.EPISODE_OVER, True, 2)
    assert 'step limit' in end.detail


def test_max_steps_cuts_a_run_off_and_names_the_circle_it_walked_in() -> None:
    east_west = np.where(feature('taxi_col') == 0, EAST, WEST)
    end = drive(Run(option(east_west, False, max_steps=9), TAXI, 0.9), TaxiState(2, 0, 0, 1))
    assert (end.status, end.step_count) == (RunStatus.MAX_STEPS, 9)
    assert '9 steps' in end.detail
    assert 'circle of 2 through taxi 2,0' in end.detail


def test_max_steps_without_a_circle_does_not_speak_of_one() -> None:
    end = drive(Run(option(NORTH, False), TAXI, 0.9, max_steps=3), FAR)
    assert (end.status, end.step_count) == (RunStatus.MAX_STEPS, 3)
    assert 'circle' not in end.detail


def test_a_sampled_run_that_comes_back_is_not_said_to_walk_in_a_circle() -> None:
    rng = np.random.default_rng(0)
    run = Run(option(SOUTH, False), TAXI, 0.9, 3, Mode.SAMPLED, rng)
    end = drive(run, FAR)
    assert end.status is RunStatus.MAX_STEPS
    assert 'circle' not in end.detail


def test_a_primitive_action_is_an_option_of_one_step() -> None:
    end = drive(Run(primitive(NORTH), TAXI, 0.9), FAR)
    assert (end.status, end.option_name, end.step_count) == (RunStatus.REACHED, 'action:north', 1)


def test_a_run_is_refused_outside_the_initiation_set() -> None:
    aboard = TaxiState(2, 2, passenger=4, destination=0)
    end = Run(option(NORTH, False), TAXI, 0.9).begin(aboard, 1, 5)
    assert end is not None
    assert (end.status, end.step_count) == (RunStatus.NOT_AVAILABLE, 0)
    assert 'taxi 2,2 passenger aboard' in end.detail


@pytest.mark.parametrize(('state', 'episode'), [(FAR, 0), (TaxiState(0, 0, 1, 1), 4)])
def test_a_run_is_refused_where_no_episode_is_under_way(state: TaxiState, episode: int) -> None:
    end = Run(option(NORTH, False), TAXI, 0.9).begin(state, episode, 0)
    assert end is not None
    assert end.status is RunStatus.NO_EPISODE


@pytest.mark.parametrize(
    'status', [RunStatus.NO_PROGRESS, RunStatus.INTERRUPTED, RunStatus.CANCELED, RunStatus.FAILED]
)
def test_a_run_ended_from_outside_keeps_what_it_did(status: RunStatus) -> None:
    run = Run(option(NORTH, False), TAXI, 0.9)
    assert run.begin(FAR, 2, 1) is None
    run.observe(TaxiState(3, 0, 0, 1), -1.0, False, False)
    end = run.end(status, 'because')
    assert (end.status, end.step_count, end.total_reward) == (status, 1, -1.0)
    assert end.detail == f'{TEXT[status]}: because'
    assert end.final_state.startswith('taxi 3,0')
    with pytest.raises(RunError, match='ended'):
        run.next_action()


def arbiter(
    better: NDArray[np.bool_], execution: Arbitration = Arbitration.MODULAR_STRONGEST
) -> Arbiter:
    """Return what decides between going up and to the right, which is better where (S,) says."""
    options = {'drive': option(NORTH, False), 'right': option(EAST, False, 'right')}
    worth = np.stack([~better, better], axis=1).astype(np.float64)
    states = np.arange(TAXI.n_states)
    values = OptionValues('human', tuple(options), states, worth, worth, 0.0, sampled=False)
    return Arbiter(values, execution, TAXI, options)


ROW = feature('taxi_row')
ZIGZAG = arbiter(ROW % 2 == 1)


def test_in_a_run_of_modules_the_winner_of_each_step_acts_and_is_counted() -> None:
    """From row 4 up to row 3 and then to the right; it goes on where a module would end."""
    end = drive(Run(ZIGZAG, TAXI, 0.9, max_steps=4), FAR)
    assert (end.status, end.step_count, end.option_name) == (RunStatus.MAX_STEPS, 4, '')
    assert end.acted == {'drive': 1, 'right': 3}
    assert end.discounted_return == pytest.approx(-(1 + 0.9 + 0.81 + 0.729))


def test_a_run_of_modules_ends_with_the_episode() -> None:
    end = drive(Run(ZIGZAG, TAXI, 0.9), FAR, cut_off=9)
    assert (end.status, end.truncated, end.step_count) == (RunStatus.EPISODE_OVER, True, 9)


def test_modules_that_nothing_would_cut_off_are_refused() -> None:
    endless = Taxi()
    endless.max_steps = 0
    with pytest.raises(RunError, match='give max_steps'):
        Run(ZIGZAG, endless, 0.9)


def test_a_plan_stops_a_run_before_its_next_action() -> None:
    run = Run(option(NORTH, False), TAXI, 0.9)
    assert run.begin(FAR, 2, 1) is None
    run.next_action()
    assert run.observe(TaxiState(3, 0, 0, 1), -1.0, False, False) is None
    assert run.stopped(arbiter(ROW == 2, Arbitration.INTERRUPTED)) is None
    end = run.stopped(arbiter(ROW == 3, Arbitration.INTERRUPTED))
    assert end is not None
    assert (end.status, end.acted) == (RunStatus.STOPPED_BY_PLAN, {'drive': 1})


def test_an_execution_is_found_by_its_name_and_none_means_to_the_end() -> None:
    assert execution_named('') is Arbitration.RUN_TO_END
    assert [execution_named(execution) for execution in Arbitration] == list(Arbitration)
    with pytest.raises(RunError, match="no execution 'fly'; there is run_to_end, interrupted"):
        execution_named('fly')


@pytest.mark.parametrize(
    'status', [RunStatus.BUSY, RunStatus.UNKNOWN_OPTION, RunStatus.NO_EPISODE]
)
def test_a_refused_request_names_the_option_and_the_reason(status: RunStatus) -> None:
    end = refusal(status, 'fly', 'more about it')
    assert (end.status, end.option_name, end.step_count) == (status, 'fly', 0)
    assert end.detail == f'{TEXT[status]}: more about it'


def test_a_run_driven_out_of_order_is_refused() -> None:
    run = Run(option(NORTH, False), TAXI, 0.9)
    with pytest.raises(RunError, match='not begun'):
        run.next_action()
    run.begin(FAR, 1, 0)
    with pytest.raises(RunError, match='begun already'):
        run.begin(FAR, 1, 0)
    with pytest.raises(RunError, match='random generator'):
        Run(option(NORTH, False), TAXI, 0.9, mode=Mode.SAMPLED)
    with pytest.raises(RunError, match='max_steps is -1'):
        Run(option(NORTH, False), TAXI, 0.9, max_steps=-1)


def primitive(action: int) -> PrimitiveOption:
    """Return a primitive action as an option."""
    return PrimitiveOption(f'action:{TAXI.actions[action].name}', action, 6)


def library(*options: LearnedOption) -> OptionLibrary:
    """Return a library of Taxi options."""
    made = OptionLibrary(TAXI)
    made.replace(options)
    return made


def test_options_are_found_by_name_and_participant() -> None:
    ann, bob = option(NORTH, False), option(SOUTH, False, participant='bob')
    other = option(EAST, False, name='other')
    held = library(other, bob, ann)
    assert held.options() == [ann, bob, other]
    assert held.options('bob') == [bob]
    assert held.resolve('drive', 'bob') is bob
    assert held.resolve('other') is other
    assert held.resolve('action:dropoff', 'bob') == primitive(DROPOFF)
    with pytest.raises(AmbiguousOptionError, match='ann, bob'):
        held.resolve('drive')


def test_an_unknown_option_is_answered_with_what_there_is() -> None:
    held = library(option(NORTH, False))
    for name, participant in (('fly', ''), ('drive', 'bob'), ('action:fly', '')):
        with pytest.raises(UnknownOptionError, match=r"'drive' \(ann\).*action:south"):
            held.resolve(name, participant)


def test_a_library_refuses_options_it_could_not_run_and_keeps_what_it_has() -> None:
    held = library(option(NORTH, False))
    for strange in (option(0, False, domain=Taxi(6, 6)), option(0, False, name='action:south')):
        with pytest.raises(OptionError):
            held.replace([option(SOUTH, False, name='new'), strange])
    assert [o.name for o in held.options()] == ['drive']


def test_a_primitive_action_can_be_queried_like_an_option() -> None:
    rows = TAXI.feature_table()[:3]
    action = primitive(WEST)
    assert action.action_probabilities(rows).tolist() == [[0, 0, 0, 1, 0, 0]] * 3
    assert action.initiation_probability(rows).tolist() == [1, 1, 1]
    assert action.termination_probability(rows).tolist() == [1, 1, 1]
