"""
A long lesson among random faults: ``make soak SECONDS=600 SEED=1``.

Nodes are killed, ended and stopped at random, and so is the terminal of a guest. The time of day
is changed, the disk is slow for a while, invalid lines are added to files, parameters are set to
invalid values, and garbage is sent on every topic, service and action. After each fault the lesson
must continue. At the end no demonstration may be lost and no action applied twice. A table shows
the faults and their effects.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import random
import signal
import sys
import tempfile
import time
from typing import Any
from unittest.mock import patch

from humanopts_env.domains.registry import make_domain
from humanopts_interfaces.msg import NodeStatus
from humanopts_learner.demonstrations import check_demonstration, Demonstration
from humanopts_ros.workarounds import prepare_discovery
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.commands.session import Session, session
from humanopts_teach.launching import LaunchError, MODULES, OccupiedError
from humanopts_teach.launching.processes import Setup
from humanopts_teach.launching.restarts import RestartPolicy
from humanopts_teach.lesson.store import entry_from_line
import pandas as pd
import psutil
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.parameter import Parameter

from graph_support.live import free_domain_id
from graph_support.machine import Machine
from graph_support.stranger import Stranger
from graph_support.terminal import CTRL_C, ENTER, Terminal

OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')
SETTLE = 30.0  # s for the lesson to take its usual memory, and to give back what it took more
RECOVERY = 60.0  # s until all nodes are ready and another demonstration is kept
SETTINGS = (-3600.0, -10.0, -0.3, 0.3, 10.0, 3600.0)  # s by which the time of day is set
ANSWER = 40.0  # s for a call of garbage to be answered; a node may wait 15 s for others
ENDS = {'killed': signal.SIGKILL, 'ended': signal.SIGTERM, 'stopped': signal.SIGSTOP}
GUEST_KEYS = ('y', 'n', 'left', 'right', 'up', 'down', 'p', 'd', 't', ENTER)
IMPOSSIBLE = (math.nan, -math.inf, [1, 2], 'x' * 20_000)  # values of no parameter


@dataclass
class Outcome:
    """What came of all faults."""

    recoveries: list[tuple[str, float]] = field(default_factory=list)  # fault, s until it was over
    violations: list[str] = field(default_factory=list)
    remarks: Counter[str] = field(default_factory=Counter)
    messages: int = 0  # of garbage
    calls: int = 0


class Soak:
    """A launch under random faults."""

    def __init__(
        self, running: Session, machine: Machine, rng: random.Random, outcome: Outcome
    ) -> None:
        self._machine = machine
        self._running, self._graph, self._launcher = running, running.graph, running.launcher
        self._rng, self._outcome = rng, outcome
        self.stranger = Stranger(random.Random(rng.random()))
        self.names = [name.rpartition('/')[2] for name in self._launcher.node_names]
        self.verbose = False  # a line is printed for each fault
        self._participants, self._replaced = 1, set[int]()  # processes of those who are done
        self._next: list[str] = []  # kinds of faults

    def shown(self) -> list[Demonstration]:
        """Return the demonstrations on disk, without those that were taken back."""
        return on_disk(self._running.setup.directory / 'demonstrations')

    def fault(self, kinds: Sequence[str], messages: int, calls: int) -> None:
        """Do one thing at random, and wait until the lesson goes on."""
        self.serve(self._rng.uniform(0.0, 1.0))
        if not self._next:  # each kind comes as often as it is given
            self._next = self._rng.sample(kinds, len(kinds))
        kind, node = self._next.pop(), self._rng.choice(self.names)
        self._until(lambda: self._runs(node), f'{node} to run')
        before, began, name = len(self.shown()), time.monotonic(), kind
        if kind in ('kill', 'term', 'files'):
            name = f'{kind} {self._end(kind, node)}'
        elif kind == 'stop':
            name = f'stop {node}'
            pid = self._send(node, signal.SIGSTOP)
            self.serve(self._rng.choice((0.2, 1.0, 3.0)))
            os.kill(pid, signal.SIGCONT)
        elif kind == 'terminal':
            name = f'terminal {self._sit_down()}'
        elif kind == 'clock':
            self._machine.set_time(self._rng.choice(SETTINGS))
        elif kind == 'disk':
            self._machine.slow_disk(self._rng.choice((0.01, 0.1, 1.0)))
            self.serve(3.0)
            self._machine.slow_disk(0.0)
        elif kind == 'settings':
            self._set(node)
        elif kind == 'messages':
            topic, type_ = self._rng.choice(self.stranger.topics())
            self.stranger.send(topic, type_, messages)
            self._outcome.messages += messages
            name = f'messages on {topic}'
        else:
            name = f'calls of {self._call(calls)}'
        self._recover(kind, name, before, began)

    def _end(self, kind: str, node: str) -> str:
        """End a node, after its files were spoilt or not; wait until the graph knows of it."""
        ends, said = len(self._launcher.ends), len(self.stranger.said)
        if kind == 'files':
            node = self._rng.choice(('lesson', 'learner'))
            self._spoil(node)
        self._send(node, signal.SIGTERM if kind == 'term' else signal.SIGKILL)
        self._until(lambda: len(self._launcher.ends) > ends, f'the end of {node} to be seen')
        news = f'the node {node} ended'
        self._until(
            lambda: any(news in text for text in self.stranger.said[said:]), f'the news: {news}'
        )
        return node

    def _send(self, node: str, how: signal.Signals) -> int:
        """Send a signal to a node, and return its process; it may have ended just now."""
        while True:
            pid = self.pid(node)
            with suppress(ProcessLookupError):
                os.kill(pid, how)
                return pid
            self.serve(0.1)

    def _sit_down(self) -> str:
        """
        Let a guest teach in a terminal that ends at any moment, and come again.

        :return: how it ended.
        """
        how = self._rng.choice(('killed', 'ended', 'stopped', 'hung up'))
        with suppress(AssertionError):  # which is a violation, and noted
            with self._terminal() as terminal:
                self._teach_until(how, terminal)
            with self._terminal() as terminal:
                terminal.press(CTRL_C)
                status = terminal.ended()
                assert not status, f'after one {how}: {terminal.errors()}'
                assert terminal.restored(), f'the terminal is not given back after one {how}'
        return how

    def _teach_until(self, how: str, terminal: Terminal) -> None:
        """Press keys until the terminal is ended at a random moment."""
        terminal.press('1', *'guess', ENTER)
        end = time.monotonic() + self._rng.uniform(0.0, 6.0)
        while time.monotonic() < end and terminal.process.poll() is None:
            terminal.press(self._rng.choice(GUEST_KEYS))
            self.serve(0.05)
            terminal.read(0.0)
        if how == 'hung up':
            terminal.hang_up()
        else:
            terminal.process.send_signal(ENDS[how])
        if how == 'stopped':
            self.serve(self._rng.choice((0.2, 3.0)))
            terminal.process.send_signal(signal.SIGCONT)
            terminal.press(CTRL_C)
        self._until(lambda: terminal.process.poll() is not None, f'the end of one {how}')

    @contextmanager
    def _terminal(self) -> Iterator[Terminal]:
        """Sit down at a terminal as a guest."""
        words = ('-m', MODULES['keyboard_teleop'], '--ros-args', '-p', 'participant:=guest')
        terminal = Terminal(words, int(os.environ['ROS_DOMAIN_ID']), lambda: self.serve(0.0))
        try:
            terminal.see('Who is teaching? > guest')
            pressed = 0.0

            def let_in() -> bool:
                """Press Enter now and then: another participant may be demonstrating."""
                nonlocal pressed
                if time.monotonic() > pressed + 0.1:
                    terminal.press(ENTER)
                    pressed = time.monotonic()
                return not any(
                    text in terminal.text() for text in ('Who is teaching?', 'Discard it?')
                )

            terminal.until(let_in, 'to be let in', RECOVERY)
            yield terminal
        except AssertionError as error:
            self._violate(str(error))
            raise
        finally:
            terminal.close()

    def _spoil(self, node: str) -> None:
        """Add an invalid line to a file that the node reads when it is restarted."""
        out = self._running.setup.directory
        folder = out / ('demonstrations' if node == 'lesson' else 'options')
        self._until(lambda: any(f.stat().st_size for f in folder.glob('*.jsonl')), 'a journal')
        file = self._rng.choice(sorted(f for f in folder.glob('*.jsonl') if f.stat().st_size))
        entry = self._rng.choice(file.read_bytes().splitlines())
        cut = entry[: self._rng.randrange(len(entry))]
        line = self._rng.choice((cut, b'[' * 100_000, b'{"entry": 5}', self.stranger.bytes()))
        with file.open('ab', buffering=0) as opened:
            opened.write(line.replace(b'\n', b'') + b'\n')

    def _set(self, node: str) -> None:
        """Set every parameter of a node to what it cannot be; each must be refused, and why."""
        value = self._rng.choice(IMPOSSIBLE)
        listed = self._ask(ListParameters, f'/{node}/list_parameters')
        names = listed.result.names if listed else []
        wanted = [Parameter(name, value=value).to_parameter_msg() for name in names]
        answer = self._ask(SetParameters, f'/{node}/set_parameters', parameters=wanted)
        if answer is None:
            return
        for name, result in zip(names, answer.results, strict=True):
            if result.successful or not result.reason:
                self._violate(f'{name} of {node} was set to {str(value)[:20]}')

    def _ask(self, kind: Any, service: str, **fields: Any) -> Any:
        """Return the response of a service of the graph; None: there is none, a violation."""
        client = self.stranger.node.create_client(kind, service)
        self._until(client.service_is_ready, f'{service} to be there')
        future = client.call_async(kind.Request(**fields))
        self._until(future.done, f'an answer of {service}', ANSWER)
        self.stranger.node.destroy_client(client)
        return future.result()

    def _call(self, count: int) -> str:
        """Send garbage to a service or an action, and return which."""
        service, type_ = self._rng.choice(self.stranger.services())
        for _ in range(count):
            self._until(lambda: self.stranger.ready(service), f'{service} to be there')
            done, result = self.stranger.call(service, type_)
            self._outcome.calls += 1
            self._until(done, f'an answer of {service}', ANSWER)
            if done() and not hasattr(result(), 'status') and not hasattr(result(), 'result'):
                self._violate(f'{service} answered without a status')
        return service

    def _recover(self, kind: str, name: str, before: int, began: float) -> None:
        """Wait until every node is ready and another demonstration is kept."""
        if kind in GARBAGE:
            before = len(self.shown())
        deadline = time.monotonic() + RECOVERY
        while time.monotonic() < deadline:
            try:
                self._graph.wait_ready(list(self._launcher.node_names), 15.0)
                self._graph.wait(lambda: self._grown(before), 15.0, 'another demonstration')
            except LaunchError as error:
                text = f'after {name}: {str(error)[:300]}'
                if isinstance(error, OccupiedError):  # a restart was taken for another launch
                    self._violate(text)
                self._outcome.remarks[text] += 1
                self._help_teacher()
                self.serve(0.5)
            else:
                seconds = time.monotonic() - began
                self._outcome.recoveries.append((kind, seconds))
                if self.verbose:
                    print(f'{seconds:7.2f} s  {name}', flush=True)
                return
        self._violate(f'{name}: the lesson did not go on within {RECOVERY:.0f} s')

    def _grown(self, before: int) -> bool:
        self.stranger.serve()
        if self._taught():
            self._next_participant()
        return len(self.shown()) > before

    def _next_participant(self) -> None:
        """Let another simulated person teach, once one has taught everything."""
        self._participants += 1
        (spec,) = [s for s in self._launcher._specs if s.name == 'simulated_teacher']
        assert isinstance(spec.parameters, dict)
        spec.parameters['participant'] = f'p{self._participants}'
        for running in self._launcher._running:
            if running.spec is spec:  # it has not died, so that the pause before it does not grow
                running.policy = RestartPolicy(10**9)
        pid = self.pid('simulated_teacher')
        self._replaced.add(pid)
        os.kill(pid, signal.SIGTERM)

    def _help_teacher(self) -> None:
        """Start the simulated teacher again where it gave up and said why, as a person would."""
        status = self._graph.peers.statuses.get('simulated_teacher')
        if status is not None and status.state == NodeStatus.STATE_PAUSED:
            self._outcome.remarks[
                f'the teacher is started again, it said: {status.text[:200]}'
            ] += 1
            with suppress(ProcessLookupError):  # it has just ended
                os.kill(self.pid('simulated_teacher'), signal.SIGTERM)

    def _runs(self, node: str) -> bool:
        """Return whether a node runs; it may have ended just now for another reason."""
        return node in self._graph.peers.statuses and psutil.pid_exists(self.pid(node))

    def pid(self, node: str) -> int:
        """Return the process of a node."""
        return self._launcher.pid(node)

    def _until(self, done: Callable[[], bool], what: str, seconds: float = 30.0) -> None:
        deadline = time.monotonic() + seconds
        while not done():
            if time.monotonic() > deadline:
                self._violate(f'waited {seconds:.0f} s for {what}, which did not come')
                return
            self.serve(0.01)

    def serve(self, seconds: float) -> None:
        """Look after the stranger and the launch for a while, in which the lesson goes on."""
        end = time.monotonic() + seconds
        while True:
            self.stranger.serve(0.01)
            self.watch(0.0)
            if time.monotonic() >= end:
                return

    def teach(self, seconds: float) -> None:
        """Let people teach for a while, one after the other."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._grown(0)
            self.serve(0.5)

    def _taught(self) -> bool:
        return (
            self._graph.teacher_finished() and self.pid('simulated_teacher') not in self._replaced
        )

    def watch(self, seconds: float) -> None:
        """Look after the launch for a while."""
        end = time.monotonic() + seconds
        while True:
            self._graph.catch_up()
            self._running.check()
            if time.monotonic() >= end:
                return
            time.sleep(0.01)

    def _violate(self, text: str) -> None:
        self._outcome.violations.append(text)
        print(f'VIOLATION: {text}', flush=True)

    def finish(self) -> None:
        """Check what must hold whatever happened."""
        directory, domain = self._running.setup.directory, make_domain('taxi')
        shown = self.shown()

        def lost() -> set[str]:
            return {d.uuid for d in shown} - {d.uuid for d in on_disk(directory / 'options')}

        self._until(lambda: not lost(), 'the learner to have every demonstration')
        for demo in [*shown, *on_disk(directory / 'options')]:
            try:
                check_demonstration(demo, domain)
            except ValueError as error:
                self._violate(f'a demonstration breaks the rules: {error}')
        twice = [key for key, places in self.stranger.applied.items() if len(places) > 1]
        if twice:
            self._violate(f'{len(twice)} actions were applied twice: {twice[:3]}')
        people = len({d.participant for d in shown})
        self._outcome.remarks[f'{len(shown)} demonstrations of {people} people are kept'] += 1
        guests = sum('/keyboard_teleop#' in who for who, _ in self.stranger.applied)
        seen = f'{len(self.stranger.applied)} actions were seen, {guests} of them by guests'
        self._outcome.remarks[seen] += 1


