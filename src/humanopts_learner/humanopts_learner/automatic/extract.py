"""Extraction of automatic options: tasks, visits, bottlenecks and internal policies."""

from collections.abc import Callable
from dataclasses import dataclass
import time

from humanopts_env.arrays import Ints
from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.capabilities import HasSearchSpace
from humanopts_env.domains.search_space import SearchSpace, space_of_states
from humanopts_env.seeding import generator
from humanopts_learner.automatic.bottlenecks import Bottleneck, find_bottlenecks, Visits
from humanopts_learner.automatic.subgoals import (
    draw_tasks,
    Extraction,
    Progress,
    Subgoals,
    Trainer,
    USUAL,
)
from humanopts_learner.demonstrations import MACHINE
from humanopts_learner.options.learned_option import (
    LearnedOption,
    option_from_table,
    TabularOption,
)
from humanopts_learner.planning.request import PlanError
import numpy as np


@dataclass(frozen=True, eq=False)
class AutomaticOption(TabularOption):
    """One option, as arrays over the states of the search space."""

    target: Bottleneck
    reaches: float  # share of the initiation set from which a run reached the target


@dataclass(frozen=True)
class AutomaticOptions:
    """The options found, and the cost of finding them."""

    options: tuple[AutomaticOption, ...]  # in the order found
    space: SearchSpace
    visits: Ints  # (K,) visits to each cell in all successful greedy runs
    seconds: float
    game_steps: int  # primitive steps of learning and of the greedy runs for bottlenecks
    episodes: int  # Q-learning episodes for tasks and internal policies
    solved: float  # share of greedy runs that reached their goals


def search_space(domain: Domain) -> SearchSpace:
    """
    Return the domain's own search space, or else all of its states.

    :raises PlanError: the domain has no search space, and its states cannot all be listed.
    """
    if isinstance(domain, HasSearchSpace):
        return domain.search_space()
    if is_enumerable(domain):
        return space_of_states(domain)
    raise PlanError(
        f'the states of {domain.name} cannot all be listed, so no tasks can be set in it'
    )


def find_options(
    domain: Domain,
    seed: int,
    config: Extraction = USUAL,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> AutomaticOptions:
    """
    Find options by the algorithm of Stolle and Precup (2002), with the changes of this package.

    :param domain: domain with states that can all be listed, or with its own search space.
    :param progress: called with the stages ``tasks`` and ``policies``.
    :raises PlanError: no tasks can be set, no task was learned, or no options were found.
    :raises PlanCanceled: from ``progress``.
    """
    space, began = search_space(domain), clock()
    trainer = Trainer(space, config, progress or (lambda stage, done, steps: None))
    rng = generator(seed, 'automatic_options', 'tasks')
    tasks = draw_tasks(space, config.tasks, rng)
    values = trainer.learn('tasks', tasks, config.train_episodes, rng)
    learner = np.repeat(np.arange(config.tasks), config.test_runs)
    run, state = trainer.greedy_runs(values, tasks, learner, tasks.draw(learner, rng), rng)
    if not run.size:
        raise PlanError(
            f'not one of {config.tasks} tasks was learned in {config.train_episodes} episodes '
            'each: give more'
        )
    visits = Visits(space, run, state)

    found = [b for b in find_bottlenecks(visits, config.options) if b.initiation.any()]
    if not found:
        raise PlanError('no bottleneck has an initiation set: give more tasks')
    rng = generator(seed, 'automatic_options', 'policies')
    initiation = np.array([bottleneck.initiation for bottleneck in found])
    target = np.array([bottleneck.target for bottleneck in found])
    starts, counts = np.nonzero(initiation)[1], initiation.sum(axis=1)
    subgoals = Subgoals(starts, counts, target, ~(initiation | target))
    values = trainer.learn('policies', subgoals, config.option_episodes, rng)
    owner = np.repeat(np.arange(len(found)), counts)
    game_steps = trainer.game_steps  # excluding the runs that only evaluate
    reached, _ = trainer.greedy_runs(values, subgoals, owner, starts, rng)
    reaches = np.bincount(owner[np.unique(reached)], minlength=len(found)) / counts
    return AutomaticOptions(
        options=tuple(
            AutomaticOption(
                name=bottleneck.name,
                max_steps=domain.max_steps or config.max_steps,
                action=table.argmax(axis=1),
                initiation=bottleneck.initiation,
                termination=~bottleneck.initiation,
                target=bottleneck,
                reaches=share,
            )
            for bottleneck, table, share in zip(found, values, reaches.tolist(), strict=True)
        ),
        space=space,
        visits=visits.counts.sum(axis=0),
        seconds=clock() - began,
        game_steps=game_steps,
        episodes=config.tasks * config.train_episodes + len(found) * config.option_episodes,
        solved=len(np.unique(run)) / len(learner),
    )


def to_learned_options(
    domain: Domain, found: AutomaticOptions, participant: str = f'{MACHINE}1'
) -> list[LearnedOption]:
    """
    Convert automatic options to learned options, for saving, serving and planning.

    Each option depends on no more features than its tables require. The trees agree with the
    tables in every state that an episode can pass through: I and beta in all of them, pi in I.

    :param found: automatic options of this domain.
    :param participant: participant code of the options, which begins with ``MACHINE``.
    :raises PlanError: the participant code has another prefix.
    :raises DomainError: two states with equal features have different table entries.
    """
    check_participant(participant)
    rows, going, columns = found.space.rows, found.space.open, found.space.columns
    learned = []
    for option in found.options:
        decisions = 2 * np.where(option.initiation, 1 + option.action, 0) + option.termination
        needed = list(columns)
        for column in reversed(columns):  # drop features that are not needed, last first
            fewer = [other for other in needed if other != column]
            seen = rows[going][:, fewer]
            both = np.column_stack([seen, decisions[going]])
            if fewer and len(np.unique(seen, axis=0)) == len(np.unique(both, axis=0)):
                needed = fewer
        features = [domain.features[column].name for column in needed]
        known = going & option.initiation, going, going
        learned.append(option_from_table(domain, option, features, rows, known, participant))
    return learned


def check_participant(code: str) -> None:
    """
    Check the participant code of automatic options.

    :raises PlanError: the code could be that of a person.
    """
    if not code.startswith(MACHINE):
        raise PlanError(
            f'the participant of automatic options must begin with {MACHINE!r}, not {code!r}'
        )
