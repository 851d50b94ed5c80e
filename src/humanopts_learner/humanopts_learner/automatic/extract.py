"""Finding options without a person: tasks, visits, bottlenecks and internal policies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.search_space import SearchSpace
from humanopts_env.seeding import generator
from humanopts_learner.automatic.bottlenecks import Bottleneck, find_bottlenecks, Visits
from humanopts_learner.automatic.how import Extraction, Progress, say_nothing, USUAL
from humanopts_learner.automatic.reaching import (
    check_tables,
    Errands,
    greedy_runs,
    learn_to_reach,
    Values,
)
from humanopts_learner.automatic.search_space import search_space
from humanopts_learner.automatic.tabled import BatchTabledOption
from humanopts_learner.automatic.tasks import draw_tasks
from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.action_sets import TabledOption
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.qlearning import TabularSimulator
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class AutomaticOption:
    """One option, by tables over the states that it was looked for in."""

    target: Bottleneck
    tables: OptionTables
    max_steps: int
    reaches: float  # share of its initiation set from which a run came to its target

    @property
    def name(self) -> str:
        """Name of the option."""
        return self.target.name


@dataclass(frozen=True)
class AutomaticOptions:
    """What was found, and what it cost."""

    options: tuple[AutomaticOption, ...]  # in the order in which they were found
    space: SearchSpace
    visits: NDArray[np.intp]  # (K,) of all greedy runs that came to their goals, by cell
    seconds: float
    game_steps: int  # primitive steps of learning and of greedy runs
    episodes: int  # of Q-learning: tasks and internal policies
    solved: float  # share of the greedy runs that came to their goals

    @property
    def tabled(self) -> tuple[TabledOption, ...]:
        """The options for planning with exact models, in domains whose states can be listed."""
        return tuple(TabledOption(o.name, o.max_steps, o.tables) for o in self.options)

    @property
    def batched(self) -> tuple[BatchTabledOption, ...]:
        """The options for planning from samples."""
        return tuple(
            BatchTabledOption(o.name, o.max_steps, o.tables, self.space) for o in self.options
        )


def find_options(
    domain: Domain[Any],
    seed: int,
    how: Extraction = USUAL,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> AutomaticOptions:
    """
    Find options by the algorithm of Stolle and Precup (2002).

    :param domain: one that has a search space of its own, or whose states can be listed.
    :param progress: told the stages ``tasks`` and ``policies``.
    :raises PlanError: no tasks can be set in the domain; its subclasses say why.
    :raises PlanCanceled: from ``progress``.
    """
    space, tell = search_space(domain), progress or say_nothing
    began = clock()
    work = _Extraction(space, seed, how, tell)
    visits, solved = work.visit()
    bottlenecks = find_bottlenecks(visits, how.options)
    options = work.learn(bottlenecks, domain.max_steps or how.max_steps)
    return AutomaticOptions(
        options=tuple(options),
        space=space,
        visits=visits.counts.sum(axis=0),
        seconds=clock() - began,
        game_steps=work.game_steps,
        episodes=work.episodes,
        solved=solved,
    )


class _Extraction:
    """Options while they are looked for."""

    def __init__(self, space: SearchSpace, seed: int, how: Extraction, tell: Progress) -> None:
        self._space, self._seed, self._how, self._tell = space, seed, how, tell
        self._world = TabularSimulator(space.transitions, space.over)
        self.game_steps, self.episodes = 0, 0

    def visit(self) -> tuple[Visits, float]:
        """Learn random tasks; return the visits of greedy runs, and the share that came home."""
        how, rng = self._how, generator(self._seed, 'automatic_options', 'tasks')
        check_tables(self._world, how.tasks)
        errands = draw_tasks(self._space, how.tasks, rng)
        values = self._learn('tasks', errands, how.train_episodes, rng)
        learner = np.repeat(np.arange(how.tasks), how.test_runs)
        start = errands.draw(learner, rng)
        run, state, steps = greedy_runs(
            self._world, values, errands, learner, start, how.max_steps, rng
        )
        self.game_steps += steps
        if not run.size:
            raise PlanError(
                f'not one of {how.tasks} tasks was learned in {how.train_episodes} episodes each: '
                'give more'
            )
        return Visits(self._space, run, state), len(np.unique(run)) / len(learner)

    def learn(self, targets: Sequence[Bottleneck], max_steps: int) -> list[AutomaticOption]:
        """Learn the internal policies, each with reward 1 at its target."""
        targets = [target for target in targets if target.initiation.any()]
        if not targets:
            raise PlanError('no bottleneck has an initiation set: give more tasks')
        rng = generator(self._seed, 'automatic_options', 'policies')
        initiation = np.array([target.initiation for target in targets])
        target = np.array([target.target for target in targets])
        starts = np.nonzero(initiation)[1]
        errands = Errands(starts, initiation.sum(axis=1), target, ~(initiation | target))
        values = self._learn('policies', errands, self._how.option_episodes, rng)
        reaches = self._reaches(values, errands, rng)
        return [
            AutomaticOption(
                found,
                OptionTables(table.argmax(axis=1), found.initiation, ~found.initiation),
                max_steps,
                share,
            )
            for found, table, share in zip(targets, values, reaches)
        ]

    def _learn(
        self, stage: str, errands: Errands, episodes: int, rng: np.random.Generator
    ) -> Values:
        before = self.game_steps
        values, steps = learn_to_reach(
            self._world,
            errands,
            episodes,
            self._how,
            rng,
            lambda done, so_far: self._tell(stage, done, before + so_far),
        )
        self.game_steps += steps
        self.episodes += episodes * len(errands.counts)
        self._tell(stage, 1.0, self.game_steps)
        return values

    def _reaches(self, values: Values, errands: Errands, rng: np.random.Generator) -> list[float]:
        """Return the share of starts of each learner from which one greedy run comes home."""
        owner = np.repeat(np.arange(len(errands.counts)), errands.counts)
        limit = self._how.max_steps
        run, _, _ = greedy_runs(self._world, values, errands, owner, errands.starts, limit, rng)
        came = np.bincount(owner[np.unique(run)], minlength=len(errands.counts))
        shares: list[float] = (came / errands.counts).tolist()
        return shares
