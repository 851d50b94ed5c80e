"""The command line as a process of its own, and every process below it."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
import fcntl
from functools import partial
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from humanopts_learner.demonstrations import Demonstration
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import Bag
from humanopts_teach.lesson.store import entry_from_line

from graph_support.live import free_domain_id

EPISODES = 5  # played in the demo that tests share


def _outside_of_tests() -> dict[str, str]:
    """Return the environment without what pytest sets: a command may run pytest itself."""
    return {name: value for name, value in os.environ.items() if not name.startswith('PYTEST_')}


class Command:
    """
    ``humanopts ARGUMENTS``, in a session of its own, without a terminal.

    :ivar folder: where its output goes.
    """

    def __init__(
        self,
        arguments: Sequence[Any],
        folder: Path,
        domain_id: int,
        interrupt: signal.Handlers = signal.SIG_DFL,
    ) -> None:
        """
        Start it.

        :param interrupt: what SIGINT does at its start: the default, as in a terminal, or
            nothing, as a shell starts ``command &`` in a script.
        """
        self.folder = folder
        self._out, self._err = folder / 'stdout', folder / 'stderr'
        self._began = time.monotonic()
        with self._out.open('wb') as out, self._err.open('wb') as err:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'humanopts_teach', *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env={**_outside_of_tests(), 'ROS_DOMAIN_ID': str(domain_id)},
                start_new_session=True,
                preexec_fn=partial(signal.signal, signal.SIGINT, interrupt),
            )

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    @property
    def output(self) -> str:
        """What it has printed so far."""
        return self._out.read_text('utf-8')

    @property
    def errors(self) -> str:
        """What it has printed on standard error so far."""
        return self._err.read_text('utf-8')

    @property
    def seconds(self) -> float:
        """Time since its start."""
        return time.monotonic() - self._began

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 60.0) -> None:
        """Wait for a condition while it runs."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert self._process.poll() is None, f'it ended before {what}:\n{self.errors}'
            assert time.monotonic() < deadline, f'timed out waiting for {what}:\n{self.output}'
            time.sleep(0.05)

    def ended(self, seconds: float) -> int:
        """Wait for its end and return its exit status."""
        return self._process.wait(seconds)

    def send(self, how: signal.Signals) -> None:
        """Send a signal to its process group, as a terminal does."""
        os.killpg(self._process.pid, how)

    def running(self) -> dict[int, str]:
        """Return the processes below it, by number: their command lines."""
        found = {}
        for folder in Path('/proc').glob('[0-9]*'):
            try:
                state, _, _, session = (folder / 'stat').read_text().rpartition(')')[2].split()[:4]
                words = (folder / 'cmdline').read_bytes().decode().split('\0')
            except OSError:
                continue  # it ended just now
            number = int(folder.name)
            if int(session) == self._process.pid != number and state != 'Z':
                found[number] = ' '.join(words)
        return found

    def kill(self, node: str, how: signal.Signals) -> None:
        """Send a signal to the process of a node."""
        (number,) = [n for n, line in self.running().items() if f'/log/{node}.yaml' in line]
        os.kill(number, how)

    def gone(self, seconds: float) -> None:
        """
        Wait until nothing is left below it.

        :param seconds: at most, without time that the machine gives to other processes.
        """
        waited = 0.0
        while left := self.running():
            assert waited < seconds, f'still there: {left}'
            began = time.monotonic()
            time.sleep(0.05)
            waited += min(time.monotonic() - began, 0.1)

    def __enter__(self) -> 'Command':
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End whatever is left."""
        for number in (self._process.pid, *self.running()):
            if number != self._process.pid or self._process.poll() is None:
                os.kill(number, signal.SIGKILL)
        self._process.wait()


@dataclass(frozen=True)
class DemoRun:
    """A demo that was run to its end."""

    folder: Path  # --out
    status: int
    output: str
    errors: str
    first_state_after: float  # s
    seconds: float

    @property
    def bag(self) -> Path:
        """Its bag."""
        return self.folder / 'bag'

    @property
    def summary(self) -> dict[str, Any]:
        """Its summary.json."""
        values: dict[str, Any] = json.loads((self.folder / 'summary.json').read_text('utf-8'))
        return values


def run_demo(folder: Path, domain_id: int, *arguments: Any, seconds: float = 300.0) -> DemoRun:
    """Run a demo to its end, within some seconds; its files are in ``folder/out``."""
    with Command(['demo', '--out', folder / 'out', *arguments], folder, domain_id) as command:
        command.until(lambda: 'the first state' in command.output, 'the first state')
        first = command.seconds
        status = command.ended(seconds)
        return DemoRun(
            folder / 'out', status, command.output, command.errors, first, command.seconds
        )


def shared_demo(folder: Path, *arguments: Any) -> DemoRun:
    """Run a demo, unless another process of the same test run has done so in that folder."""
    folder.mkdir(exist_ok=True)
    kept = folder / 'demo.json'
    with (folder / 'lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            with free_domain_id() as number:
                run = run_demo(folder, number, *arguments)
            kept.write_text(json.dumps(asdict(run), default=str), 'utf-8')
    values = json.loads(kept.read_text('utf-8'))
    return DemoRun(**{**values, 'folder': Path(values['folder'])})


def shown_in_bag(bag: Bag) -> list[Demonstration]:
    """Return the demonstrations in a bag, each once: a learner that comes late gets them again."""
    return list(dict.fromkeys(read_demonstrations(bag)))


def shown_on_disk(folder: Path) -> list[Demonstration]:
    """Return the demonstrations that the lesson below ``folder`` has kept, in order."""
    files = sorted((folder / 'demonstrations').glob('*.jsonl'))
    lines = [line for file in files for line in file.read_text('utf-8').splitlines(keepends=True)]
    entries = [entry_from_line(line) for line in lines if line.endswith('\n')]
    return [entry for entry in entries if isinstance(entry, Demonstration)]
