"""Advice of a lesson: the next action, and the reason for it."""

from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.summary import NOT_MET, OptionSummary
from humanopts_teach.lesson.requests import LessonView, Phase

_HINTS = {
    Phase.NO_SESSION: 'Open a session to begin.',
    Phase.NO_OPTION: 'Name the option that you want to teach.',
    Phase.ASKING: 'Answer the question.',
    Phase.READY: 'Begin the next demonstration.',
    Phase.DEMONSTRATING: 'Show the option, then say done; or say not here, or discard.',
    Phase.LEARNING: 'The learner is working on the demonstration.',
    Phase.FINISHED: 'Go to the menu for the next option, or to finish.',
    Phase.CHECKING: 'Answer the question.',
    Phase.EXAM: 'Begin the next run of the exam.',
}
_WITHOUT_STARTS = {  # for domains in which the person drives to each start
    Phase.READY: 'Drive to where the option can start, then begin.',
    Phase.EXAM: 'Drive to a start that you have not shown, then begin the next run of the exam.',
}


def advice(
    lesson: LessonView,
    settled: OptionSummary | None,
    wrong: Demonstration | None,
    stage: Phase,
    missing: str | None = None,
) -> str:
    """
    Return advice on what to do next, with the reason if it is not obvious.

    :param lesson: state of the lesson; its ``text`` is ignored.
    :param settled: summary of the option if its criteria are settled; otherwise None.
    :param wrong: last run of the option that the person called wrong; None: none.
    :param stage: as in ``Examination``.
    :param missing: as in ``NextStart``; None: the lesson chooses the starts.
    """
    phase, hint = lesson.phase, _HINTS[lesson.phase]
    spent = lesson.n_demonstrations + lesson.n_not_here >= lesson.budget > 0
    stuck = dict(zip(lesson.stuck_options, lesson.stuck_games)).get(lesson.option_name)
    if phase in (Phase.READY, Phase.FINISHED) and stuck and not spent:
        hint = (
            f'The plan got stuck in {stuck} of {lesson.trial_games} games while running '
            f"'{lesson.option_name}', or where it was needed: show what to do there."
        )
    if missing is not None:
        hint = _WITHOUT_STARTS.get(phase, hint)
        if phase is Phase.READY and lesson.n_demonstrations:
            why = f': {missing}' if missing else ''
            hint = (
                f'Drive to another start{why}. Or run the option and take over where it '
                'goes wrong.'
            )
    if phase is Phase.READY and wrong is not None:
        start = 'where you stopped the run' if wrong.stopped else 'where the run started'
        hint = f'Show what the option should do, starting {start}.'
    if lesson.exam:
        hint = 'Watch the option run, then say right or wrong.'
    if lesson.paused and phase not in (Phase.DEMONSTRATING, Phase.LEARNING):
        hint = 'The lesson is paused.'
    if phase is Phase.FINISHED:
        why = f'The budget of {lesson.budget} is used up. ' if spent else ''
        status = NOT_MET if settled is None else settled.status
        return f'{why}{status[0].upper()}{status[1:]}. {hint}'
    fails = phase in (Phase.READY, Phase.DEMONSTRATING) and stage is Phase.READY and wrong is None
    if fails and settled is not None and settled.criteria_met:
        return (
            f'{settled.result[:-1]}, but from some starts it fails, or too little has '
            f'been shown. {hint}'
        )
    return hint
