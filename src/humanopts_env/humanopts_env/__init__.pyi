from .domains.base import (
    Action,
    Domain,
    DomainError,
    EnumerableDomain,
    Feature,
    FeatureKind,
    is_enumerable,
)
from .domains.names import domain_names
from .domains.reference import ReferenceOption
from .domains.registry import make_domain, reference_options
from .domains.table_domain import TableDomain
from .gym_env import DomainEnv
from .seeding import generator

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
