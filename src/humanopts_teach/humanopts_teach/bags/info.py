"""
What ``humanopts bag info`` prints, found in one pass and shown as text and as JSON.

These are the facts about a bag: people, options, runs, plans, episodes and loss.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, UTC
from functools import lru_cache, partial
from itertools import chain
import math
from operator import attrgetter
from typing import Any

from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    each_once,
    Kind,
)
from humanopts_ros.limits import one_line, shown
from humanopts_teach.bags.contents import domains_played, of_the_game, state_topics
from humanopts_teach.bags.reader import (
    Bag,
    BEING_RECORDED,
    DEMONSTRATION,
    LESSON_STATE,
    Recorded,
)
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.sequence_numbers import MessageCounter, read_stamp, Stream
from humanopts_teach.text_table import table
from mcap.records import AttachmentIndex

_FACT_TEXTS = {
    ('teacher_error_rate', 'None'): 'none: a person taught',
    ('return_delta', 'None'): 'none: a tenth of the range',
}
_MAX_ROWS = 50  # streams with losses in a text
_STATUS = 'humanopts_interfaces/msg/LearningStatus'
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'
PLAN_RESULT = 'humanopts_interfaces/msg/PlanResult'
_POLICY_RESULT = 'humanopts_interfaces/msg/PolicyResult'
_RESULTS = {_OPTION_RESULT: 'option runs', PLAN_RESULT: 'plans', _POLICY_RESULT: 'policy runs'}
_constants = lru_cache(constants)


@dataclass(frozen=True)
class TopicRow:
    """One topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: it is not known


@dataclass(frozen=True)
class OptionRow:
    """One option of one participant, from its demonstrations."""

    participant: str
    option: str
    sessions: tuple[str, ...]
    features: tuple[str, ...]
    demonstrations: int
    not_here: int
    withdrawn: int  # taken back; not counted in the other fields
    steps: int  # of all demonstrations
    seconds: float  # that the person took for all demonstrations
    criteria_met: bool  # by the last learning status


@dataclass(frozen=True)
class CriterionRow:
    """A criterion of an option after a demonstration, by the learning status."""

    participant: str
    option: str
    criterion: str  # return, initiation or termination
    seconds: float  # from the beginning of the bag
    demonstrations: int  # shown so far
    not_here: int  # "not here" answers so far
    threshold: float | None  # None: not yet known
    value: float | None  # None: not yet measurable
    met: bool


