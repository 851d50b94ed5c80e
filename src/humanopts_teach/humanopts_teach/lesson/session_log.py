"""
Who teaches, what is taught and what was answered: the part of a lesson that is written.

The store has entries. ``History`` is what they come to for one participant. ``SessionLog`` adds to
both.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from humanopts_env.domains.base import Domain, Feature
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    DefineOption,
    OpenSession,
    RequestStatus,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.store import (
    CODE,
    CODE_RULE,
    DemonstrationStore,
    Entry,
    FeatureAnswered,
    OptionDefined,
    SessionOpened,
    StoreError,
)

_NAME_LENGTH = 60
_RESERVED = 'action:'  # how option_server names primitive actions
ALL_NO = 'Every answer was no, but an option depends on something: they are asked again.'


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

    def again(self) -> 'Questions':
        """Return the questions without answers; ``earlier`` keeps what was chosen before."""
        earlier = self.chosen if self.open is None else self.earlier
        return Questions(self.option_name, self.features, earlier=earlier)


class OptionHistory:
    """One option: the answers and the demonstrations."""

    def __init__(self, name: str, features: Sequence[Feature]) -> None:
        self.name = name
        self.questions = Questions(name, features)
        self.demonstrations: list[Demonstration] = []  # those that count
        self.withdrawn: set[str] = set()  # uuids
        self._again: list[str] = []  # start states of what was withdrawn
        self.number = 1  # of the next demonstration; it also keys the draw of its start state

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
        """Start state of the last one withdrawn, which comes next; empty: any may come."""
        return self._again[-1] if self._again else ''

    @property
    def n_not_here(self) -> int:
        """Answers that the option makes no sense in a state."""
        return len(self.demonstrations) - self.n_trajectories

    def add(self, demo: Demonstration) -> None:
        """Add one more demonstration, or count out one that is withdrawn."""
        self.number = max(self.number, demo.number + 1)
        if demo.withdrawn:
            self.withdrawn.add(demo.uuid)
            self._again.append(demo.states[0])
            self.demonstrations = [d for d in self.demonstrations if d.uuid != demo.uuid]
        else:
            del self._again[-1:]
            self.demonstrations.append(demo)


class History:
    """The sessions and options of one participant in one domain."""

    def __init__(
        self, features: Sequence[Feature], domain: tuple[str, str], entries: Iterable[Entry] = ()
    ) -> None:
        """
        Begin with the entries of the domain.

        :param domain: name and parameters, as in the entries; other entries are passed over.
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
        """Add one more entry."""
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


