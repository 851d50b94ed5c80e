"""Making a plan from samples: rounds of play, each by the policy of the models so far."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import BatchGames
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_learner.planning.action_sets import (
    check_action_set,
    ignore_progress,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.arbitration import Execution, OptionValues
from humanopts_learner.planning.errors import check_gamma, ForeignOptionError, PlanError
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.multi_time_models import expected_values, SparseMultiTimeModel
from humanopts_learner.planning.plan import Clock, Decision, SweepProgress
from humanopts_learner.planning.sampled.columns import BatchOption, Columns, LearnedBatchOption
from humanopts_learner.planning.sampled.counts import Counts
from humanopts_learner.planning.sampled.games import (
    batch_games,
    Watcher,
    watcher_for,
)
from humanopts_learner.planning.sampled.judging import play_games
from humanopts_learner.planning.sampled.policies import (
    ArbitratedPolicy,
    executed,
    ExploringPolicy,
    GreedyPolicy,
    Policy,
    UniformPolicy,
)
from humanopts_learner.planning.sampled.pooling import pooled
from humanopts_learner.planning.sampled.sampling import Sampler
from humanopts_learner.planning.value_iteration import Solution, solve_smdp
import numpy as np
from numpy.typing import NDArray

IMPROVEMENTS = 4  # of the policy by pooled values, each evaluated, after value iteration


@dataclass(frozen=True)
class Sampling:
    """How samples are drawn, and what is made of them."""

    rounds: int = 8  # of play; every one but the first by the policy so far
    n_games: int = 1000  # side by side, at most
    game_steps: int = 400  # that each of them is played in all, at least
    explore: float = 0.2  # share of decisions that are drawn, from the second round on
    min_samples: int = 1  # pairs of state and column with fewer are not available
    penalty: float = 0.0  # reward units, by the square root of the number of samples
    pooling: float = 0.0  # samples that the mean over states of other context counts as; 0: none
    reluctance: float = 0.0  # reward units that a primitive action beside options seems worth less
    margin: float = 10.0  # reward units that stopping an option must be worth when it is played

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises PlanError: one is out of range.
        """
        if min(self.rounds - 1, self.n_games, self.min_samples) < 1:
            raise PlanError(f'{self} needs two rounds, one game and one sample, at least')
        numbers = (self.penalty, self.pooling, self.reluctance, self.margin)
        finite = all(0.0 <= number < math.inf for number in numbers)
        if not 0.0 <= self.explore <= 1.0 or not finite:
            raise PlanError(f'{self} needs a share from 0 to 1; others finite, from 0')


