"""
A quick check of a domain, before a game of it is played.

``make_domain`` checks a domain of another package so. The tests of ``humanopts_env.testing`` check
everything.
"""

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
    EnumerableDomain,
    Feature,
    FeatureKind,
    is_enumerable,
    Outcome,
)
from humanopts_env.domains.capabilities import (
    board_of,
)
from humanopts_env.seeding import generator
import numpy as np

CHECKED = 400  # states and transitions of an enumerable domain compared one by one
NAME = re.compile(r'[a-z][a-z0-9_]*')
NAMED_KEYS = {'up', 'down', 'left', 'right'}


def refuses(call: Any) -> bool:
    """Return whether a call raises DomainError."""
    try:
        call()
    except DomainError:
        return True
    return False


QUICK_STEPS = 60  # of the random walk
SECONDS = 0.025  # after which no more steps are taken
SMALL = 20_000  # largest number of states whose tables are checked
PARTS = dict.fromkeys(
    part
    for kind in (ActableDomain, Domain)
    for part in (*kind.__annotations__, *vars(kind))
    if not part.startswith('_')
)


class ContractError(DomainError):
    """A domain breaks the contract; the text says which domain and what is wrong."""


class Breach(AssertionError):  # noqa: N818 - a test fails by it; or it becomes a ContractError
    """What a domain does against the contract, in words."""


def check_domain(domain: Domain[Any], name: str) -> None:
    """
    Check by sampling that a domain satisfies the contract that a game relies on.

    It takes some hundredths of a second, so it finds gross errors only; the tests of
    ``DomainContract`` check everything.

    :param name: the name under which the domain is registered.
    :raises ContractError: the domain breaks the contract, or raises an unexpected error.
    """
    try:
        missing = [part for part in PARTS if not hasattr(domain, part)]
        _expect(not missing, f'it has no {", ".join(missing)}')
        _expect(domain.name == name, f'it calls itself {domain.name!r}')
        check_form(domain)
        _check_walk(domain)
        check_refusals(domain)
        if is_enumerable(domain) and domain.n_states <= SMALL:
            check_tables(domain)
    except Breach as breach:
        raise ContractError(f'{name} breaks the contract of domains: {breach}') from None
    except (Exception, SystemExit) as error:  # whatever a plug-in raises
        raise ContractError(
            f'{name} breaks the contract of domains: it raised {type(error).__name__}: {error}'
        ) from error


def _expect(kept: object, breach: str) -> None:
    if not kept:
        raise Breach(breach)


def check_description(domain: ActableDomain) -> None:
    """
    Check what a domain says of itself.

    :raises ContractError: it cannot be used.
    """
    try:
        check_form(domain)
    except Breach as breach:
        raise ContractError(f'{domain.name!r} cannot be used: {breach}') from None


def check_form(domain: ActableDomain) -> None:
    """
    Check names, keys, numbers and parameters.

    :raises Breach: one of them cannot be used; as all checks below.
    """
    json.dumps(dict(domain.parameters))
    _expect(0 < domain.gamma <= 1, f'gamma is {domain.gamma}, not above 0 and at most 1')
    _expect(domain.max_steps >= 0, f'max_steps is {domain.max_steps}')
    _expect(all(isinstance(f, Feature) for f in domain.features), 'a feature is no Feature')
    _expect(all(isinstance(a, Action) for a in domain.actions), 'an action is no Action')
    for kind, names in (
        ('feature', [feature.name for feature in domain.features]),
        ('action', [action.name for action in domain.actions]),
    ):
        _expect(names, f'it has no {kind}')
        _expect(len(set(names)) == len(names), f'two {kind}s have one name: {names}')
        for one in names:
            _expect(NAME.fullmatch(one), f'the {kind} name {one!r} is not snake_case')
    for feature in domain.features:
        if feature.kind is FeatureKind.CONTINUOUS:
            _expect(
                math.isfinite(feature.span) and feature.low < feature.high,
                f'the feature {feature.name} has the range {feature.low} to {feature.high}',
            )
        else:
            _expect(feature.values, f'the feature {feature.name} has no values')
    keys = [action.key for action in domain.actions]
    _expect(len(set(keys)) == len(keys), f'two actions have one key: {keys}')
    for key in keys:
        _expect(len(key) == 1 or key in NAMED_KEYS, f'{key!r} is no key')


