"""What each sweep of value iteration brought, plan beside plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
import math

from humanopts_learner.planning.action_sets import build_model
from humanopts_learner.planning.plan import Plan
from humanopts_learner.planning.value_iteration import sweep_table, SweepRow
from humanopts_teach.report.charts import sweep_figure
from humanopts_teach.report.words import number

MOST_VALUES = 20_000_000  # states by sweeps, up to which plans are made again for this
ALL_ROWS, STEP = 30, 1.1  # sweeps that are all in the table; from there on each so many times on
NEAR = 1e-3  # a value so close to its end, in reward units, is settled


@dataclass(frozen=True)
class SweepReport:
    """The sweeps of several plans."""

    names: list[str]
    near: float
    figure: str  # SVG
    rows: list[tuple[int, list[str]]]  # sweep; residual and share settled of each plan


def sweep_report(plans: Mapping[str, Plan], name: str) -> SweepReport | None:
    """
    Make the plans again, sweep by sweep; None where that would take long, or there are none.

    :param plans: with exact models, by what each is called.
    :param name: prefix of the identifiers.
    """
    if not plans or any(_values(plan) > MOST_VALUES for plan in plans.values()):
        return None
    tables = {called: _sweeps(plan) for called, plan in plans.items()}
    states = next(iter(plans.values())).domain.n_states
    found = list(zip_longest(*tables.values()))
    rows = [
        (sweep, [text for row in found[sweep] for text in _cells(row, states)])
        for sweep in _shown([len(table) - 1 for table in tables.values()])
    ]
    return SweepReport(list(tables), NEAR, sweep_figure(tables, f'{name}-residual'), rows)


def _values(plan: Plan) -> int:
    return plan.domain.n_states * plan.solution.sweeps


def _shown(last: Sequence[int]) -> list[int]:
    """Return the sweeps that the table shows: the first ones, fewer later on, and each last."""
    shown, sweep = set(last), 0
    while sweep <= max(last):
        shown.add(sweep)
        sweep = sweep + 1 if sweep < ALL_ROWS else math.ceil(sweep * STEP)
    return sorted(shown)


def _sweeps(plan: Plan) -> list[SweepRow]:
    model = build_model(plan.domain, plan.action_set, plan.options, plan.gamma)
    return sweep_table(model, near=NEAR, max_sweeps=plan.solution.sweeps)


def _cells(row: SweepRow | None, states: int) -> tuple[str, str]:
    if row is None:
        return '', ''
    return (number(row.residual, 3) if row.sweep else '', f'{row.settled / states:.1%}')