def on_disk(folder: Path) -> list[Demonstration]:
    """Return the demonstrations in the files of the lesson or of the learner that count."""
    found: dict[str, Demonstration] = {}
    for file in sorted(folder.glob('*.jsonl')):
        for line in file.read_bytes().decode(errors='replace').split('\n')[:-1]:
            read = entry_from_line if '"entry"' in line else Demonstration.from_json
            entry = None
            with suppress(ValueError):  # a line that was spoilt
                entry = read(line)
            if isinstance(entry, Demonstration):
                found[entry.uuid] = entry
    return [demo for demo in found.values() if not demo.withdrawn]


def usage(soak: Soak) -> pd.DataFrame:
    """Return memory (MB), threads and descriptors of each node."""
    found = {}
    for name in soak.names:
        with suppress(psutil.Error):  # it has ended just now
            process = psutil.Process(soak.pid(name))
            memory = round(process.memory_info().rss / 1e6)
            found[name] = memory, process.num_threads(), process.num_fds()
    return pd.DataFrame.from_dict(found, 'index', columns=['MB', 'threads', 'descriptors'])


@contextmanager
def lesson(folder: Path, outcome: Outcome, rng: random.Random) -> Iterator[Soak]:
    """Launch a lesson that has no end by itself."""
    setup = Setup(
        'taxi',
        folder / 'out',
        seed=rng.randrange(1000),
        taught=OPTIONS,
        teacher_error_rate=0.05,
        budget=25,
        step_period=0.005,
    )
    said: list[str] = []
    machine = Machine(folder)
    with (
        patch.dict(os.environ, machine.environment),
        session(setup, report=said.append, restarts=10**9) as running,
    ):
        soak = Soak(running, machine, rng, outcome)
        try:
            yield soak
        finally:
            soak.stranger.close()
    outcome.violations += [f'at the end: {problem}' for problem in running.stop_problems]
    outcome.violations += [line for line in said if line.startswith('another process runs')]
    for bag in running.bags:
        real = [
            stream
            for stream in check_bag(open_bag(bag)).streams
            if stream.publisher.startswith('/game#') and 'garbage' not in stream.publisher
        ]
        late = [s for s in real if s.late]
        outcome.violations += [f'{bag.name}: {s.late} on {s.topic} out of order' for s in late]
        if any(s.repeated and s.topic == '/game_state' for s in real):
            outcome.remarks[f'{bag.name}: repeated states, mutated copies of real ones'] += 1
    outcome.remarks[f'{len(running.bags)} bags can be read'] += 1


