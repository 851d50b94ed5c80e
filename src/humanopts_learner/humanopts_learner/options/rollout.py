"""Rollouts: options run to their ends by the rules of their domain, without a graph."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from humanopts_env.domains.base import Domain, DomainError, EnumerableDomain, is_enumerable
from humanopts_env.domains.capabilities import feature_rows, HasBatchGames
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption, Mode, tabulate
import numpy as np
from numpy.typing import NDArray


def is_deterministic(domain: Domain[Any]) -> TypeGuard[EnumerableDomain[Any]]:
    """Tell whether all states can be listed, and every action has one outcome."""
    return is_enumerable(domain) and domain.transitions().deterministic


@dataclass(frozen=True)
class Rollouts:
    """What running an option from each of N start states led to."""

    total_reward: NDArray[np.float64]  # (N,) undiscounted
    steps: NDArray[np.int64]  # (N,)
    reached: NDArray[np.bool_]  # (N,) beta holds or the task is over; else cut off
    over: NDArray[np.bool_]  # (N,) the task is over


@dataclass(frozen=True)
class DeterministicRollouts(Rollouts):
    """Rollouts in an enumerable domain."""

    final: NDArray[np.intp]  # (N,) state indices where they ended


def rollouts(
    option: LearnedOption,
    domain: Domain[Any],
    starts: Sequence[Any],
    seed: int = 0,
    keys: Sequence[str] = (),
    mode: Mode = Mode.GREEDY,
    max_steps: int | None = None,
) -> Rollouts:
    """
    Run the option from every start state.

    It ends where the termination condition holds, which is looked at only after a step; where the
    task is over; or after ``max_steps``.

    :param starts: (N,) states, not over.
    :param keys: (N,) names of the runs: chance in a run depends on the seed, the option and this.
    :param max_steps: None: the option's own.
    :raises OptionError: the option was not learned in this domain.
    """
    limit = option.max_steps if max_steps is None else max_steps
    if mode is Mode.GREEDY and is_deterministic(domain):
        tables = tabulate(option, domain)
        at = np.array([domain.index(state) for state in starts], dtype=np.intp)
        which = np.zeros(len(at), dtype=np.intp)
        limits = np.full(len(at), limit)
        return deterministic_rollouts(
            domain, tables.action[None], tables.termination[None], which, at, limits
        )
    names = keys or [str(number) for number in range(len(starts))]
    limits = np.full(len(starts), limit)
    return rollouts_of([option] * len(starts), domain, starts, seed, names, limits, mode)


def rollouts_of(
    options: Sequence[LearnedOption],
    domain: Domain[Any],
    starts: Sequence[Any],
    seed: int,
    keys: Sequence[str],
    limits: NDArray[np.integer],
    mode: Mode = Mode.GREEDY,
) -> Rollouts:
    """
    Run an option of its own from every start state, all in step, by the rules of any domain.

    Each run has chance of its own, so what it comes to does not depend on the others.

    :param options: (N,), the same one as often as it runs.
    :param keys: (N,) names of the runs.
    :param limits: (N,) where they are cut off, 1 or more.
    :raises DomainError: the task is over in a start state.
    """
    count, total = len(starts), np.zeros(len(starts))
    several = {id(option): option for option in options}
    for option in several.values():
        option.check_domain(domain)
    which = np.array([id(option) for option in options], dtype=np.int64)
    rngs = [generator(seed, 'rollout', o.name, key) for o, key in zip(options, keys, strict=True)]
    steps = np.zeros(count, dtype=np.int64)
    reached, over = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    games = domain.batch_games() if isinstance(domain, HasBatchGames) else _StateGames(domain)
    going, batch = np.arange(count), games.batch_of(starts)
    if games.batch_over(batch).any():
        raise DomainError('the task is over in a start state, so no step can be taken')
    rows = games.batch_features(batch)
    while going.size:
        own, running = [rngs[run] for run in going], which[going]
        actions = np.empty(len(going), dtype=np.intp)
        for key, option in several.items():
            at = np.flatnonzero(running == key)
            if at.size:
                actions[at] = option.choose_actions(rows[at], mode, [own[k] for k in at])
        total[going] += games.batch_step_each(batch, actions, own)
        steps[going] += 1
        rows, ended = games.batch_features(batch), games.batch_over(batch)
        over[going] = ended
        for key, option in several.items():
            at = np.flatnonzero((running == key) & ~over[going])
            if at.size:
                ended[at] = option.choose_ends(rows[at], mode, [own[k] for k in at])
        reached[going] = ended
        on = np.flatnonzero(~ended & (steps[going] < limits[going]))
        if len(on) < len(going):
            going, rows, batch = going[on], rows[on], games.batch_take(batch, on)
    return Rollouts(total, steps, reached, over)


class _StateGames:
    """What rollouts need of ``BatchGames``, in any domain; a batch is a list of states."""

    def __init__(self, domain: Domain[Any]) -> None:
        self._domain = domain

    def batch_of(self, states: Sequence[Any]) -> list[Any]:
        return list(states)

    def batch_take(self, batch: list[Any], games: NDArray[np.intp]) -> list[Any]:
        return [batch[game] for game in games]

    def batch_step_each(
        self,
        batch: list[Any],
        actions: NDArray[np.intp],
        rngs: Sequence[np.random.Generator],
    ) -> NDArray[np.float64]:
        outcomes = [
            self._domain.step(state, action, rng)
            for state, action, rng in zip(batch, actions.tolist(), rngs, strict=True)
        ]
        batch[:] = [outcome.state for outcome in outcomes]
        return np.array([outcome.reward for outcome in outcomes], dtype=np.float64)

    def batch_over(self, batch: list[Any]) -> NDArray[np.bool_]:
        return np.array([self._domain.is_over(state) for state in batch], dtype=np.bool_)

    def batch_features(self, batch: list[Any]) -> NDArray[np.int32]:
        return feature_rows(self._domain, batch)


def deterministic_rollouts(
    domain: EnumerableDomain[Any],
    action: NDArray[np.intp],
    termination: NDArray[np.bool_],
    which: NDArray[np.intp],
    starts: NDArray[np.intp],
    max_steps: NDArray[np.integer],
) -> DeterministicRollouts:
    """
    Run several policies at once in a deterministic domain.

    :param action: (M, S) what each of M policies does in each state.
    :param termination: (M, S) where it ends.
    :param which: (N,) the policy of each run.
    :param starts: (N,) its start, a state index.
    :param max_steps: (N,) where it is cut off, 1 or more.
    """
    table, over = domain.transitions(), domain.over()
    total, steps = np.zeros(len(starts)), np.zeros(len(starts), dtype=np.int64)
    reached, final = np.zeros(len(starts), dtype=np.bool_), starts.copy()
    is_over = np.zeros_like(reached)
    going, at, policy = np.arange(len(starts)), starts, which
    while going.size:
        pair = at, action[policy, at], 0
        at = table.successor[pair]
        total[going] += table.reward[pair]
        steps[going] += 1
        final[going] = at
        is_over[going] = table.terminated[pair] | over[at]
        ended = termination[policy, at] | is_over[going]
        reached[going[ended]] = True
        on = ~ended & (steps[going] < max_steps[going])
        if not on.all():
            going, at, policy = going[on], at[on], policy[on]
    return DeterministicRollouts(total, steps, reached, is_over, final)
