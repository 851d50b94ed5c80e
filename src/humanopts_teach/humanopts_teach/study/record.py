"""
Records of participants: one file of events each.

An event is a line of JSON. It is written to disk (fsync) before the study continues, and also
published, so that the bag of the condition contains it. The only personal data stored are the
participant code and the texts that the person types.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import fcntl
import os
from pathlib import Path
import re
import time
from typing import Any

from humanopts_learner.append_only_log import AppendOnlyLog, read_lines
from humanopts_teach.lesson.store import CODE, CODE_RULE, similar_code
from humanopts_teach.study.events import (
    Event,
    event_of,
    EventKind,
    FAILED,
    FINISHED,
    last_attempts,
    REFUSED,
    TimeIn,
    times_in,
)
from humanopts_teach.study.plan import Part, StudyPlan
from humanopts_teach.study.protocol import difference, digest_of, FILE, Protocol, SHOWN_DIGEST

TOPIC = 'study_events'  # StudyEvent messages, each an event as JSON
MAX_BYTES = 64 * 2**20  # maximum size of a record
MAX_NUMBER = 999_999  # maximum participant number
_NAME = re.compile(rf'([0-9]{{3,6}})-({CODE.pattern})\.jsonl')  # file name of a record


class StudyError(ValueError):
    """A participant cannot take part; the message gives the reason."""


class SimilarCodeError(StudyError):
    """A code differs from a known one only in case, so it is probably a typo."""

    def __init__(self, code: str, known: str) -> None:
        super().__init__(
            f'{code!r} differs only in case from {known!r}, who has taken part: give {known!r} '
            'to go on, or another code'
        )


class ChangedPlanError(StudyError):
    """
    The plan has changed since it was stored.

    :ivar diff: lines of the unified diff.
    """

    def __init__(self, diff: Sequence[str]) -> None:
        self.diff = diff
        super().__init__(
            'the plan is not the one with which the study began: put that back, or accept the '
            'change with --accept-changes'
        )


@dataclass
class Record:
    """The events of one participant in order, without invalid ones."""

    path: Path
    code: str = ''  # from the file name, as is the number
    number: int = 0  # in order of arrival, from 0
    events: list[Event] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)  # descriptions of omitted lines

    def read(self) -> 'Record':
        """
        Return the record as currently stored on disk, without modifying the file.

        :raises OSError: the file is not regular, is too large, or cannot be read.
        """
        events, problems = read_lines(self.path, event_of, MAX_BYTES)
        return replace(self, events=events, problems=problems)

    def of(self, kind: EventKind) -> list[Event]:
        """Return the events of one kind."""
        return [event for event in self.events if event.event == kind]

    @property
    def began(self) -> Event | None:
        """The participant's 'began' event; None: missing or damaged."""
        return next(iter(self.of('began')), None)

    @property
    def done(self) -> set[str]:
        """The keys of the completed parts."""
        return {e.part for e in last_attempts(self.events) if e.event == 'part ended'}

    @property
    def refused(self) -> bool:
        """Whether the participant declined to take part."""
        return any(event.why == REFUSED for event in self.of('part ended'))

    @property
    def excluded(self) -> bool:
        """Whether the participant has failed too many attention checks."""
        return any(event.why == FAILED for event in self.of('part ended'))

    @property
    def place(self) -> int:
        """The participant's place; without a valid beginning, the one by number."""
        return self.number if self.began is None else self.began.place

    @property
    def over(self) -> bool:
        """Whether the participant has completed the study."""
        return bool(self.of('ended'))

    @property
    def minutes(self) -> float:
        """The time in minutes from the first to the last event, including breaks."""
        times = [event.time for event in self.events] or [0.0]
        return (max(times) - min(times)) / 60

    def seconds_in(self, part: str) -> float:
        """Return the time in s that the participant has spent on a part, over all sittings."""
        return times_in(self.events).get(part, TimeIn()).seconds

    def answers_in(self, part: str) -> dict[str, Any]:
        """Return the answers of the last attempt at a part, by question; None: skipped."""
        events = last_attempts(self.events)
        return {e.item: e.value for e in events if e.event == 'answer' and e.part == part}

    def remaining(self, parts: Iterable[Part]) -> list[Part]:
        """Return the parts that the participant has not completed."""
        done = self.done
        return [part for part in parts if part.key not in done]


