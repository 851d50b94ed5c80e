"""The open session of a participant: its entries on disk, and the history built from them."""

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.formulas import derive, FormulaError
from humanopts_learner.demonstrations import Demonstration, each_once
from humanopts_ros.limits import composed
from humanopts_teach.lesson.history import History, OptionHistory
from humanopts_teach.lesson.requests import RefusalError, RequestStatus
from humanopts_teach.lesson.store import (
    CODE,
    CODE_RULE,
    DemonstrationStore,
    Entry,
    LessonEvent,
    similar_code,
    StoreError,
)

MAX_DERIVED = 100  # maximum number of derived features per participant


class Notebook:
    """
    Reads and writes the entries of a lesson; its methods raise RefusalError on failure.

    :ivar history: history of the participant; without participant: no session is open.
    :ivar session: code of the session; empty: none is open.
    """

    def __init__(self, domain: ActableDomain, store: DemonstrationStore) -> None:
        """Start without a session."""
        self._domain, self._store = domain, store
        self.history, self.session = History(domain, ''), ''

    def open(self, participant: str, session: str, today: Callable[[], str]) -> None:
        """
        Open a session, or resume it.

        :param session: code of the session; empty: a new one, named by date and number.
        :param today: returns the date as YYYYMMDD.
        """
        for what, code in (('participant', participant), ('session', session or 'new')):
            if not CODE.fullmatch(code):
                detail = f'{what} {code!r} is not a valid code: {CODE_RULE}'
                raise RefusalError(RequestStatus.BAD_NAME, detail)
        if similar := similar_code(participant, self._store.participants()):
            detail = (
                f'{participant!r} differs only in case from {similar!r}: use '
                f'{similar!r}, or another code'
            )
            raise RefusalError(RequestStatus.BAD_NAME, detail)
        history = History(self._domain, participant, self._entries(participant))
        codes = (f'{today()}-{number}' for number in count(1))
        session = session or next(code for code in codes if code not in history.sessions)
        self._append(opened := LessonEvent('session', *history.key, participant, session))
        history.add(opened)
        self.history, self.session = history, session

    def demonstrations(self, *participants: str) -> list[Demonstration]:
        """
        Return the demonstrations of participants in this domain, without duplicates.

        For a withdrawn demonstration, only the withdrawal is returned.

        :param participants: participant codes; none: all in the folder.
        """
        return each_once(
            entry
            for participant in participants or self._store.participants()
            for entry in self._entries(participant)
            if isinstance(entry, Demonstration)
            and (entry.domain, entry.domain_parameters) == self.history.key
        )

    def event(self, entry: Any, option_name: str, **more: Any) -> LessonEvent:
        """Return an entry about an option in the open session."""
        who = self.history.participant, self.session
        return LessonEvent(entry, *self.history.key, *who, option_name, **more)

    def write(self, *entries: Entry) -> None:
        """Add entries; they are on disk when this returns."""
        self._append(*entries)
        for entry in entries:
            self.history.add(entry)

    def option(self, name: str) -> OptionHistory:
        """Return an option of the participant."""
        option = self.history.options.get(composed(name))
        if option is None:
            participant, detail = self.history.participant, 'open a session first'
            if participant:
                detail = f'unknown option {name!r} of {participant}'
            raise RefusalError(RequestStatus.NO_OPTION, detail)
        return option

    def new_features(self, requested: Sequence[str]) -> list[str]:
        """Return the names of requested derived features that the participant does not have."""
        found: list[str] = []
        for text in requested:
            try:
                name = derive(self._domain, text).feature.name
            except FormulaError as error:
                raise RefusalError(RequestStatus.BAD_FEATURE, str(error)) from error
            if name not in (*self.history.derived, *found):
                found.append(name)
        if len(self.history.derived) + len(found) > MAX_DERIVED:
            detail = f'at most {MAX_DERIVED} derived features are allowed'
            raise RefusalError(RequestStatus.BAD_FEATURE, detail)
        return found

    def _entries(self, participant: str) -> tuple[Entry, ...]:
        try:
            return self._store.entries(participant)
        except StoreError as error:
            raise RefusalError(RequestStatus.NOT_SAVED, str(error)) from error

    def _append(self, *entries: Entry) -> None:
        try:
            self._store.append(*entries)
        except StoreError as error:
            raise RefusalError(RequestStatus.NOT_SAVED, str(error)) from error
