"""Reports: self-contained pages with every number from the data."""

from dataclasses import replace
from html import escape
import math
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import reference_options
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.intervals import Interval
from humanopts_learner.options.judge import Thresholds
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_learner.summary import Criterion
from humanopts_teach.bags.info import TopicRow
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, evaluate, OptionEvaluation
from humanopts_teach.evaluation.settings import EvaluationSettings
from humanopts_teach.evaluation.summary import Live, PlayedEpisodes, SummaryError
from humanopts_teach.evaluation.text import evaluation_text
from humanopts_teach.report import charts
from humanopts_teach.report.charts import learning_curves, sweep_figure
from humanopts_teach.report.episode import episode_strip, Frame
from humanopts_teach.report.findings import findings
from humanopts_teach.report.pages import counted, DASH, MINUS, number, percent
from humanopts_teach.report.people import (
    judged_runs,
    shown_demonstrations,
    shown_return,
    teachers,
    wrong_ends,
)
from humanopts_teach.report.rules import option_rules
from humanopts_teach.report.write import render_report, ReportData, write_evaluation_report
import numpy as np
from numpy.typing import NDArray
import pytest
from teach_support.bags import judged_run

pytestmark = pytest.mark.heavy

SETTINGS = EvaluationSettings(
    seed=5, thresholds=Thresholds(0.9375, 0.1875, 0.0625, 0.125), teacher_error_rate=0.02
)
TAUGHT = ('go to passenger and pickup', 'go to destination and dropoff')
FRAMES = (
    Frame('taxi 0,1 passenger R destination B'),
    Frame('taxi 0,0 passenger R destination B', 'west', -1.0, 'go to passenger and pickup'),
    Frame('taxi 0,0 passenger aboard destination B', 'pickup', 0.0, 'go to passenger and pickup'),
)
TOPICS = (
    TopicRow('/game_state', 'humanopts_interfaces/msg/GameState', 4321, 1, 0),
    TopicRow('/rosout', 'rcl_interfaces/msg/Log', 17),
)


@pytest.fixture(scope='module')
def evaluation(taxi: Domain, taxi_lesson: list[Demonstration]) -> BagEvaluation:
    """A short lesson, evaluated."""
    return evaluate(taxi_lesson, taxi, SETTINGS)


def shortened(option: OptionEvaluation, **changed: Any) -> OptionEvaluation:
    """Return an option as it was learned last, with some columns changed."""
    return replace(option, learning=option.learning[-1:].assign(**changed))


@pytest.fixture(scope='module')
def brief(evaluation: BagEvaluation) -> BagEvaluation:
    """One of its options as it was learned last, and one of its plans."""
    options, plans = evaluation.options[:1], {'human': evaluation.plans['human']}
    return replace(evaluation, options=(shortened(*options),), plans=plans)


