"""
Domains known only from messages, such as a robot or a simulator on the graph.

Actions can be taken in such a domain. Code that needs rules, such as planning, calls
``simulated``, which raises an error for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import (
    ActableDomain,
    Action,
    Domain,
    DomainError,
    Feature,
    FeatureKind,
    Parameter,
)
from humanopts_env.domains.check import check_description
from humanopts_env.domains.parameters import parameters_from_json
import numpy as np

KIND_NUMBERS = {  # KIND_* of FeatureInfo.msg
    FeatureKind.ORDINAL: 1,
    FeatureKind.NOMINAL: 2,
    FeatureKind.CONTINUOUS: 3,
}


class NeedsRulesError(DomainError):
    """A domain lacks the rules needed for an operation; the message names the operation."""


@dataclass(frozen=True, slots=True)
class SeenState:
    """A published state."""

    text: str  # in the world's own notation
    features: tuple[float, ...]
    over: bool = False  # the task is over


@dataclass(frozen=True)
class DescribedDomain(ActableDomain):
    """A domain described by ``domain_info``; its states are ``SeenState``."""

    name: str
    parameters: Mapping[str, Parameter]
    features: Sequence[Feature]
    actions: Sequence[Action]
    gamma: float
    max_steps: int

    def is_over(self, state: SeenState) -> bool:
        return state.over

    def feature_values(self, state: SeenState) -> Floats:
        return np.array(state.features)

    def encode(self, state: SeenState) -> str:
        return state.text


def described_domain(message: Any) -> DescribedDomain:
    """
    Decode the domain of a ``DomainInfo``, from rclpy or a bag reader.

    :raises DomainError: the description is invalid.
    """
    kinds = {number: kind for kind, number in KIND_NUMBERS.items()}
    if strange := [f.name for f in message.features if f.kind not in kinds]:
        raise DomainError(f'the feature {strange[0]} of {message.domain} is of an unknown kind')
    domain = DescribedDomain(
        message.domain,
        parameters_from_json(message.domain, message.parameters),
        [
            Feature(f.name, f.question, kinds[f.kind], tuple(f.value_names), f.unit, f.low, f.high)
            for f in message.features
        ],
        [Action(a.name, a.key, a.description, a.seconds, a.idle) for a in message.actions],
        message.gamma,
        message.max_steps,
    )
    check_description(domain)
    return domain


def can_simulate(domain: ActableDomain) -> TypeGuard[Domain]:
    """Return whether the rules of a domain are known, so that it can be simulated."""
    return not isinstance(domain, DescribedDomain)


def simulated(domain: ActableDomain, what: str) -> Domain:
    """
    Return a domain with its rules.

    :param what: operation that needs the rules, such as planning; start of the error message.
    :raises NeedsRulesError: the rules are unknown.
    """
    if can_simulate(domain):
        return domain
    raise NeedsRulesError(
        f'{what} needs a domain that can be simulated; {domain.name} cannot be simulated'
    )


def published_state(
    domain: ActableDomain, text: str, features: Sequence[float], *, over: bool = False
) -> Any:
    """
    Return the state with a published text and features.

    :param over: whether the task is over.
    :raises StateError: the rules of the domain are known, and the text is not a state.
    """
    if can_simulate(domain):
        return domain.decode(text)
    return SeenState(text, tuple(features), over)
