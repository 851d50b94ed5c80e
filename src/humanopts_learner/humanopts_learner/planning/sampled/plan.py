"""Making a plan from samples: rounds of play, each by the policy of the models so far."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.seeding import generator
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_learner.planning.action_sets import (
    check_action_set,
    HUMAN,
    PRIMITIVE,
    Progress,
    say_nothing,
)
from humanopts_learner.planning.errors import check_gamma, ForeignOptionError, PlanError
from humanopts_learner.planning.model import expected_values
from humanopts_learner.planning.plan import Clock, Decision, SweepProgress
from humanopts_learner.planning.sampled.columns import BatchOption, Columns, LearnedBatchOption
from humanopts_learner.planning.sampled.counts import Counts
from humanopts_learner.planning.sampled.games import batch_domain, BatchDomain, Watcher
from humanopts_learner.planning.sampled.judging import GameReturns, play_games
from humanopts_learner.planning.sampled.policies import (
    ExploringPolicy,
    GreedyPolicy,
    Policy,
    UniformPolicy,
)
from humanopts_learner.planning.sampled.sampling import Sampler
from humanopts_learner.planning.value_iteration import Solution, solve_smdp
import numpy as np


@dataclass(frozen=True)
class Sampling:
    """How samples are drawn, and what is made of them."""

    rounds: int = 4  # of play; every one but the first by the policy so far
    n_games: int = 1000  # side by side, at most
    game_steps: int = 400  # that each of them is played in all, at least
    explore: float = 0.2  # share of decisions that are drawn, from the second round on
    min_samples: int = 2  # pairs of state and column with fewer are not available
    penalty: float = 5.0  # reward units, by the square root of the number of samples

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises PlanError: one is out of range.
        """
        if min(self.rounds - 1, self.n_games, self.min_samples) < 1:
            raise PlanError(f'{self} needs two rounds, one game and one sample, at least')
        if not 0.0 <= self.explore <= 1.0 or not 0.0 <= self.penalty < math.inf:
            raise PlanError(f'{self} needs a share from 0 to 1 and a finite penalty from 0')


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

    def play(self, seed: int, episodes: int) -> GameReturns:
        """Judge the plan in the real game, each option run to its end."""
        return play_games(self.watch, self.columns, self.policy, self.gamma, seed, episodes)


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
) -> SampledPlan:
    """
    Plan from samples, in a domain that plays many games at once.

    :param action_set: human, primitive (``options`` are not looked at) or human+primitive.
    :param budget_steps: game steps that are sampled in all; rounds get equal parts.
    :param gamma: discount per primitive step; None: the domain's own.
    :param tol: largest change allowed in the last sweep, in reward units.
    :param progress: told the stages ``models`` and ``sweeps``, anew in each round.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    :raises PlanCanceled: from ``progress``.
    """
    gamma = domain.gamma if gamma is None else gamma
    check_gamma(gamma)
    used = () if action_set == PRIMITIVE else _batch_options(domain, options)
    check_action_set(action_set, [option.name for option in used])
    if budget_steps < how.game_steps:
        raise PlanError(f'{budget_steps} game steps are fewer than the {how.game_steps} of a game')
    games = batch_domain(domain)
    tell = progress or say_nothing
    work = _Planning(games, action_set, used, gamma, how, budget_steps, seed, tell, clock)
    for number in range(how.rounds):
        work.sample(number)
        work.solve(tol, max_sweeps)
    return work.plan()


class _Planning:
    """What a plan is made of while it is made."""

    def __init__(
        self,
        games: BatchDomain,
        action_set: str,
        options: Sequence[BatchOption],
        gamma: float,
        how: Sampling,
        budget_steps: int,
        seed: int,
        tell: Progress,
        clock: Clock,
    ) -> None:
        self._games, self._action_set, self._gamma = games, action_set, gamma
        self._how, self._tell, self._clock = how, tell, clock
        self._columns = Columns(games, action_set, options)
        self._watch = Watcher(games, fine=action_set != HUMAN)
        self._counts = Counts(self._columns.names[: self._columns.first_fallback])
        self._sampler = Sampler(
            self._watch,
            self._columns,
            self._counts,
            min(how.n_games, budget_steps // how.game_steps),
            gamma,
            generator(seed, 'sampled_plan', action_set),
        )
        self._part = budget_steps // how.rounds
        self._policy: GreedyPolicy | None = None
        self._solution: Solution | None = None
        self._steps, self._model_seconds, self._sweep_seconds = 0, 0.0, 0.0

    def sample(self, number: int) -> None:
        """Play one round, and count what happened."""
        began, rounds = self._clock(), self._how.rounds
        policy: Policy = UniformPolicy(self._columns)
        if self._policy is not None:
            policy = ExploringPolicy(self._policy, self._how.explore)
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
        modelled = self._clock()
        on_sweep = SweepProgress(self._tell, tol, max_sweeps)
        self._solution = solve_smdp(model, tol, max_sweeps, on_sweep)
        expected = expected_values(model, self._solution.values)
        values = np.where(model.available, model.reward + expected.T, -np.inf)
        self._policy = GreedyPolicy(self._columns, self._counts.index.snapshot(), values)
        self._model_seconds += modelled - began
        self._sweep_seconds += self._clock() - modelled

    def plan(self) -> SampledPlan:
        """Return the plan of the last round."""
        assert self._policy is not None
        assert self._solution is not None
        return SampledPlan(
            self._games.domain,
            self._action_set,
            self._gamma,
            self._columns,
            self._solution,
            self._policy,
            self._watch,
            self._steps,
            0.0,
            self._model_seconds,
            self._sweep_seconds,
        )


def _batch_options(
    domain: Domain[Any], options: Sequence[LearnedOption | BatchOption]
) -> list[BatchOption]:
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
