"""
Play a plan by the rules of its domain, all episodes at once, and find what it does not cover.

Coverage shows where a person can teach more (paper, section 8).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Domain, EnumerableDomain, S
from humanopts_env.games import Chance, TableGames
from humanopts_env.seeding import generator
from humanopts_learner.execution import Execution, play, Played, Policy
from humanopts_learner.options.learned_option import SeenStates
from humanopts_learner.planning.exact_plan import ExactPlan, option_table
from humanopts_learner.planning.models import look_ahead, primitive_model
from humanopts_learner.planning.request import ignore_progress, PlanError, Progress
import numpy as np
from numpy.typing import NDArray

_STARTS = 2_000  # that coverage is found from, at most
_ROUNDING = 1e-6  # in units of discounted return


@dataclass(frozen=True)
class Returns:
    """Results of E episodes."""

    total: NDArray[np.float64]  # (E,) undiscounted
    discounted: NDArray[np.float64]  # (E,)
    steps: Ints  # (E,) primitive steps
    successes: Flags  # (E,) the task was done, not cut off
    decisions: Ints  # (E,) options begun
    fallbacks: Ints  # (E,) decisions for a primitive action because no option could start
    outcomes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """(E,) each: other results that the domain reports of its games; exact: none."""

    @classmethod
    def of(cls, played: Played, gamma: float, first_fallback: int) -> 'Returns':
        """Return the results of episodes; ``first_fallback`` as of ``PolicyPlan``."""
        runs, by_game = played.runs, played.by_game
        ones = np.ones(len(runs.game))
        steps, decisions, fallbacks = (
            by_game(values).astype(np.intp)
            for values in (runs.steps, ones, runs.option >= first_fallback)
        )
        return cls(
            total=by_game(runs.total),
            discounted=by_game(gamma**runs.begun * runs.discounted),
            steps=steps,
            successes=played.over,
            decisions=decisions,
            fallbacks=fallbacks,
            outcomes=played.outcomes,
        )


def episode_starts(domain: EnumerableDomain, seed: int, episodes: int) -> NDArray[np.int32]:
    """
    Draw the start states of episodes, (E,) state indices.

    Each draw has its own generator, so start i does not depend on the number of episodes.
    """
    starts = [domain.index(episode_start(domain, seed, episode)) for episode in range(episodes)]
    return np.array(starts, dtype=np.int32)


def episode_start(domain: Domain[S], seed: int, episode: int) -> S:
    """Draw the start state of one episode."""
    return domain.reset(generator(seed, 'episode_start', episode))


@dataclass(frozen=True)
class PlannedOptions(Policy[SeenStates]):
    """The policy of an exact plan: each option runs to its end."""

    best: NDArray[np.integer]  # (S,) index of the option that is begun

    def choose(self, seen: SeenStates, games: Ints) -> Ints:
        return self.best.take(seen.states).astype(np.intp)


def play_plan(
    plan: ExactPlan,
    starts: NDArray[np.integer],
    max_steps: int = 0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Returns:
    """
    Run each option of the policy to its end, as the runner does, until the episode ends.

    Chance has its own generator for each episode, so episode i is the same however many are
    played.

    :param starts: (E,) state indices.
    :param seed: of the outcomes; not used where every action has one.
    :param max_steps: episodes are cut off after this many steps; 0: the domain's own limit.
    :param progress: called with the stage evaluation; what it raises passes through.
    :raises PlanError: neither limits the episodes.
    """
    limit = max_steps or plan.domain.max_steps
    if limit < 1:
        raise PlanError(f'{plan.domain.name} never cuts an episode off: give max_steps')
    chance: Chance = np.random.default_rng(0)  # unused without chance
    if not plan.domain.transitions().deterministic:
        chance = [generator(seed, 'play', episode) for episode in range(len(starts))]

    def on_step(step: int, *_: Any) -> None:
        progress('evaluation', step / limit, 0, math.nan)

    return Returns.of(
        _played(plan, starts, chance, limit, on_step), plan.gamma, plan.first_fallback
    )


def _played(
    plan: ExactPlan,
    starts: NDArray[np.integer],
    chance: Chance,
    limit: int,
    on_step: Callable[[int, Execution[SeenStates], SeenStates], object],
) -> Played:
    games = TableGames(plan.domain, starts.astype(np.intp))
    options = option_table(plan.domain, plan.action_set, plan.options)
    policy = PlannedOptions(plan.solution.best)
    return play(games, options, policy, chance, limit, gamma=plan.gamma, on_step=on_step)


@dataclass(frozen=True)
class Coverage:
    """States where a plan decides and its options do not serve well."""

    fallback: Ints  # (N,) no option can start there; the most visited first
    single_step: Ints  # (M,) a primitive action is worth more; the greatest gain first
    gain: Floats  # (M,) of each, in units of discounted return


def find_coverage(plan: ExactPlan, most: int = 20) -> Coverage:
    """
    Play one episode from each start state, and look at the states where decisions were made.

    The value of a primitive action followed by the plan is that of one step of look-ahead.

    :param plan: with options only.
    :param most: states of each kind.
    :raises PlanError: primitive actions are among its choices, or the domain never cuts an
        episode off.
    """
    domain = plan.domain
    if plan.first_fallback != len(plan.options) or not domain.max_steps or not plan.options:
        raise PlanError('coverage is found of plans with options only, where episodes end')
    starts = domain.start_states()
    starts = starts[:: -(-len(starts) // _STARTS)]
    visits = np.zeros(domain.n_states, dtype=np.intp)

    def count(step: int, execution: Execution[SeenStates], seen: SeenStates) -> None:
        np.add.at(visits, seen.states.take(execution.decided), 1)

    _played(plan, starts, generator(0, 'coverage'), domain.max_steps, count)
    chosen, values = plan.solution.best, plan.solution.values
    decided = visits > 0
    fallback = np.flatnonzero(decided & (chosen >= plan.first_fallback))
    names = [action.name for action in domain.actions]
    steps = primitive_model(domain.transitions(), domain.over(), plan.gamma, names)
    gain = look_ahead(steps, values).max(axis=1) - values
    better = np.flatnonzero(decided & (chosen < plan.first_fallback) & (gain > _ROUNDING))
    fallback = fallback[np.argsort(-visits[fallback], kind='stable')][:most]
    better = better[np.argsort(-gain[better], kind='stable')][:most]
    return Coverage(fallback, better, gain[better])
