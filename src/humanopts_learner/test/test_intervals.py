"""Confidence intervals, against published values, SciPy's tests, and how often they are right."""

import math

from humanopts_env.seeding import generator
from humanopts_learner.intervals import all_hold, any_holds, Interval, level_of_each
import numpy as np
from numpy.typing import NDArray
import pytest
from scipy import stats

RNG = generator(1, 'intervals')
FIRST, SECOND = RNG.normal(3.0, 1.0, 6), RNG.normal(2.0, 2.0, 6)


def limits(found: Interval) -> tuple[float, float]:
    return found.low, found.high


@pytest.mark.parametrize(('count', 'half'), [(2, 12.706), (5, 2.776), (30, 2.045)])
def test_a_mean_of_few_has_the_interval_of_students_t(count: int, half: float) -> None:
    """The values are those of printed tables: half widths in standard errors."""
    values = RNG.normal(size=count)
    error = values.std(ddof=1) / math.sqrt(count)
    found = Interval.of(values)
    assert found.mean == pytest.approx(values.mean())
    assert [x / error for x in (found.mean - found.low, found.high - found.mean)] == pytest.approx(
        [half, half], abs=5e-4
    )


def test_too_few_values_have_no_limits() -> None:
    one, none = Interval.of([4.0]), Interval.of([])
    assert one.mean == 4.0
    assert np.isnan([one.low, one.high, none.mean, none.low, none.high]).all()
    assert one.above(0.0) is one.above(9.0) is one.at_most(4.0) is one.holds(4.0) is None
    assert math.isnan(Interval.of_share(np.zeros(0, dtype=np.bool_)).mean)
    assert Interval.of_difference([2.0], [1.0, 1.0], paired=False).above() is None
    assert Interval.of_difference([2.0, 2.0], [1.0, 1.0], paired=False) == Interval(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ('good', 'of', 'low', 'high'),
    [(0, 10, 0.0, 0.278), (5, 10, 0.237, 0.763), (81, 263, 0.255, 0.366), (5, 5, 0.566, 1.0)],
)
def test_shares_have_wilsons_interval(good: int, of: int, low: float, high: float) -> None:
    """The values of the first three are those of Newcombe (1998)."""
    flags = np.arange(of) < good
    found = Interval.of(flags)
    assert found == Interval.of_share(flags)
    assert (found.mean, *limits(found)) == pytest.approx((good / of, low, high), abs=5e-4)


def test_differences_within_units_are_paired() -> None:
    """What the units share drops out, and the interval is that of the paired t test."""
    units = RNG.normal(0.0, 1000.0, 6)
    found = Interval.of_difference(FIRST + units, SECOND + units)
    known = stats.ttest_rel(FIRST, SECOND).confidence_interval()
    assert found.mean == pytest.approx(FIRST.mean() - SECOND.mean())
    assert limits(found) == pytest.approx((known.low, known.high))
    with pytest.raises(ValueError, match='6 and 5 values'):
        Interval.of_difference(FIRST, SECOND[:5])


@pytest.mark.parametrize('second', [SECOND, SECOND[:3], FIRST])
def test_differences_of_other_units_are_welchs(second: NDArray[np.float64]) -> None:
    found = Interval.of_difference(FIRST, second, paired=False)
    known = stats.ttest_ind(FIRST, second, equal_var=False).confidence_interval()
    assert found.mean == pytest.approx(FIRST.mean() - second.mean())
    assert limits(found) == pytest.approx((known.low, known.high))


def test_the_ratio_the_other_way_round_is_the_inverse() -> None:
    found = Interval.of_ratio([2.0, 4.0, 3.0], [1.0, 1.0, 2.0])
    other = Interval.of_ratio([1.0, 1.0, 2.0], [2.0, 4.0, 3.0])
    assert found.mean == pytest.approx(12.0 ** (1 / 3))
    assert limits(found) == pytest.approx((1 / other.high, 1 / other.low))
    assert found.low < 12.0 ** (1 / 3) < found.high
    alike = Interval.of_ratio([6.0, 2.0], [3.0, 1.0])
    assert (alike.mean, *limits(alike)) == pytest.approx((2.0, 2.0, 2.0))


@pytest.mark.parametrize(
    ('value', 'above', 'at_most'),
    [
        (0.9, True, False),
        (1.0, None, None),
        (2.0, None, None),
        (3.0, None, True),
        (3.1, False, True),
    ],
)
def test_an_interval_decides_only_what_lies_outside(
    value: float, above: bool | None, at_most: bool | None
) -> None:
    found = Interval(2.0, 1.0, 3.0)
    assert (found.above(value), found.at_most(value)) == (above, at_most)
    assert found.below(value) is {True: False, False: True, None: None}[above]
    assert found.holds(value) is (above is None)


def test_several_claims_hold_together_with_wider_intervals() -> None:
    assert level_of_each(5) == pytest.approx(0.99)
    found = [all_hold(claims) for claims in ([True, True], [True, None], [None, False])]
    assert found == [True, None, False]
    found = [any_holds(claims) for claims in ([False, None, True], [False, None], [False, False])]
    assert found == [True, None, False]
