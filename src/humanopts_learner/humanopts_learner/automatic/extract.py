"""Finding options without a person: tasks, visits, bottlenecks and internal policies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import time
from typing import Any

from humanopts_env.arrays import Ints, Rows
from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.capabilities import HasSearchSpace
from humanopts_env.domains.search_space import SearchSpace, space_of_states
from humanopts_env.domains.tabular import TabularSimulator
from humanopts_env.seeding import generator
from humanopts_learner.automatic.bottlenecks import Bottleneck, find_bottlenecks, Visits
from humanopts_learner.automatic.config import Extraction, ignore_progress, Progress, USUAL
from humanopts_learner.automatic.subgoals import (
    check_tables,
    draw_tasks,
    greedy_runs,
    learn_to_reach,
    Subgoals,
    Values,
)
from humanopts_learner.options.option import LearnedOption, option_from_table, TabularOption
from humanopts_learner.planning.action_sets import MACHINE
from humanopts_learner.planning.errors import NotEnumerableError, PlanError
import numpy as np


@dataclass(frozen=True, eq=False)
class AutomaticOption(TabularOption):
    """One option, as arrays over the states of the search space."""

    target: Bottleneck
    reaches: float  # share of its initiation set from which a run reached its target


@dataclass(frozen=True)
class AutomaticOptions:
    """The options that were found, and the cost of finding them."""

    options: tuple[AutomaticOption, ...]  # in the order in which they were found
    space: SearchSpace
    visits: Ints  # (K,) visits of all greedy runs that reached their goals, by cell
    seconds: float
    game_steps: int  # primitive steps of learning and of greedy runs
    episodes: int  # of Q-learning: tasks and internal policies
    solved: float  # share of the greedy runs that reached their goals


def search_space(domain: Domain[Any]) -> SearchSpace:
    """
    Return the search space that the domain defines, else all of its states.

    :raises NotEnumerableError: the domain defines none, and its states cannot all be listed.
    """
    if isinstance(domain, HasSearchSpace):
        return domain.search_space()
    if is_enumerable(domain):
        return space_of_states(domain)
    raise NotEnumerableError(
        f'the states of {domain.name} cannot all be listed, so no tasks can be set in it'
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
                name=found.name,
                max_steps=max_steps,
                action=table.argmax(axis=1),
                initiation=found.initiation,
                termination=~found.initiation,
                target=found,
                reaches=share,
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


def to_learned_options(
    domain: Domain[Any], found: AutomaticOptions, participant: str = MACHINE
) -> list[LearnedOption]:
    """
    Return the options so that they can be saved, sent, served and planned with like others.

    Each depends on as few features as its tables need. The trees agree with the tables in every
    state that an episode passes through: I and beta in all of them, and pi in I.

    :param found: automatic options of this domain.
    :param participant: the participant code of the options; begins with ``MACHINE``.
    :raises PlanError: the participant has another code.
    :raises DomainError: two states with equal features have different entries in the tables.
    """
    check_participant(participant)
    rows, going, columns = found.space.rows, found.space.open, found.space.columns
    learned = []
    for option in found.options:
        decisions = 2 * np.where(option.initiation, 1 + option.action, 0) + option.termination
        needed = _needed(rows[going], list(columns), decisions[going])
        features = [domain.features[column].name for column in needed]
        known = going & option.initiation, going, going
        learned.append(option_from_table(domain, option, features, rows, known, participant))
    return learned


def check_participant(code: str) -> None:
    """
    Check the participant code of automatic options.

    :raises PlanError: it could be the code of a person.
    """
    if not code.startswith(MACHINE):
        raise PlanError(
            f'the participant of options that nobody taught must begin with {MACHINE!r}, '
            f'not {code!r}'
        )


def _needed(rows: Rows, columns: list[int], decisions: Ints) -> list[int]:
    """Return the feature indices without those, tried from the last, that are not needed."""
    for column in reversed(columns):
        others = [other for other in columns if other != column]
        if others and _determine(rows[:, others], decisions):
            columns = others
    return columns


def _determine(seen: Rows, decisions: Ints) -> bool:
    """Return whether equal rows always come with equal decisions."""
    both = np.column_stack([seen, decisions])
    return len(np.unique(seen, axis=0)) == len(np.unique(both, axis=0))
