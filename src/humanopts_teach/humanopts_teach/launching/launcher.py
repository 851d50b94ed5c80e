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
import os
from pathlib import Path
import signal
import stat
import subprocess
import sys
import termios
import time
import uuid

from humanopts_ros.environment import INSTANCE, LAUNCHER_PID
from humanopts_ros.limits import one_line, printable
from humanopts_teach.launching import LaunchError, MODULES, OccupiedError
from humanopts_teach.launching.fork_server import ForkedProcess, ForkServer, server_for
from humanopts_teach.launching.job import in_foreground
from humanopts_teach.launching.place import answer, holder
from humanopts_teach.launching.processes import ProcessSpec, RECORDER
from humanopts_teach.launching.restarts import how, MOST, NodeExit, RestartPolicy, said_last
import psutil

CONDUCTOR = 'conductor'  # the node in the launcher's own process
TAIL_LINES = 12
_PARAMETERS = '--params-file'  # before the last word of a node's command line
_STOP_SECONDS = 10.0  # for a node to end by itself before it is killed
_LAST_SECONDS = 1.0  # for the end of what was killed to be known
_STOPPED_PERIOD = 1.0  # s between looks whether a process is stopped
_ENDS_AS_ASKED = (
    0,
    -signal.SIGTERM,  # before the node had a handler for it
    -signal.SIGALRM,  # Fast DDS held it up
)


def processes_of_launch(namespace: str) -> dict[str, psutil.Process | None]:
    """
    Return the processes of the launches in a namespace on this machine.

    :return: by name of the node; None: it has ended and is to be started again.
    """
    found: dict[str, psutil.Process | None] = {}
    launchers = set()
    for name in MODULES:
        if (who := holder(namespace, name)) is not None:
            found[name] = None
            launchers.add(who[0])
    for number in sorted(launchers):
        with suppress(psutil.Error, ValueError):  # it ends just now, or is in another container
            launcher = psutil.Process(number)
            for process in launcher.children(recursive=True):
                with suppress(psutil.Error):
                    words = ' '.join(process.cmdline()).rstrip()  # of a fork: one, and empty ones
                    name = Path(words.partition(f'{_PARAMETERS} ')[2]).stem
                    if name in MODULES:  # "ros2 launch" names its files otherwise
                        found |= {name: process, CONDUCTOR: launcher}
    return found


Process = subprocess.Popen[bytes] | ForkedProcess


