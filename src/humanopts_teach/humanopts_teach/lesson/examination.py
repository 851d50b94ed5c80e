"""The stages after the criteria of an option are met: questions about its runs, then the exam."""

from collections.abc import Collection

from humanopts_learner.options.checks import Check
from humanopts_learner.summary import OptionSummary
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.requests import Phase
from humanopts_teach.lesson.seeded_starts import SeededStarts


class Examination:
    """
    The stage of the lesson on one option.

    :ivar stage: READY (a demonstration is next), CHECKING, EXAM or FINISHED.
    :ivar check: the open question about a run; None: none is open.
    """

    def __init__(self, starts: SeededStarts) -> None:
        self._starts = starts
        self.stage = Phase.READY
        self.check: Check | None = None

    def update(
        self,
        option: OptionHistory | None,
        summary: OptionSummary | None,
        names: Collection[str],
    ) -> None:
        """
        Update the stage after any change.

        :param option: option of the lesson; None: none is named.
        :param summary: summary of the option if its criteria are settled; otherwise None.
        :param names: as in ``SeededStarts.draw``.
        """
        self.stage, self.check = Phase.READY, None
        if option is None or summary is None or option.wrong_run is not None:
            return
        if summary.exam_needed and summary.learned:
            self.stage = Phase.FINISHED
        elif self._starts.exhausted(option, names):
            self.check = self._starts.check(option, names, every_end=not summary.criteria_met)
            if self.check is not None:
                self.stage = Phase.CHECKING
            elif summary.criteria_met:  # settled criteria need not be met
                self.stage = Phase.FINISHED if summary.exam_passed else Phase.EXAM
