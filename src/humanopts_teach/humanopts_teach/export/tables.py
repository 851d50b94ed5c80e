"""A bag as files: tables of steps, demonstrations, options and plans, and attached files."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
import json
import math
from pathlib import Path, PurePosixPath
from typing import Any, TYPE_CHECKING

from humanopts_env.domains.base import ActableDomain, FeatureKind
from humanopts_learner.demonstrations import Demonstration, each_once
from humanopts_learner.spreadsheet import csv_of, EXCEL
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

if TYPE_CHECKING:
    import pandas as pd

FEATURE_PREFIX = 'feature:'  # before the name of a feature, in the head of a column
_PLAN = (  # of PlanResult
    *('plan_id', 'status', 'action_set', 'option_names', 'gamma', 'n_states', 'game_steps'),
    *('table_seconds', 'model_seconds', 'sweep_seconds', 'sweeps', 'residual', 'converged'),
    *('evaluation_episodes', 'mean_return', 'mean_return_low', 'mean_return_high'),
    *('mean_discounted_return', 'fallbacks'),
    *('outcome_names', 'outcome_means', 'outcome_low', 'outcome_high'),
)


class ExportError(ValueError):
    """A bag cannot be exported as asked; the text says why."""


def bag_tables(bag: Bag) -> 'dict[str, pd.DataFrame]':
    """
    Return the tables steps, demonstrations, options and plans; a list is JSON text.

    :raises BagError: the bag does not say which domain was played.
    """
    import pandas as pd  # slow to import

    domain = read_description(bag)
    demonstrations = each_once(read_demonstrations(bag)) if bag.of_type(DEMONSTRATION) else []
    counted = [*(field.name for field in fields(Demonstration)), 'steps', 'total_reward']
    return {
        'steps': _steps(bag, domain),
        'demonstrations': pd.DataFrame(map(_demonstration, demonstrations), columns=counted),
        'options': pd.DataFrame(
            (_plain(asdict(row)) for row in option_rows(bag)),
            columns=[field.name for field in fields(OptionRow)],
        ),
        'plans': pd.DataFrame(_plans(bag), columns=_PLAN),
    }


def _steps(bag: Bag, domain: ActableDomain) -> 'pd.DataFrame':
    """Return a row for each recorded state and the step that led to it, features in words."""
    import pandas as pd

    actors, names = read_actors(bag), [FEATURE_PREFIX + each.name for each in domain.features]
    rows = (
        (
            *(number, episode.publisher_id, episode.number, at.step, at.state),
            *(at.features if len(at.features) == len(names) else [math.nan] * len(names)),
            *(at.previous_action, at.reward, at.terminated, at.truncated),
            *(source_of(at), actor_of(at, actors)),
        )
        for number, episode in enumerate(read_episodes(bag), start=1)
        for at in episode.transitions
    )
    table = pd.DataFrame(
        rows,
        columns=[
            *('episode', 'game', 'game_episode', 'step', 'state', *names),
            *('action', 'reward', 'terminated', 'truncated', 'source', 'option'),
        ],
    )
    for name, feature in zip(names, domain.features):
        continuous = feature.kind is FeatureKind.CONTINUOUS
        words = {
            value: value if continuous else feature.text(value)
            for value in table[name].unique()
            if feature.has(value)
        }
        table[name] = table[name].map(words)
    if table[names].isna().any(axis=None):
        bag.note('values that features do not have are left out of the table of steps')
    return table


def _demonstration(demo: Demonstration) -> dict[str, Any]:
    counted = {'steps': len(demo.actions), 'total_reward': demo.total_reward}
    plain = {'kind': demo.kind.value, 'features': demo.plain_features}
    return _plain({**asdict(demo), **plain, **counted})


def _plans(bag: Bag) -> Iterator[dict[str, Any]]:
    """Yield the results of plans."""
    for recorded in bag.genuine(PLAN_RESULT):
        names = constants(bag.topics[recorded.topic].schema, 'STATUS_')
        if (result := recorded.message) is not None:
            status = names.get(result.status, str(result.status)).lower()
            yield {**_plain({name: getattr(result, name) for name in _PLAN}), 'status': status}


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with lists as JSON, and null in place of NaN in them."""
    return {
        name: json.dumps(_without_nan(value), ensure_ascii=False)
        if isinstance(value, list | tuple)
        else value
        for name, value in row.items()
    }


def _without_nan(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_without_nan(part) for part in value]
    return None if value != value else value


def write_tables(
    tables: 'Mapping[str, pd.DataFrame]', out: Path, kind: str, *, excel: bool = False
) -> list[Path]:
    """
    Write a file for each table; unknown values are empty.

    :param kind: csv, which is UTF-8 with a head, or parquet.
    :param excel: write a byte order mark into CSV.
    :raises ExportError: pyarrow is not installed, and Parquet needs it.
    :raises OSError: the folder cannot be written to.
    """
    if kind == 'parquet':
        try:
            import pyarrow  # noqa: F401, what pandas writes with
        except ImportError as error:
            raise ExportError(
                'Parquet needs pyarrow, which is not installed: pip install pyarrow'
            ) from error
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f'{name}.{kind}' for name in tables]
    for path, table in zip(paths, tables.values()):
        if kind == 'parquet':
            table.to_parquet(path, index=False)
        else:
            path.write_bytes(csv_of(table).encode(EXCEL if excel else 'utf-8'))
    return paths


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
