"""Results of a study: tidy tables."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import json
from typing import Any

from humanopts_learner.append_only_log import read_lines
from humanopts_learner.demonstrations import Demonstration, each_once, Kind
from humanopts_teach.lesson.store import Entry, entry_from_line, LessonEvent
from humanopts_teach.study.codebook import codebook, Column
from humanopts_teach.study.events import Event, last_attempts, LearnedOption, times_in
from humanopts_teach.study.log import StudyLog
from humanopts_teach.study.plan import Condition, Part, PartKind, StudyPlan
from humanopts_teach.study.protocol import Protocol, SHOWN_DIGEST
from humanopts_teach.study.questions import Question
from humanopts_teach.study.record import Record, StudyFolder
import pandas as pd

ADDRESS = 'url_'  # prefix of columns with URL parameters
_DETAILS = {'event', 'time', 'part', 'condition'}  # fields of an event that have their own column


@dataclass(frozen=True)
class StudyData:
    """
    The data of the participants of a study.

    :ivar lessons: entries in the order written, by participant and condition; empty: not reached.
    :ivar now: current time, s since 1970; determines whether a participant has dropped out.
    :ivar wordings: canonical names of buttons, as returned by ``read_merge``.
    """

    protocol: Protocol
    log: StudyLog
    records: Sequence[Record]
    lessons: Mapping[tuple[str, str], Sequence[Entry]]
    now: float
    wordings: Mapping[str, str] = field(default_factory=dict)

    def plan_of(self, record: Record) -> StudyPlan | None:
        """Return the plan that a participant follows; None: unknown."""
        return self.protocol.plan_of(record.began.protocol) if record.began else None

    def state_of(self, record: Record) -> str:
        """Return the state of a participant, as defined in the codebook."""
        if record.excluded:
            return 'excluded'
        if record.over:
            return 'finished'
        plan = self.plan_of(record)
        here = record.holds_place(plan.return_within if plan is not None else 0.0, self.now)
        return 'under way' if here else 'dropped out'


def read_study(
    folder: StudyFolder, now: float, wordings: Mapping[str, str] = {}
) -> tuple[StudyData, list[str]]:
    """
    Read the folder of a study.

    :return: the data, and descriptions of omissions.
    :raises OSError: the protocol or the log cannot be read.
    """
    records, problems = folder.records()
    protocol, log = Protocol(folder.path), StudyLog(folder.path)
    problems += [*protocol.problems, *log.problems]
    lessons = {}
    for record in records:
        for condition in record.began.order if record.began is not None else ():
            path = folder.path / record.code / condition / 'demonstrations'
            try:
                entries, faults = read_lines(path / f'{record.code}.jsonl', entry_from_line)
            except OSError as error:
                entries, faults = [], [f'{path} is left out: {error.strerror}']
            lessons[record.code, condition] = entries
            problems += faults
    return StudyData(protocol, log, records, lessons, now, wordings), problems


def tables(data: StudyData) -> dict[str, pd.DataFrame]:
    """
    Return tidy tables by name, one row per observation, with the columns of the codebook.

    If a part was restarted, only the answers and suggestions of the last attempt count.
    """
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in codebook()}
    for record in data.records:
        for name, found in _Participant(data, record).rows().items():
            rows[name] += found
    return {
        name: pd.DataFrame(rows[name], columns=list(described_columns(name, rows[name])))
        for name in codebook()
    }


def described_columns(name: str, rows: Iterable[Mapping[str, Any]]) -> dict[str, Column]:
    """Return the columns of a table, including the URL parameters in the rows."""
    given = dict.fromkeys(key for row in rows for key in row if key.startswith(ADDRESS))
    from_address = Column('parameter of the address, from a recruiting platform', '', 'id')
    return codebook()[name] | dict.fromkeys(given, from_address)


class _Participant:
    """The rows for one participant in all tables."""

    def __init__(self, data: StudyData, record: Record) -> None:
        self.data, self.record = data, record
        self.plan, self.state = data.plan_of(record), data.state_of(record)
        self.events = last_attempts(record.events)
        self.times = times_in(record.events)
        self.order = record.began.order if record.began is not None else ()
        known = {each.name: each for each in self.plan.conditions} if self.plan else {}
        self.conditions: dict[str, Condition | None] = {n: known.get(n) for n in self.order}

    def rows(self) -> dict[str, list[dict[str, Any]]]:
        """Return the rows by table."""
        began = self.record.began
        common: dict[str, Any] = {'participant': self.record.code}
        versions = self.data.protocol.versions
        if began is not None:
            common |= {
                'study': began.study,
                'protocol': began.protocol[:SHOWN_DIGEST],
                'seed': None if self.plan is None else self.plan.seed,
                'software': next((v.software for v in versions if v.digest == began.protocol), ''),
                'simulated': _word(began.simulated),
            }
        found = {
            'participants': [self._person()],
            'conditions': [self._condition(name) for name in self.conditions],
            'demonstrations': [row for name in self.conditions for row in self._given(name)],
            'parts': self._parts(),
            'answers': list(self._answers()),
            'buttons': [self._where(e) | e.model_dump() for e in self._of('button')],
            'options': [
                self._where(event)
                | {key: _word(value) for key, value in option.model_dump().items()}
                for event in self._of('learned')
                for option in _newest(event.options)
            ],
            'events': self._events(),
        }
        return {name: [row | common for row in each] for name, each in found.items()}

    def _of(self, kind: str) -> list[Event]:
        return [event for event in self.events if event.event == kind]

    def _where(self, event: Event) -> dict[str, Any]:
        """Return the columns that identify the condition of an event."""
        return self._place(event.condition)

    def _place(self, condition: str) -> dict[str, Any]:
        known = self.conditions.get(condition)
        return {
            'condition': condition,
            'domain': '' if known is None else known.domain,
            'position': self.order.index(condition) + 1 if condition in self.order else None,
        }

    def _entries(self, condition: str) -> Sequence[Entry]:
        return self.data.lessons.get((self.record.code, condition), ())

    def _given_in(self, condition: str) -> list[Demonstration]:
        """Return the demonstrations and judged runs of a condition, including withdrawn ones."""
        entries = self._entries(condition)
        return each_once(each for each in entries if isinstance(each, Demonstration))

    def _person(self) -> dict[str, Any]:
        record, agreed = self.record, ''
        for event in record.of('part ended'):
            if event.kind is PartKind.CONSENT:
                agreed = _word(True)
        checks = self._of('attention')
        row = {
            'number': record.number,
            'place': record.place,
            'order': ' '.join(self.order),
            'agreed': agreed,
            'state': self.state,
            'left': '' if record.over else next(reversed(self.times), ''),
            'ended': _word(record.over),
            'began': min(event.time for event in record.events),
            'minutes': round(record.minutes, 2),
            'active_seconds': self._seconds(self.times),
            'checks': len(checks),
            'checks_failed': sum(not event.passed for event in checks),
            'idle_seconds': sum(event.seconds for event in record.of('idle')),
        }
        for event in record.of('client'):
            client = event.model_dump(include={'browser', 'width', 'height', 'language'})
            row |= client | {f'{ADDRESS}{name}': text for name, text in event.columns.items()}
        return row

    def _seconds(self, parts: Iterable[str]) -> float:
        return round(sum(self.times[part].seconds for part in parts), 3)

    def _condition(self, name: str) -> dict[str, Any]:
        """Return the row of a condition, whether or not the participant reached it."""
        events = [event for event in self.record.events if event.condition == name]
        parts = dict.fromkeys(event.part for event in events)
        teach = {e.part for e in events if e.kind is PartKind.TEACH and e.event == 'part began'}
        given = self._given_in(name)
        kept = [demo for demo in given if not demo.withdrawn]
        shown = [demo for demo in kept if demo.kind is Kind.TRAJECTORY]
        exams = [demo for demo in kept if demo.kind is Kind.JUDGED and demo.exam]
        learned = [o for e in self._of('learned') if e.condition == name for o in e.options]
        options, known = _newest(learned), self.conditions[name]
        # Without the lesson's files, use the counts in the record.
        counts = (
            (len(shown), sum(demo.kind is Kind.NOT_HERE for demo in kept))
            if given
            else (
                sum(option.demonstrations for option in options),
                sum(option.not_here for option in options),
            )
        )
        return self._place(name) | {
            'state': self.state,
            'learn': '' if known is None else known.learn,
            'strategy': '' if known is None else known.strategy,
            'place': self.record.place,
            'order': ' '.join(self.order),
            'reached': _word(bool(teach)),
            'finished': _word(bool(teach & self.record.done)),
            'active_seconds': self._seconds(parts.keys() & self.times.keys()),
            'teach_seconds': self._seconds(teach),
            'sittings': sum(len(self.times[part].sittings) for part in teach),
            'options': len(begun_options(self._entries(name))) or len(options),
            'options_learned': sum(option.learned for option in options),
            'demonstrations': counts[0],
            'not_here': counts[1],
            'taken_back': len(given) - len(kept),
            'cut': sum(event.event == 'demonstration cut' for event in events),
            'steps': sum(len(demo.actions) - demo.machine_steps for demo in shown),
            'demonstration_seconds': round(sum(demo.seconds for demo in shown), 3),
            'questions': sum(demo.kind is Kind.JUDGED for demo in kept) - len(exams),
            'exam_right': sum(demo.right for demo in exams),
            'exam_runs': len(exams),
        }

    def _given(self, condition: str) -> Iterator[dict[str, Any]]:
        """Yield the row of each demonstration and judged run of a condition."""
        for trial, demo in enumerate(self._given_in(condition), start=1):
            judged = demo.kind is Kind.JUDGED
            kinds = {Kind.TRAJECTORY: 'demonstration', Kind.NOT_HERE: 'not here'}
            yield self._place(condition) | {
                'trial': trial,
                'option': demo.option_name,
                'kind': kinds.get(demo.kind, 'exam' if demo.exam else 'question'),
                'number': demo.number,
                'right': _word(demo.right) if judged else '',
                'steps': len(demo.actions),
                'machine_steps': demo.machine_steps,
                'total_reward': demo.total_reward,
                'seconds': demo.seconds,
                'withdrawn': _word(demo.withdrawn),
                'session': demo.session,
                'uuid': demo.uuid,
            }

    def _parts(self) -> list[dict[str, Any]]:
        """Return a row for each started part, in order of the first event."""
        kinds = {e.part: e.kind.value for e in self.record.events if e.kind}
        conditions = {event.part: event.condition for event in self.record.events}
        why = {event.part: event.why for event in self._of('part ended')}
        return [
            self._place(conditions[part])
            | {
                'part': part,
                'kind': kinds.get(part, ''),
                'began': found.began,
                'seconds': round(found.seconds, 3),
                'sittings': len(found.sittings),
                'why': why.get(part, ''),
            }
            for part, found in self.times.items()
        ]

    def _answers(self) -> Iterator[dict[str, Any]]:
        """Yield the row of each answer, with the question as shown to the participant."""
        parts = self.plan.parts_of(self.record.place, self.record.number) if self.plan else []
        asked: dict[tuple[str, str], tuple[int, Question, Part]] = {
            (part.key, question.name): (page, question, part)
            for part in parts
            if part.questions is not None
            for page, question in enumerate(part.questions.items, start=1)
        }
        passed = {(e.part, e.item): _word(e.passed) for e in self._of('attention')}
        for event in self._of('answer'):
            row = self._where(event) | {
                'part': event.part,
                'item': event.item,
                'value': event.value if isinstance(event.value, int | float) else None,
                'text': event.value if isinstance(event.value, str) else '',
                'points': event.points or None,
                'reaction_seconds': event.seconds,
                'passed': passed.get((event.part, event.item), ''),
            }
            if known := asked.get((event.part, event.item)):
                page, question, _ = known
                row |= {
                    'page': page,
                    'wording': question.text,
                    'kind': question.kind.value,
                    'low': question.low,
                    'high': question.high,
                    'expected': '' if question.expect is None else str(question.expect),
                }
                if question.options and event.value and question.accepts(event.value, 0):
                    given = event.value if isinstance(event.value, tuple) else (event.value,)
                    row['chosen'] = ' '.join(map(str, given))
                    row['text'] = ' | '.join(question.options[int(each) - 1] for each in given)
            yield row

    def _events(self) -> list[dict[str, Any]]:
        first = min(event.time for event in self.record.events)
        return [
            {
                'number': number,
                'time': event.time,
                'elapsed': round(event.time - first, 3),
                'event': event.event,
                'part': event.part,
                'condition': event.condition,
                'details': json.dumps(
                    event.model_dump(mode='json', exclude_unset=True, exclude=_DETAILS),
                    ensure_ascii=False,
                ),
            }
            for number, event in enumerate(self.record.events, start=1)
        ]


def _word(value: Any) -> Any:
    """Return a bool as 'yes' or 'no', and other values unchanged."""
    return {True: 'yes', False: 'no'}[value] if isinstance(value, bool) else value


def _newest(options: Iterable[LearnedOption]) -> list[LearnedOption]:
    """Return the last state of each option."""
    return list({each.option: each for each in options}.values())


def begun_options(entries: Iterable[Entry]) -> list[str]:
    """Return the names of the options of a lesson in order, without deleted ones."""
    names: dict[str, None] = {}
    for entry in entries:
        if isinstance(entry, LessonEvent) and entry.entry == 'option deleted':
            names.pop(entry.option_name, None)
        elif entry.option_name:
            names[entry.option_name] = None
    return list(names)
