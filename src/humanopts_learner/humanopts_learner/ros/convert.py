"""Conversion between messages and the values of learning and planning."""

from array import array
from collections.abc import Sequence
from dataclasses import asdict, fields
import math
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Floats
from humanopts_interfaces import msg
from humanopts_interfaces.action import Plan
from humanopts_learner.demonstrations import Demonstration, KIND_NUMBERS
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import PlanError, PlanRequest
from humanopts_learner.summary import Criterion, OptionSummary
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # slow to import, and terminals convert none of them
    from humanopts_learner.execution import RunResult
    from humanopts_learner.planning.evaluate import Coverage
    from humanopts_learner.planning.interruption import OptionValues
    from humanopts_learner.planning.plan import AnyPlan, Performance


def demonstration_to_message(demo: Demonstration) -> msg.Demonstration:
    """Encode a demonstration; header, publisher_id and sequence are left to the publisher."""
    values = {field.name: getattr(demo, field.name) for field in fields(demo)}
    values |= {name: list(each) for name, each in values.items() if isinstance(each, tuple)}
    values['kind'] = KIND_NUMBERS[demo.kind]
    values['features'] = [value for row in demo.features for value in row]
    return msg.Demonstration(**values)


def summary_to_message(summary: OptionSummary) -> msg.OptionStatus:
    """Encode how far an option is learned; None is sent as NaN."""
    values = {f.name: getattr(summary, f.name) for f in fields(summary) if f.name != 'gain'}
    values |= {name: list(each) for name, each in values.items() if isinstance(each, tuple)}
    values['criteria'] = [
        msg.Criterion(
            name=criterion.name,
            value=math.nan if criterion.value is None else criterion.value,
            threshold=math.nan if criterion.threshold is None else criterion.threshold,
            measurable=criterion.measurable,
            met=criterion.met,
            no_range=criterion.no_range,
        )
        for criterion in summary.criteria
    ]
    return msg.OptionStatus(criteria_met=summary.criteria_met, **values)


def summary_from_message(message: msg.OptionStatus) -> OptionSummary:
    """Decode how far an option is learned; confidence limits are not sent."""
    names = {f.name for f in fields(OptionSummary)} - {'gain', 'criteria'}
    values = {name: getattr(message, name) for name in names}
    values |= {name: tuple(each) for name, each in values.items() if isinstance(each, list)}
    criteria = tuple(
        Criterion(
            found.name,
            found.value if found.measurable else None,
            None if math.isnan(found.threshold) else found.threshold,
            found.met,
            no_range=found.no_range,
        )
        for found in message.criteria
    )
    return OptionSummary(criteria=criteria, **values)


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


def end_to_message(end: 'RunResult', run_id: str, execution: str = '') -> msg.OptionResult:
    """
    Encode how a run ended.

    :param run_id: empty for a refusal.
    :param execution: in force at the end; empty for a refusal.
    """
    values = {**asdict(end), 'status': int(end.status)}
    acted = values.pop('acted')
    return msg.OptionResult(
        run_id=run_id,
        execution=execution,
        acted_names=list(acted),
        acted_steps=list(acted.values()),
        **values,
    )
