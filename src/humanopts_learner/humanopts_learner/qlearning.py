"""
SMDP Q-learning and intra-option Q-learning: many learners in parallel, or one table.

R. S. Sutton, D. Precup and S. Singh (1999), "Between MDPs and semi-MDPs". SMDP Q-learning (section
3.2; "macro Q-learning" for options that cannot be interrupted) updates an option when it ends
after k steps, with r the discounted reward in between:

    Q(s, o) += rate * (r + gamma**k * max Q(s', .) - Q(s, o))

Intra-option Q-learning (section 6) updates, in every step, all options that would have taken the
same action, with U(s', o) = Q(s', o) if o continues and max Q(s', .) if it ends:

    Q(s, o) += rate * (r + gamma * U(s', o) - Q(s, o))

Intra-option learning ignores the step limits of options, which depend on more than the state.
"""

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.formulas import FeatureColumn, stacked
from humanopts_env.games import Steps, TableGames
from humanopts_env.seeding import generator
from humanopts_learner.execution import draw_among, Execution, Policy, Runs
from humanopts_learner.options.learned_option import OptionTable, SeenStates
from humanopts_learner.planning.request import PlanError
import numpy as np

if TYPE_CHECKING:
    from humanopts_env.options_env import OptionsEnv

MIN_RATE, MAX_RATE = 0.05, 1.0  # range of candidate learning rates
MIN_EXPLORE, MAX_EXPLORE = 0.005, 0.3  # range of candidate exploration rates


class Method(Enum):
    """When the learners update."""

    SMDP = 'smdp'  # at the end of each run of an option
    INTRA_OPTION = 'intra-option'  # at each step


@dataclass(frozen=True)
class Rates:
    """
    Learning and exploration rates of one learner.

    :raises PlanError: a number is out of range.
    """

    learning_rate: float = 0.1
    explore: float = 0.1  # share of decisions drawn from all available options
    averages: bool = False  # whether the n-th update of a ``QTable`` value has at least rate 1/n

    def __post_init__(self) -> None:
        if not (0.0 < self.learning_rate <= 1.0 and 0.0 <= self.explore <= 1.0):
            raise PlanError(f'{self}: the rate must be above 0, and both at most 1')


@dataclass(frozen=True)
class Settings:
    """Settings shared by all learners."""

    episodes: int
    method: Method = Method.SMDP
    gamma: float = 0.0  # discount per primitive step; 0: the domain's own
    max_steps: int = 0  # per episode; 0: the domain's own limit


@dataclass(frozen=True)
class Learning:
    """Results of N learners in E episodes each."""

    steps: Ints  # (N, E) primitive steps
    returns: Floats  # (N, E) undiscounted
    values: Floats  # (N, S, O) after the last episode


@dataclass(frozen=True)
class Learners:
    """Learners with the same options."""

    options: OptionTable
    rates: Sequence[Rates]  # one per learner; learners draw independently


