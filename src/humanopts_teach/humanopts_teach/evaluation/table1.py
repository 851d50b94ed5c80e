"""
Table 1 of the paper: the options named by people, counted in bags.

In section 4, people were asked for buttons that make winning easier and faster, and their answers
were counted. A study asks the same question. In a lesson, people name the options they teach.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
from pathlib import Path

from humanopts_learner.demonstrations import Kind
from humanopts_learner.intervals import Interval
from humanopts_ros.limits import caseless, composed, one_line, shown
from humanopts_ros.text_files import read_yaml
from humanopts_teach import text_table
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import domains_played, read_demonstrations
from humanopts_teach.bags.reader import Bag, DEMONSTRATION, LESSON_STATE
from humanopts_teach.study.events import Event, event_of, last_attempts
import numpy as np

STUDY_EVENT = 'humanopts_interfaces/msg/StudyEvent'
TABLE_1 = {  # section 4: share of the participants who named each button, by domain
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


@dataclass(frozen=True)
class Named:
    """An option named by a person."""

    domain: str
    participant: str
    name: str  # in the person's words; empty: the person took part but named nothing
    taught: bool  # whether it was demonstrated


@dataclass(frozen=True)
class Button:
    """Counts of the people of one domain who named an option."""

    option: str
    people: int
    share: float | None  # of the participants of the domain; None: no participants
    share_low: float | None  # Wilson's 95 % interval
    share_high: float | None
    taught: int  # number of people who demonstrated it
    paper: float | None  # share in the paper; None: not in the paper
    wordings: tuple[str, ...]  # names given by people


class MergeError(ValueError):
    """A merge file cannot be used; the message gives the reason."""


def _plain(name: str) -> str:
    """Normalise a name: ignore case, spaces and Unicode form."""
    return ' '.join(caseless(name).split())


def read_merge(path: Path) -> dict[str, str]:
    """
    Read a merge file: YAML that maps each canonical name to a list of its wordings.

    :return: canonical names by normalised wording.
    :raises FileError: the file cannot be read, or is not YAML.
    :raises MergeError: the file has another structure, or a wording belongs to two names.
    """
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise MergeError('it must map each name to the list of its wordings')
    canonical: dict[str, str] = {}
    for name, wordings in values.items():
        if not _plain(name):
            raise MergeError(f'{shown(name)!r} is not a name')
        if not isinstance(wordings, list):
            raise MergeError(f'{shown(name)!r} needs a list of wordings, such as [fetch, get him]')
        for wording in wordings:
            if not isinstance(wording, str):
                raise MergeError(
                    f'a wording of {shown(name)!r} is {shown(json.dumps(wording))}, not text: '
                    'put it in quotes'
                )
        for wording in (name, *wordings):
            if canonical.setdefault(_plain(wording), name) != name:
                others = shown(canonical[_plain(wording)])
                raise MergeError(
                    f'{shown(wording)!r} belongs to {others!r} and to {shown(name)!r}'
                )
    return canonical


def named_options(bags: Sequence[Bag]) -> list[Named]:
    """
    Return the options named by the participants in bags.

    If a part of a study was repeated, possibly in another bag, the last attempt counts.

    :raises BagError: a bag contains no domain, or several.
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
            if event.event == 'button':
                found.setdefault((domain, participant, event.text), False)
    return [Named(*key, taught) for key, taught in found.items()]


def domain_of(bag: Bag) -> str:
    """
    Return the name of the domain in a bag.

    :raises BagError: the bag contains no domain, or several.
    """
    domains = {name for name, _ in domains_played(bag)}
    if len(domains) != 1:
        raise BagError(f'{bag.path} holds games of {len(domains)} domains; give bags of one')
    return domains.pop()


@dataclass(frozen=True)
class ButtonTable:
    """The options named by the participants of one domain."""

    domain: str
    people: list[str]
    rows: list[Button]  # the paper's rows in its order, then the others, most frequent first


def count_named(named: Sequence[Named], canonical: Mapping[str, str]) -> list[ButtonTable]:
    """
    Count the people who named each option; each person counts once, even in several bags.

    :param canonical: result of ``read_merge``. Other names are equal if they differ only in case
        and spaces; names in the paper keep its spelling.
    :return: one table per domain, in order of appearance.
    """
    tables = []
    for domain in dict.fromkeys(each.domain for each in named):
        buttons, paper = [each for each in named if each.domain == domain], TABLE_1.get(domain, {})
        names = {_plain(name): name for name in paper}
        names = {**names, **{w: names.get(_plain(name), name) for w, name in canonical.items()}}
        people = sorted({each.participant for each in buttons})
        options: dict[str, list[Named]] = {name: [] for name in paper}
        for each in buttons:
            if each.name:
                option = names.setdefault(_plain(each.name), each.name)
                options.setdefault(option, []).append(each)
        rows = []
        for option, given in options.items():
            count = len({each.participant for each in given})
            share = Interval.of_share(np.arange(len(people)) < count)
            rows.append(
                Button(
                    option,
                    count,
                    share=share.mean if people else None,
                    share_low=share.low if people else None,
                    share_high=share.high if people else None,
                    taught=len({each.participant for each in given if each.taught}),
                    paper=paper.get(option),
                    wordings=tuple(dict.fromkeys(each.name for each in given)),
                )
            )
        rows.sort(key=lambda row: (row.option not in paper) * (len(people) + 1 - row.people))
        tables.append(ButtonTable(domain, people, rows))
    return tables


def table_text(tables: Sequence[ButtonTable]) -> str:
    """Return the tables as plain text."""
    parts = []
    for found in tables:
        who = ', '.join(found.people) or 'no participants'
        rows = [
            {
                'option': row.option,
                'people': f'{row.people} of {len(found.people)}',
                'share': _percent(row.share),
                '95 % interval': f'{_percent(row.share_low)} to {_percent(row.share_high)}',
                'paper': _percent(row.paper),
                'taught': row.taught,
                'other wordings': ', '.join(x for x in row.wordings if x != row.option),
            }
            for row in found.rows
        ]
        heading = one_line(f'{found.domain}: {who}')
        parts.append(f'{heading}\n\n{text_table.table(rows, ["option", "other wordings"])}')
    return '\n\n\n'.join(parts)


def _percent(share: float | None) -> str:
    return '-' if share is None else f'{share:.0%}'
