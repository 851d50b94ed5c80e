"""What people showed, and how they compare: tables of demonstrations and of teachers."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from humanopts_learner.demonstrations import Demonstration, each_once, Kind
from humanopts_learner.intervals import Interval, level_of_each
from humanopts_learner.planning.request import HUMAN
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation
from humanopts_teach.report.pages import duration, Finding, limits, number


@dataclass(frozen=True)
class DemonstrationRow:
    """One demonstration or "not here" answer, as the report tells it."""

    participant: str
    number: int
    option: str
    start: str  # in the notation of the domain
    steps: int
    total: float | None  # return, reward units; None: "not here"
    seconds: float
    verdict: str


def demonstration_rows(evaluation: BagEvaluation) -> list[DemonstrationRow]:
    """Return all demonstrations, each once: by person and option as they came, and by number."""
    used = {uuid for option in evaluation.options for uuid in option.last.option.uuids}
    demos = each_once(evaluation.demonstrations)
    order = list(dict.fromkeys((demo.participant, demo.option_name) for demo in demos))
    demos.sort(key=lambda d: (order.index((d.participant, d.option_name)), d.number))
    return [
        DemonstrationRow(
            demo.participant,
            demo.number,
            demo.option_name,
            demo.states[0] if demo.states else '',
            len(demo.actions),
            demo.total_reward if demo.kind is Kind.TRAJECTORY else None,
            demo.seconds,
            _verdict(demo, demo.uuid in used),
        )
        for demo in demos
    ]


def _verdict(demo: Demonstration, used: bool) -> str:
    kept = 'kept' if demo.kind is Kind.TRAJECTORY else 'kept: not here'
    if demo.machine_steps:
        kept = f'kept: the machine took the first {demo.machine_steps}'
    return 'taken back' if demo.withdrawn else kept if used else 'left out'


def shown_return(evaluation: BagEvaluation, option: OptionEvaluation) -> Interval:
    """Return the mean return of an option's demonstrations, by Student's t over them."""
    used = set(option.last.option.uuids)
    return Interval.of(
        [
            demo.total_reward
            for demo in each_once(evaluation.demonstrations)
            if demo.uuid in used and demo.kind is Kind.TRAJECTORY
        ]
    )


@dataclass(frozen=True)
class TeacherRow:
    """One option as one of several people taught it."""

    option: str
    participant: str
    demonstrations: int
    withdrawn: int
    seconds: str  # of teaching
    shown: Interval  # return of a demonstration
    gain: Interval  # of the policy over the demonstrations, from the same starts
    accuracies: tuple[float | None, float | None, float | None]  # of policy, I and beta
    criteria_met: bool


def teacher_rows(evaluation: BagEvaluation) -> list[TeacherRow]:
    """Return a row for each option and person, those of an option together; of one person none."""
    if len(evaluation.people) < 2:
        return []
    back = [
        (demo.participant, demo.option_name)
        for demo in each_once(evaluation.demonstrations)
        if demo.withdrawn
    ]
    rows = []
    for name in dict.fromkeys(block.name for block in evaluation.blocks):
        for option in evaluation.options:
            point, block = option.last, option.last.block
            if block.name == name:
                rows.append(
                    TeacherRow(
                        name,
                        option.participant,
                        block.n_demonstrations,
                        back.count((option.participant, name)),
                        duration(point.seconds),
                        shown_return(evaluation, option),
                        point.judgement.gain,
                        (
                            block.policy_accuracy,
                            block.classification_accuracy_initiation,
                            block.classification_accuracy_termination,
                        ),
                        block.criteria_met,
                    )
                )
    return rows


def people_findings(evaluation: BagEvaluation) -> Iterator[Finding]:
    """Compare the plans with the options of each two people, in the same episodes."""
    plans = [
        plan for plan in evaluation.plans if plan.participant and plan.row.action_set == HUMAN
    ]
    pairs = list(combinations(plans, 2))
    for one, other in pairs:
        if len(one.totals) != len(other.totals):
            continue
        gain = Interval.of_difference(one.totals, other.totals, level_of_each(len(pairs)))
        words = {True: 'better than', False: 'worse than', None: 'not distinguishable from'}
        verdict = 'as good as' if gain.low == gain.high == 0.0 else words[gain.above()]
        yield Finding(
            None,
            f'A plan with the options of {one.participant} is {verdict} one with those of '
            f'{other.participant}: from the same start states, it returns {number(gain.mean)} '
            f'{limits(gain)} more.',
        )
