"""Messages to learning and planning values and back: the one module here that knows both."""

from dataclasses import asdict
import math

from humanopts_interfaces import msg
from humanopts_learner.demonstrations import Demonstration, KIND_NUMBERS
from humanopts_learner.execution import End
from humanopts_learner.options.criteria import Judgement
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.plan import Plan


def demonstration_to_message(demo: Demonstration) -> msg.Demonstration:
    """Encode a demonstration; header, publisher_id and sequence are left to the publisher."""
    return msg.Demonstration(
        kind=KIND_NUMBERS[demo.kind],
        uuid=demo.uuid,
        domain=demo.domain,
        domain_parameters=demo.domain_parameters,
        participant=demo.participant,
        session=demo.session,
        option_name=demo.option_name,
        number=demo.number,
        chosen_features=list(demo.chosen_features),
        feature_names=list(demo.feature_names),
        features=[value for row in demo.features for value in row],
        states=list(demo.states),
        actions=list(demo.actions),
        rewards=list(demo.rewards),
        terminated=demo.terminated,
        can_start_at_end=demo.can_start_at_end,
        seconds=demo.seconds,
    )


def status_to_message(option: LearnedOption, judgement: Judgement) -> msg.OptionStatus:
    """Say how far an option is learned."""
    return msg.OptionStatus(
        option_name=option.name,
        participant=option.participant,
        features=list(option.features),
        n_demonstrations=option.n_demonstrations,
        n_not_here=option.n_not_here,
        last_uuid=option.uuids[-1],
        criteria=[
            msg.Criterion(
                name=criterion.name,
                value=math.nan if criterion.value is None else criterion.value,
                threshold=criterion.threshold,
                measurable=criterion.measurable,
                met=criterion.met,
            )
            for criterion in judgement.criteria
        ],
        criteria_met=judgement.criteria_met,
        mean_return_demonstrations=judgement.mean_return_demonstrations,
        mean_return_policy=judgement.mean_return_policy,
        more_needed=judgement.more_needed,
        conflicts=list(judgement.conflicts),
        suggested_feature=judgement.suggested_feature or '',
    )


def not_learnable_status(demos: list[Demonstration]) -> msg.OptionStatus:
    """Say that there are only "not here" answers so far."""
    newest = demos[-1]
    return msg.OptionStatus(
        option_name=newest.option_name,
        participant=newest.participant,
        features=list(newest.chosen_features),
        n_not_here=len(demos),
        last_uuid=newest.uuid,
        mean_return_demonstrations=math.nan,
        mean_return_policy=math.nan,
        more_needed=-1,
    )


def plan_to_message(plan: Plan, plan_id: str, returns: Returns | None) -> msg.PlanResult:
    """Say what planning came to, and how the plan did in the episodes it was judged by."""
    solution, result = plan.solution, msg.PlanResult
    return msg.PlanResult(
        status=result.STATUS_CONVERGED if solution.converged else result.STATUS_NOT_CONVERGED,
        detail='' if solution.converged else f'not converged after {solution.sweeps} sweeps',
        plan_id=plan_id,
        action_set=plan.action_set,
        option_names=list(plan.names),
        gamma=plan.gamma,
        n_states=len(solution.values),
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=solution.sweeps,
        residual=solution.residual,
        converged=solution.converged,
        evaluation_episodes=0 if returns is None else len(returns.total),
        mean_return=math.nan if returns is None else float(returns.total.mean()),
        mean_discounted_return=math.nan if returns is None else float(returns.discounted.mean()),
    )


def end_to_message(end: End, run_id: str) -> msg.OptionResult:
    """Say how a run ended; ``run_id`` is empty for a refusal."""
    values = {**asdict(end), 'status': int(end.status)}
    return msg.OptionResult(run_id=run_id, **values)
