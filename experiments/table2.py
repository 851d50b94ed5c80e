"""
Table 2: what planning with each action set takes and achieves (sections 7.3 and 8).

The trials of the plans in ``table2_plans``, and their section of the report.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
import math
import re

from humanopts_learner.intervals import all_hold, Interval
from humanopts_teach.evaluation.tables import SECONDS
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
    EFFORT,
    GAMES,
    INTERRUPTED,
    NAME,
    plan_all_games,
    TAXI,
    UNIFORM,
    VARIANTS,
)
from experiments.trials import Trial

TITLE = 'Table 2: planning time and return'
COSTS = {'pacman': 100.0, 'taxi': 5.0}  # of a trial, about processor seconds
KEYS = ['game', 'action set']
ROUNDING = 1e-9  # reward units
ORDER = ['taxi', 'pacman', *(one.name for one in (*GAMES, *VARIANTS))]  # of rows


def trials(study: people.Study) -> list[Trial]:
    """Return one trial for each domain that is taught, and person, extraction, repetition."""
    found = []
    for domain in dict.fromkeys(game.domain for game in GAMES):
        sources = people.owners(study, domain)
        if not (count := len(sources[people.PERSON])):
            continue
        for whose, members in sources.items():
            for source in members:
                parameters = {
                    'domain': domain,
                    'plans': math.ceil(study.seeds / count),
                    'seed': study.seed,
                    'effort': asdict(EFFORT),
                    'whose': whose,
                    **source,
                }
                found.append(Trial(NAME, parameters, plan_all_games, COSTS[domain]))
    return found


def present(done: report.Done) -> report.Section:
    """Return the section of the report."""
    members, points = member_table(done), point_table(done)
    summary, curves = summary_table(members), curve_table(points)
    found, pictures, tables = [], [], []
    for game in GAMES:
        if game.name not in summary.index:
            continue
        results = Results(game, members, points, curves)
        found += [*_claims(results), *_numbers(results)]
        name = f'table2-{re.sub(r"[^a-z]+", "-", game.name.lower())}'
        tables.append(report.Table(name, game.name, summary.loc[game.name].reset_index()))
        label = f'Mean return in {game.name} by planning seconds and action set'
        unit = 'sweeps' if game.exact else 'game steps'
        caption = (
            f'{game.name}: mean return against planning time, {unit} doubled from point to '
            'point. Shaded: 95 % interval.'
        )
        draw = partial(_draw, game, curves[curves['game'] == game.name])
        pictures.append(report.Picture(name, label, (8.2, 4.2), draw, caption))
    acquired = 'What it cost to get the options, mean of each'
    drawn = 'The curves; budgets are sweeps in Taxi, game steps in Pac-Man'
    tables += [
        report.Table('table2-acquisition', acquired, cost_table(done)),
        report.Table('table2-paper', "The paper's table, and ours", paper_table(summary)),
        report.Table('table2-curves', drawn, curves, shown=False),
    ]
    return report.Section(NAME, TITLE, found, pictures, tables, {'effort': asdict(EFFORT)})


def rows_of(done: report.Done, name: str, by: Sequence[str]) -> pd.DataFrame:
    """
    Return the rows of one table of all trials, with the number of the trial as ``member``.

    :param by: columns to order the rows by, as in ``ORDER``.
    """
    rows = [
        {'domain': parameters['domain'], 'member': member, **row}
        for member, (parameters, result) in enumerate(done)
        for row in result[name]
    ]
    frame = pd.DataFrame(rows, columns=None if rows else ['domain', 'member', *by])
    return frame.sort_values(
        list(by), key=lambda names: names.map(ORDER.index), kind='stable', ignore_index=True
    )


def member_table(done: report.Done) -> pd.DataFrame:
    """Return the means of each member's plans, indexed by game, variant and member."""
    plans = rows_of(done, 'plans', KEYS)
    plans['seconds'] = plans[list(SECONDS)].sum(axis=1)
    return plans.groupby([*KEYS, 'member'], sort=False).mean(numeric_only=True)


