"""Table 2 in the report: what it says, the tables, and the curves."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial
import re
from typing import Any

from humanopts_teach.report.figures import Drawing, SERIES
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np

from experiments import paper, table2
from experiments.cells import code_version
from experiments.sections import Paint, Picture, Section, Table, Value
from experiments.study import Experiment, Study
from experiments.table2_kinds import AS_IN_PAPER, Game, GAMES, TAXI, UNIFORM
from experiments.table2_record import SECONDS
from experiments.table2_sampled import Setting
from experiments.table2_series import Gain, gather, gather_gains, Line
from experiments.table2_words import comparisons

TITLE = 'Table 2: planning time and return'
STYLES = {  # colour, line, marker by kind
    'primitive': (SERIES[0], '-', 'o'),
    'human': (SERIES[1], '-', 's'),
    AS_IN_PAPER: (SERIES[1], ':', 'x'),
    'automatic': (SERIES[2], '-', '^'),
    'human + primitive': (SERIES[1], '--', 'D'),
    'automatic + primitive': (SERIES[2], '--', 'v'),
    'human, interrupted': (SERIES[3], '-', 'P'),
    'human, modular (greatest mass)': (SERIES[4], '-.', '<'),
    'human, modular (strongest)': (SERIES[5], '-.', '>'),
}


def present(study: Study, results: Mapping[str, Any]) -> Section:
    """Return what the report says of the cells that have a result."""
    cells = table2.cells(study)
    lines, gains = gather(cells, results), gather_gains(cells, results)
    return Section(
        table2.NAME,
        TITLE,
        _text(study),
        comparisons(lines, gains),
        _pictures(lines),
        [
            *(_game_table(game, lines) for game in GAMES if any(x.game == game for x in lines)),
            _cost_table(lines),
            _gain_table(gains),
            _paper_table(lines),
            _curve_table(lines),
            _search_table(lines),
        ],
        {'code': code_version(), 'effort': asdict(table2.EFFORT)},
    )


EXPERIMENT = Experiment(table2.NAME, TITLE, table2.cells, present)


def _text(study: Study) -> list[str]:
    effort = table2.EFFORT
    return [
        'Planning seconds are those of a processor, not of the clock on the wall: policy tables '
        '(what the trees of learned options do in every state), models (of options; sampling is '
        'among them), and sweeps of value iteration. What it cost to get the options is told '
        'apart. Teaching minutes of simulated people are counted at the assumed pace of figure 2. '
        'Automatic options come as tables, so that theirs take no time.',
        'Taxi has exact models, so there are no parameters to search. Each plan is played once '
        'from every start state, and what varies is whose options they are.',
        'In Pac-Man models are sampled. For every action set, and the options of everybody, the '
        f'same {effort.tried} settings are tried with plans of {effort.search_steps:,} game steps '
        f'in {effort.search_games} games: the usual one, one that was found by hand with '
        'primitive actions, two with the reference options, and one that looks farther ahead. '
        'With the best of them, plans are made and judged '
        f'with other seeds, {effort.games} games each, from {effort.largest:,} game steps. '
        'Primitive actions alone have finer planning states, and their steps cost less: they get '
        f'{effort.primitive_search_steps:,} in the search and {effort.primitive_largest:,} then. '
        'Since a sampled plan takes as long as it is let, times are compared by when two curves '
        'come to the same return.',
        'Means are over people, extractions or repetitions; each counts once, with the mean of '
        f'its plans, so that there are at least {study.seeds} plans of each kind. Intervals are '
        "Student's t, 95 %; what varies is whose options they are and, in Pac-Man, the chance of "
        'the samples and games too. “Done” is the passenger delivered, or the maze cleared. '
        'Discounted returns are told where gamma is not searched for.',
        'Simulated people teach the options of section 7 and, in Pac-Man, “eat the ghost”, which '
        'people named in table 1: each scared ghost that is eaten counts 200 points, and no other '
        'option goes for them. The row “human, without eating ghosts” has only those of section '
        '7. They are taught where ghosts are random, and planned with in both games.',
    ]


def _game_table(game: Game, lines: Sequence[Line]) -> Table:
    rows: list[list[Value]] = []
    for line in lines:
        if line.game == game:
            value, done = line.value(), line.value('done')
            seconds = [line.mean(name) for name in SECONDS]
            rows.append(
                [
                    line.kind.name,
                    len(line.members),
                    *(round(x, 6) for x in (*seconds, line.seconds)),
                    round(line.mean('sweeps'), 1),
                    round(line.mean('states')),
                    round(line.mean('game_steps')),
                    value.mean,
                    value.low,
                    value.high,
                    line.value('discounted').mean if game.exact else None,
                    done.mean,
                    line.mean('fallbacks'),
                ]
            )
    columns = ['action set', 'count', 'tables, s', 'models, s', 'sweeps, s', 'total, s', 'sweeps']
    columns += ['states', 'game steps', 'mean return', 'low', 'high', 'discounted', 'done']
    columns += ['fallbacks in a game']
    return Table(f'table2-{_slug(game)}', game.name, columns, rows)


def _slug(game: Game) -> str:
    return re.sub(r'[^a-z]+', '-', game.name.lower())


def _cost_table(lines: Sequence[Line]) -> Table:
    """Return what it cost to get the options, each owner's once."""
    names = ('options', 'demonstrations', 'minutes', 'seconds', 'game_steps')
    found: dict[tuple[str, str], list[Value]] = {}
    for line in lines:
        costs = [line.cost(name) for name in names]
        if costs[0]:
            found[line.game.domain, line.kind.name] = [
                line.game.domain,
                line.kind.name,
                len(line.costs),
                *costs,
            ]
    columns = ['domain', 'action set', 'count', 'options', 'demonstrations', 'teaching minutes']
    columns += ['extraction seconds', 'extraction game steps']
    title = 'What it cost to get the options, mean of each'
    return Table('table2-acquisition', title, columns, list(found.values()))


