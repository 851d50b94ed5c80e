"""Table 2 again: real trials of small numbers, and what is said of results that are known."""

from collections.abc import Mapping
from dataclasses import asdict, replace
import json
import math
from typing import Any

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.options.learned_option import options_from_references
from humanopts_teach.report.figures import Drawing
import numpy as np
import pytest

from experiments import paper, table2, table2_plans
from experiments.people import BagLesson, NOBODY, PERSON, Study
from experiments.report import Comparison, Done, Mark, Section
from experiments.table2 import present
from experiments.table2_plans import (
    BY_CHANCE,
    CHASE,
    Effort,
    GAMES,
    plan_from_samples,
    play_states_by_chance,
    SECONDS,
    TAXI,
    UNIFORM,
    VARIANTS,
)
from experiments.trials import Trial

NAMES = [game.name for game in GAMES]
TINY = Effort(largest=800, primitive_largest=1600, first=400, games=4)


def without_seconds(value: Any) -> Any:
    """Return JSON data without what a clock said."""
    if isinstance(value, Mapping):
        return {k: without_seconds(v) for k, v in value.items() if k not in SECONDS}
    return [without_seconds(v) for v in value] if isinstance(value, list) else value


def trial_of(domain: str, whose: str, seeds: int = 2) -> Trial:
    return next(
        trial
        for trial in table2.trials(Study(participants=1, seeds=seeds))
        if (trial.parameters['domain'], trial.parameters['whose']) == (domain, whose)
    )


def test_every_variant_is_planned_with_at_least_as_many_plans_as_seeds() -> None:
    trials = table2.trials(Study(participants=4, seeds=10))
    for game in GAMES:
        for variant in VARIANTS:
            mine = [
                t.parameters['plans']
                for t in trials
                if (t.parameters['domain'], t.parameters['whose']) == (game.domain, variant.whose)
            ]
            assert mine == [3] * 4
    assert len({trial.key for trial in trials}) == len(trials)


def test_domains_that_nobody_in_the_bags_taught_are_left_out() -> None:
    lesson = BagLesson('/bag', 'p1', 'avoid ghost', 'pacman', '{}', 'failures', 1, 'x')
    domains = {trial.parameters['domain'] for trial in table2.trials(Study(bags=(lesson,)))}
    assert domains == {'pacman'}


def test_person_plans_taxi_as_well_as_primitive_actions_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(table2_plans, 'REPEATS', 1)  # seconds are not compared
    human, primitive = (
        (trial := trial_of('taxi', whose)).compute(trial.parameters) for whose in (PERSON, NOBODY)
    )
    (best, _) = primitive['plans']
    assert json.loads(json.dumps(human)) == human
    costs = {row['action set']: row for row in human['costs']}
    assert costs['human']['demonstrations'] > 2
    for name in ('human', 'human, interrupted', 'human + primitive'):
        plans, curve = (
            [row for row in human[table] if row['action set'] == name]
            for table in ('plans', 'curve')
        )
        assert len(plans) == 2
        assert plans[0]['done'] == best['done'] == 1.0
        assert plans[0]['mean'] == pytest.approx(best['mean'], abs=0.5)
        assert curve[-1]['mean'] == plans[0]['mean']
    (by_chance, _) = [row for row in human['plans'] if row['action set'] == BY_CHANCE]
    assert by_chance['mean'] == pytest.approx(best['mean'], abs=0.5)  # one option can start
    assert sum(by_chance[name] for name in SECONDS) == by_chance['states'] == 0


def test_both_games_of_pacman_are_planned_with_budgets_that_double() -> None:
    effort = replace(TINY, games=2, primitive_largest=800)
    trial = trial_of('pacman', NOBODY, seeds=1)
    found = table2_plans.plan_all_games({**trial.parameters, 'effort': asdict(effort)})
    assert [(row['game'], row['budget']) for row in found['curve']] == [
        (game.name, budget) for game in (UNIFORM, CHASE) for budget in (400, 800)
    ]
    assert all(row['game_steps'] >= row['budget'] for row in found['curve'])