def summary_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each game and variant, indexed by both; each member counts once."""
    means = members.groupby(KEYS, sort=False).mean()
    returns = report.mean_intervals(members.reset_index(), KEYS, 'mean').set_index(KEYS)
    parts = {
        'count': returns['count'],
        'tables, s': means['table_seconds'].round(6),
        'models, s': means['model_seconds'].round(6),
        'sweeps, s': means['sweep_seconds'].round(6),
        'total, s': means['seconds'].round(6),
        'sweeps': means['sweeps'].round(1),
        'states': means['states'].round().astype(int),
        'game steps': means['game_steps'].round().astype(int),
        'mean return': returns['mean'],
        'low': returns['low'],
        'high': returns['high'],
        'discounted': means['discounted'],
        'done': means['done'],
        'fallbacks in a game': means['fallbacks'],
    }
    return pd.DataFrame(parts)


def point_table(done: report.Done) -> pd.DataFrame:
    """Return each member's curve by budget; one that has ended keeps its last point."""
    points = rows_of(done, 'curve', KEYS)
    found: list[pd.DataFrame] = []
    points['seconds'] = points[list(SECONDS)].sum(axis=1)
    for key, mine in report.grouped(points, KEYS):
        wide = mine.set_index(['budget', 'member'])[['seconds', 'mean']].unstack('member').ffill()
        every = wide.stack('member', future_stack=True).reset_index()
        found.append(every.assign(**dict(zip(KEYS, key))))
    return pd.concat(found, ignore_index=True)


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """Return mean return by budget, over members."""
    by = [*KEYS, 'budget']
    curves = report.mean_intervals(points, by, 'mean')
    curves['seconds'] = points.groupby(by, sort=False)['seconds'].mean().to_numpy()
    columns = [*by, 'seconds', 'mean', 'low', 'high']
    return curves[columns].rename(columns={'mean': 'mean return'})


def cost_table(done: report.Done) -> pd.DataFrame:
    """Return what it cost to get the options, mean of their owners."""
    names = {
        'options': 'options',
        'demonstrations': 'demonstrations',
        'minutes': 'teaching minutes',
        'seconds': 'extraction seconds',
        'game_steps': 'extraction game steps',
    }
    keys = ['domain', 'action set']
    owned = rows_of(done, 'costs', keys)
    owned = owned[owned['options'] > 0].astype(dict.fromkeys(names, float))
    groups = owned.groupby(keys, sort=False)
    found: pd.DataFrame = groups[list(names)].mean().rename(columns=names)
    found.insert(0, 'count', groups.size())
    return found.reset_index()


def paper_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Set the paper's numbers beside ours; in Pac-Man, beside the game with random ghosts."""
    rows, ours = [], ['total, s', 'mean return', 'low', 'high']
    for game in (TAXI, UNIFORM):
        known = paper.TABLE_2[game.domain]
        for name, row in {**known, AS_IN_PAPER: known['human']}.items():
            if (game.name, name) in summary.index:
                rows.append([game.name, name, *row, *summary.loc[(game.name, name), ours]])
    columns = [*KEYS, "paper's seconds", "paper's average reward", 'seconds', 'mean return']
    return pd.DataFrame(rows, columns=[*columns, 'low', 'high'])


Value = tuple[str, Interval]  # what it is of, and its interval


class Results:
    """What there is of one game, by variant: means of each member, and the curves."""

    def __init__(self, game: ComparedGame, *tables: pd.DataFrame) -> None:
        """Take the members, points and curves of all games."""
        self.game = game
        self.members, self._points, self._curves = (
            {name: rows for (name,), rows in report.grouped(of[of['game'] == game.name], KEYS[1:])}
            for of in (table.reset_index() for table in tables)
        )

    def has(self, *names: str) -> bool:
        """Return whether there are results of all these variants."""
        return set(names) <= set(self.members)

    def more(self, first: str, second: str) -> Value:
        """Return how much more the first variant returns; with the same owners, within each."""
        one, other = (self.members[name].set_index('member')['mean'] for name in (first, second))
        paired = one.index.equals(other.index)
        more = Interval.of_difference(one, other, paired=paired)
        return f'return, {first} less {second}', more

    def race(self, first: str, second: str) -> Value:
        """
        Return the time of one variant as a part of another's until both come to the same.

        Plans with exact models end by themselves. Sampled ones take as long as they are let, so
        they are compared by the time of the first plans whose whole interval lies at or above a
        return: the highest that both come to so. Of one member there is none, and all is NaN.
        """
        if self.game.exact:
            one, other = (self.members[name]['seconds'] for name in (first, second))
            return f'time, {first} / {second}', Interval.of_ratio(one, other, paired=False)
        curves = [self._curves[name] for name in (first, second)]
        level = min(float(curve['low'].max()) for curve in curves)
        if math.isnan(level):
            return f'time, {first} / {second}', Interval(math.nan, math.nan, math.nan)
        budgets = [curve.loc[curve['low'] >= level, 'budget'].iloc[0] for curve in curves]
        points = [self._points[name] for name in (first, second)]
        one, other = (p.loc[p['budget'] == b, 'seconds'] for p, b in zip(points, budgets))
        named = f'time until {level:,.0f} points, {first} / {second}'
        return named, Interval.of_ratio(one, other, paired=False)

    def says(
        self, claim: Statement, verdict: bool | report.Mark | None, *values: Value, why: str = ''
    ) -> report.Comparison:
        """Return a claim beside the values that decide it, or why nothing does."""
        found = report.listed(self.game.name, dict(values)) if values else ''
        return report.compared(claim, '; '.join(filter(None, (found, why))), verdict)


