"""Table 2 again: real trials of small numbers, and what follows from known results."""

from dataclasses import asdict, replace
import json
import math

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.options.learned_option import options_from_references
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd
import pytest

from experiments import paper, table2, table2_plans
from experiments.people import BagLesson, MACHINE, NOBODY, PERSON, Study
from experiments.report import Comparison, Mark, Section
from experiments.table2_plans import (
    BY_CHANCE,
    CHASE,
    COLUMNS,
    Effort,
    GAMES,
    INTERRUPTED,
    PARTS,
    plan_from_samples,
    play_by_chance,
    SECONDS,
    TAXI,
    UNIFORM,
    VARIANTS,
)
from experiments.trials import Rows, Trial

NAMES = [game.name for game in GAMES]
TINY = Effort(largest=800, primitive_largest=1600, first=400, games=4)


def trial_of(domain: str, owner: str, seeds: int = 2) -> Trial:
    return next(
        trial
        for trial in table2.trials(Study(participants=1, seeds=seeds))
        if (trial.parameters['domain'], trial.parameters['owner']) == (domain, owner)
    )


def test_every_owner_makes_at_least_as_many_plans_as_seeds_where_options_were_taught() -> None:
    trials = table2.trials(Study(participants=4, seeds=10))
    assert len(trials) == 2 * 3 * 4
    assert {trial.parameters['plans'] for trial in trials} == {3}
    assert {variant.owner for variant in VARIANTS} == {NOBODY, PERSON, MACHINE}
    lesson = BagLesson('/bag', 'p1', 'avoid ghost', 'pacman', '{}', 'failures', 1, 'x')
    domains = {trial.parameters['domain'] for trial in table2.trials(Study(bags=(lesson,)))}
    assert domains == {'pacman'}


def test_person_plans_taxi_as_well_as_primitive_actions_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(table2_plans, 'REPEATS', 1)  # seconds are not compared
    human, primitive = (
        (trial := trial_of('taxi', owner)).compute(trial.parameters) for owner in (PERSON, NOBODY)
    )
    assert json.loads(json.dumps(human)) == human
    (best,) = [row for row in primitive if row['kind'] == 'plan']
    costs = {row['action set']: row for row in human if row['kind'] == 'cost'}
    assert costs['human']['demonstrations'] > 2
    for name in ('human', INTERRUPTED, 'human + primitive'):
        *_, last, plan = [row for row in human if row['action set'] == name]
        assert {**last, 'kind': 'plan'} == plan
        assert plan['done'] == best['done'] == 1.0
        assert plan['mean return'] == pytest.approx(best['mean return'], abs=0.5)
    _, by_chance, _ = [row for row in human if row['action set'] == BY_CHANCE]
    assert by_chance['mean return'] == pytest.approx(best['mean return'], abs=0.5)  # no choice
    assert by_chance[SECONDS] == by_chance['states'] == 0


def test_both_games_of_pacman_are_planned_with_budgets_that_double() -> None:
    effort = replace(TINY, games=2, primitive_largest=800)
    trial = trial_of('pacman', NOBODY, seeds=1)
    found = table2_plans.plan_all_games({**trial.parameters, 'effort': asdict(effort)})
    curve = [row for row in found if row['kind'] == 'curve']
    assert [(row['game'], row['budget']) for row in curve] == [
        (game.name, budget) for game in (UNIFORM, CHASE) for budget in (400, 800)
    ]
    assert all(row['game steps'] >= row['budget'] for row in curve)


def test_same_seed_gives_the_same_numbers_and_another_one_others() -> None:
    domain, effort = PacMan(maze='yard', max_steps=20), replace(TINY, primitive_largest=400)
    first, again, other = (
        pd.DataFrame(plan_from_samples(domain, VARIANTS[0], (), 1, effort, seed)).drop(
            columns=[SECONDS, *PARTS]
        )
        for seed in (1, 1, 2)
    )
    assert first.equals(again)
    assert not first.equals(other)


