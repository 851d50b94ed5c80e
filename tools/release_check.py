"""
Check the wheels and sdists in a folder, such as dist/, as their users meet them.

Their metadata, their files, and for each way of use an installation with pip into a new
environment, on a PATH without compiler, make and git. Prints a line per check with its time and
the size of the environment; exits with status 1 after the first failure.

Usage: release_check.py FOLDER
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile

ROOT = Path(__file__).parent.parent
PURE = ('humanopts_ros', 'humanopts_env', 'humanopts_learner', 'humanopts_teach')
# The packages that a user's environment has already, older than the newest.
OLDER = {'numpy': '1.26.4', 'scipy': '1.11.4', 'scikit-learn': '1.4.2', 'pandas': '2.1.4'}
PYTHONS = ('3.11', '3.12', '3.13')
OF_INDEX = 'PIP_', 'UV_', 'SSL_', 'REQUESTS_'  # settings of the package index
MEGABYTE = 2**20
MAX_LEARNER = 350  # MB
LEARNS = """
from humanopts_env import make_domain
from humanopts_learner import demonstrations_from_table, learn_option, plan
import sys
rooms = make_domain('rooms')
shown = demonstrations_from_table(sys.argv[1], rooms, features=['row', 'col'])
north = [demo for demo in shown if demo.option_name == 'go to the north doorway']
option = learn_option(north, rooms, seed=1)
state = rooms.state_at(int(rooms.start_states()[0]))
assert plan(rooms, [option], gamma=0.9).choose(state).name
assert 'rclpy' not in sys.modules
"""


class CheckError(Exception):
    """A check failed; the message gives the reason."""


@contextmanager
def check(text: str) -> Iterator[list[str]]:
    """Time a check, and print it with the remarks that it adds to the list."""
    began, remarks = time.monotonic(), list[str]()
    yield remarks
    print(f'{text}: {time.monotonic() - began:.1f} s', *remarks, sep=', ', flush=True)


def run(*command: object, **variables: str) -> str:
    """
    Run a command with nothing of this process's environment, and return its output.

    :raises CheckError: it failed.
    """
    known = 'HOME', 'TERM', 'ROS_DOMAIN_ID', 'XDG_CACHE_HOME'
    given = {n: v for n, v in os.environ.items() if n in known or n.startswith(OF_INDEX)}
    done = subprocess.run(
        [*map(str, command)],
        env={**given, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        raise CheckError(f'{" ".join(map(str, command))}:\n{done.stdout}')
    return done.stdout


def expected_files(package: str) -> set[str]:
    """Return the files of a package that its wheel has to hold, by the repository's index."""
    inside = ROOT / 'src' / package
    tracked = run(
        '/usr/bin/env', 'git', '-C', inside, 'ls-files', package, PATH=os.environ['PATH']
    )
    return set(tracked.split())


def check_files(dist: Path) -> None:
    """Compare the files of each wheel with what is expected."""
    for package in PURE:
        (wheel,) = dist.glob(f'{package}-*.whl')
        inside = {name for name in zipfile.ZipFile(wheel).namelist() if name[-1] != '/'}
        own = {name for name in inside if name.startswith(f'{package}/')}
        if differ := own ^ expected_files(package):
            raise CheckError(
                f'{wheel.name} and src/{package} differ in {", ".join(sorted(differ))}'
            )
    (wheel,) = dist.glob('humanopts_interfaces-*.whl')
    inside = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / 'src/humanopts_interfaces').glob('*/*'):
        if path.parent.name in ('msg', 'srv', 'action'):
            ending = f'/share/humanopts_interfaces/{path.parent.name}/{path.name}'
            if not any(name.endswith(ending) for name in inside):
                raise CheckError(f'{wheel.name} lacks {path.parent.name}/{path.name}')


class Environment:
    """A new environment of Python, with only its own programs on the PATH."""

    def __init__(self, folder: Path, dist: Path) -> None:
        self.folder, self._dist = folder, dist
        run(sys.executable, '-m', 'venv', folder)

    def run(self, program: str, *arguments: object, **variables: str) -> str:
        """Run a program of the environment."""
        given = {'PATH': str(self.folder / 'bin'), **variables}
        return run(self.folder / 'bin' / program, *arguments, **given)

    def refuses(self, text: str, program: str, *arguments: object) -> None:
        """
        Run a program that has to fail with a text.

        :raises CheckError: it does not.
        """
        try:
            said = self.run(program, *arguments)
        except CheckError as error:
            said = ' '.join(str(error).split())
            if text in said:
                return
        raise CheckError(f'{program} does not say: {text}\n{said}')

    def install(self, *packages: str) -> None:
        """Install packages with pip, ours from the folder of wheels."""
        self.run('pip', 'install', '--quiet', '--find-links', self._dist, *packages)

    @property
    def size(self) -> str:
        """The disk space of all files, in words."""
        return f'{self.megabytes:.0f} MB'

    @property
    def megabytes(self) -> float:
        """The disk space of all files, in units of 2**20 bytes."""
        paths = [
            path for path in self.folder.rglob('*') if path.is_file() and not path.is_symlink()
        ]
        return sum(path.stat().st_blocks * 512 for path in paths) / MEGABYTE

    def versions(self) -> dict[str, str]:
        """Return the installed versions by name."""
        lines = self.run('pip', 'list', '--format', 'freeze').split()
        return dict(line.split('==') for line in lines if '==' in line)


