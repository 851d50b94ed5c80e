"""Results of a study: progress of each participant, and tidy tables with a codebook."""

from collections.abc import Sequence
from typing import Any

from humanopts_teach.study.events import (
    EventKind,
    FINISHED,
    last_attempts,
    REFUSED,
    TIME,
    times_in,
)
from humanopts_teach.study.plan import PartKind
from humanopts_teach.study.protocol import Protocol, SHOWN_DIGEST
from humanopts_teach.study.record import Record
import pandas as pd


def status_table(protocol: Protocol, records: Sequence[Record]) -> pd.DataFrame:
    """
    Return one row per participant with the progress according to the record.

    :param protocol: versions of the plan; the next part is that of the participant's version.
    """
    columns = ['participant', 'order', 'parts done', 'next', 'minutes']
    rows = []
    for record in records:
        began = record.began
        plan = None if began is None else protocol.plan_of(began.protocol)
        left = [] if plan is None else record.remaining(plan.parts_of(record.place, record.number))
        order, after = '?' if began is None else ', '.join(began.order), '-'
        if not record.over:
            after = '?' if plan is None else left[0].key if left else '-'
        minutes = round(record.minutes, 1)
        rows.append((record.code, order, len(record.done), after, minutes))
    return pd.DataFrame(rows, columns=columns)


_APOSTROPHE = (
    '; an apostrophe before =, +, -, @, a tab or a line break is not part of it: it keeps '
    'spreadsheets from running the text as a formula'
)
CODEBOOK = {  # file: column: meaning
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
        'method': 'of learning: trees, forest or goal',
        'demonstrations': 'that were shown and count',
        'not_here': 'start states in which the option cannot start, by the person',
        'criteria_met': 'whether its criteria held at the end',
        'questions': 'about runs of the machine that the person answered',
        'exam_right': 'runs in the newest exam that the person called right',
        'exam_runs': 'runs in the newest exam',
        'exams_failed': 'exams before it that ended with a wrong run',
        'learned': 'whether the criteria held and the exam was passed at the end',
        'status': 'the same in words, or what was missing',
        'return_shown': 'mean return of the demonstrations, reward units',
        'return_learned': 'mean return of the option from the same starts, reward units',
    },
}


def tables(records: Sequence[Record]) -> dict[str, pd.DataFrame]:
    """
    Return tidy tables by file name, one row per observation, and the codebook.

    If a part was restarted, only the answers and suggestions of the last attempt count.
    """

    def rows(kind: EventKind) -> list[dict[str, Any]]:
        return [
            event.model_dump() | {'participant': record.code}
            for record in records
            for event in last_attempts(record.events)
            if event.event == kind
        ]

    found = {
        'participants.csv': [_person(record) for record in records],
        'parts.csv': [row for record in records for row in _parts(record)],
        'answers.csv': rows('answer'),
        'buttons.csv': rows('button'),
        'options.csv': [
            row | option
            for row in rows('learned')
            for option in {each['option']: each for each in row['options']}.values()
        ],
    }
    frames = {
        name: pd.DataFrame(found[name], columns=list(columns))
        for name, columns in CODEBOOK.items()
    }
    book = [
        (name, *described) for name, columns in CODEBOOK.items() for described in columns.items()
    ]
    return {**frames, 'codebook.csv': pd.DataFrame(book, columns=['file', 'column', 'meaning'])}


def _person(record: Record) -> dict[str, Any]:
    """Return a participant's row."""
    began, agreed = record.began, ''
    for event in record.of('part ended'):
        if event.kind is PartKind.CONSENT:
            agreed = 'no' if event.why == REFUSED else 'yes'
    row = {
        'participant': record.code,
        'number': record.number,
        'agreed': agreed,
        'ended': 'yes' if record.over else 'no',
        'minutes': round(record.minutes, 2),
    }
    if began is not None:
        row |= {
            'simulated': 'yes' if began.simulated else 'no',
            'order': ' '.join(began.order),
            'protocol': began.protocol[:SHOWN_DIGEST],
        }
    return row


def _parts(record: Record) -> list[dict[str, Any]]:
    """Return a row for each started part, in order of their start."""
    order = record.began.order if record.began is not None else ()
    kinds = {event.part: event.kind.value for event in record.events if event.kind}
    conditions = {event.part: event.condition for event in record.events}
    why = {e.part: e.why for e in last_attempts(record.events) if e.event == 'part ended'}
    return [
        {
            'participant': record.code,
            'condition': (condition := conditions[part]),
            'part': kinds.get(part, ''),
            'place': order.index(condition) + 1 if condition in order else '',
            'began': found.began,
            'seconds': round(found.seconds, 3),
            'sittings': len(found.sittings),
            'why': why.get(part, ''),
        }
        for part, found in times_in(record.events).items()
    ]
