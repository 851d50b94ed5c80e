"""Table 2 in the report: results as tables, beside the paper's numbers, and curves."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
import math
import re

from humanopts_learner.intervals import all_hold, any_holds, Interval, LEVEL, level_of_each
from humanopts_teach.report.figures import Drawing
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
import pandas as pd

from experiments import paper, table2
from experiments.learners import FOREST, NEIGHBOUR
from experiments.paper import Statement
from experiments.report import (
    compared,
    Comparison,
    Done,
    draw_curves,
    goal,
    grouped,
    listed,
    Mark,
    mean_intervals,
    Picture,
    Section,
    Table,
    written,
)
from experiments.table2 import (
    AS_IN_PAPER,
    BY_CHANCE,
    CHASE,
    ComparedGame,
    GAMES,
    INTERRUPTING,
    SECONDS,
    TAXI,
    TO_END,
    UNIFORM,
    VARIANTS,
)

TITLE = 'Table 2: planning time and return'
KEYS = ['game', 'action set']
EXECUTIONS = ['game', 'carried out as']
ROUNDING = 1e-9  # reward units
TABLE = 'table 2'
NO_BEST_KNOWN = 'the best policy of Pac-Man is not known: too many states, and models are sampled'
WHY_NO_SECONDS = 'seconds of another computer, and the paper does not say of which work'
WHY_NO_RETURN = {  # by domain, why the numbers of the paper cannot be compared
    'taxi': 'the paper does not say how it discounts',
    'pacman': 'the paper gives neither maze nor points, nor how its ghosts move',
}
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
    BY_CHANCE.name: ('C6', ':', '*'),
    'human, 5 options': ('C7', '-', 'p'),
    'human, 5 options, interrupted': ('C8', '-', 'h'),
    f'human, {NEIGHBOUR}': ('C7', ':', '1'),
    f'human, {FOREST}': ('C8', ':', '2'),
}


def rows_of(done: Done, name: str, by: Sequence[str]) -> pd.DataFrame:
    """
    Return the rows of one table of all trials, with the number of the trial as ``member``.

    :param by: columns to order the rows by: games and variants stand as in ``table2``.
    """
    order = [*(game.name for game in GAMES), *(variant.name for variant in VARIANTS)]
    rows = [
        {'domain': parameters['domain'], 'member': member, **row}
        for member, (parameters, result) in enumerate(done)
        for row in result[name]
    ]
    frame = pd.DataFrame(rows, columns=None if rows else ['domain', 'member', *by])
    return frame.sort_values(
        list(by), key=lambda names: names.map(order.index), kind='stable', ignore_index=True
    )


def member_table(done: Done) -> pd.DataFrame:
    """Return the means of each member's plans, indexed by game, variant and member."""
    plans = rows_of(done, 'plans', KEYS)
    plans['seconds'] = plans.reindex(columns=list(SECONDS)).sum(axis=1)
    return plans.groupby([*KEYS, 'member'], sort=False).mean(numeric_only=True)


def summary_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each game and variant, indexed by both; each member counts once."""
    if members.empty:
        return pd.DataFrame(index=pd.MultiIndex.from_tuples([], names=KEYS))
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


def point_table(done: Done) -> pd.DataFrame:
    """Return each member's curve by budget; one that has ended keeps its last point."""
    points = rows_of(done, 'curve', KEYS)
    found = []
    for key, mine in grouped(points, KEYS):
        mine['seconds'] = mine[list(SECONDS)].sum(axis=1)
        wide = mine.set_index(['budget', 'member'])[['seconds', 'mean']].unstack('member').ffill()
        every = wide.stack('member', future_stack=True).reset_index()
        found.append(every.assign(**dict(zip(KEYS, key))))
    columns = [*KEYS, 'budget', 'member', 'seconds', 'mean']
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=columns)


def curve_table(points: pd.DataFrame) -> pd.DataFrame:
    """Return mean return by budget, over members."""
    by = [*KEYS, 'budget']
    curves = mean_intervals(points, by, 'mean')
    curves['seconds'] = points.groupby(by, sort=False)['seconds'].mean().to_numpy()
    columns = [*by, 'seconds', 'mean', 'low', 'high']
    return curves[columns].rename(columns={'mean': 'mean return'})


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


def gain_of_members(done: Done) -> pd.DataFrame:
    """Return each member's gain by each execution of a plan over running options to their end."""
    gains = rows_of(done, 'gains', EXECUTIONS).reindex(
        columns=[*EXECUTIONS, 'member', 'least', 'mean', 'most']
    )
    means = {'least': 'min', 'mean': 'mean', 'most': 'max'}
    groups = gains.groupby([*EXECUTIONS, 'member'], sort=False)
    return groups.agg(means).astype(float).reset_index()


