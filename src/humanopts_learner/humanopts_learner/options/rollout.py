"""Rollouts: options run to termination by the rules of their domain, without a graph."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import (
    ActableDomain,
    Domain,
    DomainError,
    EnumerableDomain,
    is_enumerable,
)
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.games import Chance, Games, games_at
from humanopts_env.seeding import generator
from humanopts_learner.execution import (
    Execution,
    Fixed,
    Loops,
    play,
    Played,
    RowOptions,
    SeenRows,
)
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import (
    LearnedOption,
    OptionTable,
    TabularOption,
    tabulate,
)
import numpy as np
from numpy.typing import NDArray


def is_deterministic(domain: ActableDomain) -> TypeGuard[EnumerableDomain]:
    """Return whether all states can be listed and every action has a single outcome."""
    return is_enumerable(domain) and domain.transitions().deterministic


def without_chance(domain: ActableDomain) -> bool:
    """Return whether a state and the actions determine the outcome of a run."""
    return is_deterministic(domain) or isinstance(domain, ReplayedDomain)


@dataclass(frozen=True)
class Rollouts:
    """The outcomes of running an option from each of N start states."""

    total_reward: Floats  # (N,) undiscounted
    last_reward: Floats  # (N,) reward of the last step
    steps: Ints  # (N,)
    reached: Flags  # (N,) beta holds or the task is over; else cut off
    over: Flags  # (N,) the task is over
    rows: Rows  # (N, F) features at the end

    @classmethod
    def of(cls, played: Played, rows: Rows) -> 'Rollouts':
        """Return the outcomes of games that ended with their first run."""
        runs, order = played.runs, np.argsort(played.runs.game)
        reached = (runs.reached | runs.over)[order]
        rewards = runs.total[order], runs.last_reward[order]
        return cls(*rewards, runs.steps[order], reached, runs.over[order], rows)


def rollouts(
    options: LearnedOption | Sequence[LearnedOption],
    domain: Domain,
    starts: Sequence[Any],
    seed: int = 0,
    keys: Sequence[str] = (),
    max_steps: int | NDArray[np.integer] | None = None,
) -> Rollouts:
    """
    Run an option from every start state, in parallel.

    Each run has its own random generator, so its outcome does not depend on the others.

    :param options: option of each run (N,), or one for all.
    :param starts: (N,) start states, in which the task is not over.
    :param keys: (N,) names of the runs; chance in a run depends on seed, option and name.
    :param max_steps: maximum steps per run, 1 or more, for all or each (N,); None: the option's.
    :raises OptionError: an option was not learned in this domain.
    :raises DomainError: the task is over in a start state.
    """
    count = len(starts)
    each = [options] * count if isinstance(options, LearnedOption) else list(options)
    several = {id(option): option for option in each}
    number = {key: index for index, key in enumerate(several)}
    which = np.array([number[id(option)] for option in each], dtype=np.intp)
    for option in several.values():
        option.check_domain(domain)
    limits = np.array([option.max_steps for option in each], dtype=np.intp)
    if max_steps is not None:
        limits = np.broadcast_to(max_steps, count).astype(np.intp)
    chance: Chance = np.random.default_rng(0)  # unused without chance
    if not is_deterministic(domain):
        names = keys or [str(index) for index in range(count)]
        chance = [
            generator(seed, 'rollout', o.name, key) for o, key in zip(each, names, strict=True)
        ]
    return run_once(domain, starts, list(several.values()), which, limits, chance)


def run_once(
    domain: Domain,
    starts: Sequence[Any],
    options: Sequence[Option],
    which: Ints,
    limits: Ints,
    chance: Chance,
    loops: Loops | None = None,
    on_step: Callable[[int, Execution[SeenRows], SeenRows, Games], object] | None = None,
) -> Rollouts:
    """
    Run an option from each start state.

    :param which: (N,) index of the option of each run.
    :param limits: (N,) maximum number of steps per run, 1 or more.
    :param loops: as in ``play``.
    :param on_step: as in ``play``; not called if the options are tabulated.
    :raises DomainError: the task is over in a start state.
    """
    games = games_at(domain, starts)
    if games.over().any():
        raise DomainError('the task is over in a start state, so no step can be taken')
    longest, final = int(limits.max(initial=0)), games.features()
    learned = [option for option in options if isinstance(option, LearnedOption)]
    more: dict[str, Any] = {'limits': limits, 'once': True, 'loops': loops, 'final': final}
    if is_deterministic(domain) and len(learned) == len(options):
        table = OptionTable([tabulate(option, domain) for option in learned])
        return Rollouts.of(play(games, table, Fixed(which), chance, longest, **more), final)
    played = play(
        games, RowOptions(options), Fixed(which), chance, longest, on_step=on_step, **more
    )
    return Rollouts.of(played, final)


@dataclass(frozen=True)
class FinalRollouts(Rollouts):
    """Rollouts with their final states."""

    final: Ints  # (N,) state indices


def rollouts_from_everywhere(domain: EnumerableDomain, option: TabularOption) -> FinalRollouts:
    """
    Run an option from each of the S states of a deterministic domain.

    The length of all runs is doubled repeatedly, so cyclic runs cost no more than others. Results
    are meaningless if the task is over at the start. For a run that never ends, the return and the
    number of steps are not those at its step limit.
    """
    transitions, over = domain.transitions(), domain.over()
    states = np.arange(domain.n_states)
    taken = states, option.action, np.zeros_like(states)
    final, total = transitions.successor[taken].astype(np.intp), transitions.reward[taken].copy()
    last = total.copy()
    reached = option.termination[final] | over[final] | transitions.terminated[taken]
    steps, length = np.ones(domain.n_states, dtype=np.int64), 1
    while length < option.max_steps:
        on = np.flatnonzero(~reached)
        next_states = final[on]
        total[on] += total[next_states]
        last[on] = last[next_states]
        steps[on] += steps[next_states]
        final[on], reached[on] = final[next_states], reached[next_states]
        length *= 2
    reached &= steps <= option.max_steps
    rows = domain.feature_table()[final]
    return FinalRollouts(total, last, steps, reached, over[final], rows, final)
