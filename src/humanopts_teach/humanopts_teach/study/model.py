"""
The effect of the conditions of a study: a linear mixed model of people and conditions.

Fixed effects are the condition and its position in the person's order; the random effect is an
intercept per participant (Laird and Ware 1982), fitted by restricted maximum likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import warnings

from humanopts_env.arrays import Floats
from humanopts_learner.intervals import Interval
import numpy as np
import pandas as pd


class ModelError(ValueError):
    """The model cannot be fitted; the message is a sentence that gives the reason."""


@dataclass(frozen=True)
class Effect:
    """The difference of an outcome between two conditions, in its unit."""

    condition: str
    reference: str  # the difference is condition - reference
    difference: Interval


@dataclass(frozen=True)
class Effects:
    """The effects of all conditions on one outcome."""

    rows: tuple[Effect, ...]
    people: int
    observations: int
    between: float  # standard deviation of the participants' intercepts; NaN: not in the model
    within: float  # standard deviation of the residuals
    remark: str = ''  # about effects omitted from the model; empty: none


def effects(table: pd.DataFrame, outcome: str, conditions: Sequence[str]) -> Effects:
    """
    Return the difference of each condition from the first.

    Intervals use Student's t with the degrees of freedom of Pinheiro and Bates (2000, section
    2.4.2): observations minus participants minus the columns of fixed effects after the intercept.

    :param table: columns participant, condition, position and the outcome; rows without an
        outcome are left out.
    :param conditions: in the order of the plan.
    :raises ModelError: fewer than two conditions, or too few participants.
    """
    rows = table[table['condition'].isin(conditions) & table[outcome].notna()]
    people, present = rows['participant'].nunique(), set(rows['condition'])
    names = [name for name in conditions if name in present]
    if len(names) < 2:
        raise ModelError('There is no effect to estimate: only one condition has data.')
    columns, remarks = _fixed_effects(rows, names), list[str]()
    if columns.shape[1] > len(names) and np.linalg.matrix_rank(columns) < columns.shape[1]:
        columns = columns[:, : len(names)]
        remarks.append(
            'Condition and position cannot be separated, so the position is not in the model.'
        )
    repeated = len(rows) > people
    free = len(rows) - columns.shape[1] - (people - 1 if repeated else 0)
    if people < 3 or free < 1:
        raise ModelError(
            f'The model cannot be fitted: {len(rows)} observations of {people} participants are '
            'too few.'
        )
    values = rows[outcome].to_numpy(dtype=float)
    if not values.std():
        raise ModelError(f'There is no effect to estimate: all values are {values[0]:g}.')
    if not repeated:
        remarks.append('Each participant met one condition, so there is no random intercept.')
    means, errors, between, within = _fit(
        values, columns, rows['participant'].to_numpy() if repeated else None
    )
    if repeated and not between:
        remarks.append('Participants do not differ more than chance explains.')
    found = tuple(
        Effect(name, names[0], Interval.around(float(mean), float(error), free))
        for name, mean, error in zip(names[1:], means[1:], errors[1:])
    )
    return Effects(found, people, len(rows), between, within, ' '.join(remarks))


def _fixed_effects(rows: pd.DataFrame, names: Sequence[str]) -> Floats:
    """Return the intercept, and indicators of all conditions and positions but the first."""
    positions = sorted(set(rows['position']))[1:]
    indicators = [
        np.ones(len(rows)),
        *(rows['condition'] == name for name in names[1:]),
        *(rows['position'] == position for position in positions),
    ]
    return np.column_stack(indicators).astype(float)


def _fit(
    values: Floats, columns: Floats, people: 'np.ndarray[tuple[int], np.dtype[np.object_]] | None'
) -> tuple[Floats, Floats, float, float]:
    """
    Fit the model.

    :param people: participant of each row; None: fit without random intercepts.
    :return: estimates and standard errors of the fixed effects, and the standard deviations of
        intercepts and residuals.
    """
    # Imported here: each takes a second.
    from statsmodels.regression.linear_model import OLS
    from statsmodels.regression.mixed_linear_model import MixedLM

    if people is not None:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # a variance of 0 is handled below
            found = MixedLM(values, columns, people).fit(reml=True)
        variance, errors = float(found.cov_re[0, 0]), np.asarray(found.bse_fe)
        if np.isfinite(errors).all() and variance > 1e-6 * found.scale:
            fixed = np.asarray(found.fe_params)
            return fixed, errors, float(np.sqrt(variance)), float(np.sqrt(found.scale))
    # With an intercept variance of 0, the mixed model is ordinary least squares.
    plain = OLS(values, columns).fit()
    between = np.nan if people is None else 0.0
    return plain.params, plain.bse, between, float(np.sqrt(plain.scale))
