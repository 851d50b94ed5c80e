"""Derived features: formulas are read, have a range, and are evaluated like Python does."""

import math
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import Feature, FeatureKind
from humanopts_env.domains.formulas import column_values, derive, feature_columns, FormulaError
from hypothesis import assume, example, given
from hypothesis import strategies as st
import numpy as np
import pytest

ORDINAL = FeatureKind.ORDINAL
LANDER: Any = SimpleNamespace(
    name='lander',
    features=(
        Feature.continuous('x', 'where it is', -1.5, 1.5, 'm'),
        Feature.continuous('height', 'how high it is', -1.0, 2.0, 'm'),
        Feature.continuous('angle', 'how it is tilted', -3.0, 3.0, 'rad'),
        Feature.number('gears', 'how many gears are out', 3),
        Feature('offset', 'how far the pad is', ORDINAL, ('-2', '-1', '0', '1', 'far')),
        Feature('fuel', 'how much fuel there is', ORDINAL, ('low', 'half', 'full')),
        Feature.nominal('carrying', 'what is carried', ('none', 'key', 'ball')),
        Feature.nominal('wanted', 'what is wanted', ('ball', 'key')),
        Feature.nominal('open', 'whether it is open', ('no', 'yes')),
    ),
)
NUMBERS = ('x', 'height', 'angle', 'gears', 'offset')
TRUTHS = ('open', '(x > 0.1)', '(not open)', '(open and angle < x)', '(x < 0 or height > x)')
OFFSETS = (-2.0, -1.0, 0.0, 1.0, 2.0)
ROW = [0.5, 1.0, -0.5, 2, 4, 1, 1, 1, 1]


def python(name: str, row: list[float]) -> Any:
    """Evaluate a formula over numbers as Python does."""
    values = dict(zip(NUMBERS, row)) | {'offset': OFFSETS[int(row[4])], 'open': row[-1]}
    functions = {
        'abs': abs,
        'min': min,
        'max': max,
        'sqrt': math.sqrt,
        # The C library's may round differently; of bools, NumPy's result has 16 bits.
        'atan2': lambda y, x: float(np.arctan2(float(y), float(x))),
        'hypot': lambda a, b: math.sqrt(a * a + b * b),
        'clip': lambda value, low, high: min(max(value, low), high),
    }
    return eval(name, functions, values)


FORMS = [
    *('({} + {})', '({} - {})', '({} * {})', '({} / {})', '-{}', 'abs({})', 'sqrt({})'),
    *('min({}, {})', 'max({}, {})', 'clip({}, {}, {})', 'hypot({}, {})', 'atan2({}, {})'),
]
CONSTANT = st.floats(0, 1e6, width=32).map(repr)


@st.composite
def formulas(draw: st.DrawFn, depth: int = 3) -> str:
    """Draw a formula over numbers, which may be invalid."""
    if not depth or draw(st.booleans()):
        return draw(st.sampled_from([*NUMBERS, *TRUTHS]) | CONSTANT)
    form = draw(st.sampled_from(FORMS))
    return form.format(*(draw(formulas(depth - 1)) for _ in range(form.count('{}'))))


COMPARISON = st.tuples(formulas(), st.sampled_from(['<', '<=', '>', '>=', '==', '!=']), formulas())


@st.composite
def rows(draw: st.DrawFn) -> list[float]:
    """Draw valid values, often the lowest or the highest."""
    found = []
    for feature in LANDER.features:
        if feature.kind is FeatureKind.CONTINUOUS:
            ends = st.sampled_from([feature.low, feature.high, 0.0])
            found.append(draw(ends | st.floats(feature.low, feature.high)))
        else:
            found.append(float(draw(st.integers(0, len(feature.values) - 1))))
    return found


@given(formulas() | COMPARISON.map(' '.join), st.lists(rows(), min_size=1, max_size=5))
@example('(hypot(x, height) / (0.1 + abs(angle)))', [ROW])
@example('atan2((not open), (x > 0.1))', [[-1.5, -1.0, -3.0, 0, 0, 0, 0, 0, 0]])
def test_a_value_is_that_of_python_and_in_its_range(text: str, several: list[list[float]]) -> None:
    try:
        column = derive(LANDER, text)
    except FormulaError:
        assume(False)
    values = column.values(np.array(several))
    assert values.shape == (len(several),)
    for value, row in zip(values.tolist(), several):
        assert column.feature.has(value)
        assert value == python(column.feature.name, row)
    (again,) = feature_columns(LANDER, [column.feature.name])
    assert again == column


