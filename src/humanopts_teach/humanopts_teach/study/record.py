"""
What participants did: one file of events each.

An event is a line of JSON. It is on disk (fsync) before the study goes on, and is published too,
so that the bag of a condition holds it. Nothing that identifies a person is kept but the code that
the person was given, and what the person types.
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
    last_attempts,
    REFUSED,
    TimeIn,
    times_in,
)
from humanopts_teach.study.plan import Part, StudyPlan
from humanopts_teach.study.protocol import difference, digest_of, FILE, Protocol, SHOWN_DIGEST

TOPIC = 'study_events'  # StudyEvent, each an event as JSON
MAX_BYTES = 64 * 2**20  # of a record
MAX_NUMBER = 999_999  # of a participant
_NAME = re.compile(rf'([0-9]{{3,6}})-({CODE.pattern})\.jsonl')  # of a record


class StudyError(ValueError):
    """A participant cannot take part; the text says why."""


class SimilarCodeError(StudyError):
    """A code differs from a known one in case only: it is hardly another person's."""

    def __init__(self, code: str, known: str) -> None:
        super().__init__(
            f'{code!r} differs only in case from {known!r}, who has taken part: give {known!r} '
            'to go on, or another code'
        )


class ChangedPlanError(StudyError):
    """
    The plan has been changed since it was kept.

    :ivar diff: the lines that differ.
    """

    def __init__(self, diff: Sequence[str]) -> None:
        self.diff = diff
        super().__init__(
            'the plan is not the one with which the study began: put that back, or accept the '
            'change with --accept-changes'
        )


@dataclass
class Record:
    """The events of one participant, from the first; those that did not fit are left out."""

    path: Path
    code: str = ''  # by the name of the file, and the number too
    number: int = 0  # in the order of arrival, from 0
    events: list[Event] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)  # what was left out, in words

    def read(self) -> 'Record':
        """
        Return the record as it is on disk now, and change nothing in it.

        :raises OSError: it is not a regular file, is too large, or cannot be read.
        """
        events, problems = read_lines(self.path, event_of, MAX_BYTES)
        return replace(self, events=events, problems=problems)

    def of(self, kind: EventKind) -> list[Event]:
        """Return the events of one kind."""
        return [event for event in self.events if event.event == kind]

    @property
    def began(self) -> Event | None:
        """How the participant began; None: the line is damaged."""
        return next(iter(self.of('began')), None)

    @property
    def done(self) -> set[str]:
        """Keys of the parts that are over."""
        return {e.part for e in last_attempts(self.events) if e.event == 'part ended'}

    @property
    def refused(self) -> bool:
        """Whether the participant did not agree to take part."""
        return any(event.why == REFUSED for event in self.of('part ended'))

    @property
    def over(self) -> bool:
        """Whether the participant has ended the study."""
        return bool(self.of('ended'))

    @property
    def minutes(self) -> float:
        """From the first event to the last, pauses included."""
        times = [event.time for event in self.events] or [0.0]
        return (max(times) - min(times)) / 60

    def seconds_in(self, part: str) -> float:
        """Return how long the participant was at a part so far, over all sittings."""
        return times_in(self.events).get(part, TimeIn()).seconds

    def left_of(self, parts: Iterable[Part]) -> list[Part]:
        """Return what the participant has still to do."""
        done = self.done
        return [part for part in parts if part.key not in done]


class OpenRecord(Record):
    """A record to which events are added."""

    def __init__(
        self,
        path: Path,
        publish: Callable[[str], object] = lambda line: None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """
        Open the file, which need not exist.

        :param publish: called with each new line.
        :param clock: s since 1970; None: one that goes on evenly when the time of day is set, so
            that the time between two events of one sitting is the time that passed.
        :raises OSError: it cannot be read.
        """
        ahead = time.time() - time.monotonic()
        self._clock = clock or (lambda: ahead + time.monotonic())
        self._log, self._publish = AppendOnlyLog(path), publish
        super().__init__(path, events=self._log.read(event_of), problems=self._log.problems)

    def note(self, kind: EventKind, part: Part | None = None, /, **values: Any) -> None:
        """
        Add an event.

        :param part: that it concerns; None: none.
        :param values: its other fields, but the time.
        :raises OSError: it could not be written.
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
    """The folder of a study: records of its participants, and a folder for each with bags."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def records(self) -> tuple[list[Record], list[str]]:
        """
        Return what all participants did, in the order of arrival, each once: copies are left out.

        :return: also what is left out, in words: files that are not the record of a participant,
            and lines that are not events.
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
        Return the record of a participant: a new one, or one who has not finished and continues.

        :param simulated: a simulated teacher takes part.
        :raises SimilarCodeError: a known code differs only in case.
        :raises ChangedPlanError: the plan is not the one that is kept.
        :raises StudyError: the code cannot be used, its participant has finished or follows
            another plan, or the plan has no room.
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
                study=plan.study,
                order=tuple(condition.name for condition in plan.order_of(record.number)),
                simulated=simulated,
                protocol=digest_of(plan),
            )
            return record

    def check(self, plan: StudyPlan) -> None:
        """
        Compare a plan with the one that is kept.

        :raises ChangedPlanError: it has been changed.
        :raises StudyError: what is kept is damaged.
        :raises OSError: it cannot be read.
        """
        protocol = self._whole_protocol()
        if missing := self.missing_plan(protocol):
            raise StudyError(f'{missing}; put the file back from a copy')
        if protocol.plan is not None and (changes := difference(protocol.plan, plan)):
            raise ChangedPlanError(changes)

    def accept(self, plan: StudyPlan) -> None:
        """
        Keep a changed plan, for participants who begin from now on.

        :raises StudyError: what is kept is damaged.
        :raises OSError: the folder cannot be read or written.
        """
        with self._locked():
            self._whole_protocol().keep(plan)

    def plan_of(self, plan: StudyPlan, record: Record) -> StudyPlan:
        """
        Return the plan that a participant follows: the one with which the participant began.

        :param plan: the current one, for participants without a stored version.
        :raises OSError: the record, or what is kept, cannot be read.
        """
        began = record.read().began
        return (Protocol(self.path).plan_of(began.protocol) if began else None) or plan

    def missing_plan(self, protocol: Protocol) -> str:
        """Return which plan that a record names is not kept, in words; empty: all are."""
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
        """Return what is kept, unless it has damaged lines: a participant may follow one."""
        protocol = Protocol(self.path)
        if protocol.problems:
            raise StudyError(f'{protocol.problems[0]}; put the file back from a copy')
        return protocol

    def _check_continues(
        self, plan: StudyPlan, record: Record, began: Event, *, simulated: bool
    ) -> None:
        followed = self.plan_of(plan, record).order_of(record.number)
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
        """Return the record of a new participant; one whose file is empty keeps its number."""
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
        """Return the files named as records, by number, and which others there are."""
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
        """Keep other terminals from entering a participant at the same time."""
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
    Return why a file is not a participant's record; empty: it is.

    :param others: records whose files come before it.
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
