"""Conversion between messages and the values of learning and planning."""

from array import array
from collections.abc import Sequence
import math
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Floats
from humanopts_interfaces import msg
from humanopts_interfaces.action import Plan
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import PlanError, PlanRequest
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_ros.codec import Codec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # slow to import, and terminals convert none of them
    from humanopts_learner.planning.evaluate import Coverage
    from humanopts_learner.planning.interruption import OptionValues
    from humanopts_learner.planning.plan import AnyPlan, Performance

_CRITERION = Codec(Criterion, msg.Criterion, of_value=['high'], computed=['measurable'])
_SUMMARY = Codec(
    OptionSummary,
    msg.OptionStatus,
    of_value=['gain'],
    computed=['criteria_met'],
    parts={'criteria': (_CRITERION.encode, _CRITERION.decode)},
)
# None is sent as NaN; confidence limits are not sent.
summary_to_message, summary_from_message = _SUMMARY.encode, _SUMMARY.decode
_DEMONSTRATION = Codec(
    Demonstration, msg.Demonstration, of_value=['features'], of_message=['features']
)


def demonstration_to_message(demo: Demonstration) -> msg.Demonstration:
    """Encode a demonstration; header, publisher_id and sequence are left to the publisher."""
    return _DEMONSTRATION.encode(demo, features=[value for row in demo.features for value in row])


def plan_goal_to_message(
    goal: Plan.Goal, plan_id: str, request: PlanRequest, options: Sequence[LearnedOption]
) -> msg.PlanGoal:
    """
    Encode the plan request that is in force.

    :param goal: of the action plan.
    :param request: in force.
    :param options: to plan with.
    """
    return msg.PlanGoal(
        plan_id=plan_id,
        action_set=request.action_set,
        participant=goal.participant,
        options=[option.name for option in options],
        gamma=request.gamma,
        tolerance=request.tol,
        max_sweeps=request.max_sweeps,
        game_steps=request.game_steps,
        evaluation_episodes=goal.evaluation_episodes,
        seed=request.seed,
    )


def refused_plan(action_set: str) -> msg.PlanResult:
    """Return a result without a plan; status and detail are left to the caller."""
    return msg.PlanResult(action_set=action_set, **_performance_fields(None))


def plan_to_message(
    plan: 'AnyPlan', plan_id: str, performance: 'Performance | None', coverage: 'Coverage | None'
) -> msg.PlanResult:
    """
    Encode the result of planning, with the returns of the plan's evaluation episodes.

    :param coverage: None: not known.
    """
    solution, result = plan.solution, msg.PlanResult
    return msg.PlanResult(
        status=result.STATUS_CONVERGED if solution.converged else result.STATUS_NOT_CONVERGED,
        detail='' if solution.converged else f'not converged after {solution.sweeps} sweeps',
        plan_id=plan_id,
        action_set=plan.action_set,
        option_names=list(plan.names),
        gamma=plan.gamma,
        n_states=len(solution.values),
        game_steps=plan.game_steps,
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=solution.sweeps,
        residual=solution.residual,
        converged=solution.converged,
        **_coverage_fields(plan, coverage),
        **_performance_fields(performance),
    )


def _coverage_fields(plan: 'AnyPlan', found: 'Coverage | None') -> dict[str, Any]:
    """Return the fields of ``PlanResult`` on what the options do not cover."""
    from humanopts_learner.planning.exact import ExactPlan

    if found is None or not isinstance(plan, ExactPlan):
        return {}
    encode, state_at = plan.domain.encode, plan.domain.state_at
    return {
        'coverage_known': True,
        'fallback_states': [encode(state_at(index)) for index in found.fallback.tolist()],
        'single_step_states': [encode(state_at(index)) for index in found.single_step.tolist()],
        'single_step_gains': found.gain.tolist(),
    }


def _performance_fields(found: 'Performance | None') -> dict[str, Any]:
    """Return the fields of ``PlanResult`` with the plan's returns."""
    if found is None:
        names = ('mean_return', 'mean_return_low', 'mean_return_high', 'mean_discounted_return')
        return dict.fromkeys(names, math.nan)
    outcomes = found.outcomes.values()
    return {
        'evaluation_episodes': found.episodes,
        'mean_return': found.total.mean,
        'mean_return_low': found.total.low,
        'mean_return_high': found.total.high,
        'mean_discounted_return': found.discounted.mean,
        'fallbacks': found.fallbacks,
        'outcome_names': list(found.outcomes),
        'outcome_means': [interval.mean for interval in outcomes],
        'outcome_low': [interval.low for interval in outcomes],
        'outcome_high': [interval.high for interval in outcomes],
    }


def option_values_to_message(
    values: 'OptionValues', plan_id: str, participant: str
) -> msg.OptionValues:
    """Encode the values for arbitration; arrays are sent as bytes, since they may be large."""

    def packed(code: str, table: NDArray[Any]) -> 'array[Any]':
        return array(code, np.ascontiguousarray(table).tobytes())

    return msg.OptionValues(
        plan_id=plan_id,
        participant=participant,
        action_set=values.action_set,
        names=list(values.names),
        states=packed('q', values.states),
        option_values=packed('d', values.option_values),
        continuation_values=packed('d', values.continuation_values),
        interruption_margin=values.interruption_margin,
        sampled=values.sampled,
    )


def option_values_from_message(message: msg.OptionValues) -> 'OptionValues':
    """
    Decode the values for arbitration.

    :raises PlanError: the parts contradict each other.
    """
    from humanopts_learner.planning.interruption import OptionValues

    states = np.asarray(message.states, dtype=np.int64)
    shape = len(states), len(message.names)

    def table(name: str) -> Floats:
        values = np.asarray(getattr(message, name), dtype=np.float64)
        if values.size != shape[0] * shape[1]:
            raise PlanError(f'{name} has {values.size} values, and not {shape}')
        return values.reshape(shape)

    return OptionValues(
        action_set=message.action_set,
        names=tuple(message.names),
        states=states,
        option_values=table('option_values'),
        continuation_values=table('continuation_values'),
        interruption_margin=float(message.interruption_margin),
        sampled=bool(message.sampled),
    )
