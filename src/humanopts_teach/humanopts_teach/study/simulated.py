"""A simulated participant: what nobody does is drawn by the seed of the study."""

from collections.abc import Callable, Iterable

from humanopts_env.seeding import generator
from humanopts_teach.evaluation.table1 import TABLE_1
from humanopts_teach.lesson.requests import OptionStatus
from humanopts_teach.study.plan import Kind, Part
from humanopts_teach.study.record import (
    ANSWER,
    BUTTON,
    FINISHED,
    LEARNED,
    learned_rows,
    PART_BEGAN,
    PART_ENDED,
    Record,
)


def simulated_part(
    part: Part,
    record: Record,
    seed: int,
    number: int,
    teach: Callable[[], Iterable[OptionStatus]],
) -> None:
    """
    Do one part of a study.

    Buttons are suggested with the frequencies of Table 1 of the paper; ratings are drawn evenly.

    :param seed: of the study.
    :param number: of the participant.
    :param teach: has a simulated teacher teach, and returns what was learned.
    """
    rng = generator(seed, 'simulated participant', number, part.key)
    place = {'part': part.key, 'condition': part.condition}
    record.note(PART_BEGAN, kind=part.kind.value, **place)
    if part.kind is Kind.TEACH:
        record.note(LEARNED, options=learned_rows(teach()), **place)
    elif part.kind is Kind.BUTTONS:
        shares = TABLE_1.get(part.domain, {})
        named = [name for name, share in shares.items() if rng.random() < share]
        for rank, text in enumerate(named[: part.most], start=1):
            record.note(BUTTON, domain=part.domain, rank=rank, text=text, **place)
    for question in part.questions:
        value = int(rng.integers(1, question.points + 1))
        record.note(ANSWER, item=question.name, value=value, points=question.points, **place)
    record.note(PART_ENDED, kind=part.kind.value, why=FINISHED, **place)
