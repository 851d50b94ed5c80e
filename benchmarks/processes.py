"""The processes of a benchmark, for as long as one part of it takes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import sys
import time

from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import ProcessSpec, Value

_LOOK_PERIOD = 0.05  # s
NAMESPACE = f'/bench_{os.getpid()}'


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
