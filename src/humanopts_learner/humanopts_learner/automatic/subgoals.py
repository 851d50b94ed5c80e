"""
Subgoals, and Q-learning of policies that reach them (Watkins 1989), many learners side by side.

The subgoals are first the goals of random tasks, and then the bottlenecks. The parameters of the
search are here, each with its source.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.search_space import SearchSpace
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_learner.execution import draw_among
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Values = NDArray[np.float32]
OnProgress = Callable[[float, int], object]  # share of the episodes done, steps so far
REPORT_EVERY = 200  # steps
LARGEST_TABLES = 2**28  # entries of all learners, 1 GiB
# Called with the stage (tasks or policies), the share done (0..1) and the game steps so far;
# raises ``PlanCanceled`` to stop
Progress = Callable[[str, float, int], object]


@dataclass(frozen=True)
class Extraction:
    """
    The parameters of the search for options.

    M. Stolle and D. Precup (2002), "Learning Options in Reinforcement Learning", give the
    algorithm. The numbers marked "usual" are those of another implementation
    (utkd/bottleneck-options-learning); the others are ours, with their reasons.

    :raises PlanError: one is out of range.
    """

    options: int = 25  # largest number
    tasks: int = 400  # usual: 20, where some bottlenecks were missed
    train_episodes: int = 200  # of Q-learning for each task, N_train: usual
    test_runs: int = 10  # greedy ones for each task, N_test: usual
    option_episodes: int = 2000  # for each option; usual: 200, but these begin all over I
    learning_rate: float = 0.1  # usual
    explore: float = 0.1  # share of random actions while learning: usual
    gamma: float = 0.9  # while learning: usual; the reward is 1 at the target, 0 elsewhere
    max_steps: int = 1000  # after which an episode or a greedy run is cut off: ours

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type is int and value < 1:
                raise PlanError(f'{field.name} is {value}, and must be 1 or more')
            if field.type is float and not 0.0 <= value <= 1.0:
                raise PlanError(f'{field.name} is {value}, and must be from 0 to 1')


USUAL = Extraction()


@dataclass(frozen=True)
class Subgoals:
    """The tasks of L learners: each learns to reach a target from its starts."""

    starts: Ints  # (M,) start states of the first learner, of the second, ...
    counts: Ints  # (L,) number of each learner's starts, 1 or more, drawn for each episode
    target: Flags  # (L, S) reward 1; ends the episode
    forbidden: Flags  # (L, S) reward 0; ends the episode too

    @cached_property
    def first(self) -> Ints:
        """Return (L,): the place of each learner's first start."""
        places: Ints = np.cumsum(self.counts) - self.counts
        return places

    def draw(self, learners: Ints, rng: np.random.Generator) -> Ints:
        """Draw a start for each of some learners (N,)."""
        drawn: Ints = self.starts[self.first[learners] + rng.integers(self.counts[learners])]
        return drawn


def draw_tasks(space: SearchSpace, count: int, rng: np.random.Generator) -> Subgoals:
    """
    Draw tasks (Stolle and Precup 2002, step 1).

    The goal of a task is another state, where each of start and goal can be reached from the
    other; or the domain's own goal, where episodes begin with random goals. A task also ends,
    without reward, where the domain's own task is over.

    :raises PlanError: no two states can be reached from each other, so there are no tasks.
    """
    if space.goals is not None:
        start = rng.choice(space.starts, count)
        target = np.broadcast_to(space.goals, (count, len(space.goals)))
    else:
        rules, shape = space.transitions, (len(space.over), len(space.over))
        possible = (rules.probability > 0) & ~space.over[:, None, None]
        # csgraph of SciPy 1.11 takes indices of 32 bits only
        here = np.nonzero(possible)[0].astype(np.int32)
        there = rules.successor[possible].astype(np.int32)
        steps = coo_array((np.ones(len(here)), (here, there)), shape=shape).tocsr()
        region = connected_components(steps, connection='strong')[1]
        inside = region[space.starts]
        starts = space.starts[np.bincount(inside)[inside] > 1]
        if not starts.size:
            raise PlanError('no two states can be reached from each other, so no tasks can be set')
        start, target = rng.choice(starts, count), np.zeros((count, len(region)), dtype=np.bool_)
        for task, state in enumerate(start):
            there = starts[region[starts] == region[state]]
            target[task, rng.choice(there[there != state])] = True
    return Subgoals(start, np.ones(count, dtype=np.intp), target, np.zeros_like(target))


