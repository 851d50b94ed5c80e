"""What is kept of one plan of Table 2 and the games that it was judged in."""

from typing import Any

from humanopts_learner.planning.any_domain import AnyPlan
from humanopts_learner.planning.evaluate import Returns
from numpy.typing import NDArray

SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds')


def record(
    budget: int, plan: AnyPlan, returns: Returns | Returns, done: NDArray[Any]
) -> dict[str, Any]:
    """
    Return seconds, sizes and means as JSON data.

    :param budget: sweeps at most, or game steps.
    :param done: (E,) which games did what there is to do.
    """
    return {
        'budget': budget,
        **{name: getattr(plan, name) for name in SECONDS},
        'sweeps': plan.solution.sweeps,
        'states': len(plan.solution.values),
        'game_steps': plan.game_steps,
        'mean': float(returns.total.mean()),
        'discounted': float(returns.discounted.mean()),
        'done': float(done.mean()),
        'fallbacks': float(returns.fallbacks.mean()),
        'games': len(returns.total),
    }
