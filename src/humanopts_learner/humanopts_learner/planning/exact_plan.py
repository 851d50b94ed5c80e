"""Planning with exact models: from an action set to the greedy policy over its options."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from humanopts_env.arrays import Flags
from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import OptionTable, TabularOption, tabulate
from humanopts_learner.planning.models import (
    concatenate,
    model_option,
    MultiTimeModel,
    primitive_model,
)
from humanopts_learner.planning.request import (
    Clock,
    ignore_progress,
    OPTIONS_ONLY,
    PlanError,
    PlanRequest,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.solve import OnSweep, Solution, solve_smdp
import numpy as np
from scipy.sparse import csr_array


@dataclass(frozen=True)
class Decision:
    """The next option of a policy over options."""

    name: str  # an option, or action:NAME
    fallback: bool  # a primitive action because no option is available


@dataclass(frozen=True, kw_only=True)
class PolicyPlan(ABC):
    """
    A greedy policy over options, and what it took to make it.

    Option indices count the options and then, where the action set needs them, all primitive
    actions.
    """

    domain: Domain
    action_set: str
    gamma: float
    names: tuple[str, ...]  # by option index
    first_fallback: int  # index from which on a choice is a fallback; number of names if none is
    solution: Solution
    game_steps: int = 0  # that were sampled
    table_seconds: float = 0.0  # of the options of exact plans
    model_seconds: float  # sampling and counting, where models are sampled
    sweep_seconds: float

    @property
    def seconds(self) -> float:
        """Duration of planning, everything included."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds

    def choose(self, state: Any) -> Decision:
        """
        Return what the policy runs in a state of the domain.

        :raises PlanError: the task is over in it.
        """
        if self.domain.is_over(state):
            raise PlanError('there is nothing to do: the task is over')
        option = self._best(state)
        return Decision(self.names[option], option >= self.first_fallback)

    @abstractmethod
    def _best(self, state: Any) -> int:
        """Return the index of the option to run in a state in which the task is not over."""


@dataclass(frozen=True, kw_only=True)
class ExactPlan(PolicyPlan):
    """
    A plan by the values of all states.

    In the sets ``human`` and ``automatic`` primitive actions are the fallback: available only in
    states where no option is, so that the one chosen there is the best by one step of look-ahead
    in the plan's own values, the first of equals.
    """

    domain: EnumerableDomain
    options: tuple[TabularOption, ...]

    def _best(self, state: Any) -> int:
        return int(self.solution.best[self.domain.index(state)])


def make_exact_plan(
    domain: EnumerableDomain,
    options: Sequence[Option | TabularOption],
    request: PlanRequest,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> ExactPlan:
    """
    Plan with exact models; parameters and errors as ``plan.make_plan``.

    :param options: learned, or as tables over all states.
    """
    asked = request.in_force(domain, options, sampled=False)
    used = () if asked.action_set == PRIMITIVE else tuple(options)
    # Built once for all plans, so it is not counted in the time of this one.
    domain.transitions(), domain.over()
    if not all(isinstance(option, TabularOption) for option in used):
        domain.feature_table()
    began = clock()
    tabled = []
    for done, option in enumerate(used):
        progress('tables', done / len(used), 0, math.nan)
        tabled.append(tabulate(option, domain))
    evaluated = clock()
    model = build_model(domain, asked.action_set, tabled, asked.gamma, progress)
    modelled = clock()
    on_sweep = None
    if progress is not ignore_progress:  # small plans would take half as long again
        on_sweep = sweep_progress(progress, asked.tol, asked.max_sweeps)
    solution = solve_smdp(model, asked.tol, asked.max_sweeps, on_sweep)
    return ExactPlan(
        domain=domain,
        action_set=asked.action_set,
        gamma=asked.gamma,
        options=tuple(tabled),
        names=model.names,
        first_fallback=len(tabled if asked.action_set in OPTIONS_ONLY else model.names),
        solution=solution,
        table_seconds=evaluated - began,
        model_seconds=modelled - evaluated,
        sweep_seconds=clock() - modelled,
    )


def sweep_progress(report: Progress, tol: float, max_sweeps: int) -> OnSweep:
    """
    Return what reports the residual as a share of the sweeps.

    Its logarithm falls about linearly.
    """
    first = fraction = 0.0

    def on_sweep(sweeps: int, residual: float) -> None:
        nonlocal first, fraction
        first, fraction = max(first, residual), max(fraction, sweeps / max_sweeps)
        if residual <= tol:
            fraction = 1.0
        elif tol > 0.0:
            fraction = max(fraction, math.log(first / residual) / math.log(first / tol))
        report('sweeps', fraction, sweeps, residual)

    return on_sweep


def build_model(
    domain: EnumerableDomain,
    action_set: str,
    options: Sequence[TabularOption],
    gamma: float,
    progress: Progress = ignore_progress,
) -> MultiTimeModel:
    """
    Return the exact model of an action set.

    It has the options and then, where the set needs them, the primitive actions.

    :param options: ignored in the set ``primitive``.
    """
    names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
    if action_set == PRIMITIVE:
        return primitive_model(domain.transitions(), domain.over(), gamma, names)
    over, shape = domain.over(), (len(options), domain.n_states)
    reward, available = np.zeros(shape), np.empty(shape, dtype=np.bool_)
    lengths, rows = np.zeros(shape, dtype=np.int32), []
    for o, option in enumerate(options):
        progress('models', o / (1 + len(options)), 0, math.nan)
        starts = np.greater(option.initiation, over, out=available[o])
        found = model_option(domain.transitions(), over, gamma, option, starts)
        at = np.flatnonzero(starts)
        reward[o, at], lengths[o, at] = found.reward, np.diff(found.successor.indptr)
        rows.append(found.successor)
    parts = (
        np.concatenate([part.data for part in rows]),
        np.concatenate([part.indices for part in rows]),
        np.append(np.int32(0), np.cumsum(lengths, dtype=np.int32)),
    )
    joined = csr_array(parts, shape=(lengths.size, domain.n_states))
    model = MultiTimeModel(tuple(o.name for o in options), reward.T, available.T, joined)
    free = _primitive_states(domain, action_set, options)
    if free.any():
        primitives = primitive_model(domain.transitions(), ~free, gamma, names)
        model = concatenate([model, primitives])
    progress('models', 1.0, 0, math.nan)
    return model


def _primitive_states(
    domain: EnumerableDomain, action_set: str, options: Sequence[TabularOption]
) -> Flags:
    """
    Return the states in which primitive actions can be chosen, (S,).

    In the sets ``human`` and ``automatic`` these are only the states where no option is available;
    where there is no such state, primitive actions are left out of the set.
    """
    going = ~domain.over()
    if action_set not in OPTIONS_ONLY:
        return going
    free: Flags = going & ~np.any([option.initiation for option in options], axis=0)
    return free


def option_table(
    domain: EnumerableDomain, action_set: str, options: Sequence[TabularOption]
) -> OptionTable:
    """
    Return the options of an action set as one table.

    :param options: ignored in the set ``primitive``.
    :raises PlanError: there is no such set, or its options are none or not distinct.
    """
    PlanRequest(action_set).in_force(domain, options, sampled=False)
    used = () if action_set == PRIMITIVE else tuple(options)
    free = _primitive_states(domain, action_set, used)
    primitives = [
        TabularOption(
            name=PRIMITIVE_PREFIX + action.name,
            max_steps=1,
            action=np.full(len(free), index),
            initiation=free,
            termination=np.ones_like(free),
        )
        for index, action in enumerate(domain.actions)
    ]
    return OptionTable([*used, *primitives] if free.any() else used, domain.over())
