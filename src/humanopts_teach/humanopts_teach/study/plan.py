"""
The plan of a study: its conditions, what a participant does in each, and in which order.

A plan is a YAML file; pages are Markdown files beside it. Every participant goes through all
conditions. The order is counterbalanced by a rule, so that it can be told beforehand for each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.base import DomainError, Parameter
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import check_method
from humanopts_learner.options.start_states import STRATEGIES
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
import yaml

QUESTIONNAIRES = Path(__file__).parent  # of those that are shipped
SHIPPED = 'nasa-tlx'
_NAME = re.compile(r'[A-Za-z0-9_-]{1,40}')
_PLAN_KEYS = ('study', 'consent', 'welcome', 'thanks', 'order', 'participants', 'seed', 'all')
MOST_POINTS = 21


class PlanFileError(ValueError):
    """A plan cannot be used; the text names the place and says why."""


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


@dataclass(frozen=True)
class Question:
    """One item of a questionnaire, answered on a Likert scale of 1 to ``points``."""

    name: str
    text: str
    low: str  # what 1 means
    high: str  # what the last point means
    points: int = 7


@dataclass(frozen=True)
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

    def to_dict(self) -> dict[str, Any]:
        """Return the part as JSON data."""
        questions = [vars(question) for question in self.questions]
        return {**vars(self), 'kind': self.kind.value, 'questions': questions}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> 'Part':
        """Return the part of ``to_dict``."""
        questions = tuple(Question(**each) for each in values['questions'])
        return cls(**{**values, 'kind': Kind(values['kind']), 'questions': questions})


@dataclass(frozen=True)
class Condition:
    """One way to teach that the study compares; times are minutes, and 0 leaves a part out."""

    name: str
    domain: str = ''
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    learn: str = METHOD
    strategy: str = STRATEGY
    budget: int = BUDGET
    page: str = ''  # file in Markdown, shown first
    free_play: float = 0.0
    buttons: int = 0  # that are asked for at most; 0: none
    teach: float = 20.0  # the most that teaching takes
    questions: str = ''  # file, or the name of a questionnaire that is shipped


@dataclass(frozen=True)
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


def read_plan(path: Path) -> StudyPlan:
    """
    Read a plan and the files that it names.

    :raises PlanFileError: a file cannot be read, or the plan cannot be carried out.
    """
    values = _mapping(_load(path), 'the plan')
    _refuse_unknown(values, (*_PLAN_KEYS, 'conditions'), 'the plan')
    folder = path.parent
    common = _mapping(values.get('all', {}), 'all')
    listed = values.get('conditions')
    if not isinstance(listed, list) or not listed:
        raise PlanFileError('conditions has to be a list of one or more')
    conditions = tuple(_condition(each, common) for each in listed)
    names = [condition.name for condition in conditions]
    if len(set(names)) < len(names):
        raise PlanFileError(f'two conditions have the same name: {", ".join(names)}')
    try:
        order = Order(values.get('order', Order.BALANCED.value))
    except ValueError:
        known = ', '.join(each.value for each in Order)
        raise PlanFileError(f'order is {values["order"]!r}; it is one of {known}') from None
    plan = StudyPlan(
        name=_name(values.get('study', path.stem), 'study'),
        conditions=conditions,
        order=order,
        participants=_whole(values.get('participants', 0), 'participants'),
        seed=_whole(values.get('seed', 1), 'seed'),
        before=(
            *_page(folder, values.get('consent'), Kind.CONSENT, 'consent'),
            *_page(folder, values.get('welcome'), Kind.PAGE, 'welcome'),
        ),
        after=_page(folder, values.get('thanks'), Kind.PAGE, 'thanks'),
        during={condition.name: _parts(condition, folder) for condition in conditions},
    )
    _check_balance(plan)
    return plan


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


def _condition(given: Any, common: Mapping[str, Any]) -> Condition:
    values = {**common, **_mapping(given, 'a condition')}
    name = _name(values.get('name'), 'the name of a condition')
    where, usual = f'condition {name}', vars(Condition(name))
    _refuse_unknown(values, list(usual), where)
    condition = Condition(
        **{
            key: _of_type(values[key], usual[key], f'{key} of {where}')
            for key in usual
            if key in values
        }
    )
    if condition.strategy not in STRATEGIES:
        raise PlanFileError(
            f'strategy of {where} is {condition.strategy!r}; it is one of {", ".join(STRATEGIES)}'
        )
    if condition.teach <= 0:
        raise PlanFileError(f'teach of {where} has to be above 0 minutes')
    try:
        check_method(condition.learn, make_domain(condition.domain, dict(condition.parameters)))
    except (DomainError, ValueError) as error:
        raise PlanFileError(f'{where}: {error}') from error
    return condition


def _parts(condition: Condition, folder: Path) -> tuple[Part, ...]:
    """Return what a participant does in a condition, in the order of the paper's experiments."""
    name = condition.name
    found = list(_page(folder, condition.page or None, Kind.PAGE, f'{name}/page'))
    if condition.free_play:
        found.append(Part(Kind.PLAY, f'{name}/play', minutes=condition.free_play))
    if condition.buttons:
        found.append(Part(Kind.BUTTONS, f'{name}/buttons', most=condition.buttons))
    found.append(Part(Kind.TEACH, f'{name}/teach', minutes=condition.teach))
    if condition.questions:
        asked = _questions(condition.questions, folder)
        found.append(Part(Kind.QUESTIONS, f'{name}/questions', questions=asked))
    return tuple(replace(part, condition=name, domain=condition.domain) for part in found)


