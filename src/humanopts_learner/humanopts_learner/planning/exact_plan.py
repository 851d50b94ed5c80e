"""
Planning with exact models: the greedy policy of an action set, its episodes and its coverage.

Coverage lists states that are not well served by the options of a plan; it shows where a person
can teach more (paper, section 8).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import math
import time
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import ActableDomain, Domain, EnumerableDomain, S
from humanopts_env.games import Chance, Games, TableGames
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.execution import Execution, play, Played, Policy
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import (
    OptionTable,
    SeenStates,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.models import (
    concatenate,
    look_ahead,
    model_option,
    MultiTimeModel,
    primitive_model,
)
from humanopts_learner.planning.request import (
    Clock,
    ignore_progress,
    OPTIONS_ONLY,
    PlanError,
    PlanRequest,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.solve import OnSweep, Solution, solve_smdp
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

_STARTS = 2_000  # maximum number of start states for coverage
_ROUNDING = 1e-6  # in units of discounted return


@dataclass(frozen=True)
class Returns:
    """Results of E episodes."""

    total: NDArray[np.float64]  # (E,) undiscounted
    discounted: NDArray[np.float64]  # (E,)
    steps: Ints  # (E,) primitive steps
    successes: Flags  # (E,) task completed, not cut off
    decisions: Ints  # (E,) number of options begun
    fallbacks: Ints  # (E,) primitive actions taken because no option could start
    random_moves: Ints  # (E,) moves taken because an option repeated itself
    outcomes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """(E,) each: other results that the domain reports of its games; exact: none."""

    @classmethod
    def of(cls, played: Played, gamma: float, first_fallback: int) -> 'Returns':
        """Return the results of episodes; ``first_fallback`` as in ``PolicyPlan``."""
        runs, by_game = played.runs, played.by_game
        ones = np.ones(len(runs.game))
        fallback = runs.option >= first_fallback
        steps, decisions, fallbacks, random_moves = (
            by_game(values).astype(np.intp)
            for values in (runs.steps, ones, fallback, runs.random_moves)
        )
        return cls(
            total=by_game(runs.total),
            discounted=by_game(gamma**runs.begun * runs.discounted),
            steps=steps,
            successes=played.over,
            decisions=decisions,
            fallbacks=fallbacks,
            random_moves=random_moves,
            outcomes=played.outcomes,
        )


@dataclass(frozen=True)
class Decision:
    """The next option of a policy over options."""

    name: str  # name of an option, or action:NAME
    fallback: bool  # primitive action taken because no option is available


@dataclass(frozen=True, kw_only=True)
class PolicyPlan(ABC):
    """
    A greedy policy over options, and the cost of planning.

    Option indices refer to the options, followed by all primitive actions if the action set needs
    them.
    """

    domain: ActableDomain
    action_set: str
    gamma: float
    names: tuple[str, ...]  # by option index
    first_fallback: int  # index of the first fallback; number of names: none
    solution: Solution
    game_steps: int = 0  # sampled or recorded
    recorded_runs: int = 0  # number of runs used
    table_seconds: float = 0.0  # for option tables of exact plans
    model_seconds: float  # building models, including sampling and counting
    sweep_seconds: float

    @property
    def seconds(self) -> float:
        """Total duration of planning."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds

    def choose(self, state: Any) -> Decision:
        """
        Return the next option of the policy in a state of the domain.

        :raises PlanError: the task is over in this state.
        """
        if self.domain.is_over(state):
            raise PlanError('there is nothing to do: the task is over')
        option = self._best(state)
        return Decision(self.names[option], option >= self.first_fallback)

    @abstractmethod
    def _best(self, state: Any) -> int:
        """Return the index of the option to run in a state where the task is not over."""


@dataclass(frozen=True, kw_only=True)
class ExactPlan(PolicyPlan):
    """
    A plan based on the values of all states.

    In the sets ``human`` and ``automatic``, primitive actions are the fallback: they are available
    only in states without an available option. The fallback is the best action by one step of
    look-ahead in the plan's own values; on ties, the first.
    """

    domain: EnumerableDomain
    options: tuple[TabularOption, ...]

    def _best(self, state: Any) -> int:
        return int(self.solution.best[self.domain.index(state)])


