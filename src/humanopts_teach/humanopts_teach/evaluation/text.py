"""An evaluation as plain text, for terminals."""

from collections.abc import Sequence

from humanopts_learner.demonstrations import METHODS
from humanopts_learner.intervals import Interval
from humanopts_learner.options.criteria import likely_range, Thresholds
from humanopts_learner.summary import Criterion, NO_RANGE
from humanopts_ros.limits import one_line
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    OptionEvaluation,
    PlanEvaluation,
)
from humanopts_teach.evaluation.games import GamesEvaluation, PLAN, RANDOM
from humanopts_teach.text_table import aligned

A_TENTH = 'a tenth of the range from random actions to the demonstrations'
MOST_POINTS = 12  # of a learning curve that are printed
REPRODUCED = {
    True: 'equal to its option file in the bag, to the last digit',
    False: 'NOT equal to its option file in the bag',
}
CURVE_HEAD = (
    *('shown', 'not here', 'return', 'initiation', 'termination'),
    *('acc. policy', 'acc. I', 'acc. beta', 'met'),
)
PLAN_HEAD = (
    *('action set', 'gamma', 'game steps', 'planning ms', 'sweeps'),
    *('episodes', 'mean return', '95 % interval', 'all starts', 'discounted'),
)


def evaluation_text(evaluation: BagEvaluation) -> str:
    """Return tables of every option, its learning curve and the plans."""
    domain, settings = evaluation.domain, evaluation.settings
    limits = settings.thresholds
    lines = [
        f'domain {domain.name}, seed {settings.seed}; criteria: return <= '
        f'{return_limit(limits)}, initiation <= {limits.initiation_error:g}, '
        f'termination <= {limits.termination_error:g}',
    ]
    for option in evaluation.options:
        lines += ['', *_option(option)]
    if evaluation.plans:
        lines += ['', 'plans']
        plans = evaluation.named_plans.items()
        lines += table(PLAN_HEAD, [_plan(name, plan) for name, plan in plans])
        lines += [
            f'{name} uses options whose criteria do not hold: {", ".join(unready)}'
            for name, plan in plans
            if (unready := evaluation.unready(plan))
        ]
    for person, games in evaluation.games.items():
        whose = f' with the options of {person}' if len(evaluation.games) > 1 else ''
        lines += ['', f'{games.games} games each{whose}', *games_text(games)]
    return '\n'.join(map(one_line, lines))


def return_limit(limits: Thresholds) -> str:
    """Return how much the return may fall short."""
    return A_TENTH if limits.return_delta is None else f'{limits.return_delta:g}'


def criteria_text(option: OptionEvaluation) -> str:
    """Return whether the criteria of an option are met."""
    judgement = option.last.judgement
    if judgement.criteria_met:
        return 'criteria met'
    if judgement.settled:
        return 'the return cannot be measured, the other criteria are met'
    return 'criteria not met'


def games_text(games: GamesEvaluation) -> list[str]:
    """Return lines that compare all ways to play, with 95 % intervals, and the curves."""
    lines = []
    for setting in games.settings:
        outcomes = list(dict.fromkeys(name for row in setting.rows for name in row.outcomes))
        head = (setting.name or 'plays by', 'score', *outcomes, 'planning s')
        rows = [
            [
                row.name,
                interval(row.score, 0),
                *(interval(row.outcomes[name], 2) for name in outcomes),
                '-' if row.seconds is None else f'{row.seconds:.1f}',
            ]
            for row in setting.rows
        ]
        gain = f'{setting.largest(PLAN).name} less {setting.largest(RANDOM).name}, game by game'
        lines += ['', *table(head, rows), f'{gain}: {interval(setting.gain, 0)}']
        if setting.over_rule is not None:
            plan, rule, more = setting.over_rule
            lines.append(f'{plan.name} less {rule.name}, game by game: {interval(more, 0)}')
    for target in games.targets:
        reached = [f'{curve.name} {curve.reached(target)}' for curve in games.curves]
        lines.append(f'planning to a score of {target:.0f}: {", ".join(reached)}')
    return lines


def interval(found: Interval, digits: int) -> str:
    """Return a mean and its interval."""
    numbers = found.mean, found.low, found.high
    mean, low, high = (f'{round(x, digits) + 0.0:.{digits}f}' for x in numbers)  # no -0.00
    return f'{mean} [{low}, {high}]'


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines with the columns aligned, the first to the left and the others to the right."""
    rule = ['-' * max(map(len, column)) for column in zip(head, *rows)]
    return aligned([head, rule, *rows], [column > 0 for column in range(len(head))])


def number(value: float | None, digits: int = 4) -> str:
    """Return a number, or - where there is none."""
    return '-' if value is None else f'{value:.{digits}g}'


def share(value: float | None) -> str:
    """Return a percentage, or - where there is none."""
    return '-' if value is None else f'{100 * value:.1f}%'


def _option(option: OptionEvaluation) -> list[str]:
    block, judgement = option.last.block, option.last.judgement
    points = option.curve
    chosen = sorted({round(i * (len(points) - 1) / (MOST_POINTS - 1)) for i in range(MOST_POINTS)})
    rows = [
        [
            str(point.block.n_demonstrations),
            str(point.option.n_not_here),
            *(number(criterion.value, 3) for criterion in point.judgement.criteria),
            share(point.block.policy_accuracy),
            share(point.block.classification_accuracy_initiation),
            share(point.block.classification_accuracy_termination),
            'yes' if point.block.criteria_met else 'no',
        ]
        for point in (points[i] for i in chosen)
    ]
    lines = [
        f'{block.name} (by {option.participant or "-"}): {criteria_text(option)}',
        f'features: {", ".join(block.features)}',
        f'policy: {METHODS[block.method]}',
    ]
    if option.reproduced is not None:
        lines.append(f'learned again: {REPRODUCED[option.reproduced]}')
    lines += [
        f'mean return: demonstrations {number(block.mean_return_demonstrations)}, '
        f'policy {number(block.mean_return_policy)}',
        *(f'not met: {_unmet(c)}' for c in judgement.criteria if not c.met),
    ]
    if judgement.more_needed > 0:
        low, high = likely_range(judgement.more_needed)
        lines.append(f'perhaps {low} to {high} more demonstrations are needed')
    return [*lines, *table(CURVE_HEAD, rows)]


def _unmet(criterion: Criterion) -> str:
    is_now = criterion.verdict if criterion.value is None else number(criterion.value)
    if criterion.undecided:
        limit = f'at most {number(criterion.high)} with 95 % confidence'
        is_now = f'{criterion.verdict}: about {is_now}, {limit}'
    if criterion.no_range:
        return f'{criterion.name} is {is_now}: {NO_RANGE}'
    needs = A_TENTH if criterion.threshold is None else number(criterion.threshold)
    return f'{criterion.name} is {is_now}, needs {needs} or less'


def _plan(name: str, plan: PlanEvaluation) -> list[str]:
    row = plan.row
    return [
        name,
        number(row.gamma),
        f'{row.game_steps:,}' if row.game_steps else '-',
        number(1e3 * row.seconds, 3),
        str(row.sweeps),
        str(row.episodes),
        number(row.mean_return),
        f'{number(row.mean_return_low)} to {number(row.mean_return_high)}',
        number(plan.exact_mean_return),
        number(row.mean_discounted_return),
    ]
