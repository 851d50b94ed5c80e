"""
User-provided domain parameters: parsing from text, and checking of types.

Types are those of the constructor's annotations, or else of its defaults.
"""

from collections.abc import Callable, Mapping, Sequence
import inspect
import json
from typing import Any, get_type_hints

from humanopts_env.domains.base import DomainError
from humanopts_ros.limits import JsonError, parse_json, shown

MAX_PARAMETERS = 10**6  # characters of the JSON text of a domain's parameters
_PYTHON = {'True': True, 'False': False, 'None': None}
# Accepted type by type of the default; ``type`` is the type of inspect's "no default".
_OF_DEFAULT: dict[type, Any] = {int: float, tuple: list, type(None): Any, type: Any}
_WORDS = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}


def parameter_from_text(text: str) -> Any:
    """
    Return the value of a parameter from the command line.

    JSON and Python's True, False and None are values; everything else is text.

    :raises DomainError: the text is JSON that exceeds the limits of ``humanopts_ros.limits``.
    """
    if text in _PYTHON:
        return _PYTHON[text]
    try:
        json.loads(text)
    except RecursionError:
        pass  # refused below
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
    Refuse parameters unknown to a constructor, and values of the wrong type.

    :param name: name of the domain.
    :param usual: values that replace the constructor's defaults.
    :raises DomainError: a parameter is unknown or has the wrong type; the message names the valid
        ones.
    """
    try:
        parameters = inspect.signature(constructor).parameters
    except (TypeError, ValueError):  # written in C: cannot be inspected
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
        default = type((usual or {}).get(key, getattr(declared.get(key), 'default', None)))
        types = [hints[key]] if key in hints else []
        _check_type(name, key, value, [*types, _OF_DEFAULT.get(default, default)])


def _hints(constructor: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a constructor; empty if they cannot be resolved."""
    function = constructor.__init__ if inspect.isclass(constructor) else constructor
    try:
        return get_type_hints(function)
    except Exception:  # any error in annotations of other packages
        return {}


def _check_json(name: str, key: str, value: Any) -> None:
    """Refuse values that cannot be stored in a bag."""
    try:
        parse_json(json.dumps(value), MAX_PARAMETERS)
    except (TypeError, ValueError, RecursionError) as error:
        raise DomainError(f'the parameter {key} of {name} cannot be kept: {error}') from error


def _check_type(name: str, key: str, value: Any, types: Sequence[Any]) -> None:
    """Refuse a value that does not match the first of ``types`` that is a JSON type."""
    from pydantic import PydanticUserError, TypeAdapter, ValidationError  # slow to import

    for kind in types:
        try:
            TypeAdapter(kind).validate_json(json.dumps(value), strict=True)
        except (PydanticUserError, TypeError, NameError):  # not a JSON type, such as an array
            continue
        except ValidationError:
            wanted = _WORDS.get(kind, f'of the type {inspect.formatannotation(kind)}')
            text = shown(json.dumps(value, ensure_ascii=False), 60)
            hint = f'; as a text it is written {key}=\'"{text}"\'' if kind is str else ''
            said = f'{key} of {name} is {text}, but must be {wanted}{hint}'
            raise DomainError(said) from None
        return


def parameters_from_json(name: str, parameters: str) -> dict[str, Any]:
    """
    Decode the parameters of a domain from a message.

    :raises DomainError: the parameters are not a JSON object.
    """
    try:
        values = parse_json(parameters or '{}', MAX_PARAMETERS)
    except JsonError as error:
        raise DomainError(f'the parameters of {name} are not JSON: {error}') from error
    if not isinstance(values, dict):
        raise DomainError(f'the parameters of {name} are not a JSON object: {parameters}')
    return values
