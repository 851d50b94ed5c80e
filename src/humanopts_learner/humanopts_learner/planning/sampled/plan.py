"""Planning from samples: rounds of play, each by the policy of the models so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
import time
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import Domain
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.exact import PolicyPlan, SweepProgress
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.request import (
    Clock,
    Execution,
    ignore_progress,
    PlanError,
    PlanRequest,
    Progress,
)
from humanopts_learner.planning.sampled.action_set import ActionSet, CodeTable
from humanopts_learner.planning.sampled.games import (
    play_games,
    playing,
    Process,
    run_in_step,
    Sampler,
)
from humanopts_learner.planning.sampled.policies import (
    ExploringPolicy,
    GreedyPolicy,
    Policy,
    UniformPolicy,
)
from humanopts_learner.planning.sampled.sampled_models import SampleCounts, Shrinkage
from humanopts_learner.planning.smdp import look_ahead, SparseMultiTimeModel
from humanopts_learner.planning.value_iteration import greedy_options, Solution, sweep_values
import numpy as np

IMPROVEMENTS = 4  # policy improvements by shrunk values after value iteration, each evaluated


@dataclass(frozen=True, kw_only=True)
class SampledPlan(PolicyPlan):
    """
    A plan by the values of the abstract states that were visited.

    In the set ``human`` the primitive actions are the fallback, chosen by a hash of the features
    where no option can start; they have no models.
    """

    actions: ActionSet
    policy: GreedyPolicy  # executed as it was while sampling

    def _best(self, state: Any) -> int:
        return int(self.policy.choose(self.actions.observe_state(state)).option[0])

    def as_executed(self, execution: Execution | None = None) -> GreedyPolicy:
        """Return the policy with a way of execution; None: the one it was sampled with."""
        return self.policy if execution is None else replace(self.policy, execution=execution)

    def play(
        self,
        seed: int,
        episodes: int,
        execution: Execution | None = None,
        progress: Progress = ignore_progress,
    ) -> Returns:
        """
        Play episodes in the real game.

        :param execution: how the policy is executed; None: as it was while sampling.
        :param progress: called with the stage evaluation.
        """
        policy = self.as_executed(execution)
        return play_games(self.actions, policy, self.gamma, seed, episodes, progress)


def play_in_step(
    plans: Sequence[tuple[SampledPlan, int, Execution | None]], episodes: int
) -> list[Returns]:
    """
    Play episodes by several plans in step, which takes less time than one after another.

    :param plans: with the same options and action set, each with the seed of its games and its
        execution, as in ``SampledPlan.play``.
    """
    played = [
        playing(plan.actions, plan.as_executed(execution), plan.gamma, seed, episodes)
        for plan, seed, execution in plans
    ]
    return run_in_step(plans[0][0].actions, played) if plans else []


def make_sampled_plan(
    domain: Domain[Any],
    options: Sequence[LearnedOption],
    request: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> SampledPlan:
    """
    Plan from samples, in a domain that plays many games at once; rounds get equal parts of them.

    Parameters and errors are those of ``plan.make_plan``; ``progress`` is called with the stages
    models and sweeps, anew in each round.
    """
    asked = request.in_force(domain, options, sampled=True)
    actions = ActionSet(domain, asked.action_set, options)
    return run_in_step(actions, [_planning(domain, actions, asked, progress, clock)])[0]


def make_sampled_plans(
    domain: Domain[Any], options: Sequence[LearnedOption], requests: Sequence[PlanRequest]
) -> list[SampledPlan]:
    """
    Make plans with the same options and action set in step, which takes less time than one by one.

    Each is what ``make_sampled_plan`` makes, but for its seconds: they are those of all.

    :param requests: one or more.
    """
    asked = [request.in_force(domain, options, sampled=True) for request in requests]
    if len({request.action_set for request in asked}) != 1:
        raise PlanError('plans that are made in step have one action set')
    actions = ActionSet(domain, asked[0].action_set, options)
    return run_in_step(actions, [_planning(domain, actions, request) for request in asked])


def _planning(
    domain: Domain[Any],
    actions: ActionSet,
    asked: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> Process[SampledPlan]:
    config = asked.sampling
    counts = SampleCounts(actions.modelled, actions.first_fallback)
    sampler = Sampler(
        actions,
        counts,
        min(config.n_games, asked.game_steps // config.game_steps),
        asked.gamma,
        generator(asked.seed, 'sampled_plan', asked.action_set),
    )
    part = asked.game_steps // config.rounds
    policy: Policy = UniformPolicy(actions)
    game_steps, model_seconds, sweep_seconds = 0, 0.0, 0.0
    for number in range(config.rounds):

        def on_steps(done: int, before: int = number) -> None:
            progress('models', (before + done / part) / config.rounds, 0, math.nan)

        began = clock()
        game_steps += yield from sampler.play(policy, part, on_steps)
        model = counts.model(config.min_samples, config.penalty)
        modelled = clock()
        on_sweep = SweepProgress(progress, asked.tol, asked.max_sweeps)
        solution, greedy = _solve(model, actions, counts, asked, on_sweep)
        model_seconds += modelled - began
        sweep_seconds += clock() - modelled
        # sampled from without an interruption margin
        values = replace(greedy.values, interruption_margin=0.0)
        policy = ExploringPolicy(replace(greedy, values=values), config.explore)
    return SampledPlan(
        domain=domain,
        action_set=asked.action_set,
        gamma=asked.gamma,
        names=actions.names,
        first_fallback=actions.first_fallback,
        actions=actions,
        solution=solution,
        policy=greedy,
        game_steps=game_steps,
        model_seconds=model_seconds,
        sweep_seconds=sweep_seconds,
    )


def _solve(
    model: SparseMultiTimeModel,
    actions: ActionSet,
    counts: SampleCounts,
    asked: PlanRequest,
    on_sweep: SweepProgress,
) -> tuple[Solution, GreedyPolicy]:
    """Return the solution of the model of all samples so far, and the policy of its values."""
    n_choosable, config = actions.first_fallback, asked.sampling
    choosable = model.first(n_choosable)
    shrinks = config.shrinkage > 0.0 and actions.abstraction.context != ()
    shrink: Callable[[Floats], Floats] = np.copy  # of the values (S, O) of those to choose among
    if shrinks:  # towards the states that differ in context only
        alike = actions.abstraction.without_context(counts.index.codes)
        group = CodeTable(np.unique(alike)).find(alike)
        samples = counts.samples[:, :n_choosable]
        shrink = Shrinkage(choosable.available, samples, group, config.shrinkage)
    limits = asked.tol, asked.max_sweeps
    solved, sweeps, residual = sweep_values(choosable, *limits, on_sweep)
    values, greedy = solved, None
    for _ in range(IMPROVEMENTS if shrinks else 0):
        ahead = look_ahead(choosable, values)
        greedy = greedy_options(ahead) if greedy is None else greedy
        best = np.where(choosable.available, shrink(ahead), -np.inf).argmax(axis=1)
        values = sweep_values(choosable.of_policy(best), *limits)[0]
    ahead = look_ahead(model, values)  # (S, modelled)
    option_values, others = shrink(ahead[:, :n_choosable]), ahead[:, n_choosable:]
    greedy = greedy_options(ahead[:, :n_choosable]) if greedy is None else greedy
    if n_options := len(actions.options):
        option_values[:, n_options:] -= config.primitive_penalty
    continuation_values = np.full(option_values.shape, -np.inf)
    continuation_values[:, : others.shape[1]] = others
    codes = counts.index.codes
    order = np.argsort(codes)
    table = OptionValues(
        action_set=actions.action_set,
        names=actions.names[:n_choosable],
        states=codes[order],
        option_values=option_values[order],
        continuation_values=continuation_values[order],
        interruption_margin=config.interruption_margin,
        sampled=True,
    )
    solution = Solution(solved[order], greedy[order], sweeps, residual, residual <= asked.tol)
    return solution, GreedyPolicy(actions, table, asked.execution)
