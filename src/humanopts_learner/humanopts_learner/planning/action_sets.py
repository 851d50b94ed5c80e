"""The exact model of an action set: learned options, primitive actions, or both."""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, Protocol

from humanopts_env.domains.base import EnumerableDomain
from humanopts_learner.library import PRIMITIVE_PREFIX
from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.chance import RowComposer
from humanopts_learner.planning.errors import (
    DuplicateOptionError,
    NoOptionsError,
    UnknownActionSetError,
)
from humanopts_learner.planning.model import (
    concatenate,
    Model,
    primitive_model,
    RowModel,
    SmdpModel,
)
from humanopts_learner.planning.option_models import Composer
import numpy as np
from scipy.sparse import csr_array, vstack

HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE = 'human', 'primitive', 'human+primitive'
AUTOMATIC, AUTOMATIC_AND_PRIMITIVE = 'automatic', 'automatic+primitive'
ACTION_SETS = (HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE, AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)
OPTIONS_ONLY = (HUMAN, AUTOMATIC)  # primitive actions only where no option can start
OF_MACHINES = (AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)  # sets of options that nobody taught
MACHINE = 'automatic'  # with this begin the codes of participants whose options nobody taught


class Progress(Protocol):
    """Told how far planning is; raise ``PlanCanceled`` to stop it."""

    def __call__(self, stage: str, fraction: float, sweeps: int, residual: float, /) -> object:
        """
        Take note.

        :param stage: tables, models, sweeps or evaluation.
        :param fraction: of the stage, 0..1.
        :param residual: of the last sweep, reward units; NaN before the first.
        """


@dataclass(frozen=True)
class TabledOption:
    """An option as its tables over all states."""

    name: str
    max_steps: int
    tables: OptionTables


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
    options: Sequence[TabledOption],
    gamma: float,
    progress: Progress | None = None,
) -> Model:
    """
    Return the exact model of an action set.

    The columns are the options and then, where the set needs them, the primitive actions. In the
    sets ``human`` and ``automatic`` these are available only in states where no option is; where
    there is no such state, they are left out.

    :param options: not looked at in the set ``primitive``.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    """
    tell = progress or say_nothing
    check_action_set(action_set, [option.name for option in options])
    names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
    if action_set == PRIMITIVE:
        return primitive_model(domain.transitions(), domain.over(), gamma, names)
    deterministic = domain.transitions().deterministic
    model_options = _option_model if deterministic else _option_rows
    model: Model = model_options(domain, options, gamma, tell)
    closed = domain.over()
    if action_set in OPTIONS_ONLY:
        closed = closed | model.available.any(axis=1)
    if not closed.all():
        primitives = primitive_model(domain.transitions(), closed, gamma, names)
        model = concatenate([model, primitives])
    tell('models', 1.0, 0, math.nan)
    return model


def _option_model(
    domain: EnumerableDomain[Any], options: Sequence[TabledOption], gamma: float, tell: Progress
) -> SmdpModel:
    over = domain.over()
    composer = Composer(domain.transitions(), over, gamma)
    shape = (len(options), len(over))
    reward, discount = np.zeros(shape), np.zeros(shape)
    successor = np.zeros(shape, dtype=np.int32)
    available = np.empty(shape, dtype=np.bool_)
    for o, option in enumerate(options):
        tell('models', o / (1 + len(options)), 0, math.nan)
        tables = option.tables
        np.greater(tables.initiation, over, out=available[o])
        outcome = composer.outcome(
            tables.action, tables.termination, option.max_steps, available[o]
        )
        reward[o, outcome.states] = outcome.reward
        discount[o, outcome.states] = outcome.discount
        successor[o, outcome.states] = outcome.successor
    names = tuple(option.name for option in options)
    return SmdpModel(names, reward.T, available.T, successor.T, discount.T)


def _option_rows(
    domain: EnumerableDomain[Any], options: Sequence[TabledOption], gamma: float, tell: Progress
) -> RowModel:
    over = domain.over()
    composer = RowComposer(domain.transitions(), over, gamma)
    shape = (len(options), len(over))
    reward, available = np.zeros(shape), np.empty(shape, dtype=np.bool_)
    rows = []
    for o, option in enumerate(options):
        tell('models', o / (1 + len(options)), 0, math.nan)
        tables = option.tables
        np.greater(tables.initiation, over, out=available[o])
        outcome = composer.outcome(
            tables.action, tables.termination, option.max_steps, available[o]
        )
        asked = np.flatnonzero(available[o, outcome.states])
        starts = outcome.states[asked]
        reward[o, starts] = outcome.reward[asked]
        place = csr_array((np.ones(len(asked)), (starts, asked)), (len(over), len(outcome.states)))
        rows.append(place @ outcome.successor)
    names = tuple(option.name for option in options)
    return RowModel(names, reward.T, available.T, vstack(rows, format='csr'))


def say_nothing(stage: str, fraction: float, sweeps: int, residual: float) -> None:
    pass