@dataclass
class _Running:
    spec: ProcessSpec
    process: Process
    instance: str  # how its publisher_id ends
    log: Path
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
        self._server: ForkServer | None = None  # None: nothing is started
        self._logs: dict[str, int] = {}  # locked descriptors, by node

    @property
    def node_names(self) -> list[str]:
        """Fully qualified names of the nodes that run."""
        prefix = self._namespace.rstrip('/')
        return [f'{prefix}/{running.spec.name}' for running in self._running]

    @property
    def pids(self) -> list[int]:
        """All processes that run."""
        return [running.process.pid for running in self._running if running.runs]

    def pid(self, name: str) -> int:
        """Return the process of a node that runs."""
        return next(entry.process.pid for entry in self._running if entry.spec.name == name)

    def start(self, *, late: bool = False) -> None:
        """
        Start every process but the terminal's.

        :param late: those that come when the others are ready, in place of the others.
        :raises OccupiedError: another launch writes to a log there.
        :raises LaunchError: the log directory cannot be written.
        """
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._lock_logs()
            if self._server is None:
                self._server = server_for([s.module for s in self._specs if not s.terminal])
            for spec in self._specs:
                if not spec.terminal and spec.late == late:
                    self._start(spec)
        except (OSError, OccupiedError) as error:
            self.stop()
            raise self._refusal(error) from error

    def _refusal(self, error: Exception) -> LaunchError:
        if isinstance(error, LaunchError):
            return error
        return LaunchError(f'cannot write logs in {self._directory}: {error}')

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
        with _terminal_restored():
            try:
                try:
                    running = self._start(spec)
                except OSError as error:
                    raise self._refusal(error) from error
                while running.process.poll() is None:
                    watch()
                    self.check(RECORDER)
                self._running.remove(running)
                status = running.process.wait()
                if status < 0:
                    raise LaunchError(_end_of(running))
                if status:
                    said = running.log.read_text(encoding='utf-8', errors='replace')
                    sys.stderr.write(printable(said))
                return status
            finally:
                self._end([entry for entry in self._running if entry.spec.terminal])

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
            if running.spec.terminal:
                continue
            if running.due is not None and now >= running.due:
                running.due, running.stopped = None, False
                running.instance = _new_instance()
                try:
                    running.process = self._process(running.spec, running.log, running.instance)
                except OSError as error:  # the machine has no process for it, say
                    self._ended(running, 1, f'cannot be started: {error}', now)
                else:
                    running.policy.begin(time.monotonic())
            elif running.runs and (status := running.process.poll()) is not None:
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
        others = [entry for entry in self._running if entry.spec.name != RECORDER]
        recorder = [entry for entry in self._running if entry.spec.name == RECORDER]
        problems = self._end(others) + self._end(recorder)
        self._running.clear()
        if self._server is not None:
            self._server.close()
            self._server = None
        while self._logs:
            os.close(self._logs.popitem()[1])
        return problems

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
                raise OSError(errno.EINVAL, 'it is no regular file', str(path))
            try:
                fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OccupiedError(
                    f'another launch writes to {path}; stop it, or choose another --out'
                ) from None
            except OSError:  # a file system without locks
                pass

    def _start(self, spec: ProcessSpec) -> _Running:
        log = self._log(spec.name)
        os.truncate(self._logs[spec.name], 0)  # of an earlier launch
        instance, policy = _new_instance(), RestartPolicy(self._restarts)
        running = _Running(spec, self._process(spec, log, instance), instance, log, policy)
        running.policy.begin(time.monotonic())
        self._running.append(running)
        return running

    def _process(self, spec: ProcessSpec, log: Path, instance: str) -> Process:
        path = self._directory / f'{spec.name}.yaml'
        tree = {'/**': {'ros__parameters': dict(spec.parameters)}}
        # JSON, as YAML whose strings are quoted: rcl takes a bare y for true.
        if (problem := _write(path, json.dumps(tree, ensure_ascii=False).encode())) is not None:
            if not any(entry.spec is spec for entry in self._running):
                raise problem
            self.report(f'{path} cannot be written: {problem.strerror}; it stays as it was')
        if not spec.terminal:  # of which there may be several
            self.on_start(spec.name, instance)
        arguments = ['--ros-args', '-r', f'__ns:={self._namespace}', _PARAMETERS, str(path)]
        if spec.terminal or self._server is None:
            return subprocess.Popen(  # it has the terminal; only its errors go to the log
                [sys.executable, '-m', spec.module, *arguments, '--disable-stdout-logs'],
                stderr=self._logs[spec.name],
                env={**os.environ, INSTANCE: instance, LAUNCHER_PID: str(os.getpid())},
            )
        return self._server.start(spec.module, arguments, {**os.environ, INSTANCE: instance}, log)

    def _ended(self, running: _Running, status: int, what: str, now: float) -> None:
        """
        Plan when a node that ended is started again, and tell that it ended.

        :param what: how it ended, in words.
        """
        spec, policy = running.spec, running.policy
        if self._server is not None and not self._server.ended:
            running.due = policy.end(now, status)
        again = running.due is not None
        end = NodeExit(spec.name, what, _last_lines(running.log), policy.restarts, again)
        if not again:
            running.given_up = end
        with suppress(OSError):  # a full disk ends no launch
            os.write(self._logs[spec.name], f'humanopts: {end.sentence}\n'.encode())
        self.ends.append(end)
        self.on_end(end, running.instance)

    def _check_stopped(self) -> None:
        """Report which processes are stopped, and which go on."""
        for running in self._running:
            process = running.process
            if not (running.runs and isinstance(process, ForkedProcess) and process.known_pid):
                continue
            try:
                stopped = psutil.Process(process.known_pid).status() == psutil.STATUS_STOPPED
            except psutil.Error:  # it ended just now
                continue
            if stopped != running.stopped:
                running.stopped = stopped
                name = running.spec.name
                what = f'is stopped; kill -CONT {process.known_pid} lets it go on'
                self.report(f'the node {name} {what if stopped else "goes on"}')

    def _end(self, entries: Sequence[_Running]) -> list[str]:
        alive = [entry for entry in entries if entry.process.poll() is None]
        for entry in alive:
            entry.process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _STOP_SECONDS
        problems = []
        for entry in alive:
            try:
                entry.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                entry.process.kill()
                # Where the fork server is stopped, nobody tells that it ended.
                with suppress(subprocess.TimeoutExpired):
                    entry.process.wait(_LAST_SECONDS)
                problems.append(f'{entry.spec.name} did not stop when asked and was killed')
                continue
            if entry.process.wait() not in _ENDS_AS_ASKED:
                problems.append(_end_of(entry))
        return problems


def _write(path: Path, data: bytes) -> OSError | None:
    """
    Write a file, unless it has these bytes; whatever happens, it is whole.

    :return: why it could not be written, and is as it was.
    """
    new = path.with_name(f'{path.name}.new')
    try:
        if not path.is_file() or path.read_bytes() != data:
            new.write_bytes(data)
            new.replace(path)
    except OSError as error:
        with suppress(OSError):
            new.unlink()
        return error
    return None


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


def _end_of(running: _Running) -> str:
    """Return how a process ended that was asked to or had the terminal, and what it wrote last."""
    ended = f'the node {running.spec.name} ended ({how(running.process.wait())})'
    return f'{ended}{said_last(_last_lines(running.log))}'


def _last_lines(log: Path) -> str:
    """Return the last lines of a log, each after a line break."""
    try:
        lines = log.read_text(encoding='utf-8', errors='replace').splitlines()
    except OSError:
        return ''
    tail = [line for line in lines if line.strip()][-TAIL_LINES:]
    return ''.join(f'\n  {one_line(line)}' for line in tail)
