"""From command line arguments to the setup of a launch."""

import argparse
from dataclasses import fields, replace
import json
import os
from pathlib import Path
import re
import sys
import time
from typing import Any

from humanopts_env.domains.base import Parameter
from humanopts_learner.options.criteria import Thresholds, usual_thresholds
from humanopts_ros.recording import Selection
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.launching.processes import Recording, Setup

_NAMESPACE = re.compile(r'/|(/[A-Za-z_][A-Za-z0-9_]*)+')  # of nodes, as ROS 2 allows them
_LAST_DOMAIN_ID = 232


def setup_from(
    arguments: argparse.Namespace, default_out: Path, *, evaluated: bool = False, **own: Any
) -> Setup:
    """
    Return the setup that the common launch options ask for.

    :param default_out: the folder where the user names none.
    :param evaluated: the command needs a bag that can be evaluated.
    :param own: fields that the command sets itself.
    :raises CommandError: a domain parameter is not NAME=VALUE, the namespace or ROS_DOMAIN_ID is
        none, or the bag would not hold what an evaluation needs.
    """
    _check_place(arguments.namespace)
    return Setup(
        domain=arguments.domain,
        directory=Path(os.path.abspath(arguments.out or default_out)),
        domain_parameters=parameters_from(arguments),
        seed=arguments.seed,
        strategy=arguments.strategy,
        budget=arguments.budget,
        thresholds=_thresholds(arguments),
        step_period=arguments.step_period,
        recording=_recording(arguments, evaluated) if own.get('record', True) else Recording(),
        **own,
    )


def _recording(arguments: argparse.Namespace, evaluated: bool) -> Recording:
    """Return what goes into the bag; warn, or refuse, where it could not be evaluated."""
    include, exclude = tuple(arguments.record_include), tuple(arguments.record_exclude)
    if lacking := Selection(arguments.namespace, include, exclude).unevaluable:
        if evaluated:
            raise CommandError(lacking)
        print(f'humanopts: {lacking}', file=sys.stderr)
    return Recording(include, exclude, arguments.split_bytes, arguments.split_seconds)


def _thresholds(arguments: argparse.Namespace) -> Thresholds:
    """Return the domain's usual thresholds, with those that the user gives in their place."""
    given = {
        field.name: value
        for field in fields(Thresholds)
        if (value := getattr(arguments, field.name)) is not None
    }
    try:
        return replace(usual_thresholds(arguments.domain), **given)
    except ValueError as error:
        raise CommandError(str(error)) from error


def parameters_from(arguments: argparse.Namespace) -> dict[str, Parameter]:
    """
    Return the domain's parameters.

    :raises CommandError: one is not NAME=VALUE.
    """
    return dict(_parameter(text) for text in arguments.parameter)


def new_name(prefix: str) -> str:
    """Return a name that sorts by time and was not used before this second."""
    return time.strftime(f'{prefix}-%Y%m%d-%H%M%S')


def default_folder(domain: str) -> Path:
    """Return where the data of a domain goes: its name, with no character that paths dislike."""
    return Path('runs') / re.sub(r'[^\w.-]+', '-', domain)


def _check_place(namespace: str) -> None:
    if not _NAMESPACE.fullmatch(namespace):
        raise CommandError(f'{namespace!r} is not a namespace; one reads / or /room_1/left')
    number = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (number.isascii() and number.isdigit() and int(number) <= _LAST_DOMAIN_ID):
        raise CommandError(f'ROS_DOMAIN_ID is {number!r}, and must be from 0 to {_LAST_DOMAIN_ID}')


def _parameter(text: str) -> tuple[str, Parameter]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise CommandError(f'--parameter {text!r} is not NAME=VALUE')
    try:
        parsed = json.loads(value)
    except json.JSONDecodeError:
        return name, value
    return name, parsed if isinstance(parsed, int | float | bool) else value
