"""
Planning from samples, in rounds of play that follow the policy of the current models.

The policies choose among the options of an action set, in many games in parallel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
import time
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Domain
from humanopts_env.domains.described import simulated
from humanopts_env.games import new_games
from humanopts_env.seeding import generator
from humanopts_learner.execution import play, Policy
from humanopts_learner.option import Option
from humanopts_learner.planning.abstraction import Codes, StateRows
from humanopts_learner.planning.action_set import ActionSet, AnyOption, Observation
from humanopts_learner.planning.exact_plan import PolicyPlan, Returns, sweep_progress
from humanopts_learner.planning.interruption import arbitrate, interruptions, OptionValues
from humanopts_learner.planning.models import look_ahead, MultiTimeModel
from humanopts_learner.planning.request import (
    Arbitration,
    Clock,
    ignore_progress,
    MODULAR,
    PlanError,
    PlanRequest,
    Progress,
)
from humanopts_learner.planning.sampling import SampleCounts, Sampler
from humanopts_learner.planning.solve import Solution, solve_smdp
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class GreedyPolicy(Policy[Observation]):
    """
    Chooses the option with the highest value among those that can start and have enough samples.

    If no option that can start has enough samples, it chooses the one that is the best in the
    largest number of states.

    :ivar values: option values of the known states.
    :ivar execution: execution of the policy; all are deterministic.
    """

    values: OptionValues
    execution: Arbitration = Arbitration.RUN_TO_END

    @cached_property
    def preference(self) -> NDArray[np.int64]:
        """(O,) number of states in which each option is best."""
        values = self.values.option_values
        best = values[np.isfinite(values).any(axis=1)].argmax(axis=1)
        return np.bincount(best, minlength=values.shape[1])

    def choose(self, seen: Observation, games: Ints) -> Ints:
        """Return the next option in each game; with modules, the one that acts for one step."""
        row = self._row(seen.states)
        option_values = self._option_values(seen, row)
        option = self._best(seen, option_values)
        if self.execution not in MODULAR:
            return option
        continuation_values = self._continuation_values.take(row, axis=0)
        strongest = self.execution is Arbitration.MODULAR_STRONGEST
        known = np.isfinite(continuation_values if strongest else option_values).any(axis=1)
        winner = arbitrate(self.execution, option_values, continuation_values, seen.wanted)
        return np.where(known, winner, option)

    def best(self, seen: Observation) -> Ints:
        """Return (N,): the option with the highest value, regardless of the execution."""
        return self._best(seen, self._option_values(seen, self._row(seen.states)))

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        """Return (N,): whether each game's option is stopped; modules run for one step."""
        if self.execution is Arbitration.RUN_TO_END:
            return None
        stopped = np.full(len(option), self.execution in MODULAR)
        if self.execution in MODULAR:
            return stopped
        running = np.flatnonzero((option >= 0) & (option < len(self.values.names)))
        seen = seen.take(running)
        row = self._row(seen.states)
        worth = self._continuation_values[row, option[running]]
        best, margin = self._option_values(seen, row), self.values.interruption_margin
        stopped[running] = interruptions(best, worth[:, None], margin)[:, 0]
        return stopped

    def _best(self, seen: Observation, values: Floats) -> Ints:
        """Return (N,): the startable option with the highest value, given values (N, O)."""
        option: Ints = values.argmax(axis=1)
        others = np.flatnonzero(values.max(axis=1) == -np.inf)
        if others.size:
            can = seen.startable.take(others, axis=0)
            option[others] = np.where(can, self.preference, -1).argmax(axis=1)
            np.copyto(option, seen.fallback, where=seen.fallback >= 0)
        return option

    @cached_property
    def _row(self) -> StateRows:
        """Lookup of the table row of each state; unknown states have the last row, -1."""
        return StateRows(self.values.states)

    @cached_property
    def _values(self) -> Floats:
        """Option values (K + 1, O); those of the last row are unknown."""
        return np.pad(self.values.option_values, ((0, 1), (0, 0)), constant_values=-np.inf)

    @cached_property
    def _continuation_values(self) -> Floats:
        values = self.values.continuation_values
        return np.pad(values, ((0, 1), (0, 0)), constant_values=-np.inf)

    def _option_values(self, seen: Observation, row: Ints) -> Floats:
        """Return option values (N, O); -inf: the option cannot start, or is unknown."""
        values = self._values.take(row, axis=0)
        np.copyto(values, -np.inf, where=~seen.startable)
        return values


@dataclass(frozen=True)
class ExploringPolicy(Policy[Observation]):
    """A greedy policy that sometimes runs a random option, or does not stop one."""

    greedy: GreedyPolicy
    share: float  # share of exploring decisions
    rng: np.random.Generator

    def choose(self, seen: Observation, games: Ints) -> Ints:
        best, option = self.greedy.choose(seen, games), seen.at_random(self.rng)
        return np.where(self.rng.random(len(best)) < self.share, option, best)

    def stops(self, seen: Observation, option: Ints) -> Flags | None:
        stopped = self.greedy.stops(seen, option)
        if stopped is None:
            return None
        return stopped & (self.rng.random(len(option)) >= self.share)


