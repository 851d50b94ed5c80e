"""An evaluation as plain text, for terminals."""

import math
from typing import Any, TYPE_CHECKING

from humanopts_learner.demonstrations import METHODS
from humanopts_learner.options.judge import likely_range, Thresholds
from humanopts_learner.summary import (
    AGREEMENT,
    Criterion,
    IMITATION,
    OptionSummary,
    TERMINATION,
)
from humanopts_ros.limits import one_line
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation
from humanopts_teach.evaluation.games import gains
from humanopts_teach.evaluation.tables import rows_of, SECONDS
from humanopts_teach.text_table import table

if TYPE_CHECKING:
    import pandas as pd  # slow to import

MAX_POINTS = 12  # rows printed per learning curve
REPRODUCED = {
    True: 'equal to its option file in the bag, to the last digit',
    False: 'NOT equal to its option file in the bag',
}
CURVE = {  # printed columns of a learning curve
    'shown': 'n_demonstrations',
    'not here': 'n_not_here',
    'success': 'success',
    'agreement': 'agreement',
    'imitation': 'imitation',
    'return': 'return',
    'initiation': 'initiation',
    'termination': 'termination',
    'acc. policy': 'policy_accuracy',
    'acc. I': 'classification_accuracy_initiation',
    'acc. beta': 'classification_accuracy_termination',
    'criteria': 'criteria_met',
    'exam': 'exam_right',
    'learned': 'learned',
}


def evaluation_text(evaluation: BagEvaluation) -> str:
    """Return tables of all options, their learning curves and the plans."""
    domain, settings = evaluation.domain, evaluation.settings
    limits = settings.thresholds
    lines = [
        f'domain {domain.name}, seed {settings.seed}; criteria: {limits_text(limits)}',
    ]
    for option in evaluation.options:
        lines += ['', *_option(option)]
    if evaluation.plans:
        rows = [_plan(*row) for row in evaluation.plan_table.iterrows()]
        lines += ['', 'plans', table(rows, ['action set'])]
        lines += [
            f'{name} uses options that are not learned: {", ".join(unready)}'
            for name, plan in evaluation.plans.items()
            if (unready := evaluation.unready(plan))
        ]
    for person, games in evaluation.games.items():
        by = f' with the options of {person}' if len(evaluation.games) > 1 else ''
        lines += ['', f'{games["games"].max()} games each{by}', *games_text(games)]
    return '\n'.join(one_line(line) for text in lines for line in text.splitlines() or [''])


def limits_text(limits: Thresholds) -> str:
    """Return the thresholds of the criteria."""
    return (
        f'success ≥ {limits.success:g}, return ≤ {limits.return_share:g}, '
        f'initiation ≤ {limits.initiation_error:g}, termination ≤ {limits.termination_error:g}'
    )


def games_text(games: 'pd.DataFrame') -> list[str]:
    """Return lines that compare all policies, with 95 % intervals."""
    lines = []
    for setting, rows in games.groupby('setting', sort=False):
        outcomes = list(dict.fromkeys(name for each in rows['outcomes'] for name in each))
        head = str(setting) or 'policy'
        cells = [
            {
                head: row.name,
                'score': interval(row.score, row.score_low, row.score_high, 0),
                **{name: interval(**row.outcomes[name], digits=2) for name in outcomes},
                'planning s': number(row.seconds, 3),
            }
            for row in rows_of(rows)
        ]
        lines += ['', table(cells, [head])]
        lines += [
            f'{row.name} less {row.less}, game by game: {interval(row.mean, row.low, row.high, 0)}'
            for row in rows_of(gains(rows))
        ]
    return lines


def interval(mean: float, low: float, high: float, digits: int) -> str:
    """Return a mean and its interval."""
    texts = [f'{round(x, digits) + 0.0:.{digits}f}' for x in (mean, low, high)]  # no -0.00
    return f'{texts[0]} [{texts[1]}, {texts[2]}]'


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text, or - if it is missing."""
    return '-' if value is None or math.isnan(value) else f'{value:.{digits}g}'


def share(value: float) -> str:
    """Return a share as a percentage, or - if it is missing."""
    return '-' if math.isnan(value) else f'{100 * value:.1f}%'


def _option(option: OptionEvaluation) -> list[str]:
    learned, summary, learning = option.option, option.summary, option.learning
    shown = sorted({round(i * (len(learning) - 1) / (MAX_POINTS - 1)) for i in range(MAX_POINTS)})
    unused = {name for name in (AGREEMENT, IMITATION) if learning[name].isna().all()}
    rows = [
        {head: _cell(column, row) for head, column in CURVE.items() if column not in unused}
        for _, row in learning.iloc[shown].iterrows()
    ]
    lines = [
        f'{learned.name} (by {learned.participant or "-"}): {summary.status}',
        f'features: {", ".join(learned.features)}',
        f'policy: {METHODS[learned.method]}',
    ]
    if option.reproduced is not None:
        lines.append(f'learned again: {REPRODUCED[option.reproduced]}')
    lines += [
        f'mean return: demonstrations {number(summary.mean_return_demonstrations)}, '
        f'policy {number(summary.mean_return_policy)}',
        *(_unmet(c, summary) for c in summary.criteria if not c.met),
    ]
    if summary.more_needed > 0:
        low, high = likely_range(summary.more_needed)
        lines.append(f'perhaps {low} to {high} more demonstrations are needed')
    return [*lines, table(rows, [])]


def _cell(column: str, row: 'pd.Series') -> str:
    value = row[column]
    if column == 'exam_right':
        return f'{value}/{row.exam_runs}' if row.exam_runs else '-'
    if column.startswith('n_'):
        return str(value)
    if column in ('criteria_met', 'learned'):
        return 'yes' if value else 'no'
    return share(value) if 'accuracy' in column else number(value, 3)


def _unmet(criterion: Criterion, summary: OptionSummary) -> str:
    is_now = criterion.verdict if criterion.value is None else number(criterion.value)
    if criterion.undecided:
        side = 'least' if criterion.at_least else 'most'
        limit = f'at {side} {number(criterion.limit)} with 95 % confidence'
        is_now = f'{criterion.verdict}: about {is_now}, {limit}'
    if criterion.obstacle:
        return f'{criterion.name} is {is_now}: {criterion.obstacle}'
    if criterion.name == TERMINATION and criterion.value:
        early, late, never = summary.ended_early, summary.ended_late, summary.ended_never
        is_now += f' (early: {early}, late: {late}, never: {never})'
    side = 'more' if criterion.at_least else 'less'
    needs = f'needs {number(criterion.threshold)} or {side}'
    return f'not met: {criterion.name} is {is_now}, {needs}'


def _plan(name: Any, row: 'pd.Series') -> dict[str, str]:
    return {
        'action set': str(name),
        'gamma': number(row.gamma),
        'game steps': f'{row.game_steps:,}' if row.game_steps else '-',
        'planning ms': number(1e3 * sum(row[part] for part in SECONDS), 3),
        'sweeps': str(row.sweeps),
        'episodes': str(row.episodes),
        'mean return': number(row.mean_return),
        '95 % interval': f'{number(row.mean_return_low)} to {number(row.mean_return_high)}',
        'all starts': number(row.exact_mean_return),
        'discounted': number(row.mean_discounted_return),
        **({'random moves': str(row.random_moves)} if row.game_steps else {}),
    }
