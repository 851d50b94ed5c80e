"""
Derived features: formulas over the features of a domain.

The name of a derived feature is its formula, such as ``hypot(x, y)`` or ``angle - 0.5 * x``, and
can be used like any feature name. A formula is a Python expression, limited to the operators and
functions below.

A number is a continuous feature, an ordinal feature or a constant. An ordinal value counts as the
number in its text. Starting with the first text that is not a number, each value counts as one
more than the value before it (0 if there is none). A comparison is a nominal feature with the
values no and yes; like any such feature, it counts as 0 or 1. Other nominal features can only be
compared, by the texts of their values.

The range of a formula follows from the ranges of its features by interval arithmetic (Moore,
1966). A formula is refused if its range is not finite. Values and the ends of the range are
computed by the same floating-point operations. Each operation is monotone between the ends of its
arguments' ranges and zero, and rounding is monotone, so every computed value is in the range.
"""

import ast
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache, partial, reduce
from itertools import pairwise, product
import math
from typing import Any, Final

from humanopts_env.arrays import Floats, Rows
from humanopts_env.domains.base import ActableDomain, DomainError, Feature, FeatureKind
import numpy as np

MAX_LENGTH = 200  # characters of a formula
MAX_DEPTH = 30  # nesting levels of a formula
NO_YES: Final = ('no', 'yes')  # values of a comparison

Source = int | str
"""Index of a feature in its domain, or a formula over such indices, as ``x[3] - x[5]``."""


class FormulaError(DomainError):
    """A text is not the formula of a derived feature; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class FeatureColumn:
    """A feature of a domain or a derived feature, and its source in rows (N, F)."""

    feature: Feature
    source: Source

    def values(self, rows: Rows) -> Floats:
        """Return the feature's values (N,) in rows (N, F)."""
        return column_values(self.source, rows)

    def text(self, row: Floats) -> str:
        """Return the text of the feature's value in one row (F,)."""
        return self.feature.text(self.values(row[None])[0])


def feature_columns(domain: ActableDomain, names: Iterable[str]) -> list[FeatureColumn]:
    """
    Return features by name, independent of the order of ``names``.

    :return: features of the domain in its order, then derived features by name.
    :raises DomainError: a name is neither a feature of the domain nor a formula over features.
    """
    wanted = set(names)
    found = [
        FeatureColumn(feature, index)
        for index, feature in enumerate(domain.features)
        if feature.name in wanted
    ]
    derived = sorted(wanted.difference(column.feature.name for column in found))
    found += [derive(domain, name) for name in derived]
    for column, name in zip(found[len(found) - len(derived) :], derived):
        if column.feature.name != name:
            raise FormulaError(f'{name!r} must be written as {column.feature.name!r}')
    return found


def column_values(source: Source, rows: Rows) -> Floats:
    """Return a feature's values (N,) in rows (N, F)."""
    if isinstance(source, int):
        return rows[:, source]
    values: Floats = _compiled(source)(rows.T) + 0.0  # avoids -0.0
    return values


def stacked(columns: Sequence[FeatureColumn], rows: Rows) -> Rows:
    """Return the values (N, C) of C features in rows (N, F)."""
    return np.column_stack([rows[:, :0], *(column.values(rows) for column in columns)])


def derive(domain: ActableDomain, text: str) -> FeatureColumn:
    """
    Return the derived feature of a formula; its name is the formula in normal form.

    :raises FormulaError: the text is not a formula over features of the domain, is too long, has
        a range that is not finite, is constant, or is only the name of a feature.
    """
    return _derive(domain.name, tuple(domain.features), text)


