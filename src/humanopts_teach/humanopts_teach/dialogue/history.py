"""What one participant has taught in one domain: the fold of the entries in the store."""

from collections.abc import Iterable, Sequence

from humanopts_env.domains.base import Feature
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.demos.entries import Entry, FeatureAnswered, OptionDefined, SessionOpened
from humanopts_teach.dialogue.questions import Questions


class OptionHistory:
    """One option: the answers and the demonstrations."""

    def __init__(self, name: str, features: Sequence[Feature]) -> None:
        self.name = name
        self.questions = Questions(name, features)
        self.demonstrations: list[Demonstration] = []  # those that count
        self.withdrawn: set[str] = set()  # uuids
        self._again: list[str] = []  # start states of what was withdrawn
        self.number = 1  # of the next one, counted on; it also names the draw of its start state

    @property
    def n_trajectories(self) -> int:
        """Demonstrations with steps."""
        return sum(demo.kind is Kind.TRAJECTORY for demo in self.demonstrations)

    @property
    def newest(self) -> Demonstration | None:
        """The demonstration that can be taken back."""
        return self.demonstrations[-1] if self.demonstrations else None

    @property
    def next_start(self) -> str:
        """Where the next demonstration begins, as one that was withdrawn did; empty: anywhere."""
        return self._again[-1] if self._again else ''

    @property
    def n_not_here(self) -> int:
        """Answers that the option makes no sense in a state."""
        return len(self.demonstrations) - self.n_trajectories

    def add(self, demo: Demonstration) -> None:
        """Take in one more demonstration, or that one is withdrawn."""
        self.number = max(self.number, demo.number + 1)
        if demo.withdrawn:
            self.withdrawn.add(demo.uuid)
            self._again.append(demo.states[0])
            self.demonstrations = [d for d in self.demonstrations if d.uuid != demo.uuid]
        else:
            del self._again[-1:]
            self.demonstrations.append(demo)


class History:
    """The sittings and options of one participant in one domain."""

    def __init__(
        self, features: Sequence[Feature], domain: tuple[str, str], entries: Iterable[Entry] = ()
    ) -> None:
        """
        Take in the entries of the domain.

        :param domain: name and parameters, as in the entries; others are passed over.
        """
        self.options: dict[str, OptionHistory] = {}
        self.sessions: list[str] = []
        self.last_option: dict[str, str] = {}  # by session
        self.n_answers = 0
        self._features = features
        self._domain = domain
        for entry in entries:
            self.add(entry)

    def add(self, entry: Entry) -> None:
        """Take in one more entry."""
        if (entry.domain, entry.domain_parameters) != self._domain:
            return
        if entry.session not in self.sessions:
            self.sessions.append(entry.session)
        if isinstance(entry, SessionOpened):
            return
        option = self.options.setdefault(
            entry.option_name, OptionHistory(entry.option_name, self._features)
        )
        if isinstance(entry, Demonstration):
            option.add(entry)
        elif isinstance(entry, OptionDefined):
            self.last_option[entry.session] = entry.option_name
            if entry.ask_again:
                option.questions = option.questions.again()
        elif isinstance(entry, FeatureAnswered):
            self.n_answers += 1
            option.questions = option.questions.answered(entry.feature, entry.yes)
