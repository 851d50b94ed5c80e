"""The interface of options, and the end of their runs."""

from typing import Protocol

from humanopts_env.arrays import Flags, Ints, Rows


class Option(Protocol):
    """
    An option, evaluated on rows (N, F) of all features of its domain.

    Learned options, primitive actions, reference options and automatic options implement it.
    """

    @property
    def name(self) -> str:
        """Name, unique among options used together."""

    @property
    def max_steps(self) -> int:
        """Maximum number of steps per run, 1 or more."""

    def can_start(self, rows: Rows) -> Flags:
        """Return (N,): whether each state is in the initiation set I."""

    def action(self, rows: Rows) -> Ints:
        """Return (N,): the action that pi takes in each state."""

    def ends(self, rows: Rows) -> Flags:
        """Return (N,): whether the option ends in each state; ignored before the first step."""


def runs_end(
    reached: Flags, over: Flags | bool, steps: Ints | int, max_steps: Ints | int
) -> Flags:
    """
    Return (N,): whether each run of an option ends, once it has taken a step.

    :param reached: (N,) whether the termination condition holds.
    :param over: (N,) whether the episode is over or cut off.
    :param steps: (N,) steps of the run so far.
    :param max_steps: (N,) maximum number of steps.
    """
    return reached | over | (steps >= max_steps)
