"""
Arbitration between options: which one acts in the next step.

A policy over options can be executed in four ways. All but the first are polling executions: they
decide anew before each step, from one table of option values, so the same table, states and draws
always give the same run.
"""

from dataclasses import dataclass

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_learner.planning.request import Execution, PlanError
import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-9  # relative to the largest value: differences of values that are rounding


@dataclass(frozen=True)
class OptionValues:
    """
    The values of a plan that arbitration decides by: K states, O options.

    States are those of an enumerable domain, by their indices, or the abstract states of a sampled
    plan, by their codes. Values are discounted returns; -inf: not available, or not known.

    :raises PlanError: the arrays contradict each other.
    """

    action_set: str
    names: tuple[str, ...]  # (O,) options, then action:NAME
    states: NDArray[np.int64]  # (K,) ascending
    option_values: Floats  # (K, O) of choosing the option now, where it can start
    continuation_values: Floats  # (K, O) of going on with it, where it can start or not
    interruption_margin: float  # differences up to this do not count
    sampled: bool  # states are abstract states

    def __post_init__(self) -> None:
        """Check the arrays."""
        shape = len(self.states), len(self.names)
        if self.option_values.shape != shape or self.continuation_values.shape != shape:
            raise PlanError(
                f'values are {self.option_values.shape} and {self.continuation_values.shape}, '
                f'not {shape}'
            )
        if (np.diff(self.states) <= 0).any():
            raise PlanError('the states do not ascend')
        for values in (self.option_values, self.continuation_values):
            if np.isnan(values).any() or (values == np.inf).any():
                raise PlanError('a value is no number, or infinite')
        if not 0.0 <= self.interruption_margin < np.inf:
            raise PlanError(
                f'interruption_margin is {self.interruption_margin}, and must be 0 or greater'
            )

    def find(self, states: NDArray[np.int64]) -> tuple[Ints, Flags]:
        """Return the row of each state (N,), 0 where it has none, and (N,) whether it has one."""
        row = np.minimum(np.searchsorted(self.states, states), len(self.states) - 1)
        found = self.states[row] == states
        return np.where(found, row, 0), found


def interruptions(
    option_values: Floats, continuation_values: Floats, interruption_margin: float
) -> Flags:
    """
    Return (N, O): whether each option is stopped if it runs, since choosing anew is worth more.

    :param option_values: (N, O); -inf: the option cannot be chosen.
    :param continuation_values: (N, O); an option of value -inf is not stopped.
    """
    best = option_values.max(axis=1, keepdims=True)
    worse = continuation_values < best - interruption_margin
    stopped: Flags = np.isfinite(continuation_values) & worse
    return stopped


def winners(
    execution: Execution, option_values: Floats, continuation_values: Floats, action: Ints
) -> Ints:
    """
    Return (N,): the index of the option whose action modules take, the lowest of equals.

    :param execution: one of ``MODULAR``.
    :param option_values: (N, O); modules of value -inf have no strength.
    :param continuation_values: (N, O).
    :param action: (N, O) the action that each module wants.
    """
    if execution is Execution.MODULAR_STRONGEST:
        strongest: Ints = continuation_values.argmax(axis=1)
        return strongest
    return greatest_mass(option_values, action)


def greatest_mass(option_values: Floats, action: Ints) -> Ints:
    """
    Return (N,): index of the strongest option among those whose action has the greatest mass.

    Equal masses are decided by the strongest module. Parameters and ties as in ``winners``.
    """
    finite = np.isfinite(option_values)
    weakest = np.where(finite, option_values, np.inf).min(axis=1, keepdims=True)
    strength = np.subtract(option_values, weakest, out=np.zeros(option_values.shape), where=finite)
    wants = action[:, :, None] == np.arange(action.max(initial=0) + 1)  # (N, O, A)
    mass = (strength[:, :, None] * wants).sum(axis=1)
    wins = np.take_along_axis(mass, action, axis=1) >= mass.max(axis=1, keepdims=True)
    option: Ints = np.where(wins, option_values, -np.inf).argmax(axis=1)
    return option
