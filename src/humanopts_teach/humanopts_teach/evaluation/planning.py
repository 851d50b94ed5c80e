"""What planning with an action set cost and brought."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Protocol

from humanopts_learner.planning.any_domain import AnyPlan, Performance
from humanopts_teach.evaluation.options_block import finite


class PlanNumbers(Protocol):
    """What a PlanResult message says of a plan."""

    action_set: str
    gamma: float
    game_steps: int
    table_seconds: float
    model_seconds: float
    sweep_seconds: float
    sweeps: int
    residual: float
    converged: bool
    evaluation_episodes: int
    mean_return: float
    mean_return_low: float
    mean_return_high: float
    mean_discounted_return: float
    fallbacks: int
    outcome_names: Sequence[str]
    outcome_means: Sequence[float]
    outcome_low: Sequence[float]
    outcome_high: Sequence[float]


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval; None where one episode gives none."""

    mean: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class PlanningRow:
    """One entry of ``planning`` in summary.json; None where it was not measured."""

    action_set: str
    gamma: float
    table_seconds: float
    model_seconds: float
    sweep_seconds: float
    sweeps: int
    residual: float  # reward units
    converged: bool
    mean_return: float | None  # undiscounted
    mean_discounted_return: float | None
    game_steps: int = 0  # that models were sampled from; 0: models are exact
    episodes: int = 0  # that the plan was judged by
    mean_return_low: float | None = None  # 95 % interval
    mean_return_high: float | None = None
    fallbacks: int | None = None  # in all these episodes
    outcomes: Mapping[str, Estimate] = field(default_factory=dict)  # what else the games tell

    @property
    def seconds(self) -> float:
        """What planning took, all counted."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        return asdict(self)


def row_of_result(result: PlanNumbers) -> PlanningRow:
    """Return the row of a plan that was made and judged elsewhere."""
    bounds = zip(
        result.outcome_names, result.outcome_means, result.outcome_low, result.outcome_high
    )
    return PlanningRow(
        action_set=str(result.action_set),
        gamma=float(result.gamma),
        table_seconds=float(result.table_seconds),
        model_seconds=float(result.model_seconds),
        sweep_seconds=float(result.sweep_seconds),
        sweeps=int(result.sweeps),
        residual=float(result.residual),
        converged=bool(result.converged),
        mean_return=finite(result.mean_return),
        mean_discounted_return=finite(result.mean_discounted_return),
        game_steps=int(result.game_steps),
        episodes=int(result.evaluation_episodes),
        mean_return_low=finite(result.mean_return_low),
        mean_return_high=finite(result.mean_return_high),
        fallbacks=int(result.fallbacks) if result.evaluation_episodes else None,
        outcomes={
            str(name): Estimate(float(mean), finite(low), finite(high))
            for name, mean, low, high in bounds
        },
    )


def row_of_plan(plan: AnyPlan, performance: Performance) -> PlanningRow:
    """Return the row of a plan and how it did."""
    outcomes = performance.outcomes.items()
    return PlanningRow(
        action_set=plan.action_set,
        gamma=plan.gamma,
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=plan.solution.sweeps,
        residual=plan.solution.residual,
        converged=plan.solution.converged,
        mean_return=performance.total.mean,
        mean_discounted_return=performance.discounted.mean,
        game_steps=plan.game_steps,
        episodes=performance.episodes,
        mean_return_low=finite(performance.total.low),
        mean_return_high=finite(performance.total.high),
        fallbacks=performance.fallbacks,
        outcomes={name: Estimate(i.mean, finite(i.low), finite(i.high)) for name, i in outcomes},
    )


def plan_differences(live: Sequence[PlanningRow], offline: Sequence[PlanningRow]) -> list[str]:
    """Return in words where plans differ, seconds apart; empty where they are equal exactly."""
    here = {row.action_set: row for row in offline}
    found = []
    for row in live:
        other = here.get(row.action_set)
        if other is None:
            found.append(f'the plan with {row.action_set} actions cannot be made from the bag')
            continue
        for part in fields(PlanningRow):
            a, b = getattr(row, part.name), getattr(other, part.name)
            if a != b and not part.name.endswith('_seconds'):
                found.append(
                    f'{part.name} of the {row.action_set} plan was {a!r} live and is {b!r} offline'
                )
    return found
