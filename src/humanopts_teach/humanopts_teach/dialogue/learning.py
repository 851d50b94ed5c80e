"""What the lesson knows of the learner: how far each option is, and what it still works on."""

from collections.abc import Sequence

from humanopts_learner.demonstrations import Demonstration
from humanopts_teach.dialogue.answers import Progress
from humanopts_teach.dialogue.history import OptionHistory

_REFUSED = {
    False: 'The learner refused the demonstration: {detail}.',
    True: 'The learner did not take the demonstration back: {detail}.',
}
_SILENT = {
    False: 'The learner does not answer. The demonstration is on disk, and is sent again to the '
    'next learner that starts.',
    True: 'The learner does not answer. That the demonstration is taken back is on disk, and is '
    'sent again to the next learner that starts.',
}


class Learning:
    """The learner's side of a lesson, as far as it was heard of."""

    def __init__(self) -> None:
        self._progress: dict[tuple[str, str], Progress] = {}
        self.awaited: Demonstration | None = None  # kept or taken back; not counted in or out yet

    def heard(self, progress: Sequence[Progress]) -> None:
        """Take in what the learner knows of every option."""
        self._progress = {(p.participant, p.option_name): p for p in progress}

    def criteria_met(self, participant: str, option: OptionHistory) -> bool:
        """Whether the learner says so, on the features that are chosen now."""
        known = self._progress.get((participant, option.name))
        chosen = set(option.questions.chosen)
        return (
            known is not None
            and known.criteria_met
            and known.last_uuid not in option.withdrawn  # it has not counted that one out
            and set(known.features) == chosen
        )

    def has_counted(self, demo: Demonstration) -> bool:
        """Tell whether the newest demonstration is counted in; out, where it is withdrawn."""
        known = self._progress.get((demo.participant, demo.option_name))
        newest = known is not None and known.last_uuid == demo.uuid
        return newest != demo.withdrawn

    def refused(self, uuid: str, detail: str) -> str:
        """
        Go on without a demonstration that the learner did not take.

        :return: what to tell the person; empty: it was not the one that is waited for.
        """
        demo = self.awaited
        if demo is None or demo.uuid != uuid:
            return ''
        self.awaited = None
        return _REFUSED[demo.withdrawn].format(detail=detail)

    def silent(self) -> str:
        """
        Go on without the learner, which has not answered in time.

        :return: what to tell the person; empty: nothing is waited for.
        """
        demo, self.awaited = self.awaited, None
        return _SILENT[demo.withdrawn] if demo is not None else ''
