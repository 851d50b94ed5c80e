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
MEGABYTE = 2**20
LEARNS = """
from humanopts_env import make_domain
from humanopts_learner import demonstrations_from_table, learn_option, plan
import sys
rooms = make_domain('rooms')
shown = demonstrations_from_table(sys.argv[1], rooms, features=['row', 'col'])
north = [demo for demo in shown if demo.option_name == 'go to the north doorway']
option = learn_option(north, rooms, seed=1)
print(plan(rooms, [option], gamma=0.9).option_in(rooms.start_states[0]))
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
    known = ('HOME', 'XDG_CACHE_HOME', 'PIP_CONFIG_FILE', 'PIP_INDEX_URL', 'ROS_DOMAIN_ID', 'TERM')
    given = {name: os.environ[name] for name in known if name in os.environ}
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

    def run(self, program: str, *arguments: object) -> str:
        """Run a program of the environment."""
        return run(self.folder / 'bin' / program, *arguments, PATH=str(self.folder / 'bin'))

    def install(self, *packages: str) -> None:
        """Install packages with pip, ours from the folder of wheels."""
        self.run('pip', 'install', '--quiet', '--find-links', self._dist, *packages)

    @property
    def size(self) -> str:
        """The disk space of all files."""
        paths = [
            path for path in self.folder.rglob('*') if path.is_file() and not path.is_symlink()
        ]
        return f'{sum(path.stat().st_blocks * 512 for path in paths) / MEGABYTE:.0f} MB'

    def versions(self) -> dict[str, str]:
        """Return the installed versions by name."""
        lines = self.run('pip', 'list', '--format', 'freeze').split()
        return dict(line.split('==') for line in lines if '==' in line)


def check_learner(dist: Path, work: Path) -> None:
    """Learn from a table where only the learner is installed, and where others came before."""
    table = ROOT / 'examples/own_table/demonstrations.csv'
    with check('humanopts-learner alone') as remarks:
        alone = Environment(work / 'learner', dist)
        alone.install('humanopts-learner')
        remarks.append(alone.size)
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
        beside.run('python', '-P', ROOT / 'examples/options_as_actions/q_learning.py')
    with check('humanopts-learner is installable with Python ' + ', '.join(PYTHONS)):
        for version in PYTHONS:
            uv = Path(sys.executable).with_name('uv')
            wanted = work / 'learner.in'
            wanted.write_text('humanopts-learner[tables]\n')
            run(
                *(uv, 'pip', 'compile', '--quiet', '--only-binary', ':all:'),
                *('--python-version', version, '--find-links', dist, wanted),
            )


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
        for words in ('teach', 'study', 'status', 'up'):
            whole.run('humanopts', words, '--help')


def main() -> int:
    """Run all checks."""
    dist = Path(sys.argv[1]).absolute()
    work = Path(tempfile.mkdtemp(prefix='release-check-'))
    try:
        with check('metadata'):
            uv = Path(sys.executable).with_name('uv')
            run(
                uv,
                'tool',
                'run',
                'twine',
                'check',
                '--strict',
                *dist.iterdir(),
                PATH=os.environ['PATH'],
            )
        with check('files'):
            check_files(dist)
        check_learner(dist, work)
        check_all(dist, work)
    except CheckError as error:
        print(f'failed: {error}', file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(work)
    return 0


if __name__ == '__main__':
    sys.exit(main())
