"""Whether what was seen live comes out of a bag again: its option files and its software."""

from collections.abc import Mapping, Sequence
import json
from typing import Any

from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.files import FORMAT, option_to_json
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.bags.provenance import software, UNKNOWN
from humanopts_teach.bags.reader import Bag

SOFTWARE = ('humanopts_version', 'numpy', 'scikit-learn')  # that learning depends on
Key = tuple[str, str]  # participant and name of an option


def attached_options(bag: Bag) -> dict[Key, Mapping[str, Any]]:
    """Return the option files that are attached to a bag; a damaged one is noted there."""
    found: dict[Key, Mapping[str, Any]] = {}
    for file in bag.attached():
        try:
            data = json.loads(file.data)
        except (ValueError, RecursionError):
            continue  # another kind of file
        if isinstance(data, dict) and data.get('format') == FORMAT:
            found[str(data.get('participant')), str(data.get('name'))] = data
    return found


def compare_options(
    attached: Mapping[Key, Mapping[str, Any]],
    options: Sequence[LearnedOption],
    demonstrations: Sequence[Demonstration],
) -> tuple[dict[Key, bool], list[str]]:
    """
    Compare option files with the same options learned again.

    :param attached: those that nobody taught, automatic options, are passed over.
    :param demonstrations: that the options were learned from, among others.
    :return: whether they are equal to the last digit, and in words where they are not.
    """
    by_uuid = {demo.uuid: demo for demo in reversed(demonstrations)}
    equal: dict[Key, bool] = {}
    notes = []
    for option in options:
        key = (option.participant, option.name)
        if key in attached:
            file, shown = attached[key], [by_uuid[uuid] for uuid in option.uuids]
            again = json.loads(option_to_json(option, shown))
            wrong = [part for part in again if again[part] != file.get(part)]
            equal[key] = not wrong
            if wrong:
                notes.append(f'{_named(key)} differs from its option file: {", ".join(wrong)}')
    lone = [key for key, file in attached.items() if key not in equal and file.get('uuids')]
    notes += [f'{_named(key)} has an option file, but was not learned again' for key in lone]
    return equal, notes


def software_notes(facts: Mapping[str, str]) -> list[str]:
    """Say which software that learning depends on is another than at the recording."""
    now = software()
    return [
        f'recorded with {name.removesuffix("_version")} {facts[name]}, and this is {now[name]}: '
        'numbers may differ'
        for name in SOFTWARE
        if facts.get(name, UNKNOWN) not in (UNKNOWN, now[name])
    ]


def _named(key: Key) -> str:
    return f'{key[1]!r} by {key[0]}'
