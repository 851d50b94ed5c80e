"""Table 2 in the report: results as tables, beside the paper's numbers, and curves."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
import re
from typing import Any

from humanopts_teach.report.figures import Drawing
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
import pandas as pd

from experiments import paper, table2
from experiments.report import (
    compared,
    Comparison,
    Done,
    draw_curves,
    goal,
    grouped,
    listed,
    mean_intervals,
    Picture,
    Section,
    Table,
)
from experiments.table2 import (
    AS_IN_PAPER,
    CHASE,
    ComparedGame,
    GAMES,
    INTERRUPTING,
    SECONDS,
    TAXI,
    UNIFORM,
    VARIANTS,
)
from experiments.trials import code_version

TITLE = 'Table 2: planning time and return'
KEYS = ['game', 'action set']
ROUNDING = 1e-9  # reward units
WANTED_UNIFORM, WANTED_MORE = 1900.0, 300.0  # points
TENTH = 10.0
GOALS = (
    (
        UNIFORM,
        'Random ghosts: interrupted or as modules, human options come to '
        f'{WANTED_UNIFORM:,.0f} points and to no less than primitive actions, in a tenth of the '
        'planning time.',
    ),
    (
        CHASE,
        'Chasing ghosts: interrupted or as modules, human options come to '
        f'{WANTED_MORE:.0f} points more than run to their end, and to no less than primitive '
        'actions.',
    ),
)
STYLES = {  # colour, line, marker by variant
    'primitive': ('C0', '-', 'o'),
    'human': ('C1', '-', 's'),
    AS_IN_PAPER: ('C1', ':', 'x'),
    'automatic': ('C2', '-', '^'),
    'human + primitive': ('C1', '--', 'D'),
    'automatic + primitive': ('C2', '--', 'v'),
    'human, interrupted': ('C3', '-', 'P'),
    'human, modular (greatest mass)': ('C4', '-.', '<'),
    'human, modular (strongest)': ('C5', '-.', '>'),
}


def rows_of(done: Done, name: str, by: Sequence[str]) -> pd.DataFrame:
    """
    Return the rows of one table of all trials, with the number of the trial as ``member``.

    :param by: columns to order the rows by: games and variants stand as in ``table2``.
    """
    order = [one.name for one in (*GAMES, *VARIANTS)]
    rows = [
        {'domain': parameters['domain'], 'member': member, **row}
        for member, (parameters, result) in enumerate(done)
        for row in result[name]
    ]
    frame = pd.DataFrame(rows, columns=None if rows else ['domain', 'member', *by])
    return frame.sort_values(
        list(by), key=lambda names: names.map(order.index), kind='stable', ignore_index=True
    )


def summary_table(done: Done) -> pd.DataFrame:
    """Return a row for each game and variant, indexed by both; each member counts once."""
    plans = rows_of(done, 'plans', KEYS)
    if plans.empty:
        return pd.DataFrame(index=pd.MultiIndex.from_tuples([], names=KEYS))
    plans['seconds'] = plans[list(SECONDS)].sum(axis=1)
    members = plans.groupby([*KEYS, 'member'], sort=False).mean(numeric_only=True)
    means = members.groupby(KEYS, sort=False).mean()
    returns = mean_intervals(members.reset_index(), KEYS, 'mean').set_index(KEYS)
    exact = means.index.get_level_values('game') == TAXI.name
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
        'discounted': means['discounted'].where(exact),  # elsewhere gamma is searched for
        'done': means['done'],
        'fallbacks in a game': means['fallbacks'],
    }
    return pd.DataFrame(parts)


def curve_table(done: Done) -> pd.DataFrame:
    """Return mean return by budget; members whose curve has ended keep their last point."""
    points = rows_of(done, 'curve', KEYS)
    found = []
    for key, mine in grouped(points, KEYS):
        mine['seconds'] = mine[list(SECONDS)].sum(axis=1)
        wide = mine.set_index(['budget', 'member'])[['seconds', 'mean']].unstack('member').ffill()
        every = wide.stack('member', future_stack=True).reset_index()
        curve = mean_intervals(every, ['budget'], 'mean')
        curve['seconds'] = every.groupby('budget')['seconds'].mean().to_numpy()
        found.append(curve.assign(**dict(zip(KEYS, key))))
    columns = [*KEYS, 'budget', 'seconds', 'mean', 'low', 'high']
    every = pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=columns)
    return every[columns].rename(columns={'mean': 'mean return'})


def cost_table(done: Done) -> pd.DataFrame:
    """Return what it cost to get the options, mean of their owners."""
    names = {
        'options': 'options',
        'demonstrations': 'demonstrations',
        'minutes': 'teaching minutes',
        'seconds': 'extraction seconds',
        'game_steps': 'extraction game steps',
    }
    keys = ['domain', 'action set']
    owned = rows_of(done, 'costs', keys[1:]).reindex(columns=[*keys, *names])
    owned = owned[owned['options'] > 0].sort_values(
        'domain', key=lambda domains: domains.map(['taxi', 'pacman'].index), kind='stable'
    )
    groups = owned.astype(dict.fromkeys(names, float)).groupby(keys, sort=False)
    found = groups.mean().rename(columns=names)
    found.insert(0, 'count', groups.size())
    return found.reset_index()


def gain_table(done: Done) -> pd.DataFrame:
    """Return the gain of each execution of a plan over running each option to its end."""
    keys = ['game', 'carried out as']
    gains = rows_of(done, 'gains', keys).reindex(
        columns=[*keys, 'member', 'least', 'mean', 'most']
    )
    means = {'least': 'min', 'mean': 'mean', 'most': 'max'}
    members = gains.groupby([*keys, 'member'], sort=False).agg(means).astype(float)
    found = mean_intervals(members.reset_index(), keys, 'mean')
    extremes = members.groupby(keys, sort=False)
    found['least of all states'] = extremes['least'].min().to_numpy()
    found['most of all states'] = extremes['most'].max().to_numpy()
    exact = found['game'] == TAXI.name
    found[['low', 'high']] = found[['low', 'high']].mask(exact)
    found.insert(3, 'of', np.where(exact, 'value of a state', 'return of games'))
    return found


def paper_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Set the paper's numbers beside ours; in Pac-Man, beside the game with random ghosts."""
    rows = []
    for game in (TAXI, UNIFORM):
        known = paper.TABLE_2[game.domain]
        for name, row in {**known, AS_IN_PAPER: known['human']}.items():
            if (game.name, name) in summary.index:
                ours = summary.loc[(game.name, name), ['total, s', 'mean return', 'low', 'high']]
                rows.append([game.name, name, *row, *ours])
    columns = [*KEYS, "paper's seconds", "paper's average reward", 'seconds', 'mean return']
    return pd.DataFrame(rows, columns=[*columns, 'low', 'high'])


