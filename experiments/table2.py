"""
Table 2: time and return of planning with each action set (sections 7.3 and 8).

The plans are in ``table2_plans``; this module has their trials and their section of the report.
"""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
import math
import re
from typing import Any

from humanopts_learner.intervals import all_hold, Interval
from humanopts_teach.report.figures import Drawing
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import pandas as pd

from experiments import paper, people, report
from experiments.paper import Statement
from experiments.table2_plans import (
    AS_IN_PAPER,
    BY_CHANCE,
    CHASE,
    ComparedGame,
    COST,
    CURVE,
    EFFORT,
    GAMES,
    INTERRUPTED,
    NAME,
    PLAN,
    plan_all_games,
    RETURN,
    SECONDS,
    TAXI,
    UNIFORM,
    VARIANTS,
)
from experiments.trials import Trial

TITLE = 'Table 2: planning time and return'
COSTS = {'pacman': 100.0, 'taxi': 5.0}  # approximate processor seconds per trial
KEYS = ['game', 'action set']
ROUNDING = 1e-9  # reward units
ORDER = [one.name for one in (*GAMES, *VARIANTS)]  # order of rows
Values = dict[str, Interval]  # by name


def trials(study: people.Study) -> list[Trial]:
    """Return one trial per taught domain and person, extraction or repetition."""
    found = []
    for domain in dict.fromkeys(game.domain for game in GAMES):
        sources = people.owners(study, domain)
        if not (count := len(sources[people.PERSON])):
            continue
        for owner, members in sources.items():
            for source in members:
                parameters = {
                    'domain': domain,
                    'plans': math.ceil(study.seeds / count),
                    'seed': study.seed,
                    'effort': asdict(EFFORT),
                    'owner': owner,
                    **source,
                }
                found.append(Trial(NAME, parameters, plan_all_games, COSTS[domain]))
    return found


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section."""
    kinds = {
        kind: mine.dropna(axis='columns', how='all')
        for kind, mine in rows.groupby('kind', sort=False)
    }
    members = member_table(kinds[PLAN])
    summary, points = summary_table(members), point_table(kinds[CURVE])
    by = [*KEYS, 'budget']
    seconds = points.groupby(by, sort=False)[SECONDS].mean()
    curves = report.mean_intervals(points, by, RETURN).join(seconds, on=by)
    found, pictures, tables = [], [], []
    for game in GAMES:
        if game.name not in summary.index:
            continue
        results = Results(game, members, points, curves)
        found += [*_claims(results), *_numbers(results)]
        name = f'table2-{re.sub(r"[^a-z]+", "-", game.name.lower())}'
        tables.append(report.Table(name, game.name, summary.loc[game.name].reset_index()))
        unit = 'sweeps' if game.exact else 'game steps'
        caption = (
            f'{game.name}: mean return against planning time, {unit} doubled from point to '
            'point. Shaded: 95 % interval.'
        )
        draw = partial(_draw, game, curves[curves['game'] == game.name])
        pictures.append(report.Picture(name, caption, (8.2, 4.2), draw))
    drawn = 'The curves; budgets are sweeps in Taxi, game steps in Pac-Man'
    tables += [
        report.Table(
            'table2-acquisition', 'Mean cost of getting the options', cost_table(kinds[COST])
        ),
        report.Table('table2-paper', "The paper's table, and ours", paper_table(summary)),
        report.Table('table2-curves', drawn, curves.rename(columns={'mean': RETURN}), shown=False),
    ]
    return report.Section(NAME, TITLE, found, pictures, tables, {'effort': asdict(EFFORT)})


def _ordered(frame: pd.DataFrame) -> pd.DataFrame:
    """Sort the rows by game and action set."""
    return frame.sort_values(
        KEYS, key=lambda names: names.map(ORDER.index), kind='stable', ignore_index=True
    )


def member_table(plans: pd.DataFrame) -> pd.DataFrame:
    """Return the means over the plans of each member, indexed by game, variant and trial."""
    means = plans.groupby([*KEYS, 'trial']).mean(numeric_only=True)
    return _ordered(means.reset_index()).set_index([*KEYS, 'trial'])


def summary_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return one row per game and variant, indexed by both; each member counts once."""
    means = members.groupby(KEYS, sort=False).mean().drop(columns=['budget', RETURN])
    returns = report.mean_intervals(members.reset_index(), KEYS, RETURN).set_index(KEYS)
    return returns.rename(columns={'mean': RETURN}).join(means)


def point_table(curve: pd.DataFrame) -> pd.DataFrame:
    """Return each member's curve by budget; a shorter curve keeps its last point."""
    wide = curve.pivot(index=[*KEYS, 'budget'], columns='trial', values=[SECONDS, RETURN])
    long = wide.groupby(level=KEYS).ffill().stack('trial', future_stack=True).dropna()
    return _ordered(long.reset_index())


def cost_table(costs: pd.DataFrame) -> pd.DataFrame:
    """Return the mean cost of obtaining the options."""
    names = [*costs.columns.difference(['kind', 'domain', 'action set', 'trial'], sort=False)]
    owned = costs[costs['options'] > 0].astype(dict.fromkeys(names, float))
    groups = owned.groupby(['domain', 'action set'], sort=False)
    found: pd.DataFrame = groups[names].mean()
    found.insert(0, 'count', groups.size())
    return found.reset_index()


def paper_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the paper's numbers and ours; for Pac-Man, ours are those with random ghosts."""
    rows, ours = [], [SECONDS, RETURN, 'low', 'high']
    for game in (TAXI, UNIFORM):
        known = paper.TABLE_2[game.domain]
        for name, row in {**known, AS_IN_PAPER: known['human']}.items():
            if (game.name, name) in summary.index:
                rows.append([game.name, name, *row, *summary.loc[(game.name, name), ours]])
    columns = [*KEYS, "paper's seconds", "paper's average reward", 'seconds', *ours[1:]]
    return pd.DataFrame(rows, columns=columns)


