"""Setting up: what is missing is named in one line; the lock file and the targets are whole."""

from importlib.util import find_spec
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PYTHON = os.path.realpath(sys.executable)  # of the system, not of .venv
CHECK = ROOT / 'tools/check_prerequisites.sh'
TEXT: dict[str, Any] = {'capture_output': True, 'text': True, 'check': False}
# A python3 that runs the real one after a line that takes something away from it.
CRIPPLED = """#!/bin/sh
[ "$1" = -c ] || exec {python} "$@"
code="$2"; shift 2
exec {python} -c "{line}
$code" "$@"
"""
OLD = '#!/bin/sh\n[ "$1" = --version ] && echo Python 3.9.2\nexit 1\n'
NO_VENV, NO_HEADERS = (
    CRIPPLED.format(python=PYTHON, line=line)
    for line in (
        "import sys; sys.modules['ensurepip'] = None",
        "import sysconfig; sysconfig.get_path = lambda name: '/nowhere'",
    )
)
REQUIREMENTS = ('requirements-build', 'requirements', 'requirements-test', 'requirements-floor')
TARGETS = (
    'help',
    'setup',
    'demo',
    'test',
    'test-quick',
    'test-floor',
    'lint',
    'docs',
    'wheels',
    'release-check',
    'format',
    'lock',
    'clean',
)


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A PATH with all prerequisites."""
    for name in ('g++', 'git', 'python3'):
        found = PYTHON if name == 'python3' else shutil.which(name)
        assert found
        (tmp_path / name).symlink_to(found)
    return tmp_path


def check(path: Path) -> tuple[int, str, str]:
    """Look for the prerequisites on a machine that has only what is in a folder."""
    done = subprocess.run(
        [shutil.which('bash') or 'bash', CHECK, 'python3'], env={'PATH': str(path)}, **TEXT
    )
    return done.returncode, done.stdout, done.stderr


def test_machine_with_everything_passes_in_silence(machine: Path) -> None:
    assert check(machine) == (0, '', '')


@pytest.mark.parametrize(
    ('program', 'script', 'said', 'package'),
    [
        ('g++', '', 'there is no g++', 'g++'),
        ('git', '', 'there is no git', 'git'),
        ('python3', '', 'there is no python3', 'python3 python3-venv python3-dev'),
        ('python3', OLD, 'Python 3.9.2 is too old, Python 3.11 or newer is needed', 'python3.11'),
        ('python3', NO_VENV, 'python3 has no venv', 'python3-venv'),
        ('python3', NO_HEADERS, 'the headers of python3 are not there', 'python3-dev'),
    ],
)
def test_what_is_missing_is_named_in_one_line_with_its_package(
    machine: Path, program: str, script: str, said: str, package: str
) -> None:
    (machine / program).unlink()
    if script:
        (machine / program).write_text(script)
        (machine / program).chmod(0o755)
    line = f'humanopts: {said}; install it with: apt-get install {package}\n'
    assert check(machine) == (2, '', line)


def test_command_in_a_tree_that_is_not_set_up_says_what_to_run(tmp_path: Path) -> None:
    shutil.copy(ROOT / 'humanopts', tmp_path)
    done = subprocess.run([tmp_path / 'humanopts', 'demo'], **TEXT)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.count('\n') == 1
    assert 'make setup' in done.stderr


@pytest.mark.parametrize('name', REQUIREMENTS)
def test_every_locked_package_is_pinned_with_hashes_and_no_host_is_named(name: str) -> None:
    text = (ROOT / f'{name}.lock').read_text('utf-8')
    entries = re.split(r'^(?=[a-z0-9])', text, flags=re.M)[1:]
    assert len(entries) > 25
    assert [e for e in entries if not re.match(r'[a-z0-9._-]+(\[[\w,-]+\])?==\S+', e)] == []
    assert [e for e in entries if not re.search(r'--hash=sha256:[0-9a-f]{64}', e)] == []
    assert '://' not in text
    assert names(f'{name}.in') <= names(f'{name}.lock')
    assert 'index' not in text.partition('\n')[0]


def versions(file: str) -> set[tuple[str, str | None]]:
    """Return the packages that a file of requirements names, with their versions."""
    lines = (ROOT / file).read_text('utf-8').splitlines()
    package = re.compile(r'([A-Za-z0-9][A-Za-z0-9._-]*)(?:\[.*\])?(?:==(\S+))?')
    found = (package.match(line) for line in lines)
    return {(match[1].lower().replace('_', '-'), match[2]) for match in found if match}


def names(file: str) -> set[str]:
    return {name for name, _ in versions(file)}


@pytest.mark.parametrize('name', ['requirements-build', 'requirements-test'])
def test_one_version_of_each_package_builds_runs_and_is_tested(name: str) -> None:
    both = names('requirements.lock') & names(f'{name}.lock')
    assert {'numpy', 'pytest'} <= both
    found = {entry for entry in versions(f'{name}.lock') if entry[0] in both}
    assert found <= versions('requirements.lock')


def test_a_step_of_the_set_up_reports_its_time_or_all_output_if_it_fails() -> None:
    step = [ROOT / 'tools/step.sh', 'Counting']
    done = subprocess.run([*step, 'true'], **TEXT)
    assert re.fullmatch(r'Counting \.\.\.\nCounting: \d+\.\d s\n', done.stdout)
    assert done.stderr == ''
    fails = ('bash', '-c', 'echo one; echo two >&2; exit 3')
    done = subprocess.run([*step, *fails], **TEXT)
    assert (done.returncode, done.stderr) == (3, 'Counting: failed:\none\ntwo\n')


def make(*arguments: str) -> 'subprocess.CompletedProcess[str]':
    """Run make, also where the tests themselves were started by make."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(('MAKE', 'MFLAGS'))}
    return subprocess.run(['make', *arguments], cwd=ROOT, env=own, **TEXT)


