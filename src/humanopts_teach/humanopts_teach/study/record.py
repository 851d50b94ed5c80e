"""
What participants did: one file of events each.

An event is a line of JSON. It is on disk (fsync) before the study goes on, and is published too,
so that the bag of a condition holds it. Nothing that identifies a person is kept but the code that
the person was given, and what the person types.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import fcntl
import json
import math
from pathlib import Path
import time
from typing import Any

from humanopts_learner.append_only_log import AppendOnlyLog
from humanopts_ros.limits import parse_json
from humanopts_teach.lesson.requests import OptionStatus
from humanopts_teach.lesson.store import CODE, CODE_RULE
from humanopts_teach.study.plan import Part, StudyPlan

TOPIC = 'study_events'  # std_msgs/String, each an event as JSON
BEGAN, ENDED = 'began', 'ended'  # of a participant
PART_BEGAN, PART_ENDED = 'part began', 'part ended'
ANSWER, BUTTON, LEARNED = 'answer', 'button', 'learned'
FINISHED, TIME, REFUSED = 'finished', 'time is over', 'not agreed'  # why a part ended

Event = Mapping[str, Any]


class StudyError(ValueError):
    """A participant cannot take part; the text says why."""


class Record:
    """
    The events of one participant.

    :ivar events: from the first.
    """

    def __init__(
        self,
        path: Path,
        publish: Callable[[str], object] = lambda line: None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """
        Open the file, which need not exist.

        :param publish: called with each new line.
        :param clock: s since 1970.
        :raises OSError: it cannot be read.
        """
        self._log, self._publish, self._clock = AppendOnlyLog(path), publish, clock
        self.events: list[Event] = self._log.read(event_of)

    def note(self, what: str, **values: Any) -> None:
        """
        Add an event.

        :raises OSError: it could not be written.
        """
        event = {'event': what, 'time': round(self._clock(), 3), **values}
        line = json.dumps(event, sort_keys=True)
        self._log.append(line)
        self.events.append(event)
        self._publish(line)

    def of(self, what: str) -> list[Event]:
        """Return the events of one kind."""
        return [event for event in self.events if event['event'] == what]

    @property
    def done(self) -> set[str]:
        """Keys of the parts that are over."""
        return {event['part'] for event in self.of(PART_ENDED)}

    @property
    def refused(self) -> bool:
        """Whether the participant did not agree to take part."""
        return any(event['why'] == REFUSED for event in self.of(PART_ENDED))

    @property
    def over(self) -> bool:
        """Whether the participant has ended the study."""
        return bool(self.of(ENDED))


def event_of(line: str) -> Event:
    """
    Return the event of a line.

    :raises ValueError: it is no event.
    """
    values = parse_json(line)
    known = isinstance(values, dict) and isinstance(values.get('event'), str)
    if not known or not isinstance(values.get('time'), int | float):
        raise ValueError('it is no event of a study')
    event: dict[str, Any] = values
    return event


@dataclass(frozen=True)
class Participant:
    """Somebody who takes part."""

    code: str
    number: int  # in the order of arrival, from 0
    path: Path  # of the record


class StudyFolder:
    """The folder of a study: records of its participants, and a folder for each with bags."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def participants(self) -> list[Participant]:
        """Return all, in the order of arrival."""
        found = []
        for path in sorted(self.path.glob('[0-9][0-9][0-9]-*.jsonl')):
            number, code = path.stem.split('-', 1)
            found.append(Participant(code, int(number), path))
        return found

    def enter(self, plan: StudyPlan, code: str, *, simulated: bool = False) -> Participant:
        """
        Return a participant: a new one, or one who has not finished and goes on.

        :param simulated: nobody is there: a simulated teacher takes part.
        :raises StudyError: the code cannot be used, it is somebody's who has finished, the plan
            is another one, or has no room.
        :raises OSError: the folder cannot be written.
        """
        if not CODE.fullmatch(code):
            raise StudyError(f'{code!r} is not a code: {CODE_RULE}')
        self.path.mkdir(parents=True, exist_ok=True)
        with self._locked():
            there = self.participants()
            known = next((each for each in there if each.code == code), None)
            if known is not None:
                self._check_known(plan, known)
                return known
            if plan.participants and len(there) >= plan.participants:
                raise StudyError(
                    f'all {plan.participants} participants of the plan are there; {code!r} is new'
                )
            number = there[-1].number + 1 if there else 0
            entered = Participant(code, number, self.path / f'{number:03d}-{code}.jsonl')
            order = [condition.name for condition in plan.order_of(number)]
            who = {'participant': code, 'number': number, 'simulated': simulated}
            Record(entered.path).note(BEGAN, study=plan.name, order=order, **who)
            return entered

    def directory(self, participant: Participant, condition: str) -> Path:
        """Return the folder of a participant's bags and options in a condition."""
        return self.path / participant.code / condition

    def _check_known(self, plan: StudyPlan, known: Participant) -> None:
        record = Record(known.path)
        if record.over:
            raise StudyError(f'{known.code!r} has ended this study already; give another code')
        order = [condition.name for condition in plan.order_of(known.number)]
        if [event for event in record.of(BEGAN) if event.get('order') != order]:
            raise StudyError(
                f'{known.code!r} began with another plan, whose conditions were '
                f'{", ".join(record.of(BEGAN)[0].get("order", []))}; put that plan back'
            )

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep other terminals from entering a participant at the same time."""
        with (self.path / '.lock').open('w') as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def learned_rows(options: Iterable[OptionStatus]) -> list[dict[str, Any]]:
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
    return [part for part in parts if part.key not in record.done]
