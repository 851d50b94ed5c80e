"""
Check the wheels and sdists in a folder, such as dist/, from the view of their users.

The checks cover metadata, changelogs and files; for each use, an installation with pip into a new
environment, on a PATH without compiler, make and git; and the set-up of a clone. Each check prints
a line with its time and the size of the environment. The first failure ends the program with
status 1. Times until the first report are also given in units of a loop of 20 million additions,
because machines differ.

--quick: only checks that take seconds, with uv in place of pip.

Usage: release_check.py FOLDER [--quick]
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile

ROOT = Path(__file__).parent.parent
UV = Path(sys.executable).with_name('uv')
PURE = ('humanopts_ros', 'humanopts_env', 'humanopts_learner', 'humanopts_teach')
# Packages that a user's environment already has, in older versions.
OLDER = {'numpy': '1.26.4', 'scipy': '1.11.4', 'scikit-learn': '1.4.2', 'pandas': '2.1.4'}
OLD_PIP = 'pip==20.2.4'
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
PLAYS = """
import gymnasium
env = gymnasium.make('humanopts_env.gym_env:humanopts/Taxi-v0')
observation, info = env.reset(seed=1)
assert env.unwrapped.P[observation]
"""


# Run a command with a folder mounted read-only, in a separate namespace.
READ_ONLY = (
    *('unshare', '--user', '--map-root-user', '--mount', 'sh', '-ec'),
    'mount --bind "$1" "$1"; mount -o remount,bind,ro "$1"; shift; exec "$@"',
    'sh',
)


class CheckError(Exception):
    """A check failed; the message gives the reason."""


@contextmanager
def check(text: str) -> Iterator[list[str]]:
    """Time a check, and print it with the remarks that it adds to the list."""
    began, remarks = time.monotonic(), list[str]()
    yield remarks
    print(f'{text}: {time.monotonic() - began:.1f} s', *remarks, sep=', ', flush=True)


def loop() -> float:
    """Return the seconds of a loop of 20 million additions."""
    began = time.monotonic()
    exec('s = 0\nfor i in range(20_000_000): s += i', {})
    return time.monotonic() - began


@contextmanager
def loops(remarks: list[str], text: str) -> Iterator[None]:
    """Time a part of a check, also in units of the loop, which runs before and after it."""
    before, began = loop(), time.monotonic()
    yield
    taken = time.monotonic() - began
    remarks.append(f'{text} {taken:.1f} s, or {2 * taken / (before + loop()):.0f} loops')


def run(*command: object, **variables: str) -> str:
    """
    Run a command with few variables of this process's environment, and return its output.

    :raises CheckError: the command failed.
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


def check_changelogs(dist: Path) -> None:
    """Check that the changelogs have the version and its date."""
    (wheel,) = dist.glob('humanopts-*.whl')
    version = re.escape(wheel.name.split('-')[1])
    date = r'\d{4}-\d\d-\d\d'
    ros = rf'{version} \({date}\)'
    titles = {ROOT / 'CHANGELOG.md': rf'## \[{version}\] - {date}'}
    titles |= dict.fromkeys(ROOT.glob('src/*/CHANGELOG.rst'), ros)
    for path, title in titles.items():
        if not re.search(f'^{title}$', path.read_text('utf-8'), re.M):
            raise CheckError(f'{path.relative_to(ROOT)} lacks the version {version} and its date')


def expected_files(package: str) -> set[str]:
    """Return the files of a package that git tracks, which its wheel has to contain."""
    inside = ROOT / 'src' / package
    return set(run('git', '-C', inside, 'ls-files', package, PATH=os.environ['PATH']).split())


def check_files(dist: Path) -> None:
    """Compare the files of each wheel with the expected ones."""
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
    """A new Python environment, with only its own programs on the PATH."""

    def __init__(self, folder: Path, dist: Path, quick: bool = False) -> None:
        self.folder, self._dist = folder, dist
        self._pip: tuple[object, ...] = folder / 'bin/pip', 'install', '--no-compile'
        if quick:
            run(UV, 'venv', '--quiet', '--python', sys.executable, folder)
            self._pip = UV, 'pip', 'install', '--python', folder
        else:
            run(sys.executable, '-m', 'venv', '--upgrade-deps', folder)

    def run(self, program: str, *arguments: object, **variables: str) -> str:
        """Run a program of the environment."""
        given = {'PATH': str(self.folder / 'bin'), **variables}
        return run(self.folder / 'bin' / program, *arguments, **given)

    def refuses(self, text: str, program: str, *arguments: object, **variables: str) -> None:
        """
        Check that a program fails with a text.

        :raises CheckError: it does not.
        """
        try:
            said = self.run(program, *arguments, **variables)
        except CheckError as error:
            said = ' '.join(str(error).split())
            if text in said:
                return
        raise CheckError(f'{program} does not say: {text}\n{said}')

    def install(self, *packages: str, **variables: str) -> None:
        """Install packages as documented; ours come from the folder of wheels."""
        given = {'PATH': str(self.folder / 'bin'), **variables}
        run(*self._pip, '--quiet', '--find-links', self._dist, *packages, **given)

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
        lines = run(UV, 'pip', 'list', '--format', 'freeze', '--python', self.folder).split()
        return dict(line.split('==') for line in lines if '==' in line)


