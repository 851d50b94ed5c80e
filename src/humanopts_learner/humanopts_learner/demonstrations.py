"""
Demonstrations of options, checked against the rules of the game.

Runs of the machine that the person called right or wrong are recorded and sent like
demonstrations, but options are not learned from them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from enum import Enum
from functools import cache, cached_property
import json
import math
from sys import intern
from typing import Annotated, Any, Final, TypeVar
import uuid as uuid_module

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import (
    ActableDomain,
    action_index,
    Domain,
    DomainError,
    FeatureKind,
    is_enumerable,
)
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.formulas import feature_columns, FeatureColumn, stacked
from humanopts_env.domains.parameters import MAX_PARAMETERS
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import check_features
from humanopts_env.games import feature_rows
from humanopts_ros.limits import composed, JsonError, MAX_WHOLE, parse_json
from humanopts_ros.text_files import fault_in
import numpy as np
from pydantic import AfterValidator, Field, Strict, TypeAdapter, ValidationError

T = TypeVar('T')


class DemonstrationError(ValueError):
    """A demonstration is invalid; the message says why."""


class Kind(Enum):
    """The kind of a demonstration."""

    TRAJECTORY = 'trajectory'
    NOT_HERE = 'not_here'  # the option does not apply in its single state
    JUDGED = 'judged'  # a run of the machine, judged by the person


TREES: Final = 'trees'
FOREST: Final = 'forest'
GOAL: Final = 'goal'
METHODS = {  # learning methods; descriptions of the policy
    TREES: 'learned from the actions that were shown',
    FOREST: 'learned from the actions that were shown, by many trees that vote',
    GOAL: 'planned as the best path to an end like those shown',
}
PRIMITIVE_PREFIX = 'action:'  # name prefix of primitive actions used as options
MACHINE = (
    'automatic:'  # prefix of participant codes of automatic options; people's codes have no colon
)
CHANGE = 0.01  # minimum change of a continuous feature, relative to its range
MAX_NAME = 60  # maximum number of characters of option names, participant and session codes
# KIND_* of Demonstration.msg
KIND_NUMBERS = {Kind.TRAJECTORY: 1, Kind.NOT_HERE: 2, Kind.JUDGED: 3}


# Values in files and messages; only lists, and integers for reals, are converted.
Text = Annotated[str, Strict(), AfterValidator(intern)]  # interned, since states and names repeat
Real = Annotated[float, Strict()]
Count = Annotated[int, Strict(), Field(ge=0, le=MAX_WHOLE)]
Flag = Annotated[bool, Strict()]


@dataclass(frozen=True)
class Demonstration:
    """
    One trajectory s0 a0 r0 .. sT of one option, or one "not here" answer (T = 0).

    A judged run has the states and actions of the machine; T = 0: the option would not start.

    Fields are those of ``humanopts_interfaces/msg/Demonstration``.
    """

    kind: Kind
    uuid: Text
    domain: Text
    domain_parameters: Text  # JSON object
    participant: Text
    session: Text
    option_name: Annotated[Text, AfterValidator(composed)]
    number: Count  # 1, 2, 3, ... per participant and option; judged runs: numbered separately
    chosen_features: tuple[Text, ...]
    feature_names: tuple[Text, ...]
    features: tuple[tuple[Real, ...], ...]  # T + 1 rows of all features
    states: tuple[Text, ...]  # T + 1
    actions: tuple[Text, ...]  # T
    rewards: tuple[Real, ...]  # T
    terminated: Flag = False
    can_start_at_end: Flag = False
    seconds: Real = 0.0
    withdrawn: Flag = False  # withdrawn by the person; not used for learning
    method: Text = TREES  # one of METHODS; the newest demonstration decides
    machine_steps: Count = 0  # number of leading steps taken by the machine
    right: Flag = False  # the verdict on a judged run
    exam: Flag = False  # a judged run from an exam; otherwise, it answers a question
    stopped: Flag = False  # the person stopped the judged run in its last state
    option_version: Text = ''  # ``version_of`` the demonstrations of the judged option

    @cached_property
    def feature_rows(self) -> Rows:
        """All features of all states, (T + 1, F)."""
        return np.array(self.features).reshape(len(self.states), -1)

    @property
    def plain_features(self) -> list[list[float]]:
        """``features`` for files: whole numbers, such as indices, are integers."""
        return [[int(v) if float(v).is_integer() else v for v in row] for row in self.features]

    @property
    def total_reward(self) -> float:
        """Undiscounted return of the trajectory."""
        return math.fsum(self.rewards)

    def to_json(self) -> str:
        """Return the demonstration as one line of JSON."""
        values = asdict(self)
        values['kind'] = self.kind.value
        values['features'] = self.plain_features
        for name, usual in _OPTIONAL.items():
            if values[name] == usual:
                del values[name]
        return json.dumps(values, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> 'Demonstration':
        """
        Read the output of ``to_json``.

        :raises DemonstrationError: the text is not a demonstration.
        """
        try:
            return cls.from_fields(parse_json(text))
        except JsonError as error:
            raise DemonstrationError(f'not a demonstration: {error}') from error

    @classmethod
    def from_fields(cls, values: Mapping[str, Any]) -> 'Demonstration':
        """
        Build from plain values, with lists instead of tuples.

        :raises DemonstrationError: a field is missing or malformed.
        """
        try:
            return _adapter().validate_python(values)
        except ValidationError as error:
            raise DemonstrationError(f'not a demonstration: {fault_in(error)}') from error


@cache
def _adapter() -> TypeAdapter[Demonstration]:
    return TypeAdapter(Demonstration)


_OPTIONAL = {
    'withdrawn': False,
    'method': TREES,
    'machine_steps': 0,
    'right': False,
    'exam': False,
    'stopped': False,
    'option_version': '',
}  # fields omitted from JSON if they have these values


def shown(demonstrations: Iterable[Demonstration]) -> list[Demonstration]:
    """Return the demonstrations to learn from: trajectories and "not here" answers."""
    return [demo for demo in demonstrations if demo.kind is not Kind.JUDGED]


def judged(demonstrations: Iterable[Demonstration]) -> list[Demonstration]:
    """Return the runs of the machine that the person judged."""
    return [demo for demo in demonstrations if demo.kind is Kind.JUDGED]


def version_of(demonstrations: Iterable[Demonstration]) -> str:
    """Return the version of the option learned from these demonstrations."""
    uuids = sorted(demo.uuid for demo in shown(demonstrations))
    return str(uuid_module.uuid5(uuid_module.NAMESPACE_OID, ' '.join(uuids)))


def make_demonstration(
    domain: Domain,
    option_name: str,
    states: Sequence[Any],
    actions: Sequence[str] = (),
    rewards: Sequence[float] | None = None,
    *,
    features: Sequence[str] | None = None,
    can_start_at_end: bool = False,
    method: str = TREES,
    participant: str = 'anonymous',
    session: str = 'own data',
    number: int = 1,
) -> Demonstration:
    """
    Build a demonstration from states and actions in a domain, and check it.

    The same arguments give the same demonstration, including its uuid.

    :param states: T + 1 states of the domain; one state without actions: a "not here" answer.
    :param actions: T action names.
    :param rewards: T rewards; None: computed from the rules, if all states can be listed.
    :param features: names of the features that the option depends on; None: all.
    :param can_start_at_end: whether the option could start again in the last state.
    :param method: learning method, one of METHODS.
    :raises DemonstrationError: the steps break the rules of the domain, or a reward is unknown.
    """
    if not states:
        raise DemonstrationError('a demonstration has at least one state')
    names = tuple(feature.name for feature in domain.features)
    demo = Demonstration(
        kind=Kind.TRAJECTORY if actions else Kind.NOT_HERE,
        uuid='',
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        participant=participant,
        session=session,
        option_name=composed(option_name),
        number=number,
        chosen_features=names if features is None else tuple(features),
        feature_names=names,
        features=tuple(map(tuple, feature_rows(domain, states).tolist())),
        states=tuple(map(domain.encode, states)),
        actions=tuple(actions),
        rewards=tuple(_rewards(domain, states, actions) if rewards is None else rewards),
        terminated=bool(actions) and domain.is_over(states[-1]),
        can_start_at_end=can_start_at_end,
        method=method,
    )
    named = replace(demo, uuid=str(uuid_module.uuid5(uuid_module.NAMESPACE_OID, demo.to_json())))
    check_demonstration(named, domain)
    return named


def _rewards(domain: Domain, states: Sequence[Any], actions: Sequence[str]) -> list[float]:
    """Return the reward of each step by the rules; 0 for a step that violates them."""
    if actions and not is_enumerable(domain):
        raise DemonstrationError(f'the states of {domain.name} cannot all be listed: give rewards')
    found = []
    for before, name, after in zip(states, actions, states[1:]):
        assert is_enumerable(domain)
        table, at = domain.transitions(), (domain.index(before), action_index(domain, name))
        possible = (table.successor[at] == domain.index(after)) & (table.probability[at] > 0)
        rewards = set(table.reward[at][possible].tolist()) or {0.0}
        if len(rewards) > 1:
            raise DemonstrationError(
                f'{name} from {domain.encode(before)} to {domain.encode(after)} has several '
                'rewards: give rewards'
            )
        found.append(rewards.pop())
    return found


def demonstration_from_message(message: Any) -> Demonstration:
    """
    Decode a ``humanopts_interfaces/msg/Demonstration``, from rclpy or from a bag reader.

    :raises DemonstrationError: the message is malformed.
    """
    values = {field.name: getattr(message, field.name) for field in fields(Demonstration)}
    kinds = {number: kind for kind, number in KIND_NUMBERS.items()}
    values['kind'] = kinds.get(message.kind, f'number {message.kind}')
    flat, width = list(message.features), len(message.feature_names) or 1
    values['features'] = [flat[start : start + width] for start in range(0, len(flat), width)]
    values['rewards'] = list(message.rewards)
    return Demonstration.from_fields(values)


def check_demonstration(demonstration: Demonstration, domain: ActableDomain) -> None:
    """
    Check a demonstration against the known rules of its domain.

    :raises DemonstrationError: it has no steps, non-finite numbers, features of another domain, or
        actions that do not lead from one state to the next.
    """
    if fault := next(_faults(demonstration, domain), ''):
        raise DemonstrationError(fault)


def option_name_fault(name: str) -> str:
    """Return the fault of an option name; empty: valid."""
    if not name.strip():
        return 'the name is empty'
    if name.startswith(PRIMITIVE_PREFIX):
        return f'names that begin with {PRIMITIVE_PREFIX} are reserved for primitive actions'
    return _text_fault('the name', name)


def _text_fault(what: str, text: str) -> str:
    if len(text) > MAX_NAME:
        return f'{what} has {len(text)} characters; at most {MAX_NAME} are allowed'
    return '' if text.isprintable() else f'{what} has characters that cannot be printed'


def check_method(method: str, domain: ActableDomain) -> None:
    """
    Check that options of a domain can be learned with a method.

    :raises DemonstrationError: the method is unknown, or requires states that can be listed.
    """
    if method not in METHODS:
        known = ', '.join(METHODS)
        raise DemonstrationError(f'unknown learning method {method!r}; choose from {known}')
    if method == GOAL and not is_enumerable(domain):
        raise DemonstrationError(
            f'the states of {domain.name} cannot be listed, so no path to a goal can be planned; '
            f'its options are learned by {TREES}'
        )


def each_once(demonstrations: Iterable[Demonstration]) -> list[Demonstration]:
    """
    Remove duplicate demonstrations of a stream or log, by uuid.

    :return: one of each, in order of first appearance; a withdrawal takes precedence.
    """
    once: dict[str, Demonstration] = {}
    for demo in demonstrations:
        known = once.setdefault(demo.uuid, demo)
        if demo.withdrawn and not known.withdrawn:
            once[demo.uuid] = demo
    return list(once.values())


def without_idle_steps(
    demo: Demonstration, domain: ActableDomain, chosen: Sequence[FeatureColumn]
) -> Demonstration:
    """
    Return a demonstration without the steps in which the person only waited.

    A step is dropped if its action is idle and no chosen feature has changed since the last step
    that was kept. So waiting for a change is learned, and hesitation is not. If no step would be
    left, the person has shown how to wait, and nothing is dropped.

    :param chosen: chosen features; a continuous one must change by ``CHANGE`` of its range.
    """
    idle = {action.name for action in domain.actions if action.idle}
    if idle.isdisjoint(demo.actions):
        return demo
    scale = [c.feature.span if c.feature.kind is FeatureKind.CONTINUOUS else 0.0 for c in chosen]
    rows, least = stacked(chosen, demo.feature_rows), CHANGE * np.array(scale)
    kept, last, first = list[int](), len(demo.actions) - 1, 0  # first row since the last kept step
    for step, action in enumerate(demo.actions):
        changed = (np.abs(rows[step + 1] - rows[first]) > least).any()
        if action not in idle or changed or (step == last and demo.terminated):
            kept.append(step)
            first = step + 1
    if not kept:
        return demo
    seen = [*kept, kept[-1] + 1]

    def of(values: Sequence[T], rows: Sequence[int]) -> tuple[T, ...]:
        return tuple(values[row] for row in rows)

    return replace(
        demo,
        features=of(demo.features, seen),
        states=of(demo.states, seen),
        actions=of(demo.actions, kept),
        rewards=of(demo.rewards, kept),
        machine_steps=sum(step < demo.machine_steps for step in kept),
    )


def group_by_option(
    demonstrations: Iterable[Demonstration],
) -> dict[tuple[str, str], list[Demonstration]]:
    """
    Group by (participant, option name), in order of first appearance, each sorted by number.

    Duplicates and withdrawn demonstrations are dropped.
    """
    groups: dict[tuple[str, str], list[Demonstration]] = {}
    for demo in each_once(demonstrations):
        if not demo.withdrawn:
            groups.setdefault((demo.participant, demo.option_name), []).append(demo)
    for group in groups.values():
        group.sort(key=lambda demo: (demo.number, demo.uuid))
    return groups


def _faults(demo: Demonstration, domain: ActableDomain) -> Iterator[str]:
    """
    Yield the faults of a demonstration; later checks rely on earlier ones.

    :raises DemonstrationError: its learning method is invalid.
    """
    try:
        uuid_module.UUID(demo.uuid)
    except ValueError:
        yield f'its uuid {demo.uuid!r} is not a UUID'
    try:
        parameters = parse_json(demo.domain_parameters or '{}', MAX_PARAMETERS)
    except JsonError as error:
        yield f'its domain parameters are not JSON: {error}'
    if demo.domain != domain.name or parameters != dict(domain.parameters):
        yield (
            f'it is of domain {demo.domain} {demo.domain_parameters}, and the game is '
            f'{domain.name} {parameters_json(domain)}'
        )
    if not demo.option_name.strip():
        yield 'it names no option'
    for fault in (
        option_name_fault(demo.option_name),
        _text_fault('its participant', demo.participant),
        _text_fault('its session', demo.session),
    ):
        if fault:
            yield f'it cannot be kept: {fault}'
    if demo.participant.startswith(MACHINE):
        yield (
            f'its participant is {demo.participant!r}; codes that begin with {MACHINE} are '
            'reserved for automatic options'
        )
    if not demo.chosen_features:
        yield 'it names no feature that the option depends on'
    check_method(demo.method, domain)
    known = tuple(feature.name for feature in domain.features)
    if demo.feature_names != known:
        yield f'its features are not those of {domain.name}: {", ".join(demo.feature_names)}'
    try:
        feature_columns(domain, demo.chosen_features)
    except DomainError as error:
        yield str(error)
    steps = len(demo.actions)
    if [len(row) for row in demo.features] != [len(known)] * len(demo.states):
        yield (
            f'it has {len(demo.states)} states but {len(demo.features)} rows of features, '
            f'or rows that are not {len(known)} wide'
        )
    if demo.kind is Kind.TRAJECTORY and steps == 0:
        yield 'it has no steps'
    if demo.kind is Kind.NOT_HERE and (steps or len(demo.states) != 1):
        yield 'a "not here" answer has one state and no steps'
    if (demo.kind is Kind.JUDGED) != bool(demo.option_version):
        yield 'a judged run, and only that, says which version of the option ran'
    if len(demo.states) != steps + 1 or len(demo.rewards) != steps:
        yield (
            f'{steps} actions need {steps + 1} states and {steps} rewards, not '
            f'{len(demo.states)} and {len(demo.rewards)}'
        )
    if demo.machine_steps > steps:
        yield f"{demo.machine_steps} of its {steps} steps are the machine's"
    if not all(math.isfinite(value) for value in (*demo.rewards, demo.seconds)):
        yield 'it holds a number that is not finite (NaN or infinity)'
    try:
        actions = [action_index(domain, name) for name in demo.actions]
        for values in demo.features:
            check_features(values, domain)
        if not can_simulate(domain):
            return
        states = [domain.decode(text) for text in demo.states]
    except ValueError as error:
        yield str(error)
        return
    for row, values in enumerate(feature_rows(domain, states).tolist()):
        if tuple(values) != demo.features[row]:
            yield f'the features of state {row} do not match that state'
    for t, action in enumerate(actions):
        if domain.is_over(states[t]):
            yield f'it continues after the task was over in state {t}'
        if not domain.can_follow(states[t], action, states[t + 1]):
            yield (
                f'action {demo.actions[t]} does not lead from state {t} ({demo.states[t]}) '
                f'to state {t + 1} ({demo.states[t + 1]})'
            )
