"""What a study has found so far: how far each participant is, and tidy tables with a codebook."""

from collections.abc import Sequence
from typing import Any

from humanopts_teach.study.plan import Kind, StudyPlan
from humanopts_teach.study.record import (
    ANSWER,
    BUTTON,
    ENDED,
    Event,
    FINISHED,
    LEARNED,
    left_of,
    PART_BEGAN,
    PART_ENDED,
    Record,
    REFUSED,
    StudyFolder,
    TIME,
)
import pandas as pd


def status_table(plan: StudyPlan, folder: StudyFolder) -> pd.DataFrame:
    """Return one row for each participant: how far the study is."""
    rows = []
    for each in folder.participants():
        record = Record(each.path)
        left = [] if record.over else left_of(plan.parts_of(each.number), record)
        rows.append(
            {
                'participant': each.code,
                'order': ', '.join(condition.name for condition in plan.order_of(each.number)),
                'parts done': len(record.done),
                'next': left[0].key if left else '-',
                'minutes': round((record.events[-1]['time'] - record.events[0]['time']) / 60, 1),
            }
        )
    return pd.DataFrame(rows, columns=['participant', 'order', 'parts done', 'next', 'minutes'])


CODEBOOK = {  # file: column: what it holds
    'participants.csv': {
        'participant': 'code that the person was given',
        'number': 'place in the order of arrival, from 0',
        'simulated': 'whether it is a simulated teacher in place of a person',
        'order': 'conditions in the order in which this person meets them',
        'agreed': 'whether the person agreed to take part; empty: was not asked',
        'ended': 'whether the person came to the end of the study',
        'minutes': 'from the first event to the last, pauses included',
    },
    'parts.csv': {
        'participant': 'code that the person was given',
        'condition': 'name in the plan; empty: the part belongs to none',
        'part': 'consent, page, play, buttons, teach or questions',
        'place': 'of the condition in the order of this person, from 1; empty: none',
        'began': 's since 1970, when the part began; where it was begun again, the last time',
        'seconds': 'from then to its end',
        'why': f'{FINISHED}: by the person; {TIME}: by the limit of the plan; {REFUSED}',
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
        'text': 'in the words of the person',
    },
    'options.csv': {
        'participant': 'code that the person was given',
        'condition': 'in which the option was taught',
        'option': 'its name, in the words of the person',
        'method': 'of learning: trees or goal',
        'demonstrations': 'that were shown and count',
        'not_here': 'start states in which the option cannot start, by the person',
        'criteria_met': 'whether its criteria held at the end',
        'return_shown': 'mean return of the demonstrations, reward units',
        'return_learned': 'mean return of the option from the same starts, reward units',
    },
}


_FILES = {ANSWER: 'answers.csv', BUTTON: 'buttons.csv'}


def tables(folder: StudyFolder) -> dict[str, pd.DataFrame]:
    """Return tidy tables by file name, one row for each observation, and the codebook."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in CODEBOOK}
    for each in folder.participants():
        events = Record(each.path).events
        _add_participant(rows, each.code, events)
        for event in events:
            common = {'participant': each.code, 'condition': event.get('condition', '')}
            if event['event'] == LEARNED:
                rows['options.csv'] += [{**common, **option} for option in event['options']]
            elif event['event'] in _FILES:  # of whose fields the table has its columns
                rows[_FILES[event['event']]].append({**event, **common})
    found = {
        name: pd.DataFrame(rows[name], columns=list(columns)) for name, columns in CODEBOOK.items()
    }
    book = [
        {'file': name, 'column': column, 'meaning': meaning}
        for name, columns in CODEBOOK.items()
        for column, meaning in columns.items()
    ]
    return {**found, 'codebook.csv': pd.DataFrame(book)}


def _add_participant(
    rows: dict[str, list[dict[str, Any]]], code: str, events: Sequence[Event]
) -> None:
    if not events:
        return
    order, agreed = events[0].get('order', []), ''
    began: dict[str, float] = {}
    for event in events:
        if event['event'] == PART_BEGAN:
            began[event['part']] = event['time']
        elif event['event'] == PART_ENDED:
            if event['kind'] == Kind.CONSENT.value:
                agreed = 'no' if event['why'] == REFUSED else 'yes'
            condition = event['condition']
            place = order.index(condition) + 1 if condition in order else ''
            since = began.get(event['part'], event['time'])
            seconds = round(event['time'] - since, 3)
            values = code, condition, event['kind'], place, since, seconds, event['why']
            rows['parts.csv'].append(dict(zip(CODEBOOK['parts.csv'], values)))
    simulated = 'yes' if events[0].get('simulated') else 'no'
    ended = 'yes' if events[-1]['event'] == ENDED else 'no'
    minutes = round((events[-1]['time'] - events[0]['time']) / 60, 2)
    number = events[0].get('number', '')
    person = code, number, simulated, ' '.join(order), agreed, ended, minutes
    rows['participants.csv'].append(dict(zip(CODEBOOK['participants.csv'], person)))
