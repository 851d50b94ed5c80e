"""
Interruption and modules: choosing the option that acts in the next step, by the values of a plan.

A policy over options can be executed in four ways. All but the first are polling executions: they
decide again before each step, based on one table of option values, so the same table, states and
draws always give the same run. Sampled plans and live games use the same rules. This module
computes the values of exact plans, and the resulting policies.

Sutton, Precup and Singh (1999), section 4 and theorem 2: a policy over Markov options that stops
an option wherever continuing has a lower value than choosing again, by the policy's own values, is
at least as good in every state. An option with ``max_steps`` is Markov only together with the
number of remaining steps. This makes no difference if no run is cut off. Otherwise, the value of
continuing is the maximum over all numbers of remaining steps, so a run is stopped only if that is
right for every number, and the theorem holds.
"""

from dataclasses import dataclass, replace
import math

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Transitions
from humanopts_learner.options.learned_option import TabularOption
from humanopts_learner.planning.exact_plan import build_model, ExactPlan, option_table
from humanopts_learner.planning.models import look_ahead, model_option, visited
from humanopts_learner.planning.request import Arbitration, PlanError
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye

MAX_EXACT_STATES = 20_000  # number of states up to which the exact return is as fast as planning
ROUNDING = 1e-9  # tolerance for rounding errors, relative to the largest value


@dataclass(frozen=True)
class OptionValues:
    """
    The values of a plan for arbitration: K states, O options.

    States are indices in an enumerable domain, or codes of the abstract states of a sampled plan.
    Values are discounted returns; -inf: unavailable or unknown.

    :raises PlanError: the arrays are inconsistent.
    """

    action_set: str
    names: tuple[str, ...]  # (O,) options, then action:NAME
    states: NDArray[np.int64]  # (K,) ascending
    option_values: Floats  # (K, O) value of choosing the option now
    continuation_values: Floats  # (K, O) value of continuing it, even where it cannot start
    interruption_margin: float  # differences up to this are ignored
    sampled: bool  # states are abstract states
    columns: tuple[str, ...] = ()  # feature columns of abstract states, as in ``Abstraction``

    def __post_init__(self) -> None:
        shape = len(self.states), len(self.names)
        if self.option_values.shape != shape or self.continuation_values.shape != shape:
            raise PlanError(
                f'values are {self.option_values.shape} and {self.continuation_values.shape}, '
                f'not {shape}'
            )
        if (self.states[1:] <= self.states[:-1]).any():  # a difference could overflow
            raise PlanError('the states do not ascend')
        for values in (self.option_values, self.continuation_values):
            if np.isnan(values).any() or (values == np.inf).any():
                raise PlanError('a value is NaN or infinite')
        if not 0.0 <= self.interruption_margin < np.inf:
            raise PlanError(
                f'interruption_margin is {self.interruption_margin}, but must be 0 or greater'
            )


def interruptions(
    option_values: Floats, continuation_values: Floats, interruption_margin: float
) -> Flags:
    """
    Return (N, O): whether each running option is stopped, because choosing again is worth more.

    :param option_values: (N, O); -inf: the option cannot be chosen.
    :param continuation_values: (N, O); an option with value -inf is not stopped.
    """
    best = option_values.max(axis=1, keepdims=True)
    worse = continuation_values < best - interruption_margin
    stopped: Flags = np.isfinite(continuation_values) & worse
    return stopped


def arbitrate(
    execution: Arbitration,
    option_values: Floats,
    continuation_values: Floats,
    action: NDArray[np.signedinteger],
) -> Ints:
    """
    Arbitrate between modules: return (N,) the index of the option that acts.

    By greatest mass, it is the strongest module with an action of the greatest mass.
    Ties between masses are broken by the strongest module, and between modules by lowest index.

    :param execution: one of ``MODULAR``.
    :param option_values: (N, O); modules with value -inf have no strength.
    :param continuation_values: (N, O).
    :param action: (N, O) action preferred by each module.
    """
    if execution is Arbitration.MODULAR_STRONGEST:
        strongest: Ints = continuation_values.argmax(axis=1)
        return strongest
    finite = np.isfinite(option_values)
    weakest = np.where(finite, option_values, np.inf).min(axis=1, keepdims=True)
    strength = np.subtract(option_values, weakest, out=np.zeros(option_values.shape), where=finite)
    wants = action[:, :, None] == np.arange(action.max(initial=0) + 1)  # (N, O, A)
    mass = (strength[:, :, None] * wants).sum(axis=1)
    wins = np.take_along_axis(mass, action, axis=1) >= mass.max(axis=1, keepdims=True)
    option: Ints = np.where(wins, option_values, -np.inf).argmax(axis=1)
    return option


