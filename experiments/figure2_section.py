"""Figure 2 in the report: beside what the paper says of it, and beside our own goals."""

from collections.abc import Mapping, Sequence
from functools import partial
import re
from typing import Any

from humanopts_teach.report.figures import Drawing, MUTED, SERIES
from matplotlib.ticker import MaxNLocator, PercentFormatter
import numpy as np

from experiments import figure2, paper
from experiments.cells import code_version
from experiments.figure2_series import (
    Case,
    gather,
    LEVELS,
    MEASURES,
    Needed,
    PEOPLE,
    Series,
)
from experiments.lessons import SECONDS
from experiments.people import CAREFUL, VARIED
from experiments.sections import (
    agreement,
    Comparison,
    goal,
    Paint,
    Picture,
    Section,
    Table,
    Value,
    Verdict,
)
from experiments.study import Experiment, Study

TITLE = 'Figure 2: accuracy against demonstrations'
TITLES = {'policy': 'policy', 'initiation': 'I (may it start?)', 'termination': 'β (does it end?)'}
STYLES = {'random': (SERIES[1], '--'), 'coverage': (SERIES[3], '-.'), 'failures': (SERIES[0], '-')}
GOALS = {('failures', 0.95): 15, ('failures', 1.0): 30}  # demonstrations at most, careful, Taxi
NEAR = 10  # demonstrations by which "about 40" may be missed
OURS = 'goal of this project'


def present(study: Study, results: Mapping[str, Any]) -> Section:
    """Return what the report says of the cells that have a result."""
    series = gather(figure2.cells(study), results)
    return Section(
        figure2.NAME,
        TITLE,
        _text(study),
        _comparisons(series, bool(study.bags)),
        _pictures(series),
        [_needed_table(series), _curve_table(series), _person_table(series)],
        {'code': code_version(), 'shown': figure2.SHOWN},
    )


EXPERIMENT = Experiment(figure2.NAME, TITLE, figure2.cells, present)


def _text(study: Study) -> list[str]:
    measured = (
        'Policy accuracy is the share of states where the option may start in which its policy '
        'takes one of the best actions; the paper compares returns. Accuracy of I and β is the '
        'share of states that they classify as the reference option does. In Pac-Man both are '
        'taken over a fixed sample of states. Lines are means over people, bands their 95 % '
        "confidence intervals by Student's t."
    )
    if study.bags:
        return [measured, 'The demonstrations are those of the people in the bags.']
    return [
        measured,
        'A demonstration is a trajectory; “not here” answers are counted apart. Lessons go on '
        f'to {figure2.SHOWN["taxi"]} demonstrations in Taxi and {figure2.SHOWN["pacman"]} in '
        'Pac-Man, whether or not the criteria of a lesson hold.',
    ]


def _comparisons(series: Sequence[Series], real: bool) -> list[Comparison]:
    found = []
    for one in series:
        case = one.case
        if _as_in_paper(case) and paper.FIGURE_2_OPTIONS.get(case.domain) == case.option:
            found += [_rises(one), _not_perfect(one)]
        if case.group == CAREFUL and case.domain == 'taxi':
            found += _goals(one)
    return [*found, *_minutes(series, real)]


def _as_in_paper(case: Case) -> bool:
    """Tell whether people taught, or are like people, and start states were random."""
    return case.group == PEOPLE or (case.group, case.strategy) == (VARIED, 'random')


def _rises(one: Series) -> Comparison:
    """Compare the paper's one claim about the height of the curve."""
    mean = one.bands()['policy'].mean
    last = min(paper.DEMONSTRATIONS, len(mean))
    needed = one.needed(LEVELS[0])
    found = (
        f'{_named(one.case)}: mean policy accuracy {mean[0]:.1%} after 1 demonstration and '
        f'{mean[last - 1]:.1%} after {last}; demonstrations for 95 %: {needed.text}.'
    )
    return _said(1, found, agreement(last > 1 and mean[last - 1] > mean[0]))


def _not_perfect(one: Series) -> Comparison:
    bands = one.bands()
    last = {name: float(bands[name].mean[-1]) for name in MEASURES[1:]}
    found = (
        f'{_named(one.case)}: after {one.accuracy.shape[2]} demonstrations I is right in '
        f'{last["initiation"]:.1%} of states, β in {last["termination"]:.1%}.'
    )
    return _said(2, found, agreement(min(last.values()) < 1))


def _said(number: int, found: str, verdict: Verdict) -> Comparison:
    statement = paper.FIGURE_2[number]
    return Comparison(statement.text, statement.where, found, verdict)


def _goals(one: Series) -> list[Comparison]:
    """Compare the demonstrations needed with the paper's 40 and with our own goals."""
    found = []
    for level in LEVELS:
        needed, most = one.needed(level), GOALS.get((one.case.strategy, level))
        text = f'{_named(one.case)}, people without errors: mean {needed.text}.'
        if most is not None:
            said = f'{level:.0%} policy accuracy takes at most {most} demonstrations.'
            met = needed.complete and needed.mean <= most
            found.append(Comparison(said, OURS, text, goal(met)))
        elif one.case.strategy == 'random' and level == LEVELS[0]:
            said = f'{level:.0%} policy accuracy takes about {paper.DEMONSTRATIONS}.'
            where = 'section 7.1, figure 2: “acceptable levels with over 40 trajectories”'
            found.append(Comparison(said, where, text, agreement(_is_near(needed))))
    return found


def _is_near(needed: Needed) -> bool:
    return needed.complete and abs(needed.mean - paper.DEMONSTRATIONS) <= NEAR


