"""Action sets, and their exact models: learned options, primitive actions, or both."""

from collections.abc import Sequence
import math
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import TabularOption
from humanopts_learner.planning.multi_time_models import (
    concatenate,
    Model,
    MultiTimeModel,
    primitive_model,
    SparseMultiTimeModel,
)
from humanopts_learner.planning.option_models import option_modeller, OptionModel
from humanopts_learner.planning.request import ignore_progress, OPTIONS_ONLY, PRIMITIVE, Progress
import numpy as np
from scipy.sparse import csr_array, vstack


def build_model(
    domain: EnumerableDomain[Any],
    action_set: str,
    options: Sequence[TabularOption],
    gamma: float,
    progress: Progress = ignore_progress,
) -> Model:
    """
    Return the exact model of an action set.

    It has the options and then, where the set needs them, the primitive actions. In the sets
    ``human`` and ``automatic`` these are available only in states where no option is; where there
    is no such state, they are left out.

    :param options: ignored in the set ``primitive``.
    """
    names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
    if action_set == PRIMITIVE:
        return primitive_model(domain.transitions(), domain.over(), gamma, names)
    model = _option_models(domain, options, gamma, progress)
    closed = domain.over()
    if action_set in OPTIONS_ONLY:
        closed = closed | model.available.any(axis=1)
    if not closed.all():
        primitives = primitive_model(domain.transitions(), closed, gamma, names)
        model = concatenate([model, primitives])
    progress('models', 1.0, 0, math.nan)
    return model


def _option_models(
    domain: EnumerableDomain[Any],
    options: Sequence[TabularOption],
    gamma: float,
    progress: Progress,
) -> Model:
    """Return the model of options alone, sparse where the domain has chance."""
    over, shape = domain.over(), (len(options), domain.n_states)
    modeller = option_modeller(domain.transitions(), over, gamma)
    reward, available = np.zeros(shape), np.empty(shape, dtype=np.bool_)
    deterministic = domain.transitions().deterministic
    discount = np.zeros(shape if deterministic else 0)
    successor = np.zeros(discount.shape, dtype=np.int32)
    rows = []
    for o, option in enumerate(options):
        progress('models', o / (1 + len(options)), 0, math.nan)
        np.greater(option.initiation, over, out=available[o])
        found = modeller.model(option.action, option.termination, option.max_steps, available[o])
        reward[o, found.states] = found.reward
        if isinstance(found, OptionModel):
            discount[o, found.states] = found.discount
            successor[o, found.states] = found.successor
        else:
            asked = np.flatnonzero(available[o, found.states])
            at = found.states[asked], asked
            place = csr_array((np.ones(len(asked)), at), (len(over), len(found.states)))
            rows.append(place @ found.successor)
    names = tuple(option.name for option in options)
    if deterministic:
        return MultiTimeModel(names, reward.T, available.T, successor.T, discount.T)
    return SparseMultiTimeModel(names, reward.T, available.T, vstack(rows, format='csr'))
