"""What planning with an action set cost and brought."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from humanopts_learner.planning.evaluate import play
from humanopts_learner.planning.plan import Plan
from humanopts_teach.evaluation.options_block import finite
import numpy as np
from numpy.typing import NDArray


class PlanNumbers(Protocol):
    """What a PlanResult message says of a plan."""

    action_set: str
    gamma: float
    table_seconds: float
    model_seconds: float
    sweep_seconds: float
    sweeps: int
    residual: float
    converged: bool
    mean_return: float
    mean_discounted_return: float


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

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        return asdict(self)


def row_of_result(result: PlanNumbers) -> PlanningRow:
    """Return the row of a plan that was made elsewhere."""
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
    )


def row_of_plan(plan: Plan, starts: NDArray[np.integer], seed: int) -> PlanningRow:
    """
    Return the row of a plan, played from start states.

    :param starts: (E,) state indices; none: the returns are not measured.
    :param seed: of the chance in the game.
    """
    returns = play(plan, starts, seed=seed) if len(starts) else None
    return PlanningRow(
        action_set=plan.action_set,
        gamma=plan.gamma,
        table_seconds=plan.table_seconds,
        model_seconds=plan.model_seconds,
        sweep_seconds=plan.sweep_seconds,
        sweeps=plan.solution.sweeps,
        residual=plan.solution.residual,
        converged=plan.solution.converged,
        mean_return=None if returns is None else float(returns.total.mean()),
        mean_discounted_return=None if returns is None else float(returns.discounted.mean()),
    )
