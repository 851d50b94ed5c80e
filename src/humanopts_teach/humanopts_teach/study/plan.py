"""
The plan of a study: its conditions, their parts, and their order for each participant.

A plan is a YAML file; pages are Markdown files in the same folder. Every participant completes all
conditions, or one of them. The order is counterbalanced deterministically, so it is known in
advance.
"""

from collections.abc import Iterable
from enum import Enum
from functools import cache, partial
import json
from pathlib import Path
import re
from typing import Annotated, Any, Self, TypeVar

from humanopts_env.domains.formulas import derive
from humanopts_env.domains.names import is_robot, ROBOT
from humanopts_env.domains.registry import open_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import check_method
from humanopts_learner.options.starts import STRATEGIES
from humanopts_ros.limits import shown
from humanopts_ros.text_files import fault_in, FileError, read_text, read_yaml
from humanopts_teach.language import ENGLISH, LanguageError, read_language
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from humanopts_teach.study.questions import (
    CONTROL,
    different,
    distinct,
    Label,
    Name,
    Question,
    Questionnaire,
    short,
    Text,
    Values,
)
from markdown_it import MarkdownIt
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    model_validator,
    TypeAdapter,
    ValidationError,
)

QUESTIONNAIRES = Path(__file__).parent  # folder of the bundled questionnaires
SHIPPED = 'nasa-tlx'
MAX_CONDITIONS = 100
MAX_TASK = 300  # characters
MAX_PAGES = 100  # pages per file
MAX_PAGE = 100_000  # characters in a file of pages
MAX_MINUTES = 10**6
MAX_BUTTONS = 9  # buttons to teach; each has a digit key in the menu
MAX_BUTTON = 60  # characters of a button
MAX_HOURS = 24 * 366
MAX_READING = 60.0  # s
_URL = re.compile(r'https://[A-Za-z0-9.-]+(:[0-9]+)?([/?][!-~]*)?')
_COMPLETION_CODE = re.compile(r'[A-Za-z0-9_-]{1,60}')


class PlanFileError(ValueError):
    """A plan is unusable; the message gives the location and the reason."""


M = TypeVar('M', bound=Values)


def _given(value: Any) -> Any:
    if value is None:
        raise ValueError('give a text, or leave the key out')
    return value


def _as_url(text: str) -> str:
    if not _URL.fullmatch(text):
        raise ValueError('use a complete address that begins with https://')
    return text


def _as_url_or_code(text: str) -> str:
    return text if _COMPLETION_CODE.fullmatch(text) else _as_url(text)


ButtonName = Annotated[Text, AfterValidator(partial(short, most=MAX_BUTTON))]
Task = Annotated[Label, AfterValidator(partial(short, most=MAX_TASK))]
Given = Annotated[Text | None, BeforeValidator(_given)]  # None: the key is missing
Whole = Annotated[int, Field(ge=0, lt=2**31)]
Minutes = Annotated[float, Field(ge=0, lt=MAX_MINUTES)]
Url = Annotated[Text | None, BeforeValidator(_given), AfterValidator(_as_url)]
UrlOrCode = Annotated[Text | None, BeforeValidator(_given), AfterValidator(_as_url_or_code)]


class Order(Enum):
    """The method that determines the order of conditions for each participant."""

    FIXED = 'fixed'  # as in the plan
    BALANCED = 'balanced'  # rows of a balanced Latin square, in turn
    RANDOM = 'random'  # drawn from the study's seed and the participant's number
    ONE = 'one'  # one condition per participant, in turn


class PartKind(Enum):
    """The activity of a participant in a part."""

    CONSENT = 'consent'  # reads a page, then agrees or declines
    PAGE = 'page'  # reads a page
    PRACTICE = 'practice'  # tries out buttons, 'done' and 'not here'; nothing is learned
    PLAY = 'play'  # drives freely
    BUTTONS = 'buttons'  # suggests buttons that make winning easier and faster
    TEACH = 'teach'
    QUESTIONS = 'questions'


