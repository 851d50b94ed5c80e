"""
Games as domains: rules without hidden state, reference options, Gymnasium in both directions.

``make_domain('taxi')`` is the way in. Everything here works without ROS.
"""

from typing import TYPE_CHECKING

from humanopts_env.lazy import lazy_names

if TYPE_CHECKING:
    from humanopts_env.domains.base import (
        Action,
        Domain,
        DomainError,
        EnumerableDomain,
        Feature,
        FeatureKind,
        is_enumerable,
    )
    from humanopts_env.domains.reference import ReferenceOption
    from humanopts_env.domains.registry import domain_names, make_domain, reference_options
    from humanopts_env.domains.table_domain import TableDomain
    from humanopts_env.gym_env import DomainEnv
    from humanopts_env.seeding import generator

__all__ = [
    'Action',
    'Domain',
    'DomainEnv',
    'DomainError',
    'EnumerableDomain',
    'Feature',
    'FeatureKind',
    'ReferenceOption',
    'TableDomain',
    'domain_names',
    'generator',
    'is_enumerable',
    'make_domain',
    'reference_options',
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        'humanopts_env.domains.base': (
            'Action',
            'Domain',
            'DomainError',
            'EnumerableDomain',
            'Feature',
            'FeatureKind',
            'is_enumerable',
        ),
        'humanopts_env.domains.reference': ('ReferenceOption',),
        'humanopts_env.domains.registry': ('domain_names', 'make_domain', 'reference_options'),
        'humanopts_env.domains.table_domain': ('TableDomain',),
        'humanopts_env.gym_env': ('DomainEnv',),
        'humanopts_env.seeding': ('generator',),
    },
)
