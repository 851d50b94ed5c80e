"""
Trials: the computations of an experiment, and their execution.

A finished trial is one JSON file. Its name depends on everything that affects the result: the
experiment, its parameters, the code and the numeric libraries. An interrupted run thus continues
where it stopped, and results of other code are recomputed.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
import hashlib
from importlib.metadata import version
from importlib.util import find_spec
import json
from pathlib import Path
import time
from typing import Any

from humanopts_teach.evaluation import ProgressCallback
from humanopts_teach.evaluation.side_by_side import completed_calls, processes
from humanopts_teach.evaluation.summary import write_text

PACKAGES = ('humanopts_env', 'humanopts_learner', 'humanopts_teach', 'experiments')
LIBRARIES = {
    name: version(name) for name in ('numpy', 'scipy', 'scikit-learn')
}  # affect the last digits of results
ANSWERS_WITHIN = 10.0  # s, timeout for the answer of a Dask scheduler
WORKERS_WITHIN = 30.0  # s, timeout for the first worker of a Dask cluster
Rows = list[dict[str, Any]]  # result: rows of a table, JSON data
Compute = Callable[[Mapping[str, Any]], Rows]  # takes parameters, JSON data


class ClusterError(RuntimeError):
    """The Dask cluster cannot be used; the text says why."""


def digest(folders: Iterable[Path]) -> str:
    """Return a short digest of the Python code in folders, without the ROS nodes."""
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob('*.py')):
            if 'ros' not in path.relative_to(folder).parts:
                found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return found.hexdigest()[:12]


@cache
def code_version() -> str:
    """Return the digest of the code that affects results."""
    specs = [find_spec(package) for package in PACKAGES]
    return digest(Path(place) for s in specs if s for place in s.submodule_search_locations or ())


def versions() -> dict[str, Any]:
    """Return the versions that affect numbers: those of the code and the numeric libraries."""
    return {'code': code_version(), 'libraries': LIBRARIES}


@dataclass(frozen=True)
class Trial:
    """One computation: experiment, code and parameters determine the result."""

    experiment: str  # such as fig2
    parameters: Mapping[str, Any]  # JSON data
    compute: Compute  # a module-level function, so that it can be pickled
    cost: float = 1.0  # approximate processor seconds, for scheduling and the remaining time

    @property
    def identity(self) -> Any:
        """The values that determine the result, as JSON data."""
        known = {'experiment': self.experiment, 'parameters': dict(self.parameters), **versions()}
        return json.loads(json.dumps(known))

    @property
    def key(self) -> str:
        """A short unique name."""
        text = json.dumps(self.identity, sort_keys=True)
        return f'{self.experiment}-{hashlib.sha256(text.encode()).hexdigest()[:20]}'

    def __str__(self) -> str:
        """Describe the trial."""
        said = ', '.join(f'{name} {value}' for name, value in self.parameters.items())
        return f'{self.experiment} ({said})'


@dataclass
class TrialResults:
    """The results and failures of a run, by key of the trial."""

    results: dict[str, Rows] = field(default_factory=dict)
    computed: int = 0  # in this run; the other results existed before
    failures: dict[str, str] = field(default_factory=dict)  # the trial, and its error

    def rows_of(self, trials: Iterable[Trial]) -> list[dict[str, Any]]:
        """Return the rows of all finished trials, each with the number of its ``trial``."""
        return [
            {'trial': number, **row}
            for number, trial in enumerate(trials)
            for row in self.results.get(trial.key, ())
        ]


def run_trials(
    trials: Sequence[Trial], folder: Path, progress: ProgressCallback, jobs: int, dask: str = ''
) -> TrialResults:
    """
    Compute the missing trials; write each result as soon as it is computed.

    A failed trial is reported in the outcome, and the others continue.

    :param folder: folder of the finished trials; created if missing.
    :param progress: callback for the finished cost, the total cost and a text.
    :param jobs: number of local processes, 1 or more; 1: this process.
    :param dask: address of a Dask scheduler to use instead; empty: local processes.
    :raises ClusterError: the cluster does not answer, or Dask is not installed.
    :raises SummaryError: a result cannot be written.
    :raises OSError: the folder cannot be created.
    """
    folder.mkdir(parents=True, exist_ok=True)
    outcome, missing = TrialResults(), list[Trial]()
    for trial in {trial.key: trial for trial in trials}.values():
        try:
            kept = json.loads((folder / f'{trial.key}.json').read_text('utf-8'))
        except (OSError, ValueError):
            kept = None  # not finished, or damaged
        if isinstance(kept, dict) and kept.get('trial') == trial.identity and 'result' in kept:
            outcome.results[trial.key] = kept['result']
        else:
            missing.append(trial)
    total, count = sum(trial.cost for trial in missing), len(missing)
    before = len(outcome.results)
    progress(0.0, total, f'{before + count} trials, {before} of them done before')
    if not missing:
        return outcome
    calls = [partial(_compute, trial.compute, dict(trial.parameters)) for trial in missing]
    with _executor(jobs, dask) as executor:
        costs, done = [trial.cost for trial in missing], 0.0
        for number, (result, seconds, error) in completed_calls(calls, costs, executor):
            trial = missing[number]
            if error:
                outcome.failures[trial.key] = f'{trial}: {error}'
            else:
                kept = {'trial': trial.identity, 'seconds': round(seconds, 3), 'result': result}
                text = json.dumps(kept, indent=1, allow_nan=False)
                write_text(folder / f'{trial.key}.json', text + '\n')
                outcome.results[trial.key] = result
                outcome.computed += 1
            done += trial.cost
            ended = outcome.computed + len(outcome.failures)
            progress(done, total, f'{ended} of {count} trials')
    return outcome


def _compute(compute: Compute, parameters: dict[str, Any]) -> tuple[Rows, float, str]:
    """Compute one trial in this process; return result, seconds and error."""
    began, rows, error = time.perf_counter(), Rows(), ''
    try:
        rows = compute(parameters)
    except Exception as problem:  # one failure must not stop the other trials
        error = f'{type(problem).__name__}: {problem}'
    return rows, time.perf_counter() - began, error


@contextmanager
def _executor(jobs: int, dask: str) -> Iterator[Executor | None]:
    if not dask:
        with processes(jobs) as executor:
            yield executor
        return
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            '--dask needs the packages dask and distributed, which are not installed'
        ) from None
    try:
        client = Client(dask, timeout=ANSWERS_WITHIN)
    except (OSError, ValueError) as error:
        raise ClusterError(f'no Dask scheduler answers at {dask}: {error}') from error
    with client:
        _check_cluster(client, dask)
        yield client.get_executor(pure=False)


def _check_cluster(client: Any, dask: str) -> None:
    """
    Check that a Dask cluster has the same code and libraries as this process.

    The scheduler unpickles the calls that it forwards, so it needs their code, too.

    :raises ClusterError: there is no worker, or a worker or the scheduler lacks humanopts or has
        another version.
    """
    from distributed import TimeoutError as NoWorker

    def check(where: str, found: Any) -> None:
        if isinstance(found, Exception):
            raise ClusterError(
                f'the {where} cannot import the experiments: {found}; start it in the folder of '
                'the repository, with PYTHONPATH=.'
            )
        if found != (here := versions()):
            text = f'the {where} has other code or libraries than this machine: {found}'
            raise ClusterError(f'{text}, here {here}')

    try:
        found = client.run_on_scheduler(versions)
    except ImportError as error:
        found = error
    check('scheduler', found)
    try:
        client.wait_for_workers(1, timeout=WORKERS_WITHIN)
    except (NoWorker, TimeoutError) as error:
        raise ClusterError(f'no worker has joined the Dask scheduler at {dask}') from error
    for worker, found in client.run(versions, on_error='return').items():
        check(f'worker {worker}', found)