class Part(Values):
    """A part of the study for one participant."""

    kind: PartKind
    key: str  # unique in the study, such as trees/teach
    condition: str = ''  # empty: none
    domain: str = ''
    text: str = ''  # text of a page, Markdown
    task: str = ''  # stays visible while the participant plays, suggests buttons and teaches
    minutes: float = 0.0  # time limit; 0: none
    most: int = 0  # maximum of suggested buttons
    teach_buttons: tuple[str, ...] = ()  # options to teach; empty: participants name their own
    questions: Questionnaire | None = None  # in the participant's order
    most_failed: int | None = None  # maximum number of failed attention checks; None: unlimited
    reading: float = 0.0  # s, minimum display time of a page
    idle: float = 0.0  # minutes without a key press before the warning; 0: none


PARTS = TypeAdapter(tuple[Part, ...])


class Condition(Values):
    """A teaching condition of the study; times in minutes; 0 omits a part."""

    name: Name
    domain: Text
    parameters: dict[str, Any] = {}
    learn: Text = METHOD
    derive: tuple[Text, ...] = ()  # formulas, included in feature selection
    strategy: Text = STRATEGY
    budget: Annotated[int, Field(ge=1, lt=2**31)] = BUDGET
    unstick: bool = True  # whether options take random actions to leave loops
    picture: bool = True  # False: participants see only a table of features
    page: Given = None  # Markdown file, shown first
    task: Task = ''  # stays visible in the game
    free_play: Minutes = 0.0
    buttons: Whole = 0  # maximum of suggested buttons; 0 omits the part
    teach: Minutes = 20.0  # time limit for teaching
    teach_buttons: Annotated[
        tuple[ButtonName, ...],
        Field(max_length=MAX_BUTTONS),
        AfterValidator(different),
    ] = ()  # options to teach; empty: participants name their own
    questions: Given = None  # file, or name of a bundled questionnaire


class Attention(Values):
    """The rule for attention checks."""

    most_failed: Whole  # a participant with more failed checks is excluded


class Recruiting(Values):
    """
    The arrival of participants from a recruiting platform, and their return to it.

    ``{code}`` in a URL is replaced by the participant's code.
    """

    code: Annotated[Name | None, BeforeValidator(_given)] = (
        None  # URL parameter with the participant's code, such as PROLIFIC_PID
    )
    columns: tuple[Name, ...] = ()  # URL parameters to record
    completed: UrlOrCode = None  # URL, or a code to copy
    declined: Url = None
    failed: Url = None  # after too many failed attention checks


