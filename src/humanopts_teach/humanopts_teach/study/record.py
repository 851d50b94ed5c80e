"""
What participants did: one file of events each.

An event is a line of JSON. It is on disk (fsync) before the study goes on, and is published too,
so that the bag of a condition holds it. Nothing that identifies a person is kept but the code that
the person was given, and what the person types.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
import fcntl
import math
import os
from pathlib import Path
import re
import time
from typing import Any, TypeVar

from humanopts_learner.append_only_log import AppendOnlyLog, read_in_place, read_lines
from humanopts_learner.summary import OptionSummary
from humanopts_teach.lesson.store import CODE, CODE_RULE, similar_code
from humanopts_teach.study.events import (
    Event,
    event_of,
    last_attempts,
    PartEnded,
    ParticipantBegan,
    ParticipantEnded,
    REFUSED,
    times_in,
)
from humanopts_teach.study.plan import Part, StudyPlan
from humanopts_teach.study.protocol import digest_of, FILE, Protocol, SHOWN_DIGEST

TOPIC = 'study_events'  # StudyEvent, each an event as JSON
MAX_BYTES = 64 * 2**20  # of a record
MAX_NUMBER = 999_999  # of a participant
_NAME = re.compile(rf'([0-9]{{3,6}})-({CODE.pattern})\.jsonl')  # of a record
E_ = TypeVar('E_', bound=Event)


class StudyError(ValueError):
    """A participant cannot take part; the text says why."""


class SimilarCodeError(StudyError):
    """A code differs from a known one in case only: it is hardly another person's."""

    def __init__(self, code: str, known: str) -> None:
        self.known = known
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
        self.diff = list(diff)
        super().__init__(
            'the plan is not the one with which the study began: put that back, or accept the '
            'change with --accept-changes'
        )


@dataclass(frozen=True)
class Participant:
    """Somebody who takes part."""

    code: str
    number: int  # in the order of arrival, from 0
    path: Path  # of the record


@dataclass
class Record:
    """The events of one participant, from the first; those that did not fit are left out."""

    path: Path
    events: list[Event]
    problems: list[str] = field(default_factory=list)  # what was left out, in words

    @classmethod
    def read(cls, path: Path) -> 'Record':
        """
        Read a record, and change nothing in it.

        :raises OSError: it is no regular file, too large, or cannot be read.
        """
        return cls(path, *read_lines(path, event_of, MAX_BYTES))

    @classmethod
    def read_head(cls, path: Path) -> 'Record':
        """Read a record up to how the participant began; the errors are those of ``read``."""
        events: list[Event] = []
        for line in read_in_place(path, MAX_BYTES).split(b'\n'):
            with suppress(ValueError):
                events.append(event_of(line.decode()))
                if isinstance(events[-1], ParticipantBegan):
                    break
        return cls(path, events)

    def of(self, kind: type[E_]) -> list[E_]:
        """Return the events of one kind."""
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def counting(self) -> list[Event]:
        """The events that count: those of the last attempt at each part."""
        return last_attempts(self.events)

    @property
    def began(self) -> ParticipantBegan | None:
        """How the participant began; None: the line is damaged."""
        return next(iter(self.of(ParticipantBegan)), None)

    @property
    def done(self) -> set[str]:
        """Keys of the parts that are over."""
        return {event.part for event in self.counting if isinstance(event, PartEnded)}

    @property
    def refused(self) -> bool:
        """Whether the participant did not agree to take part."""
        return any(event.why == REFUSED for event in self.of(PartEnded))

    @property
    def over(self) -> bool:
        """Whether the participant has ended the study."""
        return bool(self.of(ParticipantEnded))

    @property
    def minutes(self) -> float:
        """From the first event to the last, pauses included."""
        times = [event.time for event in self.events]
        return (max(times) - min(times)) / 60 if times else 0.0

    def seconds_in(self, part: str) -> float:
        """Return how long the participant was at a part so far, over all sittings."""
        time_in = times_in(self.events).get(part)
        return time_in.seconds if time_in is not None else 0.0


