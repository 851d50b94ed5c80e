"""Finding options without a person: tasks, visits, bottlenecks and internal policies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.search_space import SearchSpace
from humanopts_env.seeding import generator
from humanopts_learner.automatic.bottlenecks import Bottleneck, find_bottlenecks, Visits
from humanopts_learner.automatic.config import Extraction, ignore_progress, Progress, USUAL
from humanopts_learner.automatic.search_space import search_space
from humanopts_learner.automatic.subgoals import (
    check_tables,
    draw_tasks,
    greedy_runs,
    learn_to_reach,
    Subgoals,
    Values,
)
from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.action_sets import TabledOption
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.planning.sampled.action_set import Flags, Rows
from humanopts_learner.planning.sampled.state_abstraction import Ints
from humanopts_learner.qlearning import TabularSimulator
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class AutomaticOption:
    """One option, as tables over the states of the search space."""

    target: Bottleneck
    tables: OptionTables
    max_steps: int
    reaches: float  # share of its initiation set from which a run reached its target

    @property
    def name(self) -> str:
        """Name of the option."""
        return self.target.name


@dataclass(frozen=True)
class BatchTabledOption:
    """A ``BatchOption`` by tables over the S states of a search space."""

    name: str
    max_steps: int
    tables: OptionTables  # (S,) each
    space: SearchSpace

    def can_start(self, rows: Rows) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        inside: Flags = self.tables.initiation[self.space.states_of(rows)]
        return inside

    def greedy_action(self, rows: Rows) -> Ints:
        """Return (N,): the action that the option takes."""
        action: Ints = self.tables.action[self.space.states_of(rows)]
        return action

    def ends(self, rows: Rows) -> Flags:
        """Return (N,): whether the game has reached the target, or left the initiation set."""
        return ~self.can_start(rows)


@dataclass(frozen=True)
class AutomaticOptions:
    """The options that were found, and the cost of finding them."""

    options: tuple[AutomaticOption, ...]  # in the order in which they were found
    space: SearchSpace
    visits: NDArray[np.intp]  # (K,) visits of all greedy runs that reached their goals, by cell
    seconds: float
    game_steps: int  # primitive steps of learning and of greedy runs
    episodes: int  # of Q-learning: tasks and internal policies
    solved: float  # share of the greedy runs that reached their goals

    @property
    def tabled(self) -> tuple[TabledOption, ...]:
        """The options for planning with exact models, in enumerable domains."""
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
    config: Extraction = USUAL,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> AutomaticOptions:
    """
    Find options by the algorithm of Stolle and Precup (2002).

    :param domain: an enumerable domain, or one with a search space of its own.
    :param progress: called with the stages ``tasks`` and ``policies``.
    :raises PlanError: no tasks can be set in the domain; its subclasses say why.
    :raises PlanCanceled: from ``progress``.
    """
    space, report = search_space(domain), progress or ignore_progress
    began = clock()
    work = _Extraction(space, seed, config, report)
    visits, solved = work.visit()
    bottlenecks = find_bottlenecks(visits, config.options)
    options = work.learn(bottlenecks, domain.max_steps or config.max_steps)
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
    """One search for options."""

    def __init__(
        self, space: SearchSpace, seed: int, config: Extraction, report: Progress
    ) -> None:
        self._space, self._seed, self._config, self._report = space, seed, config, report
        self._simulator = TabularSimulator(space.transitions, space.over)
        self.game_steps, self.episodes = 0, 0

    def visit(self) -> tuple[Visits, float]:
        """Learn random tasks; return the visits of greedy runs, and the share that succeeded."""
        config, rng = self._config, generator(self._seed, 'automatic_options', 'tasks')
        check_tables(self._simulator, config.tasks)
        subgoals = draw_tasks(self._space, config.tasks, rng)
        values = self._learn('tasks', subgoals, config.train_episodes, rng)
        learner = np.repeat(np.arange(config.tasks), config.test_runs)
        start = subgoals.draw(learner, rng)
        run, state, steps = greedy_runs(
            self._simulator, values, subgoals, learner, start, config.max_steps, rng
        )
        self.game_steps += steps
        if not run.size:
            raise PlanError(
                f'not one of {config.tasks} tasks was learned in {config.train_episodes} episodes '
                'each: give more'
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
        subgoals = Subgoals(starts, initiation.sum(axis=1), target, ~(initiation | target))
        values = self._learn('policies', subgoals, self._config.option_episodes, rng)
        reaches = self._reaches(values, subgoals, rng)
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
        self, stage: str, subgoals: Subgoals, episodes: int, rng: np.random.Generator
    ) -> Values:
        before = self.game_steps
        values, steps = learn_to_reach(
            self._simulator,
            subgoals,
            episodes,
            self._config,
            rng,
            lambda done, so_far: self._report(stage, done, before + so_far),
        )
        self.game_steps += steps
        self.episodes += episodes * len(subgoals.counts)
        self._report(stage, 1.0, self.game_steps)
        return values

    def _reaches(
        self, values: Values, subgoals: Subgoals, rng: np.random.Generator
    ) -> list[float]:
        """Return each learner's share of starts from which its greedy run reaches the target."""
        owner = np.repeat(np.arange(len(subgoals.counts)), subgoals.counts)
        limit = self._config.max_steps
        run, _, _ = greedy_runs(
            self._simulator, values, subgoals, owner, subgoals.starts, limit, rng
        )
        came = np.bincount(owner[np.unique(run)], minlength=len(subgoals.counts))
        shares: list[float] = (came / subgoals.counts).tolist()
        return shares
