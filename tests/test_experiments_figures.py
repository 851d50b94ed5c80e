"""Figures 2, 3 and 4 again: small trials, known results, files and page."""

import csv
from dataclasses import asdict, replace
import json
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.automatic.subgoals import Extraction
from humanopts_learner.options.learned_option import options_from_references
from humanopts_teach.cli import main
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd
import pytest

from experiments import demonstrations, figure2, figure3, figure4, paper, table1, table2
from experiments.command import section_of
from experiments.people import BagLesson, CAREFUL, OwnedOptions, participants, Study, VARIED
from experiments.report import (
    compare,
    Comparison,
    Mark,
    mean_intervals,
    Picture,
    Reproduction,
    Section,
    verdicts,
    write_reproduction,
)
from experiments.trials import Rows

PICKUP, DROPOFF = paper.TAUGHT['taxi']
SEED = 4


def about(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


def marks(section: Section) -> list[Mark]:
    return [c.mark for c in section.comparisons]


def draw(picture: Picture) -> Drawing:
    work = Drawing(*picture.size)
    picture.draw(work)
    return work


# All experiments.


def test_means_have_intervals_by_group_within_the_limits() -> None:
    frame = pd.DataFrame({'of': ['a', 'a', 'b', 'b'], 'x': [1.0, 3.0, 4.0, np.nan]})
    found = mean_intervals(frame, ['of'], 'x', 0.0, 5.0).set_index('of')
    assert found.loc['a'].tolist() == [2, 2.0, 0.0, 5.0]
    assert found.loc['b', ['count', 'mean']].tolist() == [1, 4.0]
    assert np.isnan(found.loc['b', 'low'])


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
    try:
        status = main(['reproduce', *arguments, *out])
    except SystemExit as end:
        status = int(end.code or 0)
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert status == 2
    assert said in line


def test_the_page_has_every_statement_of_the_paper_once() -> None:
    """Goals of the project are not the paper's; the marks of a statement are counted."""
    a, c = paper.SAID['rises'], paper.SAID['centre']
    x = [compare(a, True), compare('a goal', True)]
    y = [compare(a, False), compare(c, Mark.NO_COUNTERPART), compare(a, True)]
    assert [each.mark for each in x] == [Mark.AGREES, Mark.MET]
    assert verdicts([Section('x', 'X', x), Section('y', 'Y', y)]) == {
        ('x', a.text, a.where): {Mark.AGREES: 1},
        ('y', a.text, a.where): {Mark.DIFFERS: 1, Mark.AGREES: 1},
        ('y', c.text, c.where): {Mark.NO_COUNTERPART: 1},
    }
    assert section_of(figure2, []) == Section('fig2', figure2.TITLE)  # every trial failed


def test_buttons_that_people_named_are_options_here() -> None:
    """Nothing is computed for table 1; each of its ten buttons is an option that can be taught."""
    section = table1.present()
    assert marks(section) == [Mark.NO_COUNTERPART] * 3
    rows = section.tables[0].rows
    assert len(rows) == 10
    assert all(row['button'] in reference_options(make_domain(row['domain'])) for row in rows)
    taught = {(row['domain'], row['button']) for row in rows if 'figure 2' in row['here']}
    assert taught == {(domain, name) for domain, names in paper.TAUGHT.items() for name in names}


@pytest.mark.parametrize('experiment', [figure2, figure3, figure4, table2, demonstrations])
def test_trials_differ_and_more_people_leave_the_first_as_they_are(experiment: Any) -> None:
    few, many = ([trial.key for trial in experiment.trials(Study(n, seeds=3))] for n in (6, 7))
    assert set(few) <= set(many)
    assert len(many) == len(set(many))


# Figure 2.


def lesson_of(*policy: float, **case: Any) -> Rows:
    """Return the points of a lesson: policy accuracies after 1, 2, 3 ... demonstrations."""
    known = dict(zip(figure2.PERSON, ['taxi', 'all', PICKUP, CAREFUL, 'random', 'p']))
    return [
        {
            **known,
            'demonstrations': n,
            'not here': 0,
            **dict(zip(figure2.MEASURES, (10 * value - 20, value, 1.0, 0.5))),
            'best return': -10.0,
            'minutes': 1.5,
            'cut short': '',
            **{name.replace('_', ' '): value for name, value in case.items()},
        }
        for n, value in enumerate(policy, start=1)
    ]


def as_wished(strategy: str) -> list[float]:
    """Return accuracies as one would wish: failures best, random as in the paper."""
    good, perfect = {'failures': (9, 19), 'coverage': (19, 49), 'random': (39, 58)}[strategy]
    return [0.5] * good + [0.96] * (perfect - good) + [1.0] * (60 - perfect)


def figure_2(*lessons: Rows) -> Section:
    return figure2.present(pd.DataFrame([row for lesson in lessons for row in lesson]))


@pytest.fixture(scope='module')
def section() -> Section:
    return figure_2(
        *(
            lesson_of(
                *as_wished(strategy),
                domain=game.domain,
                features=game.features,
                option=option,
                people=group,
                start_states_by=strategy,
                person=person,
            )
            for game in figure2.GAMES
            for group in game.groups
            for option in paper.TAUGHT[game.domain]
            for strategy in game.strategies
            for person in 'ab'
        )
    )


@pytest.fixture(scope='module')
def written(section: Section, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reproduction with known results, of which one is drawn."""
    folder = tmp_path_factory.mktemp('reproduction')
    section = replace(section, pictures=section.pictures[:1])
    people = [replace(participants(VARIED, 1, 5)[0], code='<p&1>')]
    data = Reproduction([section], people, Study(seed=5), ['fig2 (x): why'], {'s': '5'})
    write_reproduction(folder, data)
    return folder


def test_a_level_counts_from_where_it_holds_for_good() -> None:
    """The first person loses it with the third demonstration, the last at the end."""
    section = figure_2(
        lesson_of(0.5, 0.95, 0.9, 1.0, person='a'),
        lesson_of(0.5, 0.6, 0.7, 0.96, person='b'),
        lesson_of(0.5, 0.96, 0.6, option=DROPOFF),
    )
    first, last = section.tables[0].rows
    assert first['demonstrations for 95%'] == '4.0'
    assert first['demonstrations for 100%'] == 'over 4.0 (1 of 2 people)'
    assert last['demonstrations for 95%'] == 'not within 3'
    lost = lesson_of(*[0.5] * 4, *[1.0] * 15, 0.5, *[1.0] * 40, start_states_by='failures')
    goal, _ = about(figure_2(lost, [{**row, 'person': 'b'} for row in lost]), 'at most')
    assert (goal.mark, '21.0 (21.0 to 21.0)' in goal.found) == (Mark.MISSED, True)


def test_lesson_of_a_trial_has_the_demonstrations_asked_for() -> None:
    parameters = {
        'domain': 'taxi',
        'domain_parameters': '{}',
        'option': PICKUP,
        'strategy': 'failures',
        'demonstrations': 4,
        'person': asdict(participants(VARIED, 1, seed=2)[0]),
    }
    found = figure2.learn_from_simulated(parameters)
    assert found[-1]['demonstrations'] == 4
    assert found[-1]['cut short'] == ''
    assert found[-1]['minutes'] > 1 / 3  # ten questions and four drives, by the assumed pace
    frame = pd.DataFrame(found)
    assert frame['demonstrations'].is_unique  # an answer "not here" changes the last point
    assert frame['not here'].is_monotonic_increasing
    assert frame[[*figure2.MEASURES][1:]].stack().between(0, 1).all()
    assert frame['return'].between(-100, frame['best return']).all()
    assert figure2.learn_from_simulated(parameters) == found


def test_goals_that_are_reached_are_met_and_the_papers_forty_has_no_level(
    section: Section,
) -> None:
    goals = about(section, 'at most 15') + about(section, 'at most 30')
    assert [c.mark for c in goals] == [Mark.MET] * 4
    assert goals[0].found.endswith(' 10.0 (10.0 to 10.0)')
    forty = about(section, 'over 40 trajectories')
    assert [c.mark for c in forty] == [Mark.NOT_COMPARABLE] * 2
    assert all('does not say which accuracy' in c.found for c in forty)
    minutes = about(section, 'minutes to show')
    assert [c.mark for c in minutes] == [Mark.NOT_COMPARABLE] * 3  # two lists of features
    assert all('assumed pace' in c.found for c in minutes)


def test_a_goal_is_undecided_where_the_interval_holds_the_limit() -> None:
    """Of two people one needs 5 and one 15 demonstrations."""
    lessons = [
        lesson_of(*[0.5] * n, *[0.96] * (60 - n), person=str(n), start_states_by='failures')
        for n in (4, 14)
    ]
    goal, *_ = about(figure_2(*lessons), 'at most 15')
    assert goal.mark is Mark.UNDECIDED
    assert goal.found.endswith(' 10.0 (-53.5 to 73.5)')  # 5 * t(0.975, 1) on each side


def test_gain_of_accuracy_is_that_within_people() -> None:
    """Ten people from 0.1 to 0.9: all gain 0.05, much less than they differ."""
    lessons = [
        lesson_of(
            *(level, level + 0.05 + 0.001 * (number % 2)),
            person=str(number),
            people=VARIED,
            option=paper.FIGURE_2_OPTIONS['taxi'],
        )
        for number, level in enumerate(np.linspace(0.1, 0.9, 10).tolist())
    ]
    (rises, *_) = figure_2(*lessons).comparisons
    assert rises.mark is Mark.AGREES
    assert 'best actions 0.0505 (0.05012 to 0.05088)' in rises.found


def test_csv_json_and_figure_hold_the_same_numbers(section: Section, written: Path) -> None:
    with (written / 'fig2-curves.csv').open(encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    kept = json.loads((written / 'fig2.json').read_text('utf-8'))['tables']['fig2-curves']
    assert [float(row['mean']) for row in rows] == [record['mean'] for record in kept]
    plots = draw(section.pictures[0]).figure.axes
    for axes, measure in zip(plots, figure2.MEASURES, strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        for strategy in ('random', 'coverage', 'failures'):
            case = ['taxi', 'all', PICKUP, CAREFUL, strategy]
            named = {**dict(zip(figure2.CASE, case)), 'measure': measure}
            mine = [r for r in rows if {**r, **named} == r]
            x, y = lines[strategy].get_data()
            assert [int(r['demonstrations']) for r in mine] == np.asarray(x).tolist()
            assert [float(r['mean']) for r in mine] == np.asarray(y).tolist()


def test_page_is_escaped_and_names_what_failed(written: Path) -> None:
    page = (written / 'report.html').read_text('utf-8')
    assert not re.search(r'(?:src|href)="(?!#)|url\((?!#)|@import', page)
    assert '&lt;p&amp;1&gt;' in page
    assert 'Not computed: fig2 (x): why' in page
    assert page.count('<svg') == 1
    assert page.count('var(--c1)') >= 4  # colours of the page, in every plot


# Figure 3.


@pytest.fixture(scope='module')
def extraction() -> dict[str, Any]:
    quick = Extraction(tasks=50, train_episodes=60, option_episodes=20, max_steps=200)
    return figure3.extraction_row(find_options(make_domain('taxi'), SEED, quick))


def figure_3(*found: dict[str, Any], domain: str = 'taxi') -> Section:
    rows = [{'domain': domain, 'seed': SEED + n, **one} for n, one in enumerate(found)]
    return figure3.present(pd.DataFrame(rows))


def test_extraction_is_shown_with_its_cost_and_every_option_is_on_the_map(
    extraction: dict[str, Any],
) -> None:
    assert min(extraction['pickups'], extraction['dropoffs']) > 0
    assert extraction['game steps'] > 100_000
    assert 0 < min(extraction['can start']) < 1
    section = figure_3(extraction)
    (row,) = section.tables[2].rows
    assert (row['domain'], row['seed'], row['options']) == (
        'taxi',
        SEED,
        len(extraction['option']),
    )
    texts = draw(section.pictures[0]).axes.texts
    numbers = ', '.join(text.get_text() for text in texts).split(', ')
    assert sorted(map(int, numbers)) == list(range(1, row['options'] + 1))


@pytest.mark.parametrize(
    ('names', 'mark'),
    [
        (['go to cell 2,2'] * 6, Mark.AGREES),  # 6 of 6: 61 % at least
        (['go to cell 0,0'] * 6, Mark.DIFFERS),
        (['go to cell 2,2'] * 3, Mark.UNDECIDED),  # 3 of 3: 44 % at least
        (['go to cell 2,2'] * 4 + ['go to cell 0,0'] * 2, Mark.UNDECIDED),
    ],
)
def test_the_cell_agrees_when_it_is_mostly_the_centre(
    extraction: dict[str, Any], names: list[str], mark: Mark
) -> None:
    _, *others = extraction['option']
    section = figure_3(*({**extraction, 'option': [name, *others]} for name in names))
    assert marks(section)[1] is mark


def test_extractions_with_each_option_of_the_paper_are_counted(extraction: dict[str, Any]) -> None:
    one = {name: extraction[name][:1] for name in ('target', 'can start')}
    section = figure_3(extraction, {**extraction, **one, 'option': ['pickup at R']})
    rows = {row['option']: list(row.values())[1:] for row in section.tables[0].rows}
    assert rows['pickup at R'] == ['yes', 2]
    assert rows['dropoff at Y'] == ['yes', 1]
    assert [name for name, row in rows.items() if row[0] == 'yes'] == list(figure3.PAPERS)


def test_pacman_has_a_map_of_its_maze_and_is_not_compared(extraction: dict[str, Any]) -> None:
    places = len(make_domain('pacman').rules.maze.cells)  # type: ignore[attr-defined]
    one = {'option': ['go to cell 0,3'], 'target': [3], 'can start': [0.5]}
    known = {**extraction, **one, 'visits': list(range(places))}
    section = figure_3(known, domain='pacman')
    assert not section.comparisons
    (row,) = section.tables[0].rows
    assert list(row.values()) == ['go to cell 0,3', None, 1]
    assert [text.get_text() for text in draw(section.pictures[0]).axes.texts] == ['1']


# Figure 4.


def test_trial_of_figure_4_has_the_mean_steps_of_its_learners(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two options that are always right take the place of those of a lesson."""
    taxi = Taxi()
    known = (reference_options(taxi)[name] for name in paper.TAUGHT['taxi'])
    taught = OwnedOptions(tuple(options_from_references(taxi, known)))
    monkeypatch.setattr(figure4.people, 'options_of', lambda owner, domain: taught)
    trials = figure4.trials(Study(participants=1, seeds=2))
    human = next(trial for trial in trials if trial.parameters['set'] == 'human')
    (found,) = figure4.learn_curves({**human.parameters, 'episodes': 5})
    assert (len(found['steps']), found['options']) == (5, 2)
    assert all(2 <= steps <= figure4.LIMIT for steps in found['steps'])
    assert figure4.learn_curves({**human.parameters, 'episodes': 5}) == [found]


def test_every_action_set_has_as_many_members() -> None:
    """Six of them at most in one trial."""
    trials = figure4.trials(Study(participants=7))
    for name in figure4.SETS:
        mine = [trial.parameters for trial in trials if trial.parameters['set'] == name]
        assert [len(parameters['members']) for parameters in mine] == [6, 1] * 2


def figure_4(level: dict[str, float], spread: float = 0.0) -> Section:
    """Return the section of two members for each set, with episodes of constant length."""
    known = {'options': 1, 'learning rate': 0.1, 'exploring': 0.1}
    rows = [
        {'method': method, 'action set': name, **known, 'steps': [steps] * paper.EPISODES}
        for method in figure4.METHODS.values()
        for name, each in level.items()
        for steps in (each, each + spread)
    ]
    return figure4.present(pd.DataFrame(rows))


@pytest.mark.parametrize(
    ('human', 'automatic', 'spread', 'mark', 'words'),
    [
        (10.0, 20.0, 0.0, Mark.AGREES, 'human 1,200'),
        (30.0, 20.0, 0.0, Mark.DIFFERS, 'human in the first 10 30.0'),
        # Welch: means of 1,260 and 1,320, 60 on each side of standard error, t(0.975, 2) = 4.303
        (10.0, 10.5, 1.0, Mark.UNDECIDED, 'automatic less human 60 (-305 to 425)'),
    ],
)
def test_human_options_that_learn_faster_agree(
    human: float, automatic: float, spread: float, mark: Mark, words: str
) -> None:
    section = figure_4({'human': human, 'automatic': automatic}, spread)
    assert marks(section)[:2] == [mark] * 2
    assert words in section.comparisons[0].found


def test_the_papers_axis_ends_where_it_ends_in_the_paper_and_has_no_mixtures() -> None:
    section = figure_4({'human': 10.0, 'primitive': 900.0, 'human + primitive': 5.0})
    axes = draw(section.pictures[0]).axes
    assert axes.get_ylim() == (0, 300)
    lines = {str(line.get_label()): line.get_ydata() for line in axes.get_lines()}
    assert [*lines] == ['human', 'primitive']
    assert np.asarray(lines['human']).tolist() == [10.0] * 120


# Demonstrations.


def test_people_teach_carefully_and_again_with_slips() -> None:
    trials = demonstrations.trials(Study(participants=2))
    people = [trial.parameters['person'] for trial in trials]
    rates = {person['group']: person['error_rate'] for person in people}
    assert rates == {'careful': 0.0, 'slips': demonstrations.ERROR_RATE}
    assert len(trials) == 2 * 2 * 2 * 2 * 2
    lesson = BagLesson('/bag', 'p1', 'go', 'taxi', '{}', 'failures', 1, 'x')
    assert demonstrations.trials(Study(bags=(lesson,))) == []


def test_by_goal_every_option_of_taxi_is_right_after_a_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(demonstrations, 'LONGER', 1)
    person = asdict(replace(participants(CAREFUL, 1, 1)[0], error_rate=0.02))
    parameters = {'domain': 'taxi', 'method': 'goal', 'strategy': 'failures', 'person': person}
    rows = demonstrations.count_demonstrations(parameters)
    assert json.loads(json.dumps(rows)) == rows
    assert len(rows) == 6
    for row in rows:
        assert 3 <= row[demonstrations.UNTIL[0]] <= 5
        assert 1 <= row[demonstrations.UNTIL[1]] <= 3
        assert row['accuracy when the criteria hold'] == 1.0


@pytest.mark.parametrize(
    ('met', 'mark'),
    [
        ([3, 4, 3], Mark.MET),
        ([3, 5, 7], Mark.UNDECIDED),
        ([9, 9, 10], Mark.MISSED),
        ([3, None, 5], Mark.UNDECIDED),
    ],
)
def test_the_goal_is_met_where_the_whole_interval_is_below(
    met: list[int | None], mark: Mark
) -> None:
    """A lesson that did not get there is counted as never."""
    case = dict(zip(demonstrations.KEYS, ['taxi', DROPOFF, 'goal', 'failures', 'careful']))
    rows = [
        {**case, 'code': str(n), demonstrations.UNTIL[0]: count, demonstrations.UNTIL[1]: 2}
        for n, count in enumerate(met)
    ]
    section = demonstrations.present(pd.DataFrame(rows))
    (found,) = section.comparisons
    assert found.mark is mark
    assert found.found.startswith('3 people: go to destination and dropoff ')
    (row,) = section.tables[0].rows
    assert (row['count'], row['until the criteria hold: never']) == (3, met.count(None))
    assert row['until the criteria hold: most'] == max(filter(None, met))
    assert row['most in excess'] == max(filter(None, met)) - 2
    lines = draw(section.pictures[0]).axes.get_lines()
    (dots,) = (line.get_xdata() for line in lines if line.get_marker() == 'o')
    assert sorted(dots) == sorted(filter(None, met))
