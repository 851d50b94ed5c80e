"""Recorded runs: how they are collected and kept, and what is planned and learned from them."""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain, SeenState
from humanopts_env.game import Transition
from humanopts_learner.option_runs import OPTION_RUNS, OptionRun, RunCollector, RunLog
from humanopts_learner.planning.action_set import ActionSet
from humanopts_learner.planning.recorded_plan import make_recorded_plan, OptionLearner
from humanopts_learner.planning.request import (
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PlanError,
    PlanRequest,
    Sampling,
)
from humanopts_learner.qlearning import Rates
from humanopts_learner.run import RunResult, RunStatus
import numpy as np
import pytest

GAMMA = 0.5
CORRIDOR = DescribedDomain(
    'corridor',
    {},
    [Feature.number('x', 'where it is', 5)],
    [Action('left', 'a', 'west'), Action('right', 'd', 'east')],
    GAMMA,
    100,
)
REQUEST = PlanRequest(HUMAN, columns=('x',), sampling=Sampling(min_samples=1))


@dataclass(frozen=True)
class Walk:
    """Walk in one direction, up to a place."""

    name: str
    way: int
    end: int
    max_steps: int = 10

    def can_start(self, rows: Rows) -> Flags:
        return rows[:, 0] != self.end

    def action(self, rows: Rows) -> Ints:
        return np.full(len(rows), self.way)

    def ends(self, rows: Rows) -> Flags:
        return rows[:, 0] == self.end


EAST, WEST = Walk('east', 1, 4), Walk('west', 0, 0)


def recorded(name: str, *places: int, status: str = 'REACHED', over: bool = False) -> OptionRun:
    """Return a run of an option with reward -1 per step."""
    moves = ['right' if after > here else 'left' for here, after in pairwise(places)]
    return OptionRun(
        run_id='r',
        domain='corridor',
        domain_parameters='{}',
        option=name,
        participant='',
        status=status,
        episode=1,
        first_step=0,
        features=tuple((float(place),) for place in places),
        actions=tuple(moves),
        rewards=(-1.0,) * len(moves),
        terminated=over,
    )


def option_values(*runs: OptionRun, least: int = 1) -> dict[int, list[float]]:
    """Return the option values of a plan by place."""
    request = replace(REQUEST, sampling=Sampling(min_samples=least))
    plan = make_recorded_plan(CORRIDOR, [EAST, WEST], runs, request)
    table, found = plan.policy.values, {}
    for place in range(5):
        state = plan.actions.observe_state(SeenState('', (float(place),))).states[0]
        if state in table.states:
            found[place] = table.option_values[table.states == state][0].tolist()
    return found


def test_every_suffix_of_a_run_is_a_sample() -> None:
    values = option_values(recorded('east', 1, 2, 3, 4, over=True))
    none = -np.inf
    assert values[1] == [-1.75, none]
    assert values[2] == [-1.5, none]
    assert values[3] == [-1.0, none]


def test_a_run_that_was_broken_off_does_not_count() -> None:
    good = recorded('east', 3, 4, over=True)
    off = recorded('east', 1, 2, status='CANCELED')
    plan = make_recorded_plan(CORRIDOR, [EAST, WEST], [good, off], REQUEST)
    assert plan.recorded_runs == 1


@pytest.mark.parametrize(
    ('end', 'steps'),
    [(4, 3), (3, 2), (0, 0)],
)
def test_a_run_counts_as_far_as_the_option_of_today_would_have_acted(end: int, steps: int) -> None:
    run, newer = recorded('east', 1, 2, 3, 4), replace(EAST, end=end)
    learner = OptionLearner.of(CORRIDOR, [newer, WEST], [run], REQUEST)
    assert sum(int(n.sum()) for n in learner.table.visits.values()) == steps


def test_a_run_with_other_actions_does_not_count() -> None:
    with pytest.raises(PlanError, match=r"no recorded run of 'east', 'west' in corridor counts"):
        make_recorded_plan(
            CORRIDOR, [replace(EAST, way=0), WEST], [recorded('east', 3, 4)], REQUEST
        )


def test_options_with_too_few_samples_are_unavailable_and_named() -> None:
    runs = [recorded('east', 3, 4)] * 2 + [recorded('west', 3, 2, 1, 0)]
    values = option_values(*runs, least=2)
    assert values[3][1] == -np.inf
    request = replace(REQUEST, sampling=Sampling(min_samples=2))
    plan = make_recorded_plan(CORRIDOR, [EAST, WEST], runs, request)
    found = {(each.option, each.state): (each.choices, each.samples) for each in plan.missing}
    assert found['west', 'x 3'] == (3, 1)
    assert found['west', 'x 4'] == (2, 0)
    assert ('east', 'x 3') not in found


