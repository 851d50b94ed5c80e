"""The sessions and options of one participant, rebuilt from the entries of the lesson."""

from collections.abc import Iterable, Sequence
from contextlib import suppress

from humanopts_env.domains.base import ActableDomain, Feature
from humanopts_env.domains.formulas import derive, FormulaError
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import Demonstration, Kind, version_of
from humanopts_teach.lesson.store import Entry, LessonEvent


class OptionHistory:
    """
    The answers and demonstrations of one option.

    There is one question per feature. If all answers are no, the questions are asked again.
    A derived feature that is added later gets a question, too.

    :ivar answers: answers by feature.
    :ivar earlier: features chosen before the questions were asked again.
    :ivar method: requested learning method, or that of the first demonstration; empty: neither.
    :ivar demonstrations: demonstrations that were not withdrawn.
    :ivar judged: judged runs, except those with withdrawn verdicts.
    :ivar judged_number: number of the next judged run.
    :ivar withdrawn: uuids of withdrawn demonstrations.
    :ivar start_states: start states of withdrawn demonstrations, to be demonstrated again.
    :ivar number: number of the next demonstration; it also seeds the draw of its start state.
    """

    def __init__(
        self, participant: str, name: str, features: Sequence[Feature], number: int = 1
    ) -> None:
        self.participant, self.name, self.number = participant, name, number
        self.answers: dict[str, bool] = {}
        self.earlier: tuple[str, ...] = ()
        self.method = ''
        self.demonstrations: list[Demonstration] = []
        self.judged: list[Demonstration] = []
        self.judged_number = 1
        self.withdrawn: set[str] = set()
        self.start_states: list[str] = []
        self._features = features

    @property
    def open_feature(self) -> Feature | None:
        """The feature of the next question; None: all are answered."""
        return next((f for f in self._features if f.name not in self.answers), None)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Features answered with yes, in the order of the questions."""
        return tuple(f.name for f in self._features if self.answers.get(f.name))

    @property
    def n_trajectories(self) -> int:
        """Number of demonstrations with steps; the others are "not here" answers."""
        return sum(demo.kind is Kind.TRAJECTORY for demo in self.demonstrations)

    @property
    def newest(self) -> Demonstration | None:
        """The newest demonstration."""
        return self.demonstrations[-1] if self.demonstrations else None

    @property
    def everything(self) -> list[Demonstration]:
        """Demonstrations and judged runs."""
        return [*self.demonstrations, *self.judged]

    @property
    def verdicts(self) -> list[Demonstration]:
        """The judged runs of the current version of the option."""
        version = version_of(self.demonstrations)
        return [run for run in self.judged if run.option_version == version]

    @property
    def exam_runs(self) -> int:
        """The number of exam runs among ``verdicts``."""
        return sum(run.exam for run in self.verdicts)

    @property
    def n_questions(self) -> int:
        """The number of answered questions about runs."""
        return sum(not run.exam for run in self.judged)

    @property
    def wrong_run(self) -> Demonstration | None:
        """The last run in ``verdicts`` that the person called wrong; None: none."""
        return next((run for run in reversed(self.verdicts) if not run.right), None)

    @property
    def correction(self) -> str:
        """The start state of the demonstration that corrects ``wrong_run``; empty: none."""
        run = self.wrong_run
        if run is None:
            return ''
        return run.states[-1 if run.stopped and not run.terminated else 0]

    def add(self, entry: Entry) -> None:
        """Add an entry about the option."""
        if isinstance(entry, Demonstration) and entry.kind is Kind.JUDGED:
            self.judged_number = max(self.judged_number, entry.number + 1)
            self.judged = [run for run in self.judged if run.uuid != entry.uuid]
            if not entry.withdrawn:
                self.judged.append(entry)
        elif isinstance(entry, Demonstration):
            self.number = max(self.number, entry.number + 1)
            self.method = self.method or entry.method
            start = entry.states[0]
            if entry.withdrawn:
                self.withdrawn.add(entry.uuid)
                self.start_states.append(start)
                self.demonstrations = [d for d in self.demonstrations if d.uuid != entry.uuid]
            else:
                if start in self.start_states:
                    self.start_states.remove(start)
                self.demonstrations.append(entry)
        elif entry.entry == 'answer taken back':
            self.answers.pop(next(reversed(self.answers), ''), None)
        elif entry.entry == 'answer':
            self.answers[entry.feature] = entry.yes
            if self.open_feature is None and not self.chosen:
                self.answers = {}
        elif entry.entry == 'option':
            self.method = entry.method or self.method
            if entry.ask_again:
                self.earlier = self.chosen if self.open_feature is None else self.earlier
                self.answers = {}


class History:
    """
    The sessions and options of one participant in one domain.

    :ivar participant: participant code; empty: no session is open.
    :ivar key: domain name and parameters, as in the entries; entries of other domains are ignored.
    :ivar sessions: last option by session; empty: none yet.
    :ivar n_answers: number of answers given and withdrawn, about features and runs.
    :ivar features: features asked about: those of the domain, then the participant's derived ones.
    """

    def __init__(
        self, domain: ActableDomain, participant: str, entries: Iterable[Entry] = ()
    ) -> None:
        self.participant = participant
        self.key = (domain.name, parameters_json(domain))
        self.options: dict[str, OptionHistory] = {}
        self.sessions: dict[str, str] = {}
        self.n_answers = 0
        self._numbers: dict[str, int] = {}  # next demonstration number of deleted options
        self.features = [*domain.features]
        self._domain = domain
        for entry in entries:
            self.add(entry)

    def number(self, option_name: str) -> int:
        """Return the number of an option's next demonstration; numbers are never reused."""
        option = self.options.get(option_name)
        return option.number if option is not None else self._numbers.get(option_name, 1)

    @property
    def derived(self) -> tuple[str, ...]:
        """The names of the participant's derived features."""
        return tuple(each.name for each in self.features[len(self._domain.features) :])

    def add(self, entry: Entry) -> None:
        """Add an entry."""
        if (entry.domain, entry.domain_parameters) != self.key:
            return
        self.sessions.setdefault(entry.session, '')
        name, kind = entry.option_name, getattr(entry, 'entry', '')
        if kind == 'session':
            return
        if isinstance(entry, LessonEvent) and kind == 'feature':
            with suppress(FormulaError):  # from another version of the game; not asked about
                self.features.append(derive(self._domain, entry.feature).feature)
            return
        if kind == 'option deleted':
            self._numbers[name] = self.number(name)
            self.options.pop(name, None)
            return
        if kind == 'option':
            self.sessions[entry.session] = name
        answer = isinstance(entry, Demonstration) and entry.kind is Kind.JUDGED and not entry.exam
        self.n_answers += answer or kind in ('answer', 'answer taken back')
        self.options.setdefault(
            name, OptionHistory(self.participant, name, self.features, self.number(name))
        ).add(entry)
