"""Action sets, and their exact models: learned options, primitive actions, or both."""

from collections.abc import Sequence
import math
from typing import Any, Protocol

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import TabularOption
from humanopts_learner.planning.errors import (
    DuplicateOptionError,
    NoOptionsError,
    UnknownActionSetError,
)
from humanopts_learner.planning.multi_time_models import (
    concatenate,
    Model,
    MultiTimeModel,
    primitive_model,
    SparseMultiTimeModel,
)
from humanopts_learner.planning.option_models import option_modeller, OptionModel
import numpy as np
from scipy.sparse import csr_array, vstack

HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE = 'human', 'primitive', 'human+primitive'
AUTOMATIC, AUTOMATIC_AND_PRIMITIVE = 'automatic', 'automatic+primitive'
ACTION_SETS = (HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE, AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)
OPTIONS_ONLY = (HUMAN, AUTOMATIC)  # primitive actions only where no option can start
OF_MACHINES = (AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)  # sets of options that nobody taught
MACHINE = 'automatic'  # participant codes of options that nobody taught begin with this


class Progress(Protocol):
    """Called with how far planning is; raise ``PlanCanceled`` to stop it."""

    def __call__(self, stage: str, fraction: float, sweeps: int, residual: float, /) -> object:
        """
        Receive the progress.

        :param stage: tables, models, sweeps or evaluation.
        :param fraction: of the stage, 0..1.
        :param residual: of the last sweep, reward units; NaN before the first.
        """


def check_action_set(action_set: str, option_names: Sequence[str]) -> None:
    """
    Check an action set and the names of its options.

    :raises UnknownActionSetError: there is no such set.
    :raises NoOptionsError: it needs options and there are none.
    :raises DuplicateOptionError: two have one name.
    """
    if action_set not in ACTION_SETS:
        raise UnknownActionSetError(
            f'no action set {action_set!r}; there is {", ".join(ACTION_SETS)}'
        )
    if action_set != PRIMITIVE and not option_names:
        way = 'extract them' if action_set in OF_MACHINES else 'teach one'
        raise NoOptionsError(
            f'the action set {action_set} needs options and there are none: {way} first'
        )
    twice = sorted({name for name in option_names if option_names.count(name) > 1})
    if twice:
        raise DuplicateOptionError(f'more than one option is called {", ".join(twice)}')


def build_model(
    domain: EnumerableDomain[Any],
    action_set: str,
    options: Sequence[TabularOption],
    gamma: float,
    progress: Progress | None = None,
) -> Model:
    """
    Return the exact model of an action set.

    It has the options and then, where the set needs them, the primitive actions. In the sets
    ``human`` and ``automatic`` these are available only in states where no option is; where there
    is no such state, they are left out.

    :param options: ignored in the set ``primitive``.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    """
    report = progress or ignore_progress
    check_action_set(action_set, [option.name for option in options])
    names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
    if action_set == PRIMITIVE:
        return primitive_model(domain.transitions(), domain.over(), gamma, names)
    model = _option_models(domain, options, gamma, report)
    closed = domain.over()
    if action_set in OPTIONS_ONLY:
        closed = closed | model.available.any(axis=1)
    if not closed.all():
        primitives = primitive_model(domain.transitions(), closed, gamma, names)
        model = concatenate([model, primitives])
    report('models', 1.0, 0, math.nan)
    return model


def _option_models(
    domain: EnumerableDomain[Any], options: Sequence[TabularOption], gamma: float, report: Progress
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
        report('models', o / (1 + len(options)), 0, math.nan)
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


def ignore_progress(stage: str, fraction: float, sweeps: int, residual: float) -> None:
    """Do nothing."""