def _minutes(series: Sequence[Series], real: bool) -> list[Comparison]:
    """Compare the time that people took for all that they showed."""
    found = []
    for domain, most in paper.MINUTES.items():
        taken: dict[tuple[str, str], float] = {}  # by code and strategy
        for one in series:
            if one.case.domain == domain and _as_in_paper(one.case):
                for code, minutes in zip(one.codes, one.minutes):
                    key = code, one.case.strategy
                    taken[key] = taken.get(key, 0.0) + minutes
        if not taken:
            continue
        mean = float(np.mean(list(taken.values())))
        text = f'{domain}: {mean:.1f} minutes of a person for all options'
        text += ', by the clock.' if real else f', at an assumed pace ({_pace()}).'
        said = f'On average no more than {most:g} minutes to show the most trajectories.'
        verdict = agreement(mean <= most) if real else Verdict.NOT_COMPARABLE
        found.append(Comparison(said, paper.FIGURE_2[3].where, text, verdict))
    return found


def _pace() -> str:
    words = {'Define': 'naming', 'Reply': 'question', 'Begin': 'start state', 'Drive': 'step'}
    return ', '.join(
        f'{seconds:g} s for a {words.get(act.__name__, "verdict")}'
        for act, seconds in SECONDS.items()
    )


def _named(case: Case) -> str:
    return f'{case.domain}, “{case.option}”, start states by {case.strategy}'


def _needed_table(series: Sequence[Series]) -> Table:
    rows: list[list[Value]] = []
    for one in series:
        row: list[Value] = [*_columns(one.case), len(one.codes)]
        for level in LEVELS:
            needed = one.needed(level)
            asked = [number for number in needed.asked if number is not None]
            mean = round(float(np.mean(asked)), 1) if needed.complete else None
            row += [needed.text, needed.reached, mean]
        rows.append([*row, round(float(np.mean(one.minutes)), 2)])
    heads = [
        f'{head} {level:.0%}'
        for level in LEVELS
        for head in ('demonstrations for', 'people who reached', 'start states for')
    ]
    columns = ['domain', 'option', 'people', 'start states by', 'count', *heads, 'minutes']
    return Table('fig2-needed', 'Demonstrations needed for a policy accuracy', columns, rows)


def _curve_table(series: Sequence[Series]) -> Table:
    """Return exactly what is drawn."""
    rows: list[list[Value]] = []
    for one in series:
        for measure, found in one.bands().items():
            for n in range(len(found.mean)):
                values = (found.mean[n], found.low[n], found.high[n])
                rows.append(
                    [
                        *_columns(one.case),
                        measure,
                        n + 1,
                        int(found.count[n]),
                        *(_number(v) for v in values),
                    ]
                )
    columns = ['domain', 'option', 'people', 'start states by', 'measure', 'demonstrations']
    columns += ['count', 'mean', 'low', 'high']
    return Table('fig2-curves', 'The curves', columns, rows, shown=False)


def _person_table(series: Sequence[Series]) -> Table:
    rows: list[list[Value]] = []
    for one in series:
        needed = [one.needed(level).demonstrations for level in LEVELS]
        for place, code in enumerate(one.codes):
            last = [_number(values[place][-1]) for values in one.accuracy]
            reached = [numbers[place] for numbers in needed]
            cut = one.cut_short[place]
            rows.append([*_columns(one.case), code, *reached, *last, one.minutes[place], cut])
    columns = ['domain', 'option', 'people', 'start states by', 'person']
    columns += [f'demonstrations for {level:.0%}' for level in LEVELS]
    columns += [f'last accuracy of {measure}' for measure in MEASURES]
    return Table(
        'fig2-people', 'Each person', [*columns, 'minutes', 'cut short'], rows, shown=False
    )


def _columns(case: Case) -> list[Value]:
    return [case.domain, case.option, case.group, case.strategy]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _pictures(series: Sequence[Series]) -> list[Picture]:
    """Return one figure for each option and group, with a line for each strategy."""
    panels: dict[tuple[str, str, str], list[Series]] = {}
    for one in series:
        panels.setdefault((one.case.domain, one.case.option, one.case.group), []).append(one)
    return [
        Picture(
            re.sub(r'[^a-z0-9]+', '-', f'fig2-{domain}-{option}-{group}'.lower()),
            f'Accuracy of {option} in {domain} by demonstrations, {group} people',
            (10.0, 2.9),
            partial(_draw, shown),
            f'{domain}: “{option}”, {_who(group)}'
            + (' (figure 2)' if paper.FIGURE_2_OPTIONS.get(domain) == option else ''),
        )
        for (domain, option, group), shown in panels.items()
    ]


def _who(group: str) -> str:
    return {
        CAREFUL: 'simulated people without errors',
        VARIED: 'simulated people who differ',
        PEOPLE: 'people',
    }[group]


def _draw(shown: Sequence[Series], work: Drawing, paint: Paint) -> None:
    for place, (axes, measure) in enumerate(
        zip(work.figure.subplots(1, 3, sharey=True), MEASURES)
    ):
        for one in shown:
            found = one.bands()[measure]
            n = np.arange(1, len(found.mean) + 1)
            colour, line = STYLES[one.case.strategy]
            axes.plot(n, found.mean, line, color=paint(colour), lw=1.5, label=one.case.strategy)
            axes.fill_between(n, found.low, found.high, color=paint(colour), alpha=0.15, lw=0)
        axes.axvline(paper.DEMONSTRATIONS, color=paint(MUTED), ls=':', lw=1)
        axes.set(title=TITLES[measure], xlabel='demonstrations', ylim=(None, 1.02))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.grid(axis='y')
        axes.tick_params(length=0)
        if place == 0:
            axes.set_ylabel('share of states')
            axes.legend(loc='lower right')