@pytest.fixture(scope='module')
def brief_page(brief: BagEvaluation, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of that option and plan alone, as of a bag."""
    path = tmp_path_factory.mktemp('brief') / 'report.html'
    write_evaluation_report(path, brief)
    return path.read_text('utf-8')


def undrawn(evaluation: BagEvaluation) -> BagEvaluation:
    """Return an evaluation without what takes long to draw: no demonstrations, no plans."""
    options = tuple(shortened(option, n_demonstrations=0) for option in evaluation.options)
    return replace(evaluation, options=options, plans={})


@pytest.fixture(scope='module')
def data(evaluation: BagEvaluation) -> ReportData:
    """Everything that a report can show."""
    played = PlayedEpisodes(100, 100, 0, 0, -11.375)
    live = Live(evaluation.option_table, evaluation.plan_table, played)
    return ReportData('Taxi, taught', evaluation, live, FRAMES, TOPICS, {'bag': 'demo/bag'})


@pytest.fixture(scope='module')
def page(data: ReportData) -> str:
    """The whole report."""
    return render_report(data)


def test_the_page_needs_nothing_outside_itself(page: str) -> None:
    targets = re.findall(r'(?:href|src)="([^"]*)"', page)
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert all(target.startswith(('#', 'data:')) for target in targets)
    assert re.findall(r'https?://|@import|<(script|link|iframe|object|embed|base|img)', page) == []
    assert re.findall(r'url\((?!["\']?#)', page) == []
    assert len(ids) == len(set(ids))
    assert {target[1:] for target in targets if target.startswith('#')} <= set(ids)
    assert set(re.findall(r'url\(#([^)]+)\)', page)) <= set(ids)


def test_figures_take_their_colours_from_the_page(page: str) -> None:
    assert 'prefers-color-scheme: dark' in page
    assert re.findall(r'#0[1-4]0[1-4]0[1-4]\b|#0101a', page) == []
    for variable in set(re.findall(r'var\((--\w+)\)', page)):
        assert page.count(f'{variable}: #') == 2, variable  # light and dark


def test_every_criterion_is_drawn_with_its_own_threshold(evaluation: BagEvaluation) -> None:
    figures = learning_curves(evaluation.options[0], 'curve')
    assert len(figures) == 6
    assert '95 % interval, same starts' in figures[-1]
    sides = 'above 0.969', 'below 0.188', 'below 0.0625', 'below 0.125'
    for figure, side in zip(figures, sides):
        assert f'met at or {side}' in figure
        assert 'demonstrations' in figure


def test_a_criterion_that_is_not_yet_known_is_called_so(brief: BagEvaluation) -> None:
    option = brief.options[0]
    unsure = Criterion.of('return', 0.125, 0.25, 0.375)
    criteria = [unsure if c.name == 'return' else c for c in option.summary.criteria]
    summary = replace(option.summary, criteria=tuple(criteria), more_needed=7)
    columns = {'return': 0.125, 'return_limit': 0.375, 'criteria_met': False}
    found = replace(brief, options=(replace(shortened(option, **columns), summary=summary),))
    text = evaluation_text(found)
    assert 'return is not yet known: about 0.125, at most 0.375 with 95 % confidence' in text
    assert 'perhaps 1 to 21 more demonstrations are needed' in text
    changed = [finding.text for finding in findings(found)]
    assert any('return not yet known: at most 0.375, needs 0.25' in each for each in changed)
    assert 'not yet known</td>' in render_report(ReportData('Taxi', undrawn(found)))
    _, figure, *_ = learning_curves(found.options[0], 'curve')
    assert 'upper limit' in figure


def test_where_held_out_demonstrations_end_is_told_and_what_cannot_fail_is_not_unmet(
    brief: BagEvaluation,
) -> None:
    option = brief.options[0]
    criteria = (
        Criterion.of('success', 1.0, 0.95, count=404),
        replace(Criterion.of('return', None, 0.1), obstacle='nothing to gain'),
        Criterion.of('termination', 0.25, 0.05, count=12),
    )
    summary = replace(option.summary, criteria=criteria, ended_early=2, ended_never=1)
    found = undrawn(replace(brief, options=(replace(option, summary=summary),)))
    text = evaluation_text(found).splitlines()
    ends = 'termination is 0.25 (early: 2, late: 0, never: 1), needs 0.05 or less'
    assert f'not met: {ends}' in text
    assert 'return is not measurable: nothing to gain' in text
    page = render_report(ReportData('Taxi', found))
    assert 'not met: 2 early, 0 late, 1 never</td>' in page
    assert 'every start: 404</td>' in page


def test_an_option_that_nothing_is_known_of_is_drawn_without_accuracy(
    evaluation: BagEvaluation,
) -> None:
    option = evaluation.options[0]
    unknown = {name: math.nan for name in option.learning if 'accuracy' in str(name)}
    unmeasured = tuple(Criterion.of(c.name, None, None) for c in option.summary.criteria)
    first = replace(
        option,
        learning=option.learning[:1].assign(**unknown),
        summary=replace(option.summary, criteria=unmeasured),
    )
    figures = learning_curves(first, 'curve')
    assert len(figures) == 4
    assert all('not yet measurable' in figure for figure in figures[1:])  # success is measured


def test_a_plan_with_an_option_that_is_not_learned_says_so(
    evaluation: BagEvaluation,
) -> None:
    options = [
        replace(
            o,
            summary=replace(
                o.summary, exam_needed=0, criteria=(Criterion('return', 1.0, 1.0, met),)
            ),
        )
        for o, met in zip(evaluation.options, (True, False))
    ]
    changed = replace(evaluation, options=tuple(options))
    said = f'human uses options that are not learned: {TAUGHT[1]}'
    assert said in evaluation_text(changed).splitlines()
    (text,) = [finding.text for finding in findings(changed) if 'uses' in finding.text]
    assert text.count('“') == 1
    assert f'“{TAUGHT[1]}”' in text


def test_judged_runs_are_listed_apart_from_demonstrations(
    brief: BagEvaluation, taxi_lesson: list[Demonstration]
) -> None:
    name = brief.options[0].option.name
    shown = [demo for demo in taxi_lesson if demo.option_name == name]
    runs = [
        judged_run(shown[0], shown[:3], 1, exam=True, stopped=True),
        judged_run(shown[1], shown, 2, right=True),
        replace(judged_run(shown[1], shown, 3, right=True), withdrawn=True),
    ]
    found = undrawn(replace(brief, demonstrations=[*shown, *runs]))
    options = tuple(replace(each, judged=runs[:2]) for each in found.options)
    found = replace(found, options=options)
    assert [demo for demo, _ in shown_demonstrations(found)] == shown
    assert judged_runs(found) == [(runs[0], False), (runs[1], True)]
    page = render_report(ReportData('Taxi', found))
    assert '2 runs, 1 of them wrong' in page
    assert 'wrong, stopped here</td><td class="muted">earlier version' in page
    assert f'{len(shown)} demonstrations and “not here” answers' in page
    assert f'run 1:\nwrong after {len(shown[0].actions)} steps</p>' in page
    assert [run for run, _ in wrong_ends(found)] == runs[:1]
    said = ' '.join(finding.text for finding in findings(found))
    assert f'“{name}” is {options[0].summary.status}' in said
    assert ' .' not in said


def test_numbers_on_the_page_are_those_of_the_data(data: ReportData, page: str) -> None:
    assert f'{MINUS}11.38' in page  # the mean return of the execution
    assert '4,321' in page
    assert 'demo/bag' in page
    assert all(each.option.name in page for each in data.evaluation.options)
    assert 'success ≥ 0.9375, return ≤ 0.1875, initiation ≤ 0.0625' in page


def test_the_words_say_what_was_played_what_was_lost_and_what_differs(data: ReportData) -> None:
    assert data.live is not None
    live = replace(data.live, options=data.live.options.assign(n_demonstrations=999))
    lost = replace(TOPICS[0], lost=3)
    texts = {finding.text: finding.good for finding in findings(data.evaluation, live, [lost])}
    assert texts['3 messages lost, on /game_state.'] is False
    assert any('999' in text and good is False for text, good in texts.items())
    found = findings(data.evaluation, data.live, TOPICS)
    good = [finding.text for finding in found if finding.good]
    assert (
        '100 of 100 episodes (95 % interval 96% to 100%) reached the end of the task, with no '
        f'fallbacks to a primitive action; their mean return is {MINUS}11.38.'
    ) in good
    assert any(text.startswith('No message was lost: 4,321') for text in good)
    assert any('equals the live one' in text for text in good)


@pytest.mark.parametrize(
    ('lost', 'good', 'words'),
    [
        (np.zeros(100), True, 'the options lose nothing.'),
        (np.arange(100) % 2, None, 'the options lose 0.5 (0.4003 to 0.5997).'),
        (np.arange(100) % 2 - 0.5, True, f'lose 0 ({MINUS}0.09971 to 0.09971).'),
        (np.arange(100) % 2 - 2.0, True, 'the options gain 1.5 (1.4 to 1.6).'),
        (1.0 + np.arange(100) % 2, False, 'the options lose 1.5 (1.4 to 1.6).'),
    ],
)
def test_what_options_lose_is_that_within_episodes(
    evaluation: BagEvaluation, lost: NDArray[np.float64], good: bool | None, words: str
) -> None:
    """May be 2 % of the return of primitive actions, here 0.5; episodes differ by far more."""
    luck = 100.0 * np.arange(100)
    human, primitive = evaluation.plans.values()
    mean = Interval(-25.0, -26.0, -24.0)
    plans = {
        'human': replace(human, judged=replace(human.judged, totals=luck - lost)),
        'primitive': replace(primitive, judged=replace(primitive.judged, totals=luck, total=mean)),
    }
    texts = {f.text: f.good for f in findings(replace(evaluation, plans=plans))}
    (found,) = [text for text in texts if 'from the same start states' in text]
    assert (texts[found], words in found) == (good, True), found


def test_rules_say_when_an_option_starts_and_ends(taxi: Domain, evaluation: BagEvaluation) -> None:
    initiation, termination, policy = option_rules(evaluation.options[0].option, taxi)
    assert 'passenger in taxi is yes: cannot start' in initiation.text
    assert 'passenger in taxi is no: goes on' in termination.text
    assert termination.depth == 1
    assert termination.leaves == 2
    assert policy.leaves == sum('(' in line for line in policy.text.splitlines())
    assert 'taxi row ≤' in policy.text


def test_residuals_of_every_plan_are_drawn_where_they_are_computed_soon(
    evaluation: BagEvaluation, page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans = {n: p.plan for n, p in evaluation.plans.items() if isinstance(p.plan, ExactPlan)}
    for name, plan in plans.items():
        assert f'{name}: {plan.solution.sweeps} sweeps' in page
    monkeypatch.setattr(charts, 'MAX_VALUES', 499)
    assert sweep_figure(plans, 'sweeps') == sweep_figure({}, 'sweeps') == ''


def test_every_demonstration_is_in_the_table_once_with_what_became_of_it(
    evaluation: BagEvaluation, taxi_lesson: list[Demonstration]
) -> None:
    back, last = replace(taxi_lesson[3], withdrawn=True), taxi_lesson[-1]
    stray = replace(last, uuid='stray', number=99)
    shown = [*taxi_lesson[::-1], back, stray]  # repeated and out of order
    changed = replace(evaluation, demonstrations=shown)
    rows = shown_demonstrations(changed)
    names = [last.option_name] * 13 + [back.option_name] * 12
    assert [demo.number for demo, _ in rows] == [*range(1, 13), 99, *range(1, 13)]
    assert [demo.option_name for demo, _ in rows] == names
    assert [verdict for _, verdict in rows[13:]] == [
        'taken back' if demo is taxi_lesson[3] else 'kept' if demo.actions else 'kept: not here'
        for demo in taxi_lesson[:12]
    ]
    assert rows[12][1] == 'left out'
    assert [demo for demo, _ in rows[:12]] == taxi_lesson[12:]
    corrected = replace(taxi_lesson[0], machine_steps=2)
    ((_, verdict),) = shown_demonstrations(replace(changed, demonstrations=[corrected]))
    assert verdict == 'kept: the machine took the first 2'


def test_the_page_has_demonstrations_references_and_intervals(
    brief: BagEvaluation, brief_page: str, taxi: Domain, taxi_lesson: list[Demonstration]
) -> None:
    page, option = brief_page, brief.options[0]
    assert f'<summary>{len(taxi_lesson)} demonstrations' in page
    assert all(f'<code>{demo.states[0]}</code>' in page for demo in taxi_lesson)
    assert escape(reference_options(taxi)[option.option.name].definition) in page
    own = shortened(option, option_name='my own')
    other = undrawn(replace(brief, options=(own,)))
    assert 'It has no reference option' in render_report(ReportData('Taxi', other))
    returns = np.array([sum(demo.rewards) for demo in taxi_lesson[:12] if demo.actions])
    from scipy import stats  # its import takes a second

    low, high = stats.t.interval(0.95, len(returns) - 1, returns.mean(), stats.sem(returns))
    shown = shown_return(brief, option)
    assert (shown.low, shown.high) == (pytest.approx(low), pytest.approx(high))
    assert f'<td class="n">{number(low)}</td><td class="n">{number(high)}</td>' in page
    assert 'id="people"' not in page


def test_people_are_compared_by_option_and_by_their_plans(evaluation: BagEvaluation) -> None:
    others = tuple(
        replace(each, option=replace(each.option, participant='ben'))
        for each in evaluation.options
    )
    human, primitive = evaluation.plans.values()
    totals = human.judged.totals
    lost = np.arange(len(totals))
    judged = replace(human.judged, totals=totals - lost)
    plans = {
        'human by p1': human,
        'human by ben': replace(human, participant='ben', judged=judged),
        'human by cleo': replace(human, participant='cleo'),
        'primitive': primitive,
    }
    two = replace(evaluation, options=(*evaluation.options, *others), plans=plans)
    taught = [option for option, _, _ in teachers(two)]
    assert [each.option.participant for each in taught] == ['p1', 'ben'] * 2
    assert [each.option.name for each in taught] == [n for n in TAUGHT for _ in range(2)]
    assert teachers(evaluation) == []
    texts = [f.text for f in findings(two) if 'A plan with the options of' in f.text]
    from scipy import stats  # its import takes a second

    half = stats.t.ppf(1 - 0.05 / 3 / 2, len(lost) - 1) * stats.sem(lost)  # of three at once
    limits = (
        f'{number(lost.mean())} ({number(lost.mean() - half)} to {number(lost.mean() + half)})'
    )
    assert 'of p1 is better than one with those of ben' in texts[0]
    assert f'returns {limits} more' in texts[0]
    assert 'of p1 is as good as one with those of cleo' in texts[1]
    assert 'of ben is worse than one with those of cleo' in texts[2]
    assert not any('A plan with the options' in finding.text for finding in findings(evaluation))
    assert 'id="people"' in render_report(ReportData('Taxi', undrawn(two)))


def test_the_strip_shows_what_ran_and_only_the_board(taxi: Domain) -> None:
    pictures = episode_strip(taxi, FRAMES).pictures
    assert [(picture.action, picture.reward) for picture in pictures] == [
        ('', ''),
        ('west', f'{MINUS}1'),
        ('pickup', '0'),
    ]
    assert [picture.colour for picture in pictures] == ['', 'o0', 'o0']
    assert 'landmarks' not in pictures[0].board
    assert 'class="g3"' in pictures[0].board


def test_a_report_of_a_bag_alone_has_no_live_numbers(
    brief: BagEvaluation, brief_page: str
) -> None:
    """Titles are escaped."""
    assert '<th class="n">live</th>' not in brief_page
    assert 'id="episode"' not in brief_page
    assert 'id="recording"' not in brief_page
    assert 'id="boards"' in brief_page
    escaped = render_report(ReportData('<script>alert(1)</script>', undrawn(brief)))
    assert '<script>' not in escaped
    with pytest.raises(SummaryError, match='gone'):
        write_evaluation_report(Path('/gone/report.html'), undrawn(brief))


def test_a_report_says_whether_options_equal_their_files(brief: BagEvaluation) -> None:
    changed = undrawn(replace(brief, options=(replace(brief.options[0], reproduced=False),)))
    assert '>NOT equal to its option file in the bag<' in render_report(
        ReportData('Taxi', changed)
    )
    assert not any('option learned again' in finding.text for finding in findings(changed))
    assert 'Learned again, it is' not in render_report(ReportData('Taxi', undrawn(brief)))


@pytest.mark.parametrize(
    ('made', 'text'),
    [
        (number(None), DASH),
        (number(float('nan')), DASH),
        (number(-0.5), f'{MINUS}0.5'),
        (percent(1.0), '100%'),
        (percent(0.9375), '93.8%'),
        (counted(0, 'fallback'), 'no fallbacks'),
        (counted(1, 'fallback'), '1 fallback'),
    ],
)
def test_numbers_read_well(made: str, text: str) -> None:
    assert made == text
