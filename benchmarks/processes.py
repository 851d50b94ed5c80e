"""The processes of a benchmark, in a ROS domain and a folder of their own."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import socket
import sys
import tempfile
import time

from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec, Value

# Domains whose UDP ports lie above those that Linux hands out to other programs.
DOMAIN_IDS = range(215, 232)
_FIRST_PORT, _PORTS, _DISCOVERY = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1.1
_LOOK_PERIOD = 0.05  # s
NAMESPACE = f'/bench_{os.getpid()}'


@contextmanager
def own_place() -> Iterator[Path]:
    """
    Have a folder for files that nobody needs afterwards, and a ROS_DOMAIN_ID for new processes.

    :raises LaunchError: every domain is in use.
    """
    with tempfile.TemporaryDirectory(prefix='humanopts-bench-') as folder, own_domain():
        yield Path(folder)


@contextmanager
def own_domain() -> Iterator[int]:
    """
    Have new processes use a ROS_DOMAIN_ID that no process of this machine uses.

    Messages are not checked field by field meanwhile, as they are only where programs are tested.

    :raises LaunchError: every domain is in use.
    """
    order = [DOMAIN_IDS[(os.getpid() + n) % len(DOMAIN_IDS)] for n in range(len(DOMAIN_IDS))]
    number = next((number for number in order if _is_free(number)), None)
    if number is None:
        raise LaunchError(
            f'every ROS_DOMAIN_ID from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} is in use; end what '
            'uses one of them'
        )
    with _environment({'ROS_DOMAIN_ID': str(number), 'ROS_PYTHON_CHECK_FIELDS': '0'}):
        yield number


def _is_free(domain_id: int) -> bool:
    """Return whether the port that the first participant of a domain takes is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', _FIRST_PORT + _PORTS * domain_id + _DISCOVERY))
        except OSError:
            return False
    return True


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def bench_spec(name: str, **parameters: Value) -> ProcessSpec:
    """Return the process of a node that is only there to measure."""
    return ProcessSpec(name, f'benchmarks.{name}', parameters)


@contextmanager
def launched(specs: Sequence[ProcessSpec], folder: Path) -> Iterator[Launcher]:
    """
    Start processes, and stop them whatever happens, the recorder last.

    :param folder: for logs and parameters.
    """
    launcher = Launcher(specs, folder, NAMESPACE)
    try:
        launcher.start()
        yield launcher
    finally:
        for problem in launcher.stop():
            print(f'humanopts bench: {problem}', file=sys.stderr)


def wait(launcher: Launcher, done: Callable[[], bool], seconds: float, what: str) -> None:
    """
    Wait until something is done, while all processes are alive.

    :raises LaunchError: one died, or the time is over.
    """
    deadline = time.monotonic() + seconds
    while not done():
        launcher.check()
        if time.monotonic() > deadline:
            raise LaunchError(f'gave up waiting for {what} after {seconds:.0f} s')
        time.sleep(_LOOK_PERIOD)