def check_learner(dist: Path, work: Path, quick: bool) -> Environment:
    """Learn from a table with only the learner installed, and beside older packages."""
    table = ROOT / 'examples/own_table/demonstrations.csv'
    example = ROOT / 'examples/own_table/learn_from_table.py', '--out', work / 'own'
    with check('humanopts-learner alone') as remarks:
        alone = Environment(work / 'learner', dist, quick)
        alone.install('humanopts-learner', *() if quick else ('--compile',))
        remarks.append(alone.size)
        if alone.megabytes > MAX_LEARNER:
            raise CheckError(f'it is larger than {MAX_LEARNER} MB')
        for name in alone.versions():
            if name.startswith('ros-') or name in ('pandas', 'nicegui'):
                raise CheckError(f'humanopts-learner installs {name}')
        alone.install('pandas', 'matplotlib', 'gymnasium')
        remarks.append(f'with pandas, matplotlib and gymnasium {alone.size}')
        alone.run('python', '-P', '-c', LEARNS, table)
        alone.run('python', '-P', '-c', PLAYS)
        alone.run('python', '-P', *example)
    if quick:
        return alone
    with check('humanopts-learner beside older packages'):
        beside = Environment(work / 'beside', dist)
        beside.install(*(f'{name}=={version}' for name, version in OLDER.items()), 'matplotlib')
        before = beside.versions()
        beside.install('humanopts-learner', 'gymnasium')
        after = beside.versions()
        if changed := {name for name in before if before[name] != after.get(name)}:
            raise CheckError(f'humanopts-learner replaces {", ".join(sorted(changed))}')
        beside.run('python', '-P', *example)
    with check('humanopts-learner is installable with Python ' + ', '.join(PYTHONS)):
        for version in PYTHONS:
            wanted = work / 'learner.in'
            wanted.write_text('humanopts-learner[tables]\n')
            run(
                *(UV, 'pip', 'compile', '--quiet', '--only-binary', ':all:'),
                *('--python-version', version, '--find-links', dist, wanted),
            )
    return beside


def check_gymnasium(learner: Environment, lesson: Path) -> None:
    """Use the options of a lesson as actions of a Gymnasium environment."""
    with check('options as actions, with the learner alone'):
        script, env = ROOT / 'examples/options_as_actions/q_learning.py', 'humanopts/Taxi-v0'
        learner.run('python', '-P', script, env, lesson, '--episodes', 10)


def check_refusals(dist: Path, work: Path) -> None:
    """Check the messages about a missing extra, an old pip and another Python."""
    with check('humanopts without extras'):
        bare = Environment(work / 'bare', dist)
        bare.install('humanopts')
        bare.refuses("install it with: pip install 'humanopts[ros]'", 'humanopts', 'demo', 'taxi')
    with check('humanopts[ros] with an old pip'):
        bare.install(OLD_PIP)
        wanted = 'install', '--find-links', dist, 'humanopts[ros]'
        bare.refuses('update it: python -m pip install --upgrade pip', 'pip', *wanted)
    with check('humanopts[ros] with another Python'):
        (sdist,) = dist.glob('humanopts_interfaces-*.tar.gz')
        shutil.unpack_archive(sdist, work)
        code = 'import sys; sys.version_info = 3, 10, 0; import refusal'
        source = {'PYTHONPATH': str(work / sdist.name.removesuffix('.tar.gz'))}
        bare.refuses('is compiled for Python', 'python', '-c', code, **source)


def check_all(dist: Path, work: Path) -> None:
    """Teach, record, plan and report with everything installed."""
    report, fresh = work / 'demo', {'XDG_CACHE_HOME': str(work / 'cache')}
    with (
        check('humanopts[all]') as remarks,
        loops(remarks, 'from a new environment to the first report'),
    ):
        whole = Environment(work / 'all', dist)
        whole.install('humanopts[all]', **fresh)
        remarks.append(whole.size)
        whole.run('humanopts', 'demo', 'taxi', '--out', report)
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
    with check('its commands where site-packages is read-only'):
        program, report = whole.folder / 'bin/humanopts', work / 'read-only'
        demo = program, 'demo', 'taxi', '--episodes', 1, '--out', report
        run(*READ_ONLY, whole.folder, *demo, PATH=os.environ['PATH'])
        whole.run('humanopts', 'bag', 'check', report / 'bag')


def check_clone(work: Path) -> None:
    """Run the demo in a clone, with empty caches."""
    with check('a clone') as remarks:
        clone, path = work / 'clone', os.environ['PATH']
        run('git', 'clone', '--quiet', ROOT, clone, PATH=path)
        with loops(remarks, 'from make to the first report'):
            run('make', '-C', clone, 'demo', PATH=path, XDG_CACHE_HOME=str(work / 'cache of make'))


def main() -> int:
    """Run all checks."""
    dist, quick = Path(sys.argv[1]).absolute(), sys.argv[2:] == ['--quick']
    work = Path(tempfile.mkdtemp(prefix='release-check-'))
    try:
        with check('metadata'):
            tools = Environment(work / 'tools', dist, quick=True)
            tools.install('twine')
            tools.run('twine', 'check', '--strict', *dist.glob('humanopts*'))
            check_changelogs(dist)
        with check('files'):
            check_files(dist)
        learner = check_learner(dist, work, quick)
        if not quick:
            check_refusals(dist, work)
            check_all(dist, work)
            check_gymnasium(learner, work / 'demo')
            check_clone(work)
    except CheckError as error:
        print(f'failed: {error}', file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(work)
    return 0


if __name__ == '__main__':
    sys.exit(main())
