"""
The effect of the conditions of a study: a linear mixed model of people and conditions.

Fixed effects are the condition and its position in the person's order; the random effect is an
intercept per participant (Laird and Ware 1982), fitted by restricted maximum likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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
    remark: str = ''  # on what was left out of the model; empty: nothing


def effects(table: pd.DataFrame, outcome: str, conditions: Sequence[str]) -> Effects:
    """
    Return the difference of each condition to the first.

    Intervals are those of Student's t with the degrees of freedom of Pinheiro and Bates (2000,
    section 2.4.2): observations less participants less further columns of fixed effects.

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
    Fit the model, by the variance of intercepts relative to that of residuals.

    Given this ratio, rows less a share of their participant's mean are independent, and least
    squares give everything else (Pinheiro and Bates 2000, section 2.2).

    :param people: of each row; None: without random intercepts.
    :return: means and standard errors of the fixed effects, and the standard deviations of
        intercepts and residuals.
    """
    from scipy.optimize import minimize_scalar  # slow to import

    free = len(values) - columns.shape[1]
    rows = np.column_stack([columns, values])
    persons = np.arange(len(values)) if people is None else people
    _, person, counts = np.unique(persons, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), rows.shape[1]))
    np.add.at(sums, person, rows)

    def fitted(ratio: float) -> tuple[Floats, Floats, float, float]:
        """Return means, their standard errors, residual variance and -2 log likelihood."""
        shares = (1 - 1 / np.sqrt(1 + counts * ratio)) / counts
        independent = rows - (shares[:, None] * sums)[person]
        x, y = independent[:, :-1], independent[:, -1]
        inverse = np.linalg.inv(x.T @ x)
        means = inverse @ x.T @ y
        scale = float(((y - x @ means) ** 2).sum() / free)
        with np.errstate(divide='ignore'):  # the fit may be perfect
            unlikely = free * np.log(scale) + np.log1p(counts * ratio).sum()
        unlikely -= np.linalg.slogdet(inverse)[1]
        return means, np.sqrt(scale * np.diag(inverse)), scale, float(unlikely)

    ratio = 0.0
    if people is not None:
        found = minimize_scalar(
            lambda log: fitted(np.exp(log))[-1], bounds=(-20, 20), options={'xatol': 1e-9}
        )
        ratio = float(np.exp(found.x))
        ratio = ratio if ratio > 1e-6 else 0.0
    means, errors, scale, _ = fitted(ratio)
    between = np.nan if people is None else float(np.sqrt(ratio * scale))
    return means, errors, between, float(np.sqrt(scale))
