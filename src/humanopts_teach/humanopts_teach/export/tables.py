"""
What a bag holds as files: tables of steps, demonstrations, options and plans, and attached files.

Tables are written while the bag is read, so that a long one takes no memory.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
import csv
from dataclasses import asdict, dataclass, fields
from itertools import chain, islice
import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

from humanopts_env.domains.base import Feature, FeatureKind
from humanopts_learner.demonstrations import Demonstration, each_once
from humanopts_learner.spreadsheet import EXCEL, to_cell
from humanopts_teach.bags.contents import (
    actor_of,
    Actors,
    read_actors,
    read_demonstrations,
    read_domain,
    read_episodes,
    source_of,
)
from humanopts_teach.bags.info import option_rows, OptionRow, PLAN_RESULT
from humanopts_teach.bags.reader import Bag, DEMONSTRATION
from humanopts_teach.bags.schemas import constants

BATCH = 50_000  # rows of a Parquet table that are held in memory
FEATURE_PREFIX = 'feature:'  # before the name of a feature, in the head of a column
_STEPS = ('episode', 'game', 'game_episode', 'step', 'state')
_MOVES = ('action', 'reward', 'terminated', 'truncated', 'source', 'option')
_DEMONSTRATION = (*(field.name for field in fields(Demonstration)), 'steps', 'total_reward')
_OPTION = tuple(field.name for field in fields(OptionRow))
_PLAN = (  # of PlanResult
    *('plan_id', 'status', 'action_set', 'option_names', 'gamma', 'n_states', 'game_steps'),
    *('table_seconds', 'model_seconds', 'sweep_seconds', 'sweeps', 'residual', 'converged'),
    *('evaluation_episodes', 'mean_return', 'mean_return_low', 'mean_return_high'),
    *('mean_discounted_return', 'fallbacks'),
    *('outcome_names', 'outcome_means', 'outcome_low', 'outcome_high'),
)


class ExportError(ValueError):
    """A bag cannot be exported as asked; the text says why."""


@dataclass(frozen=True)
class Table:
    """Rows of plain values, read when they are needed; a list is JSON text, None is unknown."""

    name: str
    head: tuple[str, ...]
    rows: Iterable[tuple[Any, ...]]


def bag_tables(bag: Bag) -> list[Table]:
    """
    Return the four tables.

    :raises BagError: the bag does not say which domain was played, or it is not installed.
    """
    demonstrations = each_once(read_demonstrations(bag)) if bag.of_type(DEMONSTRATION) else []
    return [
        _steps_table(bag),
        _table('demonstrations', _DEMONSTRATION, map(_demonstration, demonstrations)),
        _table('options', _OPTION, map(asdict, option_rows(bag))),
        _table('plans', _PLAN, _plans(bag)),
    ]


def _steps_table(bag: Bag) -> Table:
    """Return a table with a row for each recorded state and the step that led to it."""
    features = read_domain(bag).features
    names = (f'{FEATURE_PREFIX}{feature.name}' for feature in features)
    rows = _steps(bag, features, read_actors(bag))
    return Table('steps', (*_STEPS, *names, *_MOVES), rows)


def _steps(bag: Bag, features: Sequence[Feature], actors: Actors) -> Iterator[tuple[Any, ...]]:
    for number, episode in enumerate(read_episodes(bag), start=1):
        for at in episode.transitions:
            cells = _cells(features, at.features)
            if cells is None:
                bag.note(f'{episode.topic}: states with other features have none in the table')
            yield (
                *(number, episode.publisher_id, episode.number, at.step, at.state),
                *(cells or (None,) * len(features)),
                *(at.previous_action, at.reward, at.terminated, at.truncated),
                *(source_of(at), actor_of(at, actors)),
            )


def _cells(features: Sequence[Feature], values: Sequence[float]) -> list[float | str] | None:
    """Return values of features, in words unless continuous; None: they are of another domain."""
    pairs = list(zip(features, values))
    if len(values) != len(features) or not all(feature.has(value) for feature, value in pairs):
        return None
    return [v if f.kind is FeatureKind.CONTINUOUS else f.text(v) for f, v in pairs]


def _demonstration(demo: Demonstration) -> dict[str, Any]:
    counted = {'steps': len(demo.actions), 'total_reward': demo.total_reward}
    plain = {'kind': demo.kind.value, 'features': demo.plain_features}
    return {**asdict(demo), **plain, **counted}


def _plans(bag: Bag) -> Iterator[dict[str, Any]]:
    """Yield the results of plans; bags of older versions lack some fields."""
    for recorded in bag.genuine(PLAN_RESULT):
        if (result := recorded.message) is not None:
            names = constants(bag.topics[recorded.topic].schema, 'STATUS_')
            status = names.get(result.status, str(result.status)).lower()
            yield {**{name: getattr(result, name, None) for name in _PLAN}, 'status': status}


def _plain(value: Any) -> Any:
    """Return a list as JSON, and nothing in place of NaN, in lists too."""
    value = _known(value)
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list) else value


def _known(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_known(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _table(name: str, head: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Table:
    return Table(name, tuple(head), (tuple(_plain(row[key]) for key in head) for row in rows))


def write_csv(tables: Sequence[Table], out: Path, *, excel: bool = False) -> list[Path]:
    """
    Write a UTF-8 file for each table, with a head; unknown values are empty.

    :param excel: write a byte order mark.
    :raises OSError: the folder cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.csv')
        encoding = EXCEL if excel else 'utf-8'
        with paths[-1].open('w', encoding=encoding, newline='') as file:
            writer = csv.writer(file)
            writer.writerows(map(to_cell, row) for row in chain([table.head], table.rows))
    return paths


