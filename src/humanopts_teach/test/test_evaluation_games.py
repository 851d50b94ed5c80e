"""Taught options in many games of Pac-Man, and the report of what came out."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
import json
from multiprocessing import get_context
import re
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.baselines import NAMED_OPTIONS, PAPER_OPTIONS
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.intervals import Interval
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import HUMAN, PlanCanceled, PRIMITIVE
from humanopts_learner.planning.sampled.plan import SampledPlan
from humanopts_teach.evaluation import games as evaluation_games
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate,
)
from humanopts_teach.evaluation.games import (
    Baseline,
    ComparisonRow,
    Curve,
    CurveRow,
    earlier_calls,
    evaluate_games,
    every_baseline,
    GamesEvaluation,
    HEURISTIC,
    judged_plan,
    option_sets,
    PLAN,
    play_baseline,
    RANDOM,
)
from humanopts_teach.evaluation.measures import Settings
from humanopts_teach.evaluation.text import games_text
from humanopts_teach.report.episode import episode_strip, Frame, MOST_PICTURES
from humanopts_teach.report.findings import findings, games_findings
from humanopts_teach.report.pages import Finding
from humanopts_teach.report.write import render_report, ReportData
import numpy as np
from numpy.typing import NDArray
import pytest

pytestmark = pytest.mark.heavy

GAMES, SEED, STEPS = 20, 5, 4_992
SMALL = (500, 1_000)  # budgets that are far too small to play well


@pytest.fixture(scope='module')
def brief() -> Domain[Any]:
    """The same game, which is over after a few steps."""
    return make_domain('pacman', {'maze': 'yard', 'max_steps': 15})


@pytest.fixture(scope='module')
def evaluation(yard: Domain[Any], yard_lesson: list[Demonstration]) -> BagEvaluation:
    """Four options, taught a little."""
    return evaluate(yard_lesson, yard, Settings(seed=SEED, game_steps=STEPS), episodes=GAMES)


@pytest.fixture(scope='module')
def options(evaluation: BagEvaluation) -> list[LearnedOption]:
    """These options."""
    return [entry.last.option for entry in evaluation.options]


@pytest.fixture(scope='module')
def told() -> list[tuple[str, float]]:
    """What was said meanwhile."""
    return []


@pytest.fixture(scope='module')
def played() -> list[Baseline]:
    """The ways to play that were played once options were there."""
    return []


@pytest.fixture(scope='module')
def games(
    brief: Domain[Any],
    options: list[LearnedOption],
    told: list[tuple[str, float]],
    played: list[Baseline],
) -> GamesEvaluation:
    """What they came to; what needs no options was played before."""
    calls = earlier_calls(brief, (), SEED, GAMES, SMALL[0], SMALL)

    def play(domain: Domain[Any], way: Baseline, *numbers: int) -> ComparisonRow:
        played.append(way)
        return play_baseline(domain, way, *numbers)

    known = {key: call() for key, call in calls.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation_games, 'play_baseline', play)
        return evaluate_games(
            *(brief, options, SEED, GAMES, SMALL[0]),
            budgets=SMALL,
            progress=lambda done, total, text: told.append((text, done / total)),
            jobs=1,
            known=known,
        )


def test_plans_of_a_bag_are_sampled_and_judged(evaluation: BagEvaluation) -> None:
    assert evaluation.warnings == ()
    human, primitive = evaluation.planning
    assert (human.action_set, primitive.action_set) == (HUMAN, PRIMITIVE)
    for row in evaluation.planning:
        assert (row.episodes, row.game_steps) == (GAMES, STEPS)
        assert row.mean_return is not None
        assert row.mean_return_low is not None
        assert row.mean_return_low < row.mean_return
        assert set(row.outcomes) == {'cleared', 'lives left'}


def test_a_plan_of_a_bag_has_the_row_that_it_would_have_if_it_were_made_again(
    yard: Domain[Any], evaluation: BagEvaluation, options: list[LearnedOption]
) -> None:
    human = evaluation.plans[0]
    assert isinstance(human.plan, SampledPlan)
    _, row = judged_plan(human.plan, human.judged, SEED)
    again = play_baseline(yard, Baseline('', PLAN, HUMAN, options, STEPS), SEED, GAMES)
    assert replace(row, seconds=None) == replace(again, seconds=None)
    assert np.array_equal(row.scores, again.scores)


def test_three_options_are_those_of_the_paper(options: list[LearnedOption]) -> None:
    named = [PAPER_OPTIONS, NAMED_OPTIONS]
    three, four = option_sets(options, named).values()
    assert [option.name for option in three] == list(PAPER_OPTIONS)
    assert [option.name for option in four] == [*PAPER_OPTIONS, 'eat the ghost']
    assert list(option_sets(three, named)) == ['3 options']
    five = [*four, replace(four[0], name='go to the fruit')]
    assert option_sets(five, named) == {'3 options': three, '4 options': four, '5 options': five}


def test_every_action_set_and_baseline_plays_in_both_settings(games: GamesEvaluation) -> None:
    assert [setting.name for setting in games.settings] == ['ghosts=random', 'ghosts=chase']
    for setting in games.settings:
        kinds = [(row.kind, len(row.options)) for row in setting.rows]
        assert kinds == [
            *((PLAN, count) for count in (3, 4)),
            *((PLAN, count) for count in (3, 4, 4, 4)),  # interrupted
            *((PLAN, 0), (PLAN, 0)),
            *((RANDOM, count) for count in (0, 3, 4)),
            *((HEURISTIC, 0), (HEURISTIC, 0)),
        ]
        assert {row.games for row in setting.rows} == {GAMES}


def test_both_sides_of_the_curve_have_the_same_budgets(games: GamesEvaluation) -> None:
    assert games.targets == ()  # nothing is known of this maze
    assert games.curve_setting == 'ghosts=random'
    options, primitive = games.curves
    assert [row.budget_steps for row in options.rows] == [500, 1_000]
    assert [row.budget_steps for row in primitive.rows][:1] == [500]
    assert options.rows[0].score == games.settings[0].rows[1].score


def test_progress_rises_to_the_end(games: GamesEvaluation, told: list[tuple[str, float]]) -> None:
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert {'ghosts=chase: human, 3 options'} <= {what for what, _ in told}


def test_each_way_to_play_has_the_row_that_another_process_gives(
    brief: Domain[Any], options: list[LearnedOption], games: GamesEvaluation
) -> None:
    """Every third: plans with options, interrupted, and without any, chance, and a rule."""
    chase = make_domain('pacman', {**brief.parameters, 'ghosts': 'chase'})
    ways = every_baseline(chase, options, SMALL[0])[::3]
    assert [way.kind for way in ways] == [PLAN, PLAN, PLAN, RANDOM, HEURISTIC]
    calls = [partial(play_baseline, chase, way, SEED, GAMES) for way in ways]
    with ProcessPoolExecutor(1, get_context('fork')) as other:
        again = [answer.result() for answer in [other.submit(call) for call in calls]]
    assert [(row.name, row.score, row.outcomes) for row in again] == [
        (row.name, row.score, row.outcomes) for row in games.settings[1].rows[::3]
    ]


def test_what_needs_no_options_can_be_played_before_any_is_taught(
    games: GamesEvaluation, played: list[Baseline]
) -> None:
    assert games.settings
    assert played
    assert all(way.options for way in played)


def test_what_was_played_with_the_same_options_is_not_played_again(
    brief: Domain[Any],
    options: list[LearnedOption],
    games: GamesEvaluation,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Read again from their files they are the same; of another length they are others."""
    any_plan = games.settings[0].rows[0]
    played: list[Baseline] = []

    def play(domain: Domain[Any], way: Baseline, *numbers: int) -> ComparisonRow:
        played.append(way)
        return any_plan

    monkeypatch.setattr(evaluation_games, 'play_baseline', play)
    calls = earlier_calls(brief, options, SEED, 2, SMALL[0], SMALL)
    known = {key: call() for key, call in calls.items()}
    assert played
    assert all(way.needs_options for way in played)
    again = [option_from_json(option_to_json(option))[0] for option in options]
    longer = [replace(option, max_steps=option.max_steps + 1) for option in options]
    for others, is_played in ((again, False), (longer, True)):
        played.clear()
        evaluate_games(brief, others, SEED, 2, SMALL[0], SMALL, jobs=1, known=known)
        of_no_curve = [way for way in played if way.kind == RANDOM and way.needs_options]
        assert bool(of_no_curve) is is_played