def _claims(results: Results) -> Iterator[report.Comparison]:
    """Yield what the paper says of times and returns, and what planning shall gain over chance."""
    said, options = paper.SAID, [*filter(results.has, ('human', 'automatic'))]
    if results.has('primitive') and options:
        for each in options:
            time = results.race(each, 'primitive')
            yield results.says(said[f'{each}_faster'], time[1].below(1.0), time)
        losses = [results.more('primitive', each) for each in options]
        worse = all_hold(loss.above(ROUNDING) for _, loss in losses)
        yield results.says(said['never_as_good'], worse, *losses)
    if len(options) > 1:
        first, second = options
        time, more = results.race(first, second), results.more(first, second)
        verdict = all_hold([time[1].below(1.0), more[1].above(ROUNDING)])
        yield results.says(said['efficient'], verdict, time, more)
    if results.has('human', BY_CHANCE):
        gain = results.more('human', BY_CHANCE)
        planned, by_chance = (
            results.members[name]['mean'].mean() for name in ('human', BY_CHANCE)
        )
        share = f'random choice has {by_chance / planned:.0%}' if planned > 0 else ''
        claim = 'Planning with human options returns more than random choice among them.'
        yield results.says(Statement(claim, report.OURS), gain[1].above(ROUNDING), gain, why=share)
    if results.has('human', INTERRUPTED) and not results.game.exact:
        more = results.more(INTERRUPTED, 'human')
        yield results.says(said['interrupted'], more[1].above(), more)


def _numbers(results: Results) -> Iterator[report.Comparison]:
    """
    Yield the numbers of table 2 beside ours.

    Seconds are compared as parts of those of primitive actions: they agree where the interval
    holds the paper's part.
    """
    known, title = paper.TABLE_2[results.game.domain], results.game.name.partition(',')[0]
    human = AS_IN_PAPER if results.has(AS_IN_PAPER) else 'human'
    ours = {'primitive': 'primitive', 'human': human, 'automatic': 'automatic'}
    ours = {name: own for name, own in ours.items() if results.has(own)}
    if 'primitive' not in ours or results.game == CHASE:
        return
    for name, own in ours.items():
        said, part = f'{title}, {name}: {known[name][0]:g} s', known[name][0]
        if name == 'primitive':
            taken = 'seconds', Interval.of(results.members[own]['seconds'])
            claim, why = Statement(f'{said}.', 'table 2'), paper.WHY_NO_SECONDS
            yield results.says(claim, report.Mark.NOT_COMPARABLE, taken, why=why)
        else:
            part, time = part / known['primitive'][0], results.race(own, 'primitive')
            said += f', {part:.3g} of the time of primitive actions.'
            yield results.says(Statement(said, 'table 2'), time[1].holds(part), time)
    why = paper.WHY_NO_RETURN[results.game.domain]
    for name, own in ours.items():
        claim = Statement(f'{title}, {name}: average reward {known[name][1]:,g}.', 'table 2')
        returned = f'return, {own}', Interval.of(results.members[own]['mean'])
        yield results.says(claim, report.Mark.NOT_COMPARABLE, returned, why=why)
    if not results.game.exact:
        best = paper.SAID['incomplete']
        yield results.says(best, report.Mark.NO_COUNTERPART, why=paper.NO_BEST_KNOWN)


def _draw(game: ComparedGame, curves: pd.DataFrame, work: Drawing) -> None:
    axes, (unit, scale) = work.axes, ('ms', 1e3) if game.exact else ('s', 1.0)
    drawn = curves.assign(mean=curves['mean return'], seconds=scale * curves['seconds'])
    lines = {variant.name: variant.line for variant in VARIANTS}
    report.draw_curves(axes, drawn, 'action set', 'seconds', lines, ms=4, lw=1.3)
    axes.set(title=game.name, xlabel=f'planning time of a processor, {unit}', ylabel='mean return')
    axes.set_xscale('log')
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5))
