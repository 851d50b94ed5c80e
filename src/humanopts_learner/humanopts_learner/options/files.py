"""Option files: versioned, readable JSON that includes the demonstrations."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import cache
import hashlib
import json
import os
from pathlib import Path
import re
from typing import Any, Literal

from humanopts_learner.append_only_log import link_remark, refuse_link, sync, unused_name
from humanopts_learner.demonstrations import (
    Count,
    Demonstration,
    option_name_fault,
    Real,
    TREES,
)
from humanopts_learner.options.decision_tree import LEAF, Tree, TreeError
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_ros.limits import JsonError, MAX_JSON, parse_json
from humanopts_ros.text_files import fault_in, FileError, read_text
import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

FORMAT = 'humanopts-option'
VERSION = 1
SLUG_LENGTH = 48
PARTS = ('policy', 'initiation', 'termination')


class OptionFileError(OptionError):
    """An option file is unusable; the message names the file and the error."""


def option_to_json(
    option: LearnedOption, demonstrations: Sequence[Demonstration] = (), status: str = ''
) -> str:
    """
    Return the option as JSON, with one tree node or demonstration per line.

    :param demonstrations: demonstrations from which it was learned, or none.
    :param status: learning status (``OptionSummary.status``), for readers of the file.
    """
    values = {field.name: getattr(option, field.name) for field in fields(option)}
    if option.method == TREES:
        del values['method']
    if option.policy_encoding == option.encoding:
        del values['policy_encoding']
    if not option.most_visits:
        del values['most_visits']
    values['domain_parameters'] = json.loads(option.domain_parameters)
    values |= {part: _tree_data(values.pop(part)) for part in PARTS}
    for key in ('encoding', 'policy_encoding'):
        values |= {key: [asdict(encoded) for encoded in values[key]]} if key in values else {}
    values['demonstrations'] = [json.loads(demo.to_json()) for demo in demonstrations]
    head = {'format': FORMAT, 'version': VERSION, **({'status': status} if status else {})}
    return _pretty({**head, **values}) + '\n'


class _Values(BaseModel):
    model_config = ConfigDict(frozen=True, extra='forbid')


class _Node(_Values):
    """A node of a tree; a leaf has only counts."""

    column: Count = LEAF
    at_most: Real = 0.0
    left: Count = LEAF
    right: Count = LEAF
    counts: tuple[Count, ...]


class _Tree(_Values):
    columns: Count
    classes: tuple[Count, ...]
    nodes: tuple[_Node, ...]
    roots: tuple[Count, ...] = (0,)  # more than one in a forest

    def tree(self) -> Tree:
        """
        Return the tree.

        :raises TreeError: the nodes are not a tree.
        """
        if {len(node.counts) for node in self.nodes} != {len(self.classes)}:
            raise TreeError(f'a node of a tree has not {len(self.classes)} counts')
        return Tree(
            np.array([node.left for node in self.nodes], dtype=np.int32),
            np.array([node.right for node in self.nodes], dtype=np.int32),
            np.array([node.column for node in self.nodes], dtype=np.int32),
            np.array([node.at_most for node in self.nodes], dtype=np.float64),
            np.array([node.counts for node in self.nodes], dtype=np.int64),
            self.classes,
            self.columns,
            self.roots,
        )


def _tree_data(tree: Tree) -> dict[str, Any]:
    arrays = tree.feature, tree.threshold, tree.left, tree.right, tree.counts
    nodes = [dict(zip(_Node.model_fields, each)) for each in zip(*(a.tolist() for a in arrays))]
    nodes = [node if node['left'] != LEAF else {'counts': node['counts']} for node in nodes]
    roots = {'roots': list(tree.roots)} if len(tree.roots) > 1 else {}
    return {'columns': tree.n_features, 'classes': list(tree.classes), **roots, 'nodes': nodes}


class _OptionFile(BaseModel):
    """An option file; the other keys are those of ``LearnedOption``."""

    model_config = ConfigDict(extra='allow')

    format: Literal['humanopts-option']
    version: Literal[1]
    status: str = ''
    domain_parameters: dict[str, Any]
    policy: _Tree
    initiation: _Tree
    termination: _Tree
    demonstrations: tuple[Demonstration, ...]


@cache
def _option_adapter() -> TypeAdapter[LearnedOption]:
    return TypeAdapter(LearnedOption)


def option_from_json(text: str) -> tuple[LearnedOption, list[Demonstration]]:
    """
    Read the output of ``option_to_json``.

    :raises OptionFileError: the text is not an option, has an unknown version, or is damaged.
    """
    try:
        data = _OptionFile.model_validate(parse_json(text))
        parameters = json.dumps(data.domain_parameters, sort_keys=True)
        option = _option_adapter().validate_python(
            {
                **(data.model_extra or {}),
                **{part: getattr(data, part).tree() for part in PARTS},
                'domain_parameters': parameters,
            }
        )
        demonstrations = list(data.demonstrations)
        for name in {option.name, *(demo.option_name for demo in demonstrations)}:
            if fault := option_name_fault(name):
                raise OptionFileError(fault)
    except JsonError as error:
        raise OptionFileError(f'it is not JSON: {error}') from error
    except ValidationError as error:
        raise OptionFileError(fault_in(error)) from error
    except OptionFileError:
        raise
    except (TreeError, OptionError) as error:
        raise OptionFileError(str(error)) from error
    if tuple(dict.fromkeys(encoded.feature for encoded in option.encoding)) != option.features:
        raise OptionFileError('its encoded features are not those that it names')
    if demonstrations and {demo.uuid for demo in demonstrations} != set(option.uuids):
        raise OptionFileError('its demonstrations are not those that it was learned from')
    return option, demonstrations


def option_path(directory: Path, participant: str, name: str) -> Path:
    """Return the path of an option file."""
    return directory / _slug(participant) / f'{_slug(name)}.json'


def save_option(
    directory: Path,
    option: LearnedOption,
    demonstrations: Sequence[Demonstration],
    status: str = '',
) -> Path:
    """
    Write an option file atomically.

    An existing file that is damaged or belongs to another option is renamed and kept.

    :param demonstrations: as in ``option_to_json``.
    :param status: as in ``option_to_json``.
    :return: path of the file.
    :raises OSError: writing failed; any existing file is unchanged.
    """
    path = option_path(directory, option.participant, option.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    refuse_link(path.parent)
    temporary = path.with_name(f'.{path.name}.{os.getpid()}.tmp')
    try:
        with temporary.open('w', encoding='utf-8') as file:
            file.write(option_to_json(option, demonstrations, status))
            file.flush()
            os.fsync(file.fileno())
        if path.exists() and not _is_of(path, option.participant, option.name):
            path.rename(unused_name(path, 'damaged'))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync(path.parent)
    return path


def remove_option(directory: Path, participant: str, name: str) -> None:
    """
    Remove the file of an option, if it exists; a file of another option is kept.

    :raises OSError: it cannot be removed.
    """
    path = option_path(directory, participant, name)
    if path.exists() and _is_of(path, participant, name):
        path.unlink()
        sync(path.parent)


def load_option(path: Path) -> tuple[LearnedOption, list[Demonstration]]:
    """
    Read one option file.

    :raises OptionFileError: it cannot be read, or is damaged.
    """
    try:
        return option_from_json(read_text(path, MAX_JSON))
    except FileError as error:
        raise OptionFileError(str(error)) from error
    except OptionFileError as error:
        raise OptionFileError(f'{path} cannot be used: {error}') from error


def load_options(directory: Path) -> tuple[list[LearnedOption], list[OptionFileError]]:
    """
    Read every option file of a folder, sorted by path.

    Symbolic links in the folder are not followed.

    :return: the options, and the errors of unusable files, which are left unchanged. If the folder
        itself is a symbolic link, an error says so.
    """
    options: list[LearnedOption] = []
    problems: list[OptionFileError] = []
    if remark := link_remark(directory):
        problems.append(OptionFileError(remark))
    for path in sorted(directory.glob('*/*.json')):
        try:
            if link := next((each for each in (path.parent, path) if each.is_symlink()), None):
                raise OptionFileError(f'{path} is left out: {link} is a symbolic link')
            options.append(load_option(path)[0])
        except OptionFileError as error:
            problems.append(error)
    return options, problems


def _pretty(data: Mapping[str, Any]) -> str:
    """Format an object with one line for each entry, and for each object in a list."""
    lines = []
    for key, value in data.items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, dict) and 'nodes' in value:
            text = _pretty(value).replace('\n', '\n  ')
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            items = ',\n'.join(f'    {json.dumps(item, allow_nan=False)}' for item in value)
            text = f'[\n{items}\n  ]'
        lines.append(f'  {json.dumps(key)}: {text}')
    return '{\n' + ',\n'.join(lines) + '\n}'


def _slug(name: str) -> str:
    """Return a unique and readable file name."""
    readable = re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')[:SLUG_LENGTH]
    if readable == name and not re.search(r'-[0-9a-f]{8}$', name):
        return name
    return f'{readable}-{hashlib.sha256(name.encode()).hexdigest()[:8]}'.lstrip('-')


def _is_of(path: Path, participant: str, name: str) -> bool:
    try:
        found, _ = load_option(path)
    except OptionFileError:
        return False
    return (found.participant, found.name) == (participant, name)
