"""
The events of a study, as lines of JSON with one schema.

Every line from a file or a bag is validated here; invalid lines are ignored.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
import math
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import composed, parse_json
from humanopts_ros.text_files import fault_in
from humanopts_teach.lesson.store import CODE
from humanopts_teach.study.plan import PartKind
from humanopts_teach.study.questions import Answer, MAX_POINTS, Name
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    model_validator,
    ValidationError,
)

EventKind = Literal[
    'began',  # the participant started the study
    'part began',  # started or restarted: earlier answers and buttons no longer count
    'still there',  # keep-alive; after a crash, time is counted up to the last one
    'part left',  # left unfinished
    'part ended',
    'answer',  # to a question; the last one counts
    'attention',  # result of an attention check, recorded when its questionnaire ended
    'client',  # details of the participant's browser, at each arrival
    'idle',  # time without a key press, until a key was pressed or the part was left
    'demonstration cut',  # the time limit ended an open demonstration
    'button',  # a suggested button
    'learned',  # all options taught so far in this condition
    'ended',  # the participant completed the study
]
_REQUIRED: dict[EventKind, tuple[str, ...]] = {
    'began': ('participant', 'number', 'place', 'study', 'order', 'simulated'),
    'part began': ('part', 'kind'),
    'still there': ('part',),
    'part left': ('part',),
    'part ended': ('part', 'kind', 'why'),
    'answer': ('part', 'item', 'value'),
    'attention': ('part', 'item', 'passed'),
    'client': (),
    'idle': ('part', 'seconds'),
    'demonstration cut': ('part',),
    'button': ('part', 'domain', 'rank', 'text'),
    'learned': ('part', 'options'),
    'ended': (),
}
FINISHED: Final = 'finished'  # this and the next two: reason why a part ended
TIME: Final = 'time is over'
FAILED: Final = 'attention failed'
MAX_LINE = 1_000_000  # characters of an event


def _text(text: str) -> str:
    """Return a text in NFC; reject lone surrogates, which cannot be encoded."""
    text.encode()
    return composed(text)


Text = Annotated[str, Field(max_length=1000), AfterValidator(_text)]
Count = Annotated[int, Field(ge=0, lt=2**31)]
Rank = Annotated[int, Field(ge=1, lt=2**31)]
Return = Annotated[float, Field(allow_inf_nan=False)]  # reward units


class _Values(BaseModel):
    """A strict model without type conversion; unknown fields are ignored."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True)


class LearnedOption(_Values):
    """The learning state of one option."""

    option: Annotated[Text, Field(min_length=1)]
    method: Text
    demonstrations: Count
    not_here: Count
    criteria_met: bool
    questions: Count
    exam_right: Count
    exam_runs: Count
    exams_failed: Count
    learned: bool
    status: Text
    return_shown: Return | None
    return_learned: Return | None


class Event(_Values):
    """An event; fields that its kind does not use are empty."""

    event: EventKind
    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970
    part: Text = ''  # key of the part; empty: none
    condition: Text = ''  # empty: none
    kind: Annotated[PartKind | None, Field(strict=False)] = None  # kind of the part
    why: Literal['', 'finished', 'time is over', 'attention failed'] = ''
    item: Text = ''  # name of the question
    value: Answer | None = None  # None: the question was skipped
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)] = 0  # points of a rating scale
    seconds: Annotated[float, Field(ge=0, lt=1e9)] = 0.0  # reaction time, or time without a key
    passed: bool = False  # whether an attention check was passed
    domain: Text = ''
    rank: Rank = 0
    text: Text = ''
    options: tuple[LearnedOption, ...] = Field(default=(), strict=False)
    participant: Annotated[str, Field(pattern=f'^{CODE.pattern}$')] = ''
    number: Count = 0  # index of the participant, in order of arrival
    place: Count = 0  # index into the orders of the plan
    study: Text = ''
    order: tuple[Text, ...] = Field(default=(), strict=False)  # names of the conditions
    simulated: bool = False
    software: Text = ''  # version of humanopts
    protocol: Text = ''  # digest of the participant's plan; empty: not stored
    browser: Text = ''
    width: Count = 0  # CSS pixels
    height: Count = 0  # CSS pixels
    language: Text = ''  # of the browser
    columns: dict[Name, Text] = {}  # URL parameters from a recruiting platform

    @model_validator(mode='after')
    def _fits(self) -> Self:
        needed = _REQUIRED[self.event]
        given = [n for n in needed if n in self.model_fields_set and getattr(self, n) != '']
        if missing := ', '.join(name for name in needed if name not in given):
            raise ValueError(f'{self.event!r} needs {missing}')
        rated = type(self.value) is int and 1 <= self.value <= self.points
        if self.points and not rated and self.value is not None:
            raise ValueError(f'{self.value} is not on a scale of {self.points}')
        return self