def _check_walk(domain: Domain[Any]) -> None:
    """Take random steps, each twice with the same generator, until the time is over."""
    began, rng = time.perf_counter(), generator(0, 'check')
    state = domain.reset(rng)
    _expect(not domain.is_over(state), f'it begins where the task is over: {state}')
    for number in range(QUICK_STEPS):
        check_state(domain, state)
        action = int(rng.integers(len(domain.actions)))
        outcome, again = (domain.step(state, action, generator(1, number)) for _ in range(2))
        where = f'{domain.actions[action].name} in {domain.encode(state)!r}'
        same = outcome == again or math.isnan(outcome.reward)  # nan is refused below
        _expect(same, f'{where} is not the same again with the same generator')
        check_step(domain, state, action, outcome)
        if outcome.terminated:
            check_end(domain, outcome.state)
        state = domain.reset(rng) if outcome.terminated else outcome.state
        if time.perf_counter() - began > SECONDS:
            break


def check_step(domain: Domain[Any], state: Any, action: int, outcome: Outcome[Any]) -> None:
    """Check the outcome of a step."""
    where = f'{domain.actions[action].name} in {domain.encode(state)!r}'
    _expect(math.isfinite(outcome.reward), f'{where} has the reward {outcome.reward}')
    over = domain.is_over(outcome.state)
    _expect(outcome.terminated == over, f'{where}: terminated and is_over disagree')
    _expect(domain.can_follow(state, action, outcome.state), f'can_follow denies {where}')


def check_state(domain: Domain[Any], state: Any) -> None:
    """Check text, feature values and board of a state."""
    text, values = domain.encode(state), domain.feature_values(state)
    _expect(len(text.splitlines()) == 1, f'{text!r} is not one line')
    _expect(domain.decode(text) == state, f'{text!r} is read back as another state')
    _expect(values.shape == (len(domain.features),), f'{text!r} has {values.shape} features')
    _check_values(domain, values[None], text)
    board = board_of(domain, state)
    _expect(board != Board(), f'{text!r} is drawn as nothing')
    for mark in board.marks:
        inside = 0 <= mark.cell[0] < board.rows and 0 <= mark.cell[1] < board.cols
        _expect(inside, f'{mark.name} is drawn outside the board in {text!r}')


def _check_values(domain: Domain[Any], rows: Rows, where: str) -> None:
    for feature, column in zip(domain.features, rows.T):
        high = feature.low + feature.span
        for value in np.unique(column):
            _expect(
                feature.has(value),
                f'the feature {feature.name} is {value:g} in {where}, out of its range '
                f'{feature.low:g}..{high:g}',
            )


def check_refusals(domain: Domain[Any]) -> None:
    """Check that actions and texts that are not in the domain are refused."""
    rng = generator(0, 'check', 'refusals')
    state = domain.reset(rng)
    for action in (-1, len(domain.actions)):
        refused = refuses(lambda action=action: domain.step(state, action, rng))
        _expect(refused, f'it takes the action {action}, of {len(domain.actions)}')
    refused = refuses(lambda: domain.decode('no state at all'))
    _expect(refused, 'it reads "no state at all" as a state')


def check_end(domain: Domain[Any], state: Any) -> None:
    """Check that no step is taken where the task is over."""
    for action in range(len(domain.actions)):
        refused = refuses(lambda a=action: domain.step(state, a, generator(0, 'check', 'end')))
        _expect(refused, f'it takes a step after the end, in {domain.encode(state)!r}')


def check_tables(domain: EnumerableDomain[Any]) -> None:
    """Check the tables of a domain whose states can all be listed."""
    table = domain.transitions()
    _expect(np.allclose(table.probability.sum(axis=2), 1), 'probabilities do not sum to 1')
    _expect(table.probability.min() >= 0, 'a probability is negative')
    inside = (table.successor >= 0) & (table.successor < domain.n_states)
    _expect(inside.all(), 'a transition leads to no state')
    _check_values(domain, domain.feature_table(), 'its feature table')
    for index in np.flatnonzero(domain.over())[:5]:
        check_end(domain, domain.state_at(int(index)))
