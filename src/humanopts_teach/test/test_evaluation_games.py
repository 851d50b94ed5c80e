"""Policies compared in many games of Pac-Man, and the report on them."""

from dataclasses import replace
import json
import re

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.baselines import PAPER_OPTIONS
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options as rooms_references
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import LearnedOption, options_from_references
from humanopts_learner.planning.request import HUMAN, PlanCanceled, PlanError, PlanRequest
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, evaluate
from humanopts_teach.evaluation.games import (
    Baseline,
    carried_over,
    evaluate_games,
    every_baseline,
    gains,
    games_to_dict,
    PLAN,
    play_baseline,
    RULE,
    RULE_NAME,
)
from humanopts_teach.evaluation.settings import EvaluationSettings
from humanopts_teach.evaluation.tables import rows_of
from humanopts_teach.evaluation.text import games_text
from humanopts_teach.report.episode import episode_strip, Frame, MAX_PICTURES
from humanopts_teach.report.findings import findings
from humanopts_teach.report.write import render_report, ReportData
import numpy as np
from numpy.typing import NDArray
import pandas as pd
import pytest

pytestmark = pytest.mark.heavy

GAMES, SEED, STEPS, FEW = 20, 5, 4_992, 500
POLICIES = {  # of the yard, where four options were taught: kind, and number of options
    'human, 3 options': ('plan', 3),
    'human, 4 options': ('plan', 4),
    'human, 4 options, interrupted, 4-fold steps': ('plan', 4),
    'primitive': ('plan', 0),
    'random choice, 4 options': ('chance', 4),
    RULE_NAME: ('rule', 0),
}


@pytest.fixture(scope='module')
def brief() -> Domain:
    """The same game, which is over after a few steps."""
    return make_domain('pacman', {'maze': 'yard', 'max_steps': 15})


@pytest.fixture(scope='module')
def evaluation(yard: Domain, yard_lesson: list[Demonstration]) -> BagEvaluation:
    """Four options, taught a little."""
    return evaluate(
        yard_lesson, yard, EvaluationSettings(seed=SEED, game_steps=STEPS), episodes=GAMES
    )


@pytest.fixture(scope='module')
def options(evaluation: BagEvaluation) -> list[LearnedOption]:
    """These options."""
    return [each.option for each in evaluation.options]


@pytest.fixture(scope='module')
def reported() -> list[tuple[str, float]]:
    """The progress that was reported."""
    return []


@pytest.fixture(scope='module')
def games(
    brief: Domain, options: list[LearnedOption], reported: list[tuple[str, float]]
) -> pd.DataFrame:
    """The results of all policies, from two processes."""
    return evaluate_games(
        *(brief, options, SEED, GAMES, FEW),
        progress=lambda done, total, text: reported.append((text, done / total)),
        jobs=2,
    )


def test_plans_of_a_bag_are_sampled_and_judged(evaluation: BagEvaluation) -> None:
    assert evaluation.warnings == ()
    plans = evaluation.plan_table
    assert [*plans.index] == ['human', 'primitive']
    assert (plans[['episodes', 'game_steps']] == [GAMES, STEPS]).all(axis=None)
    assert (plans['mean_return_low'] < plans['mean_return']).all()
    assert all(set(outcomes) == {'cleared', 'lives left'} for outcomes in plans['outcomes'])
    said = 'The plan with the action set human, from'
    (human,) = [f.text for f in findings(evaluation) if f.text.startswith(said)]
    assert f'from {STEPS:,} game steps' in human
    assert f'in {GAMES} games' in human


def test_a_plan_of_a_bag_has_the_row_that_it_would_have_if_it_were_made_again(
    yard: Domain, evaluation: BagEvaluation, options: list[LearnedOption]
) -> None:
    human = evaluation.plans['human']
    baseline = Baseline('', PLAN, options, PlanRequest(HUMAN, game_steps=STEPS))
    known = play_baseline(yard, baseline, SEED, GAMES, (human.plan, human.judged))
    again = play_baseline(yard, baseline, SEED, GAMES)
    assert np.array_equal(known.pop('scores'), again.pop('scores'))
    assert {**known, 'seconds': 0.0} == {**again, 'seconds': 0.0}


def test_the_papers_and_our_policies_play_in_both_settings(
    games: pd.DataFrame, reported: list[tuple[str, float]]
) -> None:
    assert [*games['setting'].unique()] == ['ghosts=random', 'ghosts=chase']
    for _, rows in games.groupby('setting'):
        kinds = zip(rows['kind'], rows['options'].map(len))
        assert dict(zip(rows['name'], kinds, strict=True)) == POLICIES
    three = games['options'][games['name'] == 'human, 3 options']
    assert all(names == list(PAPER_OPTIONS) for names in three)
    assert set(games['games']) == {GAMES}
    shares = [share for _, share in reported]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert 'ghosts=chase: human, 3 options' in {what for what, _ in reported}


def test_a_policy_has_the_row_that_another_process_gives(
    brief: Domain, options: list[LearnedOption], games: pd.DataFrame
) -> None:
    chase = make_domain('pacman', {**brief.parameters, 'ghosts': 'chase'})
    scores = games.set_index(['setting', 'name'])['scores']
    for baseline in every_baseline(chase, options, FEW)[::2]:
        again = play_baseline(chase, baseline, SEED, GAMES)['scores']
        assert np.array_equal(again, scores['ghosts=chase', baseline.name])


