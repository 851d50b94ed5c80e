"""
The contract of every domain, as claims that are checked on some of its states and steps.

``make_domain`` checks these claims for domains of other packages before a game is played;
``humanopts_env.testing`` checks these and more claims on many more states.
"""

from collections.abc import Callable, Iterable
from functools import cached_property
import json
import math
import re
import time
from typing import Any

from humanopts_env.arrays import Rows
from humanopts_env.board import Board
from humanopts_env.domains.base import (
    ActableDomain,
    Action,
    Domain,
    DomainError,
    Feature,
    FeatureKind,
    is_enumerable,
    Outcome,
)
from humanopts_env.domains.capabilities import board_of
from humanopts_env.seeding import generator
import numpy as np

NAME = re.compile(r'[a-z][a-z0-9_]*')
NAMED_KEYS = {'up', 'down', 'left', 'right'}
QUICK_STEPS = 60  # steps of the random walk before a game
SECONDS = 0.025  # time limit of the random walk
MAX_STATES = 20_000  # the tables of larger domains are not checked before a game
PARTS = dict.fromkeys(
    part
    for kind in (ActableDomain, Domain)
    for part in (*kind.__annotations__, *vars(kind))
    if not part.startswith('_')
)


class ContractError(DomainError):
    """A domain breaks the contract; the message names the domain and the breach."""


class Breach(AssertionError):  # noqa: N818 - fails a test, or becomes a ContractError
    """A breach of the contract, in words."""


def expect(kept: object, breach: str) -> None:
    """
    Check one claim.

    :raises Breach: the claim does not hold.
    """
    if not kept:
        raise Breach(breach)


class Evidence:
    """
    A domain with the states and steps on which the claims are checked.

    :ivar steps: steps of a random walk with restarts: state, action, outcome.
    """

    def __init__(
        self, domain: Domain, steps: int, samples: int = 0, seconds: float = math.inf
    ) -> None:
        """
        Take a random walk.

        :param steps: maximum number of steps.
        :param samples: number of additional sampled states.
        :param seconds: time limit.
        """
        self.domain, self.samples = domain, samples
        self.steps: list[tuple[Any, int, Outcome[Any]]] = []
        began, rng = time.process_time(), self.rng('walk')  # unaffected by other programs
        state = domain.reset(rng)
        expect(not domain.is_over(state), f'it begins where the task is over: {state}')
        late = False
        while len(self.steps) < steps and not late:
            action = int(rng.integers(len(domain.actions)))
            outcome = domain.step(state, action, self.rng('step', len(self.steps)))
            self.steps.append((state, action, outcome))
            state = domain.reset(rng) if outcome.terminated else outcome.state
            late = time.process_time() - began > seconds

    def rng(self, *purpose: str | int) -> np.random.Generator:
        """Return a generator with the same draws on every call."""
        return generator(0, 'contract', *purpose)

    @cached_property
    def states(self) -> list[Any]:
        """The distinct states of the walk, including its ends, and the sampled states."""
        walked = [each for state, _, outcome in self.steps for each in (state, outcome.state)]
        sampled = self.domain.sample_states(self.rng('states'), self.samples)
        return list(dict.fromkeys([*walked, *sampled]))

    def where(self, state: Any, action: int) -> str:
        """Describe an action and its state."""
        return f'{self.domain.actions[action].name} in {self.domain.encode(state)!r}'


Claim = Callable[[Evidence], None]


def names_and_numbers_are_usable(seen: Evidence) -> None:
    _check_description(seen.domain)


def the_same_generator_gives_the_same_step(seen: Evidence) -> None:
    for number, (state, action, outcome) in enumerate(seen.steps):
        again = seen.domain.step(state, action, seen.rng('step', number))
        same = outcome == again or math.isnan(outcome.reward)  # NaN is refused below
        where = seen.where(state, action)
        expect(same, f'{where} gives another result with the same generator')


def a_state_has_a_text_features_and_a_board(seen: Evidence) -> None:
    domain = seen.domain
    for state in seen.states:
        text, values = domain.encode(state), domain.feature_values(state)
        expect(len(text.splitlines()) == 1, f'{text!r} is not one line')
        again = domain.decode(text)
        same = again == state and hash(again) == hash(state)
        expect(same, f'{text!r} is read back as another state')
        expect(
            values.shape == (len(domain.features),),
            f'{text!r} has features of shape {values.shape}, not {(len(domain.features),)}',
        )
        expect(values.dtype == np.float64, f'the features of {text!r} are {values.dtype}')
        check_values(domain, values[None], text)
        board = board_of(domain, state)
        expect(board != Board(), f'{text!r} is drawn as nothing')
        for mark in board.marks:
            inside = 0 <= mark.cell[0] < board.rows and 0 <= mark.cell[1] < board.cols
            expect(inside, f'{mark.name} is drawn outside the board in {text!r}')


def a_step_can_follow_and_says_whether_the_task_is_over(seen: Evidence) -> None:
    domain = seen.domain
    for state, action, outcome in seen.steps:
        where, over = seen.where(state, action), domain.is_over(outcome.state)
        expect(math.isfinite(outcome.reward), f'{where} has the reward {outcome.reward}')
        expect(outcome.terminated == over, f'{where}: terminated and is_over disagree')
        expect(domain.can_follow(state, action, outcome.state), f'can_follow denies {where}')


