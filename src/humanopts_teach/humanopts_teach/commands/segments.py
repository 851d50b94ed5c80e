"""
``humanopts import``, and code shared with ``humanopts bag segment``: cutting plays into segments.

Commands import modules when they run, so that help and completion are quick.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

from humanopts_ros.limits import printable
from humanopts_teach.command_line import (
    DomainOptions,
    option,
    PLAIN,
    SegmentOptions,
    with_options,
)
from humanopts_teach.commands import CommandError, refusing
import typer

if TYPE_CHECKING:
    from humanopts_env.domains.base import ActableDomain
    from humanopts_learner.demonstrations import Demonstration

app = typer.Typer(**PLAIN, subcommand_metavar='COMMAND ...')


@app.callback()
def import_() -> None:
    """Make demonstrations from plays of the whole task that were recorded elsewhere."""


@app.command()
@with_options
def minari(
    dataset: Annotated[str, typer.Argument(metavar='ID')],
    folder: Annotated[
        Path | None, option('DIR', "folder of Minari's datasets; default: Minari's own")
    ] = None,
    *,
    cutting: SegmentOptions,
) -> int:
    """Cut the episodes of a Minari dataset on disk into segments."""
    from humanopts_teach.plays import plays_in_dataset

    print(printable(cut_plays(*plays_in_dataset(dataset, folder), cutting)))
    return 0


@app.command()
@with_options
def table(
    file: Annotated[Path, typer.Argument(metavar='FILE.csv')],
    domain: Annotated[str, typer.Argument(metavar='DOMAIN')],
    *,
    of_domain: DomainOptions,
    cutting: SegmentOptions,
) -> int:
    """Cut plays in a table with one row per state into segments."""
    from humanopts_env.domains.registry import make_domain
    from humanopts_learner.demonstration_table import demonstrations_from_table
    from humanopts_teach.plays import WHOLE_TASK

    made = make_domain(domain, of_domain.domain_parameters)
    with refusing(OSError, what=f'cannot read {file}: '):
        plays = demonstrations_from_table(file, made, WHOLE_TASK)
    shown = {n: play for n, play in enumerate(plays, start=1) if play.actions}
    print(printable(cut_plays(made, shown, cutting)))
    return 0


def cut_plays(
    domain: 'ActableDomain', plays: 'Mapping[int, Demonstration]', cutting: SegmentOptions
) -> str:
    """
    Cut plays, save the named segments as demonstrations, and return the report.

    :raises CommandError: there are no plays, or the names do not match the segments.
    """
    from humanopts_learner.segments import cut, event_features, joined, Segment
    from humanopts_teach.plays import keep_segments

    if not plays:
        raise CommandError('there is no play with steps')
    if bool(cutting.name) != (cutting.out is not None):
        raise CommandError('to keep segments, give both --name and --out')
    events = tuple(cutting.event) or event_features(domain, [*plays.values()])
    segments = {number: cut(domain, play, events) for number, play in plays.items()}
    kinds: dict[tuple[str, ...], int] = {}  # number of each kind, by the events at its end
    lines = [f'events: changes of {", ".join(events) or "no feature"}']
    for number, parts in segments.items():
        lines += ['', f'episode {number}: {len(plays[number].actions)} steps']
        for part in parts:
            kind = kinds.setdefault(part.end, len(kinds) + 1)
            steps = f'{part.first + 1} to {part.last}'
            lines.append(f'  steps {steps:<12} {kind:>3}  {", ".join(part.end)}')
    names = _names(cutting.name, len(kinds))
    if not cutting.out:
        lines += ['', 'to keep segments: --name NUMBER=OPTION for each kind, and --out DIR']
        return '\n'.join(lines)
    named: dict[str, list[Segment]] = {}
    for parts in segments.values():
        for name, part in joined(parts, [names.get(kinds[part.end], '') for part in parts]):
            named.setdefault(name, []).append(part)
    features = keep_segments(domain, named, cutting.out, cutting.participant)
    lines.append('')
    for name, chosen in features.items():
        count = len(named[name])
        plural = 's'[: count != 1]
        lines.append(f'{name}: {count} demonstration{plural}; depends on {", ".join(chosen)}')
    who = f'--out {cutting.out} --participant {cutting.participant}'
    lines.append(f'continue: humanopts teach {domain.name} {who}')
    return '\n'.join(lines)


def _names(given: list[str], kinds: int) -> dict[int, str]:
    """
    Parse the names of kinds of segments, such as ``1=get the key``.

    :raises CommandError: a kind does not exist, or a text has another form.
    """
    names = {}
    for text in given:
        number, equals, name = text.partition('=')
        if not (equals and name.strip() and number.isascii() and number.isdecimal()):
            raise CommandError(f'--name {text!r} is not of the form 1=OPTION')
        if not 1 <= int(number) <= kinds:
            raise CommandError(f'--name {text!r}: there is no kind {number}, only 1 to {kinds}')
        names[int(number)] = name.strip()
    return names
