"""What came out in many games: in a few sentences, and as a table."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from humanopts_learner.planning.evaluate import Interval
from humanopts_learner.planning.sampled.comparison import CHANCE, ComparisonRow, PLAN
from humanopts_teach.evaluation.games import Curve, GamesEvaluation, Setting, TENFOLD
from humanopts_teach.report.words import DASH, Finding

MARGIN = 80.0  # points by which a plan shall be better than random choice among its options


@dataclass(frozen=True)
class GamesCell:
    """A mean and its interval, as they are written."""

    mean: str
    bounds: str


@dataclass(frozen=True)
class GamesTable:
    """The results in all settings side by side."""

    settings: list[str]
    measures: list[str]  # of each setting
    rows: list[tuple[str, list[GamesCell], str]]  # name, cells of all settings, planning seconds


def games_table(games: GamesEvaluation) -> GamesTable:
    """Lay out the results."""
    first = games.settings[0].rows
    outcomes = list(first[0].outcomes)
    rows = []
    for place, row in enumerate(first):
        cells, seconds = [], []
        for setting in games.settings:
            found = setting.rows[place]
            cells.append(_cell(found.score, 0))
            cells += [_cell(found.outcomes[name], 2) for name in outcomes]
            seconds.append(DASH if found.seconds is None else f'{found.seconds:.1f}')
        rows.append((row.name, cells, ' / '.join(dict.fromkeys(seconds))))
    return GamesTable([s.name for s in games.settings], ['score', *outcomes], rows)


def _cell(found: Interval, digits: int) -> GamesCell:
    low, high = max(found.low, 0.0) if found.mean >= 0 else found.low, found.high
    return GamesCell(*(f'{found.mean:,.{digits}f}', f'{low:,.{digits}f} to {high:,.{digits}f}'))


def reached(curve: Curve, target: float) -> str:
    """Say when a score was reached."""
    seconds = curve.seconds_to_reach(target)
    if seconds is None:
        return f'not reached in {curve.most_seconds:.1f} s'
    return f'in {seconds:.1f} s'


def games_findings(games: GamesEvaluation) -> list[Finding]:
    """Return what the games come to."""
    found = [_scores(games, setting) for setting in games.settings]
    planned = _largest(games.settings[0].rows, PLAN)
    found += _targets(games, planned)
    return [*found, *(_time(games.curves, target) for target in games.targets)]


def _scores(games: GamesEvaluation, setting: Setting) -> Finding:
    """Say what the options came to, and by how much that is better than chance among them."""
    planned, chance = (_largest(setting.rows, kind) for kind in (PLAN, CHANCE))
    gap, half = _difference(planned.score, chance.score)
    where = f'With {setting.name}, ' if setting.name else ''
    best = max(setting.rows, key=lambda row: row.score.mean)
    others = f' The best of all is “{best.name}” with {best.score.mean:,.0f}.'
    text = (
        f'{where}“{planned.name}” scores {_written(planned.score)} in {games.games:,} games: '
        f'{abs(gap):,.0f} ± {half:,.0f} {"more" if gap >= 0 else "less"} than random choice among '
        'the same options.'
        f'{others if best is not planned else ""}'
    )
    good = gap >= MARGIN if games.targets and setting.name == games.curve_setting else None
    return Finding(good, text)


def _targets(games: GamesEvaluation, planned: ComparisonRow) -> list[Finding]:
    if not games.targets:
        return []
    target = max(games.targets)
    verb = 'reaches' if planned.score.mean >= target else 'does not reach'
    text = f'“{planned.name}” {verb} a mean score of {target:,.0f} with {games.curve_setting}.'
    return [Finding(planned.score.mean >= target, text)]


def _time(curves: Sequence[Curve], target: float) -> Finding:
    """Say whether options reached a score in a tenth of the time of primitive actions."""
    options, primitive = curves
    quick, slow = options.seconds_to_reach(target), primitive.seconds_to_reach(target)
    both = ', '.join(f'with {curve.name} {reached(curve, target)}' for curve in curves)
    text = f'Planning to a score of {target:,.0f} (the whole interval above it): {both}'
    if quick is None:
        return Finding(False, f'{text}.')
    times = (primitive.most_seconds if slow is None else slow) / quick
    if slow is None:
        good = True if times >= TENFOLD else None
        undecided = '' if good else '; whether it takes ten times as long is not decided'
        return Finding(good, f'{text}: more than {_times(times)} times as long{undecided}.')
    return Finding(times >= TENFOLD, f'{text}: {_times(times)} times as long.')


def _times(times: float) -> str:
    return f'{math.floor(times * 10) / 10:g}' if times < TENFOLD else f'{math.floor(times)}'


def _largest(rows: Sequence[ComparisonRow], kind: str) -> ComparisonRow:
    """Return the row of the largest set of options, of one kind."""
    return max((row for row in rows if row.kind == kind), key=lambda row: len(row.options))


def _difference(one: Interval, other: Interval) -> tuple[float, float]:
    """Return the difference of two independent means, and half its 95 % interval."""
    half = math.hypot(one.high - one.mean, other.high - other.mean)
    return one.mean - other.mean, half


def _written(found: Interval) -> str:
    return f'{found.mean:,.0f} ± {found.high - found.mean:,.0f}'
