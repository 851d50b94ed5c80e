"""What the learner has reported, and whether a lesson waits for it or is done."""

from collections.abc import Sequence

from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.summary import OptionSummary
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.seeded_starts import SeededStarts


class Learning:
    """
    The learner's side of a lesson.

    :ivar awaited: the demonstration that the learner has not counted in, or out; None: none.
    :ivar done: the criteria of the option are met, and the strategy has nothing left to ask.
    """

    def __init__(self, starts: SeededStarts) -> None:
        self.awaited: Demonstration | None = None
        self.done = False
        self._starts = starts
        self._summaries: dict[tuple[str, str], OptionSummary] = {}  # by participant and option

    def method(self, option: OptionHistory) -> str:
        """Return the method by which an option is learned from its next demonstration on."""
        return option.method or self._starts.rules.method

    def update(self, summaries: Sequence[OptionSummary]) -> None:
        """Keep what the learner knows of every option."""
        self._summaries = {(each.participant, each.option_name): each for each in summaries}

    def settled(self, option: OptionHistory | None) -> OptionSummary | None:
        """Return the report that all criteria that can be measured are met, as taught now."""
        summary = option and self._summaries.get((option.participant, option.name))
        if not option or not summary or not summary.settled or not _is_current(summary, option):
            return None
        same = summary.method == self.method(option)
        return summary if same and set(summary.features) == set(option.questions.chosen) else None

    def go_on(self, option: OptionHistory | None) -> None:
        """Wait no more where both learner and start states have counted what was awaited."""
        if option is not None and (demo := self.awaited) is not None:
            summary = self._summaries.get((demo.participant, demo.option_name))
            if demo.withdrawn:
                counted = summary is None or _is_current(summary, option)
            else:
                counted = summary is not None and summary.last_uuid == demo.uuid
            if not counted or not self._starts.counts(option, demo):
                return
        self.await_none(option)

    def await_none(self, option: OptionHistory | None) -> None:
        """Wait no more."""
        self.awaited = None
        self.check_done(option)

    def check_done(self, option: OptionHistory | None) -> None:
        """Find out whether the option is learned."""
        settled = self.settled(option) is not None
        self.done = settled and option is not None and self._starts.exhausted(option)


def _is_current(summary: OptionSummary, option: OptionHistory) -> bool:
    """Return whether nothing counts in a summary that was withdrawn."""
    counted = summary.n_demonstrations + summary.n_not_here
    return summary.last_uuid not in option.withdrawn and counted <= len(option.demonstrations)
