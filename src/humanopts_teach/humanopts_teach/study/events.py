"""
What happens in a study, as lines of JSON: one schema for each kind of event.

Every line that comes from a file or a bag is validated here; what does not fit is never counted.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, Self

from humanopts_ros.limits import composed, parse_json
from humanopts_ros.text_files import fault_in
from humanopts_teach.lesson.store import CODE
from humanopts_teach.study.plan import MAX_POINTS, PartKind
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    model_validator,
    TypeAdapter,
    ValidationError,
)

FINISHED, TIME, REFUSED = 'finished', 'time is over', 'not agreed'  # why a part ended
MAX_LINE = 1_000_000  # characters of an event


def _text(text: str) -> str:
    """Return a text in composed form; half a surrogate pair cannot be written to any file."""
    text.encode()
    return composed(text)


Text = Annotated[str, Field(max_length=1000), AfterValidator(_text)]
Word = Annotated[Text, Field(min_length=1)]
Count = Annotated[int, Field(ge=0, lt=2**31)]
Rank = Annotated[int, Field(ge=1, lt=2**31)]
Return = Annotated[float, Field(allow_inf_nan=False)]  # reward units


class _Values(BaseModel):
    """Values that are never converted; unknown fields are ignored."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True)


class _Event(_Values):
    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970


class _OfPart(_Event):
    part: Word  # its key
    condition: Text  # empty: of none


class ParticipantBegan(_Event):
    """The participant came for the first time."""

    event: Literal['began'] = 'began'
    participant: Annotated[str, Field(pattern=f'^{CODE.pattern}$')]
    number: Count  # in the order of arrival, from 0
    study: Text
    order: tuple[Text, ...] = Field(strict=False)  # names of the conditions
    simulated: bool
    protocol: Text = ''  # digest of what the participant follows; empty: it was not kept


class PartBegan(_OfPart):
    """A part began, or began again: its earlier answers and buttons count no longer."""

    event: Literal['part began'] = 'part began'
    kind: PartKind = Field(strict=False)


class SignOfLife(_OfPart):
    """The participant is still at a part; after a crash, the time until then counts."""

    event: Literal['still there'] = 'still there'


class PartLeft(_OfPart):
    """The participant left in the middle of a part."""

    event: Literal['part left'] = 'part left'


class PartEnded(_OfPart):
    """A part ended."""

    event: Literal['part ended'] = 'part ended'
    kind: PartKind = Field(strict=False)
    why: Literal['finished', 'time is over', 'not agreed']


class Answered(_OfPart):
    """A question was answered."""

    event: Literal['answer'] = 'answer'
    item: Word
    value: Rank
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)]  # of the scale

    @model_validator(mode='after')
    def _on_the_scale(self) -> Self:
        if self.value > self.points:
            raise ValueError(f'{self.value} is not on a scale of {self.points}')
        return self


class ButtonSuggested(_OfPart):
    """A button was suggested."""

    event: Literal['button'] = 'button'
    domain: Text
    rank: Rank
    text: Word


class LearnedOption(_Values):
    """One option as it was learned so far."""

    option: Word
    method: Text
    demonstrations: Count
    not_here: Count
    criteria_met: bool
    return_shown: Return | None
    return_learned: Return | None


class OptionsLearned(_OfPart):
    """All options of the participant in this condition, as they were learned so far."""

    event: Literal['learned'] = 'learned'
    options: tuple[LearnedOption, ...] = Field(strict=False)


class ParticipantEnded(_Event):
    """The participant came to the end of the study."""

    event: Literal['ended'] = 'ended'
    why: Literal['', 'not agreed'] = ''


PartEvent = (
    PartBegan | SignOfLife | PartLeft | PartEnded | Answered | ButtonSuggested | OptionsLearned
)
Event = ParticipantBegan | PartEvent | ParticipantEnded
WHOLE = ParticipantBegan | ParticipantEnded  # of no part
_EVENT: TypeAdapter[Event] = TypeAdapter(Annotated[Event, Field(discriminator='event')])


def event_of(line: str) -> Event:
    """
    Return the event of a line.

    :raises ValueError: it is not an event; the text is one line.
    """
    try:
        return _EVENT.validate_python(parse_json(line, MAX_LINE))
    except ValidationError as error:
        if not error.errors()[0]['loc']:
            raise ValueError('it is not an event of a study') from None
        raise ValueError(fault_in(error)) from None


def last_attempts(events: Iterable[Event]) -> list[Event]:
    """
    Return the events that count: one for each fact, and of the last attempt at each part.

    A part that was left is begun again, which supersedes what was answered and suggested in it.
    What was taught goes on, so the last list of options counts. A fact that is noted twice in one
    attempt, such as the answer to a question, counts as it was noted last; a participant begins
    once, with the first event that says so.

    :param events: of one participant, in the order in which they happened.
    """
    parts: dict[str, dict[tuple[Any, ...], tuple[int, Event]]] = {}
    for place, event in enumerate(events):
        part = '' if isinstance(event, WHOLE) else event.part
        fact = event.event, getattr(event, 'item', ''), getattr(event, 'rank', 0)
        facts = parts.setdefault(part, {})
        if isinstance(event, PartBegan):
            parts[part] = facts = {k: v for k, v in facts.items() if k[0] == 'learned'}
        if not (isinstance(event, ParticipantBegan) and fact in facts):
            facts[fact] = place, event
    counting = [each for facts in parts.values() for each in facts.values()]
    return [event for _, event in sorted(counting, key=lambda each: each[0])]


@dataclass
class TimeIn:
    """When a participant was at a part, over all sittings."""

    began: float | None = None  # s since 1970, the first time; None: not recorded
    sittings: list[tuple[float, float]] = field(default_factory=list)  # begin and end of each
    open: bool = False

    @property
    def seconds(self) -> float:
        """The sum of all sittings."""
        return sum(end - begin for begin, end in self.sittings)


def times_in(events: Iterable[Event]) -> dict[str, TimeIn]:
    """
    Return the time that a participant was at each part, by its key.

    A sitting lasts from where the part begins until it is left or ends; where neither is recorded,
    since a process or the power failed, until the last sign of life. Where its begin is not
    recorded, it lasts from the first event that is.
    """
    parts: dict[str, TimeIn] = {}
    for event in events:
        if isinstance(event, WHOLE):
            continue
        found, now = parts.setdefault(event.part, TimeIn()), event.time
        if isinstance(event, PartBegan):
            found.began = now if found.began is None else found.began
        if isinstance(event, PartBegan) or not found.sittings:
            found.sittings.append((now, now))
            found.open = True
        elif found.open:
            begin, end = found.sittings[-1]
            found.sittings[-1] = begin, max(end, now)
        found.open = found.open and not isinstance(event, PartLeft | PartEnded)
    return parts
