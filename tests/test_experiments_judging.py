"""Which options are right, and lessons as ``humanopts reproduce judging`` gives them."""

from collections.abc import Sequence
from dataclasses import replace
import json
from pathlib import Path

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.table_domain import TableDomain
from humanopts_env.domains.tabular import distance_to
from humanopts_learner.options.learned_option import options_from_references, TabularOption
from humanopts_teach.cli import main
import numpy as np
import pandas as pd
import pytest

from experiments import judging
from experiments.people import Study
from experiments.report import Mark
from experiments.right import Ending, meant, MeantEverywhere, MeantInSample

CELLS, LEFT = 12, 0


class Ring(TableDomain[int]):
    """Cells in a ring; a step to the left or right may slip, and stays then."""

    name, gamma, max_steps = 'ring', 0.99, 100
    actions = (Action('left', 'left', 'go left'), Action('right', 'right', 'go right'))
    features = (Feature.number('cell', 'which cell it is', CELLS),)

    def __init__(self, slips: float = 0.0) -> None:
        super().__init__(range(CELLS))
        self.parameters, self.slips = {'slips': slips}, slips

    def outcomes(self, state: int, action: int) -> Sequence[tuple[float, int, float]]:
        there = (state + (1 if action else -1)) % CELLS
        outcomes = [(1 - self.slips, there, -1.0), (self.slips, state, -1.0)]
        return outcomes[: 2 if self.slips else 1]

    def encode(self, state: int) -> str:
        return f'cell {state}'

    def is_over(self, state: int) -> bool:
        return False

    def can_begin(self, state: int) -> bool:
        return True

    def values_of(self, state: int) -> Sequence[float]:
        return (state,)


def to_cell_0(domain: Ring) -> TabularReferenceOption:
    """Go to cell 0 from cells 1 to 5, by the shorter way."""
    cell = np.arange(CELLS)
    starts, goal = (cell > 0) & (cell < 6), cell == 0
    distance, optimal = distance_to(Ring().transitions(), goal[_successor()], starts)
    return TabularReferenceOption(
        domain, 'to cell 0', ('cell',), starts, ~starts, optimal, distance, cell >= 0
    )


def _successor() -> np.ndarray:
    return Ring().transitions().successor[:, :, 0]


def share_right(domain: Ring, option: TabularOption) -> tuple[float, dict[str, float], float]:
    wanted = MeantEverywhere(domain, to_cell_0(domain))
    found = wanted.performance(option)
    return (
        float(found.right(wanted.teacher).mean()),
        found.faults(wanted.teacher),
        found.elsewhere,
    )


RIGHT = TabularOption.of_reference(to_cell_0(Ring()))
NOWHERE = np.zeros(CELLS, dtype=np.bool_)


@pytest.mark.parametrize('slips', [0.0, 0.3])
def test_an_option_that_does_as_its_teacher_is_right_from_everywhere(slips: float) -> None:
    assert share_right(Ring(slips), RIGHT) == (1.0, {}, 0.0)


def test_an_option_must_end_where_its_teacher_ends() -> None:
    early = replace(RIGHT, termination=RIGHT.termination | (np.arange(CELLS) == 2))
    assert share_right(Ring(), early) == (0.4, {'early': 0.6}, 0.0)
    late = replace(RIGHT, termination=np.arange(CELLS) == 11)
    assert share_right(Ring(), late) == (0.0, {'late': 1.0}, 0.0)
    never = replace(RIGHT, termination=NOWHERE, action=np.arange(CELLS) % 2)
    assert share_right(Ring(), never)[1]['never'] == 0.8


def test_an_option_that_takes_three_times_the_steps_is_wrong() -> None:
    """From cell 3 it is 3 steps to the left, and 9 to the right; the teacher never goes there."""
    cell = np.arange(CELLS)
    goal, starts = cell == 0, cell > 0
    distance, optimal = distance_to(Ring().transitions(), goal[_successor()], starts)
    anywhere = TabularReferenceOption(
        Ring(), 'to cell 0', ('cell',), starts, ~starts, optimal, distance, cell >= 0
    )
    wanted = MeantEverywhere(Ring(), anywhere)
    right = TabularOption.of_reference(anywhere)
    found = wanted.performance(replace(right, action=np.ones(CELLS, dtype=np.intp)))
    assert found.right(wanted.teacher).tolist() == [n >= 4 for n in range(1, CELLS)]
    assert found.faults(wanted.teacher) == {'slow': pytest.approx(3 / 11)}


def test_an_option_may_start_only_where_its_teacher_can() -> None:
    shy = replace(RIGHT, initiation=RIGHT.initiation & (np.arange(CELLS) > 1))
    assert share_right(Ring(), shy) == (0.8, {'refused': 0.2}, 0.0)
    bold = replace(RIGHT, initiation=~NOWHERE)
    assert share_right(Ring(), bold) == (1.0, {}, 1.0)


def test_where_chance_matters_the_teachers_own_share_is_the_measure() -> None:
    """Five steps are enough with a probability of 1.00 and 0.97, and then 0.84 and less."""
    hasty = replace(RIGHT, max_steps=5)
    assert share_right(Ring(0.3), hasty) == (0.4, {'never': 0.6}, 0.0)


