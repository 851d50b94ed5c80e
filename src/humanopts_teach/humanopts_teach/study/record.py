"""
Records of participants: one file of events each.

An event is a line of JSON. It is written to disk (fsync) before the study continues. It is also
published, and thus recorded in the bag of the condition. The only personal data stored are the
participant code and the texts that the person types.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import fcntl
from itertools import count
import os
from pathlib import Path
import re
from secrets import choice
import shutil
import time
from typing import Any

from humanopts_learner.append_only_log import AppendOnlyLog, read_lines
from humanopts_ros.limits import caseless, shown
from humanopts_teach.language import N_
from humanopts_teach.lesson.store import CODE, similar_code
from humanopts_teach.study.events import (
    Event,
    event_of,
    EventKind,
    FAILED,
    FINISHED,
    last_attempts,
    TimeIn,
    times_in,
)
from humanopts_teach.study.log import FILE as LOG
from humanopts_teach.study.log import LogEvent, StudyLog
from humanopts_teach.study.plan import Part, PartKind, StudyPlan
from humanopts_teach.study.protocol import (
    difference,
    digest_of,
    FILE,
    Protocol,
    SHOWN_DIGEST,
    SOFTWARE,
)

TOPIC = 'study_events'  # StudyEvent messages, each an event as JSON
MAX_BYTES = 64 * 2**20  # size of a record
MAX_NUMBER = 999_999  # participant number
_LOCK = '.lock'
PILOT = 'pilot'  # folder of the pilot of a study
_RESERVED = {PILOT, 'tables', 'report'}  # folders of a study
_CODE_LETTERS, _CODE_LENGTH = '23456789abcdefghjkmnpqrstuvwxyz', 8
_NAME = re.compile(rf'([0-9]{{3,6}})-({CODE.pattern})\.jsonl')  # file name of a record


class StudyError(ValueError):
    """A participant cannot take part; the message gives the reason."""


class EndedError(StudyError):
    """
    A participant has already completed the study.

    :ivar record: record of the participant.
    """

    def __init__(self, record: 'Record') -> None:
        self.record = record
        super().__init__(N_(f'{record.code!r} has already ended this study; use another code'))


class FullError(StudyError):
    """All places of the study are taken."""

    def __init__(self, places: int) -> None:
        super().__init__(N_(f'All {places} places of the study are taken; nothing was saved.'))


class SimilarCodeError(StudyError):
    """A code differs from a known one only in case, so it is probably a typo."""

    def __init__(self, code: str, known: str) -> None:
        super().__init__(
            f'{code!r} differs only in case from {known!r}, who has taken part: use '
            f'{known!r} to continue, or another code'
        )


class ChangedPlanError(StudyError):
    """
    The plan has changed since it was stored.

    :ivar diff: lines of the unified diff.
    """

    def __init__(self, diff: Sequence[str]) -> None:
        self.diff = diff
        super().__init__(
            'the plan is not the one with which the study began: restore that one, or accept the '
            'change with --accept-changes'
        )


@dataclass
class Record:
    """The events of one participant in order, without invalid lines."""

    path: Path
    code: str = ''  # code and number are from the file name
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
    def excluded(self) -> bool:
        """Whether the participant has failed too many attention checks."""
        return any(event.why == FAILED for event in self.of('part ended'))

    @property
    def place(self) -> int:
        """The participant's place; without a valid 'began' event, the participant's number."""
        return self.number if self.began is None else self.began.place

    @property
    def over(self) -> bool:
        """Whether the participant has completed the study."""
        return bool(self.of('ended'))

    def holds_place(self, hours: float, now: float) -> bool:
        """
        Return whether the participant's place is unavailable to others.

        Participants who have completed the study, or are under way, hold their places.

        :param hours: maximum absence before the place is released; 0: unlimited.
        :param now: current time, s since 1970.
        """
        if self.excluded:
            return False
        latest = max((event.time for event in self.events), default=now)
        return self.over or not hours or now - latest < 3600 * hours

    @property
    def minutes(self) -> float:
        """The time in minutes from the first to the last event, including breaks."""
        times = [event.time for event in self.events] or [0.0]
        return (max(times) - min(times)) / 60

    def seconds_in(self, part: str) -> float:
        """Return the time spent on a part in all sittings, s."""
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

        :return: reason why the part ends: ``FINISHED``, or ``FAILED`` with too many failed checks.
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

        :param part: part that the event belongs to; None: none.
        :param values: other fields of the event, except the time.
        :raises OSError: the event could not be written.
        """
        if part is not None:
            values |= {'part': part.key, 'condition': part.condition}
            if kind in ('part began', 'part ended'):
                values['kind'] = part.kind
        self.append(Event(event=kind, time=round(self._clock(), 3), **values))

    def append(self, *events: Event) -> None:
        """
        Append events, all of them or none.

        :raises OSError: the events could not be written.
        """
        lines = [event.model_dump_json(exclude_unset=True) for event in events]
        self._log.append(*lines)
        self.events.extend(events)
        for line in lines:
            self._publish(line)


