"""Message, service and action types by name, and messages built from the values of a file."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from humanopts_env.worlds.sensors import placed
from humanopts_env.worlds.world_file import Place, WorldFileError


def interface(name: str) -> Any:
    """
    Return the class of a type such as ``nav_msgs/msg/Odometry``.

    :raises WorldFileError: the type is not installed.
    """
    package, kind, short = name.split('/')
    try:
        return getattr(import_module(f'{package}.{kind}'), short)
    except (ImportError, AttributeError) as error:
        raise WorldFileError(
            f'the type {name} is not installed: {error}; install or build {package}'
        ) from None


def filled(message: Any, values: Mapping[str, Any], places: Mapping[str, Place], key: str) -> Any:
    """
    Set fields of a message, and return it.

    :param values: values by field; a mapping sets the fields of a nested message, and the name of
        a place sets a pose.
    :param key: location of the values in the file.
    :raises WorldFileError: the type has no such field, or a value does not fit.
    """
    types = message.get_fields_and_field_types()
    message._check_fields = True  # usually off, since it takes time
    for name, value in values.items():
        inside = f'{key} {name}'
        if name not in types:
            raise WorldFileError(
                f'{inside}: {type(message).__name__} has no such field; it has {", ".join(types)}'
            )
        part = getattr(message, name)
        is_message = hasattr(part, 'get_fields_and_field_types')
        if is_message and isinstance(value, str) and hasattr(part, 'orientation'):
            if value not in places:
                known = ', '.join(places) or 'none'
                raise WorldFileError(f'{inside}: unknown place {value!r}; the file has {known}')
            value = placed(places[value])
        if is_message and isinstance(value, Mapping):
            filled(part, value, places, inside)
            continue
        if isinstance(value, list):
            element = types[name].removeprefix('sequence<').partition('[')[0].rstrip('>')
            element = element.partition(',')[0]
            if '/' in element:
                package, _, short = element.partition('/')
                kind = interface(f'{package}/msg/{short}')
                value = [filled(kind(), each, places, inside) for each in value]
            elif element in ('float', 'double'):
                value = [float(each) if type(each) is int else each for each in value]
        if isinstance(part, float) and type(value) is int:
            value = float(value)
        try:
            setattr(message, name, value)
        except (AssertionError, TypeError, ValueError, AttributeError) as error:
            why = str(error).splitlines()[0] if str(error) else f'{value!r} does not fit'
            raise WorldFileError(f'{inside}: {why}') from None
    return message
