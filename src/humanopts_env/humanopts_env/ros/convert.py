"""Conversion between messages and domain values."""

from collections.abc import Hashable
from dataclasses import asdict, fields
from typing import Any

from humanopts_env.domains.base import Domain, DomainError, FeatureKind
from humanopts_env.domains.registry import domain_from_json, parameters_json
from humanopts_env.game import Command, Control, Pacing, Refused, Transition
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionInfo,
    ActionRefusal,
    ControlState,
    DomainInfo,
    FeatureInfo,
    GameState,
)

_KINDS = {
    FeatureKind.ORDINAL: FeatureInfo.KIND_ORDINAL,
    FeatureKind.NOMINAL: FeatureInfo.KIND_NOMINAL,
    FeatureKind.CONTINUOUS: FeatureInfo.KIND_CONTINUOUS,
}


def domain_to_info(domain: Domain[Any]) -> DomainInfo:
    """Describe a domain; header, publisher_id and sequence are left to the publisher."""
    return DomainInfo(
        domain=domain.name,
        parameters=parameters_json(domain),
        gamma=domain.gamma,
        max_steps=domain.max_steps,
        features=[
            FeatureInfo(
                name=feature.name,
                question=feature.question,
                kind=_KINDS[feature.kind],
                value_names=list(feature.values),
                unit=feature.unit,
                low=feature.low,
                high=feature.high,
            )
            for feature in domain.features
        ],
        actions=[ActionInfo(**asdict(action)) for action in domain.actions],
    )


def domain_from_info(info: DomainInfo) -> Domain[Hashable]:
    """
    Build the domain that the node game published.

    :raises DomainError: it is not registered here, or its rules differ.
    """
    domain = domain_from_json(info.domain, info.parameters)
    here = domain_to_info(domain)
    rules = 'features', 'actions', 'gamma', 'max_steps'
    if any(getattr(here, part) != getattr(info, part) for part in rules):
        raise DomainError(
            f'game plays another version of {info.domain}: its rules differ from those installed '
            'here'
        )
    return domain


def transition_to_message(transition: Transition) -> GameState:
    """Encode a transition; header, publisher_id and sequence are left to the publisher."""
    values = {field.name: getattr(transition, field.name) for field in fields(transition)}
    values['features'] = list(transition.features)
    values['action_source'] = int(transition.action_source)
    return GameState(**values)


def command_from_message(message: ActionCommand) -> Command:
    """Decode a command."""
    names = (field.name for field in fields(Command))
    return Command(**{name: getattr(message, name) for name in names})


def refusal_to_message(refused: Refused) -> ActionRefusal:
    """Encode a refusal."""
    command = {f'command_{name}': value for name, value in asdict(refused.command).items()}
    del command['command_source']  # the topic does not carry it
    return ActionRefusal(
        reason=int(refused.reason),
        detail=refused.detail,
        episode=refused.episode,
        step=refused.step,
        **command,
    )


def control_to_message(control: Control, pacing: Pacing) -> ControlState:
    """Encode who holds control, and the pace of the machine."""
    return ControlState(
        holder=int(control.holder),
        holder_id=control.holder_id,
        reason=control.reason,
        step_period=pacing.period,
        paused_by=pacing.paused_by,
    )