def test_every_step_is_a_sample_of_its_action_where_actions_can_be_chosen() -> None:
    run, request = (
        recorded('east', 2, 3, 4, over=True),
        replace(REQUEST, action_set=HUMAN_AND_PRIMITIVE),
    )
    plan = make_recorded_plan(CORRIDOR, [EAST], [run], request)
    assert plan.names == ('east', 'action:left', 'action:right')
    values = plan.policy.values.option_values
    known = values[np.isfinite(values).any(axis=1)]  # not where the task is over
    assert sorted(known.tolist()) == [[-1.5, -np.inf, -1.5], [-1.0, -np.inf, -1.0]]


def test_learning_offline_and_while_driving_gives_the_same_values() -> None:
    runs = [recorded('east', 1, 2, 3, 4, over=True), recorded('west', 2, 1, 0)] * 5
    offline = OptionLearner.of(CORRIDOR, [EAST, WEST], runs, REQUEST)
    live = OptionLearner.of(CORRIDOR, [EAST, WEST], runs[:3], REQUEST)
    for run in runs[3:]:
        live.learn(run)
    assert live.runs == offline.runs == 10
    assert {s: v.tolist() for s, v in live.table.values.items()} == {
        s: v.tolist() for s, v in offline.table.values.items()
    }


def test_q_learning_comes_to_the_values_of_the_models() -> None:
    runs = [recorded('east', 1, 2, 3, 4, over=True), recorded('west', 3, 2, 1, 0)] * 20
    runs += [recorded('east', 0, 1, 2, 3, 4, over=True)] * 20
    by_models = make_recorded_plan(CORRIDOR, [EAST, WEST], runs, REQUEST)
    learner = OptionLearner.of(CORRIDOR, [EAST, WEST], runs, REQUEST)
    by_learning = make_recorded_plan(CORRIDOR, [EAST, WEST], runs, REQUEST, learner)
    for place in range(4):
        here = SeenState('', (float(place),))
        assert by_learning.choose(here) == by_models.choose(here)
    known = by_models.policy.values
    states = by_learning.policy.values.states
    rows = np.searchsorted(known.states, states)
    worth = by_learning.policy.values.option_values
    finite = np.isfinite(worth)
    assert worth[finite] == pytest.approx(known.option_values[rows][finite], abs=0.02)


def test_a_learner_explores_only_among_options_that_can_start() -> None:
    actions = ActionSet(CORRIDOR, HUMAN, [EAST, WEST], ('x',))
    learner = OptionLearner(actions, GAMMA, Rates(explore=1.0))
    rng = np.random.default_rng(1)
    chosen = {learner.choose(SeenState('', (2.0,)), rng).name for _ in range(20)}
    assert chosen == {'east', 'west'}
    assert {learner.choose(SeenState('', (4.0,)), rng).name for _ in range(20)} == {'west'}


def transition(step: int, place: int, *, refreshed: bool = False) -> Transition:
    moved = {'previous_action': 'right', 'reward': -1.0} if step else {}
    return Transition(1, step, str(place), (float(place),), refreshed=refreshed, **moved)  # type: ignore[arg-type]


RESULT = RunResult(RunStatus.REACHED, '', 'east', 'r', 1, 0, 2)


@pytest.mark.parametrize('early', [0, 1, 2, 3])
def test_messages_may_arrive_in_any_order(early: int) -> None:
    collector, found = RunCollector(CORRIDOR), []
    collector.on_goal('r', 'ann')
    for step, place in enumerate((2, 3, 4)):
        if step == early:
            found += collector.on_result(RESULT)
        found += collector.on_state('game#1', transition(step, place))
    if early == 3:
        found += collector.on_result(RESULT)
    assert [(run.participant, run.features, run.rewards) for run in found] == [
        ('ann', ((2.0,), (3.0,), (4.0,)), (-1.0, -1.0))
    ]


def test_a_run_with_a_lost_state_is_not_collected() -> None:
    collector = RunCollector(CORRIDOR)
    for step, place in ((0, 2), (2, 4)):
        collector.on_state('game#1', transition(step, place))
    assert collector.on_result(RESULT) == []


def test_runs_survive_a_restart_and_those_of_other_worlds_are_left_out(tmp_path: Path) -> None:
    log = RunLog(tmp_path, CORRIDOR)
    log.add(recorded('east', 1, 2))
    log.add(replace(recorded('east', 1, 2), domain='hall'))
    with (tmp_path / OPTION_RUNS).open('a') as file:
        file.write('nonsense\n')
    again = RunLog(tmp_path, CORRIDOR)
    assert again.runs == [recorded('east', 1, 2)]
    assert again.problems[0].endswith('it is a run in hall {}')
    assert len(again.problems) == 2
