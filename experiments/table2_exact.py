"""Table 2 where models are exact: no parameters to search, and every start state is played."""

from collections.abc import Sequence
from dataclasses import replace
import time
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.options.option import LearnedOption, option_tables
from humanopts_learner.planning.action_sets import TabledOption
from humanopts_learner.planning.any_domain import MAX_SWEEPS
from humanopts_learner.planning.evaluate import play
from humanopts_learner.planning.interruption import as_executed, policy_values
from humanopts_learner.planning.plan import Plan, plan_with_tables
import numpy as np

from experiments.table2_kinds import Kind, OTHER_WAYS
from experiments.table2_record import record, SECONDS

CLOCK = time.process_time
REPEATS = 7  # makings of one plan, for its seconds
Options = Sequence[LearnedOption | TabledOption]


def plan_exactly(
    domain: EnumerableDomain[Any], asked: Sequence[tuple[Kind, Options]], plans: int
) -> dict[str, Any]:
    """
    Plan with each kind, and its options.

    :param plans: how often the same plan is made, for its seconds.
    :return: by kind a curve (an entry for each number of sweeps, doubled until converged) and
        the plans; and what each other way to carry out the human plan gains, by state.
    """
    domain.feature_table()  # built once for all plans, so no part of their time
    _made(domain, *asked[0])  # what is loaded by the first plan is no part of it either
    return {
        'kinds': {
            kind.name: {
                'curve': _curve(domain, kind, options),
                'plans': [
                    _judged(MAX_SWEEPS, *_timed(domain, kind, options)) for _ in range(plans)
                ],
                'tried': [],
                'chosen': None,
            }
            for kind, options in asked
        },
        'gains': {
            kind.name: _gain(domain, kind, options)
            for kind, options in asked
            if kind in OTHER_WAYS
        },
    }


def _timed(
    domain: EnumerableDomain[Any], kind: Kind, options: Options, max_sweeps: int = MAX_SWEEPS
) -> tuple[Plan, Plan]:
    """Make a plan some times, since it takes hardly any; return that of the median seconds."""
    made = [_made(domain, kind, options, max_sweeps) for _ in range(REPEATS)]
    return sorted(made, key=lambda pair: _seconds(pair[0]))[REPEATS // 2]


def _seconds(plan: Plan) -> float:
    return float(sum(getattr(plan, name) for name in SECONDS))


def _made(
    domain: EnumerableDomain[Any],
    kind: Kind,
    options: Options,
    max_sweeps: int = MAX_SWEEPS,
) -> tuple[Plan, Plan]:
    """Return a plan, with all its seconds, and what carries it out."""
    began = CLOCK()
    tabled = [_tabled(option, domain) for option in options]
    limits: Any = {'max_sweeps': max_sweeps, 'clock': CLOCK, 'table_seconds': CLOCK() - began}
    plan = plan_with_tables(domain, kind.action_set, tabled, domain.gamma, **limits)
    began = CLOCK()
    carrying = as_executed(plan, kind.execution)
    return replace(plan, model_seconds=plan.model_seconds + CLOCK() - began), carrying


def _tabled(option: LearnedOption | TabledOption, domain: EnumerableDomain[Any]) -> TabledOption:
    if isinstance(option, TabledOption):
        return option
    return TabledOption(option.name, option.max_steps, option_tables(option, domain))


def _judged(budget: int, plan: Plan, carrying: Plan) -> dict[str, Any]:
    """Play from every start state, once."""
    returns = play(carrying, plan.domain.start_states())
    return record(budget, plan, returns, returns.successes)


def _curve(domain: EnumerableDomain[Any], kind: Kind, options: Options) -> list[dict[str, Any]]:
    """Judge plans of 1, 2, 4 ... sweeps, each made from scratch, until one has converged."""
    found: list[dict[str, Any]] = []
    converged, sweeps = False, 1
    while not converged and sweeps <= MAX_SWEEPS:
        plan, carrying = _timed(domain, kind, options, sweeps)
        found.append(_judged(sweeps, plan, carrying))
        converged, sweeps = plan.solution.converged, 2 * sweeps
    return found


def _gain(domain: EnumerableDomain[Any], kind: Kind, options: Options) -> dict[str, float]:
    """Return by how much a way to carry a plan out is worth more than running to the end."""
    plan, carrying = _made(domain, kind, options)
    more = policy_values(carrying) - policy_values(plan)
    return {'least': float(more.min()), 'most': float(more.max()), 'mean': float(np.mean(more))}