class SessionLog:
    """The open session and option; a request that cannot be written changes nothing."""

    def __init__(
        self, domain: Domain[Any], store: DemonstrationStore, today: Callable[[], str]
    ) -> None:
        """
        Begin without a session.

        :param today: the date as YYYYMMDD, for session codes.
        """
        self.participant = ''
        self.session = ''
        self.option: OptionHistory | None = None
        self._domain = domain
        self._key = (domain.name, parameters_json(domain))
        self._store = store
        self._today = today
        self._history = History(domain.features, self._key)

    @property
    def question_id(self) -> int:
        """Of the open question: counted on over all options, so that none is used twice; or 0."""
        if self.option is None or self.option.questions.open is None:
            return 0
        return self._history.n_answers + 1

    def demonstrations(self) -> list[Demonstration]:
        """
        Return all that anybody has shown in this domain, in the order of the store.

        Of one that was taken back, only the withdrawal is returned.
        """
        shown = [
            entry
            for participant in self._store.participants()
            for entry in self._store.entries(participant)
            if isinstance(entry, Demonstration)
            and (entry.domain, entry.domain_parameters) == self._key
        ]
        withdrawn = {demo.uuid for demo in shown if demo.withdrawn}
        return [demo for demo in shown if demo.withdrawn or demo.uuid not in withdrawn]

    def open_session(self, request: OpenSession) -> Answer:
        """Begin a session, or go on with it where it was left."""
        participant, session = request.participant, request.session
        for what, code in (('participant', participant), ('session', session or 'new')):
            if not CODE.fullmatch(code):
                return Answer(
                    RequestStatus.BAD_NAME, f'{what} {code!r} is not a code: {CODE_RULE}'
                )
        history = History(self._domain.features, self._key, self._store.entries(participant))
        session = session or self._free_session(history)
        failed = self._write(SessionOpened(*self._key, participant, session))
        if failed is not None:
            return failed
        history.sessions.append(session)
        self._history, self.participant, self.session = history, participant, session
        self.option = history.options.get(history.last_option.get(session, ''))
        return Answer(
            RequestStatus.OK,
            f'session {session} of {participant} is open',
            session=session,
            known_options=tuple(history.options),
        )

    def define_option(self, request: DefineOption) -> Answer:
        """Name an option to teach, or take it up again."""
        if not self.participant:
            return Answer(RequestStatus.WRONG_PHASE, 'open a session first')
        name = request.name.strip()
        if fault := _name_fault(name):
            return Answer(RequestStatus.BAD_NAME, fault)
        resumed = name in self._history.options
        who = (self.participant, self.session)
        entry = OptionDefined(*self._key, *who, name, request.ask_again)
        if (failed := self.keep(entry)) is not None:
            return failed
        self.option = self._history.options[name]
        text = f'{"going on with" if resumed else "begun"}: {name}'
        return Answer(RequestStatus.OK, text, resumed=resumed)

    def answer_question(self, request: AnswerQuestion) -> Answer:
        """Answer the open question."""
        option, yes = self.option, request.yes
        feature = option.questions.open if option is not None else None
        if option is None or feature is None:
            return Answer(RequestStatus.NOT_ASKED, 'no question is open')
        if request.question_id != self.question_id:
            return Answer(
                RequestStatus.NOT_ASKED,
                f'question {request.question_id} is not open; question {self.question_id} is, '
                f'about {feature.name}',
            )
        who = (self.participant, self.session)
        entry = FeatureAnswered(*self._key, *who, option.name, feature.name, yes)
        if (failed := self.keep(entry)) is not None:
            return failed
        if not option.questions.answers:
            return Answer(RequestStatus.NO_FEATURE, ALL_NO)
        return Answer(RequestStatus.OK, f'{feature.name}: {"yes" if yes else "no"}')

    def withdraw(self, request: WithdrawDemonstration) -> Answer:
        """Take back the newest demonstration of the option."""
        if self.option is None:
            return Answer(RequestStatus.WRONG_PHASE, 'name the option first')
        newest = self.option.newest
        if newest is None:
            detail = f'no demonstration of {self.option.name} is left to take back'
            return Answer(RequestStatus.NO_DEMONSTRATION, detail)
        if request.uuid not in ('', newest.uuid):
            detail = f'{request.uuid} is not the newest demonstration of {self.option.name}'
            return Answer(RequestStatus.NO_DEMONSTRATION, detail)
        withdrawn = replace(newest, withdrawn=True)
        if (failed := self.keep(withdrawn)) is not None:
            return failed
        steps = len(newest.actions)
        what = (
            f'the demonstration of {steps} step{"s"[: steps > 1]}' if steps else 'the "not here"'
        )
        text = f'{what} is taken back; its start comes again'
        return Answer(RequestStatus.OK, text, uuid=withdrawn.uuid, demonstration=withdrawn)

    def keep(self, entry: Entry) -> Answer | None:
        """Write an entry of the open session; return why it could not be written, or None."""
        failed = self._write(entry)
        if failed is None:
            self._history.add(entry)
        return failed

    def _write(self, entry: Entry) -> Answer | None:
        try:
            self._store.append(entry)
        except StoreError as error:
            return Answer(RequestStatus.NOT_SAVED, str(error))
        return None

    def _free_session(self, history: History) -> str:
        today, number = self._today(), 1
        while f'{today}-{number}' in history.sessions:
            number += 1
        return f'{today}-{number}'


def _name_fault(name: str) -> str:
    """Return what is wrong with an option's name; empty: nothing."""
    if not name:
        return 'the name is empty'
    if len(name) > _NAME_LENGTH:
        return f'the name has {len(name)} characters; {_NAME_LENGTH} is the most'
    if not name.isprintable():
        return 'the name has characters that cannot be printed'
    if name.startswith(_RESERVED):
        return f'names that begin with {_RESERVED} are those of primitive actions'
    return ''