@lru_cache(maxsize=1000)
def _derive(domain: str, features: tuple[Feature, ...], text: str) -> FeatureColumn:
    if len(text) > MAX_LENGTH:
        raise FormulaError(
            f'the formula has {len(text)} characters; at most {MAX_LENGTH} are allowed'
        )
    try:
        node = ast.parse(text.strip(), mode='eval').body
        depth = _depth(node)
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise FormulaError(
            f'{text!r} is not a formula; write one like a - 0.5 * b, hypot(a, b) or a > 0.1'
        ) from None
    if depth > MAX_DEPTH:
        raise FormulaError(
            f'{text!r} is nested too deeply; at most {MAX_DEPTH} levels are allowed'
        )
    name = ast.unparse(node)
    part = _Reader(domain, features).read(node)
    if isinstance(node, ast.Name):
        raise FormulaError(f'{name} is already a feature')
    if part.low == part.high or 'x[' not in part.source:
        always = f'always {NO_YES[int(part.low)]}' if part.truth else 'the same in every state'
        raise FormulaError(f'{name!r} says nothing about the state: it is {always}')
    words = _words(node)
    if part.truth:
        feature = Feature.nominal(name, f'whether {words}', NO_YES)
    else:
        unit = part.unit or ''
        feature = Feature.continuous(name, f'the value of {words}', part.low, part.high, unit)
    return FeatureColumn(feature, part.source)


def plain_name(name: str) -> str:
    """Return the name of a feature in words; a formula is put in parentheses."""
    return name.replace('_', ' ') if name.isidentifier() else f'({name})'


# Conversion of a formula over names to a formula over indices.


@dataclass(frozen=True, slots=True)
class _Part:
    """A part of a formula: a number, a comparison, a nominal feature, or a text constant."""

    source: str  # formula over indices
    low: float = 0.0
    high: float = 0.0
    unit: str | None = None  # None: a constant, which fits every unit
    truth: bool = False  # a comparison, 0 or 1
    words: tuple[str, ...] = ()  # texts of the values of a nominal or ordinal feature
    nominal: bool = False  # not a number
    text: str | None = None  # value of a text constant


@dataclass(frozen=True, slots=True)
class _Function:
    """
    A function of numbers.

    Its extreme values over a box are at corners of the box, or where an argument is 0.
    """

    values: Callable[..., Any]
    words: str  # with a placeholder for each argument
    unit: Callable[..., str | None]
    arguments: int


def _common(*units: str | None) -> str | None:
    """Return the common unit of the parts except constants; empty if their units differ."""
    known = {unit for unit in units if unit is not None}
    return None if not known else known.pop() if len(known) == 1 else ''


def _scaled(left: str | None, right: str | None) -> str | None:
    """Return the unit of a product; it is known only if a factor is constant."""
    return _common(left, right) if None in (left, right) else ''


def _hypot(a: Any, b: Any) -> Any:
    return np.sqrt(a * a + b * b)  # monotone, unlike np.hypot


_OPERATORS: dict[type[ast.AST], tuple[str, _Function]] = {
    ast.Add: ('+', _Function(np.add, '{} plus {}', _common, 2)),
    ast.Sub: ('-', _Function(np.subtract, '{} minus {}', _common, 2)),
    ast.Mult: ('*', _Function(np.multiply, '{} times {}', _scaled, 2)),
    ast.Div: (
        '/',
        _Function(
            np.divide,
            '{} divided by {}',
            lambda left, right: left if right is None else '',
            2,
        ),
    ),
}
_FUNCTIONS = {
    'abs': _Function(np.abs, 'the size of {}', _common, 1),
    'min': _Function(np.minimum, 'the smaller of {} and {}', _common, 2),
    'max': _Function(np.maximum, 'the larger of {} and {}', _common, 2),
    'clip': _Function(
        lambda a, low, high: np.minimum(np.maximum(a, low), high),
        '{} limited to the range {} to {}',
        _common,
        3,
    ),
    'hypot': _Function(_hypot, 'the distance over {} and {}', _common, 2),
    'atan2': _Function(np.arctan2, 'the angle of {} over {}', lambda *_: 'rad', 2),
    'sqrt': _Function(np.sqrt, 'the square root of {}', lambda unit: '', 1),
}
_COMPARISONS: dict[type[ast.AST], tuple[str, str, Callable[..., Any]]] = {
    ast.Lt: ('<', 'is below', np.less),
    ast.LtE: ('<=', 'is at most', np.less_equal),
    ast.Gt: ('>', 'is above', np.greater),
    ast.GtE: ('>=', 'is at least', np.greater_equal),
    ast.Eq: ('==', 'is', np.equal),
    ast.NotEq: ('!=', 'is not', np.not_equal),
}


