"""Questions of a study: their kinds, valid answers, and attention checks."""

from enum import Enum
import re
from typing import Annotated, Any, ClassVar, Literal, Self

from humanopts_env.seeding import generator
from humanopts_ros.limits import composed
import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
    StringConstraints,
)

CONTROL = re.compile(r'[\x00-\x08\x0b-\x1f\x7f-\x9f]')  # except tabs and line feeds
MAX_POINTS = 21
MAX_ITEMS = 200  # items per questionnaire
MAX_OPTIONS = 50  # options per question
MAX_LINE = 2000  # characters of a question, label or other text
MAX_TEXT = 1000  # characters of an answer
MAX_NUMBER = 10**12


class Values(BaseModel):
    """A strict model of a file, without type conversion."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True, extra='forbid')


def _plain(text: str) -> str:
    if CONTROL.search(text):
        raise ValueError('remove the control characters')
    return text


def _as_name(text: str) -> str:
    if not re.fullmatch(r'[A-Za-z0-9_-]{1,40}', text):
        raise ValueError('use at most 40 letters, digits, - and _')
    return text


def different(names: tuple[str, ...]) -> tuple[str, ...]:
    """Reject duplicate names."""
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f'{twice!r} is given twice')
    return names


def distinct(named: tuple[Any, ...]) -> tuple[Any, ...]:
    """Reject two items with the same name."""
    different(tuple(each.name for each in named))
    return named


def short(text: str, most: int) -> str:
    """Reject a text that is too long."""
    if len(text) > most:
        raise ValueError(f'use at most {most} characters')
    return text


_as_written = BeforeValidator(lambda value: str(value) if type(value) is int else value)
Text = Annotated[
    str,
    StringConstraints(strip_whitespace=True, min_length=1, max_length=MAX_LINE),
    _as_written,
    AfterValidator(_plain),
]
Label = Annotated[  # empty: not given
    str,
    StringConstraints(strip_whitespace=True, max_length=MAX_LINE),
    _as_written,
    AfterValidator(_plain),
]
Name = Annotated[Text, AfterValidator(_as_name)]
Number = (
    Annotated[int, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
    | Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER, allow_inf_nan=False)]
)
Answer = (
    Number
    | Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(composed)]
    | Annotated[
        tuple[Annotated[int, Field(ge=1, le=MAX_OPTIONS)], ...],
        Field(strict=False, max_length=MAX_OPTIONS),
    ]
)


class QuestionKind(Enum):
    """The kind of question; the value of an answer is in brackets."""

    RATING = 'rating'  # a point of the scale (1 to ``points``)
    CHOICE = 'choice'  # one option (its index from 1)
    CHOICES = 'choices'  # one or more options (their indices from 1, ascending)
    NUMBER = 'number'  # a number (int or float)
    TEXT = 'text'  # free text


_SETTINGS = {
    QuestionKind.RATING: ('low', 'high'),
    QuestionKind.CHOICE: ('options',),
    QuestionKind.CHOICES: ('options',),
    QuestionKind.NUMBER: ('least', 'most', 'unit'),
    QuestionKind.TEXT: ('most',),
}


class Question(Values):
    """One item of a questionnaire."""

    name: Name
    text: Text
    kind: QuestionKind = QuestionKind.RATING
    low: Label = ''  # label of the lowest point of a rating, 1
    high: Label = ''  # label of the highest point of a rating
    options: Annotated[tuple[Text, ...], Field(max_length=MAX_OPTIONS)] = ()  # of a choice
    least: Number | None = None  # minimum of a number; None: no limit
    most: Number | None = None  # maximum of a number, or length of a text; None: no limit
    unit: Label = ''  # of a number
    optional: bool | None = None  # whether it may be skipped; None: only if it is a text
    expect: Answer | None = None  # expected answer to an attention check; None: not a check

    @property
    def skippable(self) -> bool:
        """Whether the question may be left unanswered."""
        return self.kind is QuestionKind.TEXT if self.optional is None else self.optional

    @property
    def max_characters(self) -> int:
        """The maximum number of characters of a text answer."""
        return MAX_TEXT if self.most is None else int(self.most)

    @model_validator(mode='after')
    def _fits_its_kind(self) -> Self:
        given = {
            name
            for name in ('low', 'high', 'options', 'least', 'most', 'unit')
            if getattr(self, name) not in ('', (), None)
        }
        kind, allowed = self.kind, _SETTINGS[self.kind]
        if other := sorted(given.difference(allowed)):
            raise ValueError(f'{other[0]} does not belong to a question of kind {kind.value}')
        if kind is QuestionKind.RATING and len(given) < 2:
            raise ValueError('give low and high, the labels of the ends of the scale')
        if 'options' in allowed and len(set(self.options)) < max(2, len(self.options)):
            raise ValueError('give at least two options, all of them different')
        both = kind is QuestionKind.NUMBER and self.least is not None and self.most is not None
        if both and self.least > self.most:  # type: ignore[operator]
            raise ValueError('least is greater than most')
        if kind is QuestionKind.TEXT and not 1 <= self.max_characters <= MAX_TEXT:
            raise ValueError(f'most: use 1 to {MAX_TEXT} characters')
        return self

    def accepts(self, value: Any, points: int) -> bool:
        """
        Return whether a value is a valid answer; None: skipped.

        :param points: number of points of the rating scale.
        """
        whole, count = type(value) is int, len(self.options)
        match self.kind:
            case _ if value is None:
                return self.skippable
            case QuestionKind.RATING:
                return whole and 1 <= value <= points
            case QuestionKind.CHOICE:
                return whole and 1 <= value <= count
            case QuestionKind.CHOICES:
                listed = isinstance(value, tuple) and list(value) == sorted(set(value))
                return bool(listed and value) and all(1 <= each <= count for each in value)
            case QuestionKind.NUMBER:
                low = -MAX_NUMBER if self.least is None else self.least
                high = MAX_NUMBER if self.most is None else self.most
                return (whole or isinstance(value, float)) and bool(low <= value <= high)
        return isinstance(value, str) and 1 <= len(value) <= self.max_characters

    def draw(self, rng: np.random.Generator, points: int) -> Any:
        """Return a random answer, or the expected one to an attention check."""
        if self.expect is not None:
            return self.expect
        match self.kind:
            case QuestionKind.RATING:
                return int(rng.integers(1, points + 1))
            case QuestionKind.CHOICE:
                return int(rng.integers(1, len(self.options) + 1))
            case QuestionKind.CHOICES:
                count = int(rng.integers(1, len(self.options) + 1))
                chosen = rng.choice(len(self.options), count, replace=False) + 1
                return tuple(sorted(map(int, chosen)))
            case QuestionKind.NUMBER:
                low = min(0, self.most or 0) if self.least is None else self.least
                high = low + 100 if self.most is None else self.most
                whole = isinstance(low, int) and isinstance(high, int)
                drawn = rng.uniform(low, high)
                return round(drawn) if whole else float(drawn)
        return 'a simulated answer'[: self.max_characters]

    def passes(self, value: Any) -> bool:
        """Return whether an answer is the expected one."""
        if isinstance(value, str) and isinstance(self.expect, str):
            return value.strip().casefold() == self.expect.strip().casefold()
        return bool(value == self.expect)


class Questionnaire(Values):
    """A list of questions; ratings use a Likert scale from 1 to ``points``."""

    items: Annotated[
        tuple[Question, ...],
        Field(min_length=1, max_length=MAX_ITEMS),
        AfterValidator(distinct),
    ]
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)] = 7
    order: Literal['fixed', 'random'] = 'fixed'  # random: drawn for each participant

    @model_validator(mode='after')
    def _expects_answers(self) -> Self:
        for item in self.items:
            if item.expect is not None and not item.accepts(item.expect, self.points):
                raise ValueError(f'{item.name}: no one can give the answer that is expected')
        return self

    def arranged(self, seed: int, number: int, key: str) -> Self:
        """
        Return the questionnaire with its items in the order for a participant.

        :param number: index of the participant in order of arrival, from 0.
        :param key: key of the part.
        """
        if self.order == 'fixed':
            return self
        order = generator(seed, 'items', number, key).permutation(len(self.items))
        return self.model_copy(update={'items': tuple(self.items[index] for index in order)})
