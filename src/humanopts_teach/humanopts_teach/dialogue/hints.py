"""What comes next in a lesson, in words."""

from humanopts_teach.dialogue.answers import LessonView, Phase

_HINTS = {
    Phase.NO_SESSION: 'Open a session to begin.',
    Phase.NO_OPTION: 'Name the option that you want to teach.',
    Phase.ASKING: 'Answer the question.',
    Phase.READY: 'Begin the next demonstration.',
    Phase.DEMONSTRATING: 'Show the option, then say done; or say not here, or discard.',
    Phase.LEARNING: 'The learner works on the demonstration.',
    Phase.FINISHED: 'Name the next option to teach.',
}
_GOES_ON = (Phase.DEMONSTRATING, Phase.LEARNING)  # also while the lesson is paused


def hint(view: LessonView) -> str:
    """Say what to do next; where an option is finished, why."""
    still = view.paused and view.phase not in _GOES_ON
    words = 'The lesson is paused.' if still else _HINTS[view.phase]
    if view.phase is not Phase.FINISHED:
        return words
    given = view.n_demonstrations + view.n_not_here
    spent = f'The budget of {view.budget} is spent. ' if given >= view.budget else ''
    reached = 'All criteria hold.' if view.criteria_met else 'Not all criteria hold.'
    return f'{spent}{reached} {words}'
