"""The numbers of a lesson, live or learned again: of its settings, options and plans."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.intervals import Interval
from humanopts_learner.options.accuracy import classification_accuracy, policy_accuracy
from humanopts_learner.options.criteria import Thresholds
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.plan import AnyPlan, Performance
from humanopts_learner.summary import INITIATION, TERMINATION
from humanopts_teach.lesson import BUDGET, STRATEGY


@dataclass(frozen=True)
class Settings:
    """What learning and judging depend on beside the demonstrations."""

    seed: int = 0
    strategy: str = STRATEGY  # of start states
    thresholds: Thresholds = field(default_factory=Thresholds)
    teacher_error_rate: float | None = None  # None: a person taught
    budget: int = BUDGET  # most start states shown for one option
    game_steps: int = 0  # that plans are sampled from; 0: as many as is usual

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises ValueError: one is out of range.
        """
        numbers = self.seed, self.budget, self.game_steps
        if min(numbers) < 0 or not 0 <= (self.teacher_error_rate or 0.0) <= 1:
            raise ValueError(f'{self}: a number is below 0, or the rate is no share')

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data, without the game steps: each plan tells its own."""
        return {name: value for name, value in asdict(self).items() if name != 'game_steps'}


def settings_from_facts(facts: Mapping[str, str]) -> tuple[Settings, list[str]]:
    """
    Read the settings, with a default for each that is missing or unreadable.

    :return: the settings, and a sentence on each that had to be assumed.
    """
    settings, assumed = Settings(), []
    limits = asdict(settings.thresholds)
    parsers: dict[str, Callable[[str], Any]] = {
        'seed': int,
        **dict.fromkeys(limits, float),
        'return_delta': lambda text: None if text == 'None' else float(text),
        'strategy': str,
        'budget': int,
        'teacher_error_rate': lambda text: None if text == 'None' else float(text),
    }
    if 'game_steps' in facts:  # else as many as is usual
        parsers['game_steps'] = int
    for name, parse in parsers.items():
        usual = getattr(settings.thresholds if name in limits else settings, name)
        try:
            change = {name: parse(facts[name])}
            if name in limits:
                change = {'thresholds': replace(settings.thresholds, **change)}
            settings = replace(settings, **change)
        except KeyError:
            assumed.append(f'the bag does not say its {name}; {usual} is assumed')
        except ValueError:
            assumed.append(f'its {name} {facts[name]!r} is not valid; {usual} is assumed')
    return settings, assumed


@dataclass(frozen=True)
class OptionBlock:
    """One entry of ``options`` in summary.json; None where it cannot be measured."""

    name: str
    features: tuple[str, ...]
    method: str  # of learning, one of ``METHODS``
    n_demonstrations: int
    policy_accuracy: float | None
    mean_return_demonstrations: float | None
    mean_return_policy: float | None
    cv_error_initiation: float | None
    cv_error_termination: float | None
    classification_accuracy_initiation: float | None
    classification_accuracy_termination: float | None
    criteria_met: bool


def option_block(
    option: LearnedOption,
    judged: Any,
    domain: Domain[Any],
    reference: ReferenceOption | None = None,
) -> OptionBlock:
    """
    Return the numbers of a learned option.

    :param judged: an OptionSummary, or the OptionStatus message that carried it, of the same
        demonstrations that the option was learned from; NaN is not measurable.
    :param reference: the reference option; None: accuracies cannot be measured.
    """
    values = {criterion.name: criterion.value for criterion in judged.criteria}
    policy, initiation, termination = accuracies(option, domain, reference)
    return OptionBlock(
        name=option.name,
        features=tuple(option.features),
        method=option.method,
        n_demonstrations=int(option.n_demonstrations),
        policy_accuracy=policy,
        mean_return_demonstrations=finite(judged.mean_return_demonstrations),
        mean_return_policy=finite(judged.mean_return_policy),
        cv_error_initiation=finite(values.get(INITIATION)),
        cv_error_termination=finite(values.get(TERMINATION)),
        classification_accuracy_initiation=initiation,
        classification_accuracy_termination=termination,
        criteria_met=bool(judged.criteria_met),
    )


def accuracies(
    option: LearnedOption, domain: Domain[Any], reference: ReferenceOption | None
) -> tuple[float | None, float | None, float | None]:
    """Return the accuracies of policy, I and beta; None where they cannot be measured."""
    if reference is None:
        return None, None, None
    initiation, termination = classification_accuracy(option, domain, reference)
    policy = policy_accuracy(option, domain, reference)
    return finite(policy), finite(initiation), finite(termination)


def finite(value: float | None) -> float | None:
    """Return a plain float, or None in place of NaN, infinity and None."""
    return float(value) if value is not None and math.isfinite(value) else None


def finite_parts(found: Interval) -> dict[str, float | None]:
    """Return mean, low and high by name; None where the data give none."""
    return {name: finite(value) for name, value in asdict(found).items()}


@dataclass(frozen=True)
class PlanningRow:
    """One entry of ``planning`` in summary.json; None where it was not measured."""

    action_set: str
    gamma: float
    table_seconds: float
    model_seconds: float
    sweep_seconds: float
    sweeps: int
    residual: float  # reward units
    converged: bool
    mean_return: float | None  # undiscounted
    mean_discounted_return: float | None
    game_steps: int = 0  # that models were sampled from; 0: models are exact
    episodes: int = 0  # that the plan was judged by
    mean_return_low: float | None = None  # 95 % interval
    mean_return_high: float | None = None
    fallbacks: int | None = None  # in all these episodes
    outcomes: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    """The domain's own measures: mean, low and high."""

    @property
    def seconds(self) -> float:
        """Planning time: policy tables, models and sweeps."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds


_OF_PLAN = ('action_set', 'gamma', 'game_steps', 'table_seconds', 'model_seconds', 'sweep_seconds')
_OF_SOLUTION = ('sweeps', 'residual', 'converged')
_MEANS = ('mean_return', 'mean_discounted_return', 'mean_return_low', 'mean_return_high')


def row_of_result(result: Any) -> PlanningRow:
    """Return the row of a PlanResult message."""
    bounds = zip(
        result.outcome_names, result.outcome_means, result.outcome_low, result.outcome_high
    )
    same: dict[str, Any] = {name: getattr(result, name) for name in (*_OF_PLAN, *_OF_SOLUTION)}
    means: dict[str, Any] = {name: finite(getattr(result, name)) for name in _MEANS}
    return PlanningRow(
        **same,
        **means,
        episodes=result.evaluation_episodes,
        fallbacks=result.fallbacks if result.evaluation_episodes else None,
        outcomes={name: finite_parts(Interval(*bound)) for name, *bound in bounds},
    )


def row_of_plan(plan: AnyPlan, performance: Performance) -> PlanningRow:
    """Return the row of a plan and how it did."""
    return PlanningRow(
        **{name: getattr(plan, name) for name in _OF_PLAN},
        **{name: getattr(plan.solution, name) for name in _OF_SOLUTION},
        mean_return=performance.total.mean,
        mean_discounted_return=performance.discounted.mean,
        episodes=performance.episodes,
        mean_return_low=finite(performance.total.low),
        mean_return_high=finite(performance.total.high),
        fallbacks=performance.fallbacks,
        outcomes={name: finite_parts(each) for name, each in performance.outcomes.items()},
    )