class _Reader:
    """Reads formulas over the features of a domain."""

    def __init__(self, domain: str, features: Sequence[Feature]) -> None:
        self._domain, self._features = domain, features
        self._known = {feature.name: at for at, feature in enumerate(features)}

    def read(self, node: ast.AST) -> _Part:
        """
        Return a node as a part of a formula.

        :raises FormulaError: the node is invalid.
        """
        match node:
            case ast.Name(name):
                return self._feature(name)
            case ast.Constant(str() as text):
                return _Part('', text=text)
            case ast.Constant(int() | float() as value) if not isinstance(value, bool):
                number = float(value) if abs(value) < 1e300 else math.inf
                return _checked(_Part(repr(number), number, number), node)
            case ast.UnaryOp(ast.USub(), inner):
                part = self._number(inner)
                return _Part(f'(-{part.source})', -part.high, -part.low, part.unit)
            case ast.UnaryOp(ast.Not(), inner):
                return _negated(self._truth(inner))
            case ast.BinOp(left, op, right) if type(op) in _OPERATORS:
                sign, function = _OPERATORS[type(op)]
                parts = self._number(left), self._number(right)
                if isinstance(op, ast.Div) and parts[1].low <= 0 <= parts[1].high:
                    raise FormulaError(
                        f'{ast.unparse(right)!r} can be 0, so nothing can be divided by it'
                    )
                source = f'({parts[0].source} {sign} {parts[1].source})'
                return _applied(function, parts, source, node)
            case ast.BoolOp(op, values):
                name = 'min' if isinstance(op, ast.And) else 'max'
                truths = [self._truth(each) for each in values]
                return reduce(partial(_joined, name), truths)
            case ast.Compare(left, ops, rights) if all(type(op) in _COMPARISONS for op in ops):
                sides = pairwise([left, *rights])
                pairs = [self._compared(a, op, b) for op, (a, b) in zip(ops, sides)]
                return reduce(partial(_joined, 'min'), pairs)
            case ast.Call(ast.Name(name), args, keywords=[]):
                return self._call(name, args, node)
        raise FormulaError(
            f'{ast.unparse(node)!r} cannot be part of a formula; use + - * /, comparisons, and, '
            f'or, not, {", ".join(_FUNCTIONS)}'
        )

    def _feature(self, name: str) -> _Part:
        if name not in self._known:
            near = get_close_matches(name, self._known, 3)
            advice = f'did you mean {" or ".join(near)}?' if near else ''
            raise FormulaError(
                f'{self._domain} has no feature {name!r}; '
                f'{advice or "it has " + ", ".join(self._known)}'
            )
        feature = self._features[self._known[name]]
        source = f'x[{self._known[name]}]'
        if feature.kind is FeatureKind.CONTINUOUS:
            return _Part(source, feature.low, feature.high, feature.unit)
        if feature.kind is FeatureKind.NOMINAL:
            high, truth = float(len(feature.values) - 1), feature.values == NO_YES
            return _Part(source, 0.0, high, '', truth, feature.values, nominal=True)
        numbers = _numbers(feature.values)
        if numbers != list(range(len(numbers))):
            source = f'pick({source}, {", ".join(map(repr, numbers))})'
        return _Part(source, min(numbers), max(numbers), '', words=feature.values)

    def _number(self, node: ast.AST) -> _Part:
        part = self.read(node)
        if part.text is None and (part.truth or not part.nominal):
            return part
        text = ast.unparse(node)
        if part.nominal:
            example = f'{text} == {part.words[-1]!r}'
            raise FormulaError(f'{text} is not a number: compare it, as in {example}')
        raise FormulaError(f'{text} is not a number')

    def _truth(self, node: ast.AST) -> _Part:
        part = self.read(node)
        if not part.truth:
            raise FormulaError(
                f'{ast.unparse(node)!r} is neither yes nor no, so it cannot be joined by and, or, '
                'not; compare it first'
            )
        return part

    def _call(self, name: str, args: Sequence[ast.AST], node: ast.AST) -> _Part:
        function = _FUNCTIONS.get(name)
        if function is None:
            raise FormulaError(f'unknown function {name!r}; choose from {", ".join(_FUNCTIONS)}')
        if len(args) != function.arguments:
            raise FormulaError(
                f'{name} takes {function.arguments} arguments, not {len(args)}: '
                f'{ast.unparse(node)!r}'
            )
        parts = [self._number(arg) for arg in args]
        if name == 'sqrt' and parts[0].low < 0:
            raise FormulaError(f'{ast.unparse(args[0])!r} can be negative, so it has no root')
        source = f'{name}({", ".join(part.source for part in parts)})'
        part = _applied(function, parts, source, node)
        return replace(part, low=-math.pi, high=math.pi) if name == 'atan2' else part

    def _compared(self, left: ast.AST, op: ast.AST, right: ast.AST) -> _Part:
        sign, _, compare = _COMPARISONS[type(op)]
        parts = self.read(left), self.read(right)
        if any(part.text is not None or part.nominal for part in parts):
            parts = self._by_text(parts, (left, right))
            if sign not in ('==', '!=') and any(part.nominal for part in parts):
                raise FormulaError(
                    f'{ast.unparse(left)} and {ast.unparse(right)} have no order: use == or !='
                )
        elif any(part.truth for part in parts):
            raise FormulaError(f'join {ast.unparse(left)!r} with and, or, not instead of {sign}')
        a, b = parts
        if sign in ('==', '!='):
            possible = a.low <= b.high and b.low <= a.high
            certain = a.low == a.high == b.low == b.high
            low, high = float(certain), float(possible)
            if sign == '!=':
                low, high = 1 - high, 1 - low
        else:
            found = [compare(*corner) for corner in product((a.low, a.high), (b.low, b.high))]
            low, high = float(min(found)), float(max(found))
        return _Part(f'({a.source} {sign} {b.source})', low, high, '', truth=True)

    def _by_text(
        self, parts: tuple[_Part, _Part], nodes: tuple[ast.AST, ast.AST]
    ) -> tuple[_Part, _Part]:
        """Convert the sides of a comparison of texts to numbers, equal for equal texts."""
        known = next((part for part in parts if part.words), None)
        if known is None or not all(part.words or part.text is not None for part in parts):
            left, right = map(ast.unparse, nodes)
            raise FormulaError(
                f'{left} and {right} cannot be compared: one must be a feature whose '
                'values are texts, and the other such a feature or one of its texts'
            )
        for part, other in zip(parts, reversed(nodes)):
            if part.text is not None and part.text not in known.words:
                name = ast.unparse(other)
                raise FormulaError(
                    f'{name} is never {part.text!r}; its values are {", ".join(known.words)}'
                )
        if not any(part.nominal for part in parts):  # an ordinal feature and a text
            code = dict(zip(known.words, _numbers(known.words)))
        else:
            texts = dict.fromkeys(word for part in parts for word in part.words)
            code = {text: float(at) for at, text in enumerate(texts)}
        sides = []
        for part, node in zip(parts, nodes):
            if part.text is not None:
                value = code[part.text]
                sides.append(replace(part, source=repr(value), low=value, high=value, text=None))
            elif any(each.nominal for each in parts):
                codes = [code[word] for word in part.words]
                source = f'x[{self._known[ast.unparse(node)]}]'
                if codes != list(range(len(codes))):
                    source = f'pick({source}, {", ".join(map(repr, codes))})'
                sides.append(
                    replace(part, source=source, low=min(codes), high=max(codes), nominal=True)
                )
            else:
                sides.append(part)
        return sides[0], sides[1]


