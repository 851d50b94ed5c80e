"""Figure 2 again: its numbers by hand, its files, and its page."""

import csv
import json
from pathlib import Path
import re
from typing import Any

from humanopts_teach.cli import main
from humanopts_teach.report.figures import Drawing
import numpy as np
import pytest

from experiments import figure2, paper
from experiments.bands import band
from experiments.cells import Cell
from experiments.figure2_section import EXPERIMENT, present
from experiments.figure2_series import gather
from experiments.page import Reproduction, write_reproduction
from experiments.people import CAREFUL, Participant, participants, VARIED
from experiments.sections import Comparison, Section, Verdict
from experiments.study import Study

PICKUP = 'go to passenger and pickup'


def result(*policy: float, not_here: int = 0, cut_short: str = '') -> dict[str, Any]:
    """Return what a cell came to: policy accuracies after 1, 2, 3 ... demonstrations."""
    points = [[n, not_here, value, 1.0, 0.5] for n, value in enumerate(policy, start=1)]
    return {'points': points, 'seconds': 90.0, 'cut_short': cut_short}


def results_of(study: Study, made: Any) -> dict[str, Any]:
    """Return a result for every cell of figure 2, made from its parameters."""
    return {cell.key: made(cell.parameters) for cell in figure2.cells(study)}


def of_taxi(parameters: Any) -> dict[str, Any]:
    """Return results as one would wish: failures best, random as in the paper."""
    levels = {'failures': (9, 19), 'coverage': (19, 49), 'random': (39, 58)}
    good, perfect = levels[parameters['strategy']]
    return result(*[0.5] * good, *[0.96] * (perfect - good), *[1.0] * (60 - perfect))


