"""What ``humanopts bag info`` prints: the facts about a bag as text and as JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, UTC
from typing import Any

from humanopts_teach.bags.sequence_numbers import Stream

NO_TEACHER = 'none: a person taught'  # shown for the simulated teacher's error rate


@dataclass(frozen=True)
class TopicRow:
    """One topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: it is not known

    @property
    def counted(self) -> bool:
        """Whether its messages carry sequence numbers, by which loss is counted."""
        return self.publishers is not None


@dataclass(frozen=True)
class OptionRow:
    """One option of one participant, from its demonstrations."""

    participant: str
    option: str
    sessions: tuple[str, ...]
    features: tuple[str, ...]
    demonstrations: int
    not_here: int
    withdrawn: int  # taken back; not counted in the other fields
    steps: int  # of all demonstrations
    seconds: float  # that the person took for all demonstrations
    criteria_met: bool  # by the last learning status


@dataclass(frozen=True)
class CriterionPoint:
    """A criterion after a demonstration, by the learning status."""

    seconds: float  # from the beginning of the bag
    demonstrations: int  # shown so far
    not_here: int  # "not here" answers so far
    value: float | None  # None: not yet measurable
    met: bool


@dataclass(frozen=True)
class CriterionRow:
    """The values of one criterion of one option over time."""

    participant: str
    option: str
    criterion: str  # return, initiation or termination
    threshold: float
    points: tuple[CriterionPoint, ...]

    @property
    def first_met(self) -> CriterionPoint | None:
        """Return the first point at which the criterion held."""
        return next((point for point in self.points if point.met), None)


@dataclass(frozen=True)
class AttachedRow:
    """A file that is attached to the bag."""

    name: str
    bytes: int
    media_type: str