def _numbers(words: Sequence[str]) -> list[float]:
    """Return the number for each ordinal value."""
    found: list[float] = []
    numeric = True
    for word in words:
        try:
            numeric = numeric and math.isfinite(float(word))
        except ValueError:
            numeric = False
        found.append(float(word) if numeric else found[-1] + 1 if found else 0.0)
    return found


def _applied(function: _Function, parts: Sequence[_Part], source: str, node: ast.AST) -> _Part:
    """Return the result of a function, with its range."""
    ends = [[part.low, part.high, *([0.0] if part.low < 0 < part.high else [])] for part in parts]
    with np.errstate(all='ignore'):
        found = [float(function.values(*corner)) for corner in product(*ends)]
    finite = all(map(math.isfinite, found))
    low, high = (min(found), max(found)) if finite else (-math.inf, math.inf)
    unit = function.unit(*(part.unit for part in parts))
    return _checked(_Part(source, low, high, unit), node)


def _checked(part: _Part, node: ast.AST) -> _Part:
    if not math.isfinite(part.high - part.low):
        raise FormulaError(f'{ast.unparse(node)!r} can be too large for a number')
    return part


def _negated(part: _Part) -> _Part:
    return _Part(f'(1 - {part.source})', 1 - part.high, 1 - part.low, '', truth=True)


