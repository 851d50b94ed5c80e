"""
The plan of a study: its conditions, what a participant does in each, and in which order.

A plan is a YAML file; pages are Markdown files beside it. Every participant goes through all
conditions. The order is counterbalanced by a rule, so that it is known beforehand for each.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from enum import Enum
from functools import cache, partial
from inspect import signature
import json
from pathlib import Path
import re
from typing import Annotated, Any, TypeVar

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import check_method
from humanopts_learner.options.start_states import STRATEGIES
from humanopts_ros.limits import shown
from humanopts_ros.text_files import FileError, read_text, read_yaml
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

QUESTIONNAIRES = Path(__file__).parent  # of those that are shipped
SHIPPED = 'nasa-tlx'
_NAME = re.compile(r'[A-Za-z0-9_-]{1,40}')
_CONTROL = re.compile(r'[\x00-\x08\x0b-\x1f\x7f-\x9f]')  # but tabs and line breaks
MOST_POINTS = 21
MAX_CONDITIONS = 100
MAX_ITEMS = 200  # of a questionnaire
MAX_PAGES = 100  # of a file
MAX_PAGE = 100_000  # characters of a file of pages
MAX_LINE = 2000  # characters of a question, a label or another text of a plan
MAX_MINUTES = 10**6


class PlanFileError(ValueError):
    """A plan cannot be used; the text names the place and says why."""


def _shown(value: Any) -> str:
    return shown(json.dumps(value, ensure_ascii=False), 60)


def _text(value: Any) -> str:
    """Return a text; whole numbers are texts too, as they are written."""
    if isinstance(value, bool):
        raise ValueError(
            f'is {_shown(value)}, as YAML reads words such as No and Yes: put it in quotes'
        )
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, str):
        number = isinstance(value, float)
        raise ValueError(
            f'is {_shown(value)}; it has to be a text{": put it in quotes" if number else ""}'
        )
    if not value.strip():
        raise ValueError('is empty: give a text, or leave the key out')
    if len(value) > MAX_LINE:
        raise ValueError(f'has {len(value):,} characters, and {MAX_LINE:,} are allowed')
    if _CONTROL.search(value):
        raise ValueError('has characters that control terminals: remove them')
    return value.strip()


def _name(value: Any) -> str:
    if not _NAME.fullmatch(text := _text(value)):
        raise ValueError(
            f'is {_shown(text)}; it has to be letters, digits, - and _, at most 40 of them'
        )
    return text


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**31:
        raise ValueError(f'is {_shown(value)}; it has to be a whole number from 0 on')
    return value


def _minutes(value: Any) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not 0 <= value < MAX_MINUTES:
        raise ValueError(f'is {_shown(value)}; it has to be minutes, 0 or more')
    return float(value)


def _one_of(*known: str) -> BeforeValidator:
    def check(value: Any) -> str:
        if value not in known:
            raise ValueError(f'is {_shown(value)}; it is one of {", ".join(known)}')
        return str(value)

    return BeforeValidator(check)


def _mapping(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f'is {_shown(value)}; it has to map names to values')
    return value


def _listed(most: int) -> BeforeValidator:
    def check(value: Any) -> list[Any]:
        if not isinstance(value, list) or not value:
            raise ValueError('has to be a list of one or more')
        if len(value) > most:
            raise ValueError(f'has {len(value):,} entries, and {most} are allowed')
        return value

    return BeforeValidator(check)


Text = Annotated[str, BeforeValidator(_text)]
Given = Annotated[str | None, BeforeValidator(_text)]  # None: the key is not there
Name = Annotated[str, BeforeValidator(_name)]
Whole = Annotated[int, BeforeValidator(_whole)]
Minutes = Annotated[float, BeforeValidator(_minutes)]
T = TypeVar('T')
_STRICT = ConfigDict(strict=True, extra='forbid')


class Order(Enum):
    """How the order of the conditions is chosen for each participant."""

    FIXED = 'fixed'  # as they stand in the plan
    BALANCED = 'balanced'  # by the rows of a balanced Latin square, one after the other
    RANDOM = 'random'  # drawn by the study's seed and the participant's number


class Kind(Enum):
    """What a participant does in one part."""

    CONSENT = 'consent'  # reads a page, and agrees or not
    PAGE = 'page'  # reads a page
    PLAY = 'play'  # drives freely
    BUTTONS = 'buttons'  # suggests buttons that make winning easier and faster
    TEACH = 'teach'
    QUESTIONS = 'questions'


@dataclass(frozen=True, config=_STRICT)
class Question:
    """One item of a questionnaire, answered on a Likert scale of 1 to ``points``."""

    name: Name
    text: Text
    low: Text  # what 1 means
    high: Text  # what the last point means
    points: int = 7


@dataclass(frozen=True, config=_STRICT)
class Part:
    """One thing that a participant does."""

    kind: Kind
    key: str  # unique in the study, such as trees/teach
    condition: str = ''  # empty: of no condition
    domain: str = ''
    text: str = ''  # of a page, Markdown
    minutes: float = 0.0  # after which it ends by itself; 0: never
    most: int = 0  # buttons that can be suggested
    questions: tuple[Question, ...] = ()


def parts_to_json(parts: Iterable[Part]) -> str:
    """Return parts as one line of JSON."""
    return _PARTS.dump_json(tuple(parts)).decode()


def parts_from_json(text: str) -> tuple[Part, ...]:
    """Return the parts of ``parts_to_json``."""
    return _PARTS.validate_json(text)


_PARTS = TypeAdapter(tuple[Part, ...])


@dataclass(frozen=True, config=_STRICT)
class Condition:
    """One way to teach that the study compares; times are minutes, and 0 leaves a part out."""

    name: Name
    domain: Text
    parameters: Annotated[dict[str, Any], BeforeValidator(_mapping)] = Field(default_factory=dict)
    learn: Text = METHOD
    strategy: Annotated[str, _one_of(*STRATEGIES)] = STRATEGY
    budget: Whole = BUDGET
    page: Given = None  # file in Markdown, shown first
    free_play: Minutes = 0.0
    buttons: Whole = 0  # that are asked for at most; 0: none
    teach: Minutes = 20.0  # the most that teaching takes
    questions: Given = None  # file, or the name of a questionnaire that is shipped


@dataclass(frozen=True, config=_STRICT)
class StudyPlan:
    """A whole study."""

    name: str
    conditions: tuple[Condition, ...]
    order: Order
    participants: int  # that are planned; 0: any number
    seed: int
    before: tuple[Part, ...]  # consent and welcome
    after: tuple[Part, ...]  # thanks
    during: Mapping[str, tuple[Part, ...]]  # by name of the condition

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

        Buttons for a game are asked for once, in the first condition that asks for them.
        """
        turns: list[tuple[Condition, list[Part]]] = []
        asked: set[str] = set()
        for condition in self.order_of(number):
            parts = [
                part
                for part in self.during[condition.name]
                if part.kind is not Kind.BUTTONS or part.domain not in asked
            ]
            asked |= {part.domain for part in parts if part.kind is Kind.BUTTONS}
            turns.append((condition, parts))
        turns[0][1][:0] = self.before
        turns[-1][1].extend(self.after)
        return turns

    def parts_of(self, number: int) -> list[Part]:
        """Return everything that a participant does, in order."""
        return [part for _, parts in self.turns_of(number) for part in parts]


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