class _Values(Policy[SeenStates]):
    """
    The Q-values of N learners, and their epsilon-greedy policy.

    Each learner has W option slots, some of which may be empty.

    :ivar first: (N,) index of each learner's first option in the combined table.
    :ivar began: (N,) state in which each learner's current option began.
    """

    def __init__(
        self, groups: Sequence[Learners], n_states: int, rng: np.random.Generator
    ) -> None:
        """Initialize all values to 0."""
        self._rng, rates = rng, [one for group in groups for one in group.rates]
        sizes = np.array([len(group.options.names) for group in groups])
        owner = np.repeat(np.arange(len(groups)), [len(group.rates) for group in groups])
        shape = len(groups), n_states, sizes.max()
        self._acting = np.full(shape, -1)
        self._available = np.zeros(shape, dtype=np.bool_)
        for g, (group, size) in enumerate(zip(groups, sizes)):
            self._acting[g, :, :size] = group.options.action.T
            self._available[g, :, :size] = group.options.available
        self._acting, self._available = (
            table.reshape(-1, shape[2]) for table in (self._acting, self._available)
        )
        self.table = OptionTable([o for group in groups for o in group.options.options])
        self.first, self._place = (np.cumsum(sizes) - sizes)[owner], owner * n_states
        self._rate = np.array([one.learning_rate for one in rates])
        self._explore = np.array([one.explore for one in rates])
        self.values = np.zeros((len(rates), n_states, shape[2]))
        self.began = np.zeros(len(rates), dtype=np.intp)

    def choose(self, seen: SeenStates, games: Ints) -> Ints:
        known = self._known(games, seen.states)
        among = known == known.max(axis=1, keepdims=True)
        among |= (self._rng.random(len(games)) < self._explore.take(games))[:, None]
        among &= known > -np.inf
        self.began[games] = seen.states
        option: Ints = self.first.take(games) + draw_among(among, self._rng)
        return option

    def learn_of_runs(self, runs: Runs, there: Ints, gamma: float) -> None:
        """
        Update the values by SMDP Q-learning.

        :param there: (N,) current state of each learner.
        """
        ahead = self._ahead(runs.game, there.take(runs.game), runs.over)
        goal = runs.discounted + gamma**runs.steps * ahead
        slot = runs.option - self.first.take(runs.game)
        self._move(runs.game, self.began.take(runs.game), slot, goal)

    def learn_of_steps(
        self, games: Ints, here: Ints, actions: Ints, there: Ints, steps: Steps, gamma: float
    ) -> None:
        """
        Update all options that would have taken the same actions, by intra-option Q-learning.

        :param here: (n,) states before the step.
        :param there: (n,) states after the step.
        """
        _, count, width = self.values.shape
        acting = self._acting.take(self._place.take(games) + here, axis=0)
        at, slot = np.nonzero(acting == actions[:, None])
        game, after = games.take(at), there.take(at)
        onward = self.values.take((game * count + after) * width + slot)
        onward[steps.over.take(at)] = 0.0
        ends = self.table.ends.take((self.first.take(game) + slot) * count + after)
        best = self._ahead(games, there, steps.over).take(at)
        goal = steps.reward.take(at) + gamma * np.where(ends, best, onward)
        self._move(game, here.take(at), slot, goal)

    def _known(self, games: Ints, states: Ints) -> Floats:
        """Return option values (n, W) of some learners; -inf: not available."""
        _, count, width = self.values.shape
        can = self._available.take(self._place.take(games) + states, axis=0)
        values = self.values.reshape(-1, width).take(games * count + states, axis=0)
        return np.where(can, values, -np.inf)

    def _ahead(self, games: Ints, states: Ints, over: Flags) -> Floats:
        """Return the value of the best option (n,); 0 if none is available or the task is over."""
        best: Floats = self._known(games, states).max(axis=1)
        best[over | (best == -np.inf)] = 0.0
        return best

    def _move(self, games: Ints, states: Ints, slots: Ints, goal: Floats) -> None:
        """Move the values of distinct options (n,) towards target values."""
        flat, (_, count, width) = self.values.reshape(-1), self.values.shape
        place = (games * count + states) * width + slots
        known = flat.take(place)
        flat[place] = known + self._rate.take(games) * (goal - known)


def learn_in_step(
    domain: EnumerableDomain, groups: Sequence[Learners], settings: Settings, seed: int
) -> list[Learning]:
    """
    Train all learners in lock-step from values of 0, running each option to its end.

    If an episode is cut off, SMDP learning treats the running option as ended there.

    :return: results of each group.
    :raises PlanError: episodes have no step limit, or there are no learners or no episodes.
    """
    limit, episodes = settings.max_steps or domain.max_steps, settings.episodes
    counts = [len(group.rates) for group in groups]
    if limit < 1 or episodes < 1 or min(counts, default=0) < 1:
        raise PlanError(
            f'cannot learn with {min(counts, default=0)} learners in {episodes} episodes '
            f'of {limit} steps: each must be 1 or more'
        )
    rng, count = generator(seed, 'qlearning', settings.method.value), sum(counts)
    gamma = settings.gamma or domain.gamma
    learners = _Values(groups, domain.n_states, rng)
    games = TableGames(domain, rng.choice(domain.start_states(), count).astype(np.intp))
    execution = Execution(learners.table, learners, count, gamma)
    steps, returns = np.zeros((count, episodes), dtype=np.intp), np.zeros((count, episodes))
    episode, state, age = np.zeros((3, count), dtype=np.intp)
    gained = np.zeros(count)  # return of the current episode
    while len(games):
        live, here = execution.games, games.state
        actions = execution.act(SeenStates(learners.table, here))
        taken = games.step(actions, rng)
        state[live] = games.state
        age += 1
        gained += taken.reward
        last = taken.over | (age >= limit)
        runs = execution.observe(SeenStates(learners.table, games.state), taken, last)
        if settings.method is Method.SMDP:
            learners.learn_of_runs(runs, state, gamma)
        else:
            learners.learn_of_steps(live, here, actions, games.state, taken, gamma)
        ended = np.flatnonzero(last)
        if ended.size:
            games.reset(ended, rng)
            at = live.take(ended), episode.take(live.take(ended))
            steps[at], returns[at] = age.take(ended), gained.take(ended)
            age[ended], gained[ended] = 0, 0.0
            episode[at[0]] += 1
            left = np.flatnonzero(episode.take(live) < episodes)
            if len(left) < len(live):
                games, age, gained = games.take(left), age.take(left), gained.take(left)
                execution.keep(left)
    first = np.cumsum([0, *counts])
    return [
        Learning(steps[i:k], returns[i:k], learners.values[i:k, :, : len(group.options.names)])
        for group, i, k in zip(groups, first, first[1:])
    ]


