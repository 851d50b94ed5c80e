"""
The participants who teach at the same time: each has a seat, which has a game of its own.

A seat outlives its window for a while: a page that is loaded again goes on where it was.
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from itertools import count
from typing import Protocol

from humanopts_teach.dialogue.panel import Line, Panel, Tone, View
from humanopts_teach.lesson.store import similar_code

FAREWELL = 'Everything taught is saved.'
_STARTING = 'Starting the game of {} ...'
_IN_LINE = (
    'All games are taken. You are number {} in line. Keep this page open: your game starts '
    'by itself.'
)
_GAME_BYTES = 350_000_000  # of a game's processes, until one is measured that has more
_SPARE_BYTES = 1_000_000_000  # that are left to other programs; a tenth where memory is small
_LOOK = 0.5  # s between looks whether another game may begin
Press = Callable[[list[str], int], None]  # keys, and the number of the frame they were pressed on


def another_fits(available: int, total: int, taken: Sequence[int], games: int) -> bool:
    """
    Return whether the memory of a machine holds another game; the first one is always let in.

    :param available: bytes that programs may still take, without swapping.
    :param total: bytes of the machine.
    :param taken: bytes of each game that is measured; it may have begun just now, and grows.
    :param games: number of all games, some of which may have no process yet.
    """
    each = max([_GAME_BYTES, *taken])
    to_come = each * games - sum(taken)
    return not games or available - to_come - min(_SPARE_BYTES, total // 10) >= each


class Window(Protocol):
    """A page that is open in a browser."""

    def show(self, view: View, frame: int) -> None:
        """Show a frame."""

    def listen(self, press: Press) -> None:
        """Hand on from now on what is pressed."""

    def reload(self) -> None:
        """Load the page again."""

    async def taken(self) -> None:
        """Wait until the page has what was shown last, or seems to be gone."""


class GameError(Exception):
    """A participant's game cannot be started, or has ended; the text says why."""


# Opens the game of a seat; it shows frames, and may end the seat. Its value takes keys.
OpenGame = Callable[['Seat'], AbstractAsyncContextManager[Press]]


class Seat:
    """
    The place of one participant.

    :ivar number: from 1; no other game has it meanwhile. 0: it is in line for a game.
    :ivar window: on which it is shown; None: none is open.
    """

    def __init__(self, participant: str, domain: str) -> None:
        self.participant, self.number = participant, 0
        self.window: Window | None = None
        self.over = asyncio.Event()
        self.farewell = FAREWELL
        self.head = ('humanopts', domain, participant)
        self._shown = message(self.head, _STARTING.format(participant)), 0
        self._press: Press = lambda keys, frame: None
        self._leaving: asyncio.TimerHandle | None = None

    def show(self, view: View, frame: int) -> None:
        """Show a frame, now or when a window comes."""
        self._shown = view, frame
        if self.window is not None:
            self.window.show(view, frame)

    def listen(self, press: Press) -> None:
        """Hand on from now on what is pressed."""
        self._press = press

    def enter(self, window: Window) -> None:
        """Show the seat in a window; another one that shows it is told so."""
        if self._leaving is not None:
            self._leaving.cancel()
        if self.window is not None and self.window is not window:
            text = 'The lesson goes on in another window.'
            prompt(self.window, message(self.head, text, 'teach here again'), self.window.reload)
        self.window = window
        window.listen(lambda keys, frame: self._press(keys, frame))
        window.show(*self._shown)

    def leave(self, window: Window, seconds: float) -> None:
        """Give the seat up after a time, unless a window comes."""
        if self.window is window:
            self.window = None
            loop = asyncio.get_running_loop()
            self._leaving = loop.call_later(seconds, self.over.set)

    def end(self, farewell: str = FAREWELL) -> None:
        """Give the seat up now."""
        self.farewell = farewell
        self.over.set()

    async def closed(self) -> None:
        """Say farewell, and wait until the page has it; from now on a key loads the page again."""
        if self._leaving is not None:
            self._leaving.cancel()
        if (window := self.window) is not None:
            prompt(window, message(self.head, self.farewell, 'go on'), window.reload)
            await window.taken()