def make_exact_plan(
    domain: EnumerableDomain,
    options: Sequence[Option | TabularOption],
    request: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> ExactPlan:
    """
    Plan with exact models; parameters and errors as in ``plan.make_plan``.

    :param options: learned options, or tables over all states.
    """
    resolved = request.resolved(domain, options, sampled=False)
    used = () if resolved.action_set == PRIMITIVE else tuple(options)
    # These tables are built once for all plans, so planning times exclude them.
    domain.transitions(), domain.over()
    if not all(isinstance(option, TabularOption) for option in used):
        domain.feature_table()
    began = clock()
    tabled = []
    for done, option in enumerate(used):
        progress('tables', done / len(used), 0, math.nan)
        tabled.append(tabulate(option, domain))
    evaluated = clock()
    model = build_model(domain, resolved.action_set, tabled, resolved.gamma, progress)
    modelled = clock()
    on_sweep = None
    if progress is not ignore_progress:  # ignored reports would slow small plans down by half
        on_sweep = sweep_progress(progress, resolved.tol, resolved.max_sweeps)
    solution = solve_smdp(model, resolved.tol, resolved.max_sweeps, on_sweep)
    return ExactPlan(
        domain=domain,
        action_set=resolved.action_set,
        gamma=resolved.gamma,
        options=tuple(tabled),
        names=model.names,
        first_fallback=len(tabled if resolved.action_set in OPTIONS_ONLY else model.names),
        solution=solution,
        table_seconds=evaluated - began,
        model_seconds=modelled - evaluated,
        sweep_seconds=clock() - modelled,
    )


def sweep_progress(report: Progress, tol: float, max_sweeps: int) -> OnSweep:
    """
    Return a callback that reports progress from the residual.

    The logarithm of the residual decreases roughly linearly.
    """
    first = fraction = 0.0

    def on_sweep(sweeps: int, residual: float) -> None:
        nonlocal first, fraction
        first, fraction = max(first, residual), max(fraction, sweeps / max_sweeps)
        if residual <= tol:
            fraction = 1.0
        elif tol > 0.0:
            fraction = max(fraction, math.log(first / residual) / math.log(first / tol))
        report('sweeps', fraction, sweeps, residual)

    return on_sweep


def build_model(
    domain: EnumerableDomain,
    action_set: str,
    options: Sequence[TabularOption],
    gamma: float,
    progress: Progress = ignore_progress,
) -> MultiTimeModel:
    """
    Return the exact model of an action set.

    It contains the options, followed by the primitive actions if the set needs them.

    :param options: ignored in the set ``primitive``.
    """
    names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
    if action_set == PRIMITIVE:
        return primitive_model(domain.transitions(), domain.over(), gamma, names)
    over, shape = domain.over(), (len(options), domain.n_states)
    reward, available = np.zeros(shape), np.empty(shape, dtype=np.bool_)
    lengths, rows = np.zeros(shape, dtype=np.int32), []
    for o, option in enumerate(options):
        progress('models', o / (1 + len(options)), 0, math.nan)
        starts = np.greater(option.initiation, over, out=available[o])
        found = model_option(domain.transitions(), over, gamma, option, starts)
        at = np.flatnonzero(starts)
        reward[o, at], lengths[o, at] = found.reward, np.diff(found.successor.indptr)
        rows.append(found.successor)
    parts = (
        np.concatenate([part.data for part in rows]),
        np.concatenate([part.indices for part in rows]),
        np.append(np.int32(0), np.cumsum(lengths, dtype=np.int32)),
    )
    joined = csr_array(parts, shape=(lengths.size, domain.n_states))
    model = MultiTimeModel(tuple(o.name for o in options), reward.T, available.T, joined)
    free = _primitive_states(domain, action_set, options)
    if free.any():
        primitives = primitive_model(domain.transitions(), ~free, gamma, names)
        model = concatenate([model, primitives])
    progress('models', 1.0, 0, math.nan)
    return model


def _primitive_states(
    domain: EnumerableDomain, action_set: str, options: Sequence[TabularOption]
) -> Flags:
    """
    Return (S,): whether primitive actions can be chosen in each state.

    In the sets ``human`` and ``automatic``, they can be chosen only where no option is available;
    if there is no such state, the set contains no primitive actions.
    """
    going = ~domain.over()
    if action_set not in OPTIONS_ONLY:
        return going
    free: Flags = going & ~np.any([option.initiation for option in options], axis=0)
    return free


def option_table(
    domain: EnumerableDomain, action_set: str, options: Sequence[TabularOption]
) -> OptionTable:
    """
    Return the options of an action set as a single table.

    :param options: ignored in the set ``primitive``.
    :raises PlanError: the set is unknown, or its options are missing or have equal names.
    """
    PlanRequest(action_set).resolved(domain, options, sampled=False)
    used = () if action_set == PRIMITIVE else tuple(options)
    free = _primitive_states(domain, action_set, used)
    primitives = [
        TabularOption(
            name=PRIMITIVE_PREFIX + action.name,
            max_steps=1,
            action=np.full(len(free), index),
            initiation=free,
            termination=np.ones_like(free),
        )
        for index, action in enumerate(domain.actions)
    ]
    return OptionTable([*used, *primitives] if free.any() else used, domain.over())


def episode_starts(
    domain: EnumerableDomain, seed: int, episodes: int, progress: Progress = ignore_progress
) -> NDArray[np.int32]:
    """
    Draw the start states of episodes, (E,) state indices.

    Each draw has its own generator, so start i does not depend on the number of episodes.

    :param progress: called with the stage evaluation, which begins here.
    """
    starts = np.empty(episodes, dtype=np.int32)
    for episode in range(episodes):
        progress('evaluation', 0.0, 0, math.nan)
        starts[episode] = domain.index(episode_start(domain, seed, episode))
    return starts


def episode_start(domain: Domain[S], seed: int, episode: int) -> S:
    """Draw the start state of one episode."""
    return domain.reset(generator(seed, 'episode_start', episode))


@dataclass(frozen=True)
class PlannedOptions(Policy[SeenStates]):
    """The policy of an exact plan: each option runs to its end."""

    best: NDArray[np.integer]  # (S,) index of the next option

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

    Each episode has its own generator, so episode i does not depend on the number of episodes.

    :param starts: (E,) state indices.
    :param seed: random seed of outcomes; unused if every action has a single outcome.
    :param max_steps: maximum number of steps per episode; 0: the domain's own limit.
    :param progress: called with the stage evaluation; its exceptions propagate.
    :raises PlanError: episodes have no step limit.
    """
    limit = max_steps or plan.domain.max_steps
    if limit < 1:
        raise PlanError(f'{plan.domain.name} has no step limit: give max_steps')
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
    on_step: Callable[[int, Execution[SeenStates], SeenStates, Games], object],
) -> Played:
    games = TableGames(plan.domain, starts.astype(np.intp))
    options = option_table(plan.domain, plan.action_set, plan.options)
    policy = PlannedOptions(plan.solution.best)
    return play(games, options, policy, chance, limit, gamma=plan.gamma, on_step=on_step)


@dataclass(frozen=True)
class Coverage:
    """Decision states of a plan that are not well served by its options."""

    fallback: Ints  # (N,) states where no option can start; most visited first
    single_step: Ints  # (M,) states where a primitive action is better; greatest gain first
    gain: Floats  # (M,) gain of each, in units of discounted return


def find_coverage(plan: ExactPlan, most: int = 20) -> Coverage:
    """
    Play one episode from each start state, and evaluate the states where decisions were made.

    The value of a primitive action is that of one step of look-ahead followed by the plan.

    :param plan: plan with options only.
    :param most: maximum number of states of each kind.
    :raises PlanError: the plan chooses among primitive actions, or the domain has no step limit.
    """
    domain = plan.domain
    if plan.first_fallback != len(plan.options) or not domain.max_steps or not plan.options:
        raise PlanError('coverage is found of plans with options only, where episodes end')
    starts = domain.start_states()
    starts = starts[:: -(-len(starts) // _STARTS)]
    visits = np.zeros(domain.n_states, dtype=np.intp)

    def count(step: int, execution: Execution[SeenStates], seen: SeenStates, _: Games) -> None:
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
