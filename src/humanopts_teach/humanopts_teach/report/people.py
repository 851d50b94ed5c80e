"""The demonstrations and verdicts given by people."""

from humanopts_env.domains.capabilities import pictured_board_of
from humanopts_learner.demonstrations import (
    Demonstration,
    each_once,
    Kind,
    shown,
    version_of,
)
from humanopts_learner.intervals import Interval
from humanopts_teach.board_html import board_html
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation

MAX_PICTURES = 12  # of wrong runs


def shown_demonstrations(evaluation: BagEvaluation) -> list[tuple[Demonstration, str]]:
    """
    Return each demonstration once, with a description of its use.

    Sorted by person and option in order of appearance, then by number.
    """
    used = {uuid for option in evaluation.options for uuid in option.option.uuids}
    demos = shown(each_once(evaluation.demonstrations))
    order = list(dict.fromkeys((demo.participant, demo.option_name) for demo in demos))
    demos.sort(key=lambda d: (order.index((d.participant, d.option_name)), d.number))
    return [(demo, _use(demo, demo.uuid in used)) for demo in demos]


def judged_runs(evaluation: BagEvaluation) -> list[tuple[Demonstration, bool]]:
    """Return the judged runs by option, and whether each is from the option's newest version."""
    found = []
    for each in evaluation.options:
        used = [d for d in evaluation.demonstrations if d.uuid in each.option.uuids]
        version = version_of(each_once(used))
        found += [(run, run.option_version == version) for run in each.judged]
    return found


def wrong_ends(evaluation: BagEvaluation) -> list[tuple[Demonstration, str]]:
    """Return the newest wrong runs, each with a picture of its last state, in HTML."""
    domain = evaluation.domain
    wrong = [run for run, _ in judged_runs(evaluation) if not run.right][-MAX_PICTURES:]
    return [
        (run, board_html(pictured_board_of(domain, domain.decode(run.states[-1]))))
        for run in wrong
    ]


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
