"""Figures 2, 3 and 4 again: trials of small size, results that are known, files and page."""

from collections.abc import Mapping
import csv
from dataclasses import asdict, replace
import json
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.registry import domain_from_json, make_domain, reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.automatic.subgoals import Extraction
from humanopts_learner.options.learned_option import options_from_references
from humanopts_teach.cli import main
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd
import pytest

from experiments import figure2, figure3, figure4, paper, table1, table2
from experiments.command import section_of
from experiments.people import CAREFUL, OwnedOptions, participants, Study, VARIED
from experiments.report import (
    Comparison,
    Done,
    Mark,
    mean_intervals,
    OURS,
    Picture,
    Reproduction,
    Section,
    verdicts,
    write_reproduction,
)
from experiments.trials import Outcome

PICKUP = 'go to passenger and pickup'
SEED = 4


def about(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


def marks(section: Section) -> list[Mark]:
    return [c.mark for c in section.comparisons]


def draw(picture: Picture) -> Drawing:
    work = Drawing(*picture.size)
    picture.draw(work)
    return work


# What all experiments share.


def test_interval_is_that_of_students_t() -> None:
    frame = pd.DataFrame({'of': ['a', 'a', 'b', 'b'], 'x': [1.0, 3.0, 4.0, np.nan]})
    found = mean_intervals(frame, ['of'], 'x')
    assert found['count'].tolist() == [2, 1]
    assert found['mean'].tolist() == [2.0, 4.0]
    assert found['high'][0] - 2.0 == pytest.approx(12.706204736)  # t(0.975, 1) * 1
    assert np.isnan(found['low'][1])
    assert mean_intervals(frame, ['of'], 'x', 0.0, 5.0)[['low', 'high']].iloc[0].tolist() == [0, 5]


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
    errors = capsys.readouterr().err.strip().splitlines()
    assert status == 2
    assert len(errors) == 1
    assert said in errors[0]


@pytest.mark.parametrize('module', [figure2, figure3, figure4, table2])
def test_nothing_is_said_of_trials_that_failed(module: Any) -> None:
    section = section_of(module, Outcome(), module.trials(Study(participants=1, seeds=1)))
    assert section == Section(module.NAME, module.TITLE)


def test_the_page_has_every_statement_of_the_paper_once() -> None:
    """Goals of the project are not the paper's; the marks of a statement are counted."""
    said = [
        Comparison('a', 'section 1', '1', Mark.AGREES),
        Comparison('b', OURS, '2', Mark.MET),
        Comparison('a', 'section 1', '3', Mark.DIFFERS),
        Comparison('c', 'section 2', '4', Mark.NO_COUNTERPART),
        Comparison('a', 'section 1', '5', Mark.AGREES),
    ]
    found = verdicts([Section('x', 'X', said[:2]), Section('y', 'Y', said[2:])])
    assert found == {
        ('x', 'a', 'section 1'): {Mark.AGREES: 1},
        ('y', 'a', 'section 1'): {Mark.DIFFERS: 1, Mark.AGREES: 1},
        ('y', 'c', 'section 2'): {Mark.NO_COUNTERPART: 1},
    }


def test_buttons_that_people_named_are_options_here() -> None:
    """Nothing is computed for table 1; each of its ten buttons is an option that can be taught."""
    section = table1.present()
    assert marks(section) == [Mark.NO_COUNTERPART] * 3
    rows = section.tables[0].rows
    assert len(rows) == 10
    assert all(row['button'] in reference_options(make_domain(row['domain'])) for row in rows)
    taught = {(row['domain'], row['button']) for row in rows if 'figure 2' in row['here']}
    assert taught == {(domain, name) for domain, names in paper.TAUGHT.items() for name in names}


# Figure 2.


def lesson_of(*policy: float, not_here: int = 0) -> dict[str, Any]:
    """Return what a trial came to: policy accuracies after 1, 2, 3 ... demonstrations."""
    points = [
        [n, not_here, 10 * value - 20, value, 1.0, 0.5] for n, value in enumerate(policy, start=1)
    ]
    return {
        'points': points,
        'best_return': -10.0,
        'seconds': 90.0,
        'cut_short': '',
    }


def as_wished(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return results as one would wish: failures best, random as in the paper."""
    levels = {'failures': (9, 19), 'coverage': (19, 49), 'random': (39, 58)}
    good, perfect = levels[parameters['strategy']]
    return lesson_of(*[0.5] * good, *[0.96] * (perfect - good), *[1.0] * (60 - perfect))


def figure_2(result: Any, *domains: str) -> Section:
    """Return the section of results by parameters of trials; of some domains, or of all."""
    every = [trial.parameters for trial in figure2.trials(Study(participants=2, seed=5))]
    mine = [known for known in every if not domains or known['domain'] in domains]
    return figure2.present([(known, result(known)) for known in mine])


@pytest.fixture(scope='module')
def section() -> Section:
    return figure_2(as_wished)


@pytest.fixture(scope='module')
def written(section: Section, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reproduction with results that are known, of which one is drawn."""
    folder = tmp_path_factory.mktemp('reproduction')
    section = replace(section, pictures=section.pictures[:1])
    people = [replace(participants(VARIED, 1, 5)[0], code='<p&1>')]
    data = Reproduction([section], people, Study(seed=5), ['fig2 (x): why'], {'s': '5'})
    write_reproduction(folder, data)
    return folder


def careful(number: int, **others: Any) -> dict[str, Any]:
    person = asdict(participants(CAREFUL, 2, seed=1)[number])
    known = {'domain': 'taxi', 'domain_parameters': '{}', 'option': PICKUP}
    return {**known, 'strategy': 'random', 'demonstrations': 4, 'person': person, **others}


def test_demonstrations_needed_are_those_until_a_level_is_reached_first_and_for_good() -> None:
    """The first person loses the level with the third demonstration, and has it again."""
    done: Done = [
        (careful(0), lesson_of(0.5, 0.95, 0.9, 1.0, not_here=3)),
        (careful(1), lesson_of(0.5, 0.6, 0.7, 0.96)),
    ]
    people = figure2.person_table(figure2.accuracy_table(done))
    (needed,) = figure2.needed_table(people).to_dict('records')
    assert people['95%, first'].tolist() == [2, 4]
    assert people['95%, for good'].tolist() == [4, 4]
    assert people['100%, first'].tolist() == [4, pd.NA]
    assert needed['demonstrations for 95%, first'] == '3.0'
    assert needed['demonstrations for 95%, for good'] == '4.0'
    assert needed['demonstrations for 100%, first'] == 'over 4.0 (1 of 2 people)'


def test_a_level_that_is_lost_at_last_is_not_reached_for_good() -> None:
    (row,) = figure2.present([(careful(0), lesson_of(0.5, 0.96, 0.6))]).tables[0].rows
    assert row['demonstrations for 95%, first'] == '2.0'
    assert row['demonstrations for 95%, for good'] == 'not within 3'


def test_marks_count_demonstrations_until_the_level_holds_for_good() -> None:
    """The level is first reached after 5, and lost once after 20: the goal is missed."""
    section = figure_2(lambda _: lesson_of(*[0.5] * 4, *[1.0] * 15, 0.5, *[1.0] * 40), 'taxi')
    (goal, *_) = about(section, 'at most 15')
    assert goal.mark is Mark.MISSED
    assert 'first 5.0; for good 21.0' in goal.found


def test_answer_not_here_changes_the_point_of_the_demonstrations_so_far() -> None:
    points = [
        [1, 0, -9.0, 0.5, 0.6, 0.7],
        [1, 1, -9.0, 0.5, 0.8, 0.9],
        [2, 1, -8.0, 0.6, 0.8, 0.9],
    ]
    done: Done = [(careful(0), {**lesson_of(), 'points': points})]
    found = figure2.accuracy_table(done)
    assert found['initiation'].tolist() == [0.8, 0.8]
    assert found['not here'].tolist() == [1, 1]


def test_lesson_of_a_trial_has_the_demonstrations_asked_for() -> None:
    person = asdict(participants(VARIED, 1, seed=2)[0])
    parameters = careful(0, strategy='failures', person=person)
    found = figure2.learn_from_simulated(parameters)
    assert found['points'][-1][0] == 4
    assert found['cut_short'] == ''
    assert found['seconds'] > 20  # ten questions and four drives, by the assumed pace
    assert all(0 <= value <= 1 for point in found['points'] for value in point[3:])
    assert all(-100 <= point[2] <= found['best_return'] for point in found['points'])
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

    def result(parameters: Mapping[str, Any]) -> dict[str, Any]:
        few = parameters['person']['code'] == participants(CAREFUL, 2, 5)[0].code
        good = (5, 15)[not few] - 1
        return lesson_of(*[0.5] * good, *[0.96] * (60 - good))

    section = figure_2(result, 'taxi')
    goal, *_ = about(section, 'at most 15')
    assert goal.mark is Mark.UNDECIDED
    assert goal.found.endswith(' 10.0 (-53.5 to 73.5)')  # 5 * t(0.975, 1) on each side


def test_gain_of_accuracy_is_that_within_people() -> None:
    """Ten people from 0.1 to 0.9: all gain 0.05, much less than they differ."""
    person = asdict(participants(VARIED, 1, 5)[0])
    done: Done = [
        (
            careful(0, strategy='random', person={**person, 'code': f'p{number}'})
            | {'option': paper.FIGURE_2_OPTIONS['taxi']},
            lesson_of(level, level + 0.05 + 0.001 * (number % 2)),
        )
        for number, level in enumerate(np.linspace(0.1, 0.9, 10).tolist())
    ]
    (rises, *_) = figure2.present(done).comparisons
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
            named = {
                'domain': 'taxi',
                'features': 'all',
                'option': PICKUP,
                'people': CAREFUL,
                'start states by': strategy,
                'measure': measure,
            }
            mine = [r for r in rows if {**r, **named} == r]
            x, y = lines[strategy].get_data()
            assert [int(r['demonstrations']) for r in mine] == np.asarray(x).tolist()
            assert [float(r['mean']) for r in mine] == np.asarray(y).tolist()


def test_page_needs_nothing_from_outside_and_is_escaped(written: Path) -> None:
    page = (written / 'report.html').read_text('utf-8')
    assert not re.search(r'(?:src|href|action)\s*=\s*["\']?\s*(?!#)(?:https?:|//|[a-z])', page)
    assert not re.search(r'url\((?!#)', page)
    assert '@import' not in page
    assert '&lt;p&amp;1&gt;' in page
    assert 'simulated' in page
    assert 'Not computed: fig2 (x): why' in page
    assert page.count('<svg') == 1
    assert page.count('var(--c1)') >= 4  # colours of the page, in every plot


def test_figure_2_of_pacman_is_there_with_both_lists_of_features(section: Section) -> None:
    """Each caption says what the features do; the return has the reference option's beside it."""
    captions = [p.caption for p in section.pictures if 'go to the closest food' in p.caption]
    assert len(captions) == 2
    assert 'they hand the policy over' in captions[0]
    assert 'positions only' in captions[1]
    trials = figure2.trials(Study(participants=1))
    mine = [t.parameters for t in trials if t.parameters['domain'] == 'pacman']
    names = {
        len(domain_from_json('pacman', known['domain_parameters']).features) for known in mine
    }
    assert names == {15, 30}
    last = {row['features']: row for row in section.tables[1].rows if row['domain'] == 'pacman'}
    assert set(last) == {figure2.DIRECTIONS, figure2.POSITIONS}
    assert {row['best return'] for row in last.values()} == {-10.0}
    axes = draw(section.pictures[-1]).figure.axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert set(np.asarray(lines['reference'].get_ydata())) == {-10.0}


# Figure 3.


@pytest.fixture(scope='module')
def extraction() -> dict[str, Any]:
    quick = Extraction(tasks=50, train_episodes=60, option_episodes=20, max_steps=200)
    return figure3.as_json(find_options(make_domain('taxi'), SEED, quick))


def figure_3(*found: Mapping[str, Any], domain: str = 'taxi') -> Section:
    return figure3.present(
        [({'domain': domain, 'seed': SEED + n}, x) for n, x in enumerate(found)]
    )


def test_extraction_is_shown_with_its_cost(extraction: dict[str, Any]) -> None:
    assert {o['event'] for o in extraction['options']} >= {'pickup', 'dropoff'}
    assert extraction['game_steps'] > 100_000
    assert 0 < min(o['can_start'] for o in extraction['options']) < 1
    row = figure_3(extraction).tables[2].rows[0]
    assert (row['domain'], row['seed']) == ('Taxi', SEED)
    assert row['options'] == len(extraction['options'])


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
    first, *others = extraction['options']
    cells = [{**first, 'name': name, 'event': ''} for name in names]
    section = figure_3(*({**extraction, 'options': [cell, *others]} for cell in cells))
    assert marks(section)[1] is mark


def test_it_is_counted_how_often_each_option_of_the_paper_was_found(
    extraction: dict[str, Any],
) -> None:
    fewer = {**extraction, 'options': [{**extraction['options'][0], 'name': 'pickup at R'}]}
    section = figure_3(extraction, fewer)
    rows = {row['option']: list(row.values())[1:] for row in section.tables[0].rows}
    assert rows['pickup at R'] == ['yes', 2, 2]
    assert rows['dropoff at Y'] == ['yes', 1, 2]
    assert rows[figure3.CENTRE][0] == 'yes'
    assert [name for name, row in rows.items() if row[0] == 'yes'] == list(figure3.PAPERS)
    assert 'the rarest pickup or dropoff in 1' in section.comparisons[0].found


def test_pacman_has_a_map_of_its_maze_and_is_not_compared() -> None:
    option = {'cell': 3, 'name': 'go to cell 0,3', 'event': '', 'visits': 5}
    option |= {'can_start': 0.5, 'reaches': 1.0}
    cost = {'seconds': 1.0, 'game_steps': 9, 'episodes': 2, 'solved': 1.0}
    places = len(make_domain('pacman').rules.maze.cells)  # type: ignore[attr-defined]
    known = {'options': [option], 'visits': list(range(places)), **cost}
    section = figure_3(known, domain='pacman')
    assert not section.comparisons
    (row,) = section.tables[0].rows
    assert list(row.values()) == ['go to cell 0,3', None, 1, 1]
    assert [text.get_text() for text in draw(section.pictures[0]).axes.texts] == ['1']


def test_every_option_is_numbered_on_the_map(extraction: dict[str, Any]) -> None:
    work = draw(figure_3(extraction).pictures[0])
    numbers = ', '.join(text.get_text() for text in work.axes.texts).split(', ')
    assert sorted(map(int, numbers)) == list(range(1, len(extraction['options']) + 1))


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
    assert len(found['steps']) == 5
    assert found['options'] == ['go to passenger and pickup', 'go to destination and dropoff']
    assert all(2 <= steps <= figure4.LIMIT for steps in found['steps'])
    assert figure4.learn_curves({**human.parameters, 'episodes': 5}) == [found]


def test_every_action_set_has_as_many_members() -> None:
    """Six of them at most in one trial, so more people leave trials of six as they are."""
    trials = figure4.trials(Study(participants=7))
    for name in figure4.SETS:
        mine = [trial.parameters for trial in trials if trial.parameters['set'] == name]
        assert [len(parameters['members']) for parameters in mine] == [6, 1] * 2
    first = {trial.key for trial in figure4.trials(Study(participants=6))}
    assert first < {trial.key for trial in trials}
    assert len({trial.key for trial in trials}) == len(trials)


def figure_4(level: Mapping[str, float], spread: float = 0.0) -> Section:
    """Return the section of episodes that all take as many steps, by action set."""
    known = {'learning_rate': 0.1, 'explore': 0.1, 'options': ['a']}
    return figure4.present(
        [
            (
                trial.parameters,
                [
                    {
                        'steps': [level[trial.parameters['set']] + spread * (number % 2)]
                        * paper.EPISODES,
                        **known,
                    }
                    for number in range(len(trial.parameters['members']))
                ],
            )
            for trial in figure4.trials(Study(participants=2))
            if trial.parameters['set'] in level
        ]
    )


def test_human_options_that_learn_slower_do_not_agree() -> None:
    faster = figure_4({'human': 10.0, 'automatic': 20.0})
    slower = figure_4({'human': 30.0, 'automatic': 20.0})
    assert marks(faster)[:2] == [Mark.AGREES] * 2
    assert marks(slower)[:2] == [Mark.DIFFERS] * 2
    assert 'human 1,200' in faster.comparisons[0].found


def test_human_options_whose_lead_is_within_the_interval_are_not_distinguishable() -> None:
    """Means of 1,260 and 1,320 steps by two people and extractions, who differ by 120 steps."""
    section = figure_4({'human': 10.0, 'automatic': 10.5}, spread=1.0)
    assert marks(section)[:2] == [Mark.UNDECIDED] * 2
    # Welch: 60 on each side of standard error, t(0.975, 2) = 4.303
    assert 'automatic less human 60 (-305 to 425)' in section.comparisons[0].found


def test_curves_of_figure_4_in_csv_are_those_that_are_drawn() -> None:
    section = figure_4({'human': 10.0, 'automatic': 20.0})
    drawn = {picture.name: picture for picture in section.pictures}
    for line in draw(drawn['fig4-smdp']).axes.get_lines():
        mine = [
            row['mean']
            for row in section.tables[1].rows
            if (row['method'], row['action set']) == ('SMDP Q-learning', line.get_label())
        ]
        assert np.asarray(line.get_ydata()).tolist() == mine
        assert len(mine) == 120


def test_the_papers_axis_ends_where_it_ends_in_the_paper_and_has_no_mixtures() -> None:
    section = figure_4({'human': 10.0, 'primitive': 900.0, 'human + primitive': 5.0})
    drawn = {picture.name: picture for picture in section.pictures}
    axes = draw(drawn['fig4-smdp-paper']).axes
    assert axes.get_ylim() == (0, 300)
    assert [line.get_label() for line in axes.get_lines()] == ['primitive', 'human']
