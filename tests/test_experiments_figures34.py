"""Figures 3 and 4 again: cells of their own, and what is said of results that are known."""

from collections.abc import Mapping
import csv
import io
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_teach.report.figures import Drawing
import numpy as np
import pytest

from experiments import figure3, figure4, figure4_section
from experiments.cells import Cell
from experiments.page import csv_text
from experiments.sections import Section, Verdict
from experiments.study import BagLesson, Study

SEED = 4


@pytest.fixture(scope='module')
def extraction() -> dict[str, Any]:
    return figure3.extract({'domain': 'taxi', 'seed': SEED})


def verdicts(section: Section) -> list[Verdict]:
    return [comparison.verdict for comparison in section.comparisons]


def with_cell(extraction: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return an extraction whose options without an event all have one name."""
    options = [{**o, 'name': o['name'] if o['event'] else name} for o in extraction['options']]
    return {**extraction, 'options': options}


def section_of_figure_3(one: Mapping[str, Any]) -> Section:
    study = Study(seeds=1, seed=SEED)
    return figure3.present(study, {figure3.cells(study)[0].key: one})


def test_extraction_is_told_with_its_cost(extraction: dict[str, Any]) -> None:
    assert {o['event'] for o in extraction['options']} >= {'pickup', 'dropoff'}
    assert extraction['game_steps'] > 1_000_000
    assert 0 < min(o['can_start'] for o in extraction['options']) < 1
    table = section_of_figure_3(extraction).tables[2]
    assert table.rows[0][:3] == ['Taxi', SEED, len(extraction['options'])]


@pytest.mark.parametrize(('name', 'agrees'), [('go to cell 2,2', True), ('go to cell 0,0', False)])
def test_the_cell_agrees_when_it_is_the_centre(
    extraction: dict[str, Any], name: str, agrees: bool
) -> None:
    section = section_of_figure_3(with_cell(extraction, name))
    assert verdicts(section)[1] is (Verdict.AGREES if agrees else Verdict.DIFFERS)


def test_it_is_counted_how_often_each_option_of_the_paper_was_found(
    extraction: dict[str, Any],
) -> None:
    study = Study(seeds=2, seed=SEED)
    fewer = {**extraction, 'options': [{**extraction['options'][0], 'name': 'pickup at R'}]}
    first, second = figure3.cells(study)[:2]
    section = figure3.present(study, {first.key: extraction, second.key: fewer})
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows['pickup at R'] == ['yes', 2, 2]
    assert rows['dropoff at Y'] == ['yes', 1, 2]
    assert rows[figure3.CENTRE][0] == 'yes'
    assert [name for name, row in rows.items() if row[0] == 'yes'] == list(figure3.PAPERS)
    assert 'of at least 1' in section.comparisons[0].found


def test_pacman_has_a_map_of_its_maze_and_is_not_compared() -> None:
    study = Study(seeds=1, seed=SEED)
    cell = figure3.cells(study)[1]
    option = {'cell': 3, 'name': 'go to cell 0,3', 'event': '', 'visits': 5}
    option |= {'can_start': 0.5, 'reaches': 1.0}
    cost = {'seconds': 1.0, 'game_steps': 9, 'episodes': 2, 'solved': 1.0}
    places = len(make_domain('pacman').rules.maze.cells)  # type: ignore[attr-defined]
    known = {'options': [option], 'visits': list(range(places)), **cost}
    section = figure3.present(study, {cell.key: known})
    assert cell.parameters['domain'] == 'pacman'
    assert not section.comparisons
    assert section.tables[0].rows == [['go to cell 0,3', None, 1, 1]]
    work = Drawing(*section.pictures[0].size)
    section.pictures[0].draw(work, str)
    assert [text.get_text() for text in work.axes.texts] == ['1']


def test_every_option_is_numbered_on_the_map(extraction: dict[str, Any]) -> None:
    picture = section_of_figure_3(extraction).pictures[0]
    work = Drawing(*picture.size)
    picture.draw(work, str)
    numbers = ', '.join(text.get_text() for text in work.axes.texts).split(', ')
    assert sorted(map(int, numbers)) == list(range(1, len(extraction['options']) + 1))


def test_cell_of_figure_4_has_the_mean_steps_of_its_learners() -> None:
    cells = figure4.cells(Study(participants=1, seeds=2))
    human = next(c for c in cells if c.parameters['set'] == 'human')
    found = figure4.compute({**human.parameters, 'episodes': 5})
    assert len(found['steps']) == 5
    assert found['options'] == ['go to passenger and pickup', 'go to destination and dropoff']
    assert all(2 <= steps <= figure4.LIMIT for steps in found['steps'])
    assert figure4.compute({**human.parameters, 'episodes': 5}) == found


def test_every_action_set_has_as_many_cells() -> None:
    cells = figure4.cells(Study(participants=3))
    sets = [c.parameters['set'] for c in cells]
    assert {name: sets.count(name) for name in figure4.SETS} == dict.fromkeys(figure4.SETS, 6)
    assert len({c.key for c in cells}) == len(cells)


def test_people_in_bags_of_another_domain_teach_nothing_here() -> None:
    lesson = BagLesson('/bag', 'p1', 'avoid ghost', 'pacman', '{}', 'failures', 1, 'x')
    sets = {c.parameters['set'] for c in figure4.cells(Study(bags=(lesson,)))}
    assert sets == {'primitive', 'automatic', 'automatic + primitive'}


def section_of_figure_4(level: Mapping[str, float]) -> Section:
    def result(cell: Cell) -> dict[str, Any]:
        steps = [level[cell.parameters['set']]] * cell.parameters['episodes']
        return {'steps': steps, 'learning_rate': 0.1, 'explore': 0.1, 'options': ['a']}

    study = Study(participants=2)
    known = [c for c in figure4.cells(study) if c.parameters['set'] in level]
    return figure4_section.present(study, {cell.key: result(cell) for cell in known})


def test_human_options_that_learn_slower_do_not_agree() -> None:
    faster = section_of_figure_4({'human': 10.0, 'automatic': 20.0})
    slower = section_of_figure_4({'human': 30.0, 'automatic': 20.0})
    assert verdicts(faster)[:2] == [Verdict.AGREES] * 2
    assert verdicts(slower)[:2] == [Verdict.DIFFERS] * 2
    assert 'human 1,200' in faster.comparisons[0].found


def test_curves_in_csv_are_those_that_are_drawn() -> None:
    section = section_of_figure_4({'human': 10.0, 'automatic': 20.0})
    rows = list(csv.DictReader(io.StringIO(csv_text(section.tables[1]))))
    work = Drawing(5.0, 3.0)
    drawn = {picture.name: picture for picture in section.pictures}
    drawn['fig4-smdp'].draw(work, str)
    for line in work.axes.get_lines():
        mine = [
            float(row['mean'])
            for row in rows
            if (row['method'], row['action set']) == ('SMDP Q-learning', line.get_label())
        ]
        assert np.asarray(line.get_ydata()).tolist() == mine
        assert len(mine) == 120


def test_the_papers_axis_ends_where_it_ends_in_the_paper_and_has_no_mixtures() -> None:
    section = section_of_figure_4({'human': 10.0, 'primitive': 900.0, 'human + primitive': 5.0})
    drawn = {picture.name: picture for picture in section.pictures}
    work = Drawing(5.0, 3.0)
    drawn['fig4-smdp-paper'].draw(work, str)
    assert work.axes.get_ylim() == (0, 300)
    assert [line.get_label() for line in work.axes.get_lines()] == ['primitive', 'human']


def test_mixtures_are_told_and_not_compared() -> None:
    section = section_of_figure_4({'human': 10.0, 'automatic': 20.0, 'human + primitive': 30.0})
    (told,) = [c for c in section.comparisons if 'human options and primitive' in c.said]
    assert told.verdict is Verdict.NOT_COMPARABLE
    assert 'SMDP Q-learning: 30 steps in the first 10 episodes, 30 in the last 10' in told.found