def comparisons(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


@pytest.fixture(scope='module')
def study() -> Study:
    return Study(participants=2, seed=5)


@pytest.fixture(scope='module')
def written(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reproduction with results that are known."""
    folder = tmp_path_factory.mktemp('reproduction')
    people = [Participant.from_dict({**participants(VARIED, 1, 5)[0].to_dict(), 'code': '<p&1>'})]
    section = present(study, results_of(study, of_taxi))
    write_reproduction(folder, Reproduction([section], people, [], ['fig2 (x): why'], {'s': '5'}))
    return folder


def test_band_is_that_of_students_t() -> None:
    found = band(np.array([[1.0, 4.0], [3.0, np.nan]]))
    assert found.count.tolist() == [2, 1]
    assert found.mean.tolist() == [2.0, 4.0]
    assert found.high[0] - found.mean[0] == pytest.approx(12.706204736)  # t(0.975, 1) * 1
    assert np.isnan(found.low[1])
    assert band(np.array([[0.0], [1.0]]), 0.0, 1.0).low.tolist() == [0.0]


def test_demonstrations_needed_are_those_until_the_level_is_first_reached() -> None:
    people = participants(CAREFUL, 2, seed=1)
    cells = [
        Cell('fig2', {**base(), 'person': person.to_dict()}, figure2.simulated)
        for person in people
    ]
    found = gather(
        cells,
        {
            cells[0].key: result(0.5, 0.95, 0.9, 1.0, not_here=3),
            cells[1].key: result(0.5, 0.6, 0.7, 0.96),
        },
    )
    good, perfect = (found[0].needed(level) for level in (0.95, 1.0))
    assert (good.demonstrations, good.asked, good.text) == ((2, 4), (5, 4), '3.0')
    assert (perfect.demonstrations, perfect.text) == ((4, None), 'over 4.0 (1 of 2 people)')
    assert found[0].needed(1.01).text == 'not within 4'


def base() -> dict[str, Any]:
    return {'domain': 'taxi', 'option': PICKUP, 'strategy': 'random', 'demonstrations': 4}


def test_answer_not_here_changes_the_point_of_the_demonstrations_so_far() -> None:
    parameters = {**base(), 'person': participants(CAREFUL, 1, seed=1)[0].to_dict()}
    cell = Cell('fig2', parameters, figure2.simulated)
    points = [[1, 0, 0.5, 0.6, 0.7], [1, 1, 0.5, 0.8, 0.9], [2, 1, 0.6, 0.8, 0.9]]
    made = {'points': points, 'seconds': 60.0, 'cut_short': ''}
    series = gather([cell], {cell.key: made})[0]
    assert series.accuracy[1].tolist() == [[0.8, 0.8]]
    assert series.not_here.tolist() == [[1.0, 1.0]]


def test_lesson_of_a_cell_has_the_demonstrations_asked_for() -> None:
    person = participants(VARIED, 1, seed=2)[0]
    parameters = {**base(), 'strategy': 'failures', 'person': person.to_dict()}
    found = figure2.simulated(parameters)
    assert found['points'][-1][0] == 4
    assert found['cut_short'] == ''
    assert found['seconds'] > 20  # ten questions and four drives, by the assumed pace
    assert all(0 <= value <= 1 for point in found['points'] for value in point[2:])
    assert figure2.simulated(parameters) == found


def test_goals_that_are_reached_are_met_and_the_papers_forty_agrees(study: Study) -> None:
    section = present(study, results_of(study, of_taxi))
    goals = comparisons(section, 'at most 15') + comparisons(section, 'at most 30')
    assert [c.verdict for c in goals] == [Verdict.MET] * 4
    assert 'mean 10.0.' in goals[0].found
    assert [c.verdict for c in comparisons(section, 'about 40')] == [Verdict.AGREES] * 2


def test_goals_that_are_missed_are_told(study: Study) -> None:
    section = present(study, results_of(study, lambda _: result(*[0.5] * 60)))
    told = [c for c in section.comparisons if c.verdict in (Verdict.MISSED, Verdict.DIFFERS)]
    assert len(comparisons(section, 'at most')) == 4
    assert len(told) == 4 + 2 + 2  # goals; about 40; no rise in either domain
    assert all('not within 60' in c.found for c in comparisons(section, '% policy accuracy'))


def test_minutes_of_simulated_people_are_not_comparable(study: Study) -> None:
    section = present(study, results_of(study, of_taxi))
    minutes = comparisons(section, 'minutes to show')
    assert [c.verdict for c in minutes] == [Verdict.NOT_COMPARABLE] * 2
    assert all('assumed pace' in c.found for c in minutes)


def test_nothing_is_said_of_cells_that_failed(study: Study) -> None:
    section = present(study, {})
    assert not section.comparisons
    assert not section.pictures
    assert all(not table.rows for table in section.tables)


def test_csv_json_and_figure_hold_the_same_numbers(study: Study, written: Path) -> None:
    with (written / 'fig2-curves.csv').open(encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    kept = json.loads((written / 'fig2.json').read_text('utf-8'))['tables']['fig2-curves']
    assert [float(row['mean']) for row in rows] == [record['mean'] for record in kept]
    section = present(study, results_of(study, of_taxi))
    work = Drawing(10.0, 3.0)
    section.pictures[0].draw(work, lambda colour: colour)
    domain, option, group = 'taxi', PICKUP, CAREFUL
    for axes, measure in zip(work.figure.axes, ('policy', 'initiation', 'termination')):
        lines = {line.get_label(): line for line in axes.get_lines()}
        for strategy in ('random', 'coverage', 'failures'):
            named = {
                'domain': domain,
                'option': option,
                'people': group,
                'start states by': strategy,
                'measure': measure,
            }
            mine = [r for r in rows if {**r, **named} == r]
            x, y = lines[strategy].get_data()
            assert [int(r['demonstrations']) for r in mine] == np.asarray(x).tolist()
            assert [float(r['mean']) for r in mine] == np.asarray(y).tolist()


def test_every_figure_is_there_as_png_and_svg(study: Study, written: Path) -> None:
    for picture in present(study, results_of(study, of_taxi)).pictures:
        assert (written / f'{picture.name}.png').read_bytes().startswith(b'\x89PNG')
        text = (written / f'{picture.name}.svg').read_text('utf-8')
        assert '<svg' in text
        assert 'var(--' not in text  # colours of its own
        assert '#0101a' not in text


def test_page_needs_nothing_from_outside_and_is_escaped(written: Path) -> None:
    page = (written / 'report.html').read_text('utf-8')
    assert not re.search(r'(?:src|href|action)\s*=\s*["\']?\s*(?!#)(?:https?:|//|[a-z])', page)
    assert not re.search(r'url\((?!#)', page)
    assert '@import' not in page
    assert '&lt;p&amp;1&gt;' in page
    assert 'simulated' in page
    assert 'Not computed: fig2 (x): why' in page
    assert page.count('<svg') == 7  # options in groups


def test_paper_and_registry_name_the_same_options(study: Study) -> None:
    taught = {(c.parameters['domain'], c.parameters['option']) for c in EXPERIMENT.cells(study)}
    assert taught == {(d, option) for d, options in paper.TAUGHT.items() for option in options}
    assert all(paper.FIGURE_2_OPTIONS[d] in paper.TAUGHT[d] for d in paper.TAUGHT)


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['fig9'], "'fig9'"),
        (['fig2', '--participants', '0'], 'not from 1'),
        (['fig2', '--bags', 'nowhere'], 'nowhere'),
        (['fig2', '--out', '/proc/x'], '/proc/x'),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [] if '--out' in arguments else ['--out', str(tmp_path / 'out')]
    status = main(['reproduce', *arguments, *out])
    errors = capsys.readouterr().err.strip().splitlines()
    assert status == 2
    assert len(errors) == 1
    assert said in errors[0]
