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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_env.seeding import generator
from humanopts_learner.planning.exact import OptionTable
from humanopts_learner.planning.request import PlanError
import numpy as np

# Called with the share of the episodes that is done, 0..1; raises ``PlanCanceled`` to stop
Progress = Callable[[float], object]
REPORT_EVERY = 200  # steps
SLOWEST, FASTEST = 0.05, 1.0  # learning rates that are tried
LEAST, MOST = 0.005, 0.3  # shares of exploring decisions that are tried


class Method(Enum):
    """When the learners update."""

    SMDP = 'smdp'  # the end of each run of an option
    INTRA_OPTION = 'intra-option'  # each step


@dataclass(frozen=True)
class Rates:
    """How one learner learns and explores."""

    learning_rate: float = 0.1
    explore: float = 0.1  # share of decisions that are drawn from all that is available

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises PlanError: one is out of range.
        """
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


def learn(
    domain: EnumerableDomain[Any],
    options: OptionTable,
    rates: Sequence[Rates],
    settings: Settings,
    seed: int,
    progress: Progress | None = None,
) -> Learning:
    """
    Learn from values of 0, each option run to its end.

    Where an episode is cut off, SMDP learning takes the running option as ended there.

    :param rates: of the N learners, which draw independently.
    :raises PlanError: nothing limits the episodes, or there are no learners or no episodes.
    :raises PlanCanceled: from ``progress``.
    """
    limit = settings.max_steps or domain.max_steps
    if limit < 1 or settings.episodes < 1 or not rates:
        raise PlanError(
            f'cannot learn with {len(rates)} learners in {settings.episodes} episodes of {limit} '
            'steps: each must be 1 or more'
        )
    gamma, episodes, count = settings.gamma or domain.gamma, settings.episodes, len(rates)
    rng = generator(seed, 'qlearning', settings.method.value)
    simulator = TabularSimulator(domain.transitions(), domain.over())
    starts = domain.start_states().astype(np.intp)
    rate = np.array([one.learning_rate for one in rates])
    explore = np.array([one.explore for one in rates])
    steps, returns = np.zeros((count, episodes), dtype=np.intp), np.zeros((count, episodes))
    values = np.zeros((count, domain.n_states, len(options.names)))
    live = np.arange(count)  # learners with episodes left
    episode = np.zeros(count, dtype=np.intp)
    state = rng.choice(starts, count)
    option = np.full(count, -1, dtype=np.intp)  # running; -1: to be decided
    begun = np.zeros(count, dtype=np.intp)  # state in which the option began
    ran = np.zeros(count, dtype=np.intp)  # its steps so far
    gained, discount = np.zeros(count), np.ones(count)  # since it began; gamma**ran
    rounds = 0
    while live.size:
        free = live[option[live] < 0]
        option[free] = _choose(values[free, state[free]], options, state[free], explore[free], rng)
        begun[free], ran[free], gained[free], discount[free] = state[free], 0, 0.0, 1.0

        here, running = state[live], option[live]
        action = options.action[running, here]
        there, reward, over = simulator.step(here, action, simulator.draw(rng, len(live)))
        at = live, episode[live]
        steps[at] += 1
        returns[at] += reward
        gained[live] += discount[live] * reward
        discount[live] *= gamma
        ran[live] += 1
        out_of_time = steps[at] >= limit
        ended = over | out_of_time | options.ends[running, there]
        ended |= ran[live] >= options.limits[running]

        can = options.available[there]
        best = np.where(can, values[live, there], -np.inf).max(axis=1)
        ahead = np.where(over | ~can.any(axis=1), 0.0, best)
        if settings.method is Method.SMDP:
            learner = live[ended]
            goal = gained[learner] + discount[learner] * ahead[ended]
            at_option = learner, begun[learner], option[learner]
        else:  # all options that would have done the same
            game, same = np.nonzero(action[:, None] == options.action[:, here].T)
            learner = live[game]
            onward = np.where(over[game], 0.0, values[learner, there[game], same])
            goes = np.where(options.ends[same, there[game]], ahead[game], onward)
            goal = reward[game] + gamma * goes
            at_option = learner, here[game], same
        values[at_option] += rate[learner] * (goal - values[at_option])

        state[live] = there
        option[live[ended]] = -1
        over_now = live[over | out_of_time]
        episode[over_now] += 1
        state[over_now] = rng.choice(starts, len(over_now))
        live = live[episode[live] < episodes]
        rounds += 1
        if progress is not None and rounds % REPORT_EVERY == 0:
            progress(float(episode.sum()) / steps.size)
    if progress is not None:
        progress(1.0)
    return Learning(steps, returns, values)


def _choose(
    values: Floats, options: OptionTable, state: Ints, explore: Floats, rng: np.random.Generator
) -> Ints:
    """
    Return an option (n,) for each of some learners: the best, any of equals, or now and then any.

    :param values: (n, O) in their states.
    :param explore: (n,) share of decisions that are drawn from all that is available.
    """
    can = options.available[state]
    values = np.where(can, values, -np.inf)
    best = values == values.max(axis=1, keepdims=True)
    explores = rng.random(len(state)) < explore
    return draw_among(can & (best | explores[:, None]), rng)


def drawn_rates(seed: int, count: int) -> list[Rates]:
    """Draw rates to try, uniform in their logarithms; the first are the usual ones, 0.1."""
    rng = generator(seed, 'rates')
    draws = rng.random((count - 1, 2))
    learning = SLOWEST * (FASTEST / SLOWEST) ** draws[:, 0]
    exploring = LEAST * (MOST / LEAST) ** draws[:, 1]
    return [Rates(), *(Rates(float(a), float(b)) for a, b in zip(learning, exploring))]


def best_rates(
    domain: EnumerableDomain[Any],
    options: OptionTable,
    candidates: Sequence[Rates],
    runs: int,
    settings: Settings,
    seed: int,
    progress: Progress | None = None,
) -> Rates:
    """
    Return the rates with the fewest steps in all episodes, averaged over some runs.

    Give every action set the same candidates, runs and episodes: then the search is equally long
    for all. Learn anew with another seed to judge the rates that were chosen.

    :param runs: learners for each candidate.
    :raises PlanError: as ``learn``.
    """
    every = [rates for rates in candidates for _ in range(runs)]
    learning = learn(domain, options, every, settings, seed, progress)
    score = learning.steps.reshape(len(candidates), -1).mean(axis=1)
    return candidates[int(score.argmin())]


def draw_among(among: Flags, rng: np.random.Generator) -> Ints:
    """Return the index (N,) of one True entry of each row (N, A), all equally likely."""
    chosen: Ints = np.where(among, rng.random(among.shape), -1.0).argmax(axis=1)
    return chosen