def option_values(plan: ExactPlan) -> OptionValues:
    """
    Return the values for arbitration, for every state.

    An option's policy is defined in every state where the task is not over, so continuing is
    modelled in all of them; primitive actions are one-step options.
    """
    domain, values = plan.domain, plan.solution.values
    model = build_model(domain, plan.action_set, plan.options, plan.gamma)
    option_values = look_ahead(model, values)
    continuation_values = option_values.copy()
    for o, option in enumerate(plan.options):
        continuation_values[:, o] = _continuation_values(plan, option)
    continuation_values[domain.over()] = -np.inf
    # Maximum difference of values that would be equal after infinitely many sweeps.
    rounding = ROUNDING * max(1.0, float(np.abs(values).max()))
    margin = rounding + 8.0 * plan.solution.residual / max(1.0 - plan.gamma, ROUNDING)
    return OptionValues(
        action_set=plan.action_set,
        names=model.names,
        states=np.arange(len(values)),
        option_values=option_values,
        continuation_values=continuation_values,
        interruption_margin=margin,
        sampled=False,
    )


def as_executed(plan: ExactPlan, execution: Arbitration) -> ExactPlan:
    """
    Return a plan that runs each option to its end and acts like ``plan`` under ``execution``.

    Interrupted options also end where they are stopped; modules become one-step options that can
    start where they win. The values are still those of ``plan``; use ``policy_values`` for those
    of the new plan.
    """
    if execution is Arbitration.RUN_TO_END:
        return plan
    table = option_values(plan)
    values = table.option_values, table.continuation_values
    if execution is Arbitration.INTERRUPTED:
        stop = interruptions(*values, table.interruption_margin)
        ending = [
            replace(option, termination=option.termination | stop[:, o])
            for o, option in enumerate(plan.options)
        ]
        return replace(plan, options=tuple(ending))
    action = option_table(plan.domain, plan.action_set, plan.options).action
    found = arbitrate(execution, *values, action[: len(plan.names)].T)
    winner = np.where(plan.domain.over(), -1, found).astype(np.int32)
    modules = [
        replace(option, max_steps=1, initiation=winner == o)
        for o, option in enumerate(plan.options)
    ]
    return replace(plan, options=tuple(modules), solution=replace(plan.solution, best=winner))


def policy_values(plan: ExactPlan) -> Floats:
    """
    Return the value of a plan in every state, (S,), running each option to its end.

    The values solve V = R + P V, with R and P the model of the option chosen in each state.

    :raises PlanError: gamma is 1 and the policy does not terminate from every state.
    """
    from scipy.sparse.linalg import splu  # slow to import

    model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
    best = plan.solution.best
    live = np.flatnonzero(best >= 0)
    chosen = best[live]
    rows = model.rows[chosen * model.n_states + live][:, live]
    values = np.zeros(model.n_states)
    try:
        values[live] = splu((csr_array(eye(len(live))) - rows).tocsc()).solve(
            model.reward[live, chosen]
        )
    except RuntimeError as error:
        raise PlanError(
            'the policy does not end from everywhere: evaluate it with a gamma below 1'
        ) from error
    return values


def exact_mean_return(plan: ExactPlan) -> float | None:
    """
    Return the expected undiscounted return of an episode: the mean over all start states.

    :return: None: the policy does not terminate from every state, or there are more than
        ``MAX_EXACT_STATES`` states.
    """
    if plan.domain.n_states > MAX_EXACT_STATES:
        return None
    try:
        values = policy_values(replace(plan, gamma=1.0))
    except PlanError:
        return None
    mean = float(values[plan.domain.start_states()].mean())
    return mean if math.isfinite(mean) else None


def _continuation_values(plan: ExactPlan, option: TabularOption) -> Floats:
    """Return the value (S,) of running an option from each state, even outside I."""
    domain, values = plan.domain, plan.solution.values
    rules, over = domain.transitions(), domain.over()
    model = model_option(rules, over, plan.gamma, option, np.ones_like(over))
    worth = np.asarray(model.reward + model.successor @ values)
    late = model.cut_off & option.initiation & ~over
    if late.any():
        ends = option.termination | over
        states = visited(rules, option.action, ends, late)
        worth[states] = _best_of_any_steps(rules, option, ends, states, values, plan.gamma)
    return worth


def _best_of_any_steps(
    rules: Transitions,
    option: TabularOption,
    ends: Flags,
    states: Ints,
    values: Floats,
    gamma: float,
) -> Floats:
    """
    Return the highest value (n,) of continuing with 1 to max_steps remaining steps.

    :param states: (n,) state indices; runs from these never continue from others.
    """
    at = states, option.action[states]
    after, share = rules.successor[at], gamma * rules.probability[at]
    share[rules.terminated[at]] = 0.0
    last = ends[after]
    fixed = (rules.probability[at] * rules.reward[at]).sum(axis=1)
    fixed += (share * last * values[after]).sum(axis=1)
    onward = share * ~last
    worth, best = values.copy(), np.full(len(states), -np.inf)
    for _ in range(option.max_steps):
        worth[states] = fixed + (onward * worth[after]).sum(axis=1)
        np.maximum(best, worth[states], out=best)
    return best
