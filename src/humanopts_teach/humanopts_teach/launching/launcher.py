"""
Supervises the nodes: one process for each is started, watched, and stopped, the recorder last.

A node that ends without being asked is started again, while the others go on.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import errno
import fcntl
import json
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import stat
import subprocess
import sys
import termios
import time
import uuid

from humanopts_ros.limits import one_line, printable
from humanopts_ros.middleware import INSTANCE, LAUNCHER_PID, RESTARTS
from humanopts_teach.launching import LaunchError, OccupiedError, RECORDER
from humanopts_teach.launching.forks import start
from humanopts_teach.launching.job import in_foreground
from humanopts_teach.launching.place import answer
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.restarts import how, MOST, NodeExit, RestartPolicy, said_last
import psutil

PARAMETERS = '--params-file'  # before the last word of a node's command line
TAIL_LINES = 12
_STOP_SECONDS = 10.0  # for a node to end by itself before it is killed
_LAST_SECONDS = 1.0  # for the end of what was killed to be known
_STOPPED_PERIOD = 1.0  # s between looks whether a process is stopped
_ENDS_AS_ASKED = (
    0,
    -signal.SIGTERM,  # before the node had a handler for it
    -signal.SIGALRM,  # Fast DDS held it up
)


@dataclass
class _Running:
    spec: ProcessSpec
    process: BaseProcess
    instance: str  # how its publisher_id ends
    policy: RestartPolicy
    due: float | None = None  # when it is started again, s; None: it runs, or does so no more
    given_up: NodeExit | None = None  # how it ended for the last time; None: it did not
    stopped: bool = False  # by SIGSTOP

    @property
    def runs(self) -> bool:
        """Whether its process is not known to have ended."""
        return self.due is None and self.given_up is None


class Launcher:
    """
    The processes of one launch.

    Each writes to a log of its own below ``log_directory``. They run in process groups of their
    own, so that Ctrl-C reaches only the launcher, which then stops them in order. A node whose
    launcher is gone ends by itself. A node that ends before is started again by ``check``, but for
    the terminal's, a limited number of times in a row and after a pause that grows.

    :ivar ends: of nodes that nobody asked to end, in order.
    :ivar on_start: called with the name of each node but the terminal's, before a process of it
        is started, and with how the publisher_id of that process ends.
    :ivar on_end: called with each of those ``ends``, and with how its publisher_id ended.
    :ivar report: called with a line about a process that is stopped, and when it goes on.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        log_directory: Path,
        namespace: str = '/',
        *,
        restarts: int = MOST,
    ) -> None:
        """
        Start nothing yet.

        :param restarts: times in a row that a node is started again.
        """
        self._specs = list(specs)
        self._directory = log_directory
        self._namespace = namespace
        self._restarts = restarts
        self.ends: list[NodeExit] = []
        self.on_start: Callable[[str, str], object] = lambda name, instance: None
        self.on_end: Callable[[NodeExit, str], object] = lambda ended, instance: None
        self.report: Callable[[str], object] = lambda line: None
        self._checked = 0.0  # when it was last looked for stopped processes, s
        self._running: list[_Running] = []
        self._logs: dict[str, int] = {}  # locked descriptors, by node

    @property
    def node_names(self) -> list[str]:
        """Fully qualified names of the nodes that run."""
        prefix = self._namespace.rstrip('/')
        return [f'{prefix}/{running.spec.name}' for running in self._running]

    @property
    def pids(self) -> list[int]:
        """All processes that run."""
        return [running.process.pid or 0 for running in self._running if running.runs]

    def pid(self, name: str) -> int:
        """Return the process of a node that runs."""
        return next(e.process.pid or 0 for e in self._running if e.spec.name == name)

    def start(self, *, late: bool = False) -> None:
        """
        Start every process but the terminal's.

        :param late: those that come when the others are ready, in place of the others.
        :raises OccupiedError: another launch writes to a log there.
        :raises LaunchError: the log directory cannot be written, or a process cannot be started.
        """
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._lock_logs()
            for spec in self._specs:
                if not spec.terminal and spec.late == late:
                    os.truncate(self._logs[spec.name], 0)  # of an earlier launch
                    instance, policy = _new_instance(), RestartPolicy(self._restarts)
                    process = self._process(spec, instance, self._settings(spec))
                    policy.begin(time.monotonic())
                    self._running.append(_Running(spec, process, instance, policy))
        except (OSError, OccupiedError) as error:
            self.stop()
            raise self._refusal(error) from error

    def run_terminal(self, watch: Callable[[], object]) -> int:
        """
        Run the process that takes over the terminal, to its end, and restore the terminal.

        :param watch: called again and again meanwhile; it waits a moment, and what it raises ends
            the process, too.
        :return: its exit status.
        :raises LaunchError: another node ended meanwhile, is not started again, and is needed:
            without the recorder the lesson pauses, and says so. The terminal's process is ended.
        """
        (spec,) = [spec for spec in self._specs if spec.terminal]
        log = self._logs[spec.name]
        with _terminal_restored():
            try:
                os.truncate(log, 0)
                arguments = [spec.module, *self._arguments(self._settings(spec))]
                own = {INSTANCE: _new_instance(), LAUNCHER_PID: str(os.getpid())}
                process = subprocess.Popen(  # only its errors go to the log
                    [sys.executable, '-m', *arguments, '--disable-stdout-logs'],
                    stderr=log,
                    env={**os.environ, **own},
                )
            except OSError as error:
                raise self._refusal(error) from error
            try:
                while process.poll() is None:
                    watch()
                    self.check(RECORDER)
            finally:
                process.terminate()
                try:
                    process.wait(_STOP_SECONDS)
                except subprocess.TimeoutExpired:
                    process.kill()
        if (status := process.wait()) < 0:
            raise LaunchError(self._end_of(spec.name, status))
        if status:
            said = self._log(spec.name).read_text(encoding='utf-8', errors='replace')
            sys.stderr.write(printable(said))
        return status

    def check(self, *besides: str) -> None:
        """
        Look whether every process but the terminal's is alive, and start again those that ended.

        :param besides: nodes without which the others go on where they are not started again.
        :raises LaunchError: another one ended and is not started again; the text names it and
            holds its last lines.
        """
        now = time.monotonic()
        answer()
        for running in self._running:
            if running.due is not None and now >= running.due:
                running.due, running.stopped = None, False
                running.instance = _new_instance()
                try:
                    settings = self._settings(running.spec, again=True)
                    running.process = self._process(running.spec, running.instance, settings)
                except OSError as error:  # the machine has no process for it, say
                    self._ended(running, 1, f'cannot be started: {error}', now)
                else:
                    running.policy.begin(time.monotonic())
            elif running.runs and (status := running.process.exitcode) is not None:
                self._ended(running, status, how(status), now)
            if running.given_up is not None and running.spec.name not in besides:
                raise LaunchError(running.given_up.text)
        if now - self._checked > _STOPPED_PERIOD:
            self._checked = now
            self._check_stopped()

    def stop(self) -> list[str]:
        """
        End every process: the recorder when all others are gone, so that their last messages are
        in the bag.

        :return: what did not end cleanly, in words.
        """
        problems = []
        for last in (False, True):
            problems += self._end([e for e in self._running if (e.spec.name == RECORDER) == last])
        self._running.clear()
        while self._logs:
            os.close(self._logs.popitem()[1])
        return problems

    def _refusal(self, error: Exception) -> LaunchError:
        if isinstance(error, LaunchError):
            return error
        return LaunchError(f'cannot write logs in {self._directory}: {error}')

    def _log(self, name: str) -> Path:
        return self._directory / f'{name}.log'

    def _lock_logs(self) -> None:
        """
        Lock the log of each node, and change none.

        :raises OccupiedError: another launch has locked one.
        :raises OSError: one cannot be written.
        """
        paths = {spec.name: self._log(spec.name) for spec in self._specs}
        # Those that are there first: what is refused leaves no new file.
        for name in sorted(paths.keys() - self._logs.keys(), key=lambda n: not paths[n].exists()):
            path = paths[name]
            # A pipe that nobody reads would hold up what opens it.
            flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK
            log = self._logs[name] = os.open(path, flags, 0o666)
            if not stat.S_ISREG(os.fstat(log).st_mode):
                raise OSError(errno.EINVAL, 'it is not a regular file', str(path))
            try:
                fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OccupiedError(
                    f'another launch writes to {path}; stop it, or choose another --out'
                ) from None
            except OSError:  # a file system without locks
                pass

    def _settings(self, spec: ProcessSpec, *, again: bool = False) -> Path:
        """
        Write the file of a node's parameters, unless it is there; whatever happens, it is whole.

        :param again: the node was started before; where the file cannot be written, it stays.
        :raises OSError: it cannot be written.
        """
        path = self._directory / f'{spec.name}.yaml'
        tree = {'/**': {'ros__parameters': dict(spec.parameters)}}
        # JSON, as YAML whose strings are quoted: rcl takes a bare y for true.
        data, new = json.dumps(tree, ensure_ascii=False).encode(), path.with_suffix('.yaml.new')
        try:
            if not path.is_file() or path.read_bytes() != data:
                new.write_bytes(data)
                new.replace(path)
        except OSError as error:
            with suppress(OSError):
                new.unlink()
            if not again:
                raise
            self.report(f'{path} cannot be written: {error.strerror}; it stays as it was')
        return path

    def _arguments(self, settings: Path) -> list[str]:
        return ['--ros-args', '-r', f'__ns:={self._namespace}', PARAMETERS, str(settings)]

    def _process(self, spec: ProcessSpec, instance: str, settings: Path) -> BaseProcess:
        self.on_start(spec.name, instance)
        restarts = sum(end.node == spec.name for end in self.ends)
        environment = {**os.environ, INSTANCE: instance, RESTARTS: str(restarts)}
        return start(spec.module, self._arguments(settings), environment, self._log(spec.name))

    def _ended(self, running: _Running, status: int, what: str, now: float) -> None:
        """
        Plan when a node that ended is started again, and tell that it ended.

        :param what: how it ended, in words.
        """
        name, policy = running.spec.name, running.policy
        running.due = policy.end(now, status)
        again = running.due is not None
        end = NodeExit(name, what, self._last_lines(name), policy.restarts, again)
        if not again:
            running.given_up = end
        with suppress(OSError):  # a full disk ends no launch
            os.write(self._logs[name], f'humanopts: {end.sentence}\n'.encode())
        self.ends.append(end)
        self.on_end(end, running.instance)

    def _check_stopped(self) -> None:
        """Report which processes are stopped, and which go on."""
        for running in filter(lambda each: each.runs, self._running):
            pid = running.process.pid
            try:
                stopped = psutil.Process(pid).status() == psutil.STATUS_STOPPED
            except psutil.Error:  # it ended just now
                continue
            if stopped != running.stopped:
                running.stopped = stopped
                what = f'is stopped; kill -CONT {pid} lets it go on' if stopped else 'goes on'
                self.report(f'the node {running.spec.name} {what}')

    def _end(self, entries: Sequence[_Running]) -> list[str]:
        """End processes; return in words what did not end cleanly."""
        alive = [entry for entry in entries if entry.process.exitcode is None]
        for entry in alive:
            entry.process.terminate()
        deadline = time.monotonic() + _STOP_SECONDS
        problems = []
        for entry in alive:
            name, process = entry.spec.name, entry.process
            process.join(max(0.0, deadline - time.monotonic()))
            if process.exitcode is None:
                problems.append(f'{name} did not stop when asked and was killed')
                process.kill()
                process.join(_LAST_SECONDS)
                if process.exitcode is None:  # the fork server is stopped
                    with suppress(psutil.Error):
                        os.kill(psutil.Process(process.pid).ppid(), signal.SIGKILL)
            elif process.exitcode not in _ENDS_AS_ASKED:
                problems.append(self._end_of(name, process.exitcode))
        return problems

    def _end_of(self, name: str, status: int) -> str:
        """Return how a process ended that was asked to or had the terminal, in words."""
        return f'the node {name} ended ({how(status)}){said_last(self._last_lines(name))}'

    def _last_lines(self, name: str) -> str:
        """Return the last lines of a log, each after a line break."""
        try:
            lines = self._log(name).read_text(encoding='utf-8', errors='replace').splitlines()
        except OSError:
            return ''
        tail = [line for line in lines if line.strip()][-TAIL_LINES:]
        return ''.join(f'\n  {one_line(line)}' for line in tail)


def _new_instance() -> str:
    return uuid.uuid4().hex[:8]


@contextmanager
def _terminal_restored() -> Iterator[None]:
    """Undo raw mode, the alternate screen and a hidden cursor, however the node ended."""
    before = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
    try:
        yield
    finally:
        if before is not None and in_foreground(sys.stdin.fileno()):
            with suppress(termios.error):  # it was closed
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
            if sys.stdout.isatty():
                # 47, not 1049: the cursor stays below what the node said at a clean end
                sys.stdout.write('\x1b[?47l\x1b[?25h\x1b[0m')
                sys.stdout.flush()