def test_every_target_is_there_and_named_by_help() -> None:
    done = make('--dry-run', *TARGETS)
    assert (done.returncode, done.stderr) == (0, '')
    text = make('help').stdout
    assert [t for t in TARGETS if t != 'help' and f'make {t}' not in text] == []


CHECKS = [
    'checked',
    'docs',
    'lint',
    'release-check',
    'test',
    'test-browser',
    'test-floor',
    'test-slow',
]


@pytest.mark.parametrize('failing', ['', *CHECKS])
def test_the_whole_check_runs_all_checks_and_fails_where_one_does(
    tmp_path: Path, failing: str
) -> None:
    for folder in ('.ci', 'bin', 'build'):
        (tmp_path / folder).mkdir()
    check_all = Path(shutil.copy(ROOT / '.ci/run', tmp_path / '.ci'))
    stand_ins = {
        'make': 'for word; do case $word in "$FAILING") exit 3;; ARGS=*|-*) ;; '
        '*) echo "$word"; esac; done',
        'apt-get': 'echo "$@" >&2',
        'id': 'echo 0',
    }
    for name, script in stand_ins.items():
        stand_in = tmp_path / 'bin' / name
        stand_in.write_text(f'#!/bin/sh\n{script}\n')
        stand_in.chmod(0o755)
    for name in ('bash', 'dirname', 'sh'):  # neither Chromium nor its driver
        (tmp_path / 'bin' / name).symlink_to(shutil.which(name) or '')
    done = subprocess.run(
        check_all,
        env={**os.environ, 'PATH': f'{tmp_path}/bin', 'FAILING': failing},
        **TEXT,
    )
    assert 'chromium chromium-driver' in done.stderr
    assert (done.returncode != 0) is bool(failing)
    if not failing:
        assert sorted(done.stdout.split()) == CHECKS


def test_the_python_of_the_set_up_finds_the_packages_with_nothing_sourced(tmp_path: Path) -> None:
    names = 'humanopts_env, humanopts_learner, humanopts_teach'
    done = subprocess.run(
        [ROOT / '.venv/bin/python', '-c', f'import {names}; humanopts_env.make_domain("taxi")'],
        cwd=tmp_path,
        env={},
        **TEXT,
    )
    assert (done.returncode, done.stderr) == (0, '')