def steady_clock() -> Callable[[], float]:
    """
    Return a clock of s since 1970 that goes on evenly when the time of day is set.

    The time between two events of one sitting is then the time that passed.
    """
    ahead = time.time() - time.monotonic()
    return lambda: ahead + time.monotonic()


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
        :param clock: s since 1970; None: a steady one.
        :raises OSError: it cannot be read.
        """
        self._log, self._publish = AppendOnlyLog(path), publish
        self._clock = clock or steady_clock()
        events = self._log.read(event_of)
        super().__init__(path, events, self._log.problems)

    def note(self, kind: type[Event], /, **values: Any) -> None:
        """
        Add an event.

        :param values: all of its fields but the time.
        :raises OSError: it could not be written.
        """
        event = kind(time=round(self._clock(), 3), **values)
        line = event.line()
        self._log.append(line)
        self.events.append(event)
        self._publish(line)


class StudyFolder:
    """The folder of a study: records of its participants, and a folder for each with bags."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def participants(self) -> tuple[list[Participant], list[str]]:
        """Return all, in the order of arrival, and which files are left out, in words."""
        records, problems = self._records(Record.read_head)
        return [participant for participant, _ in records], problems

    def records(self) -> tuple[list[tuple[Participant, Record]], list[str]]:
        """
        Return what all participants did, in the order of arrival.

        :return: also what is left out, in words: files that are no record of a participant, and
            lines that are no event.
        """
        records, problems = self._records(Record.read)
        return records, [*problems, *(text for _, each in records for text in each.problems)]

    def similar(self, code: str) -> str:
        """Return the code of a participant that differs only in case; empty: there is none."""
        return similar_code(code, self.codes())

    def codes(self) -> list[str]:
        """Return the codes of all participants."""
        return [each.code for each in self.participants()[0]]

    def enter(self, plan: StudyPlan, code: str, *, simulated: bool = False) -> Participant:
        """
        Return a participant: a new one, or one who has not finished and goes on.

        :param simulated: nobody is there: a simulated teacher takes part.
        :raises SimilarCodeError: somebody's code differs in case only.
        :raises ChangedPlanError: the plan is not the one that is kept.
        :raises StudyError: the code cannot be used, it is somebody's who has finished, the plan
            is another one, or has no room.
        :raises OSError: the folder cannot be written.
        """
        if not CODE.fullmatch(code):
            raise StudyError(f'{code!r} is not a code: {CODE_RULE}')
        self.path.mkdir(parents=True, exist_ok=True)
        with self._locked():
            protocol = self._checked(plan)
            there, problems = self.participants()
            known = next((each for each in there if each.code == code), None)
            if known is not None:
                record = Record.read(known.path)
                _check_known(self._followed(protocol, plan, record), known, record)
                _check_kind(code, record, simulated=simulated)
                if record.began is not None:
                    return known
            else:
                _check_new(plan, code, there)
                self._check_left_out(code, problems)
            entered = known or self._new(code)
            protocol.keep(plan)
            order = [condition.name for condition in plan.order_of(entered.number)]
            OpenRecord(entered.path).note(
                ParticipantBegan,
                participant=code,
                number=entered.number,
                study=plan.name,
                order=order,
                simulated=simulated,
                protocol=digest_of(plan),
            )
            return entered

    def protocol(self) -> Protocol:
        """
        Return what is kept of the plan.

        :raises OSError: it cannot be read.
        """
        return Protocol(self.path)

    def accept(self, plan: StudyPlan) -> None:
        """
        Keep a changed plan: who begins from now on follows it.

        :raises StudyError: what is kept is damaged.
        :raises OSError: the folder cannot be read or written.
        """
        if (self.path / FILE).exists():
            with self._locked():
                protocol = self.protocol()
                _refuse_damaged(protocol)
                protocol.keep(plan)

    def check(self, plan: StudyPlan) -> None:
        """
        Compare a plan with the one that is kept.

        :raises ChangedPlanError: it has been changed.
        :raises StudyError: what is kept is damaged.
        :raises OSError: it cannot be read.
        """
        self._checked(plan)

    def plan_of(self, plan: StudyPlan, participant: Participant) -> StudyPlan:
        """
        Return the plan that a participant follows: the one of when the participant began.

        :param plan: of today, for participants of whom no version is kept.
        :raises OSError: the record, or what is kept, cannot be read.
        """
        return self._followed(self.protocol(), plan, Record.read_head(participant.path))

    def _followed(self, protocol: Protocol, plan: StudyPlan, record: Record) -> StudyPlan:
        began = record.began
        return (protocol.plan_of(began.protocol) if began is not None else None) or plan

    def _checked(self, plan: StudyPlan) -> Protocol:
        protocol = self.protocol()
        _refuse_damaged(protocol)
        if lacking := self.lacking(protocol):
            raise StudyError(f'{lacking}; put the file back from a copy')
        if changes := protocol.changes(plan):
            raise ChangedPlanError(changes)
        return protocol

    def lacking(self, protocol: Protocol) -> str:
        """Return whose plan is not kept, though the record names it, in words; empty: nobody's."""
        kept = {version.digest for version in protocol.versions}
        for participant, record in self._records(Record.read_head)[0]:
            began = record.began
            if began is not None and began.protocol and began.protocol not in kept:
                return (
                    f'{protocol.path} does not hold the plan {began.protocol[:SHOWN_DIGEST]}, '
                    f'which {participant.code!r} follows'
                )
        return ''

    def directory(self, participant: Participant, condition: str) -> Path:
        """Return the folder of a participant's bags and options in a condition."""
        return self.path / participant.code / condition

    def _check_left_out(self, code: str, problems: Iterable[str]) -> None:
        """Refuse a code whose record is there and cannot be used: it would get a second one."""
        for each in self._named()[0]:
            if each.code == code and not (each.path.is_file() and not each.path.stat().st_size):
                why = next((text for text in problems if text.startswith(f'{each.path} ')), '')
                raise StudyError(
                    f'{code!r} has a record that cannot be used: {why or each.path}; mend it, or '
                    'move it away'
                )

    def _new(self, code: str) -> Participant:
        """Return a new participant; one whose record is still empty keeps the number."""
        named = self._named()[0]
        for each in named:
            if each.code == code and each.path.is_file() and not each.path.stat().st_size:
                return each
        number = max((each.number for each in named), default=-1) + 1
        if number > MAX_NUMBER:
            raise StudyError(f'{named[-1].path} has the last number; give it a smaller one')
        return Participant(code, number, self.path / _file_name(number, code))

    def _named(self) -> tuple[list[Participant], list[str]]:
        """Return whom the names of files stand for, by number, and which name no record."""
        found, problems = [], []
        try:
            names = sorted(os.listdir(self.path))
        except FileNotFoundError:  # nobody has taken part yet
            names = []
        for path in (self.path / name for name in names):
            match = _NAME.fullmatch(path.name)
            if path.name == FILE or path.suffix != '.jsonl':
                continue
            if match is not None and _file_name(int(match[1]), match[2]) == path.name:
                found.append(Participant(match[2], int(match[1]), path))
            else:
                problems.append(
                    f'{path} is left out: its name is not that of a record, such as '
                    f'{_file_name(0, "p1")}; it may be a copy that another program made'
                )
        return sorted(found, key=lambda each: (each.number, each.code)), problems

    def _records(
        self, read: Callable[[Path], Record]
    ) -> tuple[list[tuple[Participant, Record]], list[str]]:
        """
        Return the records of participants, each once: copies are left out.

        :param read: reads a record up to how it began, or further.
        :return: also which files are left out, in words.
        """
        named, problems = self._named()
        found: dict[str, tuple[Participant, Record]] = {}
        for each in named:
            try:
                record = read(each.path)
            except OSError as error:
                problems.append(f'{each.path} is left out: {error.strerror}')
                continue
            began, why = record.began, ''
            if not record.events:
                why = 'it holds no event'
                problems += record.problems
            elif began is not None and (began.number, began.participant) != (
                each.number,
                each.code,
            ):
                own = _file_name(began.number, began.participant)
                why = f'it is the record of {began.participant!r}, whose file is {own}'
            elif each.code in found:
                why = f'{found[each.code][0].path.name} is a record of {each.code!r} too'
            elif began is None and (of := _copied(each, [p for p, _ in found.values()])):
                why = f'it seems to be a copy of {of.path.name}'
            if why:
                problems.append(f'{each.path} is left out: {why}')
            else:
                found[each.code] = each, record
        return list(found.values()), problems

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


