"""
The plan of a study: its conditions, what a participant does in each, and in which order.

A plan is a YAML file; pages are Markdown files beside it. Every participant goes through all
conditions. The order is counterbalanced by a rule, so that it is known beforehand for each.
"""

from collections.abc import Iterable
from enum import Enum
from functools import cache
import json
from pathlib import Path
import re
from typing import Annotated, Any, ClassVar, Self, TypeVar

from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import check_method
from humanopts_learner.options.starts import STRATEGIES
from humanopts_ros.limits import shown
from humanopts_ros.text_files import fault_in, FileError, read_text, read_yaml
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)

QUESTIONNAIRES = Path(__file__).parent  # of those that are shipped
SHIPPED = 'nasa-tlx'
_CONTROL = re.compile(r'[\x00-\x08\x0b-\x1f\x7f-\x9f]')  # all but tabs and line breaks
MAX_POINTS = 21
MAX_CONDITIONS = 100
MAX_ITEMS = 200  # of a questionnaire
MAX_PAGES = 100  # of a file
MAX_PAGE = 100_000  # characters of a file of pages
MAX_LINE = 2000  # characters of a question, a label or another text of a plan
MAX_MINUTES = 10**6


class PlanFileError(ValueError):
    """A plan cannot be used; the text names the place and says why."""


