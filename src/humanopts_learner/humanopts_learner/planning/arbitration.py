"""
Arbitration between options: which one acts in the next step.

A policy over options can be carried out in four ways. All of them are decided before each step
from one table of option values, so the same table, states and draws always give the same run.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from humanopts_learner.planning.errors import ModelError
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
SLACK = 1e-9  # by the largest value: differences of values that are rounding


class Execution(StrEnum):
    """How a policy over options is carried out."""

    RUN_TO_END = 'run_to_end'
    """An option that was chosen runs until it ends."""

    INTERRUPTED = 'interrupted'
    """
    An option is stopped where going on with it is worth less than choosing anew, both by the
    values of the policy that runs to the end (Sutton, Precup and Singh 1999, section 4).
    """

    MODULAR_MASS = 'modular_mass'
    """
    In every step all options that can start want their action as modules, and the greatest mass
    wins: the action with the greatest sum of strengths (Karlsson 1997, "greatest mass"; Humphrys
    1997, "maximise the collective happiness"). A module's strength is by how much its option is
    worth more than that of the weakest one.
    """

    MODULAR_STRONGEST = 'modular_strongest'
    """
    In every step the strongest module wins: the option of which going on is worth the most, inside
    its initiation set or not (Humphrys 1997, "maximise the best happiness"). Exact values make
    this as safe as interruption, by the same theorem.
    """


@dataclass(frozen=True)
class OptionValues:
    """
    What arbitration needs of a plan: K situations, O columns.

    A situation is a state of an enumerable domain, by its index, or a planning state of a sampled
    plan, by its code. Values are discounted returns; -inf: cannot be, or nothing is known.

    :raises ModelError: the arrays contradict each other.
    """

    action_set: str
    names: tuple[str, ...]  # (O,) of the columns: options, then action:NAME
    situations: NDArray[np.int64]  # (K,) ascending
    choosing: Floats  # (K, O) of choosing the column now, where it can start
    going_on: Floats  # (K, O) of going on with it, where it can start or not
    slack: float  # differences up to this say nothing
    sampled: bool  # situations are planning states

    def __post_init__(self) -> None:
        """Check the arrays."""
        shape = len(self.situations), len(self.names)
        if self.choosing.shape != shape or self.going_on.shape != shape:
            raise ModelError(
                f'values are {self.choosing.shape} and {self.going_on.shape}, not {shape}'
            )
        if (np.diff(self.situations) <= 0).any():
            raise ModelError('the situations do not ascend')
        for values in (self.choosing, self.going_on):
            if np.isnan(values).any() or (values == np.inf).any():
                raise ModelError('a value is no number, or infinite')
        if not 0.0 <= self.slack < np.inf:
            raise ModelError(f'slack is {self.slack}, and must be 0 or greater')

    def flat(self) -> dict[str, Any]:
        """Return its parts with all arrays flat, row by row, as a message carries them."""
        return {
            **vars(self),
            'names': list(self.names),
            'choosing': self.choosing.ravel(),
            'going_on': self.going_on.ravel(),
        }

    @classmethod
    def from_flat(cls, parts: Mapping[str, Any]) -> 'OptionValues':
        """
        Return what ``flat`` came from.

        :raises ModelError: the parts contradict each other.
        """
        situations = np.asarray(parts['situations'], dtype=np.int64)
        shape = len(situations), len(parts['names'])

        def table(name: str) -> Floats:
            values = np.asarray(parts[name], dtype=np.float64)
            if values.size != shape[0] * shape[1]:
                raise ModelError(f'{name} has {values.size} values, and not {shape}')
            return values.reshape(shape)

        return cls(
            action_set=parts['action_set'],
            names=tuple(parts['names']),
            situations=situations,
            choosing=table('choosing'),
            going_on=table('going_on'),
            slack=float(parts['slack']),
            sampled=bool(parts['sampled']),
        )


def stops(going_on: Floats, choosing: Floats, column: Ints, slack: float) -> Flags:
    """
    Tell where a running option is to be stopped, (N,).

    :param going_on: (N, O); nothing is stopped of which it is -inf.
    :param choosing: (N,) value of what would be chosen.
    :param column: (N,) what runs; -1: nothing.
    """
    value = going_on[np.arange(len(column)), column]
    stop: Flags = (column >= 0) & np.isfinite(value) & (value < choosing - slack)
    return stop


def strongest(going_on: Floats) -> Ints:
    """Return (N,): the column of the strongest module, the lowest of equals; going_on (N, O)."""
    column: Ints = going_on.argmax(axis=1)
    return column


def greatest_mass(choosing: Floats, action: Ints, n_actions: int) -> Ints:
    """
    Return (N,): the strongest column among those that want the action of the greatest mass.

    Equal masses are decided by the strongest module, then by the lowest column.

    :param choosing: (N, O); modules of which it is -inf want nothing.
    :param action: (N, O) what each module wants.
    """
    speaks = np.isfinite(choosing)
    weakest = np.where(speaks, choosing, np.inf).min(axis=1, keepdims=True)
    strength = np.subtract(choosing, weakest, out=np.zeros(choosing.shape), where=speaks)
    wants = action[:, :, None] == np.arange(n_actions)  # (N, O, A)
    mass = (strength[:, :, None] * wants).sum(axis=1)
    wins = np.take_along_axis(mass, action, axis=1) >= mass.max(axis=1, keepdims=True)
    return strongest(np.where(wins, choosing, -np.inf))