def _refuse_damaged(protocol: Protocol) -> None:
    """Refuse a protocol that has damaged lines: a participant's might be among them."""
    if protocol.problems:
        raise StudyError(f'{protocol.problems[0]}; put the file back from a copy')


def _check_known(plan: StudyPlan, known: Participant, record: Record) -> None:
    """Refuse a participant who cannot go on."""
    if record.over:
        raise StudyError(f'{known.code!r} has ended this study already; give another code')
    order = [condition.name for condition in plan.order_of(known.number)]
    if (began := record.began) is not None and list(began.order) != order:
        raise StudyError(
            f'{known.code!r} began with another plan, whose conditions were '
            f'{", ".join(began.order)}; put that plan back'
        )


def _check_kind(code: str, record: Record, *, simulated: bool) -> None:
    """Refuse to have a person and a simulated teacher share a record."""
    if (began := record.began) is not None and began.simulated != simulated:
        who = 'a simulated participant' if began.simulated else 'a person'
        raise StudyError(
            f'{code!r} is {who} of this study: give another code, or another folder with --study'
        )


def _check_new(plan: StudyPlan, code: str, there: Sequence[Participant]) -> None:
    """Refuse a participant who cannot begin."""
    if similar := similar_code(code, [each.code for each in there]):
        raise SimilarCodeError(code, similar)
    if plan.participants and len(there) >= plan.participants:
        raise StudyError(
            f'all {plan.participants} participants of the plan are there; {code!r} is new'
        )


def _file_name(number: int, code: str) -> str:
    return f'{number:03d}-{code}.jsonl'


def _copied(one: Participant, others: Iterable[Participant]) -> Participant | None:
    """Return whose record, by its name, a file of the same number is a copy of; None: nobody's."""
    return next(
        (
            each
            for each in others
            if each.number == one.number and one.code.startswith(f'{each.code}-')
        ),
        None,
    )


def learned_rows(options: Iterable[OptionSummary]) -> list[dict[str, Any]]:
    """Return what was learned, as JSON data: a row for each option."""
    return [
        {
            'option': option.option_name,
            'method': option.method,
            'demonstrations': option.n_demonstrations,
            'not_here': option.n_not_here,
            'criteria_met': option.criteria_met,
            'return_shown': _finite(option.mean_return_demonstrations),
            'return_learned': _finite(option.mean_return_policy),
        }
        for option in options
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def left_of(parts: Sequence[Part], record: Record) -> list[Part]:
    """Return what a participant has still to do."""
    done = record.done
    return [part for part in parts if part.key not in done]
