"""
What ``humanopts bag info`` prints, found in one pass and shown as text and as JSON.

These are the facts about a bag: people, options, runs, plans, episodes and loss.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, UTC
from functools import lru_cache, partial
import math
from typing import Any

from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    each_once,
    Kind,
)
from humanopts_ros.limits import one_line, shown
from humanopts_teach.bags.contents import (
    domains_played,
    EpisodeGrouping,
    EpisodeMessages,
    is_ended,
    of_the_game,
)
from humanopts_teach.bags.reader import (
    Bag,
    BEING_RECORDED,
    DEMONSTRATION,
    LESSON_STATE,
    Recorded,
)
from humanopts_teach.bags.rosbag2 import Topic
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.sequence_numbers import MessageCounter, Stream
from humanopts_teach.text_table import table
from mcap.records import AttachmentIndex

_FACT_TEXTS = {
    ('teacher_error_rate', 'None'): 'none: a person taught',
    ('return_delta', 'None'): 'none: a tenth of the range',
}
_MOST_ROWS = 50  # streams that are told in a text, the worst
_STATUS = 'humanopts_interfaces/msg/LearningStatus'
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'
PLAN_RESULT = 'humanopts_interfaces/msg/PlanResult'
_POLICY_RESULT = 'humanopts_interfaces/msg/PolicyResult'
_constants = lru_cache(constants)
# What JSON has of a topic and of a stream.
_OF_TOPIC = ('name', 'type', 'messages', 'counted')
_OF_STREAM = (
    *('topic', 'publisher', 'first', 'last', 'received'),
    *('missing', 'replaced', 'duplicates'),
)
_TAUGHT = (
    *('participant', 'option', 'shown', 'not here', 'taken back'),
    *('steps', 'seconds', 'criteria met'),
)
_CRITERIA = (
    *('participant', 'option', 'criterion', 'target'),
    *('first held after', 'at second', 'value', 'at the end'),
)


@dataclass(frozen=True)
class TopicRow:
    """One topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: it is not known

    @property
    def counted(self) -> bool:
        """Whether its messages carry sequence numbers, by which loss is counted."""
        return self.publishers is not None


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
class CriterionPoint:
    """A criterion after a demonstration, by the learning status."""

    seconds: float  # from the beginning of the bag
    demonstrations: int  # shown so far
    not_here: int  # "not here" answers so far
    value: float | None  # None: not yet measurable
    met: bool


@dataclass
class CriterionRow:
    """The values of one criterion of one option over time."""

    participant: str
    option: str
    criterion: str  # return, initiation or termination
    threshold: float = math.nan  # the last; NaN: not measured yet
    points: list[CriterionPoint] = field(default_factory=list)

    @property
    def first_met(self) -> CriterionPoint | None:
        """Return the first point at which the criterion held."""
        return next((point for point in self.points if point.met), None)