@dataclass(frozen=True)
class SampledPlan:
    """
    A greedy policy over columns, by the planning states that were visited.

    The columns are the options and then the primitive actions. In the set ``human`` these are the
    fallback, drawn by a hash of the features where no option can start; models do not cover them.
    """

    domain: Domain[Any]
    action_set: str
    gamma: float
    columns: Columns
    solution: Solution
    policy: GreedyPolicy
    continuation_values: NDArray[np.float64]  # (S, O) where the column cannot start; or -inf
    execution: Execution  # that it was sampled by
    margin: float  # reward units; nothing is stopped for less
    watch: Watcher
    game_steps: int  # that were sampled
    table_seconds: float  # of what samples are counted in: nothing, so 0
    model_seconds: float  # sampling and counting
    sweep_seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.columns.names

    @property
    def first_fallback(self) -> int:
        """Column from which on a choice is a fallback; the number of columns where none is."""
        return self.columns.first_fallback

    @property
    def seconds(self) -> float:
        """What planning took, all counted."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds

    def choose(self, state: Any) -> Decision:
        """
        Return what the policy runs in a state of the domain.

        :raises PlanError: the task is over in it.
        """
        if self.domain.is_over(state):
            raise PlanError('there is nothing to do: the task is over')
        choice = self.policy.choose(self.watch(self.watch.games.batch_of([state])))
        column = int(choice.column[0])
        return Decision(self.names[column], column >= self.first_fallback)

    def as_executed(self, execution: Execution | None = None) -> Policy:
        """Return the policy as executed in some way; None: as it was sampled."""
        execution = self.execution if execution is None else execution
        return executed(self.policy, self.continuation_values, execution, self.margin)

    def play(
        self,
        seed: int,
        episodes: int,
        execution: Execution | None = None,
        progress: Progress | None = None,
    ) -> Returns:
        """
        Judge the plan in the real game.

        :param execution: how the policy is executed; None: as it was sampled.
        :param progress: called with the stage evaluation.
        """
        policy = self.as_executed(execution)
        return play_games(self.watch, self.columns, policy, self.gamma, seed, episodes, progress)

    def option_values(self) -> OptionValues:
        """Return what arbitration needs of it."""
        order = np.argsort(codes := self.policy.index.codes)
        return OptionValues(
            action_set=self.action_set,
            names=self.names[: self.first_fallback],
            states=codes[order],
            option_values=self.policy.values[order],
            continuation_values=self.continuation_values[order],
            interruption_margin=self.margin,
            sampled=True,
        )


def make_sampled_plan(
    domain: Domain[Any],
    action_set: str,
    options: Sequence[LearnedOption | BatchOption],
    budget_steps: int,
    seed: int,
    gamma: float | None = None,
    how: Sampling = Sampling(),
    tol: float = 1e-3,
    max_sweeps: int = 10_000,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
    execution: Execution = Execution.RUN_TO_END,
) -> SampledPlan:
    """
    Plan from samples, in a domain that plays many games at once.

    :param action_set: one of ``ACTION_SETS``; ``options`` are not looked at in ``primitive``.
    :param budget_steps: game steps that are sampled in all; rounds get equal parts.
    :param gamma: discount per primitive step; None: the domain's own.
    :param tol: largest change allowed in the last sweep, in reward units.
    :param execution: how the policy so far is carried out from the second round on. Where options
        are interrupted, the models are of interrupted options (Sutton, Precup and Singh 1999,
        section 4: interruption can be repeated on what it led to).
    :param progress: told the stages ``models`` and ``sweeps``, anew in each round.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    :raises PlanCanceled: from ``progress``.
    """
    gamma = domain.gamma if gamma is None else gamma
    check_gamma(gamma)
    used = () if action_set == PRIMITIVE else batch_options(domain, options)
    check_action_set(action_set, [option.name for option in used])
    if budget_steps < how.game_steps:
        raise PlanError(f'{budget_steps} game steps are fewer than the {how.game_steps} of a game')
    games = batch_games(domain)
    tell = progress or ignore_progress
    work = _Planning(
        games, action_set, used, gamma, how, budget_steps, seed, tell, clock, execution
    )
    for number in range(how.rounds):
        work.sample(number)
        work.solve(tol, max_sweeps)
    return work.plan()


class _Planning:
    """What a plan is made of while it is made."""

    def __init__(
        self,
        games: BatchGames,
        action_set: str,
        options: Sequence[BatchOption],
        gamma: float,
        how: Sampling,
        budget_steps: int,
        seed: int,
        tell: Progress,
        clock: Clock,
        execution: Execution,
    ) -> None:
        self._games, self._action_set, self._gamma = games, action_set, gamma
        self._how, self._tell, self._clock = how, tell, clock
        self._execution = execution
        self._columns = Columns(games, action_set, options)
        self._watch = watcher_for(games, action_set)
        self._counts = Counts(self._columns.modelled, self._columns.first_fallback)
        self._sampler = Sampler(
            self._watch,
            self._columns,
            self._counts,
            min(how.n_games, budget_steps // how.game_steps),
            gamma,
            generator(seed, 'sampled_plan', action_set),
        )
        self._pools = how.pooling > 0.0 and self._watch.context != ()
        self._part = budget_steps // how.rounds
        self._policy: GreedyPolicy | None = None
        self._continuation_values: NDArray[np.float64] = np.empty((0, 0))
        self._solution: Solution | None = None
        self._steps, self._model_seconds, self._sweep_seconds = 0, 0.0, 0.0

    def sample(self, number: int) -> None:
        """Play one round, and count what happened."""
        began, rounds = self._clock(), self._how.rounds
        policy: Policy = UniformPolicy(self._columns)
        if self._policy is not None:
            policy = ExploringPolicy(self._policy, self._how.explore, self._arbitrated())
        self._steps += self._sampler.play(
            policy,
            self._part,
            lambda done: self._tell('models', (number + done / self._part) / rounds, 0, math.nan),
        )
        self._model_seconds += self._clock() - began

    def solve(self, tol: float, max_sweeps: int) -> None:
        """Solve the models so far."""
        began = self._clock()
        model = self._counts.model(self._how.min_samples, self._how.penalty)
        choosable = model.first(self._columns.first_fallback)
        modelled = self._clock()
        on_sweep = SweepProgress(self._tell, tol, max_sweeps)
        self._solution = solve_smdp(choosable, tol, max_sweeps, on_sweep)
        values = _values(model, self._solution.values)
        for _ in range(IMPROVEMENTS if self._pools else 0):
            policy = np.where(choosable.available, self._pooled(values), -np.inf).argmax(axis=1)
            evaluated = solve_smdp(choosable.of_policy(policy), tol, max_sweeps)
            values = _values(model, evaluated.values)
        self._take(values)
        self._model_seconds += modelled - began
        self._sweep_seconds += self._clock() - modelled

    def _pooled(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values of the columns that can be chosen, pooled if that is asked for."""
        option_values = values[:, : self._columns.first_fallback]
        if not self._pools:
            return option_values
        codes = self._watch.without_context(self._counts.index.codes)
        group = np.unique(codes, return_inverse=True)[1]
        samples = self._counts.samples[:, : self._columns.first_fallback]
        return pooled(option_values, samples, group, self._how.pooling)

    def _take(self, values: NDArray[np.float64]) -> None:
        """Make the policy of the values (S, modelled)."""
        option_values, others = self._pooled(values), values[:, self._columns.first_fallback :]
        if n_options := len(self._columns.options):
            option_values[:, n_options:] -= self._how.reluctance
        self._policy = GreedyPolicy(self._columns, self._counts.index.snapshot(), option_values)
        self._continuation_values = np.full(option_values.shape, -np.inf)
        self._continuation_values[:, : others.shape[1]] = others

    def _arbitrated(self) -> ArbitratedPolicy | None:
        if self._policy is None or self._execution is Execution.RUN_TO_END:
            return None
        return ArbitratedPolicy(self._policy, self._continuation_values, self._execution, 0.0)

    def plan(self) -> SampledPlan:
        """Return the plan of the last round."""
        assert self._policy is not None
        assert self._solution is not None
        return SampledPlan(
            domain=self._games.domain,
            action_set=self._action_set,
            gamma=self._gamma,
            columns=self._columns,
            solution=self._solution,
            policy=self._policy,
            continuation_values=self._continuation_values,
            execution=self._execution,
            margin=self._how.margin,
            watch=self._watch,
            game_steps=self._steps,
            table_seconds=0.0,
            model_seconds=self._model_seconds,
            sweep_seconds=self._sweep_seconds,
        )


def _values(model: SparseMultiTimeModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what each choice is worth, (S, O); -inf where it is not available."""
    ahead = expected_values(model, values).T
    return np.where(model.available, model.reward + ahead, -np.inf)


def batch_options(
    domain: Domain[Any], options: Sequence[LearnedOption | BatchOption]
) -> list[BatchOption]:
    """
    Return options as they are judged for many games at once.

    :raises ForeignOptionError: one was learned in another domain.
    """
    found: list[BatchOption] = []
    for option in options:
        if not isinstance(option, LearnedOption):
            found.append(option)
            continue
        try:
            option.check_domain(domain)
        except OptionError as error:
            raise ForeignOptionError(str(error)) from error
        found.append(LearnedBatchOption(option))
    return found
