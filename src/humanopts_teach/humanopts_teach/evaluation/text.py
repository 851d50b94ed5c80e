"""An evaluation as plain text, for terminals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from humanopts_learner.options.criteria import Criterion
from humanopts_teach.evaluation.planning import PlanningRow

if TYPE_CHECKING:  # it imports this module
    from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation

MOST_POINTS = 12  # of a learning curve that are printed
CURVE_HEAD = ('shown', 'not here', 'return', 'E_I', 'E_beta', 'policy', 'I', 'beta', 'met')
PLAN_HEAD = ('action set', 'gamma', 'planning ms', 'sweeps', 'mean return', 'discounted')


def evaluation_text(evaluation: 'BagEvaluation') -> str:
    """Return tables of every option, its learning curve and the plans."""
    domain, settings = evaluation.domain, evaluation.settings
    limits = settings.thresholds
    lines = [
        f'domain {domain.name}, seed {settings.seed}; criteria: return shortfall <= '
        f'{limits.return_delta:g}, E_I <= {limits.initiation_error:g}, '
        f'E_beta <= {limits.termination_error:g}',
    ]
    for option in evaluation.options:
        lines += ['', *_option(option)]
    if evaluation.plans:
        lines += ['', 'plans']
        rows = zip(evaluation.plan_names, evaluation.planning)
        lines += table(PLAN_HEAD, [_plan(name, row) for name, row in rows])
    return '\n'.join(lines)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines with the columns aligned, the first to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(head, *rows)]
    return [
        '  '.join(
            cell.rjust(width) if place else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in (head, ['-' * width for width in widths], *rows)
    ]


def number(value: float | None, digits: int = 4) -> str:
    """Return a number, or - where there is none."""
    return '-' if value is None else f'{value:.{digits}g}'


def share(value: float | None) -> str:
    """Return a percentage, or - where there is none."""
    return '-' if value is None else f'{100 * value:.1f}%'


def _option(option: 'OptionEvaluation') -> list[str]:
    block = option.block
    met = 'all criteria met' if block.criteria_met else 'criteria not met'
    points = option.curve
    chosen = sorted({round(i * (len(points) - 1) / (MOST_POINTS - 1)) for i in range(MOST_POINTS)})
    rows = [
        [
            str(point.n_demonstrations),
            str(point.n_not_here),
            *(number(criterion.value, 3) for criterion in point.criteria),
            share(point.policy_accuracy),
            share(point.classification_accuracy_initiation),
            share(point.classification_accuracy_termination),
            'yes' if point.criteria_met else 'no',
        ]
        for point in (points[i] for i in chosen)
    ]
    return [
        f'{block.name} (by {option.participant or "-"}): {met}',
        f'features: {", ".join(block.features)}',
        f'mean return: demonstrations {number(block.mean_return_demonstrations)}, '
        f'learned policy {number(block.mean_return_policy)}',
        *(f'not met: {_unmet(c)}' for c in option.judgement.criteria if not c.met),
        *table(CURVE_HEAD, rows),
    ]


def _unmet(criterion: Criterion) -> str:
    value = 'not yet measurable' if criterion.value is None else number(criterion.value)
    return f'{criterion.name} is {value}, needs {number(criterion.threshold)} or less'


def _plan(name: str, row: PlanningRow) -> list[str]:
    return [
        name,
        number(row.gamma),
        number(1e3 * (row.table_seconds + row.model_seconds + row.sweep_seconds), 3),
        str(row.sweeps),
        number(row.mean_return),
        number(row.mean_discounted_return),
    ]