def gain_table(members: pd.DataFrame) -> pd.DataFrame:
    """Return the gain of each execution, over members."""
    found = mean_intervals(members, EXECUTIONS, 'mean')
    extremes = members.groupby(EXECUTIONS, sort=False)
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
    members, points, gains = member_table(done), point_table(done), gain_of_members(done)
    summary, curves = summary_table(members), curve_table(points)
    games = [game for game in GAMES if game.name in summary.index]
    return Section(
        table2.NAME,
        TITLE,
        [
            *_comparisons(members, points, curves),
            *_compare_numbers(members, points, curves),
            *_compare_with_chance(members),
            *_compare_goals(members),
            *_compare_gains(gains),
        ],
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
                gain_table(gains),
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
        {'effort': asdict(table2.EFFORT)},
    )


def _slug(game: ComparedGame) -> str:
    return re.sub(r'[^a-z]+', '-', game.name.lower())


def _comparisons(
    members: pd.DataFrame, points: pd.DataFrame, curves: pd.DataFrame
) -> list[Comparison]:
    """Return what can be compared with the variants that there are."""
    found = []
    for game in GAMES:
        rows = _in_game(members, game)
        options = [name for name in ('human', 'automatic') if name in rows]
        if 'primitive' in rows and options:
            for name in options:
                time, text = _race(game, rows, points, curves, name, 'primitive')
                said = paper.TABLE_2_SAID[f'{name} faster']
                found.append(compared(said, text, time.below(1.0)))
            losses = {name: _more(rows, 'primitive', name) for name in options}
            text = f'{game.name}, {_returns(rows, ["primitive", *options])}; primitive less '
            text += listed({name: _written(loss) for name, loss in losses.items()})
            worse = all_hold(loss.above(ROUNDING) for loss in losses.values())
            found.append(compared(paper.TABLE_2_SAID['never as good'], text, worse))
        if len(options) > 1:
            time, text = _race(game, rows, points, curves, 'human', 'automatic')
            more = _more(rows, 'human', 'automatic')
            text += f'; {_returns(rows, options)}; human less automatic {_written(more)}'
            verdict = all_hold([time.below(1.0), more.above(ROUNDING)])
            found.append(compared(paper.TABLE_2_SAID['efficient'], text, verdict))
    return found


def _compare_numbers(
    members: pd.DataFrame, points: pd.DataFrame, curves: pd.DataFrame
) -> list[Comparison]:
    """
    Compare the numbers of table 2 with ours, in Pac-Man those with random ghosts.

    Seconds are compared as parts of those of primitive actions: they agree where the interval
    holds the paper's part.
    """
    found = []
    for game in (TAXI, UNIFORM):
        rows, known = _in_game(members, game), paper.TABLE_2[game.domain]
        human = AS_IN_PAPER if AS_IN_PAPER in rows else 'human'
        ours = {'primitive': 'primitive', 'human': human, 'automatic': 'automatic'}
        ours = {name: own for name, own in ours.items() if own in rows}
        if 'primitive' not in ours:
            continue
        title, (all_of_it, _) = game.name.partition(',')[0], known['primitive']
        for name, own in ours.items():
            seconds, _ = known[name]
            said = f'{title}, {name}: {seconds:g} s'
            if name == 'primitive':
                text = f'{_duration(float(rows[own]["seconds"].mean()))}; {WHY_NO_SECONDS}'
                found.append(Comparison(f'{said}.', TABLE, text, Mark.NOT_COMPARABLE))
            else:
                part = seconds / all_of_it
                said += f', {part:.3g} of the time of primitive actions.'
                time, text = _race(game, rows, points, curves, own, 'primitive')
                found.append(compared(Statement(said, TABLE), text, time.holds(part)))
        for name, own in ours.items():
            text = f'{_written(Interval.of(rows[own]["mean"]))}; {WHY_NO_RETURN[game.domain]}'
            reward = f'{title}, {name}: average reward {known[name][1]:,g}.'
            found.append(Comparison(reward, TABLE, text, Mark.NOT_COMPARABLE))
    if found:
        best = paper.TABLE_2_SAID['incomplete']
        found.append(Comparison(best.text, best.where, NO_BEST_KNOWN, Mark.NO_COUNTERPART))
    return found


def _compare_with_chance(members: pd.DataFrame) -> list[Comparison]:
    """Compare plans with human options with random choice among the same options."""
    found = []
    said = 'Planning with human options returns more than random choice among them.'
    for game in GAMES:
        rows = _in_game(members, game)
        if {TO_END.name, BY_CHANCE.name} <= set(rows):
            gain = _more(rows, TO_END.name, BY_CHANCE.name)
            text = f'{game.name}, {_returns(rows, [TO_END.name, BY_CHANCE.name])}; '
            text += f'gain by planning {_written(gain)}'
            planned, by_chance = (rows[v.name]['mean'].mean() for v in (TO_END, BY_CHANCE))
            if planned > 0:
                text += f'; random choice has {by_chance / planned:.0%} of the return of the plan'
            found.append(goal(said, text, gain.above(ROUNDING)))
    return found


