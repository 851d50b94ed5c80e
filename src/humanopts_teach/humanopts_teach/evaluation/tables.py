"""
The tables of an evaluation: typed columns, and the rows of options and plans.

Tables are pandas DataFrames. An unknown number is NaN in a table and null in JSON.
"""

from collections.abc import Iterable, Iterator, Mapping
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


LIVE_OPTIONS = {  # known during teaching; mostly fields of OptionSummary
    'participant': 'object',  # code of the person who taught
    'option_name': 'object',
    'features': 'object',  # names of the chosen features
    'method': 'object',  # learning method
    'n_demonstrations': 'int64',  # trajectories
    'n_not_here': 'int64',  # "not here" answers
    'n_questions': 'int64',  # answered questions about runs of the option
    'mean_return_demonstrations': 'float64',  # undiscounted, reward units
    'mean_return_policy': 'float64',  # from the same starts, undiscounted, reward units
    'evidence': 'object',  # basis of success: every start, sampled starts or recorded
    'success': 'float64',  # share of starts that lead to an end like a demonstrated one
    'agreement': 'float64',  # share of held-out demonstrations that the option would repeat
    'imitation': 'float64',  # share of demonstrations with an end that the option misses
    'return': 'float64',  # held-out shortfall in the return, as a share of its range
    'initiation': 'float64',  # held-out balanced error of I, 0 to 1
    'termination': 'float64',  # share of held-out demonstrations where the option ends elsewhere
    'ended_early': 'int64',  # count of these; so are the next two
    'ended_late': 'int64',
    'ended_never': 'int64',
    'policy_accuracy': 'float64',  # share of states in which the action is optimal
    'classification_accuracy_initiation': 'float64',  # share of states in which I is right
    'classification_accuracy_termination': 'float64',  # share of states in which beta is right
    'criteria_met': 'bool',
    'exam_right': 'int64',  # runs in the newest exam that were judged right
    'exam_runs': 'int64',
    'exam_needed': 'int64',  # required runs; 0: no exam
    'exams_failed': 'int64',  # failed exams of earlier versions
    'learned': 'bool',  # whether the criteria are met and the exam is passed
    'status': 'object',  # the same in words, or the missing conditions
}
OPTIONS = {  # one row per demonstration of an option
    **LIVE_OPTIONS,
    'success_limit': 'float64',  # lower confidence limit
    'agreement_limit': 'float64',  # lower confidence limit
    'return_limit': 'float64',  # upper confidence limit of the shortfall
    'success_threshold': 'float64',  # smallest share allowed
    'return_threshold': 'float64',  # largest shortfall allowed
    'initiation_threshold': 'float64',  # largest error allowed
    'termination_threshold': 'float64',  # largest share allowed
    'gain': 'float64',  # return of the policy minus that of the demonstrations, reward units
    'gain_low': 'float64',  # 95 % interval of the gain
    'gain_high': 'float64',  # 95 % interval of the gain
    'seconds': 'float64',  # time of the person so far, s
}
LIVE_PLANS = {  # known during planning
    'action_set': 'object',  # human or primitive
    'gamma': 'float64',  # discount per step
    'game_steps': 'int64',  # used for sampled models; 0: models are exact
    'sweeps': 'int64',  # sweeps of value iteration
    'residual': 'float64',  # largest change in the last sweep, reward units
    'converged': 'bool',  # whether the residual is within the tolerance
    'episodes': 'int64',  # episodes in the evaluation
    'mean_return': 'float64',  # undiscounted, reward units
    'mean_return_low': 'float64',  # 95 % interval
    'mean_return_high': 'float64',  # 95 % interval
    'mean_discounted_return': 'float64',  # reward units
    'fallbacks': 'int64',  # primitive actions taken because no option could start
    'random_moves': 'int64',  # random actions taken to leave loops
    'outcomes': 'object',  # mean, low and high of each outcome of the domain, by name
}
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')  # planning time
PLANS = {  # one row per plan
    'participant': 'object',  # teacher of the options; empty: primitive actions
    **LIVE_PLANS,
    **dict.fromkeys(SECONDS, 'float64'),
    'exact_mean_return': 'float64',  # mean over all start states
}
GAMES = {  # one row per policy and variant of a game
    'setting': 'object',  # variant, such as ghosts=chase; empty: there is only one
    'name': 'object',  # name of the policy
    'kind': 'object',  # plan, chance or rule
    'options': 'object',  # names of its learned options
    'games': 'int64',
    'score': 'float64',  # mean
    'score_low': 'float64',  # 95 % interval
    'score_high': 'float64',  # 95 % interval
    'outcomes': 'object',  # mean, low and high of each outcome of the domain, by name
    'decisions': 'float64',  # mean of options and actions started per game
    'fallbacks': 'float64',  # mean of actions per game, if no option could start
    'game_steps': 'int64',  # sampled for planning
    'seconds': 'float64',  # processor time of planning
}


def table(columns: Mapping[str, str], rows: Iterable[Any]) -> 'pd.DataFrame':
    """
    Return rows as a table.

    :param columns: column types by name.
    :param rows: values by column; other names are ignored, and missing values are NaN.
    """
    import pandas as pd

    return pd.DataFrame(rows, columns=[*columns]).astype(dict(columns))


def records(frame: 'pd.DataFrame') -> list[dict[str, Any]]:
    """Return the rows as JSON data."""
    plain = frame.astype(object)
    found: Any = plain.where(plain.notna(), None).to_dict('records')
    return list(found)


def rows_of(frame: Any) -> Iterator[Any]:
    """Yield the rows of a table, with ``Index`` and columns as attributes."""
    yield from frame.itertuples()


def accuracies(option: LearnedOption, domain: Domain) -> dict[str, float | None]:
    """Return the accuracies of policy, I and beta by column; None if unknown."""
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
    domain: Domain,
    seconds: float = math.nan,
) -> dict[str, Any]:
    """
    Return the row of a learned option.

    :param summary: summary of the option and its demonstrations.
    :param seconds: time of the person, s.
    """
    found = {name: getattr(summary, name, math.nan) for name in OPTIONS}
    found |= {'features': tuple(option.features), 'seconds': seconds}
    found |= {'gain': summary.gain.mean}
    found |= {'gain_low': summary.gain.low, 'gain_high': summary.gain.high}
    for criterion in summary.criteria:
        found[criterion.name] = criterion.value
        found[f'{criterion.name}_limit'] = criterion.limit
        found[f'{criterion.name}_threshold'] = criterion.threshold
    return found | accuracies(option, domain)


def plan_row(
    summary: PlanSummary, participant: str = '', exact_mean_return: float | None = None
) -> dict[str, Any]:
    """Return the row of a plan and its evaluation."""
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
    """Return mean, low and high by name; None if undefined."""
    return {name: finite(getattr(found, name)) for name in ('mean', 'low', 'high')}
