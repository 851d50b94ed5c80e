"""What the entries of a lesson come to: the sessions and options of one participant."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from humanopts_env.domains.base import ActableDomain, Feature
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.store import (
    AnswerTakenBack,
    Entry,
    FeatureAnswered,
    OptionDefined,
    OptionDeleted,
    SessionOpened,
)


@dataclass(frozen=True)
class Questions:
    """One question for each feature; when all are answered no, they are asked again."""

    option_name: str
    features: Sequence[Feature]
    answers: Mapping[str, bool] = field(default_factory=dict)
    earlier: tuple[str, ...] = ()  # chosen before they were asked again

    @property
    def open(self) -> Feature | None:
        """The feature that is asked about next; None: all are answered."""
        return next((f for f in self.features if f.name not in self.answers), None)

    @property
    def text(self) -> str:
        """The open question as the paper words it (section 5); empty: none is open."""
        feature = self.open
        if feature is None:
            return ''
        return f"Does the '{self.option_name}' option depend on {feature.question}?"

    @property
    def chosen(self) -> tuple[str, ...]:
        """Features answered yes, in the domain's order."""
        return tuple(f.name for f in self.features if self.answers.get(f.name, False))

    def answered(self, feature: str, yes: bool) -> 'Questions':
        """Return the questions after one more answer; when all are "no", all are open again."""
        answers = {**self.answers, feature: yes}
        if all(answers.get(f.name) is False for f in self.features):
            answers = {}
        return replace(self, answers=answers)

    def back(self) -> 'Questions':
        """Return the questions without the last answer."""
        return replace(self, answers=dict(list(self.answers.items())[:-1]))

    def again(self) -> 'Questions':
        """Return the questions without answers; ``earlier`` keeps what was chosen before."""
        earlier = self.chosen if self.open is None else self.earlier
        return Questions(self.option_name, self.features, earlier=earlier)


class OptionHistory:
    """One option: the answers and the demonstrations."""

    def __init__(
        self, participant: str, name: str, features: Sequence[Feature], number: int = 1
    ) -> None:
        self.participant = participant
        self.name = name
        self.questions = Questions(name, features)
        self.method = ''  # of learning: asked for, or first shown for; empty: neither was
        self.demonstrations: list[Demonstration] = []  # those that count
        self.withdrawn: set[str] = set()  # uuids
        self.start_states: list[str] = []  # of what was withdrawn and not shown anew; last first
        self.number = number  # of the next demonstration; it also keys the draw of its start state

    @property
    def n_trajectories(self) -> int:
        """Demonstrations with steps; the others are "not here" answers."""
        return sum(demo.kind is Kind.TRAJECTORY for demo in self.demonstrations)

    @property
    def newest(self) -> Demonstration | None:
        """The demonstration that can be taken back."""
        return self.demonstrations[-1] if self.demonstrations else None

    def add(self, demo: Demonstration) -> None:
        """Add one more demonstration, or count out one that is withdrawn."""
        self.number = max(self.number, demo.number + 1)
        self.method = self.method or demo.method
        if demo.withdrawn:
            self.withdrawn.add(demo.uuid)
            self.start_states.append(demo.states[0])
            self.demonstrations = [d for d in self.demonstrations if d.uuid != demo.uuid]
        else:
            if demo.states[0] in self.start_states:
                self.start_states.remove(demo.states[0])
            self.demonstrations.append(demo)


class History:
    """
    The sessions and options of one participant in one domain.

    :ivar key: name and parameters of the domain, as in the entries; others are passed over.
    """

    def __init__(
        self, domain: ActableDomain, participant: str, entries: Iterable[Entry] = ()
    ) -> None:
        self.participant = participant  # empty: nobody has opened a session
        self.key = (domain.name, parameters_json(domain))
        self.options: dict[str, OptionHistory] = {}
        self.sessions: dict[str, str] = {}  # the last option of each; empty: none was named
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
        if isinstance(entry, SessionOpened):
            return
        name = entry.option_name
        number = self.number(name)
        option = self.options.setdefault(
            name, OptionHistory(self.participant, name, self._features, number)
        )
        if isinstance(entry, Demonstration):
            option.add(entry)
        elif isinstance(entry, OptionDeleted):
            self._numbers[name] = number
            del self.options[name]
        elif isinstance(entry, AnswerTakenBack):
            self.n_answers += 1
            option.questions = option.questions.back()
        elif isinstance(entry, OptionDefined):
            self.sessions[entry.session] = name
            option.method = entry.method or option.method
            if entry.ask_again:
                option.questions = option.questions.again()
        elif isinstance(entry, FeatureAnswered):
            self.n_answers += 1
            option.questions = option.questions.answered(entry.feature, entry.yes)
