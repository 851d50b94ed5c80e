"""Starts one process for each node, watches them, and stops them all, the recorder last."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import fcntl
import hashlib
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import termios
import time
from typing import Any

from humanopts_ros.environment import LAUNCHER_PID
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.fork_server import ForkedProcess, ForkServer
from humanopts_teach.launching.processes import ProcessSpec, RECORDER

TAIL_LINES = 12
_STOP_SECONDS = 10.0  # for a node to end by itself before it is killed
_LAST_SECONDS = 1.0  # for the end of what was killed to be known
# The second: before the node had a handler for it. The third: Fast DDS held it up.
_ENDS_AS_ASKED = (0, -signal.SIGTERM, -signal.SIGALRM)


@contextmanager
def only_launch(namespace: str) -> Iterator[None]:
    """
    Hold the place of the one launch in this ROS_DOMAIN_ID and namespace.

    :raises LaunchError: another one holds it; the text names its process.
    """
    domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
    key = hashlib.sha256(f'{domain} {namespace}'.encode()).hexdigest()[:12]
    path = Path(tempfile.gettempdir()) / f'humanopts-{os.getuid()}-{key}.lock'
    with path.open('a+', encoding='utf-8') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            raise LaunchError(
                f'process {file.read().strip() or "?"} runs humanopts already in ROS_DOMAIN_ID '
                f'{domain}, namespace {namespace}; stop it, or choose another --namespace or '
                'ROS_DOMAIN_ID'
            ) from None
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield


@dataclass(frozen=True)
class _Running:
    spec: ProcessSpec
    process: 'subprocess.Popen[bytes] | ForkedProcess'
    log: Path


class Launcher:
    """
    The processes of one launch.

    Each writes to a log of its own below ``log_directory``. They run in process groups of their
    own, so that Ctrl-C reaches only the launcher, which then stops them in order. A node whose
    launcher is gone ends by itself.
    """

    def __init__(
        self, specs: Sequence[ProcessSpec], log_directory: Path, namespace: str = '/'
    ) -> None:
        self._specs = list(specs)
        self._directory = log_directory
        self._namespace = namespace
        self._running: list[_Running] = []
        self._terminal: list[Any] | None = None
        self._server: ForkServer | None = None  # None: nothing is started

    @property
    def node_names(self) -> list[str]:
        """Fully qualified names of the nodes that run."""
        prefix = self._namespace.rstrip('/')
        return [f'{prefix}/{running.spec.name}' for running in self._running]

    @property
    def pids(self) -> list[int]:
        """All processes that run."""
        return [running.process.pid for running in self._running]

    def pid(self, name: str) -> int:
        """Return the process of a node that runs."""
        return next(entry.process.pid for entry in self._running if entry.spec.name == name)

    def start(self, *, late: bool = False) -> None:
        """
        Start every process but the terminal's.

        :param late: those that come when the others are ready, in place of the others.
        :raises LaunchError: the log directory cannot be written.
        """
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            if self._server is None:
                self._server = ForkServer([s.module for s in self._specs if not s.terminal])
            for spec in self._specs:
                if not spec.terminal and spec.late == late:
                    self._start(spec)
        except OSError as error:
            self.stop()
            raise LaunchError(f'cannot write logs in {self._directory}: {error}') from error

    def run_terminal(self, watch: Callable[[], object]) -> int:
        """
        Run the process that takes over the terminal, to its end, and restore the terminal.

        :param watch: called ten times a second meanwhile; what it raises ends the process, too.
        :return: its exit status.
        :raises LaunchError: another node died meanwhile, whose process is needed: without the
            recorder the lesson pauses, and says so. The terminal's process is ended.
        """
        (spec,) = [spec for spec in self._specs if spec.terminal]
        self._save_terminal()
        try:
            running = self._start(spec)
            while running.process.poll() is None:
                watch()
                self.check(spec.name, RECORDER)
                time.sleep(0.1)
            self._running.remove(running)
            return self._terminal_status(running)
        finally:
            self._end([entry for entry in self._running if entry.spec.terminal])
            self._restore_terminal()

    def check(self, *besides: str) -> None:
        """
        Look whether every process is alive.

        :param besides: nodes that may end by themselves.
        :raises LaunchError: one ended; the text names it and holds its last lines.
        """
        for running in self._running:
            status = running.process.poll()
            if status is not None and running.spec.name not in besides:
                raise LaunchError(_end_of(running, ' while it was needed'))

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
        return problems

    def _start(self, spec: ProcessSpec) -> _Running:
        log = self._directory / f'{spec.name}.log'
        arguments = ['--ros-args', '-r', f'__ns:={self._namespace}']
        arguments += ['--params-file', str(self._parameters(spec))]
        log.write_bytes(b'')  # of an earlier launch
        process: subprocess.Popen[bytes] | ForkedProcess
        if spec.terminal or self._server is None:
            process = _of_terminal(spec.module, arguments, log)
        else:
            process = self._server.start(spec.module, arguments, os.environ, log)
        running = _Running(spec, process, log)
        self._running.append(running)
        return running

    def _parameters(self, spec: ProcessSpec) -> Path:
        path = self._directory / f'{spec.name}.yaml'
        tree = {'/**': {'ros__parameters': dict(spec.parameters)}}
        # JSON, as YAML whose strings are quoted: rcl takes a bare y for true.
        path.write_text(json.dumps(tree, ensure_ascii=False), encoding='utf-8')
        return path

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

    def _terminal_status(self, running: _Running) -> int:
        status = running.process.wait()
        if status < 0:
            raise LaunchError(_end_of(running))
        if status:
            sys.stderr.write(running.log.read_text(encoding='utf-8', errors='replace'))
        return status

    def _save_terminal(self) -> None:
        if sys.stdin.isatty():
            self._terminal = termios.tcgetattr(sys.stdin)

    def _restore_terminal(self) -> None:
        """Undo raw mode, the alternate screen and a hidden cursor, however the node ended."""
        if self._terminal is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)
            if sys.stdout.isatty():
                # 47, not 1049: the cursor stays below what the node said at a clean end
                sys.stdout.write('\x1b[?47l\x1b[?25h\x1b[0m')
                sys.stdout.flush()


def _of_terminal(module: str, arguments: Sequence[str], log: Path) -> 'subprocess.Popen[bytes]':
    """Start a process that has the terminal; only its errors go to the log."""
    with log.open('wb') as errors:
        return subprocess.Popen(
            [sys.executable, '-m', module, *arguments, '--disable-stdout-logs'],
            stderr=errors,
            env={**os.environ, LAUNCHER_PID: str(os.getpid())},
        )


def _end_of(running: _Running, when: str = '') -> str:
    """Say how a process ended that did, and what it wrote last."""
    status = running.process.wait()
    how = f'by signal {signal.Signals(-status).name}' if status < 0 else f'exit status {status}'
    return f'the node {running.spec.name} ended ({how}){when}{_last_lines(running.log)}'


def _last_lines(log: Path) -> str:
    try:
        lines = log.read_text(encoding='utf-8', errors='replace').splitlines()
    except OSError:
        return ''
    tail = [line for line in lines if line.strip()][-TAIL_LINES:]
    if not tail:
        return '; its log is empty'
    return '; its last lines:\n' + '\n'.join(f'  {line}' for line in tail)