def _gain_table(gains: Sequence[Gain]) -> Table:
    rows: list[list[Value]] = []
    for gain in gains:
        row: list[Value] = [gain.game.name, gain.kind.name, len(gain.values)]
        if gain.game.exact:
            least, mean, most = (float(x) for x in gain.states)
            rows.append([*row, 'value of a state', mean, None, None, least, most])
        else:
            found = gain.games
            rows.append([*row, 'return of games', found.mean, found.low, found.high, None, None])
    columns = ['game', 'carried out as', 'count', 'of', 'mean', 'low', 'high']
    columns += ['least of all states', 'most of all states']
    title = 'What the same plan gains over running each option to its end'
    return Table('table2-executions', title, columns, rows)


def _paper_table(lines: Sequence[Line]) -> Table:
    """Set the paper's numbers beside ours; in Pac-Man, beside the game with random ghosts."""
    mine = {(line.game.name, line.kind.name): line for line in lines}
    rows: list[list[Value]] = []
    for game in (TAXI, UNIFORM):
        known = paper.TABLE_2[game.domain]
        for name, row in {**known, AS_IN_PAPER: known['human']}.items():
            line = mine.get((game.name, name))
            if line is not None:
                value = line.value()
                ours: list[Value] = [round(line.seconds, 6), value.mean, value.low, value.high]
                rows.append([game.name, name, row.seconds, row.mean_return, *ours])
    columns = ['game', 'action set', "paper's seconds", "paper's average reward", 'seconds']
    title = "The paper's table, and ours"
    return Table('table2-paper', title, [*columns, 'mean return', 'low', 'high'], rows)


def _curve_table(lines: Sequence[Line]) -> Table:
    """Return exactly what is drawn."""
    rows: list[list[Value]] = [
        [
            line.game.name,
            line.kind.name,
            p.budget,
            p.seconds,
            p.value.mean,
            p.value.low,
            p.value.high,
        ]
        for line in lines
        for p in line.points
    ]
    columns = ['game', 'action set', 'budget', 'seconds', 'mean return', 'low', 'high']
    title = 'The curves; budgets are sweeps in Taxi, game steps in Pac-Man'
    return Table('table2-curves', title, columns, rows, shown=False)


def _search_table(lines: Sequence[Line]) -> Table:
    rows: list[list[Value]] = []
    for line in lines:
        for number, one in enumerate(line.members, start=1):
            if one['chosen'] is not None:
                tried = one['tried']
                best = [float(x) for x in (max(tried), np.mean(tried))]
                rows.append(
                    [line.game.name, line.kind.name, number, *one['chosen'].values(), *best]
                )
    columns = ['game', 'action set', 'number', *(part.name for part in fields(Setting))]
    columns += ['return in the search', 'mean of all tried']
    return Table('table2-settings', 'Settings that were chosen', columns, rows, shown=False)


def _pictures(lines: Sequence[Line]) -> list[Picture]:
    pictures = []
    for game in GAMES:
        mine = [line for line in lines if line.game == game]
        if mine:
            name, draw = f'table2-{_slug(game)}', partial(_draw, mine, game.name)
            label = f'Mean return in {game.name} by planning seconds and action set'
            caption = (
                f'{game.name}: mean return against planning time, '
                + ('sweeps' if game.exact else 'game steps')
                + ' doubled from point to point. Shaded: 95 % interval.'
            )
            pictures.append(Picture(name, label, (8.2, 4.2), draw, caption))
    return pictures


def _draw(lines: Sequence[Line], title: str, work: Drawing, paint: Paint) -> None:
    axes, exact = work.axes, lines[0].game.exact
    for line in lines:
        colour, style, marker = STYLES[line.kind.name]
        points, own = line.points, paint(colour)
        time = [p.seconds * (1e3 if exact else 1.0) for p in points]
        axes.plot(
            time,
            [p.value.mean for p in points],
            style,
            color=own,
            marker=marker,
            ms=4,
            lw=1.3,
            label=line.kind.name,
        )
        limits = [(p.value.low, p.value.high) for p in points]
        if all(low is not None for low, _ in limits):
            axes.fill_between(time, *np.array(limits).T, color=own, alpha=0.1, lw=0)
    unit = 'ms' if exact else 's'
    axes.set(title=title, xlabel=f'planning time of a processor, {unit}', ylabel='mean return')
    axes.set_xscale('log')
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(axis='y')
    axes.legend(loc='center left', bbox_to_anchor=(1.01, 0.5))
