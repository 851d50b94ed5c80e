"""
Accuracy of a learned option, compared with its reference option (section 7.1).

A policy has two measures: the share of states in which it takes an optimal action and, as in the
paper, the average return of its runs. Classification accuracy measures I and beta.

Accuracy is measured over all states if they can be listed, and otherwise over a fixed sample.
Each part is measured where it is used:

- pi in the states of the reference's initiation set where the task is not over;
- I in all reachable states where the task is not over;
- beta where the option can be after a step: in its initiation set, and in states to which one of
  its optimal actions leads. Beta in a room that the option never enters is irrelevant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.reference import (
    judge_games,
    Judgement,
    ReferenceOption,
    TabularReferenceOption,
)
from humanopts_env.domains.registry import KeyedDomain
from humanopts_env.games import Chance, Games, games_at
from humanopts_env.seeding import generator
from humanopts_learner.execution import Fixed, play
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.rollout import is_deterministic
import numpy as np

SAMPLE = 2000  # number of states, if they cannot be listed
RUNS = 400  # maximum number of runs per average return
MAX_RUN_STEPS = 100


@dataclass(frozen=True)
class _Answers:
    """Reference values, and the features (., F) of the states in which they are compared."""

    starts: list[Any]  # at most RUNS states where the option acts
    acting: Rows  # (N, F)
    optimal: Flags  # (N, A)
    starting: Rows  # (M, F)
    initiation: Flags  # (M,)
    ending: Rows  # (K, F)
    termination: Flags  # (K,)


def policy_accuracy(option: LearnedOption, domain: Domain, reference: ReferenceOption) -> float:
    """
    Return the share of states in which the most likely action is optimal.

    :return: 0..1; NaN if the reference cannot start anywhere.
    :raises OptionError: the option was not learned in this domain.
    """
    option.check_domain(domain)
    right = _answers(domain, reference)
    if not len(right.acting):
        return float('nan')
    action = option.action(right.acting)
    return float(right.optimal[np.arange(len(action)), action].mean())


def average_returns(
    options: Sequence[LearnedOption | None], domain: Domain, reference: ReferenceOption
) -> list[float]:
    """
    Return the average undiscounted return of each policy, in reward units.

    Runs start where the reference option can start, in the same states and with the same random
    numbers for every option. They end where the reference option ends, when the task is over, or
    after ``MAX_RUN_STEPS``. The learned beta is not used: it is measured separately, and ending
    too early would save the cost of steps.

    :param options: learned options; None: the reference itself, with its first optimal action.
    :return: NaN if the reference cannot start anywhere.
    :raises OptionError: an option was not learned in this domain.
    """
    for option in options:
        if option is not None:
            option.check_domain(domain)
    starts, count = _answers(domain, reference).starts, len(options)
    if not starts:
        return [float('nan')] * count
    chance: Chance = np.random.default_rng(0)  # unused without chance
    if not is_deterministic(domain):
        keys = [('accuracy', 'return', domain.name, run) for run in range(len(starts))]
        chance = [generator(0, *key) for key in keys * count]
    games, until = games_at(domain, starts * count), _UntilReference(options, reference)
    policy = Fixed(np.repeat(np.arange(count), len(starts)))
    played = play(games, until, policy, chance, MAX_RUN_STEPS, once=True)
    returns = played.by_game(played.runs.total).reshape(count, -1)
    return [float(each.mean()) for each in returns]


class _UntilReference:
    """Options that end where a reference option ends; None: the reference option itself."""

    def __init__(
        self, options: Sequence[LearnedOption | None], reference: ReferenceOption
    ) -> None:
        self.options, self.reference = options, reference
        self.limits = np.full(len(options), MAX_RUN_STEPS)

    def see(self, games: Games) -> '_Seen':
        return _Seen(self, games, games.features(), judge_games(self.reference, games))


@dataclass(frozen=True)
class _Seen:
    until: _UntilReference
    games: Games
    rows: Rows
    judged: Judgement

    def take(self, games: Ints) -> '_Seen':
        return self.until.see(self.games.take(games))

    def action(self, option: Ints) -> Ints:
        action: Ints = self.judged.optimal.argmax(axis=1)
        for index, one in enumerate(self.until.options):
            at = np.flatnonzero(option == index)
            if one is not None and at.size:
                action[at] = one.action(self.rows[at])
        return action

    def ends(self, option: Ints) -> Flags:
        return self.judged.termination


def classification_accuracy(
    option: LearnedOption, domain: Domain, reference: ReferenceOption
) -> tuple[float, float]:
    """
    Return the shares of states in which I and beta agree with the reference.

    :return: 0..1; NaN for beta if the reference cannot start anywhere.
    :raises OptionError: the option was not learned in this domain.
    """
    option.check_domain(domain)
    right = _answers(domain, reference)
    initiation = float((option.can_start(right.starting) == right.initiation).mean())
    if not len(right.ending):
        return initiation, float('nan')
    return initiation, float((option.ends(right.ending) == right.termination).mean())


def _answers(domain: Domain, reference: ReferenceOption) -> _Answers:
    if is_enumerable(domain) and isinstance(reference, TabularReferenceOption):
        return _of_all_states(domain, reference)
    return _of_a_sample(KeyedDomain.of(domain), reference)


def _of_all_states(domain: EnumerableDomain, reference: TabularReferenceOption) -> _Answers:
    rows, table, open_states = domain.feature_table(), domain.transitions(), ~domain.over()
    transitions = reference.optimal[:, :, None] & (table.probability > 0)  # (S, A, B)
    can_be = reference.initiation.copy()
    can_be[table.successor[transitions]] = True
    acts, starts, ends = (
        reference.initiation & open_states,
        reference.judged & open_states,
        reference.judged,
    )
    ends = ends & can_be
    begun = np.flatnonzero(acts)
    begun = begun[np.linspace(0, len(begun), min(len(begun), RUNS), False, dtype=np.intp)]
    return _Answers(
        [domain.state_at(index) for index in begun.tolist()],
        rows[acts],
        reference.optimal[acts],
        rows[starts],
        reference.initiation[starts],
        rows[ends],
        reference.termination[ends],
    )


@lru_cache(maxsize=4)
def _sample(game: KeyedDomain) -> Games:
    """Return ``SAMPLE`` games in non-terminal states from all parts of the game."""
    states = game.value.sample_states(generator(0, 'accuracy', 'states', game.value.name), SAMPLE)
    return games_at(game.value, states)


@lru_cache(maxsize=32)
def _of_a_sample(game: KeyedDomain, reference: ReferenceOption) -> _Answers:
    """Return answers for a sample, with ends reached by one optimal step from acting states."""
    domain, games = game.value, _sample(game)
    rows, judged = games.features(), judge_games(reference, games)
    acts = judged.initiation
    after = games.take(np.flatnonzero(acts))
    starts = after.take(np.arange(min(len(after), RUNS))).states()
    rng = generator(0, 'accuracy', 'steps', domain.name, reference.name)
    after.step(judged.optimal[acts].argmax(axis=1), [rng] * len(after))
    then = judge_games(reference, after)
    left = ~then.initiation
    return _Answers(
        starts,
        rows[acts],
        judged.optimal[acts],
        rows,
        judged.initiation,
        np.concatenate((rows[acts], after.features()[left])),
        np.concatenate((judged.termination[acts], then.termination[left])),
    )
