"""Trials that show where a plan gets stuck, in new games without random moves."""

from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.described import simulated
from humanopts_env.games import Games, new_games
from humanopts_env.seeding import generator
from humanopts_learner.execution import Execution, NONE, play, Policy
from humanopts_learner.planning.action_set import Observation
from humanopts_learner.planning.request import ignore_progress, OPTIONS_ONLY, Progress
from humanopts_learner.planning.sampled_plan import GreedyPolicy, SampledPlan
import numpy as np

TRIALS = 50  # number of games


@dataclass(frozen=True)
class Trial:
    """The places where a plan got stuck, at most one per game."""

    games: int = 0  # number played; 0: the plan was not tried
    options: tuple[str, ...] = ()  # option that ran there; empty: no option could start
    states: tuple[str, ...] = ()  # in the domain's notation


@dataclass(frozen=True)
class _WithoutFallback(Policy[Observation]):
    """A policy that ends a game where no option can start."""

    policy: GreedyPolicy
    first_fallback: int  # index of the first primitive action

    def choose(self, seen: Observation, games: Ints) -> Ints:
        option = self.policy.choose(seen, games)
        return np.where(option < self.first_fallback, option, NONE)

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        return self.policy.stops(seen, option)


def try_plan(
    plan: SampledPlan, seed: int, progress: Progress = ignore_progress, games: int = TRIALS
) -> Trial:
    """
    Play a plan with options only, and find where it gets stuck.

    A plan gets stuck where an option repeats itself (``Loops``), where no option can start, or, in
    a game that exceeds the step limit, where the last option began.

    :param progress: called with the stage evaluation.
    :return: the trial; empty if no option has runs to check, or games have no step limit.
    """
    actions, domain = plan.actions, simulated(plan.domain, 'a trial')
    loops, limit = actions.loops(games, None), domain.max_steps
    if loops is None or limit < 1 or plan.action_set not in OPTIONS_ONLY:
        return Trial()
    rng = generator(seed, 'trial games')
    began: dict[int, Any] = {}
    last: dict[int, tuple[int, Any]] = {}

    def on_step(
        step: int, execution: Execution[Observation], seen: Observation, played: Games
    ) -> None:
        progress('evaluation', step / limit, 0, np.nan)
        states = played.states()
        began.update((int(execution.games[at]), states[at]) for at in execution.decided)
        parts = zip(execution.games.tolist(), execution.option.tolist(), states)
        last.update((game, (option, state)) for game, option, state in parts)

    policy = _WithoutFallback(plan.policy, plan.first_fallback)
    played = play(
        new_games(domain, games, rng), actions, policy, rng, limit, loops=loops, on_step=on_step
    )
    looped = set(played.runs.game[played.runs.stuck != NONE].tolist())
    stuck = []
    for game in np.flatnonzero(~played.over).tolist():
        option, state = last[game]
        if option != NONE and game not in looped:
            state = began[game]
        stuck.append(('' if option == NONE else plan.names[option], domain.encode(state)))
    return Trial(games, tuple(name for name, _ in stuck), tuple(state for _, state in stuck))
