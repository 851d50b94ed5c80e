"""The demonstrations and verdicts given by people."""

from humanopts_learner.demonstrations import (
    Demonstration,
    each_once,
    judged,
    Kind,
    shown,
    version_of,
)
from humanopts_learner.intervals import Interval
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation


def shown_demonstrations(evaluation: BagEvaluation) -> list[tuple[Demonstration, str]]:
    """
    Return each demonstration once, with a word on its use.

    Sorted by person and option in order of appearance, then by number.
    """
    used = {uuid for option in evaluation.options for uuid in option.option.uuids}
    return [(demo, _use(demo, demo.uuid in used)) for demo in shown(_by_option(evaluation))]


def judged_runs(evaluation: BagEvaluation) -> list[tuple[Demonstration, bool]]:
    """Return each judged run, sorted likewise, and whether its option is learned the same now."""
    demos = _by_option(evaluation)
    now = {
        version_of(demo for demo in demos if demo.uuid in each.option.uuids)
        for each in evaluation.options
    }
    return [(run, run.option_version in now) for run in judged(demos) if not run.withdrawn]


def _by_option(evaluation: BagEvaluation) -> list[Demonstration]:
    demos = each_once(evaluation.demonstrations)
    order = list(dict.fromkeys((demo.participant, demo.option_name) for demo in demos))
    return sorted(demos, key=lambda d: (order.index((d.participant, d.option_name)), d.number))


def _use(demo: Demonstration, used: bool) -> str:
    kept = 'kept' if demo.kind is Kind.TRAJECTORY else 'kept: not here'
    if demo.machine_steps:
        kept = f'kept: the machine took the first {demo.machine_steps}'
    return 'taken back' if demo.withdrawn else kept if used else 'left out'


def shown_return(evaluation: BagEvaluation, option: OptionEvaluation) -> Interval:
    """Return the mean return of an option's demonstrations, with a Student's t interval."""
    used = set(option.option.uuids)
    return Interval.of(
        [
            demo.total_reward
            for demo in each_once(evaluation.demonstrations)
            if demo.uuid in used and demo.kind is Kind.TRAJECTORY
        ]
    )


def teachers(evaluation: BagEvaluation) -> list[tuple[OptionEvaluation, int, Interval]]:
    """
    Return each option of each person, grouped by name; empty if only one person taught.

    :return: option, number of its withdrawn demonstrations, and return of its demonstrations.
    """
    if len(evaluation.people) < 2:
        return []
    back = [
        (demo.participant, demo.option_name)
        for demo in shown(each_once(evaluation.demonstrations))
        if demo.withdrawn
    ]
    return [
        (each, back.count((each.option.participant, name)), shown_return(evaluation, each))
        for name in dict.fromkeys(each.option.name for each in evaluation.options)
        for each in evaluation.options
        if each.option.name == name
    ]