class OpenRecord(Record):
    """A record opened for appending events."""

    def __init__(
        self,
        path: Path,
        publish: Callable[[str], object] = lambda line: None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """
        Open the file, which need not exist.

        :param publish: callback for each new line.
        :param clock: function that returns the time in s since 1970; None: a monotonic clock, so
            that changes of the system time do not affect durations within a sitting.
        :raises OSError: the file cannot be read.
        """
        ahead = time.time() - time.monotonic()
        self._clock = clock or (lambda: ahead + time.monotonic())
        self._log, self._publish = AppendOnlyLog(path), publish
        super().__init__(path, events=self._log.read(event_of), problems=self._log.problems)

    def check_attention(self, part: Part) -> str:
        """
        Record whether the attention checks of a part were passed.

        :return: why the part ends: the participant has finished it, or has failed too many checks.
        :raises OSError: the event could not be written.
        """
        checks = [] if part.questions is None else part.questions.items
        for check in checks:
            if check.expect is not None:
                passed = check.passes(self.answers_in(part.key).get(check.name))
                self.note('attention', part, item=check.name, passed=passed)
        failed = [e for e in last_attempts(self.events) if e.event == 'attention' and not e.passed]
        too_many = part.most_failed is not None and len(failed) > part.most_failed
        return FAILED if too_many else FINISHED

    def note(self, kind: EventKind, part: Part | None = None, /, **values: Any) -> None:
        """
        Append an event.

        :param part: part of the event; None: none.
        :param values: other fields of the event, except the time.
        :raises OSError: the event could not be written.
        """
        if part is not None:
            values |= {'part': part.key, 'condition': part.condition}
            if kind in ('part began', 'part ended'):
                values['kind'] = part.kind
        event = Event(event=kind, time=round(self._clock(), 3), **values)
        line = event.model_dump_json(exclude_unset=True)
        self._log.append(line)
        self.events.append(event)
        self._publish(line)


class StudyFolder:
    """The folder of a study: participants' records, and one subfolder of bags for each."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def records(self) -> tuple[list[Record], list[str]]:
        """
        Return the records of all participants in order of arrival, without copies.

        :return: records, and descriptions of what was omitted: files that are not a participant's
            record, and lines that are not events.
        """
        found: dict[str, Record] = {}
        named, problems = self._named()
        for each in named:
            try:
                record = each.read()
            except OSError as error:
                problems.append(f'{each.path} is left out: {error.strerror}')
                continue
            problems += record.problems
            if why := _fault(record, found.values()):
                problems.append(f'{each.path} is left out: {why}')
            else:
                found[each.code] = record
        return list(found.values()), problems

    def codes(self) -> list[str]:
        """Return the codes of all participants."""
        return [each.code for each in self.records()[0]]

    def enter(self, plan: StudyPlan, code: str, *, simulated: bool = False) -> Record:
        """
        Return the record of a new participant, or of one who continues the study.

        :param simulated: whether the participant is a simulated teacher.
        :raises SimilarCodeError: a known code differs only in case.
        :raises ChangedPlanError: the plan differs from the stored one.
        :raises StudyError: the code is invalid, its participant has finished or follows another
            plan, or the plan is full.
        :raises OSError: the folder cannot be written.
        """
        if not CODE.fullmatch(code):
            raise StudyError(f'{code!r} is not a code: {CODE_RULE}')
        self.path.mkdir(parents=True, exist_ok=True)
        with self._locked():
            self.check(plan)
            records, problems = self.records()
            record = next((each for each in records if each.code == code), None)
            if record is None:
                record = self._new(plan, code, [each.code for each in records], problems)
            if record.over:
                raise StudyError(f'{code!r} has ended this study already; give another code')
            if record.began is not None:
                self._check_continues(plan, record, record.began, simulated=simulated)
                return record
            Protocol(self.path).keep(plan)
            OpenRecord(record.path).note(
                'began',
                participant=code,
                number=record.number,
                place=record.number,
                study=plan.study,
                order=tuple(condition.name for condition in plan.order_of(record.number)),
                simulated=simulated,
                protocol=digest_of(plan),
            )
            return record

    def check(self, plan: StudyPlan) -> None:
        """
        Compare a plan with the stored one.

        :raises ChangedPlanError: the plan has changed.
        :raises StudyError: the stored protocol is damaged.
        :raises OSError: the protocol cannot be read.
        """
        protocol = self._whole_protocol()
        if missing := self.missing_plan(protocol):
            raise StudyError(f'{missing}; put the file back from a copy')
        if protocol.plan is not None and (changes := difference(protocol.plan, plan)):
            raise ChangedPlanError(changes)

    def accept(self, plan: StudyPlan) -> None:
        """
        Store a changed plan for new participants.

        :raises StudyError: the stored protocol is damaged.
        :raises OSError: the folder cannot be read or written.
        """
        with self._locked():
            self._whole_protocol().keep(plan)

    def plan_of(self, plan: StudyPlan, record: Record) -> StudyPlan:
        """
        Return the plan with which a participant began.

        :param plan: current plan, used for participants without a stored version.
        :raises OSError: the record or the protocol cannot be read.
        """
        began = record.read().began
        return (Protocol(self.path).plan_of(began.protocol) if began else None) or plan

    def missing_plan(self, protocol: Protocol) -> str:
        """Return a description of a missing plan that a record refers to; empty: none."""
        kept = {'', *(version.digest for version in protocol.versions)}
        for record in self.records()[0]:
            digest = record.began.protocol if record.began is not None else ''
            if digest not in kept:
                return (
                    f'{protocol.path} does not hold the plan {digest[:SHOWN_DIGEST]}, '
                    f'which {record.code!r} follows'
                )
        return ''

    def _whole_protocol(self) -> Protocol:
        """Return the protocol; raise if a line is damaged: a participant may depend on it."""
        protocol = Protocol(self.path)
        if protocol.problems:
            raise StudyError(f'{protocol.problems[0]}; put the file back from a copy')
        return protocol

    def _check_continues(
        self, plan: StudyPlan, record: Record, began: Event, *, simulated: bool
    ) -> None:
        followed = self.plan_of(plan, record).order_of(record.place)
        if list(began.order) != [condition.name for condition in followed]:
            raise StudyError(
                f'{record.code!r} began with another plan, whose conditions were '
                f'{", ".join(began.order)}; put that plan back'
            )
        if began.simulated != simulated:
            who = 'a simulated participant' if began.simulated else 'a person'
            raise StudyError(
                f'{record.code!r} is {who} of this study: give another code, or another folder '
                'with --study'
            )

    def _new(
        self, plan: StudyPlan, code: str, known: Sequence[str], problems: Iterable[str]
    ) -> Record:
        """Return the record of a new participant; an existing empty file keeps its number."""
        if similar := similar_code(code, known):
            raise SimilarCodeError(code, similar)
        if plan.participants and len(known) >= plan.participants:
            raise StudyError(
                f'all {plan.participants} participants of the plan have begun; {code!r} is new'
            )
        named, _ = self._named()
        number = max((each.number for each in named), default=-1) + 1
        for each in named:
            if each.code == code:
                if each.path.is_file() and not each.path.stat().st_size:
                    return each
                # Otherwise the participant would get a second record.
                why = next(text for text in problems if text.startswith(f'{each.path} '))
                raise StudyError(
                    f'{code!r} has a record that cannot be used: {why}; repair it, or move it away'
                )
        if number > MAX_NUMBER:
            raise StudyError(f'{named[-1].path} has the last number; give it a smaller one')
        return Record(self.path / _file_name(number, code), code, number)

    def _named(self) -> tuple[list[Record], list[str]]:
        """Return the files with record names, by number, and descriptions of other files."""
        found, problems = [], []
        for path in sorted(self.path.glob('*.jsonl')) if self.path.is_dir() else []:
            match = _NAME.fullmatch(path.name)
            if match is not None and _file_name(int(match[1]), match[2]) == path.name:
                found.append(Record(path, match[2], int(match[1])))
            elif path.name != FILE:
                problems.append(
                    f'{path} is left out: its name is not that of a record, such as '
                    f'{_file_name(0, "p1")}; it may be a copy that another program made'
                )
        return sorted(found, key=lambda each: (each.number, each.code)), problems

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Prevent other processes from entering a participant at the same time."""
        how = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        lock = os.open(self.path / '.lock', how, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)


def _file_name(number: int, code: str) -> str:
    return f'{number:03d}-{code}.jsonl'


def _fault(record: Record, others: Iterable[Record]) -> str:
    """
    Return why a file is not a participant's record; empty: it is valid.

    :param others: records of preceding files.
    """
    began = record.began
    if not record.events:
        return 'it holds no event'
    if began and (began.number, began.participant) != (record.number, record.code):
        name = _file_name(began.number, began.participant)
        return f'it is the record of {began.participant!r}, whose file is {name}'
    for other in others:
        if other.code == record.code:
            return f'{other.path.name} is a record of {record.code!r} too'
        if began is None and other.number == record.number:
            return f'it seems to be a copy of {other.path.name}'
    return ''
