"""From command line arguments to the setup of a launch."""

import argparse
import json
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import Parameter
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.launching.processes import Setup


def setup_from(arguments: argparse.Namespace, default_out: Path, **own: Any) -> Setup:
    """
    Return the setup that the common launch options ask for.

    :param default_out: the folder where the user names none.
    :param own: fields that the command sets itself.
    :raises CommandError: a domain parameter is not NAME=VALUE, or the namespace is none.
    """
    if not arguments.namespace.startswith('/'):
        raise CommandError(f'the namespace {arguments.namespace!r} does not begin with /')
    return Setup(
        domain=arguments.domain,
        directory=(arguments.out or default_out).resolve(),
        domain_parameters=dict(_parameter(text) for text in arguments.parameter),
        seed=arguments.seed,
        strategy=arguments.strategy,
        budget=arguments.budget,
        **own,
    )


def new_name(prefix: str) -> str:
    """Return a name that sorts by time and was not used before this second."""
    return time.strftime(f'{prefix}-%Y%m%d-%H%M%S')


def _parameter(text: str) -> tuple[str, Parameter]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise CommandError(f'--parameter {text!r} is not NAME=VALUE')
    try:
        parsed = json.loads(value)
    except json.JSONDecodeError:
        return name, value
    return name, parsed if isinstance(parsed, int | float | bool) else value