@pytest.mark.parametrize(
    ('text', 'name', 'question', 'value'),
    [
        ('x-0.5*height', 'x - 0.5 * height', 'the value of x minus (0.5 times height)', '0 m'),
        ('x*height', 'x * height', 'the value of x times height', '0.5'),
        ('abs(angle)', 'abs(angle)', 'the value of the size of angle', '0.5 rad'),
        (
            'atan2(height, x)',
            'atan2(height, x)',
            'the value of the angle of height over x',
            '1.107 rad',
        ),
        ('hypot(height, x)', 'hypot(height, x)', None, '1.118 m'),
        ('offset - gears', 'offset - gears', 'the value of offset minus gears', '0'),
        ('height>0.1', 'height > 0.1', 'whether height is above 0.1', 'yes'),
        ('0<x<.2', '0 < x < 0.2', 'whether 0 is below x and x is below 0.2', 'no'),
        ('carrying == "key"', "carrying == 'key'", 'whether carrying is key', 'yes'),
        ('carrying == wanted', 'carrying == wanted', 'whether carrying is wanted', 'yes'),
        ("offset != 'far'", "offset != 'far'", 'whether offset is not far', 'no'),
        ("fuel >= 'full'", "fuel >= 'full'", 'whether fuel is at least full', 'no'),
        ('fuel + 1', 'fuel + 1', 'the value of fuel plus 1', '2'),
        ('x * (not open)', 'x * (not open)', 'the value of x times (not open)', '0'),
        ('2 * (x > 0) - open', '2 * (x > 0) - open', None, '1'),
        ('open and not x > 1', 'open and (not x > 1)', None, 'yes'),
    ],
)
def test_a_formula_is_a_feature(
    text: str, name: str, question: str | None, value: str | None
) -> None:
    column = derive(LANDER, text)
    assert column.feature.name == name
    assert question is None or column.feature.question == question
    assert value is None or column.text(np.array(ROW)) == value


@pytest.mark.parametrize(
    ('text', 'fault'),
    [
        ('heigth - x', "lander has no feature 'heigth'; did you mean height?"),
        ('z - x', "lander has no feature 'z'; it has x, height, angle"),
        ('x -', "'x -' is not a formula; write one like"),
        ('', "'' is not a formula"),
        ('x\0', 'is not a formula'),
        ('(' * 150 + 'x', 'is not a formula'),
        ('-' * 150 + 'x', 'nested too deeply; at most 30 levels'),
        ('x + ' * 60 + 'x', 'the formula has 241 characters; at most 200 are allowed'),
        ('(x)', 'x is already a feature'),
        ('1 + 1', 'it is the same in every state'),
        ("'key'", 'it is the same in every state'),
        ('x > 5', "'x > 5' says nothing about the state: it is always no"),
        ('height / x', "'x' can be 0, so nothing can be divided by it"),
        ('sqrt(x)', "'x' can be negative, so it has no root"),
        ('1e400 * x', 'can be too large for a number'),
        ('1e308 * angle * 9', 'can be too large for a number'),
        ('x / (height + 1.0000001) / 1e-320', 'can be too large for a number'),
        ('carrying + 1', "carrying is not a number: compare it, as in carrying == 'ball'"),
        ("'key' + x", "'key' is not a number"),
        ("carrying == 'sword'", "carrying is never 'sword'; its values are none, key, ball"),
        ("x == 'key'", "x and 'key' cannot be compared"),
        ('carrying < wanted', 'carrying and wanted have no order: use == or !='),
        ('x and open', "'x' is neither yes nor no"),
        ('(x > 0) == open', 'cannot be compared'),
        ('sin(x)', "unknown function 'sin'; choose from abs, min, max"),
        ('hypot(x)', "hypot takes 2 arguments, not 1: 'hypot(x)'"),
        ('x if open else 0', 'cannot be part of a formula; use + - * /'),
        ('x.real', "'x.real' cannot be part of a formula"),
        ('True', "'True' cannot be part of a formula"),
        ('x ** 2', 'cannot be part of a formula'),
        ('abs(x=1)', 'cannot be part of a formula'),
    ],
)
def test_a_bad_formula_is_refused_in_one_sentence(text: str, fault: str) -> None:
    with pytest.raises(FormulaError, match=r'^[^\n]+$') as refused:
        derive(LANDER, text)
    assert fault in str(refused.value)


def test_features_come_in_order_and_formulas_in_normal_form() -> None:
    columns = feature_columns(LANDER, ['x - angle', 'open', 'x > 1', 'x'])
    assert [column.feature.name for column in columns] == ['x', 'open', 'x - angle', 'x > 1']
    with pytest.raises(FormulaError, match="'x-angle' must be written as 'x - angle'"):
        feature_columns(LANDER, ['x-angle'])


@pytest.mark.parametrize('text', ['__import__("os")', 'x', 'x[y]', 'x[0].T', 'print(x[0])', '('])
def test_a_formula_from_a_file_only_computes(text: str) -> None:
    with pytest.raises(FormulaError, match='is not a formula over indices'):
        column_values(text, np.zeros((1, 3)))
