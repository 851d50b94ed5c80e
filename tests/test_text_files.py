"""Files and YAML from people: what is read, and that nothing in them stops or ends a command."""

from contextlib import suppress
import os
from pathlib import Path
import time
from typing import Any

from humanopts_ros.text_files import (
    FileError,
    MAX_NODES,
    MAX_TEXT,
    parse_yaml,
    read_text,
    read_yaml,
    YamlError,
)
from hypothesis import given
from hypothesis import strategies as st
import pytest


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('', None),
        ('a: [0, -7, 1.5, .5, 1e3]', {'a': [0, -7, 1.5, 0.5, 1000.0]}),
        ('[Yes, no, ON, true, "no"]', [True, False, True, True, 'no']),
        (
            '[010, 0x1F, 1_000, 12:30, 2026-13-45, +1]',
            ['010', '0x1F', '1_000', '12:30', '2026-13-45', '+1'],
        ),
        ('No: 1\n2: ~', {'No': 1, '2': None}),
        ('a: &x [1]\nb: *x', {'a': [1], 'b': [1]}),
        ('"<<": 1', {'<<': 1}),
        ('\ufeffa: 1\r\nb: 2', {'a': 1, 'b': 2}),
    ],
)
def test_a_value_is_what_is_written(text: str, value: Any, tmp_path: Path) -> None:
    (tmp_path / 'file').write_text(text, newline='')
    found = read_yaml(tmp_path / 'file')
    assert found == value
    assert repr(found) == repr(value)  # 1 and True are not the same


BOMB = ''.join(f'{b}: &{b} [{", ".join([f"*{a}"] * 9)}]\n' for a, b in zip('abcdefgh', 'bcdefghi'))
DEEP, MANY = 'nested more than 40 levels', f'more than {MAX_NODES:,} values'


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        ('[' * 50_000, DEEP),
        ('{a: ' * 50_000, DEEP),
        ('? ' * 50_000, DEEP),
        ('&a [*a]', DEEP),
        (f'a: &a [1, 2]\n{BOMB}', MANY),
        (f'[{"1," * 2_000_000}]', MANY),
        ('1,' * 4_000_000, '8,000,000 characters'),
        ('{[1]: a}', 'a key must be plain text'),
        ('a: &a {b: 1}\nc: {<<: *a}', 'merge keys'),
        ('a: 1\na: 2', "the key 'a' occurs twice (line 2, column 1)"),
        ('{!!int a: 1}', 'remove tags'),
        ('a\n---\nb', 'expected a single document'),
        ('1' * 400, 'an integer that is too large'),
        ('[1e999]', 'not finite'),
        ('a: "b', 'it is not YAML: while scanning a quoted scalar'),
        ('*a', 'it is not YAML: found undefined alias'),
        ('a\0', 'it is not YAML'),
        ('%TAG !a b\n' * 100_000, 'directives'),
    ],
    ids=lambda text: text[:12],
)
def test_what_is_made_to_blow_up_is_refused_at_once(text: str, why: str) -> None:
    began = time.process_time()
    with pytest.raises(YamlError) as raised:
        parse_yaml(text)
    assert why in str(raised.value)
    assert len(str(raised.value)) < 500
    assert time.process_time() - began < 1


@given(st.text(alphabet='[]{}:,-?&*!|>%@`"\'#<~ \nab01.\\\t', max_size=80) | st.text(max_size=40))
def test_any_text_is_a_value_or_a_yaml_error(text: str) -> None:
    with suppress(YamlError):
        parse_yaml(text)


def test_only_regular_files_of_some_size_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'large').write_bytes(b'a' * (MAX_TEXT + 1))
    (tmp_path / 'latin').write_bytes(b'\xe9')
    (tmp_path / 'link').symlink_to('/dev/zero')
    for name, why in {
        '/dev/zero': 'it is not a regular file',
        'pipe': 'it is not a regular file',
        '.': 'it is not a regular file',
        'link': 'it is not a regular file',
        'large': 'is larger than 1,048,576 bytes',
        'latin': 'is not UTF-8 text',
        'none': 'No such file or directory',
        'a\0b': 'it is not a file name',
        'a\udcff\ud800': 'it is not a file name',
        'a' * 5000: 'File name too long',
    }.items():
        with pytest.raises(FileError) as raised:
            read_text(tmp_path / name)
        assert why in str(raised.value)
        assert str(raised.value).isprintable()