class QTable:
    """
    SMDP Q-learning in a table of the states that have been seen.

    :ivar values: values (O,) by state; initially 0.
    :ivar visits: number of updates of each option (O,), by state.
    """

    def __init__(self, n_options: int, rates: Rates) -> None:
        self._rates = rates
        self.values: dict[Hashable, Floats] = defaultdict(lambda: np.zeros(n_options))
        self.visits: dict[Hashable, Ints] = defaultdict(lambda: np.zeros(n_options, dtype=np.intp))

    def choose(
        self, state: Hashable, can: Flags, rng: np.random.Generator, *, explores: bool = True
    ) -> int:
        """
        Return an option by the epsilon-greedy policy; ties are broken at random.

        :param can: (O,) whether each option can start.
        :param explores: whether to explore; False: use the greedy policy.
        """
        known = np.where(can, self.values[state], -np.inf)
        explored = explores and rng.random() < self._rates.explore
        among = known > -np.inf if explored else known == known.max()
        return int(draw_among(among[None], rng)[0])

    def update(
        self,
        state: Hashable,
        option: int,
        reward: float,
        discount: float,
        successor: Hashable,
        can: Flags,
        *,
        again: bool = False,
    ) -> None:
        """
        Update the value of an option with a run.

        :param again: whether the run was used before (experience replay, Lin 1992).
        :param reward: discounted return of the run.
        :param discount: gamma**k; 0 if the task is over.
        :param can: (O,) whether each option can start in the successor.
        """
        ahead = self.values[successor][can].max(initial=-np.inf)
        goal = reward + (discount * ahead if discount and can.any() else 0.0)
        values, visits = self.values[state], self.visits[state]
        visits[option] += not again
        rate = self._rates.learning_rate
        if self._rates.averages:
            rate = max(rate, 1.0 / visits[option])
        values[option] += rate * (goal - values[option])


@dataclass(frozen=True)
class Episodes:
    """Results of E episodes in an environment."""

    steps: Ints  # (E,) primitive steps
    returns: Floats  # (E,) undiscounted
    terminated: Flags  # (E,); otherwise truncated


@dataclass
class EnvLearner:
    """
    A tabular SMDP Q-learner with options as actions.

    :ivar columns: features that form its state, none of them continuous.
    """

    env: 'OptionsEnv'
    columns: Sequence[FeatureColumn]
    rates: Rates = Rates()

    def __post_init__(self) -> None:
        """Initialize all values to 0."""
        self._table = QTable(len(self.env.option_names), self.rates)

    def play(self, episodes: int, seed: int, *, learn: bool) -> Episodes:
        """
        Play episodes: epsilon-greedily while learning, otherwise greedily, with random ties.

        :param seed: random seed, also of the resets, so that another seed gives other episodes.
        """
        rng = generator(seed, 'qlearning', 'env')
        steps, returns = np.zeros(episodes, dtype=np.intp), np.zeros(episodes)
        terminated = np.zeros(episodes, dtype=np.bool_)
        for episode in range(episodes):
            _, info = self.env.reset(seed=int(rng.integers(2**31)))
            here, over = self._state(), False
            while not over:
                can = info['action_mask'] == 1
                option = self._table.choose(here, can, rng, explores=learn)
                _, reward, terminated[episode], truncated, info = self.env.step(option)
                there, over = self._state(), terminated[episode] or truncated
                if learn:
                    can = info['action_mask'] == 1
                    self._table.update(here, option, float(reward), info['discount'], there, can)
                steps[episode] += info['duration']
                returns[episode] += info['undiscounted']
                here = there
        return Episodes(steps, returns, terminated)

    def _state(self) -> tuple[float, ...]:
        return tuple(stacked(self.columns, self.env.features()[None])[0].tolist())


def drawn_rates(seed: int, count: int) -> list[Rates]:
    """Draw candidate rates log-uniformly; the first candidate has the defaults, 0.1 each."""
    rng = generator(seed, 'rates')
    draws = rng.random((count - 1, 2))
    learning = MIN_RATE * (MAX_RATE / MIN_RATE) ** draws[:, 0]
    exploring = MIN_EXPLORE * (MAX_EXPLORE / MIN_EXPLORE) ** draws[:, 1]
    return [Rates(), *(Rates(float(a), float(b)) for a, b in zip(learning, exploring))]


def best_rates_of_each(
    domain: EnumerableDomain,
    tables: Sequence[OptionTable],
    candidates: Sequence[Rates],
    runs: int,
    settings: Settings,
    seed: int,
) -> list[Rates]:
    """
    Return the rates with the fewest steps over all episodes, averaged over runs.

    All action sets get the same candidates, runs and episodes, so their searches are equally long.
    Relearn with another seed to evaluate the chosen rates.

    :param tables: options of each action set.
    :param runs: number of learners per candidate.
    :return: best rates for each table.
    :raises PlanError: as ``learn_in_step``.
    """
    every = [rates for rates in candidates for _ in range(runs)]
    learned = learn_in_step(domain, [Learners(each, every) for each in tables], settings, seed)
    scores = [one.steps.reshape(len(candidates), -1).mean(axis=1) for one in learned]
    return [candidates[int(score.argmin())] for score in scores]
