"""Files and YAML from people: what is read, and that nothing in them stops or ends a command."""

from contextlib import suppress
import os
from pathlib import Path
import time
from typing import Any

from humanopts_ros.text_files import (
    FileError,
    MAX_ALIASES,
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


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        pytest.param('[' * 50_000, 'nested more than 40 levels', id='brackets'),
        pytest.param('- ' * 50_000, 'nested more than 40 levels', id='lists'),
        pytest.param('{a: ' * 50_000, 'nested more than 40 levels', id='maps'),
        pytest.param('? ' * 50_000, 'a key has to be a plain text', id='keys'),
        pytest.param(f'a: &a [1, 2]\n{BOMB}', f'more than {MAX_NODES:,} values', id='aliases'),
        pytest.param(f'[&a 1{", *a" * (MAX_ALIASES + 1)}]', 'aliases', id='many aliases'),
        pytest.param('&a [*a]', 'has no value before it', id='alias of itself'),
        pytest.param('a: &a {b: 1}\nc: {<<: *a}', 'merge keys', id='merge'),
        pytest.param('a: 1\na: 2', "the key 'a' is there twice (line 2, column 1)", id='twice'),
        pytest.param('!!int "x"', 'remove tags', id='tag'),
        pytest.param('{!!int a: 1}', 'a key has to be a plain text', id='tag of a key'),
        pytest.param('a\n---\nb', 'several documents', id='documents'),
        pytest.param('1' * 400, 'an integer that is too large', id='integer'),
        pytest.param('[1e999]', '1e999, which is not finite', id='float'),
        pytest.param('-.inf', '-.inf, which is not finite', id='infinity'),
        pytest.param('a: "b', 'it is not YAML: while scanning a quoted scalar', id='quote'),
        pytest.param('a\0', 'it is not YAML', id='NUL'),
        pytest.param('%TAG !a b\n' * 100_000, 'directives', id='directives'),
        pytest.param('1,' * 4_000_000, '8,000,000 characters', id='size'),
        pytest.param(f'[{"1," * 2_000_000}]', f'more than {MAX_NODES:,} values', id='values'),
    ],
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
        'latin': 'is not a text in UTF-8',
        'none': 'No such file or directory',
        'a\0b': 'it is not a file name',
        'a\udcff\ud800': 'it is not a file name',
        'a' * 5000: 'File name too long',
    }.items():
        with pytest.raises(FileError) as raised:
            read_text(tmp_path / name)
        assert why in str(raised.value)
        assert str(raised.value).isprintable()