def event_of(line: str) -> Event:
    """
    Parse the event in a line.

    :raises ValueError: the line is not an event; the message is a single line.
    """
    values = parse_json(line, MAX_LINE)
    if not isinstance(values, dict):
        raise ValueError('it is not an event of a study')
    try:
        return Event.model_validate(values)
    except ValidationError as error:
        raise ValueError(fault_in(error)) from None


def learned(options: Iterable[OptionSummary]) -> tuple[LearnedOption, ...]:
    """Return the learning states of options, as stored in an event."""
    return tuple(
        LearnedOption(
            option=option.option_name,
            method=option.method,
            demonstrations=option.n_demonstrations,
            not_here=option.n_not_here,
            criteria_met=option.criteria_met,
            questions=option.n_questions,
            exam_right=option.exam_right,
            exam_runs=option.exam_runs,
            exams_failed=option.exams_failed,
            learned=option.learned,
            status=option.status,
            return_shown=_finite(option.mean_return_demonstrations),
            return_learned=_finite(option.mean_return_policy),
        )
        for option in options
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def last_attempts(events: Iterable[Event]) -> list[Event]:
    """
    Return the events that count: one per fact, from the last attempt at each part.

    Restarting a part discards the answers and buttons of the earlier attempt, but not the options
    taught. If a fact, such as an answer, is recorded twice in one attempt, the last record counts.
    Of several 'began' events, the first counts.

    :param events: events of one participant, in chronological order.
    """
    parts: dict[str, dict[tuple[Any, ...], tuple[int, Event]]] = {}
    for place, event in enumerate(events):
        fact, facts = (event.event, event.item, event.rank), parts.setdefault(event.part, {})
        if event.event == 'part began':
            parts[event.part] = facts = {k: v for k, v in facts.items() if k[0] == 'learned'}
        if event.event != 'began' or fact not in facts:
            facts[fact] = place, event
    counting = [each for facts in parts.values() for each in facts.values()]
    return [event for _, event in sorted(counting, key=lambda each: each[0])]


@dataclass
class TimeIn:
    """The times that a participant spent on a part, over all sittings."""

    began: float | None = None  # s since 1970, first start; None: not recorded
    sittings: list[tuple[float, float]] = field(default_factory=list)  # start and end of each
    open: bool = False

    @property
    def seconds(self) -> float:
        """The total duration of all sittings."""
        return sum(end - begin for begin, end in self.sittings)


def times_in(events: Iterable[Event]) -> dict[str, TimeIn]:
    """
    Return the times that a participant spent on each part, by key.

    A sitting lasts from the start of the part until the part is left or ended. If neither is
    recorded, for example after a crash, the sitting lasts until the last event, such as a
    keep-alive. If its start is not recorded, it begins with the first event.
    """
    parts: dict[str, TimeIn] = {}
    for event in events:
        if not event.part:
            continue
        found, now = parts.setdefault(event.part, TimeIn()), event.time
        begins = event.event == 'part began'
        if begins and found.began is None:
            found.began = now
        if begins or not found.sittings:
            found.sittings.append((now, now))
            found.open = True
        elif found.open:
            begin, end = found.sittings[-1]
            found.sittings[-1] = begin, max(end, now)
        found.open = found.open and event.event not in ('part left', 'part ended')
    return parts
