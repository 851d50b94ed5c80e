"""The numbers of one learned option, by one function for what was seen live and offline."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
import math
from typing import Any, Protocol

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.options.accuracy import classification_accuracy, policy_accuracy
from humanopts_learner.options.criteria import INITIATION, TERMINATION
from humanopts_learner.options.option import LearnedOption


class JudgedCriterion(Protocol):
    """One criterion: a ``criteria.Criterion``, or the message that carried it."""

    @property
    def name(self) -> str:
        """Such as return, initiation or termination."""
        ...

    @property
    def value(self) -> float | None:
        """None or NaN where it is not measurable."""
        ...


class Judged(Protocol):
    """What was said of an option: a ``criteria.Judgement``, or an OptionStatus message."""

    @property
    def criteria(self) -> Sequence[JudgedCriterion]:
        """The three criteria: return, initiation, termination."""
        ...

    @property
    def mean_return_demonstrations(self) -> float:
        """Undiscounted; NaN where there is no trajectory."""
        ...

    @property
    def mean_return_policy(self) -> float:
        """Of the learned policy from the same start states."""
        ...

    @property
    def criteria_met(self) -> bool:
        """Whether all three hold."""
        ...


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


def option_block(
    option: LearnedOption,
    judged: Judged,
    domain: Domain[Any],
    reference: ReferenceOption | None = None,
) -> OptionBlock:
    """
    Return the numbers of a learned option.

    :param judged: of the same demonstrations that the option was learned from.
    :param reference: what an expert means by the option; None: accuracies are not measurable.
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


def differences(live: Sequence[OptionBlock], offline: Sequence[OptionBlock]) -> list[str]:
    """Return in words where two lists of blocks differ; empty where they are equal exactly."""
    there, here = _by_name(live), _by_name(offline)
    found = [f'{name!r} was learned live but is not in the bag' for name in set(there) - set(here)]
    found += [
        f'{name!r} is in the bag but was not learned live' for name in set(here) - set(there)
    ]
    for name in set(there) & set(here):
        for field in fields(OptionBlock):
            a, b = getattr(there[name], field.name), getattr(here[name], field.name)
            if a != b:
                found.append(f'{field.name} of {name!r} was {a!r} live and is {b!r} offline')
    return sorted(found)


def _by_name(blocks: Sequence[OptionBlock]) -> dict[str, OptionBlock]:
    """Return blocks by name; of the same name (several people taught it), numbered."""
    found: dict[str, OptionBlock] = {}
    for block in blocks:
        again = sum(other.name == block.name for other in found.values())
        found[f'{block.name} ({again + 1})' if again else block.name] = block
    return found
