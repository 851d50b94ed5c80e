"""
Nodes as forks of one process that has imported what they need.

To import that takes a node about a second of processor time; a fork of a process that has done so
takes a hundredth of it. The fork server has one thread and knows no ROS graph, so what it forks
begins as a process of its own does: with its own environment, log, session of ROS and end.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
import gc
from importlib import import_module
from itertools import count
import json
import os
from pathlib import Path
import select
import signal
import socket
import subprocess
import sys
import time
import traceback
from typing import Any, NoReturn

from humanopts_ros.environment import LAUNCHER_PID
from humanopts_teach.launching import MODULES, USUAL
from setproctitle import setproctitle

_LAST_SECONDS = 1.0  # that the server has to end
_MESSAGE_BYTES = 1 << 20  # at most; an order holds an environment


class ForkedProcess:
    """A process of a fork server, used as one of ``subprocess`` is."""

    def __init__(self, server: 'ForkServer') -> None:
        self._server = server
        self.known_pid: int | None = None  # None: it is not forked yet
        self.returncode: int | None = None  # None: it runs; -N: signal N ended it

    @property
    def pid(self) -> int:
        """Its number; waits until it is forked."""
        while self.known_pid is None and self.returncode is None:
            self._server.listen(None)
        return self.known_pid or 0

    def poll(self) -> int | None:
        """Return the exit status; None: it runs."""
        self._server.listen(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """
        Wait for its end and return the exit status.

        :param timeout: s.
        :raises subprocess.TimeoutExpired: it runs still.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0.0:
                raise subprocess.TimeoutExpired(str(self.known_pid), timeout or 0.0)
            self._server.listen(left)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send it a signal, if it runs."""
        if self.pid and self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """A process that imports modules, and then forks for each node that is started."""

    def __init__(self, modules: Sequence[str]) -> None:
        """Start it, in a process group of its own, with what it is to import."""
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, '-m', __name__, str(theirs.fileno()), *modules],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env={**os.environ, 'PYTHONUNBUFFERED': '1'},
                process_group=0,
            )
        self._started: list[ForkedProcess] = []

    def start(
        self, module: str, arguments: Sequence[str], environment: Mapping[str, str], log: Path
    ) -> ForkedProcess:
        """Start a process that calls ``main`` of a module; it does not wait for it."""
        order = [module, list(arguments), dict(environment), os.getcwd(), os.path.abspath(log)]
        self._started.append(ForkedProcess(self))
        self._channel.send(json.dumps(order).encode())
        return self._started[-1]

    def listen(self, seconds: float | None) -> None:
        """Take what the server says of its processes; wait for it at most so long, s."""
        while select.select([self._channel], [], [], seconds)[0]:
            seconds = 0.0
            # Taken when it is understood: Ctrl-C between the two loses nothing.
            try:
                said = self._channel.recv(_MESSAGE_BYTES, socket.MSG_PEEK)
            except ConnectionResetError:  # it has not read all that was sent
                said = b''
            if not said:  # the server is gone, and with it all that it started
                status = self._process.wait()
                for process in self._started:
                    if process.returncode is None:
                        process.returncode = status
                return
            number, pid, status = json.loads(said)
            self._started[number].known_pid, self._started[number].returncode = pid, status
            self._channel.recv(_MESSAGE_BYTES)

    @property
    def ended(self) -> bool:
        """Whether the server is gone, and with it all that it started."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End the server."""
        self._channel.close()
        try:
            self._process.wait(_LAST_SECONDS)
        except subprocess.TimeoutExpired:  # it is stopped, say
            self.kill()

    def kill(self) -> None:
        """End the server at once."""
        self._channel.close()
        self._process.kill()
        self._process.wait()


_prepared: list[ForkServer] = []  # one at most


def prepare() -> None:
    """Start the server of the launch that follows: it imports while this process does."""
    _prepared.append(ForkServer([MODULES[name] for name in USUAL]))


def server_for(modules: Sequence[str]) -> ForkServer:
    """Return the server that was prepared, or start one with what it is to import."""
    return _prepared.pop() if _prepared else ForkServer(modules)


def discard() -> None:
    """End the server that no launch has taken, as where a command was refused."""
    while _prepared:
        _prepared.pop().kill()


def main() -> int:
    """Import, and fork until the launcher closes its end; a fork goes on as its node."""
    descriptor, *modules = sys.argv[1:]
    setproctitle('humanopts fork server')  # now: titles stand where the first environment did
    channel = socket.socket(fileno=int(descriptor))
    gc.disable()  # what is imported is no garbage: a tenth of the time
    for module in modules:
        import_module(module)
    gc.freeze()  # what all share is not looked through, and so not copied
    gc.enable()
    if (order := _serve(channel)) is not None:
        _run(*order)
    return 0


def _serve(channel: socket.socket) -> list[Any] | None:
    """
    Fork for each order, and tell its number, process and exit status.

    :return: in a fork, its order; None: no more come.
    """
    running: dict[int, tuple[int, int]] = {}  # by descriptor of process: order and process
    orders = count()
    while True:
        for ready in select.select([channel.fileno(), *running], [], [])[0]:
            if ready in running:
                number, pid = running.pop(ready)
                os.close(ready)
                status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
                channel.send(json.dumps([number, pid, status]).encode())
                continue
            said = channel.recv(_MESSAGE_BYTES)
            if not said:
                return None
            number, pid = next(orders), os.fork()
            if pid == 0:
                channel.close()
                for descriptor in running:
                    os.close(descriptor)
                order: list[Any] = json.loads(said)
                return order
            running[os.pidfd_open(pid)] = number, pid
            channel.send(json.dumps([number, pid, None]).encode())


def _run(
    module: str, arguments: list[str], environment: dict[str, str], directory: str, log: str
) -> NoReturn:
    """
    Be what a new process of these would be, with its output added to a file.

    It ends without taking down the modules of Python, whose shared memory that would copy.
    """
    os.setpgid(0, 0)
    os.environ.clear()
    os.environ.update({**environment, LAUNCHER_PID: str(os.getppid())})
    with suppress(OSError):  # it was removed meanwhile
        os.chdir(directory)
    try:
        output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    except OSError:  # it was removed, and the disk is full, say
        output = os.open(os.devnull, os.O_WRONLY)
    for standard in (1, 2):
        os.dup2(output, standard)
    if output not in (1, 2):
        os.close(output)
    sys.argv = [module, *arguments]
    setproctitle(' '.join([sys.executable, '-m', *sys.argv]))
    status = 1
    try:
        status = import_module(module).main()
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(OSError):  # a full disk
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


if __name__ == '__main__':
    sys.exit(main())