def check_tables(simulator: TabularSimulator, learners: int) -> None:
    """
    Check that the Q-tables fit in memory.

    :raises PlanError: they do not.
    """
    n_states, n_actions, _ = simulator.transitions.successor.shape
    if learners * n_states * n_actions > LARGEST_TABLES:
        raise PlanError(
            f'{learners} tasks or options in {n_states} states need tables that are too large: '
            'ask for fewer'
        )


def learn_to_reach(
    simulator: TabularSimulator,
    subgoals: Subgoals,
    episodes: int,
    config: Extraction,
    rng: np.random.Generator,
    report: OnProgress,
) -> tuple[Values, int]:
    """
    Learn to reach subgoals.

    Every learner has a table of its own and plays ``episodes`` episodes one after another; all
    learners step together.

    :return: values (L, S, A), and the steps taken.
    :raises PlanError: the Q-tables do not fit in memory.
    """
    count = len(subgoals.counts)
    check_tables(simulator, count)
    values = np.zeros((count, *simulator.transitions.successor.shape[:2]), dtype=np.float32)
    live = np.arange(count)
    state = subgoals.draw(live, rng)
    ran, episode = np.zeros((2, count), dtype=np.intp)  # steps of this episode; episodes so far
    rounds, game_steps = 0, 0
    while live.size:
        here = state[live]
        explore = rng.random((len(live), 1)) < config.explore
        action = draw_among(explore | _best(values[live, here]), rng)
        there, _, over = simulator.step(here, action, simulator.draw(rng, len(live)))
        hit = subgoals.target[live, there]
        ended = hit | subgoals.forbidden[live, there] | over
        goal = np.where(ended, hit, config.gamma * values[live, there].max(axis=1))
        at = live, here, action
        values[at] += config.learning_rate * (goal - values[at])
        state[live] = there
        ran[live] += 1
        game_steps += live.size
        finished = live[ended | (ran[live] >= config.max_steps)]
        if finished.size:
            episode[finished] += 1
            ran[finished] = 0
            state[finished] = subgoals.draw(finished, rng)
            live = live[episode[live] < episodes]
        rounds += 1
        if rounds % REPORT_EVERY == 0:
            report(float(episode.mean()) / episodes, game_steps)
    return values, game_steps


def greedy_runs(
    simulator: TabularSimulator,
    values: Values,
    subgoals: Subgoals,
    learner: Ints,
    start: Ints,
    max_steps: int,
    rng: np.random.Generator,
) -> tuple[Ints, Ints, int]:
    """
    Run learners greedily, R runs side by side.

    :param learner: (R,) index of the learner of each run.
    :param start: (R,) the state in which it begins.
    :param max_steps: after which a run is cut off.
    :return: run (V,) and state (V,) of every visit of the runs that reached their target, start
        and target included, run by run in the order of their steps; and all steps taken.
    """
    live, state = np.arange(len(learner)), start.copy()
    arrived = np.zeros(len(learner), dtype=np.bool_)
    visits, game_steps = [np.stack([live, state])], 0
    for _ in range(max_steps):
        if not live.size:
            break
        who, here = learner[live], state[live]
        action = draw_among(_best(values[who, here]), rng)
        there, _, over = simulator.step(here, action, simulator.draw(rng, len(live)))
        state[live] = there
        visits.append(np.stack([live, there]))
        arrived[live] = subgoals.target[who, there]
        game_steps += live.size
        live = live[~(arrived[live] | subgoals.forbidden[who, there] | over)]
    run, visited = np.concatenate(visits, axis=1)
    order = np.argsort(run, kind='stable')
    order = order[arrived[run[order]]]
    return run[order], visited[order], game_steps


def _best(values: Values) -> Flags:
    """Return (n, A): whether each action is a best one of its row."""
    best: Flags = values == values.max(axis=1, keepdims=True)
    return best
