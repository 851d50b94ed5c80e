"""Bags that other tools compressed, converted or stripped are read, or refused with advice."""

from collections.abc import Callable
import gzip
import lzma
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from typing import Any

from humanopts_teach.cli import main
import pytest
import yaml

TOOLS = Path(sys.executable).parent
TOPICS = ('/game_state', '/domain_info', '/demonstrations', '/lesson_state')


def convert(bag: Path, out: Path, *options: str) -> Path:
    """Convert a lesson with the tool of rosbags."""
    tool = [TOOLS / 'rosbags-convert', '--src', bag, '--dst', out, '--dst-storage']
    subprocess.run([*tool, *options, '--include-topic', *TOPICS], check=True)
    return out


def refusal(bag: Path, capsys: pytest.CaptureFixture[str], command: str = 'check') -> str:
    """Return the one line with which a command refuses a bag."""
    capsys.readouterr()
    assert main(['bag', command, str(bag)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return str(line)


@pytest.mark.parametrize(
    ('storage', 'mode', 'words'),
    [
        ('mcap', 'file', 'in MCAP format, compressed, such as bag_of_others.mcap.zstd; '),
        ('mcap', 'message', 'each message of .* is compressed; '),
        ('sqlite3', 'file', 'in sqlite3 format, compressed, such as .*db3.zstd; '),
    ],
)
def test_a_compressed_bag_is_named_with_the_command_that_converts_it(
    tmp_path: Path,
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
    storage: str,
    mode: str,
    words: str,
) -> None:
    bag = tmp_path / 'bag_of_others'
    convert(lesson_bag, bag, storage, '--compress', 'zstd', '--compress-mode', mode)
    bare = Path(shutil.copytree(bag, tmp_path / 'bare' / bag.name))
    (bare / 'metadata.yaml').unlink()
    for command, path in (('check', bare), ('info', bag), ('eval', bag)):
        line = refusal(path, capsys, command)
        assert re.search(words, line)
        assert 'damaged' not in line
    tool, *arguments = shlex.split(line.partition('convert it: ')[2])
    subprocess.run([TOOLS / tool, *arguments], check=True)
    made = Path(arguments[arguments.index('--dst') + 1])
    assert main(['bag', 'check', str(made)]) == 0


@pytest.mark.parametrize(('suffix', 'compress'), [('.xz', lzma.compress), ('', gzip.compress)])
def test_a_compressed_file_names_the_command_that_decompresses_it(
    tmp_path: Path,
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
    suffix: str,
    compress: Callable[[bytes], bytes],
) -> None:
    packed = tmp_path / f'a lesson.mcap{suffix}'
    packed.write_bytes(compress((lesson_bag / 'bag_0.mcap').read_bytes()))
    command = refusal(packed, capsys).partition('decompress it: ')[2]
    subprocess.run(command, shell=True, check=True)
    assert main(['bag', 'check', shlex.split(command)[-1]]) == 0


def edit(bag: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change the values of a bag's metadata."""
    path = bag / 'metadata.yaml'
    values = yaml.safe_load(path.read_text())
    change(values['rosbag2_bagfile_information'])
    path.write_text(yaml.safe_dump(values))
    return bag


def test_one_compressed_file_of_several_is_named(
    tmp_path: Path, lesson_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = Path(shutil.copytree(lesson_bag, tmp_path / 'bag'))
    (bag / 'bag_1.mcap.zstd').write_bytes(b'\x28\xb5\x2f\xfd')
    edit(bag, lambda values: values['relative_file_paths'].append('bag_1.mcap.zstd'))
    assert main(['bag', 'check', str(bag)]) == 1
    text = capsys.readouterr().out
    assert 'bag_1.mcap.zstd is left out: it is compressed; decompress it: zstd -d -c' in text
    assert 'does not exist' not in text


@pytest.mark.parametrize(
    'drop',
    [lambda values: values.pop('custom_data'), lambda values: values.update(custom_data=None)],
)
def test_facts_that_another_tool_dropped_are_not_damage(
    tmp_path: Path, lesson_bag: Path, drop: Callable[[dict[str, Any]], object]
) -> None:
    bag = edit(Path(shutil.copytree(lesson_bag, tmp_path / 'bag')), drop)
    assert main(['bag', 'check', str(bag)]) == 0
