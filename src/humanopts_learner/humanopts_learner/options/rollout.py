"""Rollouts: options run to their ends by the rules of their domain, without a graph."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import Domain, DomainError, EnumerableDomain, is_enumerable
from humanopts_env.domains.capabilities import BatchGames, feature_rows, HasBatchGames
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_env.domains.tabular_games import TabularGames
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption, TabularOption, tabulate
import numpy as np
from numpy.typing import NDArray


def is_deterministic(domain: Domain[Any]) -> TypeGuard[EnumerableDomain[Any]]:
    """Return whether all states can be listed, and every action has one outcome."""
    return is_enumerable(domain) and domain.transitions().deterministic


@dataclass(frozen=True)
class Rollouts:
    """The outcomes of running an option from each of N start states."""

    total_reward: Floats  # (N,) undiscounted
    steps: NDArray[np.int64]  # (N,)
    reached: Flags  # (N,) beta holds or the task is over; else cut off
    over: Flags  # (N,) the task is over


@dataclass(frozen=True)
class TabularRollouts(Rollouts):
    """Rollouts in an enumerable domain."""

    final: Ints  # (N,) state indices where they ended


def rollouts(
    options: LearnedOption | Sequence[LearnedOption],
    domain: Domain[Any],
    starts: Sequence[Any],
    seed: int = 0,
    keys: Sequence[str] = (),
    max_steps: int | NDArray[np.integer] | None = None,
) -> Rollouts:
    """
    Run an option, in greedy mode, from every start state, all in step.

    A run ends where the termination condition holds, which is looked at only after a step; where
    the task is over; or after ``max_steps``. Each has a random generator of its own, so its
    outcome does not depend on the others.

    :param options: the option of each run (N,), or one for all.
    :param starts: (N,) states, not over.
    :param keys: (N,) names of the runs: chance in a run depends on the seed, the option and this.
    :param max_steps: 1 or more, for all or for each run (N,); None: those of the option.
    :raises OptionError: an option was not learned in this domain.
    :raises DomainError: the task is over in a start state.
    """
    count = len(starts)
    each = [options] * count if isinstance(options, LearnedOption) else list(options)
    several = {id(option): option for option in each}
    number = {key: index for index, key in enumerate(several)}
    which = np.array([number[id(option)] for option in each], dtype=np.intp)
    own_limits = np.array([option.max_steps for option in each], dtype=np.intp)
    limits = own_limits if max_steps is None else np.broadcast_to(max_steps, count)
    if is_deterministic(domain):
        tables = [tabulate(option, domain) for option in several.values()]
        at = np.array([domain.index(state) for state in starts], dtype=np.intp)
        return tabular_rollouts(domain, tables, which, at, limits)
    for option in several.values():
        option.check_domain(domain)
    names = keys or [str(index) for index in range(count)]
    rngs = [generator(seed, 'rollout', o.name, key) for o, key in zip(each, names, strict=True)]
    return _step_by_step(list(several.values()), which, domain, starts, rngs, limits)


def _step_by_step(
    options: Sequence[LearnedOption],
    which: Ints,
    domain: Domain[Any],
    starts: Sequence[Any],
    rngs: Sequence[np.random.Generator],
    limits: NDArray[np.integer],
) -> Rollouts:
    """
    Run options by the rules of any domain; parameters as in ``rollouts``.

    :param which: (N,) the index of the option of each run.
    """
    total, steps = np.zeros(len(starts)), np.zeros(len(starts), dtype=np.int64)
    reached, over = np.zeros(len(starts), dtype=np.bool_), np.zeros(len(starts), dtype=np.bool_)
    games = games_of(domain)
    going, batch = np.arange(len(starts)), games.batch_of(starts)
    if games.batch_over(batch).any():
        raise DomainError('the task is over in a start state, so no step can be taken')
    rows = games.batch_features(batch)
    while going.size:
        own, running = [rngs[run] for run in going.tolist()], which[going]
        actions = np.empty(len(going), dtype=np.intp)
        for index, option in enumerate(options):
            at = np.flatnonzero(running == index)
            if at.size:
                actions[at] = option.greedy_action(rows[at])
        total[going] += games.batch_step_each(batch, actions, own)
        steps[going] += 1
        rows, ended = games.batch_features(batch), games.batch_over(batch)
        over[going] = ended
        for index, option in enumerate(options):
            at = np.flatnonzero((running == index) & ~over[going])
            if at.size:
                ended[at] = option.ends(rows[at])
        reached[going] = ended
        on = np.flatnonzero(~ended & (steps[going] < limits[going]))
        if len(on) < len(going):
            going, rows, batch = going[on], rows[on], games.batch_take(batch, on)
    return Rollouts(total, steps, reached, over)


def random_rollouts(
    option: LearnedOption,
    domain: Domain[Any],
    starts: Sequence[Any],
    limits: NDArray[np.integer],
    actions: np.random.Generator,
    chance: np.random.Generator,
) -> Rollouts:
    """
    Take random actions from every start state, all in step, where an option would take its own.

    The runs end as in ``rollouts``.

    :param starts: (N,) states, not over.
    :param limits: (N,) steps after which a run is cut off, 1 or more.
    :param actions: draws the actions.
    :param chance: draws their outcomes.
    """
    games = TabularGames(domain) if is_enumerable(domain) else games_of(domain)
    count, n_actions = len(starts), len(domain.actions)
    total, steps = np.zeros(count), np.zeros(count, dtype=np.int64)
    reached, over = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    going, batch = np.arange(count), games.batch_of(starts)
    while going.size:
        chosen = actions.integers(n_actions, size=len(going))
        total[going] += games.batch_step(batch, chosen, chance)
        steps[going] += 1
        over[going] = ended = games.batch_over(batch)
        ended = ended | option.ends(games.batch_features(batch))
        reached[going] = ended
        on = np.flatnonzero(~ended & (steps[going] < limits[going]))
        if len(on) < len(going):
            going, batch = going[on], games.batch_take(batch, on)
    return Rollouts(total, steps, reached, over)


def games_of(domain: Domain[Any]) -> 'BatchGames | StateGames':
    """Return what plays many games of a domain: at once where it can, else one by one."""
    return domain.batch_games() if isinstance(domain, HasBatchGames) else StateGames(domain)


class StateGames:
    """The methods of ``BatchGames`` that rollouts need, in any domain; a batch lists states."""

    def __init__(self, domain: Domain[Any]) -> None:
        self._domain = domain

    def batch_of(self, states: Sequence[Any]) -> list[Any]:
        return list(states)

    def batch_states(self, batch: list[Any]) -> list[Any]:
        return batch

    def batch_take(self, batch: list[Any], games: Ints) -> list[Any]:
        return [batch[game] for game in games]

    def batch_step_each(
        self, batch: list[Any], actions: Ints, rngs: Sequence[np.random.Generator]
    ) -> Floats:
        outcomes = [
            self._domain.step(state, action, rng)
            for state, action, rng in zip(batch, actions.tolist(), rngs, strict=True)
        ]
        batch[:] = [outcome.state for outcome in outcomes]
        return np.array([outcome.reward for outcome in outcomes], dtype=np.float64)

    def batch_step(self, batch: list[Any], actions: Ints, rng: np.random.Generator) -> Floats:
        return self.batch_step_each(batch, actions, [rng] * len(batch))

    def batch_over(self, batch: list[Any]) -> Flags:
        return np.array([self._domain.is_over(state) for state in batch], dtype=np.bool_)

    def batch_features(self, batch: list[Any]) -> Rows:
        return feature_rows(self._domain, batch)


def tabular_rollouts(
    domain: EnumerableDomain[Any],
    options: Sequence[TabularOption],
    which: Ints,
    starts: Ints,
    limits: NDArray[np.integer],
) -> TabularRollouts:
    """
    Run options in a deterministic domain.

    :param which: (N,) the index of the option of each run.
    :param starts: (N,) its start, a state index.
    :param limits: (N,) steps after which it is cut off, 1 or more.
    """
    simulator = TabularSimulator(domain.transitions(), domain.over())
    shape = len(options), domain.n_states
    action = np.array([option.action for option in options]).reshape(shape)
    termination = np.array([option.termination for option in options]).reshape(shape)
    total, steps = np.zeros(len(starts)), np.zeros(len(starts), dtype=np.int64)
    reached, final = np.zeros(len(starts), dtype=np.bool_), starts.copy()
    is_over = np.zeros_like(reached)
    going, at, option = np.arange(len(starts)), starts, which
    while going.size:
        at, reward, is_over[going] = simulator.step(at, action[option, at], None)
        total[going] += reward
        steps[going] += 1
        final[going] = at
        ended = termination[option, at] | is_over[going]
        reached[going[ended]] = True
        on = ~ended & (steps[going] < limits[going])
        if not on.all():
            going, at, option = going[on], at[on], option[on]
    return TabularRollouts(total, steps, reached, is_over, final)


def rollouts_from_everywhere(
    domain: EnumerableDomain[Any], option: TabularOption
) -> TabularRollouts:
    """
    Run an option from each of the S states of a deterministic domain, as ``tabular_rollouts``.

    All runs are doubled in length again and again, so that states that go round in a circle cost
    no more than others. What is returned means nothing where the task is over at the start; return
    and steps of a run that comes to no end are not those at which it would be cut off.
    """
    transitions, over = domain.transitions(), domain.over()
    states = np.arange(domain.n_states)
    taken = states, option.action, np.zeros_like(states)
    final, total = transitions.successor[taken].astype(np.intp), transitions.reward[taken].copy()
    reached = option.termination[final] | over[final] | transitions.terminated[taken]
    steps, length = np.ones(domain.n_states, dtype=np.int64), 1
    while length < option.max_steps:
        on = np.flatnonzero(~reached)
        there = final[on]
        total[on] += total[there]
        steps[on] += steps[there]
        final[on], reached[on] = final[there], reached[there]
        length *= 2
    reached &= steps <= option.max_steps
    return TabularRollouts(total, steps, reached, over[final], final)
