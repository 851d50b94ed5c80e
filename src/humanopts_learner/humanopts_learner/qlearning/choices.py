"""What learners choose among: options, primitive actions, or both, as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.planning.action_sets import (
    check_action_set,
    OPTIONS_ONLY,
    PRIMITIVE,
    TabledOption,
)
from humanopts_learner.qlearning.world import Flags, Ints
import numpy as np


@dataclass(frozen=True)
class Choices:
    """
    O columns over S states: the options, then all primitive actions where the set needs them.

    As in planning, these are available in the sets ``human`` and ``automatic`` only in states
    where no option is.
    """

    names: tuple[str, ...]  # (O,)
    action: Ints  # (O, S) what each does
    ends: Flags  # (O, S) whether it ends there, after one step or more
    available: Flags  # (S, O) whether it can be chosen; nothing can where the task is over
    limits: Ints  # (O,) steps after which it is cut off


def choices_of(
    domain: EnumerableDomain[Any], action_set: str, options: Sequence[TabledOption]
) -> Choices:
    """
    Return the columns of an action set.

    :param options: not looked at in the set ``primitive``.
    :raises PlanError: there is no such set, or its options are none or not distinct.
    """
    used = () if action_set == PRIMITIVE else tuple(options)
    check_action_set(action_set, [option.name for option in options])
    count, going = domain.n_states, ~domain.over()
    primitives = np.arange(len(domain.actions))
    tables = [option.tables for option in used]
    can = np.array([t.initiation for t in tables], dtype=np.bool_).reshape(-1, count) & going
    free = going & ~can.any(axis=0) if action_set in OPTIONS_ONLY else going
    columns = len(primitives) if free.any() else 0
    shape = (columns, count)
    return Choices(
        names=(
            *(option.name for option in used),
            *(PRIMITIVE_PREFIX + action.name for action in domain.actions[:columns]),
        ),
        action=np.concatenate(
            [*(t.action[None] for t in tables), np.broadcast_to(primitives[:columns, None], shape)]
        ).astype(np.intp),
        ends=np.concatenate([*(t.termination[None] for t in tables), np.ones(shape, np.bool_)]),
        available=np.concatenate([can, np.broadcast_to(free, shape)]).T.copy(),
        limits=np.array([*(option.max_steps for option in used), *[1] * columns], dtype=np.intp),
    )
