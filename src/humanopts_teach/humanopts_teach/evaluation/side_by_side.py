"""Work done side by side by processes of this machine, which end with the one that began them."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
import os
import signal
import threading
from typing import Generic, Self, TypeVar

NICE = 5  # of a process that lets a graph go first, and still has a share of a busy core
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_THREAD = {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}  # of each process
Key = TypeVar('Key', bound=Hashable)
Result = TypeVar('Result')


@contextmanager
def processes(jobs: int = 0) -> Iterator[Executor | None]:
    """
    Return what ``as_they_end`` has calls made by; they end with the context.

    :param jobs: number of processes; 1: this one alone, None. 0: one for each core.
    """
    count = jobs or len(os.sched_getaffinity(0))
    if count == 1:  # processes would take longer to start than a small task
        yield None
        return
    executor = _executor(count, 0)
    try:
        yield executor
    finally:
        _kill_workers(executor)


def as_they_end(
    calls: Sequence[Callable[[], Result]], costs: Sequence[float], executor: Executor | None
) -> Iterator[tuple[int, Result]]:
    """
    Yield the number of each call and its result as it ends; the costliest are begun first.

    :param calls: partial calls of functions of modules, so that another process can make them.
        What one raises passes through.
    :param executor: makes the calls; None: they are made here, one after the other.
    """
    order = sorted(range(len(calls)), key=lambda number: -costs[number])
    if executor is None:
        yield from ((number, calls[number]()) for number in order)
        return
    with _started_without_interrupts():
        numbers = {executor.submit(calls[number]): number for number in order}
    for ended in as_completed(numbers):
        yield numbers.pop(ended), ended.result()  # which is kept no longer than needed


def all_of(
    calls: Sequence[Callable[[], Result]],
    names: Sequence[str],
    costs: Sequence[float],
    report: Callable[[float, float, str], object],
    jobs: int = 0,
) -> list[Result]:
    """
    Return the result of each call, in order; parameters as of ``as_they_end`` and ``processes``.

    :param report: called with how many have ended, of how many, and the name of the last one.
    """
    results: dict[int, Result] = {}
    with processes(jobs) as executor:
        for number, result in as_they_end(calls, costs, executor):
            results[number] = result
            report(len(results), len(calls), names[number])
    return [results[number] for number in range(len(calls))]


class Meanwhile(Generic[Key, Result]):
    """
    Has other processes, one for each core, make calls while this one has work that goes first.

    It is a context manager, and ends with it; what is still under way is given up then.
    """

    def __init__(self) -> None:
        self._executor: ProcessPoolExecutor | None = None
        self._begun: dict[Key, Future[Result]] = {}

    @property
    def results(self) -> dict[Key, Result]:
        """The results of the calls so far that raised nothing, by what these are known by."""
        ended = {key: call for key, call in self._begun.items() if call.done()}
        return {key: call.result() for key, call in ended.items() if call.exception() is None}

    def begin(self, calls: Mapping[Key, Callable[[], Result]]) -> None:
        """
        Have more calls made, after those before; each as of ``as_they_end``.

        Where a process is killed, as for want of memory, what was begun before is given up.
        """
        try:
            self._submit(calls)
        except BrokenProcessPool:
            self._executor = None
            self._submit(calls)

    def _submit(self, calls: Mapping[Key, Callable[[], Result]]) -> None:
        if not calls:
            return
        if self._executor is None:
            self._executor = _executor(min(len(os.sched_getaffinity(0)), len(calls)), NICE)
        with _started_without_interrupts():
            for key, call in calls.items():
                self._begun[key] = self._executor.submit(call)

    def all_of(
        self,
        calls: Mapping[Key, Callable[[], Result]],
        names: Sequence[str],
        costs: Sequence[float],
        report: Callable[[float, float, str], object],
    ) -> list[Result]:
        """
        Return the result of each call, in order, now that nothing goes first.

        What is under way goes on, and so do a few calls that come next. The others begin in the
        order of the costs, and those that are not asked for are given up. Parameters are those of
        the function ``all_of``.

        :raises BrokenProcessPool: a process was killed meanwhile.
        """
        self._begun = {
            key: call
            for key, call in self._begun.items()
            if not (call.cancel() or (call.done() and call.exception()))
        }
        dearest = sorted(zip(calls, costs), key=lambda call: -call[1])
        self.begin({key: calls[key] for key, _ in dearest if key not in self._begun})
        begun = {self._begun[key]: name for key, name in zip(calls, names)}
        for ended, call in enumerate(as_completed(begun), 1):
            call.result()
            report(ended, len(calls), begun[call])
        return [call.result() for call in begun]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._executor is not None:
            _kill_workers(self._executor)


def _executor(count: int, niceness: int) -> ProcessPoolExecutor:
    """Return an executor of new processes, as a fork of this one would have its locks."""
    context = multiprocessing.get_context('spawn')
    return ProcessPoolExecutor(count, context, initializer=_begin, initargs=(niceness,))


def _begin(niceness: int) -> None:
    """Let other processes go first, and end with the one that began this one."""
    os.nice(niceness)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _kill_workers(executor: ProcessPoolExecutor) -> None:
    """End the processes of an executor at once, as Python 3.14's method of this name does."""
    workers = [*executor._processes.values()]
    executor.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.kill()
    for worker in workers:
        worker.join()


@contextmanager
def _started_without_interrupts() -> Iterator[None]:
    """Have processes that are started meanwhile not hear Ctrl-C; this process ends them."""
    with _signals_held_back():
        resource_tracker.ensure_running()  # hears it again once it has started
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
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


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """
    Let what ends this process wait, whichever of its threads the signal came to.

    A start of a process that is interrupted in its middle leaves it without its work.
    """
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():  # which alone is interrupted
        handlers = {each: signal.getsignal(each) for each in _ENDING}
    handlers = {each: handler for each, handler in handlers.items() if callable(handler)}
    for each in handlers:
        signal.signal(each, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
        if came:
            signal.raise_signal(came[0])