def test_random_choice_among_options_is_that_of_choices_by_hand() -> None:
    """
    With the two options that participants taught there is nothing to choose: -10.07 as the best.

    With no option every decision is a random move, and hardly any passenger is delivered.
    """
    taxi, rng = Taxi(), generator(3, 'by chance')
    references = reference_options(taxi)
    taught = options_from_references(taxi, [references[name] for name in paper.TAUGHT['taxi']])
    played = play_by_chance(taxi, taught, 0, rng)
    assert played.total.mean() == pytest.approx(-10.07)
    assert played.successes.all()
    assert set(played.decisions.tolist()) == {2}
    assert not played.fallbacks.any()
    moves = play_by_chance(taxi, [], 0, rng)
    assert np.array_equal(moves.fallbacks, moves.decisions)
    assert moves.successes.mean() < 0.5
    assert set(moves.steps[~moves.successes].tolist()) == {taxi.max_steps}
    assert moves.total.mean() < -100


Levels = dict[str, tuple[float, float]]
GOOD: Levels = {  # seconds and return by kind
    'primitive': (50.0, 1500.0),
    'human': (2.0, 1400.0),
    'automatic': (4.0, 700.0),
    INTERRUPTED: (3.0, 1950.0),
}


def section_of(level: Levels, spread: float = 0.0, **others: Levels) -> Section:
    """
    Return the section of results that are the same in all games but for some of them.

    :param spread: by how much the second member exceeds the first in all returns, and in the
        logarithm of its seconds.
    :param others: other levels of Taxi, random and chasing ghosts.
    """
    rows: Rows = []
    for game, key in zip(GAMES, ('taxi', 'random', 'chase')):
        for name, (seconds, mean) in {**level, **others.get(key, {})}.items():
            (variant,) = (variant for variant in VARIANTS if variant.name == name)
            known = {'domain': game.domain, 'action set': name, 'options': 4, 'demonstrations': 9}
            for member in range(2):
                more, trial = spread * member, f'{game.domain} {variant.owner} {member}'
                rows.append({'kind': 'cost', 'trial': trial, **known})
                for kind, part in (('curve', 2), ('curve', 1), ('plan', 1)):
                    row = {
                        'kind': kind,
                        'trial': trial,
                        'game': game.name,
                        'action set': name,
                        'budget': 3 - part,
                        **dict.fromkeys([*COLUMNS.values(), 'discounted', 'done'], 1.0),
                        SECONDS: seconds / part * math.exp(more),
                        'mean return': mean / part + more,
                    }
                    rows.append(row)
    return table2.present(pd.DataFrame(rows))


@pytest.fixture(scope='module')
def good() -> Section:
    """The section of results as one would wish."""
    return section_of(GOOD)


