"""
Policy and classification accuracy: a learned option beside its reference option (section 7.1).

Over all states where they can be listed, else over a fixed sample of them. Each part is judged
where it is asked:

- pi in the open states of the reference's initiation set;
- I in all open states that can be come to;
- beta where the option can be after a step: in its initiation set, and in the states outside it
  that one of its own optimal actions leads to from there. What it says of a room that it never
  enters is no error.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Generic, TypeVar

from humanopts_env.arrays import Flags, Rows
from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.capabilities import feature_rows
from humanopts_env.domains.reference import (
    judge_states,
    ReferenceOption,
    TabularReferenceOption,
)
from humanopts_env.domains.registry import parameters_json
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption
import numpy as np

T = TypeVar('T')
SAMPLE = 2000  # states, where they cannot be listed


@dataclass(frozen=True)
class _Answers:
    """The right answers, beside the features (., F) of the states in which each part is judged."""

    acting: Rows  # (N, F)
    optimal: Flags  # (N, A)
    starting: Rows  # (M, F)
    initiation: Flags  # (M,)
    ending: Rows  # (K, F)
    termination: Flags  # (K,)


def policy_accuracy(
    option: LearnedOption, domain: Domain[Any], reference: ReferenceOption
) -> float:
    """
    Return the share of states in which the likeliest action is among all optimal ones.

    :return: 0..1; NaN where the reference can start nowhere.
    :raises OptionError: the option was not learned in this domain.
    """
    option.check_domain(domain)
    right = _answers(domain, reference)
    if not len(right.acting):
        return float('nan')
    action = option.greedy_action(right.acting)
    return float(right.optimal[np.arange(len(action)), action].mean())


def classification_accuracy(
    option: LearnedOption, domain: Domain[Any], reference: ReferenceOption
) -> tuple[float, float]:
    """
    Return the shares of states that I and beta classify as the reference does.

    :return: 0..1; NaN for beta where the reference can start nowhere.
    :raises OptionError: the option was not learned in this domain.
    """
    option.check_domain(domain)
    right = _answers(domain, reference)
    initiation = float((option.can_start(right.starting) == right.initiation).mean())
    if not len(right.ending):
        return initiation, float('nan')
    return initiation, float((option.ends(right.ending) == right.termination).mean())


def _answers(domain: Domain[Any], reference: ReferenceOption) -> _Answers:
    if is_enumerable(domain) and isinstance(reference, TabularReferenceOption):
        return _of_all_states(domain, reference)
    game = _Keyed((domain.name, parameters_json(domain)), domain)
    return _of_a_sample(game, _Keyed(id(reference), reference))


def _of_all_states(domain: EnumerableDomain[Any], reference: TabularReferenceOption) -> _Answers:
    rows, table, going = domain.feature_table(), domain.transitions(), ~domain.over()
    ways = reference.optimal[:, :, None] & (table.probability > 0)  # (S, A, B)
    can_be = reference.initiation.copy()
    can_be[table.successor[ways]] = True
    acts, starts, ends = reference.initiation & going, reference.judged & going, reference.judged
    ends = ends & can_be
    return _Answers(
        rows[acts],
        reference.optimal[acts],
        rows[starts],
        reference.initiation[starts],
        rows[ends],
        reference.termination[ends],
    )


@dataclass(frozen=True)
class _Keyed(Generic[T]):
    """A value as an argument of a cached function: equal where its key is."""

    key: Hashable
    value: T = field(compare=False)  # kept with its key, so an id() as key stays its own


@lru_cache(maxsize=4)
def _sample(game: _Keyed[Domain[Any]]) -> tuple[list[Any], Rows]:
    """Return ``SAMPLE`` states from all parts of the game, never over, and their features."""
    states = game.value.sample_states(generator(0, 'accuracy', 'states', game.value.name), SAMPLE)
    return states, feature_rows(game.value, states)


@lru_cache(maxsize=32)
def _of_a_sample(game: _Keyed[Domain[Any]], meaning: _Keyed[ReferenceOption]) -> _Answers:
    """Take a step by the first optimal action wherever the option acts: some lead to its end."""
    domain, reference, count = game.value, meaning.value, len(game.value.actions)
    states, rows = _sample(game)
    said = judge_states(reference, states, count)
    acts = said.initiation
    rng = generator(0, 'accuracy', 'steps', domain.name, reference.name)
    after = [
        domain.step(states[number], int(said.optimal[number].argmax()), rng).state
        for number in np.flatnonzero(acts)
    ]
    then = judge_states(reference, after, count)
    left = ~then.initiation
    ends = [state for state, is_out in zip(after, left) if is_out]
    return _Answers(
        rows[acts],
        said.optimal[acts],
        rows,
        said.initiation,
        np.concatenate((rows[acts], feature_rows(domain, ends))),
        np.concatenate((said.termination[acts], then.termination[left])),
    )
