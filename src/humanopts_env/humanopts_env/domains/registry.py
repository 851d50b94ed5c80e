"""Domains and their reference options by name, found through Python entry points."""

from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
import json
from typing import Any, cast, Self

from humanopts_env.domains.base import ActableDomain, Domain, DomainError, Parameter
from humanopts_env.domains.check import check_domain
from humanopts_env.domains.described import NeedsRulesError
from humanopts_env.domains.names import (
    domain_names,
    DOMAINS,
    GYMNASIUM,
    is_robot,
    registered,
    ROBOT,
)
from humanopts_env.domains.parameters import check_parameters, parameters_from_json
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.replayed_domain import ReplayedDomain

REFERENCE_OPTIONS = 'humanopts.reference_options'
OURS = 'humanopts_env.'


def make_domain(
    name: str, parameters: Mapping[str, Parameter] | None = None, *, checked: bool = False
) -> Domain:
    """
    Build a registered domain, or the domain of a Gymnasium environment: ``gymnasium:ENV_ID``.

    Domains of other packages are checked by ``check_domain``, and replayed domains by a replay.

    :param parameters: keyword arguments of the domain; None: the defaults.
    :param checked: whether another process has checked the domain.
    :raises DomainError: the domain is unknown, refuses the parameters or their types, cannot be
        loaded, or breaks the contract of domains.
    """
    factory, is_builtin = _factory(name)
    check_parameters(name, factory, parameters or {})
    with _explained(f'{name} cannot be made'):
        domain = cast(Domain, factory(**(parameters or {})))
    if not is_builtin and not checked:
        with _explained(f'{name} cannot be played'):
            if isinstance(domain, ReplayedDomain):
                domain.check_replay()
        check_domain(domain, name)
    return domain


def open_domain(name: str, parameters: Mapping[str, Parameter]) -> ActableDomain:
    """
    Build the domain of a launch, which may be that of a robot: ``ros:FILE.yaml``.

    :raises DomainError: as in ``make_domain``, or the world of the robot cannot be used.
    """
    if not is_robot(name):
        return make_domain(name, parameters)
    if parameters:
        raise DomainError(f'{name} takes no parameters: change its file')
    from humanopts_env.worlds.world import load_world  # slow to import

    return load_world(name).domain


def domain_from_json(name: str, parameters: str, *, checked: bool = False) -> Domain:
    """
    Build a domain from its name and the JSON object of its parameters, as in messages.

    :param checked: see ``make_domain``.
    :raises DomainError: as in ``make_domain``, or the parameters are not a JSON object.
    """
    return make_domain(name, parameters_from_json(name, parameters), checked=checked)


def parameters_json(domain: ActableDomain) -> str:
    """Return the domain's parameters as a JSON object for messages and files."""
    return json.dumps(dict(domain.parameters), sort_keys=True)


@dataclass(frozen=True)
class KeyedDomain:
    """A domain as an argument of a cached function, compared by name and parameters."""

    key: Hashable
    value: Domain = field(compare=False)

    @classmethod
    def of(cls, domain: Domain) -> Self:
        return cls((domain.name, parameters_json(domain)), domain)


def reference_options(domain: Domain) -> dict[str, ReferenceOption]:
    """
    Return the domain's reference options by name; empty if it has none.

    :raises DomainError: the options cannot be loaded or created.
    """
    point = _entry_point(REFERENCE_OPTIONS, domain.name)
    if point is None and domain.name.startswith(GYMNASIUM):
        point = _entry_point(REFERENCE_OPTIONS, GYMNASIUM.rstrip(':'))
    if point is None:
        return {}
    with _explained(f'the reference options of {domain.name} cannot be made'):
        return dict(_load(point)(domain))


def _factory(name: str) -> tuple[Callable[..., Any], bool]:
    """Return the factory of a domain, and whether it is built in and needs no check."""
    if is_robot(name):
        raise NeedsRulesError(
            f'{name} is a robot; this operation needs a domain that can be simulated'
        )
    if name.startswith(GYMNASIUM):
        with _explained(f'{name} needs the package gymnasium'):  # slow to import
            from humanopts_env.domains.gymnasium_replayed import domain_of_environment

        return domain_of_environment(name.removeprefix(GYMNASIUM)), False
    point = _entry_point(DOMAINS, name)
    if point is None:
        known = ', '.join([*domain_names(), f'{GYMNASIUM}ENV_ID', f'{ROBOT}FILE.yaml'])
        raise DomainError(f'unknown domain {name!r}; choose from {known}')
    return _load(point), point.value.startswith(OURS)


def _entry_point(group: str, name: str) -> EntryPoint | None:
    found = {point.value: point for point in registered(group).select(name=name)}
    if len(found) > 1:
        raise DomainError(
            f'{name!r} is the name of several domains, {", ".join(sorted(found))}: rename one'
        )
    return next(iter(found.values()), None)


def _load(point: EntryPoint) -> Callable[..., Any]:
    package = point.dist.name if point.dist else 'an unknown package'
    with _explained(f'{point.name!r} of {package} cannot be loaded from {point.value}'):
        return cast(Callable[..., Any], point.load())


@contextmanager
def _explained(failed: str) -> Iterator[None]:
    """Convert all errors of a plug-in to a ``DomainError`` that names the failed operation."""
    try:
        yield
    except DomainError:
        raise
    except (Exception, SystemExit) as error:
        raise DomainError(f'{failed}: {type(error).__name__}: {error}') from error
