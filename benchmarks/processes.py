"""The processes of a benchmark, in a ROS domain and a folder of their own, and clients of them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import socket
import sys
import tempfile
import time
from typing import Any

from humanopts_ros.node_base import start_ros
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec, Value
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

# Domains whose UDP ports lie above those that Linux hands out to other programs.
DOMAIN_IDS = range(215, 232)
_FIRST_PORT, _PORTS, _DISCOVERY = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1.1
_LOOK_PERIOD = 0.1  # s between looks whether all processes are alive
_PATIENCE = 20.0  # s for anything that is waited for
NAMESPACE = f'/bench_{os.getpid()}'


@contextmanager
def own_place() -> Iterator[Path]:
    """
    Provide a temporary folder, and an unused ROS_DOMAIN_ID for new processes.

    Fields of messages are not checked meanwhile: only tests do that.

    :raises LaunchError: every domain is in use.
    """
    number = next(filter(_is_free, DOMAIN_IDS), None)
    if number is None:
        raise LaunchError(f'every ROS_DOMAIN_ID of {DOMAIN_IDS} is in use; end what uses one')
    with (
        tempfile.TemporaryDirectory(prefix='humanopts-bench-') as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv('ROS_DOMAIN_ID', str(number))
        patch.setenv('ROS_PYTHON_CHECK_FIELDS', '0')
        yield Path(folder)


def _is_free(domain_id: int) -> bool:
    """Return whether the port that the first participant of a domain takes is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', _FIRST_PORT + _PORTS * domain_id + _DISCOVERY))
        except OSError:
            return False
    return True


def own_spec(name: str, **parameters: Value) -> ProcessSpec:
    """Return the process of a node for measuring only."""
    return ProcessSpec(name, f'benchmarks.{name}', parameters)


@contextmanager
def launched(specs: Sequence[ProcessSpec], folder: Path) -> Iterator[Launcher]:
    """
    Start processes, let this one be a client of them, and stop them whatever happens.

    :param folder: for logs and parameters.
    """
    launcher = Launcher(specs, folder, NAMESPACE)
    start_ros(['--ros-args', '-r', f'__ns:={NAMESPACE}', '--disable-stdout-logs'])
    try:
        launcher.start()
        yield launcher
    finally:
        try_shutdown()
        stop(launcher)


def stop(launcher: Launcher) -> None:
    """End all processes, and print which did not end cleanly."""
    for problem in launcher.stop():
        print(f'humanopts bench: {problem}', file=sys.stderr)


class Client:
    """
    A node of this process that does one thing, and waits for the answer.

    It has its own executor, so that nothing else runs while the time is taken.
    """

    def __init__(self, launcher: Launcher, name: str) -> None:
        self.node = Node(name, start_parameter_services=False, enable_rosout=False)
        self._launcher = launcher
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, done: Callable[[], Any], what: str, seconds: float = _PATIENCE) -> None:
        """
        Run callbacks until a condition holds.

        :raises LaunchError: a process died, or the time is over.
        """
        began = time.monotonic()
        while not done():
            self._executor.spin_once(_LOOK_PERIOD)
            passed = time.monotonic() - began
            if passed > _LOOK_PERIOD:  # what is timed takes less
                self._launcher.check()
            if passed > seconds:
                raise LaunchError(f'gave up waiting for {what} after {seconds:.0f} s')

    def ask(self, future: Any, what: str) -> Any:
        """Wait for an answer and return it; errors as ``until``."""
        self.until(future.done, what)
        return future.result()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
