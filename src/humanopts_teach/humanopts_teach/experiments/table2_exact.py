"""Table 2 where models are exact: no parameters to search, and every start state is played."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
import time
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.options.option import LearnedOption, option_tables
from humanopts_learner.planning.any_domain import MAX_SWEEPS
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.continuation import carried_out, policy_values
from humanopts_learner.planning.evaluate import play
from humanopts_learner.planning.plan import Plan, plan_with_tables, TabledOption
from humanopts_teach.experiments.table2_kinds import Kind, OTHER_WAYS
import numpy as np

CLOCK = time.process_time


def plan_exactly(
    domain: EnumerableDomain[Any],
    kinds: Sequence[Kind],
    options: Sequence[LearnedOption | TabledOption],
    plans: int,
) -> dict[str, Any]:
    """
    Plan with each kind.

    :param options: all of the same owner.
    :param plans: how often the same plan is made, for its seconds.
    :return: by kind a curve (an entry for each number of sweeps, doubled until converged) and
        the plans; and what each other way to carry out the human plan gains, by state.
    """
    domain.feature_table()  # built once for all plans, so no part of their time
    _made(domain, kinds[0], options)  # what is loaded by the first plan is no part of it either
    return {
        'kinds': {
            kind.name: {
                'curve': _curve(domain, kind, options),
                'plans': [_judged(*_made(domain, kind, options)) for _ in range(plans)],
                'tried': [],
                'chosen': None,
            }
            for kind in kinds
        },
        'gains': {
            kind.name: _gain(domain, kind, options) for kind in kinds if kind in OTHER_WAYS
        },
    }


def _made(
    domain: EnumerableDomain[Any],
    kind: Kind,
    options: Sequence[LearnedOption | TabledOption],
    max_sweeps: int = MAX_SWEEPS,
) -> tuple[Plan, Plan]:
    """Return a plan, with all its seconds, and what carries it out."""
    began = CLOCK()
    tabled = [_tabled(option, domain) for option in options]
    seconds = CLOCK() - began
    gamma = domain.gamma
    plan = plan_with_tables(
        domain,
        kind.action_set,
        tabled,
        gamma,
        max_sweeps=max_sweeps,
        clock=CLOCK,
        table_seconds=seconds,
    )
    began = CLOCK()
    carrying = carried_out(plan, kind.execution)
    return replace(plan, model_seconds=plan.model_seconds + CLOCK() - began), carrying


def _tabled(option: LearnedOption | TabledOption, domain: EnumerableDomain[Any]) -> TabledOption:
    if isinstance(option, TabledOption):
        return option
    return TabledOption(option.name, option.max_steps, option_tables(option, domain))


def _judged(plan: Plan, carrying: Plan) -> dict[str, Any]:
    """Play from every start state, once."""
    returns = play(carrying, plan.domain.start_states())
    return {
        'table_seconds': plan.table_seconds,
        'model_seconds': plan.model_seconds,
        'sweep_seconds': plan.sweep_seconds,
        'sweeps': plan.solution.sweeps,
        'states': len(plan.solution.values),
        'game_steps': 0,
        'mean': float(returns.total.mean()),
        'discounted': float(returns.discounted.mean()),
        'done': float(returns.successes.mean()),
        'fallbacks': float(returns.fallbacks.mean()),
        'games': len(returns.total),
    }


def _curve(
    domain: EnumerableDomain[Any], kind: Kind, options: Sequence[LearnedOption | TabledOption]
) -> list[dict[str, Any]]:
    """Judge plans of 1, 2, 4 ... sweeps, each made from scratch, until one has converged."""
    found = []
    for power in count():
        plan, carrying = _made(domain, kind, options, 2**power)
        found.append({'budget': 2**power, **_judged(plan, carrying)})
        if plan.solution.converged or 2**power >= MAX_SWEEPS:
            return found
    raise AssertionError('not reached')


def _gain(
    domain: EnumerableDomain[Any], kind: Kind, options: Sequence[LearnedOption | TabledOption]
) -> dict[str, float]:
    """Return by how much a way to carry a plan out is worth more than running to the end."""
    plan, carrying = _made(domain, kind, options)
    assert kind.execution is not Execution.RUN_TO_END
    more = policy_values(carrying) - policy_values(plan)
    return {'least': float(more.min()), 'most': float(more.max()), 'mean': float(np.mean(more))}