@dataclass(frozen=True, config=_STRICT)
class _PlanFile:
    """What the file of a plan says, before the files that it names are read."""

    conditions: Annotated[list[Any], _listed(MAX_CONDITIONS)]
    study: Name
    consent: Given = None
    welcome: Given = None
    thanks: Given = None
    order: Annotated[str, _one_of(*(each.value for each in Order))] = Order.BALANCED.value
    participants: Whole = 0
    seed: Whole = 1
    all: Annotated[dict[str, Any], BeforeValidator(_mapping)] = Field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class _QuestionsFile:
    """What a questionnaire says."""

    items: Annotated[list[Any], _listed(MAX_ITEMS)]
    points: Whole = 7


def read_plan(path: Path) -> StudyPlan:
    """
    Read a plan and the files that it names.

    :raises PlanFileError: a file cannot be read, or the plan cannot be carried out.
    """
    try:
        values = read_yaml(path)
        if isinstance(values, dict):
            values = {'study': path.stem, **values}
        file = _validated(_PlanFile, values, 'the plan')
        plan = _plan(file, path.parent)
    except FileError as error:
        raise PlanFileError(str(error)) from error
    _check_balance(plan)
    return plan


def read_name(path: Path) -> str:
    """
    Return the name of the study of a plan, whatever else the plan says.

    :raises PlanFileError: the file cannot be read, or the name cannot be used.
    """
    try:
        values = read_yaml(path)
        return _name(values.get('study', path.stem) if isinstance(values, dict) else path.stem)
    except FileError as error:
        raise PlanFileError(str(error)) from error
    except ValueError as error:
        raise PlanFileError(f'study of the plan {error}') from error


