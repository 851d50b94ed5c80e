"""What the options of a plan do not cover: where a person can teach more (paper, section 8)."""

from dataclasses import dataclass

from humanopts_env.arrays import Floats, Ints
from humanopts_env.seeding import generator
from humanopts_learner.planning.evaluate import Episodes
from humanopts_learner.planning.exact import ExactPlan
from humanopts_learner.planning.request import PlanError
from humanopts_learner.planning.smdp import look_ahead, primitive_model
import numpy as np

_STARTS = 2_000  # that are played from at most
_ROUNDING = 1e-6  # in units of discounted return


@dataclass(frozen=True)
class Coverage:
    """States in which the plan comes to a decision that its options do not serve well."""

    fallback: Ints  # (N,) no option can start there; those that most starts lead to come first
    single_step: Ints  # (M,) a primitive action first is worth more; the greatest gain comes first
    gain: Floats  # (M,) of each, in units of discounted return


def find_coverage(plan: ExactPlan, most: int = 20) -> Coverage:
    """
    Play one episode from each start of the task, and look at the states of its decisions.

    What a primitive action is worth, with the plan from the next state on, follows from the values
    of the plan.

    :param plan: with options only.
    :param most: states of each kind.
    :raises PlanError: primitive actions are among its choices, or the domain never cuts an
        episode off.
    """
    domain = plan.domain
    if plan.first_fallback != len(plan.options) or not domain.max_steps or not plan.options:
        raise PlanError('coverage is found of plans with options only, where episodes end')
    starts = domain.start_states()
    starts = starts[:: -(-len(starts) // _STARTS)]
    visits = np.zeros(domain.n_states, dtype=np.intp)
    episodes = Episodes(plan, starts)
    for step in range(domain.max_steps):
        visits += np.bincount(episodes.decide(), minlength=domain.n_states)
        episodes.step(generator(0, 'coverage', step))
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
