"""
Participants who teach at the same time, each in a seat with a separate game.

A seat outlives its window for a while, so a reloaded page continues the lesson.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from functools import partial
from itertools import count
from typing import Any, Protocol

from humanopts_teach.dialogue.keys import ENTER, label
from humanopts_teach.dialogue.panel import Key, Line, Panel, ScreenView
from humanopts_teach.language import N_, speaking, translated
from humanopts_teach.lesson.store import similar_code

FAREWELL = N_('Everything taught is saved.')
_STARTING = N_('Starting the game of {code} ...')
_IN_LINE = N_(
    'All games are taken. You are number {place} in line. Keep this page open: your '
    'game will start by itself.'
)
_GAME_BYTES = 350_000_000  # assumed memory of a game, unless a larger game is measured
_SPARE_BYTES = 1_000_000_000  # memory reserved for other programs; at most a tenth of the total
_LOOK = 0.5  # s, period of the checks whether another game may start
Press = Callable[[list[str], int], None]  # keys, and the frame shown when pressed


def has_room(available: int, total: int, taken: Sequence[int], games: int) -> bool:
    """
    Return whether another game fits in memory; the first one always does.

    :param available: available memory in bytes, without swapping.
    :param total: total memory in bytes.
    :param taken: memory of each measured game in bytes; new games still grow.
    :param games: number of games, including those without a process yet.
    """
    each = max([_GAME_BYTES, *taken])
    upcoming = each * games - sum(taken)
    return not games or available - upcoming - min(_SPARE_BYTES, total // 10) >= each


class Window(Protocol):
    """A page open in a browser; ``language`` is that of its texts, as in ``speaking``."""

    language: str

    def show(self, view: ScreenView, frame: int) -> None:
        """Show a frame."""

    def listen(self, press: Press) -> None:
        """Pass key presses to ``press`` from now on."""

    def reload(self) -> None:
        """Reload the page."""

    def leave_to(self, url: str) -> None:
        """Open an address of another site."""

    async def client(self) -> Mapping[str, Any]:
        """Return the fields of the event ``client`` of a study; unknown ones are missing."""

    async def taken(self) -> None:
        """Wait until the page has received the last frame or seems to be disconnected."""


class GameError(Exception):
    """A participant's game cannot be started or has ended; the message gives the reason."""


# Opens a seat's game, which shows frames and may end the seat; yields the key handler.
OpenGame = Callable[['Seat'], AbstractAsyncContextManager[Press]]


class Seat:
    """
    The seat of one participant.

    :ivar number: number from 1, unique among current games; 0: waiting in line for a game.
    :ivar language: language of its texts, as in ``speaking``.
    :ivar window: window that shows the seat; None: no window is open.
    """

    def __init__(self, participant: str, domain: str, language: str) -> None:
        self.participant, self.number, self.language = participant, 0, language
        self.window: Window | None = None
        self.over = asyncio.Event()
        self.farewell = FAREWELL
        self.url: str | None = None  # address to open afterwards; empty: none; None: the page's
        self.head = ('humanopts', domain, participant)
        self._shown = self.message(_STARTING.format(code=participant)), 0
        self._press: Press = lambda keys, frame: None
        self._leaving: asyncio.TimerHandle | None = None

    def show(self, view: ScreenView, frame: int) -> None:
        """Show a frame, or store it until a window opens."""
        self._shown = view, frame
        if self.window is not None:
            self.window.show(view, frame)

    def message(self, text: str, enter: str = '') -> ScreenView:
        """Return a view with a message to the participant; see ``message``."""
        return message(self.head, text, enter, self.language)

    def listen(self, press: Press) -> None:
        """Pass key presses to ``press`` from now on."""
        self._press = press

    def enter(self, window: Window) -> None:
        """Show the seat in a window; a previous window reports that the lesson has moved."""
        if self._leaving is not None:
            self._leaving.cancel()
        if self.window is not None and self.window is not window:
            moved = self.message(N_('Continued in another window.'), N_('continue here'))
            prompt(self.window, moved, self.window.reload)
        self.window = window
        window.listen(lambda keys, frame: self._press(keys, frame))
        window.show(*self._shown)

    def leave(self, window: Window, seconds: float) -> None:
        """Release the seat after a delay, unless a window opens."""
        if self.window is window:
            self.window = None
            loop = asyncio.get_running_loop()
            self._leaving = loop.call_later(seconds, self.over.set)

    def end(self, farewell: str = FAREWELL, url: str | None = None) -> None:
        """
        Release the seat immediately.

        :param url: address that Enter then opens; empty: none; None: the page's.
        """
        self.farewell, self.url = farewell, url
        self.over.set()

    async def closed(self) -> None:
        """Show the farewell and wait until it is received; Enter then opens the next page."""
        if self._leaving is not None:
            self._leaving.cancel()
        if (window := self.window) is not None:
            url = self.url
            enter = N_('back to the site that invited you') if url else N_('go on')
            view = self.message(self.farewell, '' if url == '' else enter)
            prompt(window, view, partial(window.leave_to, url) if url else window.reload)
            await window.taken()


class ConditionSeat:
    """
    A seat for one condition of a study.

    :ivar farewell: reason for the end; empty: the participant ended it.
    """

    def __init__(self, seat: Seat) -> None:
        self.number, self.show, self.over = seat.number, seat.show, asyncio.Event()
        self.farewell = ''

    def end(self, farewell: str = FAREWELL) -> None:
        """End the condition."""
        self.farewell = '' if farewell == FAREWELL else farewell
        self.over.set()


