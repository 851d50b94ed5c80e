"""Planning from samples: rounds of play, each by the policy of the models so far."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.games import new_games
from humanopts_env.seeding import generator
from humanopts_learner.execution import play, Policy
from humanopts_learner.option import Option
from humanopts_learner.planning.action_set import ActionSet, Observation
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.exact_plan import PolicyPlan, SweepProgress
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.models import look_ahead, MultiTimeModel
from humanopts_learner.planning.request import (
    Arbitration,
    Clock,
    ignore_progress,
    PlanError,
    PlanRequest,
    Progress,
)
from humanopts_learner.planning.sampled_models import SampleCounts
from humanopts_learner.planning.sampled_policies import (
    ExploringPolicy,
    GreedyPolicy,
    UniformPolicy,
)
from humanopts_learner.planning.sampling import Sampler
from humanopts_learner.planning.solve import Solution, solve_smdp
import numpy as np


@dataclass(frozen=True, kw_only=True)
class SampledPlan(PolicyPlan):
    """
    A plan by the values of the abstract states that were visited.

    In the set ``human`` the primitive actions are the fallback where no option can start: the
    action of the option that could most probably start. They have no models.
    """

    actions: ActionSet
    policy: GreedyPolicy  # executed as it was while sampling

    def _best(self, state: Any) -> int:
        return int(self.policy.best(self.actions.observe_state(state))[0])

    def as_executed(self, execution: Arbitration | None = None) -> GreedyPolicy:
        """Return the policy with a way of execution; None: the one it was sampled with."""
        return self.policy if execution is None else replace(self.policy, execution=execution)

    def play(
        self,
        seed: int,
        episodes: int,
        execution: Arbitration | None = None,
        progress: Progress = ignore_progress,
    ) -> Returns:
        """
        Play episodes in the real game.

        :param execution: how the policy is executed; None: as it was while sampling.
        :param progress: called with the stage evaluation.
        """
        policy = self.as_executed(execution)
        return play_games(self.actions, policy, self.gamma, seed, episodes, progress)


def play_games(
    actions: ActionSet,
    policy: Policy[Observation],
    gamma: float,
    seed: int,
    episodes: int,
    progress: Progress = ignore_progress,
) -> Returns:
    """
    Play games from the start of the task by a policy.

    :param episodes: number of episodes, E; the random draws of each depend on E.
    :param progress: called with the stage evaluation; what it raises passes through.
    :raises PlanError: the domain never cuts an episode off, or ``episodes`` is below 1.
    """
    domain = actions.domain
    limit = domain.max_steps
    if limit < 1 or episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes of at most {limit} steps')
    rng = generator(seed, 'play_games')

    def on_step(step: int, *_: Any) -> None:
        progress('evaluation', step / limit, 0, math.nan)

    games = new_games(domain, episodes, rng)
    played = play(games, actions, policy, rng, limit, gamma=gamma, on_step=on_step)
    return Returns.of(played, gamma, actions.first_fallback)


def make_sampled_plan(
    domain: Domain[Any],
    options: Sequence[Option],
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
    actions = ActionSet(domain, asked.action_set, options, asked.columns)
    config = asked.sampling
    counts = SampleCounts(actions.modelled, actions.first_fallback)
    rng = generator(asked.seed, 'sampled_plan', asked.action_set)
    n_games = min(config.n_games, asked.game_steps // config.game_steps)
    sampler = Sampler(actions, counts, n_games, asked.gamma, rng)
    part = asked.game_steps // config.rounds
    policy: Policy[Observation] = UniformPolicy(rng)
    game_steps, model_seconds, sweep_seconds = 0, 0.0, 0.0
    for number in range(config.rounds):

        def on_steps(done: int, before: int = number) -> None:
            progress('models', (before + done / part) / config.rounds, 0, math.nan)

        began = clock()
        game_steps += sampler.play(policy, part, on_steps)
        model = counts.model(config.min_samples)
        modelled = clock()
        on_sweep = SweepProgress(progress, asked.tol, asked.max_sweeps)
        solution, greedy = _solve(model, actions, counts, asked, on_sweep)
        model_seconds += modelled - began
        sweep_seconds += clock() - modelled
        # sampled from without an interruption margin
        values = replace(greedy.values, interruption_margin=0.0)
        policy = ExploringPolicy(replace(greedy, values=values), config.explore, rng)
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
    model: MultiTimeModel,
    actions: ActionSet,
    counts: SampleCounts,
    asked: PlanRequest,
    on_sweep: SweepProgress,
) -> tuple[Solution, GreedyPolicy]:
    """Return the solution of the model of all samples so far, and the policy of its values."""
    n_choices = actions.first_fallback
    found = solve_smdp(model, asked.tol, asked.max_sweeps, on_sweep, n_choices)
    ahead = look_ahead(model, found.values)  # (S, modelled)
    continuation_values = np.full((len(ahead), n_choices), -np.inf)
    continuation_values[:, : len(actions.options)] = ahead[:, n_choices:]
    codes = counts.index.codes
    order = np.argsort(codes)
    table = OptionValues(
        action_set=actions.action_set,
        names=actions.names[:n_choices],
        states=codes[order],
        option_values=ahead[order, :n_choices],
        continuation_values=continuation_values[order],
        interruption_margin=asked.sampling.interruption_margin,
        sampled=True,
    )
    solution = replace(found, values=found.values[order], best=found.best[order])
    return solution, GreedyPolicy(actions, table, asked.execution)