@dataclass(frozen=True)
class BagInfo:
    """What a bag holds."""

    path: str
    recording: bool  # it is being recorded; what follows is so far
    damage: Sequence[str]  # what is wrong with the bag
    left_out: Sequence[str]  # what does not count, as it is not of the graph
    start: int  # of the first message, ns since the epoch
    duration: int  # to the last message, ns
    messages: int
    missing: int  # messages that were sent and are not in the bag
    files: int  # MCAP files
    bytes: int  # size of the MCAP files
    facts: Mapping[str, str]  # that the recorder was given
    attached: Sequence[AttachmentIndex]
    domains: Sequence[str]  # name and parameters
    participants: Sequence[str]  # who taught or sat down to, sorted
    sessions: Sequence[str]  # sorted
    topics: Sequence[TopicRow]
    options: Sequence[OptionRow]
    criteria: Sequence[CriterionRow]  # in order of time, where something has changed
    results: Mapping[str, Mapping[str, int]]  # option runs, plans and policy runs, by status
    interruptions: int  # options that policies interrupted, since another was worth more
    execution_changes: int  # of policies while they ran
    episodes: int
    episodes_ended: int  # whose last state was recorded
    streams: Sequence[Stream]

    def to_dict(self) -> dict[str, Any]:
        """Return the facts as JSON data."""
        return asdict(replace(self, streams=())) | {
            'attached': [
                {'name': file.name, 'bytes': file.data_size, 'media_type': file.media_type}
                for file in self.attached
            ],
            'streams': [stream.to_dict() for stream in self.streams],
        }

    def to_text(self) -> str:
        """Return the facts as text for a person."""
        facts = [
            {'recorded with': name.replace('_', ' '), '': _FACT_TEXTS.get((name, value), value)}
            for name, value in sorted(self.facts.items())
        ]
        attached = [
            {'attached file': file.name, 'bytes': file.data_size, 'type': file.media_type}
            for file in self.attached
        ]
        options = [
            {
                'participant': row.participant,
                'option': row.option,
                'shown': row.demonstrations,
                'not here': row.not_here,
                'taken back': row.withdrawn,
                'steps': row.steps,
                'seconds': round(row.seconds),
                'criteria met': 'yes' if row.criteria_met else 'no',
            }
            for row in self.options
        ]
        topics = [
            {'topic': topic.name, 'messages': topic.messages, 'type': topic.type}
            for topic in self.topics
        ]
        parts = [
            self._head(),
            table(facts),
            table(attached),
            table(options),
            table(self._criteria()),
            self._events(),
            table(topics),
            self._loss(),
        ]
        return '\n\n'.join(part for part in parts if part)

    def _head(self) -> str:
        begun = datetime.fromtimestamp(self.start / 1e9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
        pairs = [
            ('bag', self.path),
            *([('recording', BEING_RECORDED)] if self.recording else []),
            *(('DAMAGED', line) for line in self.damage),
            *(('left out', line) for line in self.left_out),
            ('begun', begun if self.messages else 'nothing was recorded'),
            ('duration', f'{self.duration / 1e9:.1f} s'),
            ('messages', f'{self.messages} on {len(self.topics)} topics'),
            ('size', f'{self.bytes:,} bytes in {self.files} file{"s"[: self.files > 1]}'),
            ('domain', '; '.join(self.domains) or 'not recorded'),
            ('participants', ', '.join(self.participants) or 'none'),
            ('sessions', ', '.join(self.sessions) or 'none'),
        ]
        width = max(len(name) for name, _ in pairs)
        return '\n'.join(f'{name:{width}}  {shown(value)}' for name, value in pairs)

    def _criteria(self) -> list[dict[str, object]]:
        """Return when each criterion held first, and its value then and at the end."""
        histories = defaultdict[tuple[str, str, str], list[CriterionRow]](list)
        for row in self.criteria:
            histories[row.participant, row.option, row.criterion].append(row)
        found: list[dict[str, object]] = []
        for (participant, option, criterion), rows in histories.items():
            met = next((row for row in rows if row.met), None)
            first = f'{met.demonstrations} shown, {met.not_here} not here' if met else 'never'
            found.append(
                {
                    'participant': participant,
                    'option': option,
                    'criterion': criterion,
                    'target': _measured(rows[-1].threshold),
                    'first held after': first,
                    'at second': f'{met.seconds:.1f}' if met else '-',
                    'value': _measured(met.value if met else None),
                    'at the end': _measured(rows[-1].value),
                }
            )
        return found

    def _events(self) -> str:
        lines = [f'episodes: {self.episodes}, {self.episodes_ended} recorded to their end']
        for name, counts in self.results.items():
            each = ', '.join(f'{status} {count}' for status, count in sorted(counts.items()))
            lines += [one_line(f'{name}: {each}')] if counts else []
        if self.results[_RESULTS[_POLICY_RESULT]]:
            lines.append(
                f'in policy runs: {self.interruptions} options stopped by the plan, '
                f'{self.execution_changes} changes of execution'
            )
        return '\n'.join(lines)

    def _loss(self) -> str:
        odd = [row for row in self.streams if row.missing or row.duplicates]
        if not odd:
            return f'missing: 0 messages (by the numbers in {len(self.streams)} streams)'
        odd.sort(key=lambda row: (row.missing, row.duplicates), reverse=True)
        rows = table([stream.to_dict() for stream in odd[:_MAX_ROWS]])
        more = f'\nand {len(odd) - _MAX_ROWS} streams more' if len(odd) > _MAX_ROWS else ''
        return f'missing: {self.missing} messages\n{rows}{more}'


def _measured(value: float | None) -> str:
    return '-' if value is None else f'{value:.3g}'


def option_rows(bag: Bag) -> Sequence[OptionRow]:
    """Return the options that were taught."""
    return summarise(bag, bag.of_type(DEMONSTRATION) + bag.of_type(_STATUS)).options


def _criterion_rows(status: Any, seconds: float) -> list[CriterionRow]:
    """Return the criteria in a LearningStatus."""
    return [
        CriterionRow(
            option.participant,
            option.option_name,
            criterion.name,
            seconds,
            option.n_demonstrations,
            option.n_not_here,
            None if math.isnan(criterion.threshold) else criterion.threshold,
            criterion.value if criterion.measurable else None,
            criterion.met,
        )
        for option in status.options
        for criterion in option.criteria
    ]


def summarise(bag: Bag, topics: Collection[str] | None = None) -> BagInfo:
    """
    Read a bag once and return what it holds.

    :param topics: that are read; None: all.
    """
    counter, is_of_game, states = MessageCounter(bag), of_the_game(bag), state_topics(bag)
    last_states: dict[tuple[str, str, int], tuple[int, str, bytes]] = {}  # by episode
    found = defaultdict[str, list[Any]](list)  # what was made of messages, by type
    criteria: dict[tuple[str, str, str], list[CriterionRow]] = {}
    met: dict[tuple[str, str], bool] = {}  # all criteria, by participant and option

    def status(recorded: Recorded, message: Any) -> None:
        seconds = (recorded.log_time - counter.extent.first) / 1e9
        met.update(((o.participant, o.option_name), o.criteria_met) for o in message.options)
        for row in _criterion_rows(message, seconds):
            rows = criteria.setdefault((row.participant, row.option, row.criterion), [])
            if not rows or replace(row, seconds=rows[-1].seconds) != rows[-1]:
                rows.append(row)

    def demonstration(recorded: Recorded, message: Any) -> Demonstration | None:
        demo = demonstration_from_message(message)
        return demo if is_of_game(recorded, demo) else None

    def result(recorded: Recorded, message: Any) -> tuple[str, Any]:
        names = _constants(bag.topics[recorded.topic].schema, 'STATUS_')
        return names.get(message.status, f'status {message.status}').lower(), message

    handlers: dict[str, Callable[[Recorded, Any], Any]] = {
        DEMONSTRATION: demonstration,
        LESSON_STATE: lambda _, message: (message.participant, message.session),
        _STATUS: status,
        **dict.fromkeys(_RESULTS, result),
    }
    for recorded in bag.messages(topics):
        if not counter.add(recorded) or not bag.is_genuine(recorded):
            continue
        if recorded.topic in states and (stamp := read_stamp(recorded.data, with_step=True)):
            key = recorded.topic, stamp.publisher_id, stamp.episode
            if stamp.episode and last_states.get(key, (-1,))[0] < stamp.step:
                last_states[key] = stamp.step, recorded.topic, recorded.data
        elif handler := handlers.get(recorded.type):
            made = bag.convert(recorded.topic, recorded.data, partial(handler, recorded))
            if made is not None:
                found[recorded.type].append(made)
    ended = [
        bag.convert(topic, data, lambda state: state.terminated or state.truncated)
        for _, topic, data in last_states.values()
    ]
    taught: dict[tuple[str, str], list[Demonstration]] = {}
    for demo in each_once(found[DEMONSTRATION]):
        taught.setdefault((demo.participant, demo.option_name), []).append(demo)
    options = [_option_row(demos, met.get(key, False)) for key, demos in taught.items()]
    opened = {(who, session) for who, session in found[LESSON_STATE] if who}
    policies = [message for _, message in found[_POLICY_RESULT]]
    streams = list(counter.losses)
    return BagInfo(
        path=str(bag.path),
        recording=bag.recording,
        damage=bag.damage.splitlines(),
        left_out=bag.left_out,
        start=counter.extent.first if counter.extent.messages else 0,
        duration=counter.extent.duration,
        messages=counter.extent.messages,
        missing=sum(stream.missing for stream in streams),
        files=len(bag.files),
        bytes=sum(file.stat().st_size for file in bag.files),
        facts=bag.graph_facts,
        attached=list(bag.attachments.values()),
        domains=[' '.join(each) for each in domains_played(bag)] if topics is None else [],
        participants=sorted({row.participant for row in options} | {who for who, _ in opened}),
        sessions=sorted({s for row in options for s in row.sessions} | {s for _, s in opened}),
        topics=[
            TopicRow(topic.name, topic.type, counter.counts[topic.name], *counter.loss(topic.name))
            for topic in bag.topics.values()
        ],
        options=options,
        criteria=sorted(chain(*criteria.values()), key=attrgetter('seconds')),
        results={
            name: dict(Counter(status for status, _ in found[kind]))
            for kind, name in _RESULTS.items()
        },
        interruptions=sum(message.interruptions for message in policies),
        execution_changes=sum(message.execution_changes for message in policies),
        episodes=len(last_states),
        episodes_ended=sum(map(bool, ended)),
        streams=streams,
    )


def _option_row(demos: Sequence[Demonstration], criteria_met: bool) -> OptionRow:
    kept = [demo for demo in demos if not demo.withdrawn]
    shown = [demo for demo in kept if demo.kind is Kind.TRAJECTORY]
    newest = max(kept or demos, key=lambda demo: demo.number)
    return OptionRow(
        participant=newest.participant,
        option=newest.option_name,
        sessions=tuple(dict.fromkeys(demo.session for demo in demos)),
        features=newest.chosen_features,
        demonstrations=len(shown),
        not_here=len(kept) - len(shown),
        withdrawn=len(demos) - len(kept),
        steps=sum(len(demo.actions) for demo in shown),
        seconds=math.fsum(demo.seconds for demo in kept if math.isfinite(demo.seconds)),
        criteria_met=criteria_met,
    )