class _Values(BaseModel):
    """Values of a file, none of which is converted."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True, extra='forbid')


M = TypeVar('M', bound=_Values)


def _plain(text: str) -> str:
    if _CONTROL.search(text):
        raise ValueError('remove the control characters')
    return text


def _given(value: Any) -> Any:
    if value is None:
        raise ValueError('give a text, or leave the key out')
    return value


def _as_name(text: str) -> str:
    if not re.fullmatch(r'[A-Za-z0-9_-]{1,40}', text):
        raise ValueError('use at most 40 letters, digits, - and _')
    return text


def _distinct(named: tuple[Any, ...]) -> tuple[Any, ...]:
    names = [each.name for each in named]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f'the name {twice} is used twice')
    return named


Text = Annotated[
    str,
    StringConstraints(strip_whitespace=True, min_length=1, max_length=MAX_LINE),
    BeforeValidator(lambda value: str(value) if type(value) is int else value),  # as written
    AfterValidator(_plain),
]
Name = Annotated[Text, AfterValidator(_as_name)]
Given = Annotated[Text | None, BeforeValidator(_given)]  # None: the key is not there
Whole = Annotated[int, Field(ge=0, lt=2**31)]
Minutes = Annotated[float, Field(ge=0, lt=MAX_MINUTES)]


class Order(Enum):
    """How the order of the conditions is chosen for each participant."""

    FIXED = 'fixed'  # as in the plan
    BALANCED = 'balanced'  # by the rows of a balanced Latin square, one after the other
    RANDOM = 'random'  # drawn by the study's seed and the participant's number


class PartKind(Enum):
    """What a participant does in one part."""

    CONSENT = 'consent'  # reads a page, and agrees or not
    PAGE = 'page'  # reads a page
    PLAY = 'play'  # drives freely
    BUTTONS = 'buttons'  # suggests buttons that make winning easier and faster
    TEACH = 'teach'
    QUESTIONS = 'questions'


class Question(_Values):
    """One item of a questionnaire."""

    name: Name
    text: Text
    low: Text  # what 1 means
    high: Text  # what the last point means


class Questionnaire(_Values):
    """Questions that are answered on a Likert scale of 1 to ``points``."""

    items: Annotated[
        tuple[Question, ...],
        Field(min_length=1, max_length=MAX_ITEMS),
        AfterValidator(_distinct),
    ]
    points: Annotated[int, Field(ge=2, le=MAX_POINTS)] = 7


class Part(_Values):
    """One thing that a participant does."""

    kind: PartKind
    key: str  # unique in the study, such as trees/teach
    condition: str = ''  # empty: of no condition
    domain: str = ''
    text: str = ''  # of a page, Markdown
    minutes: float = 0.0  # after which it ends by itself; 0: never
    most: int = 0  # buttons that can be suggested
    questions: Questionnaire | None = None


PARTS = TypeAdapter(tuple[Part, ...])


class Condition(_Values):
    """One way to teach that the study compares; times are minutes, and 0 leaves a part out."""

    name: Name
    domain: Text
    parameters: dict[str, Any] = {}
    learn: Text = METHOD
    strategy: Text = STRATEGY
    budget: Annotated[int, Field(ge=1, lt=2**31)] = BUDGET
    page: Given = None  # file in Markdown, shown first
    free_play: Minutes = 0.0
    buttons: Whole = 0  # largest number to suggest; 0: the part is left out
    teach: Annotated[float, Field(gt=0, lt=MAX_MINUTES)] = 20.0  # the most that teaching takes
    questions: Given = None  # file, or the name of a questionnaire that is shipped


class _PlanFile(_Values):
    """What the file of a plan says."""

    study: Name
    conditions: Annotated[
        tuple[Condition, ...],
        Field(min_length=1, max_length=MAX_CONDITIONS),
        AfterValidator(_distinct),
    ]
    consent: Given = None
    welcome: Given = None
    thanks: Given = None
    order: Order = Order.BALANCED
    participants: Whole = 0  # that are planned; 0: any number
    seed: Whole = 1

    @model_validator(mode='after')
    def _can_be_balanced(self) -> Self:
        orders, count = len(balanced_latin_square(len(self.conditions))), self.participants
        if self.order is Order.BALANCED and count % orders:
            fitting = {max(1, count // orders) * orders, (count // orders + 1) * orders}
            raise ValueError(
                f'{count} participants cannot be balanced over the {orders} orders of '
                f'{len(self.conditions)} conditions: plan for '
                f'{" or ".join(map(str, sorted(fitting)))}, or give order: random'
            )
        return self


class StudyPlan(_PlanFile):
    """A whole study, with the contents of the files that its plan names."""

    pages: dict[str, tuple[str, ...]]  # by name of the file
    questionnaires: dict[str, Questionnaire]

    def order_of(self, number: int) -> list[Condition]:
        """
        Return the conditions in the order of a participant.

        :param number: of the participant in the order of arrival, from 0.
        """
        indices = list(range(len(self.conditions)))
        if self.order is Order.BALANCED:
            square = balanced_latin_square(len(indices))
            indices = square[number % len(square)]
        elif self.order is Order.RANDOM:
            indices = generator(self.seed, 'order', number).permutation(indices).tolist()
        return [self.conditions[index] for index in indices]

    def turns_of(self, number: int) -> list[tuple[Condition, list[Part]]]:
        """
        Return what a participant does in each condition, in order, and around it.

        The parts are in the order of the paper's experiments. Buttons for a game are asked for
        once, in the first condition that asks for them.
        """
        turns: list[tuple[Condition, list[Part]]] = []
        asked: set[str] = set()
        for each in self.order_of(number):
            name, parts = each.name, self._page(each.page, f'{each.name}/page')
            if each.free_play:
                parts.append(Part(kind=PartKind.PLAY, key=f'{name}/play', minutes=each.free_play))
            if each.buttons and each.domain not in asked:
                asked.add(each.domain)
                parts.append(Part(kind=PartKind.BUTTONS, key=f'{name}/buttons', most=each.buttons))
            parts.append(Part(kind=PartKind.TEACH, key=f'{name}/teach', minutes=each.teach))
            if each.questions:
                questions = self.questionnaires[each.questions]
                parts.append(
                    Part(kind=PartKind.QUESTIONS, key=f'{name}/questions', questions=questions)
                )
            where = {'condition': name, 'domain': each.domain}
            turns.append((each, [part.model_copy(update=where) for part in parts]))
        turns[0][1][:0] = [
            *self._page(self.consent, 'consent', PartKind.CONSENT),
            *self._page(self.welcome, 'welcome'),
        ]
        turns[-1][1].extend(self._page(self.thanks, 'thanks'))
        return turns

    def parts_of(self, number: int) -> list[Part]:
        """Return everything that a participant does, in order."""
        return [part for _, parts in self.turns_of(number) for part in parts]

    def _page(self, file: str | None, key: str, kind: PartKind = PartKind.PAGE) -> list[Part]:
        """Return the parts of the pages of a file; only the last is of the kind."""
        pages = self.pages[file] if file else ()
        return [
            Part(kind=PartKind.PAGE, key=f'{key}/{number}', text=text)
            if number < len(pages)
            else Part(kind=kind, key=key, text=text)
            for number, text in enumerate(pages, start=1)
        ]


def balanced_latin_square(count: int) -> list[list[int]]:
    """
    Return orders of ``count`` conditions in which each follows each other one equally often.

    The design of Williams (1949): ``count`` orders, or twice as many where ``count`` is odd.
    """
    first = [0]
    for step in range(1, count):
        first.append((step + 1) // 2 if step % 2 else count - step // 2)
    rows = [[(index + row) % count for index in first] for row in range(count)]
    return rows + [row[::-1] for row in rows] if count % 2 and count > 1 else rows


def read_plan(path: Path) -> StudyPlan:
    """
    Read a plan and the files that it names.

    :raises PlanFileError: a file cannot be read, or the plan cannot be carried out.
    """
    try:
        values = read_yaml(path)
        if isinstance(values, dict):
            values = {'study': path.stem, **values}
            every, conditions = values.pop('all', {}), values.get('conditions')
            if isinstance(every, dict) and isinstance(conditions, list):
                values['conditions'] = [
                    {**every, **each} if isinstance(each, dict) else each for each in conditions
                ]
        plan = _validated(_PlanFile, values)
        files = {plan.consent, plan.welcome, plan.thanks, *(c.page for c in plan.conditions)}
        asked = {each.questions for each in plan.conditions}
        return StudyPlan(
            **plan.model_dump(exclude_none=True)
            | {'conditions': tuple(_playable(plan.conditions))},
            pages={name: _pages(path.parent / name) for name in sorted(filter(None, files))},
            questionnaires={
                name: _questionnaire(path.parent, name) for name in sorted(filter(None, asked))
            },
        )
    except FileError as error:
        raise PlanFileError(str(error)) from error


def read_name(path: Path) -> str:
    """
    Return the name of the study of a plan, whatever else the plan says.

    :raises PlanFileError: the file cannot be read, or the name cannot be used.
    """
    try:
        values = read_yaml(path)
        name = values.get('study', path.stem) if isinstance(values, dict) else path.stem
        return TypeAdapter(Name).validate_python(name)
    except FileError as error:
        raise PlanFileError(str(error)) from error
    except ValidationError as error:
        raise PlanFileError(f'study: {fault_in(error)}') from error


def _playable(conditions: Iterable[Condition]) -> Iterable[Condition]:
    """
    Yield the conditions, each of which can be taught as it says; equal games are made once.

    Parameters become those that the game itself gives: what a file held in place of its name.
    """
    made = cache(lambda domain, parameters: make_domain(domain, json.loads(parameters)))
    for each in conditions:
        try:
            game = made(each.domain, json.dumps(each.parameters))
            check_method(each.learn, game)
            if each.strategy not in STRATEGIES:
                raise ValueError(f'strategy: use one of {", ".join(STRATEGIES)}')
        except ValueError as error:
            raise PlanFileError(f'condition {each.name}: {shown(str(error))}') from error
        given = {name: game.parameters.get(name, value) for name, value in each.parameters.items()}
        yield each.model_copy(update={'parameters': given})


def _pages(path: Path) -> tuple[str, ...]:
    """Return the pages of a file, which a line of --- divides."""
    text = read_text(path, 4 * MAX_PAGE)
    if len(text) > MAX_PAGE:
        raise PlanFileError(f'{path.name} has {len(text):,} characters; the limit is {MAX_PAGE:,}')
    if found := _CONTROL.search(text):
        line = text.count('\n', 0, found.start()) + 1
        raise PlanFileError(f'{path.name}: remove the control character in line {line}')
    pages = re.split(r'^-{3,}[ \t]*$', text, flags=re.MULTILINE)
    if len(pages) > MAX_PAGES:
        raise PlanFileError(f'{path.name} has {len(pages):,} pages; the limit is {MAX_PAGES}')
    return tuple(pages)


def _questionnaire(folder: Path, name: str) -> Questionnaire:
    path = QUESTIONNAIRES / 'nasa_tlx.yaml' if name == SHIPPED else folder / name
    try:
        return _validated(Questionnaire, read_yaml(path))
    except PlanFileError as error:
        raise PlanFileError(f'{path.name}: {error}') from error


def _validated(kind: type[M], values: Any) -> M:
    """
    Return what the values of a file say.

    :raises PlanFileError: they cannot be used.
    """
    if not isinstance(values, dict):
        raise PlanFileError('the file has to map names to values')
    try:
        return kind.model_validate_json(json.dumps(values))
    except ValidationError as error:
        inner: dict[Any, type[_Values]] = {'conditions': Condition, 'items': Question}
        first = next(iter(error.errors()[0]['loc']), '')
        raise PlanFileError(fault_in(error, inner.get(first, kind).model_fields)) from None
