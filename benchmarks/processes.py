"""The processes of a benchmark, in a separate ROS domain and folder, and their clients."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import socket
import sys
import tempfile
import time
from typing import Any

from humanopts_ros.guarded_node import start_ros
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec, Value
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

# Domains with UDP ports above Linux's ephemeral ports.
DOMAIN_IDS = range(215, 232)
_FIRST_PORT, _PORTS, _DISCOVERY = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1.1
_LOOK_PERIOD = 0.1  # s between checks that all processes are alive
_PATIENCE = 20.0  # s, timeout of every wait
NAMESPACE = f'/bench_{os.getpid()}'


@contextmanager
def own_place() -> Iterator[Path]:
    """
    Provide a temporary folder and an unused ROS_DOMAIN_ID for new processes.

    Meanwhile, message fields are not checked, as usual outside of tests.

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
    """Return whether the port of the first participant of a domain is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', _FIRST_PORT + _PORTS * domain_id + _DISCOVERY))
        except OSError:
            return False
    return True


def own_spec(name: str, **parameters: Value) -> ProcessSpec:
    """Return the process of a node that is only used for measuring."""
    return ProcessSpec(name, f'benchmarks.{name}', parameters)


@contextmanager
def launched(specs: Sequence[ProcessSpec], folder: Path) -> Iterator[Launcher]:
    """
    Start processes with this process as their client, and always stop them at the end.

    :param folder: folder of logs and parameters.
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
    """Stop all processes and print those that did not exit cleanly."""
    for problem in launcher.stop():
        print(f'humanopts bench: {problem}', file=sys.stderr)


class Client:
    """
    A node in this process that sends one request at a time and waits for the answer.

    It has its own executor, so that nothing else runs during a measurement.
    """

    def __init__(self, launcher: Launcher, name: str) -> None:
        self.node = Node(name, start_parameter_services=False, enable_rosout=False)
        self._launcher = launcher
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, done: Callable[[], Any], what: str, seconds: float = _PATIENCE) -> None:
        """
        Run callbacks until a condition holds.

        :raises LaunchError: a process died, or the wait timed out.
        """
        began = time.monotonic()
        while not done():
            self._executor.spin_once(_LOOK_PERIOD)
            passed = time.monotonic() - began
            if passed > _LOOK_PERIOD:  # longer than any timed operation
                self._launcher.check()
            if passed > seconds:
                raise LaunchError(f'gave up waiting for {what} after {seconds:.0f} s')

    def ask(self, future: Any, what: str) -> Any:
        """Wait for an answer and return it; errors as in ``until``."""
        self.until(future.done, what)
        return future.result()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
