"""Running cells in several processes, or on a Dask cluster, with those that are done left out."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, ExitStack
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
import signal
import threading
import time
from typing import Any, Protocol

from joblib import delayed, Parallel, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_tracker

from experiments.cells import Cell, CellStore


class ClusterError(RuntimeError):
    """The Dask cluster cannot be used; the text says why."""


class Watch(Protocol):
    """Somebody who is told how far the work is."""

    def begin(self, cells: Sequence[Cell], left: Sequence[Cell]) -> None:
        """Take in all cells, and those that are to be computed."""
        ...

    def done(self, cell: Cell, failed: bool) -> None:
        """Take in that a cell is over."""
        ...


@dataclass
class Outcome:
    """What running cells came to."""

    results: dict[str, Any] = field(default_factory=dict)  # by key of the cell
    computed: int = 0  # in this run; the others were done before
    failures: dict[str, str] = field(default_factory=dict)  # by key: which cell, and what happened


@dataclass(frozen=True)
class _Reply:
    """What came back for one cell; only plain values travel."""

    number: int
    result: Any
    seconds: float
    error: str  # empty: none


def run_cells(
    cells: Sequence[Cell], store: CellStore, watch: Watch, jobs: int, dask: str = ''
) -> Outcome:
    """
    Compute what is not done yet; each result is kept as soon as it is there.

    A cell that fails is named in the outcome, and the others go on.

    :param jobs: processes on this machine, 1 or more; 1: in this process.
    :param dask: address of a Dask scheduler that does the work instead; empty: none.
    :raises ClusterError: the cluster does not answer, or Dask is not installed.
    :raises SummaryError: a result cannot be written.
    """
    outcome = Outcome()
    left = []
    for cell in {cell.key: cell for cell in cells}.values():
        if (result := store.load(cell)) is None:
            left.append(cell)
        else:
            outcome.results[cell.key] = result
    watch.begin(cells, left)
    for reply in _replies(left, jobs, dask):
        cell = left[reply.number]
        if reply.error:
            outcome.failures[cell.key] = f'{cell}: {reply.error}'
        else:
            store.save(cell, reply.result, reply.seconds)
            outcome.results[cell.key] = reply.result
            outcome.computed += 1
        watch.done(cell, bool(reply.error))
    return outcome


def _replies(cells: Sequence[Cell], jobs: int, dask: str) -> Iterator[_Reply]:
    """Yield what comes back, as it comes; the costliest cells are begun first."""
    if not cells:
        return
    order = sorted(range(len(cells)), key=lambda number: -cells[number].cost)
    with _backend(jobs, dask):
        work = Parallel(return_as='generator_unordered', pre_dispatch='all', batch_size=1)
        tasks = (
            delayed(_compute)(number, cells[number].compute, dict(cells[number].parameters))
            for number in order
        )
        with ExitStack() as stack:
            with _deaf_to_interrupts():
                replies = stack.enter_context(closing(work(tasks)))
            yield from replies


def _compute(number: int, compute: Any, parameters: dict[str, Any]) -> _Reply:
    """Compute one cell in the process that has it; an error is caught there."""
    began = time.perf_counter()
    try:
        result, error = compute(parameters), ''
    except Exception as problem:  # whatever a cell comes to, the others go on
        result, error = None, f'{type(problem).__name__}: {problem}'
    return _Reply(number, result, time.perf_counter() - began, error)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Have processes that are started meanwhile not hear Ctrl-C; this one ends them."""
    for tracker in (resource_tracker, loky_tracker):  # each hears it again once it has started
        tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _quiet_thread() -> Iterator[None]:
    """Say nothing where joblib's thread no longer finds work, since that was given up."""
    before = threading.excepthook

    def hook(error: threading.ExceptHookArgs) -> None:
        name = error.thread.name if error.thread is not None else ''
        if error.exc_type is not KeyError or name != 'ExecutorManagerThread':
            before(error)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


@contextmanager
def _backend(jobs: int, dask: str) -> Iterator[None]:
    if not dask:
        with parallel_config(backend='loky', n_jobs=jobs), _quiet_thread():
            yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            '--dask needs the packages dask and distributed, which are not installed'
        ) from None
    try:
        client = Client(dask, timeout=10)
    except (OSError, ValueError) as error:
        raise ClusterError(f'no Dask scheduler answers at {dask}: {error}') from error
    with client, parallel_config(backend='dask', client=client):
        yield
