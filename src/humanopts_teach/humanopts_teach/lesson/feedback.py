"""The results of learner and planner that a lesson uses."""

from collections.abc import Iterable, Sequence
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.starts import sort_stuck
from humanopts_learner.planning.columns import suggest_column
from humanopts_learner.summary import OptionSummary
from humanopts_teach.lesson.history import History, OptionHistory
from humanopts_teach.lesson.seeded_starts import SeededStarts


class Feedback:
    """
    Results of learner and planner for the options of a participant.

    :ivar awaited: demonstration or judged run that the learner is processing; None: none.
    :ivar trial_games: number of trial games of the newest plan; 0: it was not tried.
    :ivar offers: states in which that plan got stuck, by the option to demonstrate there.
    :ivar suggested_column: suggested feature column for plans with the options; empty: none.
    """

    def __init__(self, domain: ActableDomain, starts: SeededStarts) -> None:
        """Start without a participant."""
        self._domain, self._starts = domain, starts
        self._history = History(domain, '')
        self._summaries: dict[tuple[str, str], OptionSummary] = {}  # by participant and option
        self._stuck: list[tuple[str, Any]] = []  # options and states in which the plan got stuck
        self._planned: set[str] = set()  # uuids of the demonstrations made before that plan
        self.awaited: Demonstration | None = None
        self.trial_games = 0
        self.offers: dict[str, list[Any]] = {}
        self.suggested_column = ''

    def begin(self, history: History) -> None:
        """Begin a session with the history of its participant."""
        self._history = history
        self.trial_games, self._stuck, self.offers = 0, [], {}
        self._suggest_column()

    def method(self, option: OptionHistory) -> str:
        """Return the learning method of an option for its next demonstration."""
        return option.method or self._starts.rules.method

    def summary(self, option: OptionHistory | None) -> OptionSummary | None:
        """Return the learner's summary of an option; None: not reported yet."""
        if option is None:
            return None
        return self._summaries.get((option.participant, option.name))

    def settled(self, option: OptionHistory | None) -> OptionSummary | None:
        """Return the summary of an option if its criteria are settled; otherwise None."""
        summary = self.summary(option)
        if not option or not summary or not summary.settled or not _is_current(summary, option):
            return None
        same = summary.method == self.method(option)
        return summary if same and set(summary.features) == set(option.chosen) else None

    def shown(self, option: OptionHistory | None) -> dict[str, Any]:
        """
        Return the fields of the lesson's view that depend on learner and planner.

        :param option: option of the lesson; None: none is named.
        """
        summary, settled = self.summary(option), self.settled(option)
        fields = ('n_questions', 'exam_right', 'exam_runs', 'exam_needed') if summary else ()
        return {
            'trial_games': self.trial_games,
            'stuck_options': tuple(self.offers),
            'stuck_games': tuple(map(len, self.offers.values())),
            'suggested_column': self.suggested_column,
            **{name: getattr(summary, name) for name in fields},
            'criteria_met': settled is not None and settled.criteria_met,
            'learned': settled is not None and settled.learned,
        }

    def has_processed(self, option: OptionHistory) -> bool:
        """Return whether summary and start states include the awaited demonstration, if any."""
        demo = self.awaited
        if demo is None:
            return True
        summary = self.summary(option)
        if summary is None:
            counted = demo.withdrawn
        elif demo.kind is Kind.JUDGED:
            counts = option.n_questions, option.exam_runs
            counted = (summary.n_questions, summary.exam_runs) == counts
        elif demo.withdrawn:
            counted = _is_current(summary, option)
        else:
            counted = summary.last_uuid == demo.uuid
        return counted and self._starts.counts(option, demo)

    def update_summaries(self, summaries: Sequence[OptionSummary]) -> None:
        """Store the learner's summaries of all options."""
        self._summaries = {(each.participant, each.option_name): each for each in summaries}

    def update_option(self, participant: str, option_name: str, text: str) -> bool:
        """
        Store an option published by the learner, and return whether it has changed.

        :raises OptionError: the text is not a valid option, or belongs to another domain.
        """
        changed = self._starts.learned(participant, option_name, text)
        if changed:
            self._suggest_column()
        return changed

    def update_trial(self, participant: str, games: int, stuck: Iterable[tuple[str, str]]) -> None:
        """
        Replace the offered start states by those in which a plan got stuck.

        :param participant: participant of the plan's options; empty: the only one.
        :param games: number of games played; 0: the plan was not tried.
        :param stuck: the option that ran (empty: none could start) and the state, in the domain's
            notation.
        :raises StateError: a state is invalid.
        """
        is_own = participant in ('', self._history.participant)
        if games and is_own and can_simulate(self._domain):
            self._stuck = [(name, self._domain.decode(text)) for name, text in stuck]
            self.trial_games, self.offers = games, {}
            self._planned = {demo.uuid for demos in self._taught.values() for demo in demos}
            self.sort_stuck()

    def sort_stuck(self) -> None:
        """Assign the states in which the plan got stuck to options, by all demonstrations."""
        if self._stuck and can_simulate(self._domain):
            parts = self._stuck, self._taught, self._planned
            self.offers = sort_stuck(self._domain, *parts)

    def _suggest_column(self) -> None:
        options = self._starts.options(self._history.participant, self._history.options)
        self.suggested_column = suggest_column(self._domain, options, self._taught)

    @property
    def _taught(self) -> dict[str, list[Demonstration]]:
        """The participant's demonstrations by option."""
        return {name: each.demonstrations for name, each in self._history.options.items()}


def _is_current(summary: OptionSummary, option: OptionHistory) -> bool:
    """Return whether a summary includes no withdrawn demonstration."""
    counted = summary.n_demonstrations + summary.n_not_here
    return summary.last_uuid not in option.withdrawn and counted <= len(option.demonstrations)
