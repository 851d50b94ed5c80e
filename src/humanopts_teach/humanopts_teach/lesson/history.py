"""The sessions and options of one participant, rebuilt from the entries of the lesson."""

from collections.abc import Iterable, Sequence

from humanopts_env.domains.base import ActableDomain, Feature
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.store import Entry


class OptionHistory:
    """
    One option: the answers and the demonstrations.

    There is one question for each feature; when all are answered no, they are asked again.

    :ivar answers: by feature.
    :ivar earlier: features that were chosen before the questions were asked again.
    :ivar method: learning method: requested, or that of the first demonstration; empty: neither.
    :ivar demonstrations: those that count.
    :ivar withdrawn: uuids of the demonstrations that were withdrawn.
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
        self.withdrawn: set[str] = set()
        self.start_states: list[str] = []
        self._features = features

    @property
    def open_feature(self) -> Feature | None:
        """The feature that is asked about next; None: all are answered."""
        return next((f for f in self._features if f.name not in self.answers), None)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Features answered yes, in the domain's order."""
        return tuple(f.name for f in self._features if self.answers.get(f.name))

    @property
    def n_trajectories(self) -> int:
        """Demonstrations with steps; the others are "not here" answers."""
        return sum(demo.kind is Kind.TRAJECTORY for demo in self.demonstrations)

    @property
    def newest(self) -> Demonstration | None:
        """The newest demonstration."""
        return self.demonstrations[-1] if self.demonstrations else None

    def add(self, entry: Entry) -> None:
        """Add one more entry about the option."""
        if isinstance(entry, Demonstration):
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

    :ivar participant: code; empty: no session was opened.
    :ivar key: name and parameters of the domain, as in the entries; entries of others are ignored.
    :ivar sessions: the last option of each session; empty: none was named.
    :ivar n_answers: number of answers given and taken back.
    """

    def __init__(
        self, domain: ActableDomain, participant: str, entries: Iterable[Entry] = ()
    ) -> None:
        self.participant = participant
        self.key = (domain.name, parameters_json(domain))
        self.options: dict[str, OptionHistory] = {}
        self.sessions: dict[str, str] = {}
        self.n_answers = 0
        self._numbers: dict[str, int] = {}  # of what follows in options that were deleted
        self._features = domain.features
        for entry in entries:
            self.add(entry)

    def number(self, option_name: str) -> int:
        """Return the number of the next demonstration of an option; none is used twice."""
        option = self.options.get(option_name)
        return option.number if option is not None else self._numbers.get(option_name, 1)

    def add(self, entry: Entry) -> None:
        """Add one more entry."""
        if (entry.domain, entry.domain_parameters) != self.key:
            return
        self.sessions.setdefault(entry.session, '')
        name, kind = entry.option_name, getattr(entry, 'entry', '')
        if kind == 'session':
            return
        if kind == 'option deleted':
            self._numbers[name] = self.number(name)
            self.options.pop(name, None)
            return
        if kind == 'option':
            self.sessions[entry.session] = name
        self.n_answers += kind in ('answer', 'answer taken back')
        self.options.setdefault(
            name, OptionHistory(self.participant, name, self._features, self.number(name))
        ).add(entry)