class ConditionSeat:
    """
    A seat for one condition of a study, after which the next one follows.

    :ivar farewell: why it ended; empty: the participant ended it.
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
    Those who teach now.

    :ivar linger: how long a seat is kept without a window, s.
    """

    def __init__(
        self,
        domain: str,
        open_game: OpenGame,
        linger: float,
        fits: Callable[[int], bool] = lambda games: True,
        known: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        """
        Have no participant yet.

        :param fits: whether there may be another game beside that many; called in a thread.
        :param known: returns the codes of those who have taught before.
        """
        self.domain, self.linger, self._known = domain, linger, known
        self._open_game, self._fits = open_game, fits
        self._line: list[Seat] = []  # whose game has yet to begin
        self._playing: set[Seat] = set()
        self._door = asyncio.Lock()  # through which one goes at a time
        self._seats: dict[str, Seat] = {}  # by participant
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._waiting: dict[str, list[Window]] = {}  # at a seat that another window shows

    def enter(self, participant: str, window: Window) -> None:
        """Show a participant's seat in a window, or ask where another window shows it."""
        seat = self._seats.get(participant)
        if seat is None or seat.over.is_set():
            seat = self._begin(participant, window)
        elif seat.window not in (None, window):
            self._ask(seat, window)
            return
        seat.enter(window)

    def similar(self, participant: str) -> str:
        """Return a code in use that differs only in case; empty: there is none."""
        return similar_code(participant, (*self._seats, *self._known()))

    def leave(self, participant: str, window: Window) -> None:
        """Note that a window is gone; one that waits for its seat gets it."""
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
        seat = self._seats[participant] = Seat(participant, self.domain)
        self._tasks[participant] = asyncio.create_task(self._play(seat, before))
        return seat

    async def _play(self, seat: Seat, before: 'asyncio.Task[None] | None') -> None:
        """Keep a game from its begin, once it may begin, to its end."""
        if before is not None:
            await before  # of the same participant, whose files are still in use
        try:
            if await self._gets_turn(seat):
                async with self._open_game(seat) as press:
                    seat.listen(press)
                    await seat.over.wait()
                    seat.listen(lambda keys, frame: None)
                    seat.show(message(seat.head, 'The game ends ...'), 0)
        except GameError as error:
            seat.end(f'{error} {FAREWELL}')
        finally:
            self._playing.discard(seat)
            await seat.closed()
            if self._seats.get(seat.participant) is seat:
                del self._seats[seat.participant], self._tasks[seat.participant]

    async def _gets_turn(self, seat: Seat) -> bool:
        """
        Wait in line, and show the position, until there may be a game.

        Who has no page keeps the place for as long as a seat, and lets others pass.

        :return: whether the game may begin; else the seat is over.
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
                            seat.show(message(seat.head, _STARTING.format(seat.participant)), 0)
                        return True
                text = _IN_LINE.format(len(ahead) + 1)
                if text != shown:
                    seat.show(message(seat.head, text), 0)
                    shown = text
                with suppress(TimeoutError):
                    await asyncio.wait_for(seat.over.wait(), _LOOK)
            return False
        finally:
            self._line.remove(seat)

    def _ask(self, seat: Seat, window: Window) -> None:
        """Ask whether to go on here; the other window keeps the seat until then."""
        waiting = self._waiting.setdefault(seat.participant, [])
        if window not in waiting:
            waiting.append(window)

        def take() -> None:
            if window in waiting:
                waiting.remove(window)
                seat.enter(window)

        text = f'{seat.participant} teaches in another window just now. Nothing is lost there.'
        prompt(window, message(('humanopts', self.domain), text, 'teach here instead'), take)


def message(head: tuple[str, ...], text: str, enter: str = '') -> View:
    """
    Return a view that says something.

    :param enter: what Enter does; empty: nothing.
    """
    keys = [('Enter', enter)] if enter else []
    return View(head, '', None, Panel((Line(text, strong=True),)), Line('', Tone.PLAIN), keys)


def prompt(window: Window, view: View, then: Callable[[], None]) -> None:
    """Show a view on which Enter does something."""
    window.listen(lambda keys, frame: then() if 'enter' in keys else None)
    window.show(view, 0)
