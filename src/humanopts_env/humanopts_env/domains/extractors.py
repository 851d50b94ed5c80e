"""
Features of an environment, read from its observations or by a function that a researcher writes.

An extractor is a function ``features(env) -> Mapping[str, value]`` in a file or a module. Values
are bools, numbers, texts, members of an Enum, or None. The module may also define ``RANGES`` (by
feature name), ``QUESTIONS`` (completing "Does OPTION depend on ...?") and ``ACTIONS`` (the names
of the actions, or their descriptions by name). A range is

- ``(0.0, 14.2)`` or ``(0.0, 14.2, 'm')``: numbers, optionally with a unit,
- ``(0, 9)`` or ``(0, 9, 'none')``: whole numbers, optionally with a text for None,
- ``('wall', 'free')``: texts.

``RANGES`` may be a function of the environment. Undeclared ranges are measured; see
``measured_range``. A function ``PREPARE`` is called with each new environment, for instance to
turn off slow, unused observations.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
import importlib
import importlib.util
import math
import numbers
import operator
from pathlib import Path
import re
from typing import Any

from gymnasium import spaces
from humanopts_env.domains.base import DomainError, Feature, FeatureKind
from humanopts_env.domains.check import NAME
from humanopts_env.domains.names import registered
import numpy as np

EXTRACTORS = 'humanopts.features'  # group of entry points
OBSERVATION = 'observation'  # name of the features read from the observation space
MAX_NUMBERS = 64  # in a Box that is not an image
MAX_NOMINAL = 20  # values of an unordered Discrete
YES_NO = ('no', 'yes')
OTHER = 'other'  # a text that was not seen when the range was measured
WIDER = 3.0  # minimum ratio of a measured range to the values seen
Read = Callable[[Any, Any], Sequence[float]]  # environment, observation
Samples = Iterable[tuple[Any, Any]]  # environment, which changes, and observation


@dataclass(frozen=True)
class Extractor:
    """Features, and the function that reads them from an environment and its observation."""

    name: str  # value of the domain's parameter ``features``
    features: tuple[Feature, ...]
    read: Read
    ranges: dict[str, list[Any]] = field(default_factory=dict)  # given or measured
    actions: Mapping[str, str] = field(default_factory=dict)  # descriptions by name
    prepare: Callable[[Any], object] = bool  # called with each new environment


# Features of the documented observations of Gymnasium, by environment name.

OBSERVATIONS = {
    'CartPole': (
        Feature.continuous('cart_position', 'where the cart is', -4.8, 4.8, 'm'),
        Feature.continuous('cart_speed', 'how fast the cart moves', -4, 4, 'm/s'),
        Feature.continuous('pole_angle', 'how far the pole leans', -0.42, 0.42, 'rad'),
        Feature.continuous('pole_speed', 'how fast the pole turns', -5, 5, 'rad/s'),
    ),
    'MountainCar': (
        Feature.continuous('position', 'where the car is', -1.2, 0.6),
        Feature.continuous('speed', 'how fast the car moves', -0.07, 0.07),
    ),
    'Acrobot': (
        Feature.continuous('cos_1', 'the cosine of the angle of the first link', -1, 1),
        Feature.continuous('sin_1', 'the sine of the angle of the first link', -1, 1),
        Feature.continuous('cos_2', 'the cosine of the angle between the links', -1, 1),
        Feature.continuous('sin_2', 'the sine of the angle between the links', -1, 1),
        Feature.continuous('speed_1', 'how fast the first link turns', -12.6, 12.6, 'rad/s'),
        Feature.continuous('speed_2', 'how fast the second link turns', -28.3, 28.3, 'rad/s'),
    ),
    'LunarLander': (
        Feature.continuous('x', 'how far right of the pad the lander is', -2.5, 2.5),
        Feature.continuous('y', 'how high the lander is', -2.5, 2.5),
        Feature.continuous('x_speed', 'how fast the lander moves to the right', -10, 10),
        Feature.continuous('y_speed', 'how fast the lander rises', -10, 10),
        Feature.continuous('angle', 'how far the lander leans to the left', -6.3, 6.3, 'rad'),
        Feature.continuous('angular_speed', 'how fast the lander turns to the left', -10, 10),
        Feature.nominal('left_leg', 'whether the left leg touches the ground', YES_NO),
        Feature.nominal('right_leg', 'whether the right leg touches the ground', YES_NO),
    ),
}
ACTIONS = {
    'CartPole': ('push_left', 'push_right'),
    'MountainCar': ('push_left', 'coast', 'push_right'),
    'Acrobot': ('torque_minus', 'torque_zero', 'torque_plus'),
    'LunarLander': ('nothing', 'fire_left', 'fire_main', 'fire_right'),
}


def question_of(name: str) -> str:
    """Return the default question about a feature, which completes "Does it depend on"."""
    return f'what {name} is'


def observed(
    name: str, known: str, space: Any, ranges: Mapping[str, Any], samples: Iterable[Any]
) -> Extractor:
    """
    Return features read from observations.

    :param name: name of the domain, for errors.
    :param known: name of the environment, a key of ``OBSERVATIONS`` if it is documented.
    :param space: observation space.
    :param ranges: ranges of features with infinite bounds; missing ones are measured.
    :param samples: observations for measuring ranges, read only if needed.
    :raises DomainError: the space has images or parts without features.
    """
    found = OBSERVATIONS.get(known)
    if found is not None and isinstance(space, spaces.Box) and space.shape == (len(found),):
        low, high = bounds(found)
        return Extractor(OBSERVATION, found, lambda _, seen: clipped(seen, low, high))
    parts = list(_parts(name, space, ''))
    if not parts:
        raise DomainError(f'{name} has no observations that can be features; {_ADVICE}')
    features = [feature for part in parts for feature in part[0]]
    names = [feature.name for feature in features]
    _check_names(name, 'ranges', ranges, names)
    endless = [f for f in features if f.kind is FeatureKind.CONTINUOUS and not _finite(f)]
    measured = dict(ranges)
    if not all(feature.name in measured for feature in endless):
        rows = np.array([_numbers(parts, seen) for seen in samples])
        for feature in endless:
            column = rows[:, names.index(feature.name)]
            measured.setdefault(feature.name, measured_range(column.tolist()))
    made = tuple(
        feature_in(name, f.name, measured[f.name], f.question) if f.name in measured else f
        for f in features
    )
    low, high = bounds(made)
    return Extractor(
        OBSERVATION, made, lambda _, seen: clipped(_numbers(parts, seen), low, high), measured
    )


Part = tuple[list[Feature], Callable[[Any], Any]]  # features, and the reader of their values
_ADVICE = 'write an extractor, a function features(env), and give it with --features FILE.py:NAME'


def _parts(name: str, space: Any, key: str) -> Iterable[Part]:
    """Return the parts of a space with their features; text spaces have none."""
    word = key or 'observation'
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        for each, part in inner:
            long = f'{key}_{each}' if key else str(each)
            for features, numbers_of in _parts(name, part, long):
                yield features, partial(_part_of, each, numbers_of)
    elif isinstance(space, spaces.Discrete):
        first = int(space.start)
        yield [_discrete(word, int(space.n), first)], lambda seen: [int(seen) - first]
    elif isinstance(space, spaces.MultiDiscrete):
        counts, firsts = np.ravel(space.nvec), np.ravel(space.start)
        pairs = zip(counts.tolist(), firsts.tolist())
        features = [_discrete(f'{word}_{n}', *pair) for n, pair in enumerate(pairs)]
        yield features, lambda seen: np.ravel(seen) - firsts
    elif isinstance(space, spaces.MultiBinary):
        count = int(np.prod(space.shape))
        names = [_name(f'{word}_{n}') for n in range(count)]
        yield [Feature.nominal(each, question_of(each), YES_NO) for each in names], np.ravel
    elif isinstance(space, spaces.Box):
        count = int(np.prod(space.shape))
        if count > MAX_NUMBERS or (len(space.shape) > 1 and space.dtype == np.uint8):
            shape = ' x '.join(map(str, space.shape))
            raise DomainError(
                f'{name} has observations of {shape} numbers ({word}), too many to be features; '
                f'{_ADVICE}'
            )
        places: Iterable[tuple[int, ...]] = [()] if count == 1 else np.ndindex(space.shape)
        names = [_name('_'.join(map(str, (word, *place)))) for place in places]
        limits = zip(names, np.ravel(space.low).tolist(), np.ravel(space.high).tolist())
        yield (
            [Feature.continuous(n, question_of(n), low, high) for n, low, high in limits],
            np.ravel,
        )
    elif not isinstance(space, spaces.Text):
        kind = type(space).__name__
        raise DomainError(f'{name} has observations of the kind {kind} ({word}); {_ADVICE}')


def _part_of(key: Any, numbers_of: Callable[[Any], Any], seen: Any) -> Any:
    return numbers_of(seen[key])


def _discrete(word: str, count: int, first: int) -> Feature:
    """Return a feature of ``count`` numbers: unordered if there are few of them."""
    kind = FeatureKind.NOMINAL if count <= MAX_NOMINAL else FeatureKind.ORDINAL
    name = _name(word)
    return Feature(name, question_of(name), kind, tuple(map(str, range(first, first + count))))


def _name(key: str) -> str:
    """Return a feature name for a key of a space."""
    word = re.sub(r'\W+', '_', key.lower()).strip('_')
    return word if NAME.fullmatch(word) else f'observation_{word}'


def _numbers(parts: Iterable[Part], seen: Any) -> list[float]:
    return [float(each) for _, numbers_of in parts for each in numbers_of(seen)]


def _finite(feature: Feature) -> bool:
    """Return whether the range is finite; Gymnasium uses the largest float32 as infinity."""
    return max(abs(feature.low), abs(feature.high)) < 1e30


def bounds(features: Iterable[Feature]) -> tuple[list[float], list[float]]:
    """Return the lowest and the highest value of each feature."""
    pairs = [
        (f.low, f.high) if f.kind is FeatureKind.CONTINUOUS else (0, len(f.values) - 1)
        for f in features
    ]
    return [low for low, _ in pairs], [high for _, high in pairs]


def clipped(
    values: Iterable[float], lowest: Iterable[float], highest: Iterable[float]
) -> list[float]:
    """Return values clipped to their bounds, as Python floats; NaN remains NaN."""
    return [
        float(low if value < low else high if value > high else value)
        for value, low, high in zip(map(float, values), lowest, highest, strict=True)
    ]


# Ranges.


def measured_range(values: Sequence[Any]) -> list[Any]:
    """
    Return a range for sampled values.

    The bound of numbers is three times the largest magnitude, rounded up to 1, 2 or 5 times a
    power of ten, so that it hardly depends on the sample. Texts are those sampled and ``other``.
    """
    if any(isinstance(value, str) for value in values):
        return [*sorted(set(values)), OTHER]
    size = _round_up(WIDER * max(map(abs, values))) or 1.0
    return [-size if min(values) < 0 else 0.0, size]


def _round_up(size: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten; 0 stays 0."""
    if not size:
        return 0.0
    power = 10.0 ** math.floor(math.log10(size))
    return float(f'{next(n for n in (1, 2, 5, 10) if n * power >= size * (1 - 1e-9)) * power:.6g}')