def setting_table(done: Done) -> pd.DataFrame:
    """Return the settings that were chosen, for each game, variant and member."""
    settings = rows_of(done, 'settings', KEYS)
    number = settings.groupby(KEYS, sort=False).cumcount() + 1
    settings.insert(4, 'number', number)
    return settings.drop(columns=['domain', 'member'])


def present(done: Done) -> Section:
    """Return the section of the report."""
    summary, curves, gains = summary_table(done), curve_table(done), gain_table(done)
    games = [game for game in GAMES if game.name in summary.index]
    return Section(
        table2.NAME,
        TITLE,
        [*_comparisons(summary, curves), *_compare_goals(summary), *_compare_gains(gains)],
        [_picture(game, curves[curves['game'] == game.name]) for game in games],
        [
            *(
                Table(f'table2-{_slug(game)}', game.name, summary.loc[game.name].reset_index())
                for game in games
            ),
            Table(
                'table2-acquisition',
                'What it cost to get the options, mean of each',
                cost_table(done),
            ),
            Table(
                'table2-executions',
                'What the same plan gains over running each option to its end',
                gains,
            ),
            Table('table2-paper', "The paper's table, and ours", paper_table(summary)),
            Table(
                'table2-curves',
                'The curves; budgets are sweeps in Taxi, game steps in Pac-Man',
                curves,
                shown=False,
            ),
            Table(
                'table2-settings', 'Settings that were chosen', setting_table(done), shown=False
            ),
        ],
        {'code': code_version(), 'effort': asdict(table2.EFFORT)},
    )


def _slug(game: ComparedGame) -> str:
    return re.sub(r'[^a-z]+', '-', game.name.lower())


def _comparisons(summary: pd.DataFrame, curves: pd.DataFrame) -> list[Comparison]:
    """Return what can be compared with the variants that there are."""
    found = []
    for game in GAMES:
        if game.name not in summary.index:
            continue
        rows: Any = summary.loc[game.name]
        mine = curves[curves['game'] == game.name]
        curve = {name: points for (name,), points in grouped(mine, ['action set'])}
        options = [name for name in ('human', 'automatic') if name in rows.index]
        if 'primitive' in rows.index and options:
            for name in options:
                faster, text = _race(game, rows, curve, name, 'primitive')
                found.append(compared(paper.TABLE_2_SAID[f'{name} faster'], text, faster))
            text = f'{game.name}, {_returns(rows, ["primitive", *options])}'
            returns = rows['mean return']
            worse = bool(returns[options].max() < returns['primitive'] - ROUNDING)
            found.append(compared(paper.TABLE_2_SAID['never as good'], text, worse))
        if len(options) > 1:
            faster, text = _race(game, rows, curve, *options)
            better = bool(rows.at['human', 'mean return'] > rows.at['automatic', 'mean return'])
            text += f'; {_returns(rows, options)}'
            found.append(compared(paper.TABLE_2_SAID['efficient'], text, faster and better))
    return found


