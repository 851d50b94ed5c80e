"""What the launch file for ``ros2 launch`` offers: arguments, and the setup they ask for."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
import json
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.parameters import MAX_PARAMETERS
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import check_method
from humanopts_ros.limits import JsonError, parse_json, shown
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import (
    OUTLASTING,
    processes,
    ProcessSpec,
    RECORDER,
    Recording,
    Setup,
    UnknownNodeError,
)


class LaunchArgumentError(ValueError):
    """A launch argument has a value that cannot be used; the text says which, and what can."""


@dataclass(frozen=True)
class LaunchArgument:
    """One argument of the launch file; all values are texts."""

    name: str
    usual: Any  # and its kind: int, float (seconds), bool, dict (JSON), tuple (by ";") or str
    description: str

    @property
    def default(self) -> str:
        """The usual value as a text."""
        if isinstance(self.usual, str | tuple):
            return ';'.join(self.usual) if isinstance(self.usual, tuple) else self.usual
        return json.dumps(self.usual)


_OWN: dict[str, Any] = {  # what is usual here; the rest is as in other launches
    'domain': 'taxi',
    'domain_parameters': {},
    'out': 'runs/launch',
    'seed': 1,
    'record_topics': Recording.topics,
    'record_exclude': Recording.exclude,
    'split_bytes': Recording.split_bytes,
    'split_seconds': Recording.split_seconds,
}
_DESCRIPTIONS = {
    'domain': 'what is played: the name of a registered domain',
    'domain_parameters': 'its parameters as a JSON object, as {"rows": 7}',
    'out': 'folder of demonstrations, options and bags',
    'seed': 'of every random draw: a whole number from 0',
    'strategy': 'of start states: random, coverage or failures',
    'learn': 'how options are learned: trees or goal',
    'budget': 'most start states shown for an option',
    'teach': 'whether lesson and learner run: true or false',
    'record': 'whether the graph goes into a new bag: true or false',
    'record_topics': 'other topics to record as well, as "/odom;/camera/*"',
    'record_exclude': 'topics not to record, in the same form',
    'split_bytes': 'size at which the bag goes on in another file; 0: never',
    'split_seconds': 'and time after which it does; 0: never',
    'step_period': "seconds between a machine's steps, to watch it",
    'diagnostics': 'whether a node publishes /diagnostics: true or false',
    'views': 'whether a node publishes the game for RViz and Foxglove: true or false',
    'only': 'nodes to start on this machine, separated by ";"; empty: all',
    'taught': 'options that a simulated teacher teaches, separated by ";"; empty: no teacher',
}
ARGUMENTS = tuple(
    LaunchArgument(name, _OWN[name] if name in _OWN else getattr(Setup, name), text)
    for name, text in _DESCRIPTIONS.items()
)
_WANTED = {
    int: 'a whole number',
    float: 'a number of seconds',
    bool: 'true or false',
    dict: 'a JSON object',
}


_places = ExitStack()  # until this process ends


def setup_from_launch(texts: Mapping[str, str]) -> Setup:
    """
    Return what the launch arguments ask for.

    The keyboard is not among it: ``ros2 launch`` gives no process the terminal.

    :param texts: the values of the arguments, by name.
    :raises LaunchArgumentError: one of them cannot be used.
    """
    values = {argument.name: _read(argument, texts[argument.name]) for argument in ARGUMENTS}
    recording = ('record_topics', 'record_exclude', 'split_bytes', 'split_seconds')
    try:
        domain = make_domain(values['domain'], values['domain_parameters'])
        check_method(values['learn'], domain)
    except ValueError as error:
        raise LaunchArgumentError(str(error)) from error
    setup = Setup(
        directory=Path(values.pop('out')).absolute(),
        recording=Recording(*(values.pop(name) for name in recording)),
        bag_name=time.strftime('bags/launch-%Y%m%d-%H%M%S'),
        **values,
    )
    try:
        processes(setup)
    except UnknownNodeError as error:
        raise LaunchArgumentError(f'only:={texts["only"].strip()}: {error}') from error
    return setup


def launched(setup: Setup, namespace: str) -> list[ProcessSpec]:
    """
    Return the processes of a launch, whose places this process holds from now on.

    ``ros2 launch`` ends all at once, so the recorder waits for the others.

    :param namespace: as given, with or without a slash at its beginning.
    :raises OccupiedError: another launch of this machine runs some of them.
    """
    specs = processes(setup)
    names = [spec.name for spec in specs]
    _places.enter_context(only_launch(f'/{namespace.strip("/")}', names))
    others = [name for name in names if name != RECORDER]
    return [
        replace(spec, parameters={**spec.parameters, 'outlasts': others})
        if spec.name == RECORDER and others
        else spec
        for spec in specs
    ]


def stop_seconds(name: str) -> tuple[float, float]:
    """Return when ``ros2 launch`` sends SIGTERM to a node that is to end, and then SIGKILL, s."""
    return (OUTLASTING + 40.0, 20.0) if name == RECORDER else (10.0, 5.0)


def _read(argument: LaunchArgument, text: str) -> Any:
    """Return the value of an argument, of its kind."""
    kind = type(argument.usual)
    if kind is str:
        return text
    if kind is tuple:
        return tuple(part.strip() for part in text.split(';') if part.strip())
    try:
        value = parse_json(text.lower() if kind is bool else text, MAX_PARAMETERS)
    except JsonError:
        value = None
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise LaunchArgumentError(
            f'{argument.name}:={shown(text.strip(), 60)} is not {_WANTED[kind]}'
        )
    return value