@dataclass
class BagInfo:
    """What a bag holds, filled in while it is read."""

    path: str
    recording: bool = False  # it is being recorded; what follows is so far
    damage: str = ''  # what is wrong with the bag, a line each; empty: nothing
    left_out: Sequence[str] = ()  # what does not count, as it is not of the graph, in words
    start: int = 0  # of the first message, ns since the epoch
    duration: int = 0  # to the last message, ns
    files: int = 0  # MCAP files
    bytes: int = 0  # size of the MCAP files
    facts: Mapping[str, str] = field(default_factory=dict)  # that the recorder was given
    attached: Sequence[AttachmentIndex] = ()
    domains: list[str] = field(default_factory=list)  # name and parameters
    open_sessions: list[tuple[str, str]] = field(default_factory=list)  # participant, session
    topics: Sequence[TopicRow] = ()
    options: Sequence[OptionRow] = ()
    criteria: Sequence[CriterionRow] = ()  # over time, as the learner published them
    option_runs: dict[str, int] = field(default_factory=dict)  # by status
    plans: dict[str, int] = field(default_factory=dict)
    policy_runs: dict[str, int] = field(default_factory=dict)
    interruptions: int = 0  # options that policies interrupted, since another was worth more
    execution_changes: int = 0  # of policies while they ran
    episodes: int = 0
    episodes_ended: int = 0  # whose last state was recorded
    streams: Sequence[Stream] = ()

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.messages for topic in self.topics)

    @property
    def missing(self) -> int:
        """Number of messages that were sent and are not in the bag."""
        return sum(stream.missing for stream in self.streams)

    @property
    def participants(self) -> tuple[str, ...]:
        """Codes of the people who taught or sat down to, sorted."""
        taught = {option.participant for option in self.options}
        return tuple(sorted(taught | {participant for participant, _ in self.open_sessions}))

    @property
    def sessions(self) -> tuple[str, ...]:
        """Return the codes of all sessions, sorted."""
        taught = {code for option in self.options for code in option.sessions}
        return tuple(sorted(taught | {session for _, session in self.open_sessions}))

    def to_dict(self) -> dict[str, Any]:
        """Return the facts as JSON data."""
        facts = asdict(replace(self, streams=()))
        return {
            'sittings': facts.pop('open_sessions'),  # the key of version 0.1.0
            **facts,
            'attached': [
                {'name': file.name, 'bytes': file.data_size, 'media_type': file.media_type}
                for file in self.attached
            ],
            'topics': [{name: getattr(t, name) for name in _OF_TOPIC} for t in self.topics],
            'streams': [{name: getattr(s, name) for name in _OF_STREAM} for s in self.streams],
            'messages': self.messages,
            'missing': self.missing,
            'participants': list(self.participants),
            'sessions': list(self.sessions),
        }

    def to_text(self) -> str:
        """Return the facts as text for a person."""
        told = [
            (name.replace('_', ' '), _FACT_TEXTS.get((name, value), value))
            for name, value in sorted(self.facts.items())
        ]
        attached = [(file.name, file.data_size, file.media_type) for file in self.attached]
        topics = [(topic.name, topic.messages, topic.type) for topic in self.topics]
        taught = [
            (
                *(o.participant, o.option, o.demonstrations, o.not_here, o.withdrawn),
                *(o.steps, round(o.seconds), 'yes' if o.criteria_met else 'no'),
            )
            for o in self.options
        ]
        parts = [
            self._head(),
            table(('recorded with', ''), told),
            table(('attached file', 'bytes', 'type'), attached),
            table(_TAUGHT, taught),
            table(_CRITERIA, list(map(_criterion, self.criteria))),
            self._events(),
            table(('topic', 'messages', 'type'), topics),
            self._loss(),
        ]
        return '\n\n'.join(part for part in parts if part)

    def _head(self) -> str:
        begun = datetime.fromtimestamp(self.start / 1e9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
        pairs = [
            ('bag', self.path),
            *([('recording', BEING_RECORDED)] if self.recording else []),
            *(('DAMAGED', line) for line in self.damage.splitlines()),
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

    def _events(self) -> str:
        lines = [f'episodes: {self.episodes}, {self.episodes_ended} recorded to their end']
        for name in ('option_runs', 'plans', 'policy_runs'):
            if counts := getattr(self, name):
                each = ', '.join(f'{status} {count}' for status, count in sorted(counts.items()))
                lines.append(one_line(f'{name.replace("_", " ")}: {each}'))
        if self.policy_runs:
            lines.append(
                f'in policy runs: {self.interruptions} options stopped by the plan, '
                f'{self.execution_changes} changes of execution'
            )
        return '\n'.join(lines)

    def _loss(self) -> str:
        odd = [row for row in self.streams if row.missing or row.duplicates]
        if not odd:
            return f'missing: 0 messages (by the numbers in {len(self.streams)} streams)'
        worst = sorted(odd, key=lambda row: (row.missing, row.duplicates), reverse=True)[
            :_MOST_ROWS
        ]
        told = table(
            ('topic', 'publisher', 'sent', 'missing', 'repeated'),
            [(row.topic, row.publisher, row.last, row.missing, row.duplicates) for row in worst],
        )
        more = f'\nand {len(odd) - len(worst)} streams more' if len(odd) > len(worst) else ''
        return f'missing: {self.missing} messages\n{told}{more}'


def _criterion(row: CriterionRow) -> tuple[object, ...]:
    """Return when a criterion held first, and its value then and at the end, as ``_CRITERIA``."""

    def measured(point: CriterionPoint) -> str:
        return '-' if point.value is None else f'{point.value:.3g}'

    first = ('never', '-', '-')
    if (met := row.first_met) is not None:
        shown = f'{met.demonstrations} shown, {met.not_here} not here'
        first = (shown, f'{met.seconds:.1f}', measured(met))
    threshold = '-' if math.isnan(row.threshold) else f'{row.threshold:.3g}'
    named = (row.participant, row.option, row.criterion, threshold)
    return (*named, *first, measured(row.points[-1]))


def option_rows(bag: Bag) -> Sequence[OptionRow]:
    """Return the options that were taught."""
    return summarise(bag, bag.of_type(DEMONSTRATION) + bag.of_type(_STATUS)).options


def summarise(bag: Bag, topics: Collection[str] | None = None) -> BagInfo:
    """
    Read a bag once and return what it holds.

    :param topics: that are read; None: all.
    """
    info, counter, games = BagInfo(str(bag.path)), MessageCounter(bag), EpisodeGrouping(bag)
    if topics is None:
        info.domains = [f'{name} {parameters}' for name, parameters in domains_played(bag)]
    demonstrations: list[Demonstration] = []
    met: dict[tuple[str, str], bool] = {}  # all criteria, by participant and option
    criteria: dict[tuple[str, str, str], CriterionRow] = {}
    results = {
        _OPTION_RESULT: info.option_runs,
        PLAN_RESULT: info.plans,
        _POLICY_RESULT: info.policy_runs,
    }

    def episode(group: EpisodeMessages) -> None:
        info.episodes += 1
        info.episodes_ended += is_ended(bag, group)

    def status(recorded: Recorded, message: Any) -> None:
        for option in message.options:
            taught = (option.participant, option.option_name)
            met[taught] = option.criteria_met
            for criterion in option.criteria:
                key = (*taught, criterion.name)
                row = criteria.setdefault(key, CriterionRow(*key))
                row.threshold, last = criterion.threshold, row.points[-1:]
                point = CriterionPoint(
                    (recorded.log_time - counter.extent.first) / 1e9,
                    option.n_demonstrations,
                    option.n_not_here,
                    criterion.value if criterion.measurable else None,
                    criterion.met,
                )
                if [replace(point, seconds=each.seconds) for each in last] != last or not last:
                    row.points.append(point)

    def result(recorded: Recorded, message: Any) -> None:
        names = _constants(bag.topics[recorded.topic].schema, 'STATUS_')
        name = names.get(message.status, f'status {message.status}').lower()
        counts = results[recorded.type]
        counts[name] = counts.get(name, 0) + 1
        if recorded.type == _POLICY_RESULT:  # older versions have no such fields
            info.interruptions += getattr(message, 'interruptions', 0)
            info.execution_changes += getattr(message, 'execution_changes', 0)

    def lesson(_: Recorded, message: Any) -> None:
        opened = (message.participant, message.session)
        if message.participant and opened not in info.open_sessions:
            info.open_sessions.append(opened)

    is_of_game = of_the_game(bag)

    def demonstration(recorded: Recorded, message: Any) -> None:
        demo = demonstration_from_message(message)
        if is_of_game(recorded, demo):
            demonstrations.append(demo)

    handlers: dict[str, Callable[[Recorded, Any], None]] = {
        DEMONSTRATION: demonstration,
        LESSON_STATE: lesson,
        _STATUS: status,
        **dict.fromkeys(results, result),
    }
    for recorded in bag.messages(topics):
        if not counter.add(recorded) or not bag.is_genuine(recorded):
            continue
        if recorded.topic in games.topics and (group := games.add(recorded)) is not None:
            episode(group)
        if (handler := handlers.get(recorded.type)) is not None:
            bag.convert(recorded.topic, recorded.data, partial(handler, recorded))
    for group in games.unfinished():
        episode(group)
    taught: dict[tuple[str, str], list[Demonstration]] = {}
    for demo in each_once(demonstrations):
        taught.setdefault((demo.participant, demo.option_name), []).append(demo)
    return replace(
        info,
        recording=bag.recording,
        damage=bag.damage,
        left_out=bag.left_out,
        start=counter.extent.first if counter.extent.messages else 0,
        duration=counter.extent.duration,
        files=len(bag.files),
        bytes=sum(file.stat().st_size for file in bag.files),
        facts=bag.graph_facts,
        attached=list(bag.attachments.values()),
        topics=[_topic_row(topic, counter) for topic in bag.topics.values()],
        options=[_option_row(demos, met.get(key, False)) for key, demos in taught.items()],
        criteria=list(criteria.values()),
        streams=list(counter.losses),
    )


def _topic_row(topic: Topic, counter: MessageCounter) -> TopicRow:
    loss = tuple[int, ...]()
    if topic.name in counter.stamped:
        missing = [stream.missing for stream in counter.losses if stream.topic == topic.name]
        loss = len(missing), sum(missing)
    return TopicRow(topic.name, topic.type, counter.counts[topic.name], *loss)


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