class Seats:
    """
    The seats of all current participants.

    :ivar linger: time in s to keep a seat without a window.
    """

    def __init__(
        self,
        domain: str,
        open_game: OpenGame,
        linger: float,
        fits: Callable[[int], bool] = lambda games: True,
        known: Callable[[], Sequence[str]] = tuple,
        arrive: Callable[[Seat], Awaitable[None]] | None = None,
    ) -> None:
        """
        Start without participants.

        :param fits: function that returns whether another game fits, given the number of games;
            called in a thread.
        :param known: function that returns the codes of earlier participants.
        :param arrive: called before a participant waits for a game; it may end the seat.
        """
        self.domain, self.linger, self._known, self._arrive = domain, linger, known, arrive
        self._open_game, self._fits = open_game, fits
        self._line: list[Seat] = []  # waiting for a game
        self._playing: set[Seat] = set()
        self._door = asyncio.Lock()  # one seat checks and enters at a time
        self._seats: dict[str, Seat] = {}  # by participant
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._waiting: dict[str, list[Window]] = {}  # windows waiting for a seat shown elsewhere

    def enter(self, participant: str, window: Window) -> None:
        """Show a participant's seat in a window; ask first if another window shows it."""
        seat = self._seats.get(participant)
        if seat is None or seat.over.is_set():
            seat = self._begin(participant, window)
        elif seat.window not in (None, window):
            self._ask(seat, window)
            return
        seat.enter(window)

    def similar(self, participant: str) -> str:
        """Return a known code that differs only in case; empty: none."""
        return similar_code(participant, (*self._seats, *self._known()))

    def leave(self, participant: str, window: Window) -> None:
        """Handle a closed window; the next waiting window gets its seat."""
        waiting = self._waiting.get(participant, [])
        if window in waiting:
            waiting.remove(window)
        seat = self._seats.get(participant)
        if seat is not None and seat.window is window:
            seat.leave(window, self.linger)
            if waiting:
                seat.enter(waiting.pop(0))

    async def close(self, farewell: str) -> None:
        """End all games."""
        for seat in self._seats.values():
            seat.end(farewell)
        await asyncio.gather(*self._tasks.values())

    def _begin(self, participant: str, window: Window) -> Seat:
        before = self._tasks.get(participant)
        seat = self._seats[participant] = Seat(participant, self.domain, window.language)
        self._tasks[participant] = asyncio.create_task(self._play(seat, before))
        return seat

    async def _play(self, seat: Seat, before: 'asyncio.Task[None] | None') -> None:
        """Wait for a turn, then run the game until it ends."""
        if before is not None:
            await before  # the same participant's files are still in use
        try:
            if self._arrive is not None:
                await self._arrive(seat)
                seat.listen(lambda keys, frame: None)
            if await self._gets_turn(seat):
                async with self._open_game(seat) as press:
                    seat.listen(press)
                    await seat.over.wait()
                    seat.listen(lambda keys, frame: None)
                    seat.show(seat.message(N_('The game is ending ...')), 0)
        except GameError as error:
            seat.end(f'{error} {FAREWELL}')
        finally:
            self._playing.discard(seat)
            await seat.closed()
            if self._seats.get(seat.participant) is seat:
                del self._seats[seat.participant], self._tasks[seat.participant]

    async def _gets_turn(self, seat: Seat) -> bool:
        """
        Wait in line, showing the position, until a game may start.

        A participant without an open page keeps the position for ``linger`` but lets others pass.

        :return: whether the game may start; False: the seat has ended.
        """
        self._line.append(seat)
        shown = ''
        try:
            while not seat.over.is_set():
                ahead = [s for s in self._line[: self._line.index(seat)] if s.window is not None]
                async with self._door:
                    fits = not ahead and await asyncio.to_thread(self._fits, len(self._playing))
                    if fits and seat.window is not None and not seat.over.is_set():
                        taken = {other.number for other in self._playing}
                        seat.number = next(n for n in count(1) if n not in taken)
                        self._playing.add(seat)
                        if shown:
                            seat.show(seat.message(_STARTING.format(code=seat.participant)), 0)
                        return True
                text = _IN_LINE.format(place=len(ahead) + 1)
                if text != shown:
                    seat.show(seat.message(text), 0)
                    shown = text
                with suppress(TimeoutError):
                    await asyncio.wait_for(seat.over.wait(), _LOOK)
            return False
        finally:
            self._line.remove(seat)

    def _ask(self, seat: Seat, window: Window) -> None:
        """Ask whether to continue in this window; until then, the other window keeps the seat."""
        waiting = self._waiting.setdefault(seat.participant, [])
        if window not in waiting:
            waiting.append(window)

        def take() -> None:
            if window in waiting:
                waiting.remove(window)
                seat.enter(window)

        code = seat.participant
        text = N_(f'{code} is active in another window right now. Nothing is lost there.')
        prompt(window, seat.message(text, N_('continue here')), take)


def message(head: tuple[str, ...], text: str, enter: str = '', language: str = '') -> ScreenView:
    """
    Return a view with a message, which is translated.

    :param enter: description of the Enter key; empty: no key.
    :param language: as in ``speaking``.
    """
    with speaking(language):
        keys = [Key(ENTER, label(ENTER), translated(enter))] if enter else []
        line = Line(translated(text), strong=True)
    return ScreenView(head, Panel((line,)), keys=keys, language=language)


def prompt(window: Window, view: ScreenView, then: Callable[[], None]) -> None:
    """Show a view on which Enter calls ``then``."""
    window.listen(lambda keys, frame: then() if ENTER in keys else None)
    window.show(view, 0)
