"""Q-learning of ways to targets, many learners side by side (Watkins 1989)."""

from collections.abc import Callable
from dataclasses import dataclass

from humanopts_learner.automatic.how import Extraction
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.qlearning import draw_among, Flags, Ints, TabularSimulator
import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float32]
Tell = Callable[[float, int], object]  # share of the episodes that are done, steps so far
TOLD_EVERY = 200  # steps
LARGEST_TABLES = 2**28  # entries of all learners, 1 GiB


@dataclass(frozen=True)
class Errands:
    """What L learners are to do: come from a start to a target."""

    starts: Ints  # (M,) those of the first learner, of the second, ...
    counts: Ints  # (L,) how many each has, 1 or more; an episode begins in any of them
    target: Flags  # (L, S) worth 1, and ends the episode
    shut: Flags  # (L, S) worth nothing, and ends it as well

    def draw(self, learners: Ints, rng: np.random.Generator) -> Ints:
        """Draw a start for each of some learners (N,)."""
        first = np.cumsum(self.counts) - self.counts
        drawn: Ints = self.starts[first[learners] + rng.integers(self.counts[learners])]
        return drawn


class _Learners:
    """L learners, each in an episode of its own; ``live`` are those that go on."""

    def __init__(
        self,
        world: TabularSimulator,
        errands: Errands,
        episodes: int,
        how: Extraction,
        rng: np.random.Generator,
    ) -> None:
        self._world, self._errands, self._how, self._rng = world, errands, how, rng
        self._episodes, count = episodes, len(errands.counts)
        self.live = np.arange(count)
        self.values = np.zeros((count, *world.rules.successor.shape[:2]), dtype=np.float32)
        self._state = errands.draw(self.live, rng)
        self._ran = np.zeros(count, dtype=np.intp)  # steps of this episode
        self._episode = np.zeros(count, dtype=np.intp)

    @property
    def done(self) -> float:
        """Share of the episodes that are over."""
        return float(self._episode.mean()) / self._episodes

    def step(self) -> None:
        """Take a step in every episode that goes on, and learn."""
        live, errands, how = self.live, self._errands, self._how
        state = self._state[live]
        explore = self._rng.random((len(live), 1)) < how.explore
        action = draw_among(explore | _best(self.values[live, state]), self._rng)
        there, _, over = self._world.step(state, action, self._rng)
        hit = errands.target[live, there]
        ended = hit | errands.shut[live, there] | over
        goal = np.where(ended, hit, how.gamma * self.values[live, there].max(axis=1))
        at = live, state, action
        self.values[at] += how.learning_rate * (goal - self.values[at])
        self._state[live] = there
        self._ran[live] += 1
        self._begin_again(live[ended | (self._ran[live] >= how.max_steps)])

    def _begin_again(self, ended: Ints) -> None:
        self._episode[ended] += 1
        self._ran[ended] = 0
        self._state[ended] = self._errands.draw(ended, self._rng)
        self.live = self.live[self._episode[self.live] < self._episodes]


def check_tables(world: TabularSimulator, learners: int) -> None:
    """
    Check that the tables of so many learners can be held.

    :raises PlanError: they would not fit in memory.
    """
    n_states, n_actions, _ = world.rules.successor.shape
    if learners * n_states * n_actions > LARGEST_TABLES:
        raise PlanError(
            f'{learners} tasks or options in {n_states} states need tables that are too large: '
            'ask for fewer'
        )


def learn_to_reach(
    world: TabularSimulator,
    errands: Errands,
    episodes: int,
    how: Extraction,
    rng: np.random.Generator,
    tell: Tell,
) -> tuple[Values, int]:
    """
    Learn to do errands.

    Every learner has a table of its own, plays ``episodes`` episodes one after another, and steps
    together with all others.

    :return: values (L, S, A), and the steps taken.
    :raises PlanError: the tables would not fit in memory.
    """
    check_tables(world, len(errands.counts))
    learners = _Learners(world, errands, episodes, how, rng)
    rounds, game_steps = 0, 0
    while learners.live.size:
        game_steps += learners.live.size
        learners.step()
        rounds += 1
        if rounds % TOLD_EVERY == 0:
            tell(learners.done, game_steps)
    return learners.values, game_steps


def greedy_runs(
    world: TabularSimulator,
    values: Values,
    errands: Errands,
    learner: Ints,
    start: Ints,
    max_steps: int,
    rng: np.random.Generator,
) -> tuple[Ints, Ints, int]:
    """
    Run learners greedily, R runs side by side.

    :param learner: (R,) which of them runs.
    :param start: (R,) the state in which it begins.
    :param max_steps: after which a run is cut off.
    :return: run (V,) and state (V,) of every visit of the runs that came to their target, start
        and target included, run by run in the order of their steps; and all steps taken.
    """
    live, state = np.arange(len(learner)), start.copy()
    came = np.zeros(len(learner), dtype=np.bool_)
    visits, game_steps = [np.stack([live, state])], 0
    for _ in range(max_steps):
        if not live.size:
            break
        who, here = learner[live], state[live]
        there, _, over = world.step(here, draw_among(_best(values[who, here]), rng), rng)
        state[live] = there
        visits.append(np.stack([live, there]))
        came[live] = errands.target[who, there]
        game_steps += live.size
        live = live[~(came[live] | errands.shut[who, there] | over)]
    run, visited = np.concatenate(visits, axis=1)
    order = np.argsort(run, kind='stable')
    order = order[came[run[order]]]
    return run[order], visited[order], game_steps


def _best(values: Values) -> Flags:
    """Return (n, A): the best of each row, all of equals."""
    best: Flags = values == values.max(axis=1, keepdims=True)
    return best