def _plan(file: _PlanFile, folder: Path) -> StudyPlan:
    conditions = []
    for number, given in enumerate(file.conditions, start=1):
        if not isinstance(given, dict):
            raise PlanFileError(f'condition {number} has to map names to values')
        name = given.get('name')
        where = f'condition {name if isinstance(name, str) else number}'
        conditions.append(_validated(Condition, {**file.all, **given}, shown(where, 60)))
    names = [condition.name for condition in conditions]
    if len(set(names)) < len(names):
        raise PlanFileError(f'two conditions have the same name: {", ".join(names)}')
    _make_games(conditions)
    pages, questions = cache(lambda name: _pages(folder, name)), cache(partial(_questions, folder))
    return StudyPlan(
        name=file.study,
        conditions=tuple(conditions),
        order=Order(file.order),
        participants=file.participants,
        seed=file.seed,
        before=(
            *_page(pages, file.consent, Kind.CONSENT, 'consent'),
            *_page(pages, file.welcome, Kind.PAGE, 'welcome'),
        ),
        after=_page(pages, file.thanks, Kind.PAGE, 'thanks'),
        during={each.name: _parts(each, pages, questions) for each in conditions},
    )


def _make_games(conditions: Iterable[Condition]) -> None:
    """
    Refuse a condition that cannot be taught as it says; equal games are made once.

    Parameters become those that the game itself gives: what a file held in place of its name.
    """
    made = cache(lambda domain, parameters: make_domain(domain, json.loads(parameters)))
    for condition in conditions:
        where = f'condition {condition.name}'
        if condition.teach <= 0:
            raise PlanFileError(f'teach of {where} has to be above 0 minutes')
        if condition.budget < 1:
            raise PlanFileError(f'budget of {where} has to be 1 or more')
        try:
            game = made(condition.domain, json.dumps(condition.parameters))
            check_method(condition.learn, game)
        except (DomainError, ValueError) as error:
            raise PlanFileError(f'{where}: {shown(str(error))}') from error
        given = condition.parameters
        given.update({name: game.parameters.get(name, given[name]) for name in given})