class StudyFolder:
    """The folder of a study: participants' records, and one subfolder of bags for each."""

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        """
        Use a folder, which need not exist.

        :param clock: function that returns the time in s since 1970.
        """
        self.path, self._clock = path, clock
        self._parsed: dict[tuple[Path, int, int, int], Record] = {}  # by file, size and time
        self._counted: dict[str, LogEvent] = {}  # by code; not stored on disk

    def records(self) -> tuple[list[Record], list[str]]:
        """
        Return the records of all participants in order of arrival, without copies.

        :return: records, and descriptions of omissions: files that are not a participant's
            record, and lines that are not events.
        """
        found: dict[str, Record] = {}
        named, problems = self._named()
        parsed, self._parsed = self._parsed, {}  # reuse unchanged records, which can be long
        for each in named:
            try:
                file = each.path.lstat()
                key = each.path, file.st_ino, file.st_size, file.st_mtime_ns
                record = self._parsed[key] = parsed.get(key) or each.read()
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

    def new_code(self) -> str:
        """Return an unused code that cannot be guessed."""
        known = {caseless(code) for code in self.codes()}
        codes = (''.join(choice(_CODE_LETTERS) for _ in range(_CODE_LENGTH)) for _ in count())
        return next(code for code in codes if code not in known)

    def find(self, plan: StudyPlan, code: str, *, simulated: bool = False) -> Record | None:
        """
        Return the record of a returning participant; None: new participant, who may begin.

        Nothing is written.

        :param simulated: whether the participant is a simulated teacher.
        :raises SimilarCodeError: a known code differs only in case.
        :raises ChangedPlanError: the plan differs from the stored one.
        :raises EndedError: the participant has completed the study.
        :raises FullError: all places are taken.
        :raises StudyError: the code or its record is invalid, or belongs to another study or plan.
        :raises OSError: the folder cannot be read.
        """
        if not CODE.fullmatch(code):
            given = shown(code)
            raise StudyError(
                N_(f'{given!r} is not a valid code: use at most 60 letters, digits, - and _')
            )
        if caseless(code) in _RESERVED:
            raise StudyError(N_(f'{code!r} cannot be used as a code; use another one'))
        self.check(plan)
        records, problems = self.records()
        record = next((each for each in records if each.code == code), None)
        if record is not None and record.over:
            raise EndedError(record)
        if record is not None and record.began is not None:
            self._check_continues(plan, record, record.began, simulated=simulated)
            return record
        if record is None:
            if similar := similar_code(code, [each.code for each in records]):
                raise SimilarCodeError(code, similar)
            for each in self._named()[0]:
                if each.code == code and not _is_empty(each.path):
                    # Otherwise, the participant would get a second record.
                    why = next(text for text in problems if text.startswith(f'{each.path} '))
                    raise StudyError(
                        f'{code!r} has a record that cannot be used: {why}; repair it, or move '
                        'it away'
                    )
        self._free_place(plan, records)
        return None

    def enter(
        self,
        plan: StudyPlan,
        code: str,
        *,
        simulated: bool = False,
        consent_seconds: float | None = None,
        **client: Any,
    ) -> Record:
        """
        Return the record of a new participant, or of one who continues the study.

        A new participant gets the lowest free place. A failed write leaves nothing on disk.

        :param consent_seconds: time that the person took to consent, s; None: not requested.
        :param client: fields of the 'client' event: browser, width, height, language, columns.
        :raises StudyError: as in ``find``.
        :raises OSError: the folder cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with self._locked():
            found = self.find(plan, code, simulated=simulated)
            now = round(self._clock(), 3)
            came = [Event(event='client', time=now, **client)] if client else []
            if found is not None:
                if consent_seconds is not None:
                    pages = found.remaining(self.plan_of(plan, found).consent_parts)
                    came = [*self._agreed(pages, consent_seconds), *came]
                if came:
                    OpenRecord(found.path).append(*came)
                return found.read()
            named = self._named()[0]
            place = self._free_place(plan, self.records()[0])
            record = next((each for each in named if each.code == code), None)
            if record is None:
                log = StudyLog(self.path).entries
                deleted = (entry.number for entry in log if entry.number is not None)
                number = max((*(each.number for each in named), *deleted), default=-1) + 1
                if number > MAX_NUMBER:
                    raise StudyError(
                        f'{named[-1].path} has the last number; give it a smaller one'
                    )
                record = Record(self.path / _file_name(number, code), code, number)
            began = Event(
                event='began',
                time=now,
                participant=code,
                number=record.number,
                place=place,
                study=plan.study,
                order=tuple(condition.name for condition in plan.order_of(place)),
                simulated=simulated,
                software=SOFTWARE,
                protocol=digest_of(plan),
            )
            pages = [] if consent_seconds is None else plan.consent_parts
            consent = self._agreed(pages, consent_seconds or 0.0)
            Protocol(self.path).keep(plan)
            OpenRecord(record.path).append(began, *consent, *came)
            return record.read()

    def _agreed(self, pages: Iterable[Part], seconds: float) -> list[Event]:
        """Return the events of the consent pages; all of the time is assigned to the last page."""
        events, now = list[Event](), round(self._clock(), 3)
        for page in pages:
            start = now - seconds
            end = now if page.kind is PartKind.CONSENT else start
            fields: dict[str, Any] = {'part': page.key, 'condition': '', 'kind': page.kind}
            events += [
                Event(event='part began', time=start, **fields),
                Event(event='part ended', time=end, why=FINISHED, **fields),
            ]
        return events

    @contextmanager
    def hold(self, record: Record) -> Iterator[None]:
        """
        Mark a participant as taking part, and prevent a second visit at the same time.

        :raises StudyError: the participant is already taking part elsewhere.
        """
        with self._locked():
            handle = _take(record.path)
        if handle is None:
            raise StudyError(
                N_(f'{record.code!r} is taking part in another window or terminal at the moment.')
            )
        try:
            yield
        finally:
            os.close(handle)

    def running(self) -> set[str]:
        """Return the codes of the participants who are taking part now."""
        if not os.access(self.path / _LOCK, os.W_OK):  # missing, or read-only as in an archive
            return set()
        with self._locked():
            handles = {each.code: _take(each.path) for each in self.records()[0]}
            for handle in handles.values():
                if handle is not None:
                    os.close(handle)
        return {code for code, handle in handles.items() if handle is None}

    def count(self, code: str, event: LogEvent | None) -> None:
        """
        Count a person without a record once, by the latest visit; do not store the code.

        Earlier visits are known only to this object, so a person who returns after a restart is
        counted again.

        :param event: result of the visit; None: the person takes part.
        :raises OSError: the log cannot be written.
        """
        before = self._counted.get(code)
        if before == event:
            return
        self.path.mkdir(parents=True, exist_ok=True)
        with self._locked():
            log = StudyLog(self.path)
            if before is not None:
                log.note(before, people=-1)
                del self._counted[code]
            if event is not None:
                log.note(event)
                self._counted[code] = event

    def withdraw(self, code: str) -> int:
        """
        Delete all data of a participant, and log the deletion without the code.

        :return: number of deleted files.
        :raises StudyError: the code is unknown, or the participant is taking part.
        :raises OSError: a file cannot be deleted; the deletion can be repeated.
        """
        files = self.files_of(code)
        with self._locked():
            record = next(each for each in self._named()[0] if each.code == code)
            handle = _take(record.path)
            if handle is None:
                raise StudyError(
                    f'{code!r} is taking part at the moment; wait until that has ended'
                )
            os.close(handle)
            place = record.read().place
            if (folder := self.path / code).exists():
                shutil.rmtree(folder)
            values = {'number': record.number, 'place': place, 'files': len(files)}
            StudyLog(self.path).note('withdrawn', **values)
            for path in files:
                path.unlink(missing_ok=True)
        return len(files)

    def files_of(self, code: str) -> list[Path]:
        """
        Return all files of a participant: records and their copies, and bags.

        :raises StudyError: the code is unknown.
        """
        named = [each for each in self._named()[0] if each.code == code]
        if not named:
            raise StudyError(f'{shown(code)!r} has no record in {self.path}')
        records = [path for each in named for path in self.path.glob(f'{each.path.name}*')]
        return [*(path for path in (self.path / code).rglob('*') if path.is_file()), *records]

    def _free_place(self, plan: StudyPlan, records: Iterable[Record]) -> int:
        """Return the lowest free place."""
        now, hours = self._clock(), plan.return_within
        held = {each.place for each in records if each.holds_place(hours, now)}
        place = next(place for place in count() if place not in held)
        if plan.participants and place >= plan.participants:
            raise FullError(plan.participants)
        return place

    def check(self, plan: StudyPlan) -> None:
        """
        Compare a plan with the stored one.

        :raises ChangedPlanError: the plan has changed.
        :raises StudyError: the stored protocol is damaged.
        :raises OSError: the protocol cannot be read.
        """
        protocol = self._whole_protocol()
        if protocol.plan is not None and protocol.plan.study != plan.study:
            raise StudyError(
                f'{self.path} is the folder of the study {protocol.plan.study!r}, not of '
                f'{plan.study!r}; --study DIR names another'
            )
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
        """Return the protocol; raise if a line is damaged, since a record may refer to it."""
        protocol = Protocol(self.path)
        if protocol.problems:
            raise StudyError(f'{protocol.problems[0]}; put the file back from a copy')
        return protocol

    def _check_continues(
        self, plan: StudyPlan, record: Record, began: Event, *, simulated: bool
    ) -> None:
        if began.study != plan.study:
            raise StudyError(
                f'{record.code!r} is taking part in the study {began.study!r}, not in '
                f'{plan.study!r}'
            )
        followed = self.plan_of(plan, record).order_of(record.place)
        if list(began.order) != [condition.name for condition in followed]:
            raise StudyError(
                f'{record.code!r} began with another plan, whose conditions were '
                f'{", ".join(began.order)}; put that plan back'
            )
        if began.simulated != simulated:
            who = 'a simulated participant' if began.simulated else 'a person'
            raise StudyError(
                f'{record.code!r} is {who} in this study: use another code, or another '
                'folder with --study'
            )

    def _named(self) -> tuple[list[Record], list[str]]:
        """Return the files with valid record names by number, and descriptions of other files."""
        found, problems = [], []
        for path in sorted(self.path.glob('*.jsonl')) if self.path.is_dir() else []:
            match = _NAME.fullmatch(path.name)
            if match is not None and _file_name(int(match[1]), match[2]) == path.name:
                found.append(Record(path, match[2], int(match[1])))
            elif path.name not in (FILE, LOG):
                problems.append(
                    f'{path} is left out: its name is not that of a record, such as '
                    f'{_file_name(0, "p1")}; it may be a copy that another program made'
                )
        return sorted(found, key=lambda each: (each.number, each.code)), problems

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Prevent other processes from changing the folder at the same time."""
        how = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        lock = os.open(self.path / _LOCK, how, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)


def _is_empty(path: Path) -> bool:
    return not path.exists() or (path.is_file() and not path.stat().st_size)


def _take(record: Path) -> int | None:
    """Lock a record; return the descriptor to close, or None if it is already locked."""
    handle = os.open(record, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def _file_name(number: int, code: str) -> str:
    return f'{number:03d}-{code}.jsonl'


def _fault(record: Record, others: Iterable[Record]) -> str:
    """
    Return the reason why a file is not a valid record; empty: it is valid.

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
