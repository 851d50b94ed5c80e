"""A summary of a bag, read in one pass: people, options, runs, plans, episodes and losses."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, UTC
from functools import partial
from itertools import chain
import math
from operator import attrgetter
from typing import Any

from humanopts_learner.demonstrations import Demonstration, each_once, judged, Kind
from humanopts_ros.limits import one_line, shown
from humanopts_ros.recording import INTERFACES, own_name
from humanopts_teach.bags.check import MessageCounter
from humanopts_teach.bags.contents import demonstration_decoder, domains_played, state_topics
from humanopts_teach.bags.reader import Bag, BEING_RECORDED, DEMONSTRATION, LESSON_STATE
from humanopts_teach.bags.recording import Recorded
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.sequence_numbers import read_stamp, Stream
from humanopts_teach.text_table import table

_UNKNOWN: Any = {'exam_right': 0, 'exam_runs': 0, 'learned': False, 'status': ''}
_MAX_ROWS = 50  # streams with losses in the text
_STATUS = f'{INTERFACES}msg/LearningStatus'
PLAN_RESULT = f'{INTERFACES}msg/PlanResult'
_POLICY_RESULT = f'{INTERFACES}msg/PolicyResult'
_RESULTS = {
    f'{INTERFACES}msg/OptionResult': 'option runs',
    PLAN_RESULT: 'plans',
    _POLICY_RESULT: 'policy runs',
}


@dataclass(frozen=True)
class TopicRow:
    """One topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # number of publishers; None: messages have no numbers
    lost: int | None = None  # according to gaps in the numbers; None: unknown


@dataclass(frozen=True)
class OptionRow:
    """An option of a participant, summarised from its demonstrations."""

    participant: str
    option: str
    sessions: tuple[str, ...]
    features: tuple[str, ...]
    demonstrations: int
    not_here: int
    withdrawn: int  # withdrawn demonstrations; excluded from the other fields
    steps: int  # total of all demonstrations
    seconds: float  # total time of the person for all demonstrations, without judged runs
    judged: int  # runs judged by the person, in exams and in answer to questions
    exam_right: int  # this and the next three: from the last learning status
    exam_runs: int
    learned: bool
    status: str  # empty: no learning status was recorded

    @classmethod
    def of(cls, demos: Sequence[Demonstration], known: Any) -> 'OptionRow':
        """
        Summarise an option.

        :param demos: its demonstrations and judged runs.
        :param known: its newest OptionStatus; None: not recorded.
        """
        given = [demo for demo in demos if demo.kind is not Kind.JUDGED]
        kept = [demo for demo in given if not demo.withdrawn]
        trajectories = [demo for demo in kept if demo.kind is Kind.TRAJECTORY]
        newest = max(kept or given or demos, key=attrgetter('number'))
        return cls(
            participant=newest.participant,
            option=newest.option_name,
            sessions=tuple(dict.fromkeys(demo.session for demo in demos)),
            features=newest.chosen_features,
            demonstrations=len(trajectories),
            not_here=len(kept) - len(trajectories),
            withdrawn=len(given) - len(kept),
            steps=sum(len(demo.actions) for demo in trajectories),
            seconds=math.fsum(demo.seconds for demo in kept if math.isfinite(demo.seconds)),
            judged=sum(not run.withdrawn for run in judged(demos)),
            **{name: getattr(known, name, usual) for name, usual in _UNKNOWN.items()},
        )


@dataclass(frozen=True)
class CriterionRow:
    """An option's criterion after a demonstration, from the learning status."""

    participant: str
    option: str
    criterion: str  # return, initiation or termination
    seconds: float = field(compare=False)  # from the start of the bag
    demonstrations: int  # number so far
    not_here: int  # number of "not here" answers so far
    threshold: float | None  # None: not known yet
    value: float | None  # None: not yet measurable
    met: bool


@dataclass(frozen=True)
class Attached:
    """An attached file."""

    name: str
    bytes: int
    media_type: str


