"""Messages to domain values and back: the only module of this package that knows both."""

from collections.abc import Hashable
from typing import Any

from humanopts_env.domains.base import Domain, DomainError, FeatureKind
from humanopts_env.domains.registry import domain_from_json, parameters_json
from humanopts_interfaces.msg import ActionInfo, DomainInfo, FeatureInfo

_KINDS = {
    FeatureKind.ORDINAL: FeatureInfo.KIND_ORDINAL,
    FeatureKind.NOMINAL: FeatureInfo.KIND_NOMINAL,
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
            )
            for feature in domain.features
        ],
        actions=[
            ActionInfo(name=action.name, key=action.key, description=action.description)
            for action in domain.actions
        ],
    )


def domain_from_info(info: DomainInfo) -> Domain[Hashable]:
    """
    Build the domain that game announced.

    :raises DomainError: it is not registered here, or its features or actions are other ones.
    """
    domain = domain_from_json(info.domain, info.parameters)
    here = domain_to_info(domain)
    if here.features != info.features or here.actions != info.actions:
        raise DomainError(
            f'game plays another version of {info.domain}: its features or actions differ from '
            'those installed here'
        )
    return domain