def feature_in(name: str, key: str, declared: Any, question: str) -> Feature:
    """
    Return the feature with a declared range.

    :param name: name of the domain, for errors.
    :raises DomainError: ``declared`` is not a range.
    """
    if isinstance(declared, Feature):
        return declared
    given = list(declared) if isinstance(declared, Sequence | range) else []
    if isinstance(declared, range) and given:
        given = [given[0], given[-1]]
    if len(given) > 1 and all(isinstance(each, str) for each in given):
        return Feature.nominal(key, question, given)
    if len(given) in (2, 3) and all(isinstance(each, str) for each in given[2:]):
        low, high = given[:2]
        if type(low) is int and type(high) is int and low < high:
            texts = tuple(map(str, range(low, high + 1)))
            return Feature(key, question, FeatureKind.ORDINAL, (*texts, *given[2:]))
        if all(isinstance(each, int | float) for each in (low, high)) and low < high:
            return Feature.continuous(key, question, float(low), float(high), *given[2:])
    raise DomainError(
        f'{name}: the range of {key} is {declared!r}; write one like (0.0, 1.5), (0.0, 1.5, "m"), '
        '(0, 9), (0, 9, "none") or ("wall", "free")'
    )


# Functions.


def find_extractor(
    name: str, given: str, env: Any, ranges: Mapping[str, Any], samples: Callable[[], Samples]
) -> Extractor:
    """
    Return the features of an environment.

    :param name: name of the domain, for errors.
    :param given: ``FILE.py:NAME``, ``MODULE:NAME``, the name of an entry point, or
        ``observation``; empty: the entry point named like the environment's package, or else
        ``observation``.
    :param ranges: ranges that override declared and measured ones.
    :param samples: function that returns the states of random walks, read only as needed.
    :raises DomainError: the extractor cannot be loaded or used.
    """
    points = {point.name: point for point in registered(EXTRACTORS)}
    packages = [kind.__module__.partition('.')[0] for kind in type(env.unwrapped).__mro__]
    usual = next(filter(points.__contains__, packages), OBSERVATION)
    key = given or usual
    if key == OBSERVATION:
        return observed(
            name, env.spec.name, env.observation_space, ranges, (seen for _, seen in samples())
        )
    if key in points:
        module, function = _loaded(name, *points[key].value.split(':'))
    elif ':' in key:
        place, _, function_name = key.rpartition(':')
        if place.endswith('.py'):
            place = str(Path(place).absolute())  # valid in every working directory
            key = f'{place}:{function_name}'
        module, function = _loaded(name, place, function_name)
    else:
        known = ', '.join([OBSERVATION, *sorted(points)])
        raise DomainError(f'{name}: no features {key!r}; give FILE.py:NAME, or one of {known}')
    found = _extractor(name, key, module, function, env.unwrapped, ranges, samples)
    if not found.actions and usual in points:  # an extractor need not repeat the actions
        return replace(
            found, actions=_actions_in(_loaded(name, *points[usual].value.split(':'))[0])
        )
    return found