def test_what_plays_alike_plays_once(
    brief: Domain[Any],
    options: list[LearnedOption],
    games: GamesEvaluation,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    played: list[tuple[object, ...]] = []
    any_plan = games.settings[0].rows[0]

    def play(domain: Domain[Any], way: Baseline, *numbers: int) -> ComparisonRow:
        if way.action_set == PRIMITIVE and way.kind == PLAN:
            played.append((domain.parameters['ghosts'], way.budget_steps))
        return any_plan

    monkeypatch.setattr(evaluation_games, 'play_baseline', play)
    evaluate_games(brief, options, SEED, 2, SMALL[0], SMALL, jobs=1)
    budgets = sorted(budget for ghosts, budget in played if ghosts == 'random')
    assert budgets == [500, 1_000, 2_000]  # the curve's first two, the others' 500 and 2,000


def test_whoever_watches_can_end_it(brief: Domain[Any], options: list[LearnedOption]) -> None:
    told: list[float] = []

    def stop(done: float, total: float, text: str) -> None:
        told.append(done)
        if done:
            raise PlanCanceled

    with pytest.raises(PlanCanceled):
        evaluate_games(brief, options, SEED, 2, SMALL[0], SMALL, progress=stop, jobs=1)
    assert told == [0, 1]


def test_json_and_text_hold_every_number(games: GamesEvaluation) -> None:
    values = json.loads(json.dumps(games.to_dict(), allow_nan=False))
    assert [s['rows'][0]['score']['mean'] for s in values['settings']] == [
        setting.rows[0].score.mean for setting in games.settings
    ]
    for setting, plain in zip(games.settings, values['settings'], strict=True):
        gain = setting.largest(PLAN).scores - setting.largest(RANDOM).scores
        assert plain['gain_over_chance']['mean'] == gain.mean()
        assert not any('scores' in row for row in plain['rows'])
    text = '\n'.join(games_text(games))
    for setting in games.settings:
        assert setting.name in text
        assert all(row.name in text for row in setting.rows)


def test_the_best_plan_is_compared_with_the_best_rule_by_the_wider_interval(
    games: GamesEvaluation,
) -> None:
    for setting, plain in zip(games.settings, games.to_dict()['settings'], strict=True):
        assert setting.over_rule is not None
        plan, rule, more = setting.over_rule
        assert f'{plan.name} less {rule.name}, game by game: ' in '\n'.join(games_text(games))
        assert plain['over_rule']['mean'] == more.mean == (plan.scores - rule.scores).mean()
        alone = Interval.of_difference(plan.scores, rule.scores)
        assert more.low < alone.low < alone.high < more.high


def curve(name: str, *rows: tuple[float, float]) -> Curve:
    """Return a curve of planning seconds and lower bounds of scores."""
    return Curve(
        name,
        tuple(
            CurveRow(name, 1000, seconds, Interval(low + 5, low, low + 10), 10)
            for seconds, low in rows
        ),
    )


@pytest.mark.parametrize(
    ('human', 'primitive', 'good', 'words'),
    [
        ([(1, 1801)], [(5, 1000), (12, 1700)], True, 'more than 12 times as long.'),
        ([(1, 1801)], [(5, 1000), (12, 1795)], None, 'more than 5 times as long; whether'),
        ([(2, 1801)], [(5, 1000), (12, 1700)], None, 'is not decided'),
        (
            [(1, 1700), (2, 1801)],
            [(5, 1000), (8, 1805)],
            False,
            ': 4 times as long (at least 2.5, at most 8)',
        ),
        ([(1, 1700), (2, 1801)], [(22, 1000), (40, 1805)], True, '(at least 11, at most 40).'),
        ([(2, 1801)], [(5, 1000), (12, 1805)], None, ': 6 times as long (at least 2.5); whether'),
        ([(2, 1700)], [(12, 1805)], False, 'human not reached in 2.0 s'),
        ([(2, 1799)], [(12, 1805)], None, 'human not reached in 2.0 s'),  # 1799 to 1809
    ],
)
def test_a_tenth_of_the_time_is_said_only_where_it_is_known(
    games: GamesEvaluation,
    human: list[tuple[float, float]],
    primitive: list[tuple[float, float]],
    good: bool | None,
    words: str,
) -> None:
    both = curve('human', *human), curve('primitive', *primitive)
    *_, found = games_findings(replace(games, targets=(1800.0,), curves=both))
    assert (found.good, words in found.text) == (good, True), found.text


@pytest.mark.parametrize(
    ('scores', 'good', 'words'),
    [
        ((1880.0, 1890.0), True, 'reaches a mean score of 1,800'),
        ((1780.0, 1820.0), None, 'is not distinguishable from a mean score of 1,800'),
        ((1810.0, 1850.0), None, 'is not distinguishable'),  # a mean of 1830 alone would do
        ((1700.0, 1710.0), False, 'does not reach'),
    ],
)
def test_a_score_is_reached_by_its_whole_interval(
    games: GamesEvaluation, scores: tuple[float, float], good: bool | None, words: str
) -> None:
    found = judged(games, Interval.of(np.array(scores)), np.zeros(GAMES))
    assert (found[1].good, words in found[1].text) == (good, True), found[1].text


@pytest.mark.parametrize(
    ('gain', 'good', 'words'),
    [
        (100.0 + np.arange(GAMES), True, 'more than random choice'),
        (70.0 + np.arange(GAMES), None, 'is 80 (77 to 82)'),
        (np.arange(GAMES) - 9.5, False, 'not distinguishable from random choice'),
        (-np.arange(GAMES), False, 'less than random choice'),
    ],
)
def test_the_gain_over_random_choice_is_that_within_games(
    games: GamesEvaluation, gain: NDArray[np.float64], good: bool | None, words: str
) -> None:
    """Games differ by far more."""
    (found, *_) = judged(games, Interval(0.0, 0.0, 0.0), gain)
    assert (found.good, words in found.text) == (good, True), found.text


def test_the_share_of_random_choice_in_the_score_is_said(games: GamesEvaluation) -> None:
    """Of 0, 1000, .. points, a ninth more is planned: what was chosen at random is 90 % of it."""
    (found, *_) = judged(games, Interval(0.0, 0.0, 0.0), 1000.0 * np.arange(GAMES) / 9)
    assert 'Random choice has 90% of the score of the plan.' in found.text


def judged(games: GamesEvaluation, score: Interval, gain: NDArray[np.float64]) -> list[Finding]:
    """Return the findings of the first setting, with a score and gain of four options."""
    first, luck = games.settings[0], 1000.0 * np.arange(GAMES)
    scores = {first.largest(PLAN).name: luck + gain}
    rows = [replace(r, score=score, scores=scores.get(r.name, luck)) for r in first.rows]
    setting = replace(first, rows=tuple(rows))
    both = curve('human', (1, 1801)), curve('primitive', (2, 1801))
    told = replace(games, settings=(setting,), targets=(1800.0,), curves=both)
    return list(games_findings(told))


def test_what_is_never_reached_is_said_to_be_so() -> None:
    one = curve('x', (1.0, 90.0), (2.0, 110.0))
    assert (one.reached(100.0), one.reached(200.0)) == ('in 2.0 s', 'not reached in 2.0 s')


def test_the_report_shows_the_games_and_says_what_is_estimated(
    evaluation: BagEvaluation, games: GamesEvaluation
) -> None:
    first = evaluation.options[0]
    brief = replace(evaluation, options=(replace(first, curve=first.curve[-1:]),))
    page = render_report(ReportData('x', replace(brief, games={'p1': games})))
    section = page[page.index('<h2 id="games">') : page.index('<h2 id="planning">')]
    assert section.count('<svg') == 3  # score, cleared, curve
    assert 'estimates' in section
    for random, chase in zip(games.settings[0].rows, games.settings[1].rows):
        row = section[section.index(f'<th>{random.name}</th>') :].partition('</tr>')[0]
        cells = re.findall(r'<td class="n">([^<]*)<', row)
        scores = [f'{played.score.mean:,.0f}' for played in (random, chase)]
        assert [cells[0], cells[3]] == scores
        assert not re.search(r'>-0(\.00)? ', row)
    assert 'id="boards"' not in page
    assert 'Sweep by sweep' not in page


def test_where_no_games_were_played_the_plans_are_told(evaluation: BagEvaluation) -> None:
    texts = [finding.text for finding in findings(evaluation)]
    (human,) = [
        text
        for text in texts
        if text.startswith('The plan with the action set human') and 'game steps' in text
    ]
    assert f'from {STEPS:,} game steps' in human
    assert f'in {GAMES} games' in human


def test_a_long_episode_is_told_by_the_ends_of_runs(yard: Domain[Any]) -> None:
    """Runs of three steps, each worth 3 points."""
    state = yard.encode(yard.sample_states(generator(1, 'film'), 1)[0])
    steps = [
        Frame(state, 'north', 1.0, 'a' if step % 6 < 3 else 'b', ends_run=step % 3 == 2)
        for step in range(300)
    ]
    strip = episode_strip(yard, [Frame(state), *steps])
    assert (strip.whole, strip.steps) == (False, 300)
    assert len(strip.pictures) == MOST_PICTURES
    assert strip.left_out == 101 - MOST_PICTURES
    assert [picture.number for picture in strip.pictures][:3] == [0, 3, 6]
    assert strip.pictures[-1].number == 300
    assert (strip.pictures[1].action, strip.pictures[1].reward) == ('3 steps', '+3')
    short = episode_strip(yard, [Frame(state), *steps[:20]])
    assert short.whole
    assert len(short.pictures) == 21


def test_a_wide_board_has_room() -> None:
    wide = make_domain('pacman')
    start = wide.encode(wide.reset(generator(1, 'film')))
    assert episode_strip(wide, [Frame(start)]).width > 15.0