def _check_balance(plan: StudyPlan) -> None:
    """Refuse a number of participants for whom the orders cannot be balanced."""
    if plan.order is not Order.BALANCED or not plan.participants:
        return
    orders, count = len(balanced_latin_square(len(plan.conditions))), plan.participants
    if count % orders:
        fitting = [
            str(times * orders) for times in (count // orders, -(-count // orders)) if times
        ]
        raise PlanFileError(
            f'{count} participants cannot be balanced over the {orders} orders of '
            f'{len(plan.conditions)} conditions: plan for {" or ".join(fitting)}, or '
            'give order: random'
        )


def _parts(
    condition: Condition,
    pages: Callable[[str], list[str]],
    questions: Callable[[str], tuple[Question, ...]],
) -> tuple[Part, ...]:
    """Return what a participant does in a condition, in the order of the paper's experiments."""
    name = condition.name
    found = list(_page(pages, condition.page, Kind.PAGE, f'{name}/page'))
    if condition.free_play:
        found.append(Part(Kind.PLAY, f'{name}/play', minutes=condition.free_play))
    if condition.buttons:
        found.append(Part(Kind.BUTTONS, f'{name}/buttons', most=condition.buttons))
    found.append(Part(Kind.TEACH, f'{name}/teach', minutes=condition.teach))
    if condition.questions is not None:
        asked = questions(condition.questions)
        found.append(Part(Kind.QUESTIONS, f'{name}/questions', questions=asked))
    return tuple(replace(part, condition=name, domain=condition.domain) for part in found)


def _page(
    pages: Callable[[str], list[str]], name: str | None, kind: Kind, key: str
) -> tuple[Part, ...]:
    """Return the parts of the pages of a file; only the last is of the kind."""
    if name is None:
        return ()
    *first, last = pages(name)
    before = [Part(Kind.PAGE, f'{key}/{n}', text=text) for n, text in enumerate(first, start=1)]
    return (*before, Part(kind, key, text=last))


def _pages(folder: Path, name: str) -> list[str]:
    """Return the pages of a file, which a line of --- divides."""
    text = read_text(folder / name, 4 * MAX_PAGE)
    if len(text) > MAX_PAGE:
        raise PlanFileError(f'{name} has {len(text):,} characters, and {MAX_PAGE:,} are allowed')
    if found := _CONTROL.search(text):
        line = text.count('\n', 0, found.start()) + 1
        raise PlanFileError(f'{name} has a character that controls terminals in line {line}')
    pages = re.split(r'^-{3,}[ \t]*$', text, flags=re.MULTILINE)
    if len(pages) > MAX_PAGES:
        raise PlanFileError(f'{name} has {len(pages):,} pages, and {MAX_PAGES} are allowed')
    return pages


def _questions(folder: Path, name: str) -> tuple[Question, ...]:
    path = QUESTIONNAIRES / 'nasa_tlx.yaml' if name == SHIPPED else folder / name
    file = _validated(_QuestionsFile, read_yaml(path), path.name)
    if not 2 <= file.points <= MOST_POINTS:
        raise PlanFileError(f'points of {path.name} is {file.points}, not 2 to {MOST_POINTS}')
    found = []
    for number, item in enumerate(file.items, start=1):
        where = f'item {number} of {path.name}'
        if isinstance(item, dict) and 'points' in item:
            raise PlanFileError(f'{where} has unknown keys: points; all items share theirs')
        found.append(replace(_validated(Question, item, where), points=file.points))
    names = [each.name for each in found]
    if len(set(names)) < len(names):
        raise PlanFileError(f'two items of {path.name} have the same name')
    return tuple(found)


def _validated(kind: type[T], values: Any, where: str) -> T:
    """
    Return what the values of a file say.

    :param where: the place, in words.
    :raises PlanFileError: they say something else.
    """
    if not isinstance(values, dict):
        raise PlanFileError(f'{where} has to map names to values')
    try:
        return TypeAdapter(kind).validate_json(json.dumps(values))
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False)
        raise PlanFileError(_fault(found, list(signature(kind).parameters), where)) from None


def _fault(found: Iterable[Any], known: Iterable[str], where: str) -> str:
    """Return what is wrong, in one line: missing keys, unknown ones, or the first value."""
    keys: dict[str, list[str]] = {}
    for each in found:
        keys.setdefault(each['type'], []).append(str(each['loc'][0]))
    if missing := keys.get('missing'):
        return f'{where} has no {", ".join(missing)}'
    if unknown := keys.get('unexpected_keyword_argument'):
        names = shown(', '.join(unknown))
        return f'{where} has unknown keys: {names}; known are {", ".join(known)}'
    first = next(iter(found))
    place = '.'.join(str(each) for each in first['loc'] if isinstance(each, str))
    error = first.get('ctx', {}).get('error')
    words = f' {error}' if isinstance(error, ValueError) else f': {first["msg"]}'
    return f'{shown(place)} of {where}{words}'
