"""
Subgoals, and parallel Q-learning of policies that reach them (Watkins 1989).

Subgoals are first the goals of random tasks, and later the bottlenecks. ``Extraction`` documents
the source of each search parameter.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
import itertools
import math

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
REPORT_EVERY = 200  # steps between reports
MAX_TABLES = 2**28  # maximum table entries of all learners, 1 GiB
# Called with the stage (tasks or policies), the share done (0..1) and the game steps so far;
# may raise ``PlanCanceled`` to stop.
Progress = Callable[[str, float, int], object]


@dataclass(frozen=True)
class Extraction:
    """
    Parameters of the search for options.

    The algorithm is by M. Stolle and D. Precup (2002), "Learning Options in Reinforcement
    Learning". Values marked "usual" are those of another implementation
    (utkd/bottleneck-options-learning); the others are ours.

    :raises PlanError: a parameter is out of range.
    """

    options: int = 25  # maximum number of options
    tasks: int = 400  # usual: 20, which misses some bottlenecks
    train_episodes: int = 200  # Q-learning episodes per task, N_train (usual)
    test_runs: int = 10  # greedy runs per task, N_test (usual)
    option_episodes: int = 2000  # per option; usual: 200, but ours start anywhere in I
    learning_rate: float = 0.1  # usual
    explore: float = 0.1  # share of random actions while learning (usual)
    gamma: float = 0.9  # while learning (usual); the reward is 1 at the target, 0 elsewhere
    max_steps: int = 1000  # maximum steps per episode or greedy run (ours)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type is int and value < 1:
                raise PlanError(f'{field.name} is {value}, but must be 1 or more')
            if field.type is float and not 0.0 <= value <= 1.0:
                raise PlanError(f'{field.name} is {value}, but must be from 0 to 1')


USUAL = Extraction()


@dataclass(frozen=True)
class Subgoals:
    """The tasks of L learners; each learns to reach a target from its start states."""

    starts: Ints  # (M,) start states of the first learner, then of the second, ...
    counts: Ints  # (L,) number of start states of each learner, 1 or more; drawn per episode
    target: Flags  # (L, S) states with reward 1 that end the episode
    forbidden: Flags  # (L, S) states with reward 0 that end the episode

    @cached_property
    def first(self) -> Ints:
        """(L,) position of each learner's first start state."""
        places: Ints = np.cumsum(self.counts) - self.counts
        return places

    def draw(self, learners: Ints, rng: np.random.Generator) -> Ints:
        """Draw a start state for each of some learners (N,)."""
        drawn: Ints = self.starts[self.first[learners] + rng.integers(self.counts[learners])]
        return drawn


def draw_tasks(space: SearchSpace, count: int, rng: np.random.Generator) -> Subgoals:
    """
    Draw tasks (Stolle and Precup 2002, step 1).

    The goal of a task is a state other than its start, and each can be reached from the other. If
    episodes of the domain have random goals, the domain's own goal is used instead. A task also
    ends, without reward, if the domain's own task is over.

    :raises PlanError: no two states can be reached from each other, so there are no tasks.
    """
    if space.goals is not None:
        start = rng.choice(space.starts, count)
        target = np.broadcast_to(space.goals, (count, len(space.goals)))
    else:
        rules, shape = space.transitions, (len(space.over), len(space.over))
        possible = (rules.probability > 0) & ~space.over[:, None, None]
        # csgraph in SciPy 1.11 accepts only 32-bit indices
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


class Trainer:
    """
    Trains and runs many learners in parallel.

    :ivar game_steps: steps taken so far by all learners.
    """

    def __init__(self, space: SearchSpace, config: Extraction, report: Progress) -> None:
        """
        Set up the simulator.

        :raises PlanError: the Q-tables do not fit in memory.
        """
        self._simulator = TabularSimulator(space.transitions, space.over)
        self._config, self._report, self.game_steps = config, report, 0
        self._shape = space.transitions.successor.shape[:2]
        learners = max(config.tasks, config.options)
        if learners * math.prod(self._shape) > MAX_TABLES:
            raise PlanError(
                f'{learners} tasks or options in {self._shape[0]} states need tables that are too '
                'large: ask for fewer'
            )

    def learn(
        self, stage: str, subgoals: Subgoals, episodes: int, rng: np.random.Generator
    ) -> Values:
        """
        Learn to reach subgoals.

        Each learner has its own table and plays ``episodes`` episodes in sequence.

        :return: values (L, S, A).
        """
        config, count = self._config, len(subgoals.counts)
        values, live = np.zeros((count, *self._shape), dtype=np.float32), np.arange(count)
        state = subgoals.draw(live, rng)
        ran, episode = np.zeros((2, count), dtype=np.intp)  # steps in episode; finished episodes
        for rounds in itertools.count(1):
            here = state[live]
            explore = rng.random((len(live), 1)) < config.explore
            action = draw_among(explore | _best(values[live, here]), rng)
            there, over = self._step(here, action, rng)
            hit = subgoals.target[live, there]
            ended = hit | subgoals.forbidden[live, there] | over
            goal = np.where(ended, hit, config.gamma * values[live, there].max(axis=1))
            at = live, here, action
            values[at] += config.learning_rate * (goal - values[at])
            state[live] = there
            ran[live] += 1
            finished = live[ended | (ran[live] >= config.max_steps)]
            if finished.size:
                episode[finished] += 1
                ran[finished] = 0
                state[finished] = subgoals.draw(finished, rng)
                live = live[episode[live] < episodes]
            if rounds % REPORT_EVERY == 0:
                self._report(stage, float(episode.mean()) / episodes, self.game_steps)
            if not live.size:
                break
        self._report(stage, 1.0, self.game_steps)
        return values

    def greedy_runs(
        self,
        values: Values,
        subgoals: Subgoals,
        learner: Ints,
        start: Ints,
        rng: np.random.Generator,
    ) -> tuple[Ints, Ints]:
        """
        Run learners greedily, R runs in parallel.

        :param learner: (R,) index of the learner of each run.
        :param start: (R,) start state of each run.
        :return: run (V,) and state (V,) of each visit in runs that reached their target, including
            start and target, ordered by run and step.
        """
        live, state = np.arange(len(learner)), start.copy()
        arrived = np.zeros(len(learner), dtype=np.bool_)
        visits = [np.stack([live, state])]
        for _ in range(self._config.max_steps):
            if not live.size:
                break
            who, here = learner[live], state[live]
            there, over = self._step(here, draw_among(_best(values[who, here]), rng), rng)
            state[live] = there
            visits.append(np.stack([live, there]))
            arrived[live] = subgoals.target[who, there]
            live = live[~(arrived[live] | subgoals.forbidden[who, there] | over)]
        run, visited = np.concatenate(visits, axis=1)
        order = np.argsort(run, kind='stable')
        order = order[arrived[run[order]]]
        return run[order], visited[order]

    def _step(self, here: Ints, action: Ints, rng: np.random.Generator) -> tuple[Ints, Flags]:
        """Return the next states and whether the task is over in them, (N,) each."""
        self.game_steps += len(here)
        there, _, over = self._simulator.step(here, action, self._simulator.draw(rng, len(here)))
        return there, over


def _best(values: Values) -> Flags:
    """Return (n, A): whether each action is among the best of its row."""
    best: Flags = values == values.max(axis=1, keepdims=True)
    return best
