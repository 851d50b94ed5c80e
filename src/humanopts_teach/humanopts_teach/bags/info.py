"""What a bag holds, found in one pass: people, options, runs, plans, episodes and loss."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
import math
from typing import Any

from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
    each_once,
    Kind,
)
from humanopts_teach.bags.contents import (
    DEMONSTRATION,
    DOMAIN_INFO,
    EpisodeGrouping,
    EpisodeMessages,
    GAME_STATE,
    is_ended,
)
from humanopts_teach.bags.reader import Bag, Recorded
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.sequence_numbers import is_stamped, Ledger, read_stamp
from humanopts_teach.bags.summary import (
    AttachedRow,
    BagInfo,
    CriterionPoint,
    CriterionRow,
    OptionRow,
    StreamRow,
    TopicRow,
)

_LESSON_STATE = 'humanopts_interfaces/msg/LessonState'
_STATUS = 'humanopts_interfaces/msg/LearningStatus'
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'
PLAN_RESULT = 'humanopts_interfaces/msg/PlanResult'
_constants = lru_cache(constants)
_POLICY_RESULT = 'humanopts_interfaces/msg/PolicyResult'


def summarise(bag: Bag) -> BagInfo:
    """Read a bag once and return what it holds."""
    collector = _Collector(bag)
    for recorded in bag.messages(decoded=False):
        collector.add(recorded)
    return collector.result()


def option_rows(bag: Bag) -> list[OptionRow]:
    """Return the options that were taught."""
    collector = _Collector(bag)
    for recorded in bag.messages(bag.of_type(DEMONSTRATION) + bag.of_type(_STATUS), decoded=False):
        collector.add(recorded)
    return collector.option_rows()


def count_loss(bag: Bag) -> Ledger:
    """Count what is missing in a bag, by the numbers in every humanopts message."""
    ledger = Ledger()
    stamped = [topic.name for topic in bag.topics.values() if is_stamped(topic.schema)]
    for recorded in bag.messages(stamped, decoded=False):
        stamp = read_stamp(recorded.data)
        if stamp is not None:
            ledger.add(recorded.topic, stamp)
    return ledger


class _Collector:
    """Collects what a bag holds, message by message."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._first = self._last = 0
        self._counts: Counter[str] = Counter()
        self._ledger = Ledger()
        self._stamped = {t.name for t in bag.topics.values() if is_stamped(t.schema)}
        self._demonstrations: list[Demonstration] = []
        self._criteria: dict[tuple[str, str], bool] = {}
        self._developed: dict[tuple[str, str, str], list[CriterionPoint]] = {}
        self._thresholds: dict[tuple[str, str, str], float] = {}
        self._games = EpisodeGrouping(bag)
        self._episodes = self._episodes_ended = 0
        self._domains: dict[str, None] = {}
        self._open_sessions: dict[tuple[str, str], None] = {}
        self._results: dict[str, Counter[str]] = {
            kind: Counter() for kind in (_OPTION_RESULT, PLAN_RESULT, _POLICY_RESULT)
        }
        self._interruptions = self._execution_changes = 0
        self._handlers: dict[str, Callable[[Recorded, Any], None]] = {
            DEMONSTRATION: self._demonstration,
            DOMAIN_INFO: self._domain,
            _LESSON_STATE: self._lesson,
            _STATUS: self._status,
            **dict.fromkeys(self._results, self._result),
        }

    def add(self, recorded: Recorded) -> None:
        """Take in one message."""
        self._first = self._first or recorded.log_time
        self._last = max(self._last, recorded.log_time)
        self._counts[recorded.topic] += 1
        if recorded.topic in self._stamped:
            stamp = read_stamp(recorded.data)
            if stamp is None:
                self._bag.note(f'a message on {recorded.topic} does not decode')
                return
            self._ledger.add(recorded.topic, stamp)
        if recorded.type == GAME_STATE:
            self._episode(self._games.add(recorded))
        handler = self._handlers.get(recorded.type)
        if handler is not None:
            message = self._bag.decode(recorded.topic, recorded.data)
            if message is not None:
                with self._bag.skipping_missing_fields(recorded.topic):
                    handler(recorded, message)

    def result(self) -> BagInfo:
        """Return what was collected."""
        bag = self._bag
        for group in self._games.unfinished():
            self._episode(group)
        return BagInfo(
            path=str(bag.path),
            damage=bag.damage,
            start=self._first,
            duration=self._last - self._first,
            files=len(bag.files),
            bytes=sum(file.stat().st_size for file in bag.files),
            facts=bag.metadata.get('humanopts', {}),
            attached=tuple(
                AttachedRow(name, at.size, at.media_type) for name, at in bag.attachments.items()
            ),
            domains=tuple(self._domains),
            open_sessions=tuple(self._open_sessions),
            topics=tuple(self._topic_rows()),
            options=tuple(self.option_rows()),
            criteria=tuple(
                CriterionRow(*key, self._thresholds[key], tuple(points))
                for key, points in self._developed.items()
            ),
            option_runs=dict(self._results[_OPTION_RESULT]),
            plans=dict(self._results[PLAN_RESULT]),
            policy_runs=dict(self._results[_POLICY_RESULT]),
            interruptions=self._interruptions,
            execution_changes=self._execution_changes,
            episodes=self._episodes,
            episodes_ended=self._episodes_ended,
            streams=tuple(
                StreamRow(topic, who, s.first, s.last, s.received, s.missing, s.duplicates)
                for topic, who, s in self._ledger
            ),
        )

    def _topic_rows(self) -> list[TopicRow]:
        return [
            TopicRow(topic.name, topic.type, self._counts[topic.name], topic.name in self._stamped)
            for topic in self._bag.topics.values()
        ]

    def option_rows(self) -> list[OptionRow]:
        """Return what was collected of options."""
        taught: dict[tuple[str, str], list[Demonstration]] = {}
        for demo in each_once(self._demonstrations):
            taught.setdefault((demo.participant, demo.option_name), []).append(demo)
        return [self._option_row(*key, demos) for key, demos in taught.items()]

    def _option_row(self, participant: str, name: str, demos: list[Demonstration]) -> OptionRow:
        kept = [demo for demo in demos if not demo.withdrawn]
        shown = [demo for demo in kept if demo.kind is Kind.TRAJECTORY]
        newest = max(kept or demos, key=lambda demo: demo.number)
        return OptionRow(
            participant=participant,
            option=name,
            sessions=tuple(dict.fromkeys(demo.session for demo in demos)),
            features=newest.chosen_features,
            demonstrations=len(shown),
            not_here=len(kept) - len(shown),
            withdrawn=len(demos) - len(kept),
            steps=sum(len(demo.actions) for demo in shown),
            seconds=math.fsum(demo.seconds for demo in kept if math.isfinite(demo.seconds)),
            criteria_met=self._criteria.get((participant, name), False),
        )

    def _demonstration(self, recorded: Recorded, message: Any) -> None:
        try:
            self._demonstrations.append(demonstration_from_message(message))
        except DemonstrationError as error:
            self._bag.note(f'a message on {recorded.topic} is left out: {error}')

    def _domain(self, recorded: Recorded, message: Any) -> None:
        self._domains[f'{message.domain} {message.parameters}'] = None

    def _lesson(self, recorded: Recorded, message: Any) -> None:
        if message.participant:
            self._open_sessions[message.participant, message.session] = None

    def _episode(self, group: EpisodeMessages | None) -> None:
        """Count an episode that is over."""
        if group is not None:
            self._episodes += 1
            self._episodes_ended += is_ended(self._bag, group)

    def _status(self, recorded: Recorded, message: Any) -> None:
        for option in message.options:
            taught = (option.participant, option.option_name)
            self._criteria[taught] = option.criteria_met
            for criterion in option.criteria:
                key = (*taught, criterion.name)
                self._thresholds[key] = criterion.threshold
                point = CriterionPoint(
                    (recorded.log_time - self._first) / 1e9,
                    option.n_demonstrations,
                    option.n_not_here,
                    criterion.value if criterion.measurable else None,
                    criterion.met,
                )
                points = self._developed.setdefault(key, [])
                if not points or replace(point, seconds=points[-1].seconds) != points[-1]:
                    points.append(point)

    def _result(self, recorded: Recorded, message: Any) -> None:
        names = _constants(self._bag.topics[recorded.topic].schema, 'STATUS_')
        name = names.get(message.status, f'status {message.status}')
        self._results[recorded.type][name.lower()] += 1
        if recorded.type == _POLICY_RESULT:  # older versions have no such fields
            self._interruptions += getattr(message, 'interruptions', 0)
            self._execution_changes += getattr(message, 'execution_changes', 0)