def test_a_watcher_can_end_it(brief: Domain, options: list[LearnedOption]) -> None:
    reported: list[float] = []

    def stop(done: float, total: float, text: str) -> None:
        reported.append(done)
        if done:
            raise PlanCanceled

    with pytest.raises(PlanCanceled):
        evaluate_games(brief, options, SEED, 2, FEW, stop, jobs=1)
    assert reported == [0, 1]


def test_plans_are_compared_with_chance_and_the_rule_game_by_game(games: pd.DataFrame) -> None:
    values = json.loads(json.dumps(games_to_dict(games), allow_nan=False))
    assert [row['score'] for row in values['rows']] == games['scores'].map(np.mean).tolist()
    text = '\n'.join(games_text(games))
    assert all(name in text for name in (*POLICIES, 'ghosts=random', 'ghosts=chase'))
    pairs = [
        ('human, 4 options', 'random choice, 4 options'),
        ('human, 4 options, interrupted, 4-fold steps', RULE_NAME),
    ]
    assert [(row['name'], row['less']) for row in values['gains']] == pairs * 2
    scores = games.set_index(['setting', 'name'])['scores']
    for row in rows_of(gains(games)):
        one, other = (scores[row.setting, name] for name in (row.name, row.less))
        assert Interval(row.mean, row.low, row.high) == Interval.of(one - other)
        assert f'{row.name} less {row.less}, game by game: ' in text


@pytest.mark.parametrize(
    ('gain', 'good', 'words'),
    [
        (100.0 + np.arange(GAMES), True, 'more than “random choice'),
        (np.arange(GAMES) - 9.5, None, 'not distinguishable from “random choice'),
        (-np.arange(GAMES), False, 'less than “random choice'),
    ],
)
def test_the_gain_over_random_choice_is_that_within_games(
    evaluation: BagEvaluation,
    games: pd.DataFrame,
    gain: NDArray[np.float64],
    good: bool | None,
    words: str,
) -> None:
    """Games differ by far more."""
    luck = 1000.0 * np.arange(GAMES)
    scores = [luck + gain * (name == 'human, 4 options') for name in games['name']]
    changed = games.assign(scores=pd.Series(scores))
    found = findings(replace(evaluation, games={'p1': changed}))
    (one,) = [f for f in found if 'ghosts=random' in f.text and 'random choice' in f.text]
    assert (one.good, words in one.text) == (good, True), one.text


def test_the_report_shows_the_games_and_says_what_is_estimated(
    evaluation: BagEvaluation, games: pd.DataFrame
) -> None:
    first = evaluation.options[0]
    brief = replace(evaluation, options=(replace(first, learning=first.learning[-1:]),))
    page = render_report(ReportData('x', replace(brief, games={'p1': games})))
    section = page[page.index('<h2 id="games">') : page.index('<h2 id="planning">')]
    assert section.count('<svg') == 2  # score, cleared
    assert 'estimates' in section
    for name in POLICIES:
        row = section[section.index(f'<th>{name}</th>') :].partition('</tr>')[0]
        cells = re.findall(r'<td class="n">([^<]*)<', row)
        means = games['score'][games['name'] == name]
        assert [cells[0], cells[4]] == [f'{mean:,.0f}' for mean in means]
        assert not re.search(r'>-0(\.00)? ', row)
    assert 'id="boards"' not in page
    assert 'Sweep by sweep' not in page


def test_options_go_along_to_other_parameters_but_not_to_other_features() -> None:
    """Only a domain with a rule plays by it."""
    option = options_from_references(Rooms(), rooms_references(Rooms()).values())[0]
    other = Rooms(goal='G2')
    assert option.domain_parameters != parameters_json(other)
    carried_over(option, other).check_domain(other)
    with pytest.raises(PlanError):
        carried_over(option, PacMan())
    with pytest.raises(PlanError, match='rooms has no hand-written rule'):
        play_baseline(Rooms(), Baseline('rule', RULE), 1)


def test_a_long_episode_is_shown_by_the_ends_of_runs(yard: Domain) -> None:
    """Runs of three steps, each worth 3 points."""
    state = yard.encode(yard.sample_states(generator(1, 'film'), 1)[0])
    steps = [
        Frame(state, 'north', 1.0, 'a' if step % 6 < 3 else 'b', ends_run=step % 3 == 2)
        for step in range(300)
    ]
    strip = episode_strip(yard, [Frame(state), *steps])
    assert (strip.whole, strip.steps) == (False, 300)
    assert len(strip.pictures) == MAX_PICTURES
    assert strip.omitted == 101 - MAX_PICTURES
    assert [picture.number for picture in strip.pictures][:3] == [0, 3, 6]
    assert strip.pictures[-1].number == 300
    assert (strip.pictures[1].action, strip.pictures[1].reward) == ('3 steps', '+3')
    short = episode_strip(yard, [Frame(state), *steps[:20]])
    assert short.whole
    assert len(short.pictures) == 21

    wide = make_domain('pacman')
    start = wide.encode(wide.reset(generator(1, 'film')))
    assert episode_strip(wide, [Frame(start)]).width > 15.0 > short.width
