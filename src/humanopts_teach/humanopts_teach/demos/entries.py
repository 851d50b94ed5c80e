"""What is kept of a lesson: one line of JSON for each thing that the person said or showed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
import json
from typing import Any

from humanopts_learner.demonstrations import Demonstration, DemonstrationError

VERSION = 1  # of the line format


class EntryError(ValueError):
    """A line is not an entry; the text says why."""


@dataclass(frozen=True, slots=True)
class SessionOpened:
    """A participant began a sitting, or went on with it."""

    domain: str
    domain_parameters: str  # JSON object
    participant: str
    session: str


@dataclass(frozen=True, slots=True)
class OptionDefined:
    """An option was named, or taken up again."""

    domain: str
    domain_parameters: str
    participant: str
    session: str
    option_name: str
    ask_again: bool  # the answers given before count no longer


@dataclass(frozen=True, slots=True)
class FeatureAnswered:
    """One feature question was answered."""

    domain: str
    domain_parameters: str
    participant: str
    session: str
    option_name: str
    feature: str
    yes: bool


Entry = SessionOpened | OptionDefined | FeatureAnswered | Demonstration
_DIALOGUE: Mapping[str, type[SessionOpened | OptionDefined | FeatureAnswered]] = {
    'session': SessionOpened,
    'option': OptionDefined,
    'answer': FeatureAnswered,
}
_DEMONSTRATION = 'demonstration'
_NAMES = {kind: name for name, kind in _DIALOGUE.items()}


def entry_to_line(entry: Entry) -> str:
    """Return the entry as one line of JSON, without the line's end."""
    if isinstance(entry, Demonstration):
        name, values = _DEMONSTRATION, json.loads(entry.to_json())
    else:
        name, values = _NAMES[type(entry)], asdict(entry)
    return json.dumps({'version': VERSION, 'entry': name, **values}, sort_keys=True)


def entry_from_line(line: str) -> Entry:
    """
    Read what ``entry_to_line`` wrote.

    :raises EntryError: it is not JSON, of another version, or a field is missing or wrong.
    """
    try:
        values = json.loads(line)
    except json.JSONDecodeError as error:
        raise EntryError(f'it is not JSON: {error}') from None
    if not isinstance(values, dict) or values.get('version') != VERSION:
        raise EntryError(f'it is not an entry of version {VERSION}')
    name = str(values.get('entry'))
    try:
        if name == _DEMONSTRATION:
            return Demonstration.from_fields(values)
        if name in _DIALOGUE:
            return _dialogue_entry(_DIALOGUE[name], values)
    except DemonstrationError as error:
        raise EntryError(str(error)) from None
    raise EntryError(f'it has an unknown kind of entry, {name!r}')


def _dialogue_entry(
    kind: type[SessionOpened | OptionDefined | FeatureAnswered], values: Mapping[str, Any]
) -> Entry:
    found: dict[str, Any] = {field.name: values.get(field.name) for field in fields(kind)}
    for field in fields(kind):
        if type(found[field.name]) is not field.type:
            raise EntryError(f'its field {field.name} is missing or wrong')
    return kind(**found)
