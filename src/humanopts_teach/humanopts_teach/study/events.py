"""
What happens in a study, as lines of JSON: one schema for each kind of event.

Every line that comes from a file or a bag is validated here; what does not fit is never counted.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import json
from typing import Annotated, Any, ClassVar, Literal

from humanopts_ros.limits import composed, parse_json, shown
from humanopts_teach.lesson.store import CODE
from humanopts_teach.study.plan import Kind, MOST_POINTS
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

FINISHED, TIME, REFUSED = 'finished', 'time is over', 'not agreed'  # why a part ended
MAX_LINE = 1_000_000  # characters of an event


def _text(text: str) -> str:
    """Return a text in composed form; half a surrogate pair cannot be written to any file."""
    if any('\ud800' <= char <= '\udfff' for char in text):
        raise ValueError('it holds half a character')
    return composed(text)


Text = Annotated[str, Field(max_length=1000), AfterValidator(_text)]
Word = Annotated[Text, Field(min_length=1)]
Count = Annotated[int, Field(ge=0, lt=2**31)]
Rank = Annotated[int, Field(ge=1, lt=2**31)]
Return = Annotated[float, Field(allow_inf_nan=False)]  # reward units


class _Values(BaseModel):
    """Values that are never converted; a field more is of no account."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True)


class _Event(_Values):
    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970

    def line(self) -> str:
        """Return the event as a line of JSON, without the line's end."""
        return json.dumps(self.model_dump(mode='json'), sort_keys=True)


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
    kind: Kind = Field(strict=False)


class SignOfLife(_OfPart):
    """The participant is still at a part; after a crash, the time until then counts."""

    event: Literal['still there'] = 'still there'


class PartLeft(_OfPart):
    """The participant left in the middle of a part."""

    event: Literal['part left'] = 'part left'


class PartEnded(_OfPart):
    """A part ended."""

    event: Literal['part ended'] = 'part ended'
    kind: Kind = Field(strict=False)
    why: Literal['finished', 'time is over', 'not agreed']


class Answered(_OfPart):
    """A question was answered."""

    event: Literal['answer'] = 'answer'
    item: Word
    value: Rank
    points: Annotated[int, Field(ge=2, le=MOST_POINTS)]  # of the scale


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
_LEARNED = 'learned'
_EVENT: TypeAdapter[Event] = TypeAdapter(Annotated[Event, Field(discriminator='event')])


def event_of(line: str) -> Event:
    """
    Return the event of a line.

    :raises ValueError: it is no event; the text is one line.
    """
    values = parse_json(line, MAX_LINE)
    try:
        event = _EVENT.validate_python(values)
    except ValidationError as error:
        raise ValueError(_faults(error, values)) from None
    if isinstance(event, Answered) and event.value > event.points:
        raise ValueError(f'answer: value {event.value} is not on its scale of {event.points}')
    return event


def _faults(error: ValidationError, values: Any) -> str:
    """Return what is wrong with the values of an event, in one line."""
    kind = values.get('event') if isinstance(values, Mapping) else None
    if error.errors()[0]['type'].startswith('union_tag') or not isinstance(kind, str):
        return 'it is no event of a study'
    found = error.errors(include_url=False, include_input=False)
    lacking = ['.'.join(map(str, each['loc'][1:])) for each in found if each['type'] == 'missing']
    faults = [f'it has no {", ".join(lacking)}'] if lacking else []
    faults += [
        f'{".".join(map(str, each["loc"][1:]))}: {each["msg"]}'
        for each in found
        if each['type'] != 'missing'
    ]
    return shown(f'{kind}: {"; ".join(faults)}')


def last_attempts(events: Iterable[Event]) -> list[Event]:
    """
    Return the events that count: one for each fact, and of the last attempt at each part.

    A part that was left is begun again, which supersedes what was answered and suggested in it.
    What was taught goes on, so the last list of options counts. A fact that is noted twice in one
    attempt, such as the answer to a question, counts as it was noted last; a participant begins
    once, with the first event that says so.

    :param events: of one participant, in the order in which they happened.
    """
    of_parts: dict[str, dict[tuple[object, ...], tuple[int, Event]]] = {}
    for place, event in enumerate(events):
        facts = of_parts.setdefault('' if isinstance(event, WHOLE) else event.part, {})
        if isinstance(event, PartBegan):
            facts = {fact: each for fact, each in facts.items() if fact == (_LEARNED,)}
            of_parts[event.part] = facts
        if not (isinstance(event, ParticipantBegan) and (event.event,) in facts):
            facts[_fact(event)] = place, event
    counting = [each for facts in of_parts.values() for each in facts.values()]
    return [event for _, event in sorted(counting, key=lambda each: each[0])]


def _fact(event: Event) -> tuple[object, ...]:
    """Return what an event says something about, within its part."""
    match event:
        case Answered():
            return event.event, event.item
        case ButtonSuggested():
            return event.event, event.rank
        case _:
            return (event.event,)


@dataclass(frozen=True)
class TimeIn:
    """When a participant was at a part, over all sittings."""

    began: float | None  # s since 1970, the first time; None: not recorded
    seconds: float  # at it
    sittings: int  # times that it was begun or taken up again


def times_in(events: Iterable[Event]) -> dict[str, TimeIn]:
    """
    Return the time that a participant was at each part, by its key.

    A sitting lasts from where the part begins until it is left or ends; where neither is recorded,
    since a process or the power failed, until the last sign of life. Where its begin is not
    recorded, it lasts from the first event that is.
    """
    of_parts: dict[str, list[PartEvent]] = {}
    for event in events:
        if not isinstance(event, WHOLE):
            of_parts.setdefault(event.part, []).append(event)
    return {part: _time_in(mine) for part, mine in of_parts.items()}


def _time_in(events: Sequence[PartEvent]) -> TimeIn:
    """Return the time that a participant was at one part."""
    began: float | None = None
    seconds, sittings = 0.0, 0
    since = until = 0.0  # of the sitting
    goes_on = over = False
    for event in events:
        begins = isinstance(event, PartBegan)
        if begins or not (goes_on or over):
            seconds += until - since
            since = until = event.time
            sittings, goes_on = sittings + 1, True
            began = event.time if begins and began is None else began
        if goes_on:
            until = max(until, event.time)
        over = isinstance(event, PartLeft | PartEnded) or (over and not begins)
        goes_on = goes_on and not over
    return TimeIn(began, seconds + until - since, sittings)
