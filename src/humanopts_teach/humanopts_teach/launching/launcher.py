"""
Supervision of nodes: starts, watches and stops one process per node, the recorder last.

A node that ends unexpectedly is restarted while the others continue.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import json
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import sys
import termios
import threading
import time
import uuid

from humanopts_ros.limits import one_line, printable
from humanopts_ros.middleware import INSTANCE, RESTARTS
from humanopts_teach.launching import LaunchError, RECORDER
from humanopts_teach.launching.forks import start
from humanopts_teach.launching.job import in_foreground
from humanopts_teach.launching.place import answer
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.restarts import (
    describe_exit,
    last_output,
    MAX_RESTARTS,
    NodeExit,
    RestartPolicy,
)
import psutil

PARAMETERS = '--params-file'  # before the last word of a node's command line
TAIL_LINES = 12
_STOP_SECONDS = 10.0  # time for a node to end before it is killed
_KILL_SECONDS = 1.0  # maximum wait for a killed node to end
_STOPPED_PERIOD = 1.0  # s between checks for stopped processes
_CLEAN_ENDS = (
    0,
    -signal.SIGTERM,  # before the node installed a handler
    -signal.SIGALRM,  # Fast DDS delayed the exit
)


@dataclass
class _Running:
    spec: ProcessSpec
    process: BaseProcess
    instance: str  # suffix of its publisher_id
    policy: RestartPolicy
    due: float | None = None  # s, time of the restart; None: it runs, or has ended for good
    given_up: NodeExit | None = None  # its last exit; None: not given up
    stopped: bool = False  # by SIGSTOP

    @property
    def runs(self) -> bool:
        """Whether the process is not known to have ended."""
        return self.due is None and self.given_up is None


class Launcher:
    """
    The processes of one launch.

    Each process has its own log in ``log_directory`` and its own process group, so that Ctrl-C
    reaches only the launcher, which then stops the nodes in order. A node ends with its launcher.
    ``check`` restarts nodes that end unexpectedly, except the terminal's, a limited number of
    times in a row and with increasing delays.

    :ivar ends: unexpected exits of nodes, in order.
    :ivar on_start: callback before each start of a process, except the terminal's, with the node
        name and the suffix of the publisher_id.
    :ivar on_end: callback for each of ``ends``, with the suffix of the publisher_id.
    :ivar wake: callback in another thread when ``check`` has work to do.
    :ivar report: callback for a line when a process is stopped or continues.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        log_directory: Path,
        namespace: str = '/',
        *,
        restarts: int = MAX_RESTARTS,
    ) -> None:
        """
        Create the launcher; nothing starts yet.

        :param restarts: maximum number of consecutive restarts of a node.
        """
        self._specs = list(specs)
        self._directory = log_directory
        self._namespace = namespace
        self._restarts = restarts
        self.ends: list[NodeExit] = []
        self.on_start: Callable[[str, str], object] = lambda name, instance: None
        self.on_end: Callable[[NodeExit, str], object] = lambda ended, instance: None
        self.report: Callable[[str], object] = lambda line: None
        self.wake: Callable[[], object] = lambda: None
        self._checked = 0.0  # s, time of the last check for stopped processes
        self._running: list[_Running] = []

    @property
    def node_names(self) -> list[str]:
        """Fully qualified names of the running nodes."""
        prefix = self._namespace.rstrip('/')
        return [f'{prefix}/{running.spec.name}' for running in self._running]

    def pid(self, name: str) -> int:
        """Return the process id of a node."""
        return next(e.process.pid or 0 for e in self._running if e.spec.name == name)

    def start(self, *, late: bool = False) -> None:
        """
        Start the processes, except the terminal's.

        :param late: start only the nodes that wait for the others, instead of the others.
        :raises LaunchError: the log directory cannot be written, or a process cannot be started.
        """
        try:
            for spec in self._specs:
                if not spec.terminal and spec.late == late:
                    instance, policy = _new_instance(), RestartPolicy(self._restarts)
                    process = self._process(spec, instance, self._settings(spec, new=True))
                    policy.begin(time.monotonic())
                    self._running.append(_Running(spec, process, instance, policy))
        except OSError as error:
            self.stop()
            raise self._unwritable(error) from error

    def run_terminal(self, watch: Callable[[], object]) -> int:
        """
        Run the process that takes over the terminal, and then restore the terminal.

        :param watch: called repeatedly; waits briefly, and may raise to end the process.
        :return: exit status of the process.
        :raises LaunchError: a signal ended the process, or another node ended for good, except the
            recorder: without it, the lesson pauses and says so.
        """
        (spec,) = [spec for spec in self._specs if spec.terminal]
        with _terminal_restored():
            try:
                process = self._process(spec, _new_instance(), self._settings(spec, new=True))
            except OSError as error:
                raise self._unwritable(error) from error
            try:
                while (status := process.exitcode) is None:
                    watch()
                    self.check(RECORDER)
            finally:
                process.terminate()
                process.join(_STOP_SECONDS)
                process.kill()
        if status < 0:
            raise LaunchError(self._end_of(spec.name, status))
        if status:
            output = self._log(spec.name).read_text(encoding='utf-8', errors='replace')
            sys.stderr.write(printable(output))
        return status

    def check(self, *optional: str) -> None:
        """
        Check all processes except the terminal's, and restart those that ended.

        :param optional: nodes that the others do not need.
        :raises LaunchError: another node ended for good; the text has its name and last log lines.
        """
        now = time.monotonic()
        answer()
        for running in self._running:
            if running.due is not None and now >= running.due:
                running.due, running.stopped, running.instance = None, False, _new_instance()
                try:
                    running.process = self._process(
                        running.spec, running.instance, self._settings(running.spec)
                    )
                except OSError as error:  # for example, the machine cannot start another process
                    self._ended(running, 1, f'cannot be started: {error}', now)
                else:
                    running.policy.begin(time.monotonic())
            elif running.runs and (status := running.process.exitcode) is not None:
                self._ended(running, status, describe_exit(status), now)
            if running.given_up is not None and running.spec.name not in optional:
                raise LaunchError(running.given_up.text)
        if now - self._checked > _STOPPED_PERIOD:
            self._checked = now
            self._check_stopped()

    def stop(self) -> list[str]:
        """
        Stop all processes, the recorder last, so that the bag contains all last messages.

        :return: descriptions of the exits that were not clean.
        """
        problems = []
        for last in (False, True):
            alive = [
                each
                for each in self._running
                if (each.spec.name == RECORDER) == last and each.process.exitcode is None
            ]
            for each in alive:
                each.process.terminate()
            deadline = time.monotonic() + _STOP_SECONDS
            problems += [found for each in alive if (found := self._end(each, deadline))]
        self._running.clear()
        return problems

    def _unwritable(self, error: OSError) -> LaunchError:
        return LaunchError(f'cannot write logs in {self._directory}: {error}')

    def _log(self, name: str) -> Path:
        return self._directory / f'{name}.log'

    def _settings(self, spec: ProcessSpec, *, new: bool = False) -> Path:
        """
        Write a node's parameters to a file, completely or not at all, and return its path.

        :param new: whether the launch is new: the file must be written, and an old log is deleted.
        :raises OSError: the file of a new launch cannot be written.
        """
        path = self._directory / f'{spec.name}.yaml'
        # JSON is YAML with quoted strings; rcl would read an unquoted y as true.
        tree = {'/**': {'ros__parameters': dict(spec.parameters)}}
        whole = path.with_suffix('.yaml.new')
        try:
            if new:
                self._directory.mkdir(parents=True, exist_ok=True)
                self._log(spec.name).unlink(missing_ok=True)
            whole.write_text(json.dumps(tree, ensure_ascii=False), 'utf-8')
            whole.replace(path)
        except OSError:
            with suppress(OSError):
                whole.unlink()
            if new:
                raise
        return path

    def _process(self, spec: ProcessSpec, instance: str, settings: Path) -> BaseProcess:
        arguments = ['--ros-args', '-r', f'__ns:={self._namespace}']
        if spec.terminal:
            arguments.append('--disable-stdout-logs')
        else:
            self.on_start(spec.name, instance)
        restarts = sum(end.node == spec.name for end in self.ends)
        environment = {**os.environ, INSTANCE: instance, RESTARTS: str(restarts)}
        arguments += [PARAMETERS, str(settings)]
        log = self._log(spec.name)
        process = start(spec.module, arguments, environment, log, terminal=spec.terminal)

        def wake_at_end() -> None:
            wait([process.sentinel])
            self.wake()

        threading.Thread(target=wake_at_end, daemon=True).start()
        return process

    def _ended(self, running: _Running, status: int, what: str, now: float) -> None:
        """
        Schedule the restart of a node that ended, and report the exit.

        :param what: description of the exit.
        """
        name, policy = running.spec.name, running.policy
        running.due = policy.end(now, status)
        if running.due is not None:
            timer = threading.Timer(running.due - now, lambda: self.wake())
            timer.daemon = True
            timer.start()
        end = NodeExit(
            name, what, self._last_lines(name), policy.restarts, running.due is not None
        )
        if not end.again:
            running.given_up = end
        with suppress(OSError), self._log(name).open('a', encoding='utf-8') as log:
            log.write(f'humanopts: {end.sentence}\n')
        self.ends.append(end)
        self.on_end(end, running.instance)

    def _check_stopped(self) -> None:
        """Report processes that were stopped or continued."""
        for running in filter(lambda each: each.runs, self._running):
            pid = running.process.pid
            try:
                stopped = psutil.Process(pid).status() == psutil.STATUS_STOPPED
            except psutil.Error:  # it has just ended
                continue
            if stopped != running.stopped:
                running.stopped = stopped
                what = f'is stopped; kill -CONT {pid} resumes it' if stopped else 'continues'
                self.report(f'the node {running.spec.name} {what}')

    def _end(self, running: _Running, deadline: float) -> str:
        """Wait for a terminated process; return a description of an unclean exit, or ''."""
        name, process = running.spec.name, running.process
        process.join(max(0.0, deadline - time.monotonic()))
        if process.exitcode is not None:
            clean = process.exitcode in _CLEAN_ENDS
            return '' if clean else self._end_of(name, process.exitcode)
        process.kill()
        process.join(_KILL_SECONDS)
        if process.exitcode is None:  # the fork server is stopped
            with suppress(psutil.Error):
                os.kill(psutil.Process(process.pid).ppid(), signal.SIGKILL)
        return f'{name} did not stop when asked and was killed'

    def _end_of(self, name: str, status: int) -> str:
        """Describe the exit of a process that was asked to stop or had the terminal."""
        return (
            f'the node {name} ended ({describe_exit(status)}){last_output(self._last_lines(name))}'
        )

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
    """Undo raw mode, the alternate screen and a hidden cursor after any exit of the node."""
    before = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
    try:
        yield
    finally:
        if before is not None and in_foreground(sys.stdin.fileno()):
            with suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
            if sys.stdout.isatty():
                # 47, not 1049: the cursor stays below the output of a clean exit
                sys.stdout.write('\x1b[?47l\x1b[?25h\x1b[0m')
                sys.stdout.flush()