class _PlanFile(Values):
    """The contents of a plan file."""

    study: Name
    conditions: Annotated[
        tuple[Condition, ...],
        Field(min_length=1, max_length=MAX_CONDITIONS),
        AfterValidator(distinct),
    ]
    consent: Given = None
    welcome: Given = None
    thanks: Given = None
    practice: bool = False
    order: Order = Order.BALANCED
    participants: Whole = 0  # number of places; 0: unlimited
    seed: Whole = 1
    language: Text = ENGLISH  # or the name of a PO file in the folder of the plan
    return_within: Annotated[float, Field(ge=0, le=MAX_HOURS)] = 24.0  # hours; 0: no limit
    idle: Minutes = 0.0  # minutes without a key press before the warning; 0: none
    reading: Annotated[float, Field(ge=0, le=MAX_READING)] = (
        2.0  # s, minimum display time of pages
    )
    attention: Attention | None = None  # None: checks are only recorded
    recruiting: Recruiting = Recruiting()

    @model_validator(mode='after')
    def _can_be_balanced(self) -> Self:
        count = self.participants
        if self.order is Order.ONE and count % len(self.conditions):
            raise ValueError(
                f'{count} participants cannot be divided equally among {len(self.conditions)} '
                'conditions: give a multiple'
            )
        orders = len(balanced_latin_square(len(self.conditions)))
        if self.order is Order.BALANCED and count % orders:
            fitting = {max(1, count // orders) * orders, (count // orders + 1) * orders}
            raise ValueError(
                f'{count} participants cannot be balanced over the {orders} orders of '
                f'{len(self.conditions)} conditions: plan for '
                f'{" or ".join(map(str, sorted(fitting)))}, or give order: random'
            )
        return self


class StudyPlan(_PlanFile):
    """A complete study plan, including the contents of the files it references."""

    language: str = ENGLISH  # or the text of a PO file
    pages: dict[str, tuple[str, ...]]  # by file name
    questionnaires: dict[str, Questionnaire]

    def order_of(self, place: int) -> list[Condition]:
        """
        Return the conditions in the order assigned to a place.

        :param place: index of the participant's place, from 0.
        """
        indices = list(range(len(self.conditions)))
        if self.order is Order.BALANCED:
            square = balanced_latin_square(len(indices))
            indices = square[place % len(square)]
        elif self.order is Order.RANDOM:
            indices = generator(self.seed, 'order', place).permutation(indices).tolist()
        elif self.order is Order.ONE:
            indices = [place % len(indices)]
        return [self.conditions[index] for index in indices]

    def turns_of(self, place: int, number: int) -> list[tuple[Condition, list[Part]]]:
        """
        Return a participant's conditions in order, each with its parts.

        The parts follow the order of the paper's experiments. Consent and welcome come first,
        thanks last. Buttons for a game are requested only in its first condition with that part.

        :param place: index of the participant's place, from 0.
        :param number: index of the participant in order of arrival, from 0.
        """
        turns: list[tuple[Condition, list[Part]]] = []
        asked: set[str] = set()
        for each in self.order_of(place):
            name, parts = each.name, self._page(each.page, f'{each.name}/page')
            if self.practice and not turns:
                parts.append(Part(kind=PartKind.PRACTICE, key=f'{name}/practice'))
            if each.free_play:
                parts.append(Part(kind=PartKind.PLAY, key=f'{name}/play', minutes=each.free_play))
            if each.buttons and each.domain not in asked:
                asked.add(each.domain)
                parts.append(Part(kind=PartKind.BUTTONS, key=f'{name}/buttons', most=each.buttons))
            if each.teach:
                parts.append(
                    Part(
                        kind=PartKind.TEACH,
                        key=f'{name}/teach',
                        minutes=each.teach,
                        teach_buttons=each.teach_buttons,
                    )
                )
            if each.questions:
                key, asks = f'{name}/questions', self.questionnaires[each.questions]
                parts.append(
                    Part(
                        kind=PartKind.QUESTIONS,
                        key=key,
                        questions=asks.arranged(self.seed, number, key),
                        most_failed=self.attention.most_failed if self.attention else None,
                    )
                )
            where = {'condition': name, 'domain': each.domain, 'task': each.task}
            turns.append((each, [part.model_copy(update=where) for part in parts]))
        turns[0][1][:0] = [*self.consent_parts, *self._page(self.welcome, 'welcome')]
        turns[-1][1].extend(self._page(self.thanks, 'thanks'))
        for _, parts in turns:
            parts[:] = [part.model_copy(update={'idle': self.idle}) for part in parts]
        return turns

    def parts_of(self, place: int, number: int) -> list[Part]:
        """Return all parts of a participant in order."""
        return [part for _, parts in self.turns_of(place, number) for part in parts]

    @property
    def consent_parts(self) -> list[Part]:
        """The consent pages, the first parts for every participant; empty: no consent."""
        return self._page(self.consent, 'consent', PartKind.CONSENT)

    def _page(self, file: str | None, key: str, kind: PartKind = PartKind.PAGE) -> list[Part]:
        """Return one part per page of a file; only the last page has the given kind."""
        pages = self.pages[file] if file else ()
        return [
            Part(kind=PartKind.PAGE, key=f'{key}/{number}', text=text, reading=self.reading)
            if number < len(pages)
            else Part(kind=kind, key=key, text=text, reading=self.reading)
            for number, text in enumerate(pages, start=1)
        ]


def balanced_latin_square(count: int) -> list[list[int]]:
    """
    Return orders of ``count`` conditions: each condition follows every other one equally often.

    The design of Williams (1949): ``count`` orders, or twice as many if ``count`` is odd.
    """
    first = [0]
    for step in range(1, count):
        first.append((step + 1) // 2 if step % 2 else count - step // 2)
    rows = [[(index + row) % count for index in first] for row in range(count)]
    return rows + [row[::-1] for row in rows] if count % 2 and count > 1 else rows


def read_plan(path: Path) -> StudyPlan:
    """
    Read a plan and the files it references.

    :raises PlanFileError: a file cannot be read, or the plan is invalid.
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
            | {
                'conditions': tuple(_playable(plan.conditions, path.parent)),
                'language': _language(plan.language, path.parent),
            },
            pages={name: _pages(path.parent / name) for name in sorted(filter(None, files))},
            questionnaires={
                name: _questionnaire(path.parent, name) for name in sorted(filter(None, asked))
            },
        )
    except FileError as error:
        raise PlanFileError(str(error)) from error


def _language(name: str, folder: Path) -> str:
    """Return a shipped language, or the text of a PO file."""
    own = name.endswith('.po')
    try:
        read_language(str(folder / name) if own else name)
    except LanguageError as error:
        raise PlanFileError(f'language: {error}') from error
    return read_text(folder / name) if own else name


def read_name(path: Path) -> str:
    """
    Return the study name in a plan without validating the rest of the plan.

    :raises PlanFileError: the file cannot be read, or the name is invalid.
    """
    try:
        values = read_yaml(path)
        name = values.get('study', path.stem) if isinstance(values, dict) else path.stem
        return TypeAdapter(Name).validate_python(name)
    except FileError as error:
        raise PlanFileError(str(error)) from error
    except ValidationError as error:
        raise PlanFileError(f'study: {fault_in(error)}') from error


def _playable(conditions: Iterable[Condition], folder: Path) -> Iterable[Condition]:
    """
    Validate and yield the conditions; create equal games only once.

    Parameters are replaced by the game's own values. A file name becomes the contents of the file.

    :param folder: folder of the plan; paths are relative to it.
    """
    made = cache(lambda domain, parameters: open_domain(domain, json.loads(parameters)))
    for each in conditions:
        if is_robot(each.domain):
            path = folder / each.domain.removeprefix(ROBOT)
            each = each.model_copy(update={'domain': f'{ROBOT}{path.absolute()}'})
        features = each.parameters.get('features')
        if isinstance(features, str) and '.py:' in features:
            each.parameters['features'] = str(folder / features)
        try:
            game = made(each.domain, json.dumps(each.parameters))
            check_method(each.learn, game)
            for formula in each.derive:
                derive(game, formula)
            if each.strategy not in STRATEGIES:
                raise ValueError(f'strategy: use one of {", ".join(STRATEGIES)}')
        except ValueError as error:
            raise PlanFileError(f'condition {each.name}: {shown(str(error))}') from error
        given = {name: game.parameters.get(name, value) for name, value in each.parameters.items()}
        yield each.model_copy(update={'parameters': given})


def _pages(path: Path) -> tuple[str, ...]:
    """Return the pages of a file, which are separated by lines of ---."""
    text = read_text(path, 4 * MAX_PAGE)
    if len(text) > MAX_PAGE:
        raise PlanFileError(f'{path.name} has {len(text):,} characters; the limit is {MAX_PAGE:,}')
    if found := CONTROL.search(text):
        line = text.count('\n', 0, found.start()) + 1
        raise PlanFileError(f'{path.name}: remove the control character in line {line}')
    tokens = MarkdownIt('commonmark').parse(text)
    for each in (inner for token in tokens for inner in (token, *(token.children or ()))):
        if each.type.startswith('html'):
            line = text.count('\n', 0, text.find(each.content)) + 1
            raise PlanFileError(
                f'{path.name}: line {line} has HTML, {shown(each.content, 40)}; use Markdown, and '
                'write \\< for <'
            )
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
    Validate the values of a file.

    :raises PlanFileError: the values are invalid.
    """
    if not isinstance(values, dict):
        raise PlanFileError('the file must map names to values')
    try:
        return kind.model_validate_json(json.dumps(values))
    except ValidationError as error:
        inner: dict[Any, type[Values]] = {
            'conditions': Condition,
            'items': Question,
            'attention': Attention,
            'recruiting': Recruiting,
        }
        first = next(iter(error.errors()[0]['loc']), '')
        raise PlanFileError(fault_in(error, inner.get(first, kind).model_fields)) from None