def _page(folder: Path, name: Any, kind: Kind, key: str) -> tuple[Part, ...]:
    """Return the pages of a file, which a line of --- divides."""
    if name is None:
        return ()
    if not isinstance(name, str):
        raise PlanFileError(f'{key} has to name a file in Markdown')
    *first, last = re.split(r'^-{3,}\s*$', _text(folder / name), flags=re.MULTILINE)
    pages = [Part(Kind.PAGE, f'{key}/{n}', text=text) for n, text in enumerate(first, start=1)]
    return (*pages, Part(kind, key, text=last))


def _questions(name: str, folder: Path) -> tuple[Question, ...]:
    path = QUESTIONNAIRES / 'nasa_tlx.yaml' if name == SHIPPED else folder / name
    values = _mapping(_load(path), path.name)
    _refuse_unknown(values, ('points', 'items'), path.name)
    points, items = _whole(values.get('points', 7), f'points of {path.name}'), values.get('items')
    if not 2 <= points <= MOST_POINTS:
        raise PlanFileError(f'points of {path.name} is {points}, not from 2 to {MOST_POINTS}')
    if not isinstance(items, list) or not items:
        raise PlanFileError(f'items of {path.name} has to be a list of one or more')
    found, where, parts = [], f'an item of {path.name}', ('name', 'text', 'low', 'high')
    for item in items:
        values = _mapping(item, where)
        _refuse_unknown(values, parts, where)
        if lacking := [key for key in parts if not values.get(key)]:
            raise PlanFileError(f'{where} has no {", ".join(lacking)}')
        _name(str(values['name']), f'the name of {where}')
        found.append(Question(**{key: str(values[key]) for key in parts}, points=points))
    if len({each.name for each in found}) < len(found):
        raise PlanFileError(f'two items of {path.name} have the same name')
    return tuple(found)


def _load(path: Path) -> Any:
    try:
        return yaml.safe_load(_text(path))
    except yaml.YAMLError as error:
        raise PlanFileError(f'{path.name} is not YAML: {" ".join(str(error).split())}') from error


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding='utf-8')
    except OSError as error:
        raise PlanFileError(f'cannot read {path}: {error.strerror}') from error
    except UnicodeDecodeError:
        raise PlanFileError(f'{path} is not a text in UTF-8') from None


def _mapping(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise PlanFileError(f'{where} has to map names to values')
    return value


def _refuse_unknown(values: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    if unknown := [key for key in values if key not in known]:
        raise PlanFileError(
            f'{where} has unknown keys: {", ".join(unknown)}; known are {", ".join(known)}'
        )


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise PlanFileError(
            f'{where} is {value!r}; it has to be letters, digits, - and _, at most 40 of them'
        )
    return value


def _whole(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**31:
        raise PlanFileError(f'{where} is {value!r}; it has to be a whole number from 0 on')
    return value


def _of_type(value: Any, default: Any, where: str) -> Any:
    """Return a value of the type that a key has, from its default."""
    if isinstance(default, float):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e6:
            raise PlanFileError(f'{where} is {value!r}; it has to be minutes, 0 or more')
        return float(value)
    if isinstance(default, int):
        return _whole(value, where)
    if isinstance(default, str):
        if not isinstance(value, str):
            raise PlanFileError(f'{where} is {value!r}; it has to be a text')
        return value
    return _mapping(value, where)