@dataclass(frozen=True)
class BagInfo:
    """The summary of a bag."""

    path: str
    recording: bool  # whether the bag is being recorded (preliminary values)
    damage: Sequence[str]
    omitted: Sequence[str]  # descriptions of omitted messages
    start: int  # time of the first message, ns since the epoch
    duration: int  # time from the first to the last message, ns
    messages: int
    missing: int  # number of lost messages
    files: int  # number of MCAP files
    bytes: int  # total size of the MCAP files
    facts: Mapping[str, str]  # facts of the recorder
    attached: Sequence[Attached]
    domains: Sequence[str]  # name and parameters
    participants: Sequence[str]  # those who taught or opened a lesson, sorted
    sessions: Sequence[str]  # sorted
    topics: Sequence[TopicRow]
    options: Sequence[OptionRow]
    criteria: Sequence[CriterionRow]  # at each change, in chronological order
    results: Mapping[str, Mapping[str, int]]  # option runs, plans and policy runs, by status
    interruptions: int  # options interrupted in favour of a better one
    execution_changes: int  # changes of arbitration during policy runs
    episodes: int
    episodes_ended: int  # episodes recorded to their end
    streams: Sequence[Stream]

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as JSON data."""
        streams = [stream.to_dict() for stream in self.streams]
        return asdict(replace(self, streams=())) | {'streams': streams}

    def to_text(self) -> str:
        """Return the summary as human-readable text."""
        start = datetime.fromtimestamp(self.start / 1e9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')
        head = [
            ('bag', self.path),
            *([('recording', BEING_RECORDED)] if self.recording else []),
            *(('DAMAGED', line) for line in self.damage),
            *(('left out', line) for line in self.omitted),
            ('start', start if self.messages else 'nothing was recorded'),
            ('duration', f'{self.duration / 1e9:.1f} s'),
            ('messages', f'{self.messages} on {len(self.topics)} topics'),
            ('size', f'{self.bytes:,} bytes in {self.files} file{"s"[: self.files > 1]}'),
            ('domain', '; '.join(self.domains) or 'not recorded'),
            ('participants', ', '.join(self.participants) or 'none'),
            ('sessions', ', '.join(self.sessions) or 'none'),
        ]
        events = [f'episodes: {self.episodes}, {self.episodes_ended} recorded to their end']
        for name, counts in self.results.items():
            each = ', '.join(f'{status} {count}' for status, count in sorted(counts.items()))
            events += [one_line(f'{name}: {each}')] if counts else []
        if self.results[_RESULTS[_POLICY_RESULT]]:
            events.append(
                f'in policy runs: {self.interruptions} options stopped by the plan, '
                f'{self.execution_changes} changes of execution'
            )
        histories = defaultdict[tuple[str, str, str], list[CriterionRow]](list)
        for row in self.criteria:
            histories[row.participant, row.option, row.criterion].append(row)
        # For each criterion, show when it was first met, and its last value.
        criteria = dict.fromkeys(
            row
            for rows in histories.values()
            for row in (next((row for row in rows if row.met), rows[-1]), rows[-1])
        )
        statuses = [
            one_line(f'{row.option!r} by {row.participant}: {row.status}')
            for row in self.options
            if row.status
        ]
        lossy = [stream for stream in self.streams if stream.missing or stream.repeated]
        lossy.sort(key=attrgetter('missing', 'repeated'), reverse=True)
        parts = [
            '\n'.join(f'{name:12}  {shown(value)}' for name, value in head),
            table(
                [{'recorded with': name, '': value} for name, value in sorted(self.facts.items())]
            ),
            _columns(self.attached, 'name bytes media_type'),
            _columns(
                self.options,
                'participant option demonstrations not_here withdrawn steps seconds judged',
            ),
            '\n'.join(statuses),
            _columns(
                criteria,
                'participant option criterion threshold demonstrations not_here seconds value met',
            ),
            '\n'.join(events),
            _columns(self.topics, 'name messages type'),
            f'missing: {self.missing} messages (by the numbers in {len(self.streams)} streams)',
            table([stream.to_dict() for stream in lossy[:_MAX_ROWS]]),
            f'and {len(lossy) - _MAX_ROWS} more streams' if len(lossy) > _MAX_ROWS else '',
        ]
        return '\n\n'.join(part for part in parts if part)


def _columns(rows: Iterable[Any], names: str) -> str:
    """Return selected attributes of rows as a table."""
    return table(
        [
            {name.replace('_', ' '): _cell(getattr(row, name)) for name in names.split()}
            for row in rows
        ]
    )


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    return '-' if value is None else round(value, 3) if isinstance(value, float) else value


def option_rows(bag: Bag) -> Sequence[OptionRow]:
    """Return the taught options."""
    return summarise(bag, bag.of_type(DEMONSTRATION) + bag.of_type(_STATUS)).options


def summarise(bag: Bag, topics: Collection[str] | None = None) -> BagInfo:
    """
    Read a bag once and return its summary.

    :param topics: topics to read; None: all.
    """
    counter, states, decode = MessageCounter(bag), state_topics(bag), demonstration_decoder(bag)
    own = {name for name in bag.topics if own_name(name, bag.namespace)}
    last_states: dict[tuple[str, str, int], tuple[int, Recorded]] = {}  # step and state by episode
    demonstrations: list[Demonstration] = []
    lessons = set[tuple[str, str]]()  # participant and session
    criteria = defaultdict[tuple[str, str, str], list[CriterionRow]](list)
    newest: dict[tuple[str, str], Any] = {}  # OptionStatus, by participant and option
    results = {name: Counter[str]() for name in _RESULTS.values()}
    policies = Counter[str]()

    def learning_status(message: Any) -> None:
        seconds = (counter.extent.last - counter.extent.first) / 1e9
        for option in message.options:
            key = option.participant, option.option_name
            newest[key] = option
            for each in option.criteria:
                row = CriterionRow(
                    *key,
                    each.name,
                    seconds,
                    option.n_demonstrations,
                    option.n_not_here,
                    None if math.isnan(each.threshold) else each.threshold,
                    each.value if each.measurable else None,
                    each.met,
                )
                rows = criteria[*key, each.name]
                if rows[-1:] != [row]:
                    rows.append(row)

    def result(kind: str, statuses: Mapping[int, str], message: Any) -> None:
        status = statuses.get(message.status, f'status {message.status}').lower()
        results[_RESULTS[kind]][status] += 1
        if kind == _POLICY_RESULT:
            policies['interruptions'] += message.interruptions
            policies['execution_changes'] += message.execution_changes

    handlers: dict[str, Callable[[Any], object]] = {
        LESSON_STATE: lambda message: lessons.add((message.participant, message.session)),
        _STATUS: learning_status,
    }
    for topic in bag.topics.values():
        if topic.type in _RESULTS:
            statuses = constants(topic.schema, 'STATUS_')
            handlers[topic.type] = partial(result, topic.type, statuses)
    for recorded in bag.messages(topics):
        if not counter.add(recorded) or recorded.topic not in own:
            continue
        if recorded.topic in states and (stamp := read_stamp(recorded.data, with_step=True)):
            episode = recorded.topic, stamp.publisher_id, stamp.episode
            if stamp.episode and last_states.get(episode, (-1,))[0] <= stamp.step:
                last_states[episode] = stamp.step, recorded
        elif recorded.type == DEMONSTRATION and (demo := decode(recorded)):
            demonstrations.append(demo)
        elif handler := handlers.get(recorded.type):
            recorded.convert(handler)
    ended = [
        state.convert(lambda message: message.terminated or message.truncated)
        for _, state in last_states.values()
    ]
    taught = defaultdict[tuple[str, str], list[Demonstration]](list)
    for demo in each_once(demonstrations):
        taught[demo.participant, demo.option_name].append(demo)
    options = [OptionRow.of(demos, newest.get(key)) for key, demos in taught.items()]
    lessons = {(participant, session) for participant, session in lessons if participant}
    streams, extent = list(counter.losses), counter.extent
    lost = {name: [s.missing for s in streams if s.topic == name] for name in counter.stamped}
    return BagInfo(
        path=str(bag.path),
        recording=bag.growing,
        damage=bag.damage.splitlines(),
        omitted=bag.omitted,
        start=extent.first if extent.messages else 0,
        duration=extent.times['duration']['nanoseconds'],
        messages=extent.messages,
        missing=counter.losses.missing,
        files=len(bag.files),
        bytes=sum(file.stat().st_size for file in bag.files),
        facts=bag.graph_facts,
        attached=[Attached(f.name, f.data_size, f.media_type) for f in bag.attachments],
        domains=[' '.join(each) for each in domains_played(bag)] if topics is None else [],
        participants=sorted(
            {row.participant for row in options} | {participant for participant, _ in lessons}
        ),
        sessions=sorted({s for row in options for s in row.sessions} | {s for _, s in lessons}),
        topics=[
            TopicRow(
                name,
                topic.type,
                counter.counts[name],
                *([len(lost[name]), sum(lost[name])] if name in lost else []),
            )
            for name, topic in bag.topics.items()
        ],
        options=options,
        criteria=sorted(chain(*criteria.values()), key=attrgetter('seconds')),
        results={name: dict(counts) for name, counts in results.items()},
        interruptions=policies['interruptions'],
        execution_changes=policies['execution_changes'],
        episodes=len(last_states),
        episodes_ended=sum(map(bool, ended)),
        streams=streams,
    )