def about(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


def marks(section: Section, said: str) -> list[Mark]:
    return [c.mark for c in about(section, said)]


def test_the_gain_of_planning_over_random_choice_is_given() -> None:
    chance = dict(zip(('taxi', 'random', 'chase'), (1260.0, 1400.0, 1500.0)))
    section = section_of(GOOD, **{game: {BY_CHANCE: (0.0, n)} for game, n in chance.items()})
    assert marks(section, 'than random choice') == [Mark.MET, Mark.MISSED, Mark.MISSED]
    tables = [table for table in section.tables if table.title in NAMES]
    assert all(BY_CHANCE in table.frame['action set'].tolist() for table in tables)


def test_results_like_those_of_the_paper_agree(good: Section) -> None:
    for said in ('more efficient', 'with human options is faster', 'never do as well'):
        assert marks(good, said) == [Mark.AGREES] * 3
    exact, sampled, _ = (c.found for c in about(good, 'with human options is faster'))
    text = 'human / primitive 0.04 (0.04 to 0.04)'
    assert exact == f'Taxi: time, {text}'
    assert sampled.endswith(f'time until 1,400 points, {text}')
    faster = 'time until 700 points, human / automatic 0.25 (0.25 to 0.25)'
    assert faster in about(good, 'efficient')[1].found


def test_human_options_that_are_behind_in_time_or_return_do_not_agree() -> None:
    behind = dict(zip(('taxi', 'random', 'chase'), [(9.0, 1400.0), (2.0, 600.0), (9.0, 600.0)]))
    section = section_of(GOOD, **{game: {'human': human} for game, human in behind.items()})
    assert marks(section, 'more efficient') == [Mark.DIFFERS] * 3


def test_differences_within_the_intervals_are_not_distinguishable() -> None:
    """The two members of each kind differ by 1: in seconds 2.7 times, and one point of return."""
    near = {'primitive': (3.0, 10.3), 'human': (2.0, 10.0), 'automatic': (4.0, 9.7)}
    section = section_of(near, spread=1.0)
    others = [c for c in section.comparisons if 'it was not in Pac-Man' not in c.said]
    assert {c.mark for c in others if c.where != 'table 2'} == {Mark.UNDECIDED}
    (found, *_) = about(section, 'never do as well')
    # Welch: a standard error of sqrt(0.5), t(0.975, 2) = 4.303
    assert 'primitive less human 0.3 (-2.742 to 3.342)' in found.found


def test_the_same_people_are_compared_within_each() -> None:
    """People differ by 40 points, and each gets 550 more with interruption."""
    found = about(section_of(GOOD, spread=40.0), 'rarely')
    assert [c.mark for c in found] == [Mark.AGREES] * 2  # with either kind of ghosts
    assert all('less human 550 (550 to 550)' in c.found for c in found)


@pytest.mark.parametrize(
    ('taxi', 'pacman', 'mark'), [(0.0, 0.0, Mark.AGREES), (-0.1, 0.1, Mark.DIFFERS)]
)
def test_every_number_of_the_papers_table_is_compared_or_it_is_said_why_not(
    taxi: float, pacman: float, mark: Mark
) -> None:
    """The interval of results that are all alike holds one number only."""
    section = section_of(
        GOOD,
        taxi={'human': (50.0 * 10.45 / 17.45 + taxi, 1400.0)},
        random={'human': (50.0 * 60.45 / 600.0 + pacman, 1400.0)},
    )
    found = {c.said: c for c in section.comparisons if c.where == 'table 2'}
    assert len(found) == 2 * len(paper.TABLE_2) * len(paper.TABLE_2['taxi'])
    for said in ('Taxi, human: 10.45 s, 0.599', 'Pac-Man, human: 60.45 s, 0.101'):
        assert found[f'{said} of the time of primitive actions.'].mark is mark
    others = {c.mark for name, c in found.items() if 'of the time' not in name}
    assert others == {Mark.NOT_COMPARABLE}
    assert 'neither maze nor points' in found['Pac-Man, primitive: average reward 1,890.'].found


def test_tables_and_curves_hold_the_same_numbers(good: Section) -> None:
    tables = {table.name: table.rows for table in good.tables}
    row = tables['table2-paper'][1]
    known = row["paper's seconds"], row["paper's average reward"], row['mean return']
    assert known == (10.45, -4.294, 1400.0)
    assert len(good.pictures) == len(GAMES)
    for game, picture in zip(GAMES, good.pictures, strict=True):
        work = Drawing(*picture.size)
        picture.draw(work)
        lines = work.axes.get_lines()
        assert [line.get_label() for line in lines] == [v.name for v in VARIANTS if v.name in GOOD]
        for line in lines:
            mine = [
                [row[SECONDS] * (1e3 if game.exact else 1.0), row['mean return']]
                for row in tables['table2-curves']
                if (row['game'], row['action set']) == (game.name, line.get_label())
            ]
            assert np.asarray(line.get_xydata()).tolist() == mine
            assert len(mine) == 2
    assert TAXI.name in tables['table2-curves'][0].values()
