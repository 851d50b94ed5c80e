"""Work done side by side by processes of this machine, which end with the one that began them."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, ExitStack
from multiprocessing import resource_tracker
import os
import signal
import threading
import time
from typing import Generic, Self, TypeVar

from joblib import delayed, Parallel, parallel_config
from joblib.externals.loky import ProcessPoolExecutor
from joblib.externals.loky.backend import resource_tracker as loky_tracker

NICE = 5  # of a process that lets a graph go first, and still has a share of a busy core
_LOOK = 1.0  # s between looks at whether the process that began this one is still there
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_THREAD = {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}  # as joblib's processes
Key = TypeVar('Key', bound=Hashable)
Result = TypeVar('Result')


@contextmanager
def processes(jobs: int = 0) -> Iterator[None]:
    """
    Have ``as_they_end`` use processes.

    :param jobs: number of processes; 1: this one alone. 0: one for each core.
    """
    count = jobs or len(os.sched_getaffinity(0))
    with parallel_config(backend='loky', n_jobs=count), _quiet_thread():
        yield


def as_they_end(
    calls: Sequence[Callable[[], Result]], costs: Sequence[float]
) -> Iterator[tuple[int, Result]]:
    """
    Yield the number of each call and its result as it ends; the costliest are begun first.

    :param calls: partial calls of functions of modules, so that another process can make them.
        What one raises passes through, and the others are given up.
    """
    parallel = Parallel(return_as='generator_unordered', pre_dispatch='all', batch_size=1)
    order = sorted(range(len(calls)), key=lambda number: -costs[number])
    if parallel.n_jobs == 1:  # the trackers of processes would take longer than a small task
        yield from (_numbered(number, calls[number]) for number in order)
        return
    tasks = (delayed(_numbered)(number, calls[number]) for number in order)
    with ExitStack() as stack:
        with _started_without_interrupts():
            results = stack.enter_context(closing(parallel(tasks)))
        yield from results


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
    with processes(jobs):
        for number, result in as_they_end(calls, costs):
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
        self._stack = ExitStack()

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
        self._executor = self._executor or ProcessPoolExecutor(
            min(len(os.sched_getaffinity(0)), len(calls)),
            initializer=_give_way,
            initargs=(os.getpid(),),
            env=_ONE_THREAD,
        )
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
        self._stack.enter_context(_quiet_thread())
        return self

    def __exit__(self, *_: object) -> None:
        with self._stack:
            if self._executor is not None:
                self._executor.shutdown(kill_workers=True)


def _give_way(parent: int) -> None:
    """Let other processes go first, and end with the one that began this one."""
    os.nice(NICE)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _numbered(number: int, call: Callable[[], Result]) -> tuple[int, Result]:
    return number, call()


@contextmanager
def _started_without_interrupts() -> Iterator[None]:
    """Have processes that are started meanwhile not hear Ctrl-C; this process ends them."""
    with _signals_held_back():
        for tracker in (resource_tracker, loky_tracker):  # each hears it again once it has started
            tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """
    Let what ends this process wait, whichever of its threads the signal came to.

    A start of joblib that is interrupted in its middle raises another error.
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


@contextmanager
def _quiet_thread() -> Iterator[None]:
    """Silence joblib's manager thread, which raises KeyError when its work is given up."""
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