def _race(
    game: ComparedGame,
    rows: Any,
    curve: Mapping[str, pd.DataFrame],
    first: str,
    second: str,
) -> tuple[bool, str]:
    """
    Return whether planning with one variant takes less time than with another, and both times.

    :param rows: data frame of a game, indexed by variant, as in ``_returns``.
    Plans with exact models end by themselves. Sampled ones take as long as they are let, so they
    are compared by the time that each needs for the best return of the worse of the two.
    """
    if game.exact:
        times = {name: float(rows.at[name, 'total, s']) for name in (first, second)}
        until = ''
    else:
        both = {name: curve[name] for name in (first, second)}
        level = min(float(points['mean return'].max()) for points in both.values())
        times = {
            name: float(points.loc[points['mean return'] >= level, 'seconds'].iloc[0])
            for name, points in both.items()
        }
        until = f' until {level:,.0f} points'
    text = listed({name: _duration(seconds) for name, seconds in times.items()})
    return times[first] < times[second], f'{game.name}, planning{until}: {text}'


def _compare_goals(summary: pd.DataFrame) -> list[Comparison]:
    """Compare the best way to interrupt human options with the goals of this project."""
    found = []
    for game, said in GOALS:
        rows: Any = summary.loc[game.name] if game.name in summary.index else summary
        mine = [variant.name for variant in INTERRUPTING if variant.name in rows.index]
        if not mine or not {'primitive', 'human'} <= set(rows.index):
            continue
        best = str(rows.loc[mine, 'mean return'].idxmax())
        shown = [best, 'human', 'primitive']
        value, human, primitive = rows.loc[shown, 'mean return']
        text = f'{game.name}, {_returns(rows, shown)}'
        wanted, quick = human + WANTED_MORE, True
        if game == UNIFORM:
            seconds = rows.loc[[best, 'primitive'], 'total, s']
            wanted, quick = WANTED_UNIFORM, TENTH * seconds[best] <= seconds['primitive']
            text += f'; planning: {listed({name: _duration(s) for name, s in seconds.items()})}'
        found.append(goal(said, text, bool(value >= max(wanted, primitive) and quick)))
    return found


def _compare_gains(gains: pd.DataFrame) -> list[Comparison]:
    """Compare what it gains to stop the options of the same plan."""
    found = []
    theorem = gains[gains['game'] == TAXI.name].set_index('carried out as')['least of all states']
    theorem = theorem[~theorem.index.str.contains('greatest mass')]  # it has none
    if len(theorem):
        text = listed({name: f'{value:+.2g}' for name, value in theorem.items()})
        said = (
            'Exact models: interrupted, or with the strongest module, no state is worth less '
            'than run to the end.'
        )
        text = f'least of all states and people: {text}'
        found.append(goal(said, text, bool(theorem.min() >= -ROUNDING)))
    for game in (UNIFORM, CHASE):
        mine = gains[gains['game'] == game.name].set_index('carried out as')
        if len(mine):
            text = listed({name: _interval(row, 'mean') for name, row in mine.iterrows()})
            text = f'{game.name}, points gained by the same plan over running to the end: {text}'
            gained = bool((mine['low'].fillna(mine['mean']) > 0.0).any())
            found.append(compared(paper.TABLE_2_SAID['interrupted'], text, gained))
    return found


def _returns(rows: Any, names: Sequence[str]) -> str:
    means = {name: _interval(rows.loc[name], 'mean return') for name in names}
    return f'return: {listed(means)}'


def _interval(row: Any, name: str) -> str:
    """Return a mean with its limits; of one member, the mean alone."""
    mean = float(row[name])
    if pd.isna(row['low']):
        return f'{mean:,.2f}'
    digits = 0 if abs(mean) >= 100 else 2
    return f'{mean:,.{digits}f} ({row["low"]:,.{digits}f} to {row["high"]:,.{digits}f})'


def _duration(seconds: float) -> str:
    return f'{1e3 * seconds:.3g} ms' if seconds < 0.1 else f'{seconds:.3g} s'


def _picture(game: ComparedGame, curves: pd.DataFrame) -> Picture:
    return Picture(
        f'table2-{_slug(game)}',
        f'Mean return in {game.name} by planning seconds and action set',
        (8.2, 4.2),
        partial(_draw, game, curves),
        f'{game.name}: mean return against planning time, '
        + ('sweeps' if game.exact else 'game steps')
        + ' doubled from point to point. Shaded: 95 % interval.',
    )


def _draw(game: ComparedGame, curves: pd.DataFrame, work: Drawing) -> None:
    axes, unit, scale = work.axes, 's', 1.0
    if game.exact:
        unit, scale = 'ms', 1e3
    drawn = curves.assign(mean=curves['mean return'], seconds=scale * curves['seconds'])
    draw_curves(axes, drawn, 'action set', 'seconds', STYLES, ms=4, lw=1.3)
    axes.set(title=game.name, xlabel=f'planning time of a processor, {unit}', ylabel='mean return')
    axes.set_xscale('log')
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5))