class Results:
    """The results of one game by variant: means per member, and curves."""

    def __init__(self, game: ComparedGame, *tables: pd.DataFrame) -> None:
        """Select the rows of this game from the members, points and curves of all games."""
        self.game = game
        self.members, self._points, self._curves = (
            {name: rows for (name,), rows in report.grouped(of[of['game'] == game.name], KEYS[1:])}
            for of in (table.reset_index() for table in tables)
        )

    def returns(self, first: str, second: str) -> tuple[str, Interval]:
        """Return a label and the gain in return of the first variant, paired for equal owners."""
        one, other = (self.members[name].set_index('trial')[RETURN] for name in (first, second))
        paired = one.index.equals(other.index)
        more = Interval.of_difference(one, other, paired=paired)
        return f'return, {first} less {second}', more

    def times(self, first: str, second: str) -> tuple[str, Interval]:
        """
        Return a label, and the time of the first variant as a fraction of the second's.

        Plans with exact models converge. Sampled plans use their whole budget, so they are
        compared by the time at the first budget where the whole interval of the return reaches a
        level: the highest that both variants reach. NaN for a single member: it has no interval.
        """
        pair, level = (first, second), ''
        samples = [self.members[name][SECONDS] for name in pair]
        if not self.game.exact:
            reached = min(float(self._curves[name]['low'].max()) for name in pair)
            level, samples = f' until {reached:,.0f} points', []
            for points, curve in ((self._points[name], self._curves[name]) for name in pair):
                enough = curve.loc[curve['low'] >= reached, 'budget']
                samples.append(points.loc[points['budget'].isin(enough[:1]), SECONDS])
        one, other = samples
        return f'time{level}, {first} / {second}', Interval.of_ratio(one, other, paired=False)


# Claims that one variant has a higher return than another, or takes less time. A claim with
# several tests holds if all of them hold.
CLAIMS: tuple[tuple[Statement | str, tuple[tuple[Any, str, str], ...]], ...] = (
    (paper.SAID['human_faster'], ((Results.times, 'human', 'primitive'),)),
    (paper.SAID['automatic_faster'], ((Results.times, 'automatic', 'primitive'),)),
    (
        paper.SAID['never_as_good'],
        ((Results.returns, 'primitive', 'human'), (Results.returns, 'primitive', 'automatic')),
    ),
    (
        paper.SAID['efficient'],
        ((Results.times, 'human', 'automatic'), (Results.returns, 'human', 'automatic')),
    ),
    (
        'Planning with human options returns more than random choice among them.',
        ((Results.returns, 'human', BY_CHANCE),),
    ),
    (paper.SAID['interrupted'], ((Results.returns, INTERRUPTED, 'human'),)),
)


def _claims(results: Results) -> Iterator[report.Comparison]:
    """Yield the comparisons for the claims that have results."""
    for claim, tests in CLAIMS:
        values, verdicts = Values(), []
        for test, first, second in tests:
            if {first, second} <= set(results.members):
                name, value = test(results, first, second)
                values[name] = value
                less = test is Results.times
                verdicts.append(value.below(1.0) if less else value.above(ROUNDING))
        if values and not (results.game.exact and claim == paper.SAID['interrupted']):
            yield report.compare(claim, all_hold(verdicts), results.game.name, values)


def _numbers(results: Results) -> Iterator[report.Comparison]:
    """
    Compare the numbers of table 2 with ours.

    Seconds are compared as fractions of those of primitive actions: they agree if the interval
    contains the paper's fraction.
    """
    game, members, unknown = results.game, results.members, report.Mark.NOT_COMPARABLE
    title, known = game.name.partition(',')[0], paper.TABLE_2[game.domain]
    if 'primitive' not in members or game == CHASE:
        return
    for name, (seconds, reward) in known.items():
        own = AS_IN_PAPER if name == 'human' and AS_IN_PAPER in members else name
        if own not in members:
            continue
        said, why = f'{title}, {name}: {seconds:g} s', paper.WHY_NO_SECONDS
        values = {'seconds': Interval.of(members[own][SECONDS])}
        verdict: bool | report.Mark | None = unknown
        if name != 'primitive':
            part, why = seconds / known['primitive'][0], ''
            said += f', {part:.3g} of the time of primitive actions'
            values = dict([results.times(own, 'primitive')])
            verdict = all_hold(time.holds(part) for time in values.values())
        claim = Statement(f'{said}.', 'table 2')
        yield report.compare(claim, verdict, game.name, values, why=why)
        claim = Statement(f'{title}, {name}: average reward {reward:,g}.', 'table 2')
        values = {f'return, {own}': Interval.of(members[own][RETURN])}
        why = paper.WHY_NO_RETURN[game.domain]
        yield report.compare(claim, unknown, game.name, values, why=why)
    if not game.exact:
        none = report.Mark.NO_COUNTERPART
        yield report.compare(paper.SAID['incomplete'], none, game.name, why=paper.NO_BEST_KNOWN)


def _draw(game: ComparedGame, curves: pd.DataFrame, work: Drawing) -> None:
    axes, (unit, scale) = work.axes, ('ms', 1e3) if game.exact else ('s', 1.0)
    drawn = curves.assign(**{SECONDS: scale * curves[SECONDS]})
    lines = {variant.name: variant.line for variant in VARIANTS}
    report.draw_curves(axes, drawn, 'action set', SECONDS, lines, ms=4, lw=1.3)
    axes.set(title=game.name, xlabel=f'planning time of a processor, {unit}', ylabel='mean return')
    axes.set_xscale('log')
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5))