def _joined(name: str, left: _Part, right: _Part) -> _Part:
    """Join comparisons with ``min`` (and) or ``max`` (or)."""
    join = min if name == 'min' else max
    low, high = join(left.low, right.low), join(left.high, right.high)
    return _Part(f'{name}({left.source}, {right.source})', low, high, '', truth=True)


def _depth(node: ast.AST) -> int:
    return 1 + max(map(_depth, ast.iter_child_nodes(node)), default=0)


def _words(node: ast.AST) -> str:
    """Return a valid formula in words."""

    def inner(part: ast.AST) -> str:
        compound = isinstance(part, ast.BinOp | ast.BoolOp | ast.Compare | ast.UnaryOp)
        return f'({_words(part)})' if compound else _words(part)

    match node:
        case ast.Name(name):
            return plain_name(name)
        case ast.Constant(value):
            return str(value)
        case ast.UnaryOp(op, part):
            return f'{"not" if isinstance(op, ast.Not) else "minus"} {inner(part)}'
        case ast.BinOp(left, op, right):
            return _OPERATORS[type(op)][1].words.format(inner(left), inner(right))
        case ast.BoolOp(op, values):
            return (' and ' if isinstance(op, ast.And) else ' or ').join(map(inner, values))
        case ast.Compare(left, ops, rights):
            sides = zip(pairwise([left, *rights]), ops)
            return ' and '.join(
                f'{inner(a)} {_COMPARISONS[type(op)][1]} {inner(b)}' for (a, b), op in sides
            )
        case ast.Call(ast.Name(name), args):
            return _FUNCTIONS[name].words.format(*map(inner, args))
    raise AssertionError(node)


# Evaluation of a formula over indices.


@lru_cache(maxsize=1000)
def _compiled(source: str) -> Callable[[Floats], Any]:
    """
    Compile a formula over indices, which may come from a file.

    :raises FormulaError: the formula is invalid.
    """
    try:
        return _evaluator(ast.parse(source, mode='eval').body)
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise FormulaError(f'{source!r} is not a formula over indices') from None


def _evaluator(node: ast.AST) -> Callable[[Floats], Any]:
    """Return a function that computes a formula's values (N,) from columns (F, N)."""
    function: Callable[..., Any]
    match node:
        case ast.Constant(int() | float() as value):
            number = float(value)
            return lambda columns: number
        case ast.Subscript(ast.Name('x'), ast.Constant(int() as index)):
            return lambda columns: columns[index]
        case ast.UnaryOp(ast.USub(), part):
            function, parts = np.negative, [part]
        case ast.BinOp(left, op, right) if type(op) in _OPERATORS:
            function, parts = _OPERATORS[type(op)][1].values, [left, right]
        case ast.Compare(left, [op], [right]) if type(op) in _COMPARISONS:
            compare, parts = _COMPARISONS[type(op)][2], [left, right]
            function = lambda a, b: np.asarray(compare(a, b), dtype=np.float64)  # noqa: E731
        case ast.Call(ast.Name(name), parts) if name in _FUNCTIONS:
            function = _FUNCTIONS[name].values
        case ast.Call(ast.Name('pick'), parts):
            function = _pick
        case _:
            raise ValueError(f'{type(node).__name__} is not allowed')
    arguments = [_evaluator(part) for part in parts]
    return lambda columns: function(*[argument(columns) for argument in arguments])


def _pick(index: Floats, *numbers: float) -> Floats:
    """Return the number for each ordinal or nominal value (N,)."""
    return np.array(numbers)[np.asarray(index, dtype=np.intp)]
