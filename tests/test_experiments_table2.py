"""Table 2 again: real cells of small numbers, and what is said of results that are known."""

from collections.abc import Mapping
import csv
from dataclasses import asdict, replace
import io
import json
from typing import Any

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.automatic.how import Extraction
from humanopts_teach.report.figures import Drawing
import numpy as np
import pytest

from experiments import table2
from experiments.cells import Cell
from experiments.page import csv_text
from experiments.sections import Comparison, Section, Verdict
from experiments.study import BagLesson, Study
from experiments.table2_kinds import (
    CHASE,
    GAMES,
    KINDS,
    NOBODY,
    OTHER_WAYS,
    PERSON,
    TAXI,
    TO_END,
    UNIFORM,
)
from experiments.table2_sampled import Effort, plan_from_samples, settings_to_try
from experiments.table2_section import present, STYLES

TINY = Effort(
    tried=2,
    search_games=2,
    search_steps=800,
    largest=1600,
    primitive_search_steps=800,
    primitive_largest=3200,
    first=800,
    games=4,
)
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds', 'seconds')


def without_seconds(value: Any) -> Any:
    """Return JSON data without what a clock said."""
    if isinstance(value, Mapping):
        return {k: without_seconds(v) for k, v in value.items() if k not in SECONDS}
    return [without_seconds(v) for v in value] if isinstance(value, list) else value


def cell_of(domain: str, whose: str, study: Study = Study(participants=1, seeds=2)) -> Cell:  # noqa: B008
    return next(
        cell
        for cell in table2.cells(study)
        if (cell.parameters['domain'], cell.parameters['whose']) == (domain, whose)
    )


def test_every_kind_of_plan_is_made_with_at_least_as_many_plans_as_seeds() -> None:
    cells = table2.cells(Study(participants=4, seeds=10))
    for game in GAMES:
        for kind in KINDS:
            mine = [
                c.parameters['plans']
                for c in cells
                if (c.parameters['domain'], c.parameters['whose']) == (game.domain, kind.whose)
            ]
            assert mine == [3] * 4
    assert len({c.key for c in cells}) == len(cells)


def test_domains_that_nobody_in_the_bags_taught_are_left_out() -> None:
    lesson = BagLesson('/bag', 'p1', 'avoid ghost', 'pacman', '{}', 'failures', 1, 'x')
    domains = {c.parameters['domain'] for c in table2.cells(Study(bags=(lesson,)))}
    assert domains == {'pacman'}


def test_all_action_sets_try_the_same_settings_and_the_first_is_the_usual_one() -> None:
    few, many = settings_to_try(0.97, 2), settings_to_try(0.97, 5)
    assert many[:2] == few
    assert many[0].sampling == type(many[0].sampling)()
    assert len(set(many)) == 5


def test_person_plans_taxi_as_well_as_primitive_actions_do() -> None:
    human, primitive = (
        (cell := cell_of('taxi', whose)).compute(cell.parameters) for whose in (PERSON, NOBODY)
    )
    found = human['games'][TAXI.name]
    best = primitive['games'][TAXI.name]['kinds']['primitive']['plans'][0]
    assert json.loads(json.dumps(human)) == human
    assert human['costs']['human']['demonstrations'] > 2
    for name in ('human', 'human, interrupted', 'human + primitive'):
        plans = found['kinds'][name]['plans']
        assert len(plans) == 2
        assert plans[0]['done'] == best['done'] == 1.0
        assert plans[0]['mean'] == pytest.approx(best['mean'], abs=0.5)
        assert found['kinds'][name]['curve'][-1]['mean'] == plans[0]['mean']
    assert found['gains']['human, interrupted']['least'] > -1e-9
    assert found['gains']['human, modular (strongest)']['least'] > -1e-9