def write_parquet(tables: Sequence[Table], out: Path) -> list[Path]:
    """
    Write a file for each table.

    :raises ExportError: pyarrow is not installed.
    :raises OSError: the folder cannot be written to.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ExportError(
            'Parquet needs pyarrow, which is not installed: pip install pyarrow'
        ) from error
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for table in tables:
        paths.append(out / f'{table.name}.parquet')
        _write_batches(table, paths[-1], pyarrow, parquet)
    return paths


def _write_batches(table: Table, path: Path, pyarrow: Any, parquet: Any) -> None:
    """
    Write a table in parts.

    All parts have the column types of the first; a column that is empty there is text.
    """
    rows, schema = iter(table.rows), None
    with ExitStack() as stack:
        while (part := list(islice(rows, BATCH))) or schema is None:
            columns = dict(zip(table.head, zip(*part))) or dict.fromkeys(table.head, ())
            batch = pyarrow.table({name: list(c) for name, c in columns.items()}, schema)
            if schema is None:
                types = {f.name: f.type for f in batch.schema}
                empty = dict.fromkeys(
                    (name for name, kind in types.items() if kind == pyarrow.null()),
                    pyarrow.string(),
                )
                batch = batch.cast(pyarrow.schema({**types, **empty}))
                schema = batch.schema
                writer = stack.enter_context(parquet.ParquetWriter(path, schema))
            writer.write_table(batch)


def write_attached(bag: Bag, out: Path) -> list[Path]:
    """
    Write every attached file that is whole into a folder, under its name.

    :raises ExportError: no file is attached, none is whole, or one has a name that leads out of
        the folder or exists there.
    :raises OSError: the folder cannot be written to.
    """
    if not bag.attachments:
        raise ExportError(f'{bag.path} has no attached files')
    paths = []
    for file in bag.attached():
        name = PurePosixPath(file.name)
        if name.is_absolute() or '..' in name.parts or not name.parts:
            raise ExportError(f'{bag.path} has an attached file of the name {file.name!r}')
        path = out / name
        if path.exists():
            raise ExportError(f'{path} exists already; name another folder')
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.data)
        paths.append(path)
    if not paths:
        raise ExportError(f'all files attached to {bag.path} are damaged')
    return paths
