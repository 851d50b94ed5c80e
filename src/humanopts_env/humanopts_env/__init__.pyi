from .domains.base import (
    Action,
    Domain,
    DomainError,
    EnumerableDomain,
    Feature,
    FeatureKind,
    is_enumerable,
    Outcome,
    StateError,
)
from .domains.names import domain_names
from .domains.reference import ReferenceOption
from .domains.registry import make_domain, reference_options
from .domains.replayed_domain import ReplayedDomain, World
from .domains.table_domain import TableDomain
from .games import games_at, new_games
from .gym_env import DomainEnv
from .options_env import OptionsEnv
from .seeding import generator

__all__ = [
    'Action',
    'Domain',
    'DomainEnv',
    'DomainError',
    'EnumerableDomain',
    'Feature',
    'FeatureKind',
    'OptionsEnv',
    'Outcome',
    'ReferenceOption',
    'ReplayedDomain',
    'StateError',
    'TableDomain',
    'World',
    'domain_names',
    'games_at',
    'generator',
    'is_enumerable',
    'make_domain',
    'new_games',
    'reference_options',
]
