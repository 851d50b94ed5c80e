"""
Export of a bag as files: tables of its contents, and attachments.

Rows are written while the bag is read, so that even long bags need little memory.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass, fields
from functools import cache, partial
from importlib.util import find_spec
from itertools import chain, islice
import json
from pathlib import Path
from typing import Any, get_type_hints

from humanopts_env.domains.base import ActableDomain, Feature, FeatureKind
from humanopts_learner.demonstrations import Demonstration, each_once, judged, shown
from humanopts_learner.spreadsheet import EXCEL, to_cell
from humanopts_learner.summary import PlanSummary
from humanopts_teach.bags.contents import (
    actor_of,
    read_actors,
    read_demonstrations,
    read_description,
    read_episodes,
    source_of,
)
from humanopts_teach.bags.info import option_rows, OptionRow, PLAN_RESULT
from humanopts_teach.bags.reader import Bag, DEMONSTRATION
from humanopts_teach.bags.schemas import constants

BATCH = 20_000  # number of rows per batch of a Parquet file
FEATURE_PREFIX = 'feature:'  # prefix of feature names in column names
# Columns before and after the features of a step, and columns for the outcomes of a plan.
_STEP = {'episode': int, 'game': str, 'game_episode': int, 'step': int, 'state': str}
_MOVE = {
    'action': str,
    'reward': float,
    **dict.fromkeys(('terminated', 'truncated', 'cut_short'), bool),
}
_ACTOR = dict.fromkeys(('source', 'option'), str)
_TOTALS = {'steps': int, 'total_reward': float}
_JUDGED = {
    **dict.fromkeys(('participant', 'session', 'option_name'), str),
    'number': int,
    'judged_in': str,  # exam or question
    'verdict': str,  # right or wrong
    'stopped': bool,
    **dict.fromkeys(('start', 'end'), str),
    **_TOTALS,
    'seconds': float,
    'withdrawn': bool,
    **dict.fromkeys(('option_version', 'uuid', 'states', 'actions'), str),
}
_OUTCOMES = dict.fromkeys(('outcome_names', 'outcome_means', 'outcome_low', 'outcome_high'), str)
Columns = Mapping[str, type]  # int, float, bool or str (also for lists as JSON)


class ExportError(ValueError):
    """A bag cannot be exported as requested; the message gives the reason."""


@dataclass(frozen=True)
class Table:
    """
    A table with lazily read rows.

    :ivar columns: column types by name.
    :ivar rows: plain values in column order; None: unknown.
    """

    columns: Columns
    rows: Iterator[Sequence[Any]]


def bag_tables(bag: Bag) -> dict[str, Table]:
    """
    Return the tables steps, demonstrations, judged_runs, options and plans.

    The table of demonstrations excludes judged runs of the machine.

    :raises BagError: the bag contains no domain, several, or an invalid one.
    """
    domain = read_description(bag)
    features: Columns = {
        FEATURE_PREFIX + each.name: float if each.kind is FeatureKind.CONTINUOUS else str
        for each in domain.features
    }
    given = each_once(read_demonstrations(bag)) if bag.of_type(DEMONSTRATION) else []
    fields_of_runs = 'right', 'exam', 'stopped', 'option_version'
    demonstration = {
        name: kind
        for name, kind in {**_columns(Demonstration), **_TOTALS}.items()
        if name not in fields_of_runs
    }
    plan = {'plan_id': str, 'status': str, **_columns(PlanSummary), **_OUTCOMES}
    del plan['outcomes']
    return {
        'steps': Table({**_STEP, **features, **_MOVE, **_ACTOR}, _steps(bag, domain)),
        'demonstrations': Table(demonstration, (_run(d, demonstration) for d in shown(given))),
        'judged_runs': Table(_JUDGED, (_run(each, _JUDGED) for each in judged(given))),
        'options': Table(
            _columns(OptionRow), (_plain(vars(row).values()) for row in option_rows(bag))
        ),
        'plans': Table(plan, _plans(bag, plan)),
    }


def _columns(kind: type) -> dict[str, type]:
    """Return the fields of a dataclass as columns; compound values become text."""
    hints = get_type_hints(kind)
    return {
        f.name: hints[f.name] if hints[f.name] in (int, float, bool) else str for f in fields(kind)
    }


def _steps(bag: Bag, domain: ActableDomain) -> Iterator[Sequence[Any]]:
    """Yield a row for each recorded state and the preceding step, with feature values in words."""
    actors, words = read_actors(bag), [cache(partial(_word, each)) for each in domain.features]
    for number, episode in enumerate(read_episodes(bag), start=1):
        for at in episode.transitions:
            values = [word(value) for word, value in zip(words, at.features)]
            if len(at.features) != len(words):
                values = [None] * len(words)
            if None in values:
                bag.note('values that features do not have are left out of the table of steps')
            yield (
                *(number, episode.publisher_id, episode.number, at.step, at.state, *values),
                *(at.previous_action, at.reward, at.terminated, at.truncated, at.cut_short),
                *(source_of(at), actor_of(at, actors)),
            )


def _word(feature: Feature, value: float) -> float | str | None:
    if not feature.has(value):
        return None
    return value if feature.kind is FeatureKind.CONTINUOUS else feature.text(value)


def _run(demo: Demonstration, columns: Iterable[str]) -> Sequence[Any]:
    """Return the row of a demonstration or a judged run."""
    values = {
        **vars(demo),
        'kind': demo.kind.value,
        'features': demo.plain_features,
        'steps': len(demo.actions),
        'total_reward': demo.total_reward,
        'judged_in': 'exam' if demo.exam else 'question',
        'verdict': 'right' if demo.right else 'wrong',
        'start': next(iter(demo.states), ''),
        'end': next(reversed(demo.states), ''),
    }
    return _plain(values[name] for name in columns)


def _plans(bag: Bag, columns: Iterable[str]) -> Iterator[Sequence[Any]]:
    """Yield a row for each plan."""
    for recorded in bag.genuine(PLAN_RESULT):
        names = constants(bag.topics[recorded.topic].schema, 'STATUS_')
        if (result := recorded.message) is not None:
            result.status = names.get(result.status, str(result.status)).lower()
            yield _plain(getattr(result, name) for name in columns)


def write_tables(
    tables: Mapping[str, Table], out: Path, kind: str, *, excel: bool = False
) -> list[Path]:
    """
    Write a file for each table; unknown values become empty.

    :param kind: file format: csv (UTF-8 with a header row) or parquet.
    :param excel: whether to write a byte order mark in CSV files.
    :raises ExportError: pyarrow, required for Parquet, is not installed.
    :raises OSError: the folder cannot be written.
    """
    if kind == 'parquet' and find_spec('pyarrow') is None:
        raise ExportError('Parquet needs pyarrow, which is not installed: pip install pyarrow')
    out.mkdir(parents=True, exist_ok=True)
    paths = {out / f'{name}.{kind}': table for name, table in tables.items()}
    for path, table in paths.items():
        if kind == 'parquet':
            _write_parquet(table, path)
        else:
            with path.open('w', encoding=EXCEL if excel else 'utf-8', newline='') as file:
                rows = chain([table.columns], table.rows)
                csv.writer(file).writerows(map(to_cell, row) for row in rows)
    return list(paths)


def _write_parquet(table: Table, path: Path) -> None:
    import pyarrow
    from pyarrow.parquet import ParquetWriter

    types = {int: 'int64', float: 'float64', bool: 'bool', str: 'string'}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in table.columns.items()])
    with ParquetWriter(path, schema) as writer:
        while columns := list(zip(*islice(table.rows, BATCH))):
            writer.write_table(pyarrow.table(columns, schema))


def _plain(values: Iterable[Any]) -> list[Any]:
    """Convert lists to JSON and NaN to None, including within lists."""
    known = map(_known, values)
    return [json.dumps(v, ensure_ascii=False) if isinstance(v, list) else v for v in known]


def _known(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [*map(_known, value)]
    return None if value != value else value


def write_attached(bag: Bag, out: Path) -> list[Path]:
    """
    Write every intact attached file to a folder, under its own name.

    :raises ExportError: there are no attachments, none is intact, or a name points outside the
        folder or already exists there.
    :raises OSError: the folder cannot be written.
    """
    if not bag.attachments:
        raise ExportError(f'{bag.path} has no attached files')
    paths = []
    for file in bag.attached():
        path = out / file.name
        if out.resolve() not in path.resolve().parents:
            raise ExportError(f'{bag.path} has an attachment with unsafe name {file.name!r}')
        if path.exists():
            raise ExportError(f'{path} already exists; name another folder')
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)
        paths.append(path)
    if not paths:
        raise ExportError(f'all files attached to {bag.path} are damaged')
    return paths
