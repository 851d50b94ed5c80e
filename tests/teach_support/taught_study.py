"""Studies of simulated teachers in one process: records and lessons, without a graph."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import time

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.summary import OptionSummary
from humanopts_teach.commands.study_session import simulated_part
from humanopts_teach.lesson.in_process import Taught, teach
from humanopts_teach.lesson.records import with_uuid
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.lesson.store import DemonstrationStore
from humanopts_teach.study.plan import Condition, PartKind, StudyPlan
from humanopts_teach.study.record import OpenRecord, StudyFolder

Pool = Mapping[str, list[Taught]]  # lessons by condition; the same index is the same teacher


@dataclass
class Clock:
    """A clock that moves on with each look, and by what a person would take."""

    now: float = field(default_factory=time.time)  # s since 1970

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


def lesson(condition: Condition, seed: int, error_rate: float) -> Taught:
    """Return the lesson of one simulated teacher in a condition."""
    domain = make_domain(condition.domain, dict(condition.parameters))
    options = tuple(reference_options(domain))[:1]
    teacher = TeacherSettings(options, error_rate=error_rate, own_habits=True, seed=seed)
    return teach(domain, teacher, LessonRules(seed=seed, method=condition.learn))


def pool_of(plan: StudyPlan, teachers: int) -> Pool:
    """Return the lessons of simulated teachers, from careful ones to some with many errors."""
    rates = [0.2 * number / teachers for number in range(teachers)]
    return {
        each.name: [lesson(each, seed, rate) for seed, rate in enumerate(rates)]
        for each in plan.conditions
    }


def take_part(
    folder: StudyFolder,
    plan: StudyPlan,
    code: str,
    taught: Mapping[str, Taught],
    clock: Clock,
    most: int | None = None,
) -> OpenRecord:
    """
    Write the record and lessons of a participant who teaches as in earlier lessons.

    :param taught: lessons, by condition.
    :param most: parts after which the participant leaves; None: finishes.
    """
    who = folder.enter(plan, code)
    record = OpenRecord(who.path, clock=clock)
    for part in plan.parts_of(who.place, who.number)[:most]:
        own = taught.get(part.condition)
        if part.kind is PartKind.TEACH and own is not None:
            path = folder.path / code / part.condition / 'demonstrations'
            demos = [replace(d, participant=code) for d in (*own.demonstrations, *own.judged)]
            with DemonstrationStore(path) as store:
                store.append(*map(with_uuid, demos))

        def teach(taught: Taught | None = own) -> Sequence[OptionSummary]:
            clock.now += 20.0 if taught is None else taught.seconds
            return () if taught is None else taught.summaries

        simulated_part(part, record, plan.seed, who.number, teach)
    if most is None:
        record.note('ended')
    return record
