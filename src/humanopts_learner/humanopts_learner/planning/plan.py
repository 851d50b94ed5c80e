"""Making a plan: from an action set to the greedy policy over its options."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_learner.options.option import (
    LearnedOption,
    OptionError,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.action_sets import (
    build_model,
    check_action_set,
    ignore_progress,
    OPTIONS_ONLY,
    PRIMITIVE,
    Progress,
)
from humanopts_learner.planning.errors import (
    check_gamma,
    ForeignOptionError,
    NotEnumerableError,
    PlanError,
)
from humanopts_learner.planning.value_iteration import Solution, solve_smdp

Clock = Callable[[], float]  # seconds


@dataclass(frozen=True)
class Decision:
    """What a policy over options runs next."""

    name: str  # an option, or action:NAME
    fallback: bool  # a primitive action because no option is available


@dataclass(frozen=True)
class Plan:
    """
    A greedy policy over options.

    Option indices count the learned options and then, where the action set needs them, all
    primitive actions. In the sets ``human`` and ``automatic`` these are the fallback: available
    only in states where no option is, so that the one chosen there is the best by one step of
    look-ahead in the plan's own values, the first of equals.
    """

    domain: EnumerableDomain[Any]
    action_set: str
    gamma: float
    options: tuple[TabularOption, ...]
    names: tuple[str, ...]  # by option index
    solution: Solution
    table_seconds: float
    model_seconds: float
    sweep_seconds: float

    def choose(self, state: Any) -> Decision:
        """
        Return what the policy runs in a state of the domain.

        :raises PlanError: the task is over in it.
        """
        option = int(self.solution.best[self.domain.index(state)])
        if option < 0:
            raise PlanError('there is nothing to do: the task is over')
        return Decision(self.names[option], option >= self.first_fallback)

    @property
    def first_fallback(self) -> int:
        """Option index from which on a choice is a fallback; the number of names if none is."""
        return len(self.options) if self.action_set in OPTIONS_ONLY else len(self.names)

    @property
    def game_steps(self) -> int:
        """Game steps that were sampled: 0."""
        return 0


def make_plan(
    domain: Domain[Any],
    action_set: str,
    options: Sequence[LearnedOption],
    gamma: float | None = None,
    tol: float = 1e-8,
    max_sweeps: int = 10_000,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> Plan:
    """
    Plan with learned options, primitive actions, or both.

    :param action_set: one of ``ACTION_SETS``; ``options`` are ignored in ``primitive``.
    :param gamma: discount per primitive step; None: the domain's own.
    :param tol: largest change allowed in the last sweep, in reward units.
    :raises PlanError: the request makes no sense; its subclasses say which part.
    :raises PlanCanceled: from ``progress``.
    """
    gamma = domain.gamma if gamma is None else gamma
    used = () if action_set == PRIMITIVE else tuple(options)
    check_request(domain, action_set, used, gamma)
    if not is_enumerable(domain):
        raise NotEnumerableError(
            f'the states of {domain.name} cannot all be listed, so it has no exact models'
        )
    report = progress or ignore_progress
    domain.feature_table()  # built once for all plans, so no part of this one's time
    began = clock()
    tabled = []
    for done, option in enumerate(used):
        report('tables', done / len(used), 0, math.nan)
        tabled.append(tabulate(option, domain))
    table_seconds = clock() - began
    return plan_with_tables(
        domain, action_set, tabled, gamma, tol, max_sweeps, report, clock, table_seconds
    )


def plan_with_tables(
    domain: EnumerableDomain[Any],
    action_set: str,
    options: Sequence[TabularOption],
    gamma: float,
    tol: float = 1e-8,
    max_sweeps: int = 10_000,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
    table_seconds: float = 0.0,
) -> Plan:
    """
    Plan with options that are tables already; parameters and errors as ``make_plan``.

    :param table_seconds: time that evaluating the tables took.
    """
    report = progress or ignore_progress
    used = () if action_set == PRIMITIVE else tuple(options)
    domain.transitions(), domain.over()  # built once for all plans, so no part of this one's time
    began = clock()
    model = build_model(domain, action_set, used, gamma, report)
    modelled = clock()
    solution = solve_smdp(model, tol, max_sweeps, SweepProgress(report, tol, max_sweeps))
    return Plan(
        domain=domain,
        action_set=action_set,
        gamma=gamma,
        options=used,
        names=model.names,
        solution=solution,
        table_seconds=table_seconds,
        model_seconds=modelled - began,
        sweep_seconds=clock() - modelled,
    )


def check_request(
    domain: Domain[Any], action_set: str, options: Sequence[LearnedOption], gamma: float
) -> None:
    """
    Check a request to plan, without planning.

    :raises PlanError: the request makes no sense; its subclasses say which part.
    """
    check_action_set(action_set, [option.name for option in options])
    check_gamma(gamma)
    for option in options:
        try:
            option.check_domain(domain)
        except OptionError as error:
            raise ForeignOptionError(str(error)) from error


class SweepProgress:
    """Reports the residual as a share of the sweeps: its logarithm falls about linearly."""

    def __init__(self, report: Progress, tol: float, max_sweeps: int) -> None:
        self._report, self._tol, self._max_sweeps = report, tol, max_sweeps
        self._first, self._fraction = 0.0, 0.0

    def __call__(self, sweeps: int, residual: float) -> None:
        self._first = max(self._first, residual)
        fraction = sweeps / self._max_sweeps
        if residual <= self._tol:
            fraction = 1.0
        elif self._tol > 0.0:
            fallen = math.log(self._first / residual) / math.log(self._first / self._tol)
            fraction = max(fraction, fallen)
        self._fraction = max(self._fraction, fraction)
        self._report('sweeps', self._fraction, sweeps, residual)