def run(
    folder: Path,
    seconds: float,
    seed: int,
    kinds: Sequence[str],
    most: int,
    messages: int = 200,
    calls: int = 20,
    settle: float = 1.0,
    verbose: bool = False,
) -> tuple[Outcome, str]:
    """
    Soak a launch.

    :param most: faults at most.
    :param messages: of garbage in one fault.
    :param calls: of garbage in one fault.
    :param settle: seconds before the first fault and after the last one, before memory is read.
    :return: what came of it, and a report.
    """
    outcome, rng, count = Outcome(), random.Random(seed), 0
    began = time.monotonic()
    with lesson(folder, outcome, rng) as soak:
        soak.teach(settle)
        soak.verbose = verbose
        before = usage(soak)
        while count < most and time.monotonic() - began < seconds and len(outcome.violations) < 10:
            soak.fault(kinds, messages, calls)
            count += 1
        soak.serve(1.0)
        soak.finish()
        soak.stranger.close()  # readers keep some of what it sent for as long as it is there
        soak.watch(settle)
        nodes = before.join(usage(soak).add_suffix(' after'))
    faults = pd.DataFrame(outcome.recoveries, columns=['fault', 's']).groupby('fault')['s']
    summary = (
        f'seed {seed}: {count} faults, {outcome.messages} bad messages and '
        f'{outcome.calls} bad calls in {time.monotonic() - began:.0f} s'
    )
    remarks = (f'{count} x {text}' for text, count in outcome.remarks.most_common())
    violations = (f'VIOLATION: {text}' for text in outcome.violations)
    table = faults.agg(['count', 'median', 'max']).round(2).to_string()
    return outcome, '\n'.join([summary, table, nodes.to_string(), *remarks, *violations])


KINDS = ('kill', 'kill', 'term', 'stop', 'terminal', 'clock', 'disk', 'files', 'settings')
GARBAGE = ('messages', 'messages', 'calls')


def main() -> int:
    """Run a soak, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=600.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--faults', type=int, default=10**9, help='at most')
    kinds = [*KINDS, *GARBAGE]
    parser.add_argument('--kinds', nargs='+', choices=sorted({*kinds}), default=kinds)
    parser.add_argument('--out', type=Path, help='keep logs, demonstrations and bags there')
    given = parser.parse_args()
    prepare_discovery()
    with tempfile.TemporaryDirectory() as folder, free_domain_id() as number:
        os.environ['ROS_DOMAIN_ID'] = str(number)
        place = given.out or Path(folder)
        outcome, report = run(
            *(place, given.seconds, given.seed, given.kinds, given.faults),
            settle=SETTLE,
            verbose=True,
        )
    print(report)
    return 1 if outcome.violations else 0


if __name__ == '__main__':
    sys.exit(main())
