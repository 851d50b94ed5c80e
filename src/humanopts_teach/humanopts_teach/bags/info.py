"""What a bag holds, found in one pass: people, options, runs, plans, episodes and loss."""

from collections import Counter
from dataclasses import replace
from functools import lru_cache, partial
import math
from typing import Any

from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    each_once,
    Kind,
)
from humanopts_teach.bags.check import Tally
from humanopts_teach.bags.contents import (
    DEMONSTRATION,
    DOMAIN_INFO,
    EpisodeGrouping,
    EpisodeMessages,
    is_ended,
)
from humanopts_teach.bags.reader import Bag, Recorded
from humanopts_teach.bags.rosbag2 import Topic
from humanopts_teach.bags.schemas import constants
from humanopts_teach.bags.summary import (
    AttachedRow,
    BagInfo,
    CriterionPoint,
    CriterionRow,
    OptionRow,
    TopicRow,
)

_LESSON_STATE = 'humanopts_interfaces/msg/LessonState'
_STATUS = 'humanopts_interfaces/msg/LearningStatus'
_OPTION_RESULT = 'humanopts_interfaces/msg/OptionResult'
PLAN_RESULT = 'humanopts_interfaces/msg/PlanResult'
_POLICY_RESULT = 'humanopts_interfaces/msg/PolicyResult'
_constants = lru_cache(constants)


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


class _Collector:
    """Collects what a bag holds, message by message."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._tally = Tally(bag)
        self._games = EpisodeGrouping(bag)
        self._ends: list[bool] = []  # whether the end of each episode was recorded
        self._demonstrations: list[Demonstration] = []
        self._met: dict[tuple[str, str], bool] = {}  # all criteria, by participant and option
        self._criteria: dict[tuple[str, str, str], CriterionRow] = {}
        self._domains: dict[str, None] = {}
        self._open_sessions: dict[tuple[str, str], None] = {}
        self._results: dict[str, Counter[str]] = {
            kind: Counter() for kind in (_OPTION_RESULT, PLAN_RESULT, _POLICY_RESULT)
        }
        self._interruptions = self._execution_changes = 0
        self._handlers = {
            DEMONSTRATION: self._demonstration,
            DOMAIN_INFO: self._domain,
            _LESSON_STATE: self._lesson,
            _STATUS: self._status,
            **dict.fromkeys(self._results, self._result),
        }

    def add(self, recorded: Recorded) -> None:
        """Take in one message."""
        if not self._tally.add(recorded):
            return
        if recorded.topic in self._games.topics:
            self._episode(self._games.add(recorded))
        if (handler := self._handlers.get(recorded.type)) is not None:
            self._bag.convert(recorded.topic, recorded.data, partial(handler, recorded))

    def result(self) -> BagInfo:
        """Return what was collected."""
        bag, tally = self._bag, self._tally
        for group in self._games.unfinished():
            self._episode(group)
        return BagInfo(
            path=str(bag.path),
            damage=bag.damage,
            start=tally.extent.first if tally.extent.messages else 0,
            duration=tally.extent.duration,
            files=len(bag.files),
            bytes=sum(file.stat().st_size for file in bag.files),
            facts=bag.metadata.get('humanopts', {}),
            attached=tuple(
                AttachedRow(name, at.data_size, at.media_type)
                for name, at in bag.attachments.items()
            ),
            domains=tuple(self._domains),
            open_sessions=tuple(self._open_sessions),
            topics=tuple(self._topic_row(topic) for topic in bag.topics.values()),
            options=tuple(self.option_rows()),
            criteria=tuple(self._criteria.values()),
            option_runs=dict(self._results[_OPTION_RESULT]),
            plans=dict(self._results[PLAN_RESULT]),
            policy_runs=dict(self._results[_POLICY_RESULT]),
            interruptions=self._interruptions,
            execution_changes=self._execution_changes,
            episodes=len(self._ends),
            episodes_ended=sum(self._ends),
            streams=tuple(tally.ledger),
        )

    def _topic_row(self, topic: Topic) -> TopicRow:
        tally, loss = self._tally, tuple[int, ...]()
        if topic.name in tally.stamped:
            missing = [stream.missing for stream in tally.ledger if stream.topic == topic.name]
            loss = len(missing), sum(missing)
        return TopicRow(topic.name, topic.type, tally.counts[topic.name], *loss)

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
            criteria_met=self._met.get((participant, name), False),
        )

    def _episode(self, group: EpisodeMessages | None) -> None:
        """Count an episode that is over."""
        if group is not None:
            self._ends.append(is_ended(self._bag, group))

    def _demonstration(self, _: Recorded, message: Any) -> None:
        self._demonstrations.append(demonstration_from_message(message))

    def _domain(self, _: Recorded, message: Any) -> None:
        self._domains[f'{message.domain} {message.parameters}'] = None

    def _lesson(self, _: Recorded, message: Any) -> None:
        if message.participant:
            self._open_sessions[message.participant, message.session] = None

    def _status(self, recorded: Recorded, message: Any) -> None:
        for option in message.options:
            taught = (option.participant, option.option_name)
            self._met[taught] = option.criteria_met
            for criterion in option.criteria:
                point = CriterionPoint(
                    (recorded.log_time - self._tally.extent.first) / 1e9,
                    option.n_demonstrations,
                    option.n_not_here,
                    criterion.value if criterion.measurable else None,
                    criterion.met,
                )
                key = (*taught, criterion.name)
                before = self._criteria.get(key, CriterionRow(*key, 0.0, ()))
                points = before.points
                if not points or replace(point, seconds=points[-1].seconds) != points[-1]:
                    points = (*points, point)
                self._criteria[key] = CriterionRow(*key, criterion.threshold, points)

    def _result(self, recorded: Recorded, message: Any) -> None:
        names = _constants(self._bag.topics[recorded.topic].schema, 'STATUS_')
        name = names.get(message.status, f'status {message.status}')
        self._results[recorded.type][name.lower()] += 1
        if recorded.type == _POLICY_RESULT:  # older versions have no such fields
            self._interruptions += getattr(message, 'interruptions', 0)
            self._execution_changes += getattr(message, 'execution_changes', 0)