def no_step_is_taken_after_the_end(seen: Evidence) -> None:
    domain = seen.domain
    ends = [outcome.state for _, _, outcome in seen.steps if outcome.terminated]
    if is_enumerable(domain) and domain.n_states <= MAX_STATES:
        ends += [domain.state_at(int(index)) for index in np.flatnonzero(domain.over())[:100]]
    for state in ends:
        for action in range(len(domain.actions)):
            refused = refuses(domain.step, state, action, seen.rng())
            expect(refused, f'it takes a step after the end, in {domain.encode(state)!r}')


def other_actions_and_texts_are_refused(seen: Evidence) -> None:
    domain = seen.domain
    state = domain.reset(seen.rng('refusals'))
    for action in (-1, len(domain.actions)):
        refused = refuses(domain.step, state, action, seen.rng())
        expect(refused, f'it takes the action {action}, of {len(domain.actions)}')
    text = domain.encode(state)
    for bad in ('', 'no state at all', f'{text} ', f' {text}', f'{text}\n', text + text):
        expect(refuses(domain.decode, bad), f'it reads {bad!r} as a state')


def transitions_are_probabilities_of_states(seen: Evidence) -> None:
    domain = seen.domain
    if not is_enumerable(domain) or domain.n_states > MAX_STATES:
        return
    table = domain.transitions()
    expect(np.allclose(table.probability.sum(axis=2), 1), 'probabilities do not sum to 1')
    expect(table.probability.min() >= 0, 'a probability is negative')
    expect(np.isfinite(table.reward).all(), 'a reward is not finite')
    inside = (table.successor >= 0) & (table.successor < domain.n_states)
    expect(inside.all(), 'a transition leads to no state')
    check_values(domain, domain.feature_table(), 'its feature table')


CLAIMS: tuple[Claim, ...] = (
    names_and_numbers_are_usable,
    the_same_generator_gives_the_same_step,
    a_state_has_a_text_features_and_a_board,
    a_step_can_follow_and_says_whether_the_task_is_over,
    no_step_is_taken_after_the_end,
    other_actions_and_texts_are_refused,
    transitions_are_probabilities_of_states,
)


def check_domain(domain: Domain, name: str) -> None:
    """
    Check by sampling that a domain satisfies the claims required by a game.

    This takes a few hundredths of a second and finds only gross errors.

    :param name: registered name of the domain.
    :raises ContractError: the domain breaks the contract, or raises an unexpected error.
    """
    try:
        missing = [part for part in PARTS if not hasattr(domain, part)]
        expect(not missing, f'it has no {", ".join(missing)}')
        expect(domain.name == name, f'it calls itself {domain.name!r}')
        _check_description(domain)  # a walk needs actions
        seen = Evidence(domain, QUICK_STEPS, seconds=SECONDS)
        for claim in CLAIMS:
            claim(seen)
    except Breach as breach:
        raise ContractError(f'{name} breaks the contract of domains: {breach}') from None
    except DomainError as error:
        raise ContractError(f'{name} cannot be played: {error}') from error
    except (Exception, SystemExit) as error:  # any error of a plug-in
        raise ContractError(
            f'{name} breaks the contract of domains: it raised {type(error).__name__}: {error}'
        ) from error


def check_description(domain: ActableDomain) -> None:
    """
    Check the description of a domain.

    :raises ContractError: the description is invalid.
    """
    try:
        _check_description(domain)
    except Breach as breach:
        raise ContractError(f'{domain.name!r} cannot be used: {breach}') from None


def _check_description(domain: ActableDomain) -> None:
    json.dumps(dict(domain.parameters))
    expect(0 < domain.gamma <= 1, f'gamma is {domain.gamma}, not above 0 and at most 1')
    expect(domain.max_steps >= 0, f'max_steps is {domain.max_steps}')
    expect(all(isinstance(f, Feature) for f in domain.features), 'a feature is not a Feature')
    expect(all(isinstance(a, Action) for a in domain.actions), 'an action is not an Action')
    for kind, names in (
        ('feature', [feature.name for feature in domain.features]),
        ('action', [action.name for action in domain.actions]),
    ):
        expect(names, f'it has no {kind}')
        _expect_distinct(names, f'two {kind}s have one name')
        for one in names:
            expect(NAME.fullmatch(one), f'the {kind} name {one!r} is not snake_case')
    for feature in domain.features:
        if feature.kind is FeatureKind.CONTINUOUS:
            expect(
                math.isfinite(feature.span) and feature.low < feature.high,
                f'the feature {feature.name} has the range {feature.low} to {feature.high}',
            )
        else:
            expect(feature.values, f'the feature {feature.name} has no values')
            _expect_distinct(feature.values, f'two values of {feature.name} have one text')
    keys = [action.key for action in domain.actions]
    _expect_distinct(keys, 'two actions have one key')
    for key in keys:
        expect(len(key) == 1 or key in NAMED_KEYS, f'{key!r} is not a key')


def _expect_distinct(texts: Iterable[str], breach: str) -> None:
    found = list(texts)
    expect(len(set(found)) == len(found), f'{breach}: {", ".join(found)}')


def check_values(domain: ActableDomain, rows: Rows, where: str) -> None:
    """
    Check the ranges of features (N, F).

    :raises Breach: a value is out of range.
    """
    for feature, column in zip(domain.features, rows.T):
        high = feature.low + feature.span
        for value in np.unique(column):
            expect(
                feature.has(value),
                f'the feature {feature.name} is {value:g} in {where}, out of its range '
                f'{feature.low:g}..{high:g}',
            )


def refuses(call: Callable[..., object], *arguments: Any) -> bool:
    """Return whether a call raises DomainError."""
    try:
        call(*arguments)
    except DomainError:
        return True
    return False