def _actions_in(module: Any) -> Mapping[str, str]:
    """Return a module's descriptions of the actions by name; empty if it has none."""
    actions = getattr(module, 'ACTIONS', {})
    if isinstance(actions, Mapping):
        return actions
    return {each: each.replace('_', ' ') for each in actions}


def _loaded(name: str, place: str, function_name: str) -> tuple[Any, Callable[[Any], Any]]:
    """Return a module and its extractor."""
    try:
        if place.endswith('.py'):
            spec = importlib.util.spec_from_file_location(Path(place).stem, place)
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except (Exception, SystemExit) as error:
        raise DomainError(
            f'{name}: the features of {place} cannot be loaded: {type(error).__name__}: {error}'
        ) from error
    if not callable(function := getattr(module, function_name, None)):
        raise DomainError(f'{name}: {place} has no function {function_name}')
    return module, function


def _extractor(
    name: str,
    key: str,
    module: Any,
    function: Callable[[Any], Any],
    env: Any,
    given: Mapping[str, Any],
    samples: Callable[[], Samples],
) -> Extractor:
    """Return the extractor of a function, with the ranges declared in its module."""
    declared = getattr(module, 'RANGES', {})
    walk = iter(samples())
    first = values_of(function, next(walk)[0])
    ranges = {**(declared(env) if callable(declared) else declared), **given}
    questions = getattr(module, 'QUESTIONS', {})
    _check_names(name, 'RANGES', ranges, first)
    _check_names(name, 'QUESTIONS', questions, first)
    measured = dict(given)
    if missing := [each for each in first if each not in ranges]:
        seen = [first, *(values_of(function, env, first) for env, _ in walk)]
        for each in missing:
            measured[each] = _measured(name, each, [values[each] for values in seen])
    features = tuple(
        feature_in(
            name, each, {**ranges, **measured}[each], questions.get(each) or question_of(each)
        )
        for each in first
    )
    coders = [(feature.name, _coder(feature)) for feature in features]

    def read(env: Any, _: Any) -> list[float]:
        values = values_of(function, env, first)
        return [code(values[each]) for each, code in coders]

    prepare = getattr(module, 'PREPARE', bool)
    return Extractor(key, features, read, measured, _actions_in(module), prepare)


