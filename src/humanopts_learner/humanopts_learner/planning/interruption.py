"""
Interruption and modules with exact values: continuation values, and the policies that use them.

Sutton, Precup and Singh (1999), section 4 and theorem 2: a policy over Markov options that stops
an option wherever going on is worth less than choosing anew, by the policy's own values, is worth
at least as much in every state. An option with ``max_steps`` is Markov only together with the
number of steps that it has left. Where no run is cut off this makes no difference. Where one may
be, going on counts as the best that it can be worth with any number of steps left, so a run is
stopped only where that is right whatever is left, and the theorem holds.
"""

from dataclasses import replace

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Transitions
from humanopts_learner.options.option import TabularOption
from humanopts_learner.planning.arbitration import interruptions, OptionValues, ROUNDING, winners
from humanopts_learner.planning.exact import build_model, ExactPlan
from humanopts_learner.planning.multi_time_models import look_ahead
from humanopts_learner.planning.option_models import option_modeller, visited
from humanopts_learner.planning.request import Execution, PlanError
import numpy as np
from scipy.sparse import eye_array
from scipy.sparse.linalg import splu


def option_values(plan: ExactPlan) -> OptionValues:
    """
    Return the values that arbitration decides by, for every state.

    An option's policy is defined in every state where the task is not over, so going on is
    modelled there; primitive actions are options of one step.
    """
    domain, values = plan.domain, plan.solution.values
    model = build_model(domain, plan.action_set, plan.options, plan.gamma)
    option_values = look_ahead(model, values)
    continuation_values = option_values.copy()
    for o, option in enumerate(plan.options):
        continuation_values[:, o] = _continuation_values(plan, option)
    continuation_values[domain.over()] = -np.inf
    return OptionValues(
        action_set=plan.action_set,
        names=model.names,
        states=np.arange(len(values)),
        option_values=option_values,
        continuation_values=continuation_values,
        interruption_margin=_interruption_margin(plan),
        sampled=False,
    )


def as_executed(plan: ExactPlan, execution: Execution) -> ExactPlan:
    """
    Return a plan that, with each option run to its end, acts as ``plan`` does by ``execution``.

    Interrupted options are those that end also where they are stopped; modules are options of one
    step that can start where they win. The values are still those of ``plan``; ``policy_values``
    returns those of the new one.
    """
    if execution is Execution.RUN_TO_END:
        return plan
    table = option_values(plan)
    values = table.option_values, table.continuation_values
    if execution is Execution.INTERRUPTED:
        stop = interruptions(*values, table.interruption_margin)
        ending = [
            replace(option, termination=option.termination | stop[:, o])
            for o, option in enumerate(plan.options)
        ]
        return replace(plan, options=tuple(ending))
    found = winners(execution, *values, action_table(plan))
    winner = np.where(plan.domain.over(), -1, found).astype(np.int32)
    modules = [
        replace(option, max_steps=1, initiation=winner == o)
        for o, option in enumerate(plan.options)
    ]
    return replace(plan, options=tuple(modules), solution=replace(plan.solution, best=winner))


def action_table(plan: ExactPlan) -> Ints:
    """Return (S, O): the action of each option of a plan in every state."""
    n_options, n_states = len(plan.options), plan.domain.n_states
    action = np.tile(np.arange(len(plan.names)) - n_options, (n_states, 1))
    for o, option in enumerate(plan.options):
        action[:, o] = option.action
    return action


def policy_values(plan: ExactPlan) -> Floats:
    """
    Return what a plan is worth in every state, (S,), each option run to its end.

    The solution of V = R + P V, with R and P the model of the option chosen in each state.

    :raises PlanError: gamma is 1 and the policy does not end from everywhere.
    """
    model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
    best = plan.solution.best
    live = np.flatnonzero(best >= 0)
    chosen = best[live]
    rows = model.rows[chosen * model.n_states + live][:, live]
    values = np.zeros(model.n_states)
    try:
        values[live] = splu((eye_array(len(live)) - rows).tocsc()).solve(
            model.reward[live, chosen]
        )
    except RuntimeError as error:
        raise PlanError(
            'the policy does not end from everywhere: evaluate it with a gamma below 1'
        ) from error
    return values


def _interruption_margin(plan: ExactPlan) -> float:
    """Return how far values can differ that would be equal had the sweeps gone on for ever."""
    solution = plan.solution
    rounding = ROUNDING * max(1.0, float(np.abs(solution.values).max()))
    left = max(1.0 - plan.gamma, ROUNDING)
    return rounding + 8.0 * solution.residual / left


def _continuation_values(plan: ExactPlan, option: TabularOption) -> Floats:
    """Return the value of running an option from each state, (S,), started there or not."""
    domain, values = plan.domain, plan.solution.values
    rules, over = domain.transitions(), domain.over()
    model = option_modeller(rules, over, plan.gamma).model(
        option.action, option.termination, option.max_steps
    )
    worth = model.values(values)
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
    Return the most that going on is worth with 1 to max_steps steps left, (n,).

    :param states: (n,) state indices; runs from these go on from no others.
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
