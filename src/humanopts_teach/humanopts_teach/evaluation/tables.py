"""
The tables of an evaluation: what their columns are, and the rows of options and plans.

They are pandas DataFrames. A number that is not known is NaN in a table, and null in JSON.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import reference_options
from humanopts_learner.intervals import Interval
from humanopts_learner.options.accuracy import classification_accuracy, policy_accuracy
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.summary import OptionSummary, PlanSummary

if TYPE_CHECKING:
    import pandas as pd  # slow to import


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    dtype: str  # of pandas; ``object``: values of Python, as they are in JSON
    text: str  # what it holds, with its unit
    live: bool = True  # seen live, too; what a bag alone gives must equal it to the last digit


OPTIONS = {  # a row for an option after each of its demonstrations; many are an OptionSummary's
    'participant': Column('object', 'code of the person who taught'),
    'option_name': Column('object', 'name'),
    'features': Column('object', 'names of the features that it depends on'),
    'method': Column('object', 'learning method'),
    'n_demonstrations': Column('int64', 'trajectories'),
    'n_not_here': Column('int64', '"not here" answers'),
    'mean_return_demonstrations': Column('float64', 'undiscounted, reward units'),
    'mean_return_policy': Column('float64', 'from the same starts, undiscounted, reward units'),
    'return': Column('float64', 'shortfall of the return, reward units'),
    'initiation': Column('float64', 'held-out balanced error of I, 0 to 1'),
    'termination': Column('float64', 'held-out balanced error of beta, 0 to 1'),
    'policy_accuracy': Column('float64', 'share of states with one of the best actions'),
    'classification_accuracy_initiation': Column('float64', 'share of states, of I'),
    'classification_accuracy_termination': Column('float64', 'share of states, of beta'),
    'criteria_met': Column('bool', 'whether all three criteria are met'),
    'return_high': Column('float64', 'upper confidence limit of the shortfall', live=False),
    'return_threshold': Column('float64', 'largest shortfall allowed', live=False),
    'initiation_threshold': Column('float64', 'largest error allowed', live=False),
    'termination_threshold': Column('float64', 'largest error allowed', live=False),
    'gain': Column('float64', 'return of the policy less that shown, reward units', live=False),
    'gain_low': Column('float64', '95 % interval of the gain', live=False),
    'gain_high': Column('float64', '95 % interval of the gain', live=False),
    'seconds': Column('float64', "of the person's time so far", live=False),
}
PLANS = {
    'participant': Column('object', 'whose options; empty: primitive actions', live=False),
    'action_set': Column('object', 'human or primitive'),
    'gamma': Column('float64', 'discount of a step'),
    'game_steps': Column('int64', 'that models were sampled from; 0: models are exact'),
    'table_seconds': Column('float64', 'of evaluating policies in every state', live=False),
    'model_seconds': Column('float64', 'of models', live=False),
    'sweep_seconds': Column('float64', 'of value iteration', live=False),
    'sweeps': Column('int64', 'of value iteration'),
    'residual': Column('float64', 'largest change of the last sweep, reward units'),
    'converged': Column('bool', 'whether the residual is within the tolerance'),
    'episodes': Column('int64', 'in which it was judged'),
    'mean_return': Column('float64', 'undiscounted, reward units'),
    'mean_return_low': Column('float64', '95 % interval'),
    'mean_return_high': Column('float64', '95 % interval'),
    'mean_discounted_return': Column('float64', 'reward units'),
    'exact_mean_return': Column('float64', 'over all start states', live=False),
    'fallbacks': Column('int64', 'primitive actions because no option could start'),
    'outcomes': Column('object', 'mean, low and high of each outcome of the domain, by name'),
}
GAMES = {  # a row for each policy in each variant of a game
    'setting': Column('object', 'variant, such as ghosts=chase; empty: there is one'),
    'name': Column('object', 'of the policy'),
    'kind': Column('object', 'plan, chance or rule'),
    'options': Column('object', 'names of the learned options that it chooses among'),
    'games': Column('int64', 'that it played'),
    'score': Column('float64', 'mean'),
    'score_low': Column('float64', '95 % interval'),
    'score_high': Column('float64', '95 % interval'),
    'outcomes': Column('object', 'mean, low and high of each outcome of the domain, by name'),
    'decisions': Column('float64', 'options and actions begun in a game, mean'),
    'fallbacks': Column('float64', 'of these, because no option could start, mean'),
    'game_steps': Column('int64', 'that planning sampled'),
    'seconds': Column('float64', 'of the processor, of planning'),
}
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')  # planning time


def table(columns: Mapping[str, Column], rows: Iterable[Any]) -> 'pd.DataFrame':
    """
    Return rows as a table.

    :param rows: values by column; those of other names are left out, and missing ones are NaN.
    """
    import pandas as pd

    frame = pd.DataFrame(rows, columns=list(columns))
    return frame.astype({name: column.dtype for name, column in columns.items()})


def records(frame: 'pd.DataFrame') -> list[dict[str, Any]]:
    """Return the rows as JSON data."""
    plain = frame.astype(object)
    found: Any = plain.where(plain.notna(), None).to_dict('records')
    return list(found)


def rows_of(frame: Any) -> Iterator[Any]:
    """Yield the rows of a table: ``Index``, and attributes by column."""
    yield from frame.itertuples()


def accuracies(option: LearnedOption, domain: Domain[Any]) -> dict[str, float | None]:
    """Return the accuracies of policy, I and beta by column; None where they are not known."""
    names = [name for name in OPTIONS if 'accuracy' in name]
    reference = reference_options(domain).get(option.name)
    if reference is None:
        return dict.fromkeys(names)
    values = (
        policy_accuracy(option, domain, reference),
        *classification_accuracy(option, domain, reference),
    )
    return dict(zip(names, map(finite, values), strict=True))


def option_row(
    summary: OptionSummary,
    option: LearnedOption,
    domain: Domain[Any],
    seconds: float = math.nan,
) -> dict[str, Any]:
    """
    Return the row of a learned option.

    :param summary: of the demonstrations that it was learned from.
    :param seconds: of the person's time.
    """
    found = {name: getattr(summary, name, math.nan) for name in OPTIONS}
    found |= {'features': tuple(option.features), 'seconds': seconds}
    found |= {'gain': summary.gain.mean}
    found |= {'gain_low': summary.gain.low, 'gain_high': summary.gain.high}
    for criterion in summary.criteria:
        found[criterion.name] = criterion.value
        found[f'{criterion.name}_high'] = criterion.high
        found[f'{criterion.name}_threshold'] = criterion.threshold
    return found | accuracies(option, domain)


def plan_row(
    summary: PlanSummary, participant: str = '', exact_mean_return: float | None = None
) -> dict[str, Any]:
    """Return the row of a plan and of the episodes in which it was judged."""
    return {
        **{name: getattr(summary, name, None) for name in PLANS},
        'participant': participant,
        'episodes': summary.evaluation_episodes,
        'exact_mean_return': exact_mean_return,
        'outcomes': {name: finite_parts(each) for name, each in summary.outcomes.items()},
    }


def finite(value: float | None) -> float | None:
    """Return a plain float, or None in place of NaN, infinity and None."""
    return float(value) if value is not None and math.isfinite(value) else None


def finite_parts(found: Interval) -> dict[str, float | None]:
    """Return mean, low and high by name; None where the data give none."""
    return {name: finite(getattr(found, name)) for name in ('mean', 'low', 'high')}
