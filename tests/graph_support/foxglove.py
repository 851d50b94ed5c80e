"""What Foxglove's own JavaScript packages make of MCAP files; see tests/foxglove."""

from collections.abc import Sequence
import fcntl
import json
import os
from pathlib import Path
import shutil
import subprocess
from typing import Any, NoReturn

import pytest

SOURCE = Path(__file__).parents[1] / 'foxglove'
FOLDER = Path(__file__).parents[2] / 'build' / 'foxglove'
REQUIRED = 'HUMANOPTS_REQUIRE_NPM'  # where it is set, a test that cannot run has failed
INSTALL = ('npm', 'ci', '--ignore-scripts', '--no-audit', '--no-fund')


def decode(how: str, files: Sequence[Path]) -> list[str]:
    """
    Return what decode.mjs prints of some MCAP files, a line of JSON for each thing found.

    :param how: indexed (in order of time) or streamed (in that of the file).
    """
    install()
    command = ['node', str(FOLDER / 'decode.mjs'), how, *map(str, files)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout.rstrip('\n').split('\n')


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
        if shutil.which('npm') is None:
            _unavailable('npm is not installed here')
        run = subprocess.run(
            INSTALL, cwd=FOLDER, capture_output=True, text=True, timeout=100, check=False
        )
        if run.returncode:
            _unavailable(f'npm cannot install the packages of tests/foxglove: {run.stderr}')
        done.write_text(wanted, 'utf-8')


def _unavailable(reason: str) -> NoReturn:
    """Skip, since nothing else here needs npm; fail where the check insists on it."""
    if os.environ.get(REQUIRED):
        pytest.fail(reason)
    pytest.skip(reason)


def _number(value: dict[str, Any]) -> Any:
    """Return the number that decode.mjs wrote as a text, or an object as it is."""
    if set(value) != {'$'}:
        return value
    text = value['$'].replace('Infinity', 'inf')
    return float(text) if text in ('NaN', 'inf', '-inf') else int(text)
