"""The numbers of a lesson, live or learned again, as summary.json has them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
import json
import math
import os
from pathlib import Path
import tempfile
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.options.accuracy import classification_accuracy, policy_accuracy
from humanopts_learner.options.criteria import INITIATION, TERMINATION, Thresholds
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.any_domain import AnyPlan, Performance
from humanopts_teach.evaluation.games import GamesEvaluation


@dataclass(frozen=True)
class Settings:
    """What learning and judging depend on beside the demonstrations."""

    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)
    strategy: str = 'failures'  # of start states
    budget: int = 150  # most start states shown for one option
    teacher_error_rate: float | None = None  # None: a person taught

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data."""
        return {
            'seed': self.seed,
            'strategy': self.strategy,
            'thresholds': thresholds_dict(self.thresholds),
            'teacher_error_rate': self.teacher_error_rate,
            'budget': self.budget,
        }


def thresholds_dict(thresholds: Thresholds) -> dict[str, float]:
    """Return the thresholds by name."""
    return {part.name: float(getattr(thresholds, part.name)) for part in fields(thresholds)}


def settings_from_facts(facts: Mapping[str, str]) -> tuple[Settings, list[str]]:
    """
    Read the settings, with a default for each that is missing or unreadable.

    :return: the settings, and a sentence on each that had to be assumed.
    """
    assumed: list[str] = []

    def read(name: str, kind: Callable[[str], Any], default: Any) -> Any:
        try:
            return kind(facts[name])
        except KeyError:
            assumed.append(f'the bag does not say its {name}; {default} is assumed')
        except ValueError:
            assumed.append(f'its {name} {facts[name]!r} is not valid; {default} is assumed')
        return default

    usual = Settings()
    limits = thresholds_dict(usual.thresholds)
    settings = Settings(
        seed=read('seed', _natural, usual.seed),
        thresholds=Thresholds(
            **{name: read(name, _threshold(name), limits[name]) for name in limits}
        ),
        strategy=read('strategy', str, usual.strategy),
        budget=read('budget', _natural, usual.budget),
        teacher_error_rate=read('teacher_error_rate', _rate, usual.teacher_error_rate),
    )
    return settings, assumed


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def _threshold(name: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        value: float = getattr(Thresholds(**{name: float(text)}), name)
        return value

    return read


def _rate(text: str) -> float | None:
    if text == 'None':
        return None
    value = float(text)
    if not 0 <= value <= 1:
        raise ValueError(text)
    return value


@dataclass(frozen=True)
class OptionBlock:
    """One entry of ``options`` in summary.json; None where it cannot be measured."""

    name: str
    features: tuple[str, ...]
    n_demonstrations: int
    policy_accuracy: float | None
    mean_return_demonstrations: float | None
    mean_return_policy: float | None
    cv_error_initiation: float | None
    cv_error_termination: float | None
    classification_accuracy_initiation: float | None
    classification_accuracy_termination: float | None
    criteria_met: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the block as JSON data."""
        return {**asdict(self), 'features': list(self.features)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> 'OptionBlock':
        """Read what ``to_dict`` wrote; a missing key is a KeyError."""
        known = {field.name: values[field.name] for field in fields(cls)}
        return cls(**{**known, 'features': tuple(known['features'])})


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval; None where one episode gives none."""

    mean: float
    low: float | None
    high: float | None


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
    outcomes: Mapping[str, Estimate] = field(default_factory=dict)  # the domain's own measures

    @property
    def seconds(self) -> float:
        """Planning time: policy tables, models and sweeps."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        return asdict(self)


class SummaryError(OSError):
    """The summary could not be written; the text says why."""


@dataclass(frozen=True)
class Execution:
    """Episodes played by running options."""

    episodes: int
    successes: int  # that ended with the task done
    fallbacks: int  # primitive actions taken because no option was available
    mean_return: float | None  # undiscounted


@dataclass(frozen=True)
class BagFacts:
    """What the recording holds."""

    path: str
    messages: int
    topics: int


@dataclass(frozen=True)
class Summary:
    """Everything of summary.json."""

    domain: str
    settings: Settings
    options: tuple[OptionBlock, ...]  # as seen live
    planning: tuple[PlanningRow, ...]
    execution: Execution
    bag: BagFacts
    offline: tuple[OptionBlock, ...]  # learned again from the bag
    offline_planning: tuple[PlanningRow, ...] = ()  # planned again with these
    games: GamesEvaluation | None = None  # None: plans are exact

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as JSON data, without NaN."""
        settings = self.settings.to_dict()
        return {
            'domain': self.domain,
            'seed': settings.pop('seed'),
            'options': [block.to_dict() for block in self.options],
            'teaching': settings,
            'planning': [row.to_dict() for row in self.planning],
            'execution': asdict(self.execution),
            'bag': asdict(self.bag),
            'offline': {
                'options': [block.to_dict() for block in self.offline],
                'planning': [row.to_dict() for row in self.offline_planning],
            },
            'games': None if self.games is None else self.games.to_dict(),
        }


def option_block(
    option: LearnedOption,
    judged: Any,
    domain: Domain[Any],
    reference: ReferenceOption | None = None,
) -> OptionBlock:
    """
    Return the numbers of a learned option.

    :param judged: a Judgement, or the OptionStatus message that carried it, of the same
        demonstrations that the option was learned from; NaN is not measurable.
    :param reference: the reference option; None: accuracies cannot be measured.
    """
    values = {criterion.name: criterion.value for criterion in judged.criteria}
    policy, initiation, termination = accuracies(option, domain, reference)
    return OptionBlock(
        name=option.name,
        features=tuple(option.features),
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


def row_of_result(result: Any) -> PlanningRow:
    """Return the row of a PlanResult message."""
    bounds = zip(
        result.outcome_names, result.outcome_means, result.outcome_low, result.outcome_high
    )
    return PlanningRow(
        action_set=str(result.action_set),
        gamma=float(result.gamma),
        table_seconds=float(result.table_seconds),
        model_seconds=float(result.model_seconds),
        sweep_seconds=float(result.sweep_seconds),
        sweeps=int(result.sweeps),
        residual=float(result.residual),
        converged=bool(result.converged),
        mean_return=finite(result.mean_return),
        mean_discounted_return=finite(result.mean_discounted_return),
        game_steps=int(result.game_steps),
        episodes=int(result.evaluation_episodes),
        mean_return_low=finite(result.mean_return_low),
        mean_return_high=finite(result.mean_return_high),
        fallbacks=int(result.fallbacks) if result.evaluation_episodes else None,
        outcomes={
            str(name): Estimate(float(mean), finite(low), finite(high))
            for name, mean, low, high in bounds
        },
    )


def row_of_plan(plan: AnyPlan, performance: Performance) -> PlanningRow:
    """Return the row of a plan and how it did."""
    outcomes = performance.outcomes.items()
    return PlanningRow(
        action_set=plan.action_set,
        gamma=plan.gamma,
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=plan.solution.sweeps,
        residual=plan.solution.residual,
        converged=plan.solution.converged,
        mean_return=performance.total.mean,
        mean_discounted_return=performance.discounted.mean,
        game_steps=plan.game_steps,
        episodes=performance.episodes,
        mean_return_low=finite(performance.total.low),
        mean_return_high=finite(performance.total.high),
        fallbacks=performance.fallbacks,
        outcomes={name: Estimate(i.mean, finite(i.low), finite(i.high)) for name, i in outcomes},
    )


def differences(live: Sequence[OptionBlock], offline: Sequence[OptionBlock]) -> list[str]:
    """Return a sentence for each difference of two lists of blocks; none: they are equal."""
    there, here = _by_name(live), _by_name(offline)
    found = [f'{name!r} was learned live but is not in the bag' for name in set(there) - set(here)]
    found += [
        f'{name!r} is in the bag but was not learned live' for name in set(here) - set(there)
    ]
    for name in set(there) & set(here):
        found += _field_differences(there[name], here[name], repr(name))
    return sorted(found)


def _by_name(blocks: Sequence[OptionBlock]) -> dict[str, OptionBlock]:
    """Return blocks by name; of the same name (several people taught it), numbered."""
    found: dict[str, OptionBlock] = {}
    for block in blocks:
        again = sum(other.name == block.name for other in found.values())
        found[f'{block.name} ({again + 1})' if again else block.name] = block
    return found


def plan_differences(live: Sequence[PlanningRow], offline: Sequence[PlanningRow]) -> list[str]:
    """Return a sentence for each difference of plans, seconds apart; none: they are equal."""
    here = {row.action_set: row for row in offline}
    found = []
    for row in live:
        other = here.get(row.action_set)
        if other is None:
            found.append(f'the plan with {row.action_set} actions cannot be made from the bag')
            continue
        found += _field_differences(row, other, f'the {row.action_set} plan')
    return found


def _field_differences(
    live: OptionBlock | PlanningRow, offline: OptionBlock | PlanningRow, called: str
) -> list[str]:
    names = [part.name for part in fields(live) if not part.name.endswith('_seconds')]
    values = ((name, getattr(live, name), getattr(offline, name)) for name in names)
    return [
        f'{name} of {called} was {a!r} live and is {b!r} offline'
        for name, a, b in values
        if a != b
    ]


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """
    Write JSON data; a reader sees the old file or all of the new one.

    :raises SummaryError: the folder is missing, full or not writable.
    :raises ValueError: a number is NaN or infinite.
    """
    text = json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    """
    Write a text file; a reader sees the old file or all of the new one.

    :raises SummaryError: the folder is missing, full or not writable.
    """
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(
            'w', encoding='utf-8', dir=path.parent, prefix=f'.{path.name}.', delete=False
        ) as file:
            temporary = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise SummaryError(f'cannot write {path}: {error.strerror or error}') from error
