"""Domains and their reference options by name, found through Python entry points."""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
import json
from typing import Any, cast

from humanopts_env.domains.base import Domain, DomainError, Parameter
from humanopts_env.domains.reference import ReferenceOption

DOMAINS = 'humanopts.domains'
REFERENCE_OPTIONS = 'humanopts.reference_options'


def domain_names() -> list[str]:
    """Return the registered names, sorted."""
    return sorted({point.name for point in entry_points(group=DOMAINS)})


def make_domain(name: str, parameters: Mapping[str, Parameter] | None = None) -> Domain[Any]:
    """
    Build a registered domain.

    :param parameters: keyword arguments of the domain; its defaults where missing.
    :raises DomainError: no such domain, or it refuses the parameters.
    """
    factory = _load(DOMAINS, name)
    if factory is None:
        raise DomainError(f'no domain {name!r}; there is {", ".join(domain_names())}')
    try:
        return cast(Domain[Any], factory(**(parameters or {})))
    except TypeError as error:
        raise DomainError(f'{name} does not take these parameters: {error}') from error


def domain_from_json(name: str, parameters: str) -> Domain[Any]:
    """
    Build a domain from its name and the JSON object of its parameters, as messages carry them.

    :raises DomainError: as ``make_domain``, or the parameters are not a JSON object.
    """
    try:
        values = json.loads(parameters or '{}')
    except json.JSONDecodeError as error:
        raise DomainError(f'the parameters of {name} are not JSON: {error}') from error
    if not isinstance(values, dict):
        raise DomainError(f'the parameters of {name} are not a JSON object: {parameters}')
    return make_domain(name, values)


def parameters_json(domain: Domain[Any]) -> str:
    """Return the domain's parameters as the JSON object that messages and files carry."""
    return json.dumps(dict(domain.parameters), sort_keys=True)


def reference_options(domain: Domain[Any]) -> dict[str, ReferenceOption]:
    """Return the domain's scripted options by name; empty where it has none."""
    factory = _load(REFERENCE_OPTIONS, domain.name)
    return {} if factory is None else factory(domain)


def _load(group: str, name: str) -> Callable[..., Any] | None:
    points = entry_points(group=group, name=name)
    return next(iter(points)).load() if points else None
