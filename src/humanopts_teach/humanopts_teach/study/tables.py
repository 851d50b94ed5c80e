"""What a study has found so far: how far each participant is, and tidy tables with a codebook."""

from collections.abc import Iterable, Sequence
from typing import Any

from humanopts_teach.study.events import (
    Answered,
    ButtonSuggested,
    Event,
    FINISHED,
    OptionsLearned,
    PartBegan,
    PartEnded,
    REFUSED,
    TIME,
    times_in,
    WHOLE,
)
from humanopts_teach.study.plan import Kind
from humanopts_teach.study.protocol import Protocol, SHOWN_DIGEST
from humanopts_teach.study.record import left_of, Participant, Record
import pandas as pd

Records = Sequence[tuple[Participant, Record]]


def status_table(protocol: Protocol, records: Records) -> pd.DataFrame:
    """
    Return one row for each participant: how far the study is, by what each one's record says.

    :param protocol: what comes next is that of the version that the participant follows.
    """
    rows = []
    for each, record in records:
        began = record.began
        plan = None if began is None else protocol.plan_of(began.protocol)
        left = [] if plan is None or record.over else left_of(plan.parts_of(each.number), record)
        unknown = '-' if plan is not None or record.over else '?'
        rows.append(
            {
                'participant': each.code,
                'order': '?' if began is None else ', '.join(began.order),
                'parts done': len(record.done),
                'next': left[0].key if left else unknown,
                'minutes': round(record.minutes, 1),
            }
        )
    return pd.DataFrame(rows, columns=['participant', 'order', 'parts done', 'next', 'minutes'])


_APOSTROPHE = (
    '; an apostrophe before =, +, -, @, a tab or a line break is not part of it: it keeps '
    'spreadsheets from running the text as a formula'
)
CODEBOOK = {  # file: column: what it holds
    'participants.csv': {
        'participant': 'code that the person was given',
        'number': 'place in the order of arrival, from 0',
        'simulated': 'whether it is a simulated teacher in place of a person',
        'order': 'conditions in the order in which this person meets them',
        'agreed': 'whether the person agreed to take part; empty: was not asked',
        'ended': 'whether the person came to the end of the study',
        'minutes': 'from the first event to the last, pauses included',
        'protocol': 'begin of the digest of what this person follows, as in protocol.json; empty: '
        'it was not kept',
    },
    'parts.csv': {
        'participant': 'code that the person was given',
        'condition': 'name in the plan; empty: the part belongs to none',
        'part': 'consent, page, play, buttons, teach or questions',
        'place': 'of the condition in the order of this person, from 1; empty: none',
        'began': 's since 1970, when the part began first; empty: that line is damaged',
        'seconds': 'at the part, over all sittings. A sitting that a crash ended lasts until the '
        'last sign of life, which is noted every five seconds',
        'sittings': 'times that the part was begun, or taken up again after it was left',
        'why': f'how it ended; {FINISHED}: by the person; {TIME}: by the limit of the plan; '
        f'{REFUSED}; empty: it has not ended',
    },
    'answers.csv': {
        'participant': 'code that the person was given',
        'condition': 'that the questions are about',
        'item': 'name of the question',
        'value': 'that was chosen, from 1',
        'points': 'of the scale: the greatest value',
    },
    'buttons.csv': {
        'participant': 'code that the person was given',
        'condition': 'in which the buttons were asked for',
        'domain': 'game that they are for',
        'rank': 'in the order of suggestion, from 1',
        'text': f'in the words of the person{_APOSTROPHE}',
    },
    'options.csv': {
        'participant': 'code that the person was given',
        'condition': 'in which the option was taught',
        'option': f'its name, in the words of the person{_APOSTROPHE}',
        'method': 'of learning: trees or goal',
        'demonstrations': 'that were shown and count',
        'not_here': 'start states in which the option cannot start, by the person',
        'criteria_met': 'whether its criteria held at the end',
        'return_shown': 'mean return of the demonstrations, reward units',
        'return_learned': 'mean return of the option from the same starts, reward units',
    },
}


def tables(records: Records) -> dict[str, pd.DataFrame]:
    """
    Return tidy tables by file name, one row for each observation, and the codebook.

    Of a part that was left and begun again, what was answered and suggested last counts.
    """
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in CODEBOOK}
    for each, record in records:
        events = record.counting
        answers = [event.model_dump() for event in events if isinstance(event, Answered)]
        buttons = [event.model_dump() for event in events if isinstance(event, ButtonSuggested)]
        mine = {
            'participants.csv': [_person(each, record, events)],
            'parts.csv': _parts(record, events),
            'answers.csv': answers,
            'buttons.csv': buttons,
            'options.csv': _options(events),
        }
        for name, found in mine.items():
            rows[name] += [{**row, 'participant': each.code} for row in found]
    frames = {
        name: pd.DataFrame(rows[name], columns=list(columns)) for name, columns in CODEBOOK.items()
    }
    book = [
        {'file': name, 'column': column, 'meaning': meaning}
        for name, columns in CODEBOOK.items()
        for column, meaning in columns.items()
    ]
    return {**frames, 'codebook.csv': pd.DataFrame(book)}


def _person(participant: Participant, record: Record, events: Iterable[Event]) -> dict[str, Any]:
    """Return the row of a participant."""
    began, agreed = record.began, ''
    for event in events:
        if isinstance(event, PartEnded) and event.kind is Kind.CONSENT:
            agreed = 'no' if event.why == REFUSED else 'yes'
    return {
        'number': participant.number,
        'simulated': '' if began is None else 'yes' if began.simulated else 'no',
        'order': '' if began is None else ' '.join(began.order),
        'agreed': agreed,
        'ended': 'yes' if record.over else 'no',
        'minutes': round(record.minutes, 2),
        'protocol': '' if began is None else began.protocol[:SHOWN_DIGEST],
    }


def _options(events: Iterable[Event]) -> list[dict[str, Any]]:
    """Return a row for each option that was taught."""
    return [
        {**row, 'condition': event.condition}
        for event in events
        if isinstance(event, OptionsLearned)
        for row in {option.option: option.model_dump() for option in event.options}.values()
    ]


def _parts(record: Record, events: Sequence[Event]) -> list[dict[str, Any]]:
    """Return a row for each part that was begun, in the order in which they began."""
    order = record.began.order if record.began is not None else ()
    kinds = {e.part: e.kind.value for e in record.events if isinstance(e, PartBegan | PartEnded)}
    conditions = {e.part: e.condition for e in record.events if not isinstance(e, WHOLE)}
    why = {event.part: event.why for event in events if isinstance(event, PartEnded)}
    return [
        {
            'condition': conditions[part],
            'part': kinds.get(part, ''),
            'place': order.index(conditions[part]) + 1 if conditions[part] in order else '',
            'began': time.began,
            'seconds': round(time.seconds, 3),
            'sittings': time.sittings,
            'why': why.get(part, ''),
        }
        for part, time in times_in(record.events).items()
    ]
