"""The status of a graph: its nodes and its recording, as text and as JSON data."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from humanopts_ros.limits import one_line, shown
from humanopts_teach.text_table import table
from rich.filesize import decimal

NO_GRAPH = 2  # exit status: no nodes in this ROS_DOMAIN_ID and namespace
LITTLE_DISK = 10**9  # bytes; less space left on the recording's disk is a fault
_SILENT = 'does not answer'


@dataclass(frozen=True)
class NodeReport:
    """One node; its process is known if a launch on this machine started it."""

    name: str
    state: str = ''  # starting, ready, paused or stopping; empty: none was published
    answer: float | None = None  # response time, s; None: no response
    served: bool = True  # whether it always answers requests, unlike the conductor
    text: str = ''  # reason for a pause, a refusal or a failure
    restarts: int = 0
    stopped: bool = False  # its process is stopped (SIGSTOP)
    pid: int | None = None
    memory: int | None = None  # bytes
    threads: int | None = None

    @property
    def fault(self) -> str:
        """The fault, in words; empty: none."""
        if self.stopped:
            return f'is stopped; kill -CONT {self.pid} resumes it'
        if self.served and self.answer is None:
            return _SILENT
        if self.state == 'paused':
            return f'is paused: {self.text}'
        return '' if self.state == 'ready' else f'is {self.state or "silent"}'


@dataclass(frozen=True)
class RecorderReport:
    """The recording; fields as in RecorderStatus."""

    path: str
    messages: int
    bytes: int
    lag: float  # s
    missing: int
    complete: bool
    behind: bool
    stopped: bool
    text: str
    rate: float | None = None  # messages/s; None: unknown
    disk_left: int | None = None  # bytes; None: on another machine

    @property
    def fault(self) -> str:
        """The fault, in words; empty: none."""
        if self.stopped or self.behind:
            return self.text
        if self.missing:
            return f'{self.missing} messages are missing from the bag'
        if not self.complete:
            return 'the recorder still lacks some topics'
        little = self.disk_left is not None and self.disk_left < LITTLE_DISK
        return f'{decimal(self.disk_left or 0)} are left on the disk' if little else ''

    def to_text(self) -> str:
        """Return the recording as one line."""
        rate = '' if self.rate is None else f' ({self.rate:.0f}/s)'
        left = '' if self.disk_left is None else f', {decimal(self.disk_left)} left on the disk'
        return (
            f'{self.path}: {self.messages} messages{rate}, {decimal(self.bytes)}, '
            f'lag {self.lag:.3f} s, {self.missing} missing{left}'
        )


@dataclass(frozen=True)
class GraphReport:
    """The graph of one namespace."""

    domain_id: int
    namespace: str
    nodes: Sequence[NodeReport]
    recorder: RecorderReport | None = None  # None: nothing records
    game: str = ''  # name of its domain
    episode: int = 0
    step: int = 0
    steps_per_second: float | None = None  # None: no state was received
    holder: str = ''  # publisher_id of the node in control, or locked; empty: none
    games: Sequence[str] = ()  # publisher ids; there should be one

    @property
    def faults(self) -> list[str]:
        """All faults, in words."""
        found = [f'{node.name} {node.fault}' for node in self.nodes if node.fault]
        if self.recorder is not None and self.recorder.fault:
            found.append(self.recorder.fault)
        if len(self.games) > 1:
            found.append(f'{" and ".join(self.games)} each run a game here; stop all but one')
        return found

    @property
    def status(self) -> int:
        """Exit status: 0 without faults, 1 with faults, 2 without nodes."""
        if not self.nodes:
            return NO_GRAPH
        return 1 if self.faults else 0

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {**asdict(self), 'faults': self.faults}

    def to_text(self) -> str:
        """Return the report as plain text."""
        if not self.nodes:
            place = f'ROS_DOMAIN_ID {self.domain_id}, namespace {self.namespace}'
            return f'no node of humanopts is in {place}'
        heads = ('node', 'state', 'answers', 'restarts', 'process', 'memory', 'threads', 'says')
        rows = [dict(zip(heads, _row(node))) for node in self.nodes]
        lines = [*table(rows, heads).splitlines(), '']
        if self.steps_per_second is not None:
            lines.append(
                f'{self.game}: episode {self.episode}, step {self.step}, '
                f'{self.steps_per_second:.1f} steps/s; control: {self.holder or "nobody"}'
            )
        lines.append(
            'nothing is being recorded' if self.recorder is None else self.recorder.to_text()
        )
        lines += [f'fault: {fault}' for fault in self.faults] or ['all is well']
        return '\n'.join(map(one_line, lines))


def _row(node: NodeReport) -> tuple[str, ...]:
    answer = _SILENT if node.served else '-'
    return (
        node.name,
        'stopped' if node.stopped else node.state or '?',
        answer if node.answer is None else f'{1000.0 * node.answer:.0f} ms',
        str(node.restarts),
        '-' if node.pid is None else str(node.pid),
        '-' if node.memory is None else decimal(node.memory),
        '-' if node.threads is None else str(node.threads),
        shown(node.text, 200),
    )