def test_a_wrong_dropoff_is_an_end_but_not_the_one_that_is_meant() -> None:
    domain = make_domain('taxi')
    references = reference_options(domain)
    name = 'go to destination and dropoff'
    (option,) = options_from_references(domain, [references[name]])
    wanted = meant(domain, references, name, 1)
    assert wanted.performance(option).right(wanted.teacher).all()
    table = TabularOption.of_reference(references[name])
    anywhere = replace(table, action=np.full(domain.n_states, 5))  # always drops off
    found = wanted.performance(anywhere)
    assert found.endings[:, Ending.OTHER].sum() > 3


@pytest.mark.parametrize(
    ('name', 'option'), [('pacman', 'go to the closest food'), ('taxi', 'go to passenger')]
)
def test_the_same_runs_are_right_in_a_sample_and_everywhere(name: str, option: str) -> None:
    """A teacher in a game of chance is right by its own measure."""
    domain = make_domain(name)
    references = reference_options(domain)
    wanted = meant(domain, references, option, 1)
    assert isinstance(wanted, MeantInSample if name == 'pacman' else MeantEverywhere)
    assert wanted.teacher.right(wanted.teacher).all()
    assert wanted.teacher.faults(wanted.teacher) == {}
    assert len(wanted.teacher.steps) >= 50


def test_ends_that_depend_on_the_start_are_those_that_are_meant() -> None:
    domain = make_domain('taxi')
    for meaning, starts in (
        (judging.next_thing, 400),
        (judging.two_cells_north, 240),
        (judging.fetch, 300),
    ):
        ((name, option),) = meaning(domain).items()
        wanted = meant(domain, {name: option}, name, 1)
        assert len(wanted.teacher.can_start) == starts
        assert wanted.teacher.right(wanted.teacher).all()


def test_lessons_of_a_row_are_given_judged_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    worlds = {'Taxi': replace(judging.WORLDS['Taxi'], methods=('goal',))}
    kinds = ('careful', 'yes to all features', 'no to a needed feature', 'two cells north')
    monkeypatch.setattr(judging, 'WORLDS', worlds)
    monkeypatch.setattr(judging, 'TEACHERS', {kind: judging.TEACHERS[kind] for kind in kinds})
    monkeypatch.setattr(judging, 'BUDGET', 10)
    monkeypatch.chdir(tmp_path)
    assert main(['reproduce', 'judging', '--participants', '2', '--jobs', '1']) == 0
    folder = tmp_path / 'runs/reproduce-judging'
    rows = json.loads((folder / 'judging.json').read_text())['tables']['judging-rows']
    assert [row['taught by'] for row in rows] == [*kinds]
    careful = rows[0]
    assert (careful['lessons'], careful['learned'], careful['right']) == (2, 2, 1.0)
    assert careful['demonstrations'] <= 4
    assert careful['exam answers'] >= 5
    assert 'two cells north' in (folder / 'report.html').read_text()


def test_the_slowest_world_is_not_in_the_default_selection() -> None:
    def worlds(participants: int) -> set[str]:
        study = Study(participants)
        return {trial.parameters['world'] for trial in judging.trials(study)}

    assert {*judging.WORLDS} - worlds(judging.LESSONS) == {'LunarLander'}
    assert worlds(60) == {*judging.WORLDS}


def test_goals_count_options_called_learned_and_lessons_that_call_a_wrong_one_so() -> None:
    def lessons(teacher: str, *outcomes: tuple[bool, bool]) -> list[dict[str, object]]:
        return [
            {
                **dict(zip(judging.KEYS, ('Taxi', 'goal', teacher))),
                'learned': learned,
                'right': right,
                'elsewhere': 0.0,
                'faults': {},
                **dict.fromkeys(judging.COSTS, 1.0),
            }
            for learned, right in outcomes
        ]

    rows = [
        *lessons('careful', (True, True), (False, False)),
        *lessons('10 % slips', (True, True), (True, False)),
        *lessons('yes to all features', (False, False)),
        *lessons('two cells north', (False, False), (True, True)),
        *lessons('end by history', (False, False), (True, False)),
    ]
    section = judging.present(pd.DataFrame(rows))
    marks = [each.mark for each in section.comparisons]
    assert marks == [Mark.MET, Mark.MISSED, Mark.UNDECIDED, Mark.MET, Mark.MISSED]
    assert '0 of 1 called learned' in section.comparisons[2].found


@pytest.mark.parametrize(
    ('world', 'method', 'taught_by', 'lesson'),
    [
        ('Taxi', 'goal', 'two kinds of ends', 17),  # deliveries pass what looks like an end
        ('Rooms', 'goal', 'careful', 11),  # slips lead through another doorway
        ('FrozenLake 4x4', 'trees', '10 % slips', 1),  # only runs that reach the goal are shown
        pytest.param(  # points that have nothing to do with the option
            *('Pac-Man', 'trees', 'careful', 9), marks=pytest.mark.heavy
        ),
    ],
)
def test_chance_and_other_ends_do_not_keep_a_right_option_from_being_learned(
    world: str, method: str, taught_by: str, lesson: int
) -> None:
    case = dict(zip(judging.KEYS, (world, method, taught_by)))
    (row,) = judging.give_lesson({**case, 'lesson': lesson, 'seed': 1})
    assert row['learned']
    assert row['right']


@pytest.mark.parametrize('lesson', [23, 57])  # in both, a slip was shown; in 57, as an end
def test_a_lesson_goes_on_while_its_policy_slips_through_another_doorway(lesson: int) -> None:
    case = {'world': 'Rooms', 'method': 'trees', 'taught by': 'careful'}
    (row,) = judging.give_lesson({**case, 'lesson': lesson, 'seed': 2})
    assert row['learned']
    assert row['right']