def check_learner(dist: Path, work: Path) -> Environment:
    """Learn from a table where only the learner is installed, and where others came before."""
    table = ROOT / 'examples/own_table/demonstrations.csv'
    with check('humanopts-learner alone') as remarks:
        alone = Environment(work / 'learner', dist)
        alone.install('humanopts-learner')
        remarks.append(alone.size)
        if alone.megabytes > MAX_LEARNER:
            raise CheckError(f'it is larger than {MAX_LEARNER} MB')
        for name in alone.versions():
            if name.startswith('ros-') or name in ('pandas', 'nicegui'):
                raise CheckError(f'humanopts-learner installs {name}')
        alone.install('pandas')
        remarks.append(f'with pandas {alone.size}')
        alone.run('python', '-P', '-c', LEARNS, table)
    with check('humanopts-learner beside older packages'):
        beside = Environment(work / 'beside', dist)
        beside.install(*(f'{name}=={version}' for name, version in OLDER.items()), 'matplotlib')
        before = beside.versions()
        beside.install('humanopts-learner', 'gymnasium')
        after = beside.versions()
        if changed := {name for name in before if before[name] != after.get(name)}:
            raise CheckError(f'humanopts-learner replaces {", ".join(sorted(changed))}')
        beside.run('python', '-P', '-c', LEARNS, table)
        beside.run(
            'python', '-P', ROOT / 'examples/own_table/learn_from_table.py', '--out', work / 'own'
        )
    with check('humanopts-learner is installable with Python ' + ', '.join(PYTHONS)):
        for version in PYTHONS:
            uv = Path(sys.executable).with_name('uv')
            wanted = work / 'learner.in'
            wanted.write_text('humanopts-learner[tables]\n')
            run(
                *(uv, 'pip', 'compile', '--quiet', '--only-binary', ':all:'),
                *('--python-version', version, '--find-links', dist, wanted),
            )
    return beside


def check_gymnasium(learner: Environment, lesson: Path) -> None:
    """Use the options of a lesson as actions of a Gymnasium environment."""
    with check('options as actions, with the learner alone'):
        script, env = ROOT / 'examples/options_as_actions/q_learning.py', 'humanopts/Taxi-v0'
        learner.run('python', '-P', script, env, lesson, '--episodes', 10)


def check_refusals(dist: Path, work: Path) -> None:
    """Check what a user reads who lacks an extra, or has another Python."""
    with check('humanopts without extras'):
        bare = Environment(work / 'bare', dist)
        bare.install('humanopts')
        bare.refuses("install it with: pip install 'humanopts[ros]'", 'humanopts', 'demo', 'taxi')
    with check('interfaces for another Python'):
        install = 'install', '--no-binary', 'humanopts-interfaces', '--find-links', dist
        bare.refuses('is compiled for Python', 'pip', *install, 'humanopts-interfaces')


def check_all(dist: Path, work: Path) -> None:
    """Teach, record, plan and report where everything is installed."""
    with check('humanopts[all], from pip to the first report') as remarks:
        whole = Environment(work / 'all', dist)
        whole.install('humanopts[all]')
        report = work / 'demo'
        whole.run(
            'humanopts', 'demo', 'taxi', '--learn', 'goal', '--episodes', '5', '--out', report
        )
        remarks.append(whole.size)
    with check('its commands'):
        version = whole.run('humanopts', '--version').strip()
        if version != whole.versions()['humanopts']:
            raise CheckError(f'humanopts --version prints {version}')
        if not (report / 'report.html').stat().st_size:
            raise CheckError('the report is empty')
        for words in ('bag check', 'bag eval'):
            whole.run('humanopts', *words.split(), report / 'bag')
        for words in ('teach', 'study', 'up'):
            whole.run('humanopts', words, '--help')
    with check('its commands where another ROS is sourced'):
        other = work / 'opt/ros/humble'
        (other / 'rclpy').mkdir(parents=True)
        (other / 'rclpy/__init__.py').write_text('raise ImportError("of another Python")\n')
        names = 'AMENT_PREFIX_PATH', 'PYTHONPATH', 'LD_LIBRARY_PATH'
        sourced = {'ROS_DISTRO': 'humble', **dict.fromkeys(names, str(other))}
        whole.run('humanopts', 'demo', 'taxi', '--episodes', 1, '--out', work / 'other', **sourced)


def main() -> int:
    """Run all checks."""
    dist = Path(sys.argv[1]).absolute()
    work = Path(tempfile.mkdtemp(prefix='release-check-'))
    try:
        with check('metadata'):
            tools = Environment(work / 'tools', dist)
            tools.install('twine')
            tools.run('twine', 'check', '--strict', *dist.glob('humanopts*'))
        with check('files'):
            check_files(dist)
        learner = check_learner(dist, work)
        check_refusals(dist, work)
        check_all(dist, work)
        check_gymnasium(learner, work / 'demo')
    except CheckError as error:
        print(f'failed: {error}', file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(work)
    return 0


if __name__ == '__main__':
    sys.exit(main())
