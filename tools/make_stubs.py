"""
Write type stubs of ROS interfaces, so that mypy knows the fields of a message.

``make_stubs.py OUT SHARE...`` reads the .msg, .srv and .action files of every package in
``SHARE/<package>/`` (the share folder of a ROS prefix, or a folder of packages).
"""

from collections.abc import Iterator
from pathlib import Path
import re
import sys

from rosidl_adapter.parser import (
    MessageSpecification,
    parse_action_string,
    parse_message_string,
    parse_service_string,
    Type,
)

PYTHON = {'bool': 'bool', 'byte': 'bytes', 'string': 'str', 'wstring': 'str'}
PYTHON |= dict.fromkeys(('float32', 'float64'), 'float')
PYTHON |= dict.fromkeys(
    ('char', *(f'{u}int{n}' for u in ('', 'u') for n in (8, 16, 32, 64))), 'int'
)
HEAD = [
    'from array import array',
    'from collections.abc import Sequence',
    'from typing import Any, Final',
    'from numpy.typing import NDArray',
]


def stub_of_message(name: str, spec: MessageSpecification) -> Iterator[str]:
    """Yield the lines of a class; arrays have rclpy's types, and can be set from sequences."""
    yield f'class {name}:'
    for constant in spec.constants:
        value = bytes([constant.value]) if constant.type == 'byte' else constant.value
        yield f'    {constant.name}: Final = {value!r}'
    given = ''.join(f', {f.name}: {_given(f.type)} = ...' for f in spec.fields)
    yield f'    def __init__(self{", *" if given else ""}{given}) -> None: ...'
    yield '    @classmethod'
    yield '    def get_fields_and_field_types(cls) -> dict[str, str]: ...'
    for field in spec.fields:
        kept, given = _kept(field.type), _given(field.type)
        if kept == given:
            yield f'    {field.name}: {kept}'
            continue
        yield '    @property'
        yield f'    def {field.name}(self) -> {kept}: ...'
        yield f'    @{field.name}.setter'
        yield f'    def {field.name}(self, value: {given}) -> None: ...'


def _element(kind: Type) -> str:
    return PYTHON.get(kind.type) or f'{kind.pkg_name}.msg.{kind.type}'


def _given(kind: Type) -> str:
    if not kind.is_array:
        return _element(kind)
    return _kept(kind) if _is_fixed(kind) else f'Sequence[{_element(kind)}]'


def _kept(kind: Type) -> str:
    if not kind.is_array:
        return _element(kind)
    if _is_fixed(kind):
        return 'NDArray[Any]'
    collection = 'array' if _element(kind) in ('int', 'float') else 'list'
    return f'{collection}[{_element(kind)}]'


def _is_fixed(kind: Type) -> bool:
    fixed = bool(kind.is_array and kind.array_size and not kind.is_upper_bound)
    return fixed and _element(kind) in ('int', 'float')


def stub_of_file(kind: str, package: str, name: str, text: str) -> Iterator[str]:
    """Yield the lines for a .msg file, or a class with the parts of a .srv or .action file."""
    if kind == 'msg':
        yield from stub_of_message(name, parse_message_string(package, name, text))
        return
    parse, parts = PARTS[kind]
    spec = parse(package, name, text)
    yield f'class {name}:'
    for part in parts:
        for line in stub_of_message(part, getattr(spec, part.lower())):
            yield f'    {line}'


PARTS = {
    'srv': (parse_service_string, ('Request', 'Response')),
    'action': (parse_action_string, ('Goal', 'Result', 'Feedback')),
}


def write_package(package: Path, out: Path) -> None:
    """Write the stubs of one package."""
    for kind in ('msg', *PARTS):
        files = sorted((package / kind).glob(f'*.{kind}'))
        if not files:
            continue
        lines = [
            line
            for file in files
            for line in stub_of_file(kind, package.name, file.stem, file.read_text('utf-8'))
        ]
        used = sorted(set(re.findall(r'\w+\.msg(?=\.)', '\n'.join(lines))))
        imports = [f'import {name}' for name in used]
        folder = out / package.name / kind
        folder.mkdir(parents=True, exist_ok=True)
        (folder / '__init__.pyi').write_text('\n'.join([*HEAD, *imports, *lines, '']), 'utf-8')
        (out / package.name / '__init__.pyi').touch()


def main(arguments: list[str]) -> int:
    """Write the stubs of every package in the given folders."""
    out, *shares = map(Path, arguments)
    for share in shares:
        for package in sorted(share.iterdir()):
            write_package(package, out)
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
