"""Conversion between messages and Python values for learning and planning."""

from array import array
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Floats
from humanopts_interfaces import msg
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.intervals import Interval
from humanopts_learner.planning.request import PlanError
from humanopts_learner.summary import Criterion, OptionSummary, PlanSummary
from humanopts_ros.codec import Codec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # slow to import, and not needed by terminals
    from humanopts_learner.planning.exact_plan import Coverage
    from humanopts_learner.planning.interruption import OptionValues
    from humanopts_learner.planning.plan import AnyPlan, Performance
    from humanopts_learner.planning.stuck import Trial

_CRITERION = Codec(Criterion, msg.Criterion, computed=['measurable'])
_SUMMARY = Codec(
    OptionSummary,
    msg.OptionStatus,
    of_value=['gain'],
    computed=['criteria_met', 'learned', 'status'],
    parts={'criteria': (_CRITERION.encode, _CRITERION.decode)},
)
# None is sent as NaN; ``gain`` is omitted.
summary_to_message, summary_from_message = _SUMMARY.encode, _SUMMARY.decode
_DEMONSTRATION = Codec(
    Demonstration, msg.Demonstration, of_value=['features'], of_message=['features']
)

PLAN_RESULT = Codec(
    PlanSummary,
    msg.PlanResult,
    of_value=['outcomes'],
    of_message=[
        *('status', 'detail', 'plan_id'),
        *('coverage_known', 'fallback_states', 'single_step_states', 'single_step_gains'),
        *('participant', 'trial_games', 'stuck_options', 'stuck_states'),
        *('missing_options', 'missing_states', 'missing_samples'),
        *('outcome_names', 'outcome_means', 'outcome_low', 'outcome_high'),
    ],
)


def demonstration_to_message(demo: Demonstration) -> msg.Demonstration:
    """Encode a demonstration; the publisher fills header, publisher_id and sequence."""
    return _DEMONSTRATION.encode(demo, features=[value for row in demo.features for value in row])


def plan_to_message(
    plan: 'AnyPlan',
    plan_id: str,
    participant: str,
    performance: 'Performance | None',
    coverage: 'Coverage | None',
    trial: 'Trial',
) -> msg.PlanResult:
    """
    Encode the result of planning, with the returns of the evaluation episodes.

    :param coverage: coverage of the plan; None: unknown.
    :param trial: places where the plan got stuck.
    """
    from humanopts_learner.planning.exact_plan import ExactPlan
    from humanopts_learner.planning.plan import summarise_plan
    from humanopts_learner.planning.recorded_plan import RecordedPlan

    summary, result = summarise_plan(plan, performance), msg.PlanResult
    found = PLAN_RESULT.encode(
        summary,
        status=result.STATUS_CONVERGED if summary.converged else result.STATUS_NOT_CONVERGED,
        detail='' if summary.converged else f'not converged after {summary.sweeps} sweeps',
        plan_id=plan_id,
        participant=participant,
        trial_games=trial.games,
        stuck_options=list(trial.options),
        stuck_states=list(trial.states),
        outcome_names=list(summary.outcomes),
        outcome_means=[each.mean for each in summary.outcomes.values()],
        outcome_low=[each.low for each in summary.outcomes.values()],
        outcome_high=[each.high for each in summary.outcomes.values()],
    )
    if isinstance(plan, RecordedPlan):
        found.missing_options = [each.option for each in plan.missing]
        found.missing_states = [each.state for each in plan.missing]
        found.missing_samples = [each.samples for each in plan.missing]
    if coverage is not None and isinstance(plan, ExactPlan):
        states = [
            [plan.domain.encode(plan.domain.state_at(index)) for index in indices.tolist()]
            for indices in (coverage.fallback, coverage.single_step)
        ]
        found.coverage_known, found.single_step_gains = True, coverage.gain.tolist()
        found.fallback_states, found.single_step_states = states
    return found


def plan_from_message(message: msg.PlanResult) -> PlanSummary:
    """Decode the summary of a plan."""
    parts = message.outcome_means, message.outcome_low, message.outcome_high
    intervals = [Interval(*each) for each in zip(*parts, strict=True)]
    return PLAN_RESULT.decode(
        message, outcomes=dict(zip(message.outcome_names, intervals, strict=True))
    )


def option_values_to_message(
    values: 'OptionValues', plan_id: str, participant: str
) -> msg.OptionValues:
    """Encode the values for arbitration; arrays are sent as bytes, because they may be large."""

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
        columns=list(values.columns),
    )


def option_values_from_message(message: msg.OptionValues) -> 'OptionValues':
    """
    Decode the values for arbitration.

    :raises PlanError: the message is inconsistent.
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
        columns=tuple(message.columns),
    )