def test_both_games_of_pacman_are_planned_with_budgets_that_double() -> None:
    effort = replace(TINY, tried=1, games=2, primitive_largest=1600)
    cell = cell_of('pacman', NOBODY, Study(participants=1, seeds=1))
    found = table2.compute({**cell.parameters, 'effort': asdict(effort)})
    assert list(found['games']) == [UNIFORM.name, CHASE.name]
    for game in found['games'].values():
        curve = game['kinds']['primitive']['curve']
        assert [point['budget'] for point in curve] == [800, 1600]
        assert all(point['game_steps'] >= point['budget'] for point in curve)


def test_same_seed_gives_the_same_numbers_and_another_one_others() -> None:
    domain, kind = PacMan(maze='yard', max_steps=50), KINDS[0]
    first, again, other = (
        without_seconds(plan_from_samples(domain, [(kind, ())], 1, TINY, seed))
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_gains_are_of_every_plan_that_runs_to_the_end() -> None:
    domain = PacMan(maze='yard', max_steps=50)
    small = Extraction(options=2, tasks=30, train_episodes=50, option_episodes=50)
    options = find_options(domain, 1, small).batched
    asked = [(kind, options) for kind in (TO_END, OTHER_WAYS[0])]
    found = plan_from_samples(domain, asked, 2, TINY, seed=1)
    assert list(found['kinds']) == ['human', 'human, interrupted']
    assert {name: len(gains) for name, gains in found['gains'].items()} == {
        kind.name: 2 for kind in OTHER_WAYS
    }


def plan(mean: float, seconds: float, budget: int) -> dict[str, Any]:
    """Return a plan in which everything but return, seconds and budget is alike."""
    return {
        'budget': budget,
        'table_seconds': 0.0,
        'model_seconds': seconds,
        'sweep_seconds': 0.0,
        'sweeps': 3,
        'states': 500,
        'game_steps': 0,
        'mean': mean,
        'discounted': mean,
        'done': 1.0,
        'fallbacks': 0.0,
        'games': 1,
    }


GOOD = {  # seconds and return by kind
    'primitive': (50.0, 1500.0),
    'human': (2.0, 1400.0),
    'automatic': (4.0, 700.0),
    'human, interrupted': (3.0, 1950.0),
}


def section_of(
    level: Mapping[str, tuple[float, float]], gain: float = 100.0, least: float = 0.0
) -> Section:
    """Return the section of results that are the same in all games."""

    def kinds(whose: str) -> dict[str, Any]:
        made = {}
        for kind in KINDS:
            if kind.whose == whose and kind.name in level:
                seconds, mean = level[kind.name]
                curve = [plan(mean / 2, seconds / 2, 1), plan(mean, seconds, 2)]
                made[kind.name] = {'curve': curve, 'plans': curve[1:], 'tried': [], 'chosen': None}
        return made

    def result(cell: Cell) -> dict[str, Any]:
        whose, domain = cell.parameters['whose'], cell.parameters['domain']
        names = ('options', 'demonstrations', 'minutes', 'seconds', 'game_steps')
        exact = {'least': least, 'mean': 1.0, 'most': 2.0}
        gains = {kind.name: exact if domain == 'taxi' else [gain] for kind in OTHER_WAYS}
        return {
            'costs': {name: dict.fromkeys(names, 4) for name in level},
            'games': {
                game.name: {'kinds': kinds(whose), 'gains': gains if whose == PERSON else {}}
                for game in GAMES
                if game.domain == domain
            },
        }

    study = Study(participants=2, seeds=2)
    return present(study, {cell.key: result(cell) for cell in table2.cells(study)})


def about(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


def test_what_is_as_in_the_paper_agrees() -> None:
    section = section_of(GOOD)
    for said in ('more efficient', 'with human options is faster', 'never as good'):
        assert [c.verdict for c in about(section, said)] == [Verdict.AGREES] * 3
    assert 'Human options are ahead in both' in about(section, 'more efficient')[0].found
    exact, sampled, _ = (c.found for c in about(section, 'with human options is faster'))
    assert exact == 'Taxi, planning: human 2 s, primitive 50 s.'
    assert sampled.endswith('until 1,400 points: human 2 s, primitive 50 s.')
    assert 'until 700 points: human 1 s, automatic 4 s.' in about(section, 'efficient')[1].found


@pytest.mark.parametrize(
    ('human', 'words'),
    [
        ((9.0, 1400.0), 'in return, and not in time'),
        ((2.0, 600.0), 'in time, and not in return'),
        ((9.0, 600.0), 'in neither'),
    ],
)
def test_human_options_that_are_behind_are_said_to_be(
    human: tuple[float, float], words: str
) -> None:
    found = about(section_of({**GOOD, 'human': human}), 'more efficient')
    assert [c.verdict for c in found] == [Verdict.DIFFERS] * 3
    assert all(words in c.found for c in found)


def test_numbers_of_the_paper_that_do_not_compare_stand_beside_ours() -> None:
    section = section_of(GOOD)
    seconds, rewards = about(section, '60.45 s'), about(section, '1890')
    assert [c.verdict for c in (*seconds, *rewards)] == [Verdict.NOT_COMPARABLE] * 2
    table = next(t for t in section.tables if t.name == 'table2-paper')
    assert table.records()[1]["paper's average reward"] == -4.294
    assert table.records()[1]['mean return'] == 1400.0


@pytest.mark.parametrize(
    ('interrupted', 'uniform', 'chase'),
    [
        ((3.0, 1950.0), Verdict.MET, Verdict.MET),
        ((6.0, 1950.0), Verdict.MISSED, Verdict.MET),  # not in a tenth of the time
        ((3.0, 1890.0), Verdict.MISSED, Verdict.MET),
        ((3.0, 1650.0), Verdict.MISSED, Verdict.MISSED),
    ],
)
def test_goals_of_interruption(
    interrupted: tuple[float, float], uniform: Verdict, chase: Verdict
) -> None:
    section = section_of({**GOOD, 'human, interrupted': interrupted})
    assert [c.verdict for c in about(section, 'Random ghosts:')] == [uniform]
    assert [c.verdict for c in about(section, 'Chasing ghosts:')] == [chase]


def test_state_that_interruption_makes_worse_misses_the_goal() -> None:
    assert about(section_of(GOOD), 'Exact models')[0].verdict is Verdict.MET
    assert about(section_of(GOOD, least=-0.1), 'Exact models')[0].verdict is Verdict.MISSED


def test_gain_of_stopping_options_is_told_by_game() -> None:
    more, less = (about(section_of(GOOD, gain=g), 'rarely') for g in (100.0, -5.0))
    assert [c.verdict for c in more] == [Verdict.AGREES] * 2
    assert [c.verdict for c in less] == [Verdict.DIFFERS] * 2
    assert CHASE.name in more[1].found


def test_curves_in_csv_are_those_that_are_drawn() -> None:
    section = section_of(GOOD)
    curves = next(t for t in section.tables if t.name == 'table2-curves')
    rows = list(csv.DictReader(io.StringIO(csv_text(curves))))
    assert len(section.pictures) == len(GAMES)
    for game, picture in zip(GAMES, section.pictures, strict=True):
        work = Drawing(*picture.size)
        picture.draw(work, str)
        for line in work.axes.get_lines():
            mine = [
                (float(row['seconds']) * (1e3 if game.exact else 1.0), float(row['mean return']))
                for row in rows
                if (row['game'], row['action set']) == (game.name, line.get_label())
            ]
            assert np.asarray(line.get_xydata()).tolist() == [list(pair) for pair in mine]
            assert len(mine) == 2


def test_every_kind_has_a_line_of_its_own() -> None:
    assert set(STYLES) == {kind.name for kind in KINDS}
    assert len(set(STYLES.values())) == len(KINDS)
