"""
Table 1 of the paper: the options that people name, tallied from bags.

Section 4: people were asked for buttons that make winning easier and faster, and what they named
was counted. In a study, people are asked so too; in a lesson, they name what they teach.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import json
import math
from pathlib import Path
from typing import Any

from humanopts_learner.demonstrations import Kind
from humanopts_learner.intervals import Interval
from humanopts_ros.limits import caseless, composed, one_line, shown
from humanopts_ros.text_files import read_yaml
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import domains_played, read_demonstrations
from humanopts_teach.bags.reader import Bag, DEMONSTRATION, LESSON_STATE
from humanopts_teach.evaluation.tables import finite_parts
from humanopts_teach.study.events import ButtonSuggested, Event, event_of, last_attempts
from humanopts_teach.text_table import aligned
import numpy as np

STUDY_EVENT = 'humanopts_interfaces/msg/StudyEvent'
TABLE_1 = {  # share of the participants of a domain who gave a button, section 4
    'taxi': {
        'go to passenger and pickup': 0.6,
        'go to destination and dropoff': 0.6,
        'go to passenger': 0.4,
        'go to destination': 0.4,
        'pickup/dropoff': 0.4,
        'move away from obstacles': 0.2,
    },
    'pacman': {
        'go to the closest food': 1.0,
        'avoid ghost': 1.0,
        'go to the nearest power pellet': 1.0,
        'eat the ghost': 0.4,
    },
}


class MergeError(ValueError):
    """A merge file cannot be used; the text says why."""


def _plain(name: str) -> str:
    """Return a name without the differences that mean nothing: case, spaces, and Unicode form."""
    return ' '.join(caseless(name).split())


def read_merge(path: Path) -> dict[str, str]:
    """
    Read a merge file: YAML, each canonical name with the list of its wordings.

    :return: the canonical name of each wording, which is plain.
    :raises FileError: it cannot be read, or is not YAML.
    :raises MergeError: it is something else, or a wording belongs to two names.
    """
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise MergeError('it has to map each name to the list of its wordings')
    canonical: dict[str, str] = {}
    for name, wordings in values.items():
        if not _plain(name):
            raise MergeError(f'{shown(name)!r} is not a name')
        if not isinstance(wordings, list):
            raise MergeError(f'{shown(name)!r} needs a list of wordings, such as [fetch, get him]')
        for wording in wordings:
            if not isinstance(wording, str):
                raise MergeError(
                    f'a wording of {shown(name)!r} is {shown(json.dumps(wording))}, not a text: '
                    'put it in quotes'
                )
        for wording in (name, *wordings):
            if canonical.setdefault(_plain(wording), name) != name:
                others = shown(canonical[_plain(wording)])
                raise MergeError(
                    f'{shown(wording)!r} belongs to {others!r} and to {shown(name)!r}'
                )
    return canonical


@dataclass(frozen=True)
class NamedOption:
    """An option that somebody named in a lesson, or a button that was suggested in a study."""

    domain: str
    participant: str
    name: str  # in the person's words; empty: none, the person was there
    taught: bool  # it was demonstrated


def named_options(bags: Sequence[Bag]) -> list[NamedOption]:
    """
    Return what people named in bags, and who was there.

    Of a part of a study that was left and begun again, which may be in another bag, the buttons of
    the last attempt count.

    :raises BagError: a bag does not say which domain was played, or has several.
    """
    found: dict[tuple[str, str, str], bool] = {}
    suggested: dict[tuple[str, str, str], list[Event]] = {}  # by domain, study and participant
    for bag in bags:
        domain = domain_of(bag)
        for lesson in bag.converted(
            LESSON_STATE, lambda m: (m.participant, composed(m.option_name))
        ):
            if lesson[0]:
                found.setdefault((domain, *lesson), False)
        for participant, event in bag.converted(
            STUDY_EVENT, lambda m: (m.participant, event_of(m.event))
        ):
            key = domain, str(bag.graph_facts.get('study', '')), participant
            suggested.setdefault(key, []).append(event)
        for demo in read_demonstrations(bag) if bag.of_type(DEMONSTRATION) else ():
            taught = demo.kind is Kind.TRAJECTORY and not demo.withdrawn
            of = domain, demo.participant, demo.option_name
            found[of] = found.get(of, False) or taught
    for (domain, _, participant), events in suggested.items():
        for event in last_attempts(sorted(events, key=lambda event: event.time)):
            if isinstance(event, ButtonSuggested):
                found.setdefault((domain, participant, event.text), False)
    return [NamedOption(*key, taught) for key, taught in found.items()]


def domain_of(bag: Bag) -> str:
    """
    Return the name of the domain of a bag.

    :raises BagError: the bag does not say which domain was played, or has several.
    """
    domains = {name for name, _ in domains_played(bag)}
    if len(domains) != 1:
        raise BagError(f'{bag.path} holds games of {len(domains)} domains; give bags of one')
    return domains.pop()


@dataclass(frozen=True)
class ButtonRow:
    """One row of the table."""

    option: str
    people: int  # who named it
    share: Interval  # of the people of the domain, Wilson's interval
    taught: int  # people who demonstrated it
    paper: float | None  # share in the paper; None: nobody named it there
    wordings: tuple[str, ...]  # those that people used


@dataclass(frozen=True)
class ButtonTable:
    """The options that the people of one domain named."""

    domain: str
    people: tuple[str, ...]
    rows: tuple[ButtonRow, ...]  # the paper's in its order, then the others, most named first

    def to_dict(self) -> dict[str, Any]:
        """Return the table as JSON data; null: the paper has no such row, or nobody was there."""
        rows = [{**asdict(row), 'share': finite_parts(row.share)} for row in self.rows]
        return {'domain': self.domain, 'people': list(self.people), 'rows': rows}


def count_named(named: Sequence[NamedOption], canonical: Mapping[str, str]) -> list[ButtonTable]:
    """
    Count how many people named each option; a person counts once, in however many bags.

    :param canonical: of ``read_merge``; other names are the same where they differ in case and
        spaces only, and the paper's are written as there.
    :return: a table for each domain, in order of appearance.
    """
    return [
        _table(domain, [each for each in named if each.domain == domain], canonical)
        for domain in dict.fromkeys(each.domain for each in named)
    ]


def _table(domain: str, named: Sequence[NamedOption], canonical: Mapping[str, str]) -> ButtonTable:
    paper = TABLE_1.get(domain, {})
    names = {_plain(name): name for name in paper}
    names = {**names, **{w: names.get(_plain(name), name) for w, name in canonical.items()}}
    people = sorted({each.participant for each in named})
    by_option: dict[str, list[NamedOption]] = {name: [] for name in paper}
    for each in named:
        if each.name:
            name = names.setdefault(_plain(each.name), each.name)
            by_option.setdefault(name, []).append(each)
    rows = []
    for name, found in by_option.items():
        who = {each.participant for each in found}
        share = Interval.of_share(np.arange(len(people)) < len(who))
        taught = {each.participant for each in found if each.taught}
        wordings = tuple(dict.fromkeys(each.name for each in found))
        rows.append(ButtonRow(name, len(who), share, len(taught), paper.get(name), wordings))
    rows.sort(key=lambda row: (row.paper is None, -row.people if row.paper is None else 0))
    return ButtonTable(domain, tuple(people), tuple(rows))


def table_text(tables: Sequence[ButtonTable]) -> str:
    """Return the tables as text for a person."""
    parts = []
    for found in tables:
        count = len(found.people)
        who = ', '.join(found.people) or 'nobody'
        head = ('option', 'people', 'share', '95 % interval', 'paper', 'taught', 'other wordings')
        rows = [
            [
                *(row.option, f'{row.people} of {count}'),
                *(_percent(row.share.mean), _range(row.share), _percent(row.paper)),
                str(row.taught),
                ', '.join(each for each in row.wordings if each != row.option),
            ]
            for row in found.rows
        ]
        right = [False, True, True, True, True, True, False]
        lines = [f'{found.domain}: {who}', '', *aligned([head, *rows], right)]
        parts.append('\n'.join(map(one_line, lines)))
    return '\n\n\n'.join(parts)


def _percent(share: float | None) -> str:
    return '-' if share is None or math.isnan(share) else f'{share:.0%}'


def _range(share: Interval) -> str:
    return '-' if math.isnan(share.low) else f'{share.low:.0%} to {share.high:.0%}'
