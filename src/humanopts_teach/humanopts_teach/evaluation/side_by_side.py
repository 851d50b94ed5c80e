"""Parallel work in local processes, which end with their parent process."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed, Executor, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from importlib import import_module
import multiprocessing
from multiprocessing.connection import wait
import os
import signal
import threading
from typing import TypeVar

_ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
_ONE_THREAD = {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}  # for each process
Result = TypeVar('Result')
Jobs = int | Executor


@contextmanager
def processes(jobs: int = 0) -> Iterator[Executor | None]:
    """
    Start the executor for ``completed_calls``; its processes end with the context.

    :param jobs: number of processes; 0: one per core; 1: only this process (yields None).
    """
    count = jobs or len(os.sched_getaffinity(0))
    if count == 1:  # starting a process can take longer than a small task
        yield None
        return
    # Use spawn, since a fork would inherit the locks of this process.
    executor = ProcessPoolExecutor(count, multiprocessing.get_context('spawn'), _watch_parent)
    try:
        yield executor
    finally:  # kill without waiting, like kill_workers of Python 3.14
        workers = [*executor._processes.values()]
        executor.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.kill()
        for worker in workers:
            worker.join()


def import_ahead(modules: Sequence[str], executor: Executor | None) -> None:
    """Start the processes of an executor and have each import modules, without waiting."""
    if executor is not None:
        with _starting():
            for _ in os.sched_getaffinity(0):
                executor.submit(_import, modules)


def _import(modules: Sequence[str]) -> None:
    for module in modules:
        import_module(module)


def completed_calls(
    calls: Sequence[Callable[[], Result]], costs: Sequence[float], executor: Executor | None
) -> Iterator[tuple[int, Result]]:
    """
    Yield the index and result of each call in order of completion; the costliest start first.

    :param calls: partial calls of module-level functions, which can be pickled; their exceptions
        propagate.
    :param executor: executor of the calls; None: run them one by one in this process.
    """
    order = sorted(range(len(calls)), key=lambda number: -costs[number])
    if executor is None:
        yield from ((number, calls[number]()) for number in order)
        return
    with _starting():
        numbers = {executor.submit(calls[number]): number for number in order}
    for ended in as_completed(numbers):
        yield numbers.pop(ended), ended.result()  # free the result after use


def all_of(
    calls: Sequence[Callable[[], Result]],
    names: Sequence[str],
    costs: Sequence[float],
    report: Callable[[float, float, str], object],
    jobs: Jobs = 0,
) -> list[Result]:
    """
    Return the results of all calls in order; see ``completed_calls`` and ``processes``.

    :param jobs: as in ``processes``, or an executor from there, which can be reused.
    :param report: progress callback: finished calls, all calls, name of the last finished call.
    """
    results: dict[int, Result] = {}
    with processes(jobs) if isinstance(jobs, int) else nullcontext(jobs) as executor:
        for number, result in completed_calls(calls, costs, executor):
            results[number] = result
            report(len(results), len(calls), names[number])
    return [results[number] for number in range(len(calls))]


def _watch_parent() -> None:
    """End this process when its parent ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _starting() -> Iterator[None]:
    """Make processes started in this context ignore Ctrl-C and compute with one thread."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)  # inherited by the processes
    threads = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in threads.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