Rows = Mapping[str, pd.DataFrame]  # means of the members, by variant of one game


def _in_game(members: pd.DataFrame, game: ComparedGame) -> Rows:
    mine = members.reset_index()
    mine = mine[mine['game'] == game.name]
    return {name: rows.set_index('member') for (name,), rows in grouped(mine, ['action set'])}


def _race(
    game: ComparedGame,
    rows: Rows,
    points: pd.DataFrame,
    curves: pd.DataFrame,
    first: str,
    second: str,
) -> tuple[Interval, str]:
    """
    Return the planning time of one variant as a part of another's, and both times in words.

    Plans with exact models end by themselves. Sampled ones take as long as they are let, so they
    are compared by the time of the first plans whose whole interval lies at or above a return:
    the highest that both come to so. Of one member there is none, and all is NaN.
    """
    if game.exact:
        times = {name: rows[name]['seconds'] for name in (first, second)}
        until = ''
    else:
        both = {
            name: curves[(curves['game'] == game.name) & (curves['action set'] == name)]
            for name in (first, second)
        }
        level = min(float(curve['low'].max()) for curve in both.values())
        if math.isnan(level):
            nothing = Interval(math.nan, math.nan, math.nan)
            return nothing, f'{game.name}, planning: one owner of options each has no interval'
        times = {}
        for name, curve in both.items():
            budget = curve.loc[curve['low'] >= level, 'budget'].iloc[0]
            mine = points[(points['game'] == game.name) & (points['action set'] == name)]
            times[name] = mine.loc[mine['budget'] == budget, 'seconds']
        until = f' until {level:,.0f} points'
    ratio = Interval.of_ratio(times[first], times[second], paired=False)
    text = listed({name: _duration(float(seconds.mean())) for name, seconds in times.items()})
    text = f'{text}; {first} in {written(ratio, ".3g")} of the time of {second}'
    return ratio, f'{game.name}, planning{until}: {text}'


def _more(rows: Rows, first: str, second: str, level: float = LEVEL) -> Interval:
    """Return by how much more the first variant returns; with the same owners, within each."""
    one, other = rows[first]['mean'], rows[second]['mean']
    return Interval.of_difference(one, other, level, paired=one.index.equals(other.index))


def _compare_goals(members: pd.DataFrame) -> list[Comparison]:
    """
    Compare the best way to interrupt human options with the goals of this project.

    Since it is the best of several, its intervals are those that hold for all of them at once.
    """
    found = []
    for game, said in GOALS:
        rows = _in_game(members, game)
        mine = [variant.name for variant in INTERRUPTING if variant.name in rows]
        if not mine or not {'primitive', 'human'} <= set(rows):
            continue
        best = max(mine, key=lambda name: rows[name]['mean'].mean())
        level = level_of_each(len(mine))
        reached = Interval.of(rows[best]['mean'], level)
        less, more = (_more(rows, best, name, level) for name in ('primitive', 'human'))
        text = (
            f'{game.name}, {_returns(rows, ["human", "primitive"])}; best of {len(mine)}: {best} '
            f'{_written(reached)}, less primitive {_written(less)}'
        )
        if game == UNIFORM:
            times = {name: rows[name]['seconds'] for name in ('primitive', best)}
            slower = Interval.of_ratio(times['primitive'], times[best], level, paired=False)
            text += f'; planning: {listed({n: _duration(s.mean()) for n, s in times.items()})}'
            text += f', {written(slower, ".3g")} times as long'
            parts = [reached.at_least(WANTED_UNIFORM), slower.at_least(TENTH)]
        else:
            text += f', less human {_written(more)}'
            parts = [more.at_least(WANTED_MORE)]
        found.append(goal(said, text, all_hold([*parts, less.at_least(-ROUNDING)])))
    return found


def _compare_gains(gains: pd.DataFrame) -> list[Comparison]:
    """Compare what it gains to stop the options of the same plan."""
    found = []
    exact = gains[gains['game'] == TAXI.name].groupby('carried out as', sort=False)
    theorem = exact['least'].min()
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
        mine = gains[gains['game'] == game.name]
        if len(mine):
            level = level_of_each(mine['carried out as'].nunique())
            gained = {
                name: Interval.of(values['mean'], level)
                for (name,), values in grouped(mine, ['carried out as'])
            }
            text = listed({name: _written(gain) for name, gain in gained.items()})
            text = f'{game.name}, points gained by the same plan over running to the end: {text}'
            more = any_holds(gain.above() for gain in gained.values())
            found.append(compared(paper.TABLE_2_SAID['interrupted'], text, more))
    return found


def _returns(rows: Rows, names: Sequence[str]) -> str:
    return f'return: {listed({name: _written(Interval.of(rows[name]["mean"])) for name in names})}'


def _written(found: Interval) -> str:
    return written(found, ',.0f' if abs(found.mean) >= 100 else ',.2f')


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