def _check_names(name: str, what: str, given: Any, known: Iterable[str]) -> None:
    """
    Check the names in a declaration.

    :raises DomainError: it is not a mapping, or has a name that is not a feature.
    """
    if not isinstance(given, Mapping):
        raise DomainError(f'{name}: {what} is {given!r}, but must be given by feature name')
    names = [*known]
    if unknown := [each for each in given if each not in names]:
        raise DomainError(
            f'{name}: {what} has {unknown[0]!r}, which is not a feature; there are '
            f'{", ".join(names)}'
        )


def values_of(
    function: Callable[[Any], Any], env: Any, names: Mapping[str, Any] | None = None
) -> Mapping[str, Any]:
    """
    Call an extractor function and check its result.

    :param names: required names of the features; None: any.
    :raises ValueError: the result is not a mapping, or has other names.
    """
    values = function(env)
    if not isinstance(values, Mapping) or not values:
        raise ValueError(f'it returned {values!r}, not the values of features by name')
    if names is None:
        if bad := [each for each in values if not NAME.fullmatch(str(each))]:
            raise ValueError(f'the name {bad[0]!r} is not like agent_row, in lower case')
        return dict(values)
    if values.keys() != names.keys():
        changed = ', '.join(map(str, sorted(values.keys() ^ names.keys())))
        raise ValueError(f'it returns other names than before: {changed}')
    return values


