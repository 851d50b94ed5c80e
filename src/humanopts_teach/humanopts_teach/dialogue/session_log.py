"""Who teaches, what is taught and what was answered: the part of a lesson that is written."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import Demonstration
from humanopts_teach.demos.entries import Entry, FeatureAnswered, OptionDefined, SessionOpened
from humanopts_teach.demos.store import CODE, CODE_RULE, DemonstrationStore, StoreError
from humanopts_teach.dialogue.answers import Answer, Status
from humanopts_teach.dialogue.history import History, OptionHistory

_NAME_LENGTH = 60
_RESERVED = 'action:'  # how option_server names primitive actions
ALL_NO = 'Every answer was no, but an option depends on something: they are asked again.'


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

        Of one that was taken back there is only the word that it is withdrawn.
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

    def open_session(self, participant: str, session: str) -> Answer:
        """
        Begin a sitting, or go on with it where it was left.

        :param session: empty: today's date and a number.
        """
        for what, code in (('participant', participant), ('session', session or 'new')):
            if not CODE.fullmatch(code):
                return Answer(Status.BAD_NAME, f'{what} {code!r} is not a code: {CODE_RULE}')
        history = History(self._domain.features, self._key, self._store.entries(participant))
        session = session or self._free_session(history)
        failed = self._write(SessionOpened(*self._key, participant, session))
        if failed is not None:
            return failed
        history.sessions.append(session)
        self._history, self.participant, self.session = history, participant, session
        self.option = history.options.get(history.last_option.get(session, ''))
        return Answer(
            Status.OK,
            f'session {session} of {participant} is open',
            session=session,
            known_options=tuple(history.options),
        )

    def define_option(self, name: str, ask_again: bool) -> Answer:
        """Name an option to teach, or take it up again."""
        if not self.participant:
            return Answer(Status.WRONG_PHASE, 'open a session first')
        name = name.strip()
        if fault := _name_fault(name):
            return Answer(Status.BAD_NAME, fault)
        resumed = name in self._history.options
        entry = OptionDefined(*self._key, self.participant, self.session, name, ask_again)
        if (failed := self.keep(entry)) is not None:
            return failed
        self.option = self._history.options[name]
        text = f'{"going on with" if resumed else "begun"}: {name}'
        return Answer(Status.OK, text, resumed=resumed)

    def answer_question(self, question_id: int, yes: bool) -> Answer:
        """Answer the open question."""
        option = self.option
        feature = option.questions.open if option is not None else None
        if option is None or feature is None:
            return Answer(Status.NOT_ASKED, 'no question is open')
        if question_id != self.question_id:
            return Answer(
                Status.NOT_ASKED,
                f'question {question_id} is not open; question {self.question_id} is, about '
                f'{feature.name}',
            )
        who = (self.participant, self.session)
        entry = FeatureAnswered(*self._key, *who, option.name, feature.name, yes)
        if (failed := self.keep(entry)) is not None:
            return failed
        if not option.questions.answers:
            return Answer(Status.NO_FEATURE, ALL_NO)
        return Answer(Status.OK, f'{feature.name}: {"yes" if yes else "no"}')

    def withdraw(self, uuid: str) -> Answer:
        """
        Take back the newest demonstration of the option.

        :param uuid: of the one that is meant; empty: whichever is the newest.
        """
        if self.option is None:
            return Answer(Status.WRONG_PHASE, 'name the option first')
        newest = self.option.newest
        if newest is None:
            detail = f'no demonstration of {self.option.name} is left to take back'
            return Answer(Status.NO_DEMONSTRATION, detail)
        if uuid not in ('', newest.uuid):
            detail = f'{uuid} is not the newest demonstration of {self.option.name}'
            return Answer(Status.NO_DEMONSTRATION, detail)
        withdrawn = replace(newest, withdrawn=True)
        if (failed := self.keep(withdrawn)) is not None:
            return failed
        steps = len(newest.actions)
        what = (
            f'the demonstration of {steps} step{"s"[: steps > 1]}' if steps else 'the "not here"'
        )
        text = f'{what} is taken back; its start comes again'
        return Answer(Status.OK, text, demonstration=withdrawn)

    def keep(self, entry: Entry) -> Answer | None:
        """Write an entry of the open session; what is answered tells why it could not be."""
        failed = self._write(entry)
        if failed is None:
            self._history.add(entry)
        return failed

    def _write(self, entry: Entry) -> Answer | None:
        try:
            self._store.append(entry)
        except StoreError as error:
            return Answer(Status.NOT_SAVED, str(error))
        return None

    def _free_session(self, history: History) -> str:
        today, number = self._today(), 1
        while f'{today}-{number}' in history.sessions:
            number += 1
        return f'{today}-{number}'


def _name_fault(name: str) -> str:
    """Say what is wrong with an option's name; empty: nothing."""
    if not name:
        return 'the name is empty'
    if len(name) > _NAME_LENGTH:
        return f'the name has {len(name)} characters; {_NAME_LENGTH} is the most'
    if not name.isprintable():
        return 'the name has characters that cannot be printed'
    if name.startswith(_RESERVED):
        return f'names that begin with {_RESERVED} are those of primitive actions'
    return ''
