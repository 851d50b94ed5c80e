"""
SMDP Q-learning and intra-option Q-learning, many learners side by side.

R. S. Sutton, D. Precup and S. Singh (1999), "Between MDPs and semi-MDPs". SMDP Q-learning (section
3.2; "macro Q-learning" for options that cannot be interrupted) learns of an option when it ends
after k steps, with r the discounted reward in between:

    Q(s, o) += rate * (r + gamma**k * max Q(s', .) - Q(s, o))

Intra-option Q-learning (section 6) learns with every step, of all options that would have done
the same there, whichever runs, with U(s', o) = Q(s', o) where o goes on and max Q(s', .) where it
ends:

    Q(s, o) += rate * (r + gamma * U(s', o) - Q(s, o))

Intra-option learning ignores the step limits of options, which depend on more than the state.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_env.seeding import generator
from humanopts_learner.options.option import OptionTable
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray

SLOWEST, FASTEST = 0.05, 1.0  # learning rates that are tried
LEAST, MOST = 0.005, 0.3  # shares of exploring decisions that are tried


class Method(Enum):
    """When the learners update."""

    SMDP = 'smdp'  # the end of each run of an option
    INTRA_OPTION = 'intra-option'  # each step


@dataclass(frozen=True)
class Rates:
    """
    How one learner learns and explores.

    :raises PlanError: a number is out of range.
    """

    learning_rate: float = 0.1
    explore: float = 0.1  # share of decisions that are drawn from all that is available

    def __post_init__(self) -> None:
        if not (0.0 < self.learning_rate <= 1.0 and 0.0 <= self.explore <= 1.0):
            raise PlanError(f'{self}: the rate must be above 0, and both at most 1')


@dataclass(frozen=True)
class Settings:
    """How long, and by which method, all learners learn."""

    episodes: int
    method: Method = Method.SMDP
    gamma: float = 0.0  # discount per primitive step; 0: the domain's own
    max_steps: int = 0  # after which an episode is cut off; 0: the domain's own limit


@dataclass(frozen=True)
class Learning:
    """Results of N learners in E episodes each."""

    steps: Ints  # (N, E) primitive steps
    returns: Floats  # (N, E) undiscounted
    values: Floats  # (N, S, O) after the last episode


@dataclass(frozen=True)
class Learners:
    """Learners with the same options and one generator; beside others, they learn as alone."""

    options: OptionTable
    rates: Sequence[Rates]  # of the N learners, which draw independently
    seed: int


def learn_in_step(
    domain: EnumerableDomain[Any],
    groups: Sequence[Learners],
    settings: Settings,
) -> list[Learning]:
    """
    Learn from values of 0, each option run to its end; groups of learners step side by side.

    Where an episode is cut off, SMDP learning takes the running option as ended there.

    :return: what each group learned.
    :raises PlanError: nothing limits the episodes, or there are no learners or no episodes.
    """
    limit = settings.max_steps or domain.max_steps
    counts = [len(group.rates) for group in groups]
    if limit < 1 or settings.episodes < 1 or min(counts, default=0) < 1:
        raise PlanError(
            f'cannot learn with {min(counts, default=0)} learners in {settings.episodes} episodes '
            f'of {limit} steps: each must be 1 or more'
        )
    gamma, episodes, count = settings.gamma or domain.gamma, settings.episodes, sum(counts)
    chance = _Chance([generator(g.seed, 'qlearning', settings.method.value) for g in groups])
    simulator = TabularSimulator(domain.transitions(), domain.over())
    starts = domain.start_states().astype(np.intp)
    draw_start = partial(_draw_below, len(starts))
    steps, returns = np.zeros((count, episodes), dtype=np.intp), np.zeros((count, episodes))
    tables = _Tables([group.options for group in groups])
    values = np.zeros((count, domain.n_states, tables.width))
    live = _Live(groups, tables, domain.n_states)
    live.state = starts.take(chance.draw(live.group, draw_start))
    while live.number.size:
        free = np.flatnonzero(live.option < 0)
        if free.size:
            live.option[free] = _choose(values, tables, live, free, chance)
            live.begun[free], live.ran[free] = live.state.take(free), 0
            live.gained[free], live.discount[free] = 0.0, 1.0

        here, running = live.state, live.base + live.option
        action = tables.action.take(running * domain.n_states + here)
        drawn = None
        if not simulator.deterministic:
            drawn = chance.draw(live.group, simulator.draw)
        there, reward, over = simulator.step(here, action, drawn)
        live.steps += 1
        live.returns += reward
        live.gained += live.discount * reward
        live.discount *= gamma
        live.ran += 1
        done = over | (live.steps >= limit)
        ended = done | tables.ends.take(running * domain.n_states + there)
        ended |= live.ran >= tables.limits.take(running)
        if settings.method is Method.SMDP:
            _learn_of_runs(values, tables, live, np.flatnonzero(ended), there, over)
        else:
            _learn_of_steps(values, tables, live, action, there, reward, over, gamma)

        live.state = there
        live.option[ended] = -1
        at = np.flatnonzero(done)
        if at.size:
            episode = live.number[at], live.episode[at]
            steps[episode], returns[episode] = live.steps[at], live.returns[at]
            live.episode[at] += 1
            live.steps[at], live.returns[at] = 0, 0.0
            live.state[at] = starts.take(chance.draw(live.group[at], draw_start))
            if (live.episode[at] == episodes).any():
                live.keep(live.episode < episodes)
    first = np.cumsum([0, *counts])
    return [
        Learning(steps[i:k], returns[i:k], values[i:k, :, : len(group.options.names)])
        for group, i, k in zip(groups, first, first[1:])
    ]


def _draw_below(limit: int, rng: np.random.Generator, count: int) -> Ints:
    return rng.integers(limit, size=count)


class _Chance:
    """Draws for the learners of several groups, from the generator of each."""

    def __init__(self, rngs: Sequence[np.random.Generator]) -> None:
        self._rngs = rngs

    def parts(self, group: Ints) -> Iterator[tuple[int, np.random.Generator, int, int]]:
        """Yield the number, generator, and the first and last place of each group (n,) there."""
        ends = group.searchsorted(np.arange(len(self._rngs)), side='right').tolist()
        for number, (begin, end) in enumerate(zip([0, *ends], ends)):
            if begin < end:
                yield number, self._rngs[number], begin, end

    def draw(self, group: Ints, draw: Callable[[np.random.Generator, int], Any]) -> NDArray[Any]:
        """Return what each group (n,) draws for its learners, (n,)."""
        parts = [draw(rng, end - begin) for _, rng, begin, end in self.parts(group)]
        return np.concatenate(parts)


class _Tables:
    """
    The options of G groups as flat tables. Groups with fewer options than others are filled up.

    :ivar width: the greatest number of options, O.
    :ivar first: (G,) number of each group's first option among those of all, P.
    :ivar action: (P * S,) primitive action of each option; as ``ends``.
    :ivar limits: (P,).
    :ivar acting: (G * S, O) actions of a group's options by state; -1: no option.
    :ivar available: (G * S, O) whether they can be chosen.
    """

    def __init__(self, groups: Sequence[OptionTable]) -> None:
        self.counts = [len(group.names) for group in groups]
        self.width = max(self.counts)
        self.first = np.cumsum([0, *self.counts[:-1]])
        self.action = np.concatenate([group.action for group in groups]).ravel()
        self.ends = np.concatenate([group.ends for group in groups]).ravel()
        self.limits = np.concatenate([group.limits for group in groups])
        self.acting = self._by_state([group.action.T for group in groups], -1)
        self.available = self._by_state([group.available for group in groups], 0).astype(np.bool_)

    def _by_state(self, tables: Sequence[NDArray[Any]], fill: int) -> Ints:
        """Return tables (S, .) of the groups as one, filled up to the same width."""
        found = np.full((len(tables), len(tables[0]), self.width), fill, dtype=np.intp)
        for row, table in zip(found, tables):
            row[:, : table.shape[1]] = table
        return found.reshape(-1, self.width)


class _Live:
    """The n learners with episodes left, in the order of their numbers; (n,) of each."""

    def __init__(self, groups: Sequence[Learners], tables: _Tables, n_states: int) -> None:
        rates = [one for group in groups for one in group.rates]
        count = len(rates)
        self.number = np.arange(count)
        self.group = np.repeat(np.arange(len(groups)), [len(each.rates) for each in groups])
        self.base = tables.first[self.group]  # number of the group's first option
        self.place = self.group * n_states  # row of the group's state 0 in tables by state
        self.row = np.arange(count) * n_states  # of the learner's state 0 among all values
        self.rate = np.array([one.learning_rate for one in rates])
        self.explore = np.array([one.explore for one in rates])
        self.state = np.zeros(count, dtype=np.intp)
        self.option = np.full(count, -1, dtype=np.intp)  # running; -1: to be decided
        self.begun = np.zeros(count, dtype=np.intp)  # state in which the option began
        self.ran = np.zeros(count, dtype=np.intp)  # its steps so far
        self.gained = np.zeros(count)  # since it began, discounted
        self.discount = np.ones(count)  # gamma**ran
        self.episode = np.zeros(count, dtype=np.intp)
        self.steps = np.zeros(count, dtype=np.intp)  # of the episode so far
        self.returns = np.zeros(count)  # undiscounted

    def keep(self, chosen: Flags) -> None:
        for name, values in vars(self).items():
            setattr(self, name, values[chosen])


def _learn_of_runs(
    values: Floats, tables: _Tables, live: _Live, at: Ints, there: Ints, over: Flags
) -> None:
    """
    Update by SMDP Q-learning.

    :param at: (m,) which of the n learners' options ended in this step.
    :param there: (n,) states after it.
    """
    row, after = live.row.take(at), there.take(at)
    ahead = _ahead(values, tables, row + after, live.place.take(at) + after, over.take(at))
    goal = live.gained.take(at) + live.discount.take(at) * ahead
    place = (row + live.begun.take(at)) * tables.width + live.option.take(at)
    _move(values, place, live.rate.take(at), goal)


def _learn_of_steps(
    values: Floats,
    tables: _Tables,
    live: _Live,
    action: Ints,
    there: Ints,
    reward: Floats,
    over: Flags,
    gamma: float,
) -> None:
    """
    Update by intra-option Q-learning all options that would have done the same.

    :param there: (n,) states after the step.
    """
    ahead = _ahead(values, tables, live.row + there, live.place + there, over)
    acting = tables.acting.take(live.place + live.state, axis=0)
    at, same = np.nonzero(action[:, None] == acting)
    row, after = live.row.take(at), there.take(at)
    onward = values.reshape(-1).take((row + after) * tables.width + same)
    onward[over.take(at)] = 0.0
    ends = tables.ends.take((live.base.take(at) + same) * values.shape[1] + after)
    goal = reward.take(at) + gamma * np.where(ends, ahead.take(at), onward)
    place = (row + live.state.take(at)) * tables.width + same
    _move(values, place, live.rate.take(at), goal)


def _ahead(values: Floats, tables: _Tables, row: Ints, place: Ints, over: Flags) -> Floats:
    """
    Return the value of the best option, (n,); 0 where there is none, or the task is over.

    :param row: (n,) of the states among all values.
    :param place: (n,) of the states in tables by state.
    """
    can = tables.available.take(place, axis=0)
    known = values.reshape(-1, tables.width).take(row, axis=0)
    best: Floats = np.where(can, known, -np.inf).max(axis=1)
    best[over | ~can.any(axis=1)] = 0.0
    return best


def _move(values: Floats, place: Ints, rate: Floats, goal: Floats) -> None:
    """Move the values at some places, each once, towards goals."""
    flat = values.reshape(-1)
    known = flat.take(place)
    flat[place] = known + rate * (goal - known)


def _choose(values: Floats, tables: _Tables, live: _Live, free: Ints, chance: _Chance) -> Ints:
    """
    Return an option for some learners (m,): the best, any of equals, or now and then any.

    :param free: (m,) which of the n learners.
    """
    state, group = live.state.take(free), live.group.take(free)
    can = tables.available.take(live.place.take(free) + state, axis=0)
    known = values.reshape(-1, tables.width).take(live.row.take(free) + state, axis=0)
    known = np.where(can, known, -np.inf)
    among = known == known.max(axis=1, keepdims=True)
    draws, explores = np.zeros(can.shape), np.empty(len(free))
    for number, rng, begin, end in chance.parts(group):
        explores[begin:end] = rng.random(end - begin)
        shape = end - begin, tables.counts[number]
        draws[begin:end, : shape[1]] = rng.random(shape)
    among |= (explores < live.explore.take(free))[:, None]
    among &= can
    chosen: Ints = np.where(among, draws, -1.0).argmax(axis=1)
    return chosen


def drawn_rates(seed: int, count: int) -> list[Rates]:
    """Draw rates to try, uniform in their logarithms; the first are the usual ones, 0.1."""
    rng = generator(seed, 'rates')
    draws = rng.random((count - 1, 2))
    learning = SLOWEST * (FASTEST / SLOWEST) ** draws[:, 0]
    exploring = LEAST * (MOST / LEAST) ** draws[:, 1]
    return [Rates(), *(Rates(float(a), float(b)) for a, b in zip(learning, exploring))]


def best_rates_of_each(
    domain: EnumerableDomain[Any],
    groups: Sequence[tuple[OptionTable, int]],
    candidates: Sequence[Rates],
    runs: int,
    settings: Settings,
) -> list[Rates]:
    """
    Return the rates with the fewest steps in all episodes, averaged over some runs.

    Give every action set the same candidates, runs and episodes: then the search is equally long
    for all. Learn anew with another seed to judge the rates that were chosen.

    :param groups: options, each with the seed of its search.
    :param runs: learners for each candidate.
    :return: the rates of each group.
    :raises PlanError: as ``learn_in_step``.
    """
    every = [rates for rates in candidates for _ in range(runs)]
    learners = [Learners(options, every, seed) for options, seed in groups]
    learned = learn_in_step(domain, learners, settings)
    scores = [one.steps.reshape(len(candidates), -1).mean(axis=1) for one in learned]
    return [candidates[int(score.argmin())] for score in scores]


def draw_among(among: Flags, rng: np.random.Generator) -> Ints:
    """Return the index (N,) of one True entry of each row (N, A), all equally likely."""
    chosen: Ints = np.where(among, rng.random(among.shape), -1.0).argmax(axis=1)
    return chosen
