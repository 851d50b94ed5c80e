"""A quick look at a domain of another package, before a game is played in it."""

import json
import math
import time
from typing import Any

from humanopts_env.contract import NAME, NAMED_KEYS, refuses
from humanopts_env.domains.base import Action, Domain, DomainError, Feature, is_enumerable
from humanopts_env.seeding import generator
import numpy as np

STEPS = 60  # of the random walk
SECONDS = 0.025  # after which no more steps are taken
SMALL = 20_000  # states of which the tables are looked at
FIELDS = ('parameters', 'features', 'actions', 'gamma', 'max_steps', 'glyph_styles')
METHODS = (
    'reset', 'step', 'is_over', 'can_follow', 'feature_values', 'encode', 'decode',
    'sample_states', 'render',
)  # fmt: skip


class ContractError(DomainError):
    """A domain breaks what every domain promises; the text says which domain and what."""


class _Breach(Exception):  # noqa: N818 - becomes a ContractError
    pass


def check_domain(domain: Domain[Any], name: str) -> None:
    """
    Look whether a domain keeps the promises that a game relies on, by sampling.

    It takes some hundredths of a second, so it finds what is plainly wrong; the tests of
    ``humanopts_env.contract`` look at everything.

    :param name: under which the domain is registered.
    :raises ContractError: it breaks a promise, or raises what no domain may raise.
    """
    try:
        _check_form(domain, name)
        _check_walk(domain)
        _check_refusals(domain)
        _check_tables(domain)
    except _Breach as breach:
        raise ContractError(f'{name} breaks the contract of domains: {breach}') from None
    except (Exception, SystemExit) as error:  # whatever a plug-in raises
        raise ContractError(
            f'{name} breaks the contract of domains: it raised {type(error).__name__}: {error}'
        ) from error


def _expect(kept: object, breach: str) -> None:
    if not kept:
        raise _Breach(breach)


def _check_form(domain: Domain[Any], name: str) -> None:
    missing = [part for part in (*FIELDS, *METHODS) if not hasattr(domain, part)]
    _expect(not missing, f'it has no {", ".join(missing)}')
    _expect(getattr(domain, 'name', '') == name, f'it calls itself {domain.name!r}')
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
        _expect(feature.values, f'the feature {feature.name} has no values')
    keys = [action.key for action in domain.actions]
    _expect(len(set(keys)) == len(keys), f'two actions have one key: {keys}')
    for key in keys:
        _expect(len(key) == 1 or key in NAMED_KEYS, f'{key!r} is no key')


def _check_walk(domain: Domain[Any]) -> None:
    """Take random steps until the time is over, and the first of them again."""
    began, rng = time.perf_counter(), generator(0, 'check')
    state = domain.reset(rng)
    _expect(not domain.is_over(state), f'it begins where the task is over: {state}')
    for number in range(STEPS):
        _check_state(domain, state)
        action = int(rng.integers(len(domain.actions)))
        outcome, again = (domain.step(state, action, generator(1, number)) for _ in range(2))
        where = f'{domain.actions[action].name} in {domain.encode(state)!r}'
        _expect(math.isfinite(outcome.reward), f'{where} has the reward {outcome.reward}')
        _expect(outcome == again, f'{where} is not the same again with the same generator')
        over = domain.is_over(outcome.state)
        _expect(outcome.terminated == over, f'{where}: terminated and is_over disagree')
        _expect(domain.can_follow(state, action, outcome.state), f'can_follow denies {where}')
        if over:
            _check_end(domain, outcome.state)
        state = domain.reset(rng) if over else outcome.state
        if time.perf_counter() - began > SECONDS:
            break


def _check_state(domain: Domain[Any], state: Any) -> None:
    text, values = domain.encode(state), domain.feature_values(state)
    _expect(len(text.splitlines()) == 1, f'{text!r} is not one line')
    _expect(domain.decode(text) == state, f'{text!r} is read back as another state')
    _expect(values.shape == (len(domain.features),), f'{text!r} has {values.shape} features')
    _check_values(domain, values[None], text)
    _expect(domain.render(state), f'{text!r} is drawn as nothing')


def _check_values(domain: Domain[Any], rows: Any, where: str) -> None:
    for column, feature in enumerate(domain.features):
        low, high = int(rows[:, column].min()), int(rows[:, column].max())
        fits = 0 <= low <= high < len(feature.values)
        _expect(
            fits,
            f'the feature {feature.name} is {low if low < 0 else high} in {where}, out of its '
            f'range 0..{len(feature.values) - 1}',
        )


def _check_refusals(domain: Domain[Any]) -> None:
    rng = generator(0, 'check', 'refusals')
    state = domain.reset(rng)
    for action in (-1, len(domain.actions)):
        refused = refuses(lambda action=action: domain.step(state, action, rng))
        _expect(refused, f'it takes the action {action}, of {len(domain.actions)}')
    refused = refuses(lambda: domain.decode('no state at all'))
    _expect(refused, 'it reads "no state at all" as a state')


def _check_end(domain: Domain[Any], state: Any) -> None:
    refused = refuses(lambda: domain.step(state, 0, generator(0, 'check', 'end')))
    _expect(refused, f'it takes a step after the end, in {domain.encode(state)!r}')


def _check_tables(domain: Domain[Any]) -> None:
    if not is_enumerable(domain) or domain.n_states > SMALL:
        return
    table = domain.transitions()
    _expect(np.allclose(table.probability.sum(axis=2), 1), 'probabilities do not sum to 1')
    _expect(table.probability.min() >= 0, 'a probability is negative')
    inside = (table.successor >= 0) & (table.successor < domain.n_states)
    _expect(inside.all(), 'a transition leads to no state')
    _check_values(domain, domain.feature_table(), 'its feature table')
    for index in np.flatnonzero(domain.over())[:5]:
        _check_end(domain, domain.state_at(int(index)))