@dataclass(frozen=True)
class BagInfo:
    """What a bag holds."""

    path: str
    damage: str  # what is wrong with the bag, a line each; empty: nothing
    start: int  # of the first message, ns since the epoch
    duration: int  # to the last message, ns
    files: int  # MCAP files
    bytes: int  # size of the MCAP files
    facts: Mapping[str, str]  # that the recorder was given
    attached: tuple[AttachedRow, ...]
    domains: tuple[str, ...]  # name and parameters
    open_sessions: tuple[tuple[str, str], ...]  # participant and code of each session
    topics: tuple[TopicRow, ...]
    options: tuple[OptionRow, ...]
    criteria: tuple[CriterionRow, ...]  # over time, as the learner published them
    option_runs: Mapping[str, int]  # by status
    plans: Mapping[str, int]
    policy_runs: Mapping[str, int]
    interruptions: int  # options that policies interrupted, since another was worth more
    execution_changes: int  # of policies while they ran
    episodes: int
    episodes_ended: int  # whose last state was recorded
    streams: tuple[Stream, ...]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.messages for topic in self.topics)

    @property
    def missing(self) -> int:
        """Number of messages that were sent and are not in the bag."""
        return sum(stream.missing for stream in self.streams)

    @property
    def participants(self) -> tuple[str, ...]:
        """Codes of the people who taught or sat down to, sorted."""
        taught = {option.participant for option in self.options}
        return tuple(sorted(taught | {participant for participant, _ in self.open_sessions}))

    @property
    def sessions(self) -> tuple[str, ...]:
        """Return the codes of all sessions, sorted."""
        taught = {code for option in self.options for code in option.sessions}
        return tuple(sorted(taught | {session for _, session in self.open_sessions}))

    def to_dict(self) -> dict[str, Any]:
        """Return the facts as JSON data."""
        facts = asdict(replace(self, streams=()))
        return {
            'sittings': facts.pop('open_sessions'),  # the key of version 0.1.0
            **facts,
            'topics': [
                {
                    'name': topic.name,
                    'type': topic.type,
                    'messages': topic.messages,
                    'counted': topic.counted,
                }
                for topic in self.topics
            ],
            'streams': [
                {
                    'topic': stream.topic,
                    'publisher': stream.publisher,
                    'first': stream.first,
                    'last': stream.last,
                    'received': stream.received,
                    'missing': stream.missing,
                    'duplicates': stream.duplicates,
                }
                for stream in self.streams
            ],
            'messages': self.messages,
            'missing': self.missing,
            'participants': list(self.participants),
            'sessions': list(self.sessions),
        }

    def to_text(self) -> str:
        """Return the facts as text for a person."""
        taught = ('participant', 'option', 'shown', 'not here', 'taken back')
        parts = [
            self._head(),
            table(
                ('recorded with', ''),
                [
                    (name.replace('_', ' '), NO_TEACHER if value == 'None' else value)
                    for name, value in sorted(self.facts.items())
                ],
            ),
            table(
                ('attached file', 'bytes', 'type'),
                [(row.name, row.bytes, row.media_type) for row in self.attached],
            ),
            table(
                (*taught, 'steps', 'seconds', 'criteria met'),
                [
                    (
                        *(row.participant, row.option),
                        *(row.demonstrations, row.not_here, row.withdrawn),
                        *(row.steps, f'{row.seconds:.0f}', 'yes' if row.criteria_met else 'no'),
                    )
                    for row in self.options
                ],
            ),
            self._criteria(),
            self._events(),
            table(
                ('topic', 'messages', 'type'),
                [(topic.name, topic.messages, topic.type) for topic in self.topics],
            ),
            self._loss(),
        ]
        return '\n\n'.join(part for part in parts if part)

    def _head(self) -> str:
        begun = datetime.fromtimestamp(self.start / 1e9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
        pairs = [
            ('bag', self.path),
            *(('DAMAGED', line) for line in self.damage.splitlines()),
            ('begun', begun if self.messages else 'nothing was recorded'),
            ('duration', f'{self.duration / 1e9:.1f} s'),
            ('messages', f'{self.messages} on {len(self.topics)} topics'),
            ('size', f'{self.bytes:,} bytes in {self.files} file{"s"[: self.files > 1]}'),
            ('domain', '; '.join(self.domains) or 'not recorded'),
            ('participants', ', '.join(self.participants) or 'none'),
            ('sessions', ', '.join(self.sessions) or 'none'),
        ]
        width = max(len(name) for name, _ in pairs)
        return '\n'.join(f'{name:{width}}  {value}' for name, value in pairs)

    def _criteria(self) -> str:
        """Return when each criterion held first, and its value then and at the end."""
        rows = []
        for row in self.criteria:
            first = ('never', '-', '-')
            if (met := row.first_met) is not None:
                shown = f'{met.demonstrations} shown, {met.not_here} not here'
                first = (shown, f'{met.seconds:.1f}', _measured(met))
            named = (row.participant, row.option, row.criterion, row.threshold)
            rows.append((*named, *first, _measured(row.points[-1])))
        head = ('participant', 'option', 'criterion', 'target')
        return table((*head, 'first held after', 'at second', 'value', 'at the end'), rows)

    def _events(self) -> str:
        kinds = [
            ('option runs', self.option_runs),
            ('plans', self.plans),
            ('policy runs', self.policy_runs),
        ]
        lines = [f'episodes: {self.episodes}, {self.episodes_ended} recorded to their end']
        for name, counts in kinds:
            if counts:
                each = ', '.join(f'{status} {count}' for status, count in sorted(counts.items()))
                lines.append(f'{name}: {each}')
        if self.policy_runs:
            lines.append(
                f'in policy runs: {self.interruptions} options stopped by the plan, '
                f'{self.execution_changes} changes of execution'
            )
        return '\n'.join(lines)

    def _loss(self) -> str:
        odd = [row for row in self.streams if row.missing or row.duplicates]
        if not odd:
            return f'missing: 0 messages (by the numbers in {len(self.streams)} streams)'
        return f'missing: {self.missing} messages\n' + table(
            ('topic', 'publisher', 'sent', 'missing', 'repeated'),
            [(row.topic, row.publisher, row.last, row.missing, row.duplicates) for row in odd],
        )


def _measured(point: CriterionPoint) -> str:
    """Return the value of a criterion."""
    return '-' if point.value is None else f'{point.value:.3g}'


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out rows in columns, numbers to the right; empty where there are no rows."""
    if not rows:
        return ''
    right = [isinstance(value, int | float) for value in rows[0]]
    return '\n'.join(aligned([head, *(list(map(str, row)) for row in rows)], right))


def aligned(rows: Sequence[Sequence[str]], right: Sequence[bool]) -> list[str]:
    """
    Return lines with the columns aligned.

    :param right: whether each column is aligned to the right.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        '  '.join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(row, widths, right, strict=True)
        ).rstrip()
        for row in rows
    ]
