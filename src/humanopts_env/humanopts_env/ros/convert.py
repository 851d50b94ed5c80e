"""Conversion between messages and domain values."""

from humanopts_env.domains.base import ActableDomain, Action, DomainError, Feature
from humanopts_env.domains.described import described_domain
from humanopts_env.domains.names import is_registered
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
from humanopts_ros.codec import Codec

_FEATURE = Codec(Feature, FeatureInfo, of_value=['values'], of_message=['value_names'])
_ACTION = Codec(Action, ActionInfo)
transition_to_message = Codec(Transition, GameState).encode
command_from_message = Codec(Command, ActionCommand, of_message=['option_name']).decode
_CONTROL = Codec(Control, ControlState, of_message=['step_period', 'paused_by'])
_COMMAND_FIELDS = 'publisher_id', 'sequence', 'episode', 'step', 'action'
_REFUSED = Codec(
    Refused,
    ActionRefusal,
    of_value=['command'],
    of_message=[f'command_{name}' for name in _COMMAND_FIELDS],
)


def domain_to_info(domain: ActableDomain) -> DomainInfo:
    """Describe a domain; the publisher sets header, publisher_id and sequence."""
    return DomainInfo(
        domain=domain.name,
        parameters=parameters_json(domain),
        gamma=domain.gamma,
        max_steps=domain.max_steps,
        features=[
            _FEATURE.encode(feature, value_names=list(feature.values))
            for feature in domain.features
        ],
        actions=list(map(_ACTION.encode, domain.actions)),
    )


def domain_from_info(info: DomainInfo) -> ActableDomain:
    """
    Build the domain published by the node game, with its rules if it is registered here.

    :raises DomainError: its rules differ from those installed here, or its description is invalid.
    """
    if not is_registered(info.domain):
        return described_domain(info)
    domain = domain_from_json(info.domain, info.parameters, checked=True)  # by the game
    here = domain_to_info(domain)
    rules = 'features', 'actions', 'gamma', 'max_steps'
    if any(getattr(here, part) != getattr(info, part) for part in rules):
        raise DomainError(
            f'game plays another version of {info.domain}: its rules differ from those installed '
            'here'
        )
    return domain


def refusal_to_message(refused: Refused) -> ActionRefusal:
    """Encode a refusal."""
    command = {f'command_{name}': getattr(refused.command, name) for name in _COMMAND_FIELDS}
    return _REFUSED.encode(refused, **command)


def control_to_message(control: Control, pacing: Pacing) -> ControlState:
    """Encode the control of the game and the pace of the machine."""
    return _CONTROL.encode(control, step_period=pacing.period, paused_by=pacing.paused_by)
