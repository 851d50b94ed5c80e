"""What a demo writes about its lesson: ``summary.json``, and how live and offline differ."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
from typing import Any

from humanopts_learner.append_only_log import sync
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.measures import OptionBlock, PlanningRow


class SummaryError(OSError):
    """A file could not be written; the text says why."""


@dataclass(frozen=True)
class Execution:
    """Episodes played by running options."""

    episodes: int
    successes: int  # that ended with the task done
    fallbacks: int  # primitive actions taken because no option was available
    mean_return: float | None  # undiscounted


@dataclass(frozen=True)
class Live:
    """What was seen while the graph ran."""

    options: tuple[OptionBlock, ...]
    planning: tuple[PlanningRow, ...]
    execution: Execution


def summary(live: Live, offline: BagEvaluation, bag: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return what goes into summary.json, without NaN.

    :param offline: learned, planned and played again from the bag alone, which one person taught.
    :param bag: the facts about the recording.
    """
    settings = offline.settings.to_dict()
    return {
        'domain': offline.domain.name,
        'seed': settings.pop('seed'),
        'options': [asdict(block) for block in live.options],
        'teaching': settings,
        'planning': [asdict(row) for row in live.planning],
        'execution': asdict(live.execution),
        'bag': dict(bag),
        'offline': {
            'options': [asdict(block) for block in offline.blocks],
            'planning': [
                {**asdict(plan.row), 'exact_mean_return': plan.exact_mean_return}
                for plan in offline.plans
            ],
        },
        'games': next((games.to_dict() for games in offline.games.values()), None),
    }


def differences(live: Live, offline: BagEvaluation) -> list[str]:
    """Return a sentence for each difference of the numbers, seconds apart; none: all are equal."""
    there, here = _by_name(live.options), _by_name(offline.blocks)
    found = [f'{name!r} was learned live but is not in the bag' for name in there.keys() - here]
    found += [f'{name!r} is in the bag but was not learned live' for name in here.keys() - there]
    for name in there.keys() & here:
        found += _field_differences(there[name], here[name], repr(name))
    found.sort()
    plans = {row.action_set: row for row in offline.planning}
    for row in live.planning:
        if row.action_set not in plans:
            found.append(f'the plan with {row.action_set} actions cannot be made from the bag')
            continue
        found += _field_differences(row, plans[row.action_set], f'the {row.action_set} plan')
    return found


def _by_name(blocks: Sequence[OptionBlock]) -> dict[str, OptionBlock]:
    """Return blocks by name; of the same name (several people taught it), numbered."""
    found: dict[str, OptionBlock] = {}
    for block in blocks:
        again = sum(other.name == block.name for other in found.values())
        found[f'{block.name} ({again + 1})' if again else block.name] = block
    return found


def _field_differences(
    live: OptionBlock | PlanningRow, offline: OptionBlock | PlanningRow, called: str
) -> Iterator[str]:
    here = asdict(offline)
    for name, value in asdict(live).items():
        if value != here[name] and not name.endswith('_seconds'):
            yield f'{name} of {called} was {value!r} live and is {here[name]!r} offline'


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """
    Write JSON data; a reader sees the old file or all of the new one.

    :raises SummaryError: the folder is missing, full or not writable.
    :raises ValueError: a number is NaN or infinite.
    """
    text = json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    write_text(path, text)


def write_text(path: Path, text: str) -> None:
    """
    Write a text file; a reader sees the old file or all of the new one.

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