@dataclass(frozen=True, kw_only=True)
class SampledPlan(PolicyPlan):
    """
    A plan based on the values of visited abstract states.

    In the sets ``human`` and ``automatic``, a primitive action is the fallback if no option can
    start: the action of the option with the highest initiation probability. It has no model.
    """

    actions: ActionSet
    policy: GreedyPolicy  # with the execution used for sampling
    unstick: bool  # whether runs that repeat themselves take random moves

    def _best(self, state: Any) -> int:
        return int(self.policy.best(self.actions.observe_state(state))[0])

    def play(
        self,
        seed: int,
        episodes: int,
        execution: Arbitration | None = None,
        progress: Progress = ignore_progress,
    ) -> Returns:
        """
        Play episodes in the real game.

        :param execution: execution of the policy; None: the one used for sampling.
        :param progress: called with the stage evaluation.
        """
        policy = replace(self.policy, execution=execution or self.policy.execution)
        parts = self.actions, policy, self.gamma, seed, episodes, progress
        return play_games(*parts, unstick=self.unstick)


def play_games(
    actions: ActionSet,
    policy: Policy[Observation],
    gamma: float,
    seed: int,
    episodes: int,
    progress: Progress = ignore_progress,
    *,
    unstick: bool = True,
) -> Returns:
    """
    Play games from the start of the task with a policy.

    :param episodes: number of episodes, E; their random draws depend on E.
    :param progress: called with the stage evaluation; its exceptions propagate.
    :param unstick: whether runs that repeat themselves take random moves.
    :raises PlanError: the domain has no step limit, or ``episodes`` is below 1.
    """
    domain = simulated(actions.domain, 'playing episodes')
    limit = domain.max_steps
    if limit < 1 or episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes of at most {limit} steps')
    rng = generator(seed, 'play_games')

    def on_step(step: int, *_: Any) -> None:
        progress('evaluation', step / limit, 0, math.nan)

    games = new_games(domain, episodes, rng)
    loops = actions.loops(episodes, generator(seed, 'random moves')) if unstick else None
    played = play(games, actions, policy, rng, limit, gamma=gamma, loops=loops, on_step=on_step)
    return Returns.of(played, gamma, actions.first_fallback)


def solve_sampled(
    actions: ActionSet,
    states: Codes,
    model: MultiTimeModel,
    request: PlanRequest,
    progress: Progress = ignore_progress,
) -> tuple[Solution, GreedyPolicy]:
    """
    Solve a sampled model.

    :param states: (S,) abstract states of the model, in any order.
    :param request: result of ``PlanRequest.resolved``.
    :return: the solution and the greedy policy, both with states in ascending order.
    """
    n_choices = actions.first_fallback
    on_sweep = sweep_progress(progress, request.tol, request.max_sweeps)
    found = solve_smdp(model, request.tol, request.max_sweeps, on_sweep, n_choices)
    ahead = look_ahead(model, found.values)  # (S, modelled)
    # Where an option can start, continuing it is worth as much as choosing it.
    chosen, continued = ahead[:, :n_choices], ahead[:, :n_choices].copy()
    elsewhere = np.isneginf(chosen[:, : len(actions.options)])
    np.copyto(continued[:, : len(actions.options)], ahead[:, n_choices:], where=elsewhere)
    order = np.argsort(states)
    table = OptionValues(
        action_set=actions.action_set,
        names=actions.names[:n_choices],
        states=states[order],
        option_values=chosen[order],
        continuation_values=continued[order],
        interruption_margin=request.sampling.interruption_margin,
        sampled=True,
        columns=actions.columns,
    )
    solution = replace(found, values=found.values[order], best=found.best[order])
    return solution, GreedyPolicy(table, request.execution)


def make_sampled_plan(
    domain: Domain,
    options: Sequence[Option],
    request: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> SampledPlan:
    """
    Plan from samples, in rounds of equal size, in a domain that plays many games in parallel.

    Parameters and errors are those of ``plan.make_plan``; ``progress`` is called with the stages
    models and sweeps in each round.
    """
    resolved = request.resolved(domain, options, sampled=True)
    actions = ActionSet(domain, resolved.action_set, options, resolved.columns)
    config, n_choices = resolved.sampling, actions.first_fallback
    counts = SampleCounts(actions.modelled, n_choices)
    rng = generator(resolved.seed, 'sampled_plan', resolved.action_set)
    n_games = min(config.n_games, resolved.game_steps // config.game_steps)
    sampler = Sampler(actions, counts, n_games, resolved.gamma, rng, resolved.unstick)
    part = resolved.game_steps // config.rounds
    policy: Policy[Observation] = AnyOption(rng)
    game_steps, model_seconds, sweep_seconds = 0, 0.0, 0.0
    for number in range(config.rounds):

        def on_steps(done: int, before: int = number) -> None:
            progress('models', (before + done / part) / config.rounds, 0, math.nan)

        began = clock()
        game_steps += sampler.play(policy, part, on_steps)
        model = counts.model(config.min_samples)
        modelled = clock()
        found, greedy = solve_sampled(actions, counts.states, model, resolved, progress)
        model_seconds += modelled - began
        sweep_seconds += clock() - modelled
        without_margin = replace(greedy, values=replace(greedy.values, interruption_margin=0.0))
        policy = ExploringPolicy(without_margin, config.explore, rng)
    return SampledPlan(
        domain=domain,
        action_set=resolved.action_set,
        gamma=resolved.gamma,
        names=actions.names,
        first_fallback=n_choices,
        actions=actions,
        solution=found,
        policy=greedy,
        unstick=resolved.unstick,
        game_steps=game_steps,
        model_seconds=model_seconds,
        sweep_seconds=sweep_seconds,
    )