def _measured(name: str, key: str, values: list[Any]) -> list[Any]:
    """Return the range of sampled values."""
    if all(isinstance(value, bool | np.bool_) for value in values):
        return [*YES_NO]
    values = [value.name.lower() if isinstance(value, Enum) else value for value in values]
    wrong = [v for v in values if not isinstance(v, str | numbers.Real | np.bool_ | None)]
    if wrong:
        raise DomainError(
            f'{name}: the feature {key} is of the type {type(wrong[0]).__name__}; return each of '
            'its numbers as a feature of its own, a plain number, text or bool'
        )
    texts = any(isinstance(value, str) for value in values)
    if not texts and None in values:
        raise DomainError(
            f'{name}: the feature {key} is None in some states: declare its range, such as '
            f"RANGES = {{'{key}': (0, 9, 'none')}}"
        )
    if not texts and not all(math.isfinite(value) for value in values):
        raise DomainError(f'{name}: the feature {key} is {max(values)} in some states')
    return measured_range(['none' if value is None else value for value in values])


def _coder(feature: Feature) -> Callable[[Any], float]:
    """Return a function that converts values to floats; numbers are clipped to the range."""
    texts = feature.values
    if feature.kind is FeatureKind.CONTINUOUS:
        low, high = feature.low, feature.high

        def number(value: Any) -> float:
            if not isinstance(value, numbers.Real | np.bool_):
                raise ValueError(f'{feature.name} is {value!r}, not a number')
            found = float(value)
            return low if found < low else high if found > high else found

        return number
    counts = [text.lstrip('-').isdigit() for text in texts]
    if all(counts[:-1]) and counts[0]:
        first, last = int(texts[0]), len(texts) - (1 if counts[-1] else 2)

        def whole(value: Any) -> float:
            if value is None and not counts[-1]:
                return last + 1.0
            return float(min(max(operator.index(value) - first, 0), last))

        return whole
    table: dict[Any, float] = {text: float(n) for n, text in enumerate(texts)}
    if texts == YES_NO:
        table |= {False: 0.0, True: 1.0}

    def text(value: Any) -> float:
        found = table.get(value)
        if found is None:
            word = value.name.lower() if isinstance(value, Enum) else str(value).lower()
            found = table.get(word, table.get(OTHER))
        if found is None:
            raise ValueError(f'{feature.name} is {value!r}, and its range is {texts}')
        return found

    return text