def test_same_seed_gives_the_same_numbers_and_another_one_others() -> None:
    domain, effort = PacMan(maze='yard', max_steps=20), replace(TINY, primitive_largest=400)
    first, again, other = (
        without_seconds(plan_from_samples(domain, VARIANTS[0], (), 1, effort, seed))
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_random_choice_among_options_is_that_of_choices_by_hand() -> None:
    """
    With the two options that participants taught there is nothing to choose: -10.07 as the best.

    With no option every decision is a random move, and hardly any passenger is delivered.
    """
    taxi, rng = Taxi(), generator(3, 'by chance')
    references = reference_options(taxi)
    taught = options_from_references(taxi, [references[name] for name in paper.TAUGHT['taxi']])
    played = play_states_by_chance(taxi, taught, rng)
    assert played.total.mean() == pytest.approx(-10.07)
    assert played.successes.all()
    assert set(played.decisions.tolist()) == {2}
    assert not played.fallbacks.any()
    moves = play_states_by_chance(taxi, [], rng)
    assert np.array_equal(moves.fallbacks, moves.decisions)
    assert moves.successes.mean() < 0.5
    assert set(moves.steps[~moves.successes].tolist()) == {taxi.max_steps}
    assert moves.total.mean() < -100


def test_what_planning_gains_over_random_choice_is_said() -> None:
    chance = dict(zip(NAMES, (1260.0, 1400.0, 1500.0), strict=True))
    by_game = {game: {BY_CHANCE: (0.0, mean)} for game, mean in chance.items()}
    section = section_of(GOOD, others=by_game)
    found = about(section, 'than random choice')
    assert [c.mark for c in found] == [Mark.MET, Mark.MISSED, Mark.MISSED]
    for one, mean in zip(found, chance.values(), strict=True):
        assert f'random choice has {mean / 1400:.0%}' in one.found
    tables = [table for table in section.tables if table.title in NAMES]
    assert all(BY_CHANCE in table.frame['action set'].tolist() for table in tables)


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


Levels = Mapping[str, tuple[float, float]]


def section_of(
    level: Levels, spread: float = 0.0, others: Mapping[str, Levels] | None = None
) -> Section:
    """
    Return the section of results that are the same in all games but for some of them.

    :param spread: how much more than the first the second of two members has of all returns, and
        of the logarithm of its seconds.
    :param others: levels of some games that are not those of all.
    """
    levels = {name: {**level, **(others or {}).get(name, {})} for name in NAMES}

    def result(trial: Trial, more: float) -> dict[str, Any]:
        whose, domain = trial.parameters['whose'], trial.parameters['domain']
        games = [game.name for game in GAMES if game.domain == domain]
        mine = {variant.name for variant in VARIANTS if variant.whose == whose}
        curve = [
            {'game': game, 'action set': name}
            | plan(mean / part + more, seconds / part * math.exp(more), 3 - part)
            for game in games
            for name, (seconds, mean) in levels[game].items()
            for part in (2, 1)
            if name in mine
        ]
        names = ('options', 'demonstrations', 'minutes', 'seconds', 'game_steps')
        return {
            'curve': curve,
            'plans': [row for row in curve if row['budget'] == 2],
            'costs': [
                {'action set': name, **dict.fromkeys(names, 4)} for name in level if name in mine
            ],
        }

    trials = table2.trials(Study(participants=2, seeds=2))
    done: Done = [
        (trial.parameters, result(trial, spread * (number % 2)))
        for number, trial in enumerate(trials)
    ]
    return present(done)


@pytest.fixture(scope='module')
def good() -> Section:
    """The section of results as one would wish."""
    return section_of(GOOD)


def about(section: Section, said: str) -> list[Comparison]:
    return [c for c in section.comparisons if said in c.said]


def test_what_is_as_in_the_paper_agrees(good: Section) -> None:
    for said in ('more efficient', 'with human options is faster', 'never as good'):
        assert [c.mark for c in about(good, said)] == [Mark.AGREES] * 3
    exact, sampled, _ = (c.found for c in about(good, 'with human options is faster'))
    text = 'human / primitive 0.04 (0.04 to 0.04)'
    assert exact == f'Taxi: time, {text}'
    assert sampled.endswith(f'time until 1,400 points, {text}')
    faster = 'time until 700 points, human / automatic 0.25 (0.25 to 0.25)'
    assert faster in about(good, 'efficient')[1].found


def test_human_options_that_are_behind_in_time_or_return_do_not_agree() -> None:
    behind = zip(NAMES, [(9.0, 1400.0), (2.0, 600.0), (9.0, 600.0)], strict=True)
    section = section_of(GOOD, others={game: {'human': human} for game, human in behind})
    assert [c.mark for c in about(section, 'more efficient')] == [Mark.DIFFERS] * 3


def test_what_lies_within_the_intervals_is_not_distinguishable() -> None:
    """The two members of each kind differ by 1: in seconds 2.7 times, and one point of return."""
    near = {'primitive': (3.0, 10.3), 'human': (2.0, 10.0), 'automatic': (4.0, 9.7)}
    section = section_of(near, spread=1.0)
    others = [c for c in section.comparisons if 'it was not in Pac-Man' not in c.said]
    assert {c.mark for c in others if c.where != 'table 2'} == {Mark.UNDECIDED}
    (found, *_) = about(section, 'never as good')
    # Welch: a standard error of sqrt(0.5), t(0.975, 2) = 4.303
    assert 'primitive less human 0.3 (-2.742 to 3.342)' in found.found


def test_the_same_people_are_compared_within_each() -> None:
    """People differ by 40 points, and each gets 550 to 551 more with interruption."""
    section = section_of(GOOD, spread=40.0)
    for found in about(section, 'rarely'):
        assert found.mark is Mark.AGREES
        assert 'less human 550 (550 to 550)' in found.found
    assert len(about(section, 'rarely')) == 2  # with either kind of ghosts


def test_numbers_of_the_paper_stand_beside_ours(good: Section) -> None:
    table = next(t for t in good.tables if t.name == 'table2-paper')
    assert table.rows[1]["paper's average reward"] == -4.294
    assert table.rows[1]["paper's seconds"] == 10.45
    assert table.rows[1]['mean return'] == 1400.0


@pytest.mark.parametrize(
    ('taxi', 'pacman', 'mark'), [(0.0, 0.0, Mark.AGREES), (-0.1, 0.1, Mark.DIFFERS)]
)
def test_every_number_of_the_papers_table_is_compared_or_it_is_said_why_not(
    taxi: float, pacman: float, mark: Mark
) -> None:
    """The interval of results that are all alike holds one number only; seconds are off by so."""
    by_game = {
        TAXI.name: {'human': (50.0 * 10.45 / 17.45 + taxi, 1400.0)},
        UNIFORM.name: {'human': (50.0 * 60.45 / 600.0 + pacman, 1400.0)},
    }
    section = section_of(GOOD, others=by_game)
    found = {c.said: c for c in section.comparisons if c.where == 'table 2'}
    assert len(found) == 2 * len(paper.TABLE_2) * len(paper.TABLE_2['taxi'])
    for said in ('Taxi, human: 10.45 s, 0.599', 'Pac-Man, human: 60.45 s, 0.101'):
        assert found[f'{said} of the time of primitive actions.'].mark is mark
    others = {c.mark for name, c in found.items() if 'of the time' not in name}
    assert others == {Mark.NOT_COMPARABLE}
    assert 'neither maze nor points' in found['Pac-Man, primitive: average reward 1,890.'].found


def test_curves_in_the_table_are_those_that_are_drawn(good: Section) -> None:
    rows = next(t for t in good.tables if t.name == 'table2-curves').rows
    assert len(good.pictures) == len(GAMES)
    for game, picture in zip(GAMES, good.pictures, strict=True):
        work = Drawing(*picture.size)
        picture.draw(work)
        lines = work.axes.get_lines()
        assert {line.get_label() for line in lines} == set(GOOD)
        for line in lines:
            mine = [
                [row['seconds'] * (1e3 if game.exact else 1.0), row['mean return']]
                for row in rows
                if (row['game'], row['action set']) == (game.name, line.get_label())
            ]
            assert np.asarray(line.get_xydata()).tolist() == mine
            assert len(mine) == 2
