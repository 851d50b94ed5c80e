"""The summary of a demo, ``summary.json``, and differences between live and offline results."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
from typing import Any, TYPE_CHECKING

from humanopts_learner.append_only_log import sync
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.games import games_to_dict
from humanopts_teach.evaluation.tables import LIVE_OPTIONS, LIVE_PLANS, records, SECONDS

if TYPE_CHECKING:
    import pandas as pd  # slow to import


class SummaryError(OSError):
    """A file could not be written; the message gives the reason."""


@dataclass(frozen=True)
class PlayedEpisodes:
    """Episodes played by running options."""

    episodes: int
    successes: int  # episodes in which the task was completed
    fallbacks: int  # primitive actions taken because no option was available
    random_moves: int  # random actions taken to leave a loop
    mean_return: float | None  # undiscounted


@dataclass(frozen=True)
class Live:
    """
    Numbers from the running graph.

    :ivar options: columns ``OPTIONS``; NaN except in ``LIVE_OPTIONS``.
    :ivar plans: columns ``PLANS``; NaN except in ``LIVE_PLANS`` and ``SECONDS``.
    """

    options: 'pd.DataFrame'
    plans: 'pd.DataFrame'
    execution: PlayedEpisodes


def summary(live: Live, offline: BagEvaluation, bag: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the contents of summary.json, without NaN.

    :param offline: evaluation of the bag, which has one teacher.
    :param bag: facts about the recording.
    """
    settings = offline.settings.to_dict()
    return {
        'domain': offline.domain.name,
        'seed': settings.pop('seed'),
        'options': records(live.options[[*LIVE_OPTIONS]]),
        'teaching': settings,
        'planning': records(live.plans[[*LIVE_PLANS, *SECONDS]]),
        'execution': asdict(live.execution),
        'bag': dict(bag),
        'offline': {
            'options': records(offline.option_table[[*LIVE_OPTIONS]]),
            'planning': records(offline.plan_table.drop(columns='participant')),
        },
        'games': next(map(games_to_dict, offline.games.values()), None),
    }


def differences(live: Live, offline: BagEvaluation) -> list[str]:
    """Return a sentence on each difference between live and offline numbers, except durations."""
    found = []
    for what, columns, keys, seen, again in (
        (
            'option',
            LIVE_OPTIONS,
            ['participant', 'option_name'],
            live.options,
            offline.option_table,
        ),
        ('plan', LIVE_PLANS, ['action_set'], live.plans, offline.plan_table),
    ):
        live_rows, offline_rows = (
            {tuple(row[key] for key in keys): row for row in records(frame[[*columns]])}
            for frame in (seen, again)
        )
        for key in dict.fromkeys([*live_rows, *offline_rows]):
            called = f'the {what} {" ".join(map(repr, key[::-1]))}'
            if key not in live_rows or key not in offline_rows:
                found.append(
                    f'{called} is not in {"the bag" if key in live_rows else "the live numbers"}'
                )
                continue
            found += [
                f'{name} of {called} was {value!r} live and is {offline_rows[key][name]!r} offline'
                for name, value in live_rows[key].items()
                if value != offline_rows[key][name]
            ]
    return found


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """
    Write JSON data atomically: readers see either the old file or the complete new one.

    :raises SummaryError: the folder is missing, full or not writable.
    :raises ValueError: a number is NaN or infinite.
    """
    text = json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    """
    Write a text file atomically: readers see either the old file or the complete new one.

    :raises SummaryError: the folder is missing, full or not writable.
    """
    temporary = path.with_name(f'.{path.name}.{os.getpid()}.tmp')
    try:
        temporary.write_text(text, 'utf-8')
        sync(temporary)
        temporary.replace(path)
    except OSError as error:
        raise SummaryError(f'cannot write {path}: {error.strerror or error}') from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
