"""Progress of a study: the state of each participant, and the places of each order."""

from collections.abc import Container, Sequence

from humanopts_teach.study.plan import balanced_latin_square, Order, StudyPlan
from humanopts_teach.study.protocol import Protocol
from humanopts_teach.study.record import Record
import pandas as pd


def participants_table(
    protocol: Protocol,
    records: Sequence[Record],
    running: Container[str],
    hours: float,
    now: float,
) -> pd.DataFrame:
    """
    Return one row per participant.

    :param protocol: versions of the plan; each person follows one of them.
    :param running: codes of the participants who are taking part now.
    :param hours: absence after which a place is released, hours; 0: never.
    :param now: current time, s since 1970.
    """
    columns = ['participant', 'order', 'state', 'parts done', 'parts', 'next', 'minutes']
    rows = []
    for record in records:
        began = record.began
        plan = None if began is None else protocol.plan_of(began.protocol)
        parts = [] if plan is None else plan.parts_of(record.place, record.number)
        left = record.remaining(parts)
        if record.excluded:
            state = 'excluded'
        elif record.over:
            state = 'finished'
        elif record.code in running:
            state = 'running'
        else:
            state = 'left' if record.holds_place(hours, now) else 'left, place free'
        after = '-' if record.over else left[0].key if left else '?'
        order = '?' if began is None else ', '.join(began.order)
        done, minutes = len(record.done), round(record.minutes, 1)
        rows.append((record.code, order, state, done, len(parts), after, minutes))
    return pd.DataFrame(rows, columns=columns)


def places_table(plan: StudyPlan, records: Sequence[Record], now: float) -> pd.DataFrame:
    """
    Return the numbers of places finished, under way and free, for each order of conditions.

    If the number of participants is unlimited, the column of free places is omitted.
    """
    holding = [each for each in records if each.holds_place(plan.return_within, now)]
    taken = {each.place for each in holding}
    orders = {
        Order.FIXED: 1,
        Order.ONE: len(plan.conditions),
        Order.BALANCED: len(balanced_latin_square(len(plan.conditions))),
    }
    count = plan.participants or max([orders.get(plan.order, 1), *(place + 1 for place in taken)])
    rows: dict[str, dict[str, int]] = {}
    for place in range(count):
        order = ', '.join(condition.name for condition in plan.order_of(place))
        row = rows.setdefault(order, {'finished': 0, 'under way': 0, 'places left': 0})
        row['places left'] += place not in taken
        for each in holding:
            if each.place == place:
                row['finished' if each.over else 'under way'] += 1
    table = pd.DataFrame.from_dict(rows, orient='index').rename_axis('order').reset_index()
    return table if plan.participants else table.drop(columns='places left')
