"""What ways to play came to in many games, and score against planning time."""

from collections.abc import Callable, Sequence

from humanopts_learner.planning.evaluate import Interval
from humanopts_learner.planning.sampled.comparison import ComparisonRow
from humanopts_teach.evaluation.games import Curve, GamesEvaluation, Setting
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing, MUTED, SERIES
from humanopts_teach.report.games_words import reached
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator, PercentFormatter

MARKERS = 'osD^'
WIDTH, ROW_HEIGHT = 5.6, 0.33  # inches
CLEARED = 'cleared'


def games_figures(games: GamesEvaluation, name: str) -> list[CaptionedFigure]:
    """
    Return the scores, the share of mazes cleared where there are mazes, and the curves.

    :param name: prefix of the identifiers.
    """
    figures = [
        _intervals(games.settings, f'{name}-score', 'Mean score', 'points', lambda row: row.score)
    ]
    if all(CLEARED in row.outcomes for setting in games.settings for row in setting.rows):
        title, unit = 'Mazes cleared', 'share of games'
        figures.append(
            _intervals(
                games.settings, f'{name}-cleared', title, unit, lambda row: row.outcomes[CLEARED]
            )
        )
    return [*map(CaptionedFigure, figures), CaptionedFigure(_curves(games, f'{name}-curve'))]


def _intervals(
    settings: Sequence[Setting],
    name: str,
    title: str,
    unit: str,
    value: Callable[[ComparisonRow], Interval],
) -> str:
    names = [row.name for row in settings[0].rows]
    height = 1.2 + ROW_HEIGHT * len(names)
    with drawing(name, f'{title} by what plays, with 95 % intervals', WIDTH, height) as work:
        axes = work.axes
        for place, setting in enumerate(settings):
            shift = 0.2 * (place - (len(settings) - 1) / 2)
            for row, found in enumerate(map(value, setting.rows)):
                _dot(work, found, row + shift, place, setting.name if not row else '')
        for row, (one, other) in enumerate(zip(settings[0].rows, settings[0].rows[1:])):
            if one.kind != other.kind:
                axes.axhline(row + 0.5, color=MUTED, lw=0.6, alpha=0.5)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set(title=title, xlabel=f'{unit}, with 95 % interval')
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        if unit.startswith('share'):
            axes.set_xlim(-0.02, 1.02)
            axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.grid(axis='x')
        axes.tick_params(length=0)
        if settings[0].name:
            work.figure.legend(loc='outside lower center', ncols=len(settings))
    return work.svg


def _dot(work: Drawing, found: Interval, height: float, place: int, label: str) -> None:
    color = SERIES[place % len(SERIES)]
    work.axes.plot([found.low, found.high], [height, height], color=color, lw=2.0)
    work.axes.plot(
        found.mean,
        height,
        color=color,
        marker=MARKERS[place % len(MARKERS)],
        ms=4.5,
        ls='',
        label=label or None,
    )


def _curves(games: GamesEvaluation, name: str) -> str:
    where = f', {games.curve_setting}' if games.curve_setting else ''
    with drawing(name, f'Mean score by planning seconds{where}', WIDTH, 4.4) as work:
        axes = work.axes
        for place, curve in enumerate(games.curves):
            seconds = [row.seconds for row in curve.rows]
            color, marker = SERIES[place % len(SERIES)], MARKERS[place % len(MARKERS)]
            low, high = (
                [getattr(r.score, bound) for r in curve.rows] for bound in ('low', 'high')
            )
            axes.fill_between(seconds, low, high, color=color, alpha=0.2, lw=0)
            means = [row.score.mean for row in curve.rows]
            label = _label(curve, games.targets)
            axes.plot(seconds, means, color=color, marker=marker, ms=4.5, label=label)
        for target in games.targets:
            axes.axhline(target, color=MUTED, ls='--', lw=1.0)
            axes.annotate(
                f'{target:,.0f}',
                (1.0, target),
                xycoords=('axes fraction', 'data'),
                xytext=(3, 0),
                textcoords='offset points',
                va='center',
                size=8.5,
                color=MUTED,
            )
        axes.set_xscale('log')
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f'{x:g}'))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set(
            title=f'Score against planning time{where}',
            xlabel='planning seconds of the processor (models counted)',
            ylabel='mean score, with 95 % interval',
        )
        axes.grid()
        axes.tick_params(which='both', length=0)
        work.figure.legend(loc='outside lower left', ncols=1)
    return work.svg


def _label(curve: Curve, targets: Sequence[float]) -> str:
    times = [f'{target:,.0f} {reached(curve, target)}' for target in targets]
    return ': '.join([curve.name, ', '.join(times)]) if times else curve.name