def test_no_plugin_tries_a_failed_test_again() -> None:
    assert find_spec('pytest_rerunfailures') is None


@pytest.fixture
def other_ros(tmp_path: Path) -> dict[str, str]:
    """
    Return the environment of a shell that has sourced another ROS, for another Python.

    Whatever Python imports of it first says so and fails.
    """
    prefix = tmp_path / 'opt/ros/humble'
    for folder in ('lib/python3.10/site-packages', 'here'):
        for package in ('rclpy', 'humanopts_teach', 'numpy'):
            (prefix / folder / package).mkdir(parents=True)
            fault = f'raise ImportError("{package} of another ROS")\n'
            (prefix / folder / package / '__init__.py').write_text(fault)
    (prefix / 'lib/librcl.so').write_text('of another ROS')
    other = str(prefix)
    return {
        **{name: os.environ[name] for name in ('HOME', 'LANG') if name in os.environ},
        'ROS_VERSION': '2',
        'ROS_PYTHON_VERSION': '3',
        'ROS_DISTRO': 'humble',
        'PATH': f'{prefix}/bin:{os.environ["PATH"]}',
        'PYTHONPATH': f'{prefix}/lib/python3.10/site-packages',
        **dict.fromkeys(('LD_LIBRARY_PATH', 'PYTHONHOME', 'VIRTUAL_ENV'), f'{other}/lib'),
        **dict.fromkeys(('AMENT_PREFIX_PATH', 'CMAKE_PREFIX_PATH', 'COLCON_PREFIX_PATH'), other),
        '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1',
    }


def test_commands_work_in_a_shell_that_has_sourced_another_ros(
    tmp_path: Path, other_ros: dict[str, str], domain_id: int
) -> None:
    options: dict[str, Any] = {
        'cwd': tmp_path / 'opt/ros/humble/here',
        'env': {**other_ros, 'ROS_DOMAIN_ID': str(domain_id)},
        'stdout': subprocess.PIPE,
        'stderr': subprocess.PIPE,
        'text': True,
    }

    def run(*command: str | Path) -> 'subprocess.CompletedProcess[str]':
        return subprocess.run(command, check=False, **options)

    status = run(ROOT / 'humanopts', 'status')
    assert (status.returncode, status.stderr) == (2, '')
    assert status.stdout.startswith('no node of humanopts is in')
    words = ('up', 'rooms', '--only', 'game', '--no-record', '--out', tmp_path / 'out')
    with subprocess.Popen([ROOT / 'humanopts', *words], **options) as launch:
        assert launch.stdout.readline() == 'ready: /game\n'
        launch.send_signal(signal.SIGINT)
        assert (launch.communicate()[1], launch.returncode) == ('', 0)
    # What a person's own programs and make start.
    told = run('bash', '-c', f'root={ROOT}; . $root/tools/environment.sh; env')
    made = run('make', '--silent', '-C', ROOT, '--eval', 'told: ; @env', 'told')
    for environment in (told.stdout, made.stdout):
        assert 'HOME=' in environment
        theirs = [line for line in environment.splitlines() if str(tmp_path) in line]
        assert [line for line in theirs if not line.startswith(('PATH=', 'OLDPWD=', 'PWD='))] == []
        assert 'humble\n' not in environment


def test_packages_that_a_user_built_with_colcon_are_found(tmp_path: Path) -> None:
    prefix = tmp_path / 'my_robot'
    (prefix / 'lib/python3.11/site-packages').mkdir(parents=True)
    given = {**os.environ, 'HUMANOPTS_OVERLAY': str(tmp_path)}
    told = subprocess.run(
        ['bash', '-c', f'root={ROOT}; . $root/tools/environment.sh; env'], env=given, **TEXT
    )
    environment = dict(line.split('=', 1) for line in told.stdout.splitlines() if '=' in line)
    for name, folder in (
        ('AMENT_PREFIX_PATH', prefix),
        ('LD_LIBRARY_PATH', prefix / 'lib'),
        ('PYTHONPATH', prefix / 'lib/python3.11/site-packages'),
    ):
        assert str(folder) in environment[name].split(':')
