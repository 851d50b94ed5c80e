"""
The parameters of a domain as people give them: read from text, and checked against their types.

Types are those that the constructor declares: by its annotations, else by its defaults.
"""

from collections.abc import Callable, Mapping
import inspect
import json
from typing import Any, get_type_hints

from humanopts_env.domains.base import DomainError
from humanopts_ros.limits import JsonError, parse_json, shown

MAX_PARAMETERS = 10**6  # characters of the JSON text of a domain's parameters
_PYTHON = {'True': True, 'False': False, 'None': None}
_WORDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}


def parameter_from_text(text: str) -> Any:
    """
    Return the value of a parameter that was written on a command line.

    JSON and Python's True, False and None are values; everything else is a text.

    :raises DomainError: it is JSON, and exceeds the limits of ``humanopts_ros.limits``.
    """
    if text in _PYTHON:
        return _PYTHON[text]
    try:
        json.loads(text)
    except RecursionError:
        pass  # the limits refuse it
    except json.JSONDecodeError:
        return text
    except ValueError:
        pass
    try:
        return parse_json(text, MAX_PARAMETERS)
    except JsonError as error:
        raise DomainError(f'{shown(text, 60)} cannot be used: {error}') from error


def check_parameters(
    name: str,
    constructor: Callable[..., Any],
    given: Mapping[str, Any],
    usual: Mapping[str, Any] | None = None,
) -> None:
    """
    Refuse parameters that a constructor does not take, and values that are of another type.

    :param name: of the domain.
    :param usual: values in place of the constructor's defaults.
    :raises DomainError: one is unknown, or of another type; the text says what it has to be.
    """
    try:
        parameters = inspect.signature(constructor).parameters
    except (TypeError, ValueError):  # written in C: it can only be tried
        return
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    declared = {key: each for key, each in parameters.items() if each.kind in kinds}
    takes_any = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters.values())
    if not takes_any and (unknown := [key for key in given if key not in declared]):
        takes = ', '.join(declared) or 'none'
        raise DomainError(
            f'{name} does not take the parameter {shown(", ".join(unknown), 60)}; it takes {takes}'
        )
    hints = _hints(constructor)
    for key, value in given.items():
        _check_json(name, key, value)
        default = (usual or {}).get(key, getattr(declared.get(key), 'default', None))
        if key in hints:
            _check_annotation(name, key, value, hints[key], default)
        else:
            _check_default(name, key, value, default)


def _hints(constructor: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a constructor; none where they cannot be resolved."""
    function = constructor.__init__ if inspect.isclass(constructor) else constructor
    try:
        return get_type_hints(function)
    except Exception:  # whatever another package's annotations name
        return {}


def _check_json(name: str, key: str, value: Any) -> None:
    """Refuse what a bag could not keep."""
    try:
        parse_json(json.dumps(value), MAX_PARAMETERS)
    except (TypeError, ValueError, RecursionError) as error:
        raise DomainError(f'the parameter {key} of {name} cannot be kept: {error}') from error


def _check_annotation(name: str, key: str, value: Any, annotation: Any, default: Any) -> None:
    from pydantic import PydanticUserError, TypeAdapter, ValidationError  # slow to import

    try:
        adapter = TypeAdapter(annotation)
    except (PydanticUserError, TypeError, NameError):  # no type of JSON, such as an array
        _check_default(name, key, value, default)
        return
    try:
        adapter.validate_json(json.dumps(value), strict=True)
    except ValidationError:
        kind = inspect.formatannotation(annotation)
        wanted = _WORDS.get(annotation, f'of the type {kind}')
        raise DomainError(_refusal(name, key, value, wanted, annotation)) from None


def _check_default(name: str, key: str, value: Any, default: Any) -> None:
    """Refuse a value whose type is not the default's; a number may be whole or not."""
    if default is None or default is inspect.Parameter.empty:
        return
    numbers = (int, float)
    if isinstance(default, bool):
        fits = isinstance(value, bool)
    elif isinstance(default, numbers):
        fits = isinstance(value, numbers) and not isinstance(value, bool)
    elif isinstance(default, list | tuple):
        fits = isinstance(value, list | tuple)
    elif isinstance(default, str | dict):
        fits = isinstance(value, type(default))
    else:
        return
    if not fits:
        kind = float if type(default) is int else type(default)
        wanted = _WORDS.get(kind, f'like {shown(json.dumps(default, default=str), 60)}')
        raise DomainError(_refusal(name, key, value, wanted, kind))


def _refusal(name: str, key: str, value: Any, wanted: str, kind: Any) -> str:
    text = shown(json.dumps(value, ensure_ascii=False), 60)
    hint = f'; as a text it is written {key}=\'"{text}"\'' if kind is str else ''
    return f'{key} of {name} is {text}, and has to be {wanted}{hint}'
