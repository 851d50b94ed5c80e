"""What the launch file for ``ros2 launch`` offers: arguments, and the processes they ask for."""

from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.criteria import usual_thresholds
from humanopts_teach.launching.processes import processes, ProcessSpec, Recording, Setup


class LaunchArgumentError(ValueError):
    """A launch argument has a value that cannot be used; the text says which, and what can."""


@dataclass(frozen=True)
class LaunchArgument:
    """One argument of the launch file; all values are texts."""

    name: str
    default: str
    description: str


ARGUMENTS = (
    LaunchArgument('domain', 'taxi', 'what is played: the name of a registered domain'),
    LaunchArgument('domain_parameters', '{}', 'its parameters as a JSON object, as {"rows": 7}'),
    LaunchArgument('out', 'runs/launch', 'folder of demonstrations, options and bags'),
    LaunchArgument('seed', '1', 'of every random draw: a whole number from 0'),
    LaunchArgument('strategy', 'failures', 'of start states: random, coverage or failures'),
    LaunchArgument('budget', '150', 'most start states shown for an option'),
    LaunchArgument('teach', 'true', 'whether lesson and learner run: true or false'),
    LaunchArgument('record', 'true', 'whether everything goes into a new bag: true or false'),
    LaunchArgument('record_include', '', 'topics to record, as "lesson/*;action"; empty: all'),
    LaunchArgument('record_exclude', '', 'topics not to record, in the same form'),
    LaunchArgument('split_bytes', '0', 'size at which the bag goes on in another file; 0: never'),
    LaunchArgument('split_seconds', '0.0', 'and time after which it does; 0: never'),
    LaunchArgument('step_period', '0.0', "seconds between a machine's steps, to watch it"),
    LaunchArgument(
        'taught',
        '',
        'options that a simulated teacher teaches, separated by ";"; empty: no teacher',
    ),
)


def launched(values: Mapping[str, str]) -> list[ProcessSpec]:
    """
    Return the processes of a launch.

    :param values: of the arguments, by name.
    :raises LaunchArgumentError: one of them cannot be used.
    """
    return processes(setup_from_launch(values))


def setup_from_launch(values: Mapping[str, str]) -> Setup:
    """
    Return what the launch arguments ask for; errors as ``launched``.

    The keyboard is not among it: ``ros2 launch`` gives no process the terminal.
    """
    parameters = _parsed(values, 'domain_parameters', dict, 'a JSON object')
    try:
        thresholds = usual_thresholds(make_domain(values['domain'], parameters))
    except ValueError as error:
        raise LaunchArgumentError(str(error)) from error
    return Setup(
        domain=values['domain'],
        directory=Path(values['out']).absolute(),
        domain_parameters=parameters,
        seed=_parsed(values, 'seed', int, 'a whole number'),
        thresholds=thresholds,
        strategy=values['strategy'],
        budget=_parsed(values, 'budget', int, 'a whole number'),
        teach=_parsed(values, 'teach', bool, 'true or false'),
        record=_parsed(values, 'record', bool, 'true or false'),
        recording=Recording(
            _listed(values, 'record_include'),
            _listed(values, 'record_exclude'),
            _parsed(values, 'split_bytes', int, 'a whole number'),
            _seconds(values, 'split_seconds'),
        ),
        step_period=_seconds(values, 'step_period'),
        taught=_listed(values, 'taught'),
        bag_name=time.strftime('bags/launch-%Y%m%d-%H%M%S'),
    )


def _listed(values: Mapping[str, str], name: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in values[name].split(';') if part.strip())


def _seconds(values: Mapping[str, str], name: str) -> float:
    return float(_parsed(values, name, (int, float), 'a number of seconds'))


def _parsed(values: Mapping[str, str], name: str, kind: Any, wanted: str) -> Any:
    """Read a value as JSON of one kind."""
    text = values[name].strip()
    try:
        value = json.loads(text.lower() if kind is bool else text)
    except json.JSONDecodeError:
        value = None
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        raise LaunchArgumentError(f'{name}:={text} is not {wanted}')
    return value
