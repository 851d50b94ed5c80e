"""
Random choice among options: what a plan has to beat to be worth anything.

Wherever a choice is due, any option that can start is chosen, each with the same probability, and
runs to its end. Where none can start, a primitive action is taken.
"""

from collections.abc import Sequence
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_learner.options.option import LearnedOption, TabularOption, tabulate
from humanopts_learner.options.rollout import tabular_rollouts
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.request import HUMAN
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.games import play_games
from humanopts_learner.planning.sampled.policies import UniformPolicy
import numpy as np


def play_games_by_chance(
    domain: Domain[Any], options: Sequence[LearnedOption], seed: int, games: int
) -> Returns:
    """Play games of a domain that plays many at once, from the start of the task."""
    actions = ActionSet(domain, HUMAN, options)
    return play_games(actions, UniformPolicy(actions), domain.gamma, seed, games)


def play_states_by_chance(
    domain: EnumerableDomain[Any],
    options: Sequence[LearnedOption | TabularOption],
    rng: np.random.Generator,
) -> Returns:
    """Play an episode from every start state of a domain in which every action has one outcome."""
    everywhere = np.ones(domain.n_states, dtype=np.bool_)
    tables = [tabulate(option, domain) for option in options]
    tables += [
        TabularOption(action.name, 1, np.full(domain.n_states, index), everywhere, everywhere)
        for index, action in enumerate(domain.actions)
    ]
    can = np.array([table.initiation for table in tables])  # (O + A, S)
    can[len(options) :] = ~can[: len(options)].any(axis=0)
    longest = np.array([table.max_steps for table in tables])
    at = domain.start_states().astype(np.intp)
    returns, going = Returns.of_none(np.zeros(len(at), dtype=np.bool_)), np.arange(len(at))
    while going.size:
        draws = np.where(can[:, at[going]], rng.random((len(tables), len(going))), -1.0)
        which = draws.argmax(axis=0)
        limits = np.minimum(longest[which], domain.max_steps - returns.steps[going])
        runs = tabular_rollouts(domain, tables, which, at[going], limits)
        returns.total[going] += runs.total_reward
        returns.steps[going] += runs.steps
        returns.decisions[going] += 1
        returns.fallbacks[going] += which >= len(options)
        returns.successes[going] = runs.over
        at[going] = runs.final
        going = going[~runs.over & (returns.steps[going] < domain.max_steps)]
    returns.discounted[:] = np.nan  # what a run earned is known, not when
    return returns
