"""``ros2 launch``: its arguments are the options of ``humanopts up``."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from humanopts_teach.cli import app, up_setup
from humanopts_teach.command_line import bundled
from humanopts_teach.commands import refusing
from humanopts_teach.launching import OUTLASTING, RECORDER
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import processes, ProcessSpec, Setup
import typer

_commands: Any = typer.main.get_command(app)
_UP = _commands.commands['up']
ARGUMENTS: dict[str, tuple[str, str]] = {  # default and description of each, by name
    each.name: (
        str(each.default) if isinstance(each.default, str | int) else '',
        each.help + '; separate several by ;' * each.multiple,
    )
    for each in _UP.params
    if each.name != 'domain'
} | {'domain': ('taxi', 'name of the domain')}
_places = ExitStack()  # held until this process ends


def setup_from_launch(texts: Mapping[str, str]) -> Setup:
    """
    Return the setup described by the arguments of a launch.

    It has no keyboard, since ``ros2 launch`` gives no process the terminal.

    :param texts: values of the arguments, by name; empty: not given.
    :raises CommandError: an argument is invalid.
    """
    words = [texts['domain']]
    for each in _UP.params:
        text = texts[each.name].strip()
        if each.name == 'domain' or not text:
            continue
        if each.is_flag and text.lower() in ('true', 'false'):
            words += (each.opts if text.lower() == 'true' else each.secondary_opts)[:1]
        else:
            name = [*each.opts, *each.secondary_opts][0]
            parts = text.split(';') if each.multiple else [text]
            words += [f'{name}={part.strip()}' for part in parts]
    with refusing(typer.TyperException):
        return up_setup(**bundled(up_setup, _UP.make_context('up', words).params))


def launched(setup: Setup) -> list[ProcessSpec]:
    """
    Return the processes of a launch, and reserve their names until this process ends.

    ``ros2 launch`` ends all processes at once, so the recorder waits for the others.

    :raises OccupiedError: another launch on this machine runs one of these nodes.
    """
    specs = processes(setup)
    names = [spec.name for spec in specs]
    _places.enter_context(only_launch(setup.namespace, names))
    other_names = [name for name in names if name != RECORDER]
    return [
        replace(spec, parameters={**spec.parameters, 'outlasts': other_names})
        if spec.name == RECORDER and other_names
        else spec
        for spec in specs
    ]


def stop_seconds(name: str) -> tuple[float, float]:
    """Return the timeouts after which ``ros2 launch`` sends SIGTERM and then SIGKILL, s."""
    return (OUTLASTING + 40.0, 20.0) if name == RECORDER else (10.0, 5.0)
