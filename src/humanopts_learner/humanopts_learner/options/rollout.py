"""Rollouts: options run to their ends by the rules of their domain, without a graph."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption, Mode, option_tables
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
        tables = option_tables(option, domain)
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

    :param options: (N,), the same one as often as it runs.
    :param keys: (N,) names of the runs.
    :param limits: (N,) where they are cut off, 1 or more.
    """
    count, total = len(starts), np.zeros(len(starts))
    several = {id(option): option for option in options}
    for option in several.values():
        option.check_domain(domain)
    which = np.array([id(option) for option in options], dtype=np.int64)
    rngs = [generator(seed, 'rollout', o.name, key) for o, key in zip(options, keys, strict=True)]
    steps = np.zeros(count, dtype=np.int64)
    reached, over = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    at, going = list(starts), np.arange(count)
    rows = np.array([domain.feature_values(state) for state in at])
    while going.size:
        for key, option in several.items():
            runs = going[which[going] == key]
            actions = option.choose_actions(rows[runs], mode, [rngs[run] for run in runs])
            for run, action in zip(runs.tolist(), actions):
                outcome = domain.step(at[run], action, rngs[run])
                at[run], rows[run] = outcome.state, domain.feature_values(outcome.state)
                total[run] += outcome.reward
                over[run] = outcome.terminated or domain.is_over(outcome.state)
            on = runs[~over[runs]]
            reached[on] = option.choose_ends(rows[on], mode, [rngs[run] for run in on])
        steps[going] += 1
        reached |= over
        going = going[~reached[going] & (steps[going] < limits[going])]
    return Rollouts(total, steps, reached, over)


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
