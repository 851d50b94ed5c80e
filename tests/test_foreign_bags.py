"""Bags that other tools have compressed, converted or stripped: said what they are, and read."""

import bz2
import gzip
import lzma
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys

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
    ('storage', 'mode', 'said'),
    [
        ('mcap', 'file', 'the files of .* are compressed, such as bag_of_others.mcap.zstd; '),
        ('mcap', 'message', 'each message of .* is compressed; '),
        ('sqlite3', 'file', 'sqlite3 format, with compressed files such as .*db3.zstd; '),
        ('sqlite3', 'message', 'is a bag in sqlite3 format; '),
    ],
)
def test_a_compressed_bag_says_so_and_the_command_that_it_names_makes_one_that_is_read(
    tmp_path: Path,
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
    storage: str,
    mode: str,
    said: str,
) -> None:
    compress = ['--compress', 'zstd', '--compress-mode', mode]
    bag = convert(lesson_bag, tmp_path / 'bag_of_others', storage, *compress)
    for command in ('check', 'eval', 'info', 'table1'):
        line = refusal(bag, capsys, command)
        assert re.search(said, line)
        assert 'damaged' not in line
    (bag / 'metadata.yaml').unlink()
    if storage == 'mcap':
        assert re.search(said, refusal(bag, capsys))
    shutil.rmtree(bag)
    convert(lesson_bag, bag, storage, *compress)
    tool, *arguments = shlex.split(line.partition('convert it: ')[2])
    subprocess.run([TOOLS / tool, *arguments], check=True)
    made = Path(arguments[arguments.index('--dst') + 1])
    assert main(['bag', 'check', str(made)]) == 0


@pytest.mark.parametrize(
    ('suffix', 'compress'),
    [('.gz', gzip.compress), ('.bz2', bz2.compress), ('.xz', lzma.compress), ('', gzip.compress)],
)
def test_a_compressed_file_names_the_command_that_decompresses_it(
    tmp_path: Path,
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
    suffix: str,
    compress: object,
) -> None:
    assert callable(compress)
    packed = tmp_path / f'a lesson.mcap{suffix}'
    packed.write_bytes(compress((lesson_bag / 'bag_0.mcap').read_bytes()))
    command = refusal(packed, capsys).partition('decompress it: ')[2]
    subprocess.run(command, shell=True, check=True)
    made = shlex.split(command)[-1]
    assert main(['bag', 'check', made]) == 0


def test_one_compressed_file_of_several_is_named(
    tmp_path: Path, lesson_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = Path(shutil.copytree(lesson_bag, tmp_path / 'bag'))
    (bag / 'bag_1.mcap.zstd').write_bytes(b'\x28\xb5\x2f\xfd')
    metadata = yaml.safe_load((bag / 'metadata.yaml').read_text())
    metadata['rosbag2_bagfile_information']['relative_file_paths'].append('bag_1.mcap.zstd')
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    assert main(['bag', 'check', str(bag)]) == 1
    said = capsys.readouterr().out
    assert 'bag_1.mcap.zstd is left out: it is compressed; decompress it: zstd -d -c' in said
    assert 'not there' not in said


@pytest.mark.parametrize('left', ['key', 'null', 'empty'])
def test_facts_that_another_tool_has_dropped_are_no_damage(
    tmp_path: Path, lesson_bag: Path, capsys: pytest.CaptureFixture[str], left: str
) -> None:
    bag = Path(shutil.copytree(lesson_bag, tmp_path / 'bag'))
    metadata = yaml.safe_load((bag / 'metadata.yaml').read_text())
    information = metadata['rosbag2_bagfile_information']
    del information['custom_data']
    if left != 'key':
        information['custom_data'] = None if left == 'null' else {}
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    assert main(['bag', 'check', str(bag)]) == 0
    assert 'is whole' in capsys.readouterr().out
