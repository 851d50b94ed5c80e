"""Drawing outcomes from exact transitions."""

from typing import Any

from humanopts_env.domains.base import Transitions
import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-9  # how far the probabilities of one action may be from 1 in sum


def outcome_limits(transitions: Transitions) -> NDArray[np.float64]:
    """
    Return (S, A, B): the probability of each outcome or one before it.

    The last outcome that can happen has 1 exactly, so rounding never leads to an unused one.
    """
    limits = np.cumsum(transitions.probability, axis=2)
    limits[limits > 1 - ROUNDING] = 1.0
    return limits


def draw_outcomes(
    limits: NDArray[np.float64], state: Any, action: Any, number: Any
) -> NDArray[np.intp]:
    """
    Return which of the B outcomes uniform numbers choose.

    :param limits: from ``outcome_limits``.
    :param state: index or indices (N,), as ``action``.
    :param number: in [0, 1), one or (N,).
    """
    chosen: NDArray[np.intp] = (limits[state, action] <= np.asarray(number)[..., None]).sum(-1)
    return chosen
