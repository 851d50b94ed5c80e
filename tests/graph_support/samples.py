"""A message of every type that is installed, with something in every field."""

import os
from pathlib import Path
import re
from typing import Any

from humanopts_teach.ros.raw_subscriber import load_type

CALLS = ('SendGoal', 'GetResult')
PARTS = {
    'msg': [''],
    'srv': ['_Request', '_Response', '_Event'],
    'action': [
        '_FeedbackMessage',
        *(f'_{call}_{part}' for call in CALLS for part in ('Request', 'Response', 'Event')),
    ],
}


def installed_types() -> list[str]:
    """Return every type that a topic can have here."""
    prefixes = [Path(p) for p in os.environ['AMENT_PREFIX_PATH'].split(os.pathsep)]
    files = [file for prefix in prefixes for file in prefix.glob('share/*/*/*.*')]
    return sorted(
        {
            f'{file.parent.parent.name}/{kind}/{file.stem}{part}'
            for file in files
            for kind, parts in PARTS.items()
            for part in parts
            if file.suffix == f'.{kind}' and file.parent.name == kind
        }
    )


def filled(type_name: str) -> Any:
    """Return a message with something in every field and every array."""
    message = load_type(type_name)()
    for number, (name, kind) in enumerate(message.get_fields_and_field_types().items(), start=1):
        setattr(message, name, sample(kind, number))
    return message


def sample(kind: str, number: int) -> Any:
    """Return a value for a field; an integer that needs all bits of its type."""
    if (fixed := re.fullmatch(r'(.*)\[(\d+)\]', kind)) is not None:
        return [sample(fixed[1], number)] * int(fixed[2])
    if (sequence := re.fullmatch(r'sequence<(.*?)(, \d+)?>', kind)) is not None:
        return [sample(sequence[1], number)] * (1 if sequence[2] else 2)
    if (integer := re.fullmatch(r'(u?)int(\d+)', kind)) is not None:
        bits = int(integer[2])
        return 2**bits - number if integer[1] else number - 2 ** (bits - 1)
    if '/' in kind:
        package, name = kind.split('/')
        return filled(f'{package}/{part_folder(name)}/{name}')
    return {
        'boolean': True,
        'octet': bytes([256 - number]),
        'float': number + 0.5,
        'double': number + 0.1,
        'string': f'text {number} é \N{GRINNING FACE}\N{LINE SEPARATOR}',
    }[kind.partition('<')[0]]


def part_folder(name: str) -> str:
    """Say where a nested type lives."""
    if '_' not in name:
        return 'msg'
    return 'action' if re.search('_(SendGoal|GetResult|Feedback|Goal|Result)', name) else 'srv'
