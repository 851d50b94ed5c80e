"""Seats of participants: a game each, which outlives its page for a while and no longer."""

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from humanopts_teach.browser.seats import (
    GameError,
    has_room,
    message,
    Press,
    Seat,
    Seats,
)
from humanopts_teach.dialogue.panel import Line, ScreenView
import pytest

LINGER = 0.05  # s
PATIENCE = 5.0  # s


class Page:
    """A window that keeps what it shows."""

    language = ''

    def __init__(self) -> None:
        self.shown: tuple[str, int] = ('', 0)
        self.press: Press = lambda keys, frame: None
        self.reloaded, self.left_to = 0, ''
        self.prompt = asyncio.Event()  # whether it takes at once what is shown
        self.prompt.set()

    def show(self, view: ScreenView, frame: int) -> None:
        """Keep the first line."""
        (line, *_) = view.panel.beside
        assert isinstance(line, Line)
        self.shown = line.text, frame

    def listen(self, press: Press) -> None:
        """Keep what takes key presses."""
        self.press = press

    def reload(self) -> None:
        """Count."""
        self.reloaded += 1

    def leave_to(self, url: str) -> None:
        """Note the address."""
        self.left_to = url

    async def client(self) -> dict[str, Any]:
        """Know nothing."""
        return {}

    async def taken(self) -> None:
        """Wait until it is prompt."""
        await self.prompt.wait()


class Games:
    """Games that show what was pressed, and how many there are."""

    def __init__(self) -> None:
        self.open: list[tuple[str, int]] = []
        self.opened = 0
        self.fault = ''

    def __str__(self) -> str:
        return ', '.join(f'{who} {number}' for who, number in self.open)

    @asynccontextmanager
    async def __call__(self, seat: Seat) -> AsyncIterator[Press]:
        """Keep one."""
        if self.fault:
            raise GameError(self.fault)
        place = seat.participant, seat.number
        assert place[0] not in [participant for participant, _ in self.open]
        assert place[1] not in [number for _, number in self.open]
        self.open.append(place)
        self.opened += 1
        seat.show(message((), 'begun'), 1)

        def press(keys: list[str], frame: int) -> None:
            if keys == ['q']:
                seat.end()
            seat.show(message((), f'{keys[0]} on {frame}'), frame + 1)

        try:
            yield press
        finally:
            await asyncio.sleep(0)
            self.open.remove(place)


async def until(condition: Callable[[], bool]) -> None:
    """Wait for something."""
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.001)


async def tell(script: str, linger: float, most: int) -> None:
    """Carry out one line after the other: who (a page), what it does, and a text."""
    games, pages, people = Games(), defaultdict[str, Page](Page), dict[str, str]()
    seats = Seats('taxi', games, linger, lambda count: count < most)
    for line in script.strip().splitlines():
        who, does, text = f'{line.strip()} '.split(' ', 2)
        page, text = pages[who], text.strip()
        match does:
            case 'enters':
                people[who] = text
                seats.enter(text, page)
            case 'leaves':
                seats.leave(people[who], page)
            case 'presses':
                page.press([text], page.shown[1])
            case 'shows':
                await until(lambda page=page, text=text: text in page.shown[0])
            case 'reloaded':
                assert page.reloaded == 1
            case 'fail':
                games.fault = text
            case 'are':
                await until(lambda text=text: str(games) == text)
            case 'begun':
                assert games.opened == int(text)
    await seats.close('stopped')
    assert games.open == []


STORIES = {
    'a page that stays closed ends its game and frees its place': """
        A enters anna
        A shows begun
        A leaves
        games are
        B enters ben
        C enters anna
        games are ben 1, anna 2""",
    'a second page asks before it takes the seat': """
        A enters anna
        A shows begun
        B enters anna
        B shows anna is active in another window right now.
        B presses x
        A presses a
        A shows a on 1
        B presses enter
        A shows Continued in another window.
        B shows a on 1
        A presses b
        B shows a on 1
        A presses enter
        A reloaded
        A leaves
        B presses c
        B shows c on 2
        games begun 1""",
    'a second page gets the seat when the first is closed': """
        A enters anna
        A shows begun
        B enters anna
        C enters anna
        B leaves
        A leaves
        C shows begun""",
    'who quits reads that everything is saved and can come back': """
        A enters anna
        A shows begun
        A presses q
        B enters anna
        A shows Everything taught is saved.
        A presses enter
        A reloaded
        B shows begun""",
    'a game that cannot be started says why': """
        games fail The disk is full.
        A enters anna
        A shows The disk is full. Everything taught is saved.
        games fail
        A enters anna
        A shows begun""",
    'who finds no seat is shown the position and comes in when one is free': """
        A enters anna
        A shows begun
        B enters ben
        B shows begun
        C enters cleo
        C shows You are number 1 in line
        D enters dora
        D shows You are number 2 in line
        games are anna 1, ben 2
        A presses q
        C shows begun
        D shows You are number 1 in line
        games are ben 2, cleo 1""",
    'a place in line outlives its page for a while and lets others pass': """
        A enters anna
        A shows begun
        E enters emil
        E shows begun
        B enters ben
        B shows You are number 1 in line
        C enters cleo
        C shows You are number 2 in line
        B leaves
        C shows You are number 1 in line
        D enters ben
        C shows You are number 2 in line
        D shows You are number 1 in line
        D leaves
        A presses q
        games are emil 2, cleo 1
        games begun 3""",
}


@pytest.mark.parametrize('story', STORIES)
def test_a_story_of_seats(story: str) -> None:
    asyncio.run(tell(STORIES[story], LINGER if 'stays closed' in story else PATIENCE, 2))


def test_all_games_end_with_the_server_once_each_page_has_its_farewell() -> None:
    async def story() -> None:
        games, page = Games(), Page()
        seats = Seats('taxi', games, LINGER)
        seats.enter('anna', page)
        await until(lambda: bool(games.open))
        page.prompt.clear()
        closing = asyncio.create_task(seats.close('stopped'))
        await until(lambda: page.shown[0] == 'stopped')
        for _ in range(10):
            await asyncio.sleep(0)
        assert not closing.done()
        page.prompt.set()
        await closing

    asyncio.run(story())


GB = 10**9


@pytest.mark.parametrize(
    ('available', 'taken', 'games', 'fits'),
    [
        (0.1, (), 0, True),  # nobody plays: one may always try
        (3.0, (0.3,), 1, True),
        (1.3, (0.3,), 1, False),  # the second one needs 0.35, and 1 is spare
        (1.41, (0.3,), 1, True),
        (1.41, (0.1,), 1, False),  # the first one has yet to grow
        (2.0, (), 3, False),  # three are about to begin
        (2.6, (0.8, 0.3), 2, True),  # such a game may take 0.8
        (2.1, (0.8, 0.3), 2, False),
    ],
)
def test_games_are_let_in_while_the_memory_holds_them(
    available: float, taken: tuple[float, ...], games: int, fits: bool
) -> None:
    measured = [int(share * GB) for share in taken]
    assert has_room(int(available * GB), 16 * GB, measured, games) is fits


def test_who_does_not_agree_takes_no_seat_and_goes_where_the_study_says() -> None:
    async def story() -> None:
        async def arrive(seat: Seat) -> None:
            seat.show(message((), 'Do you agree?'), 1)
            answered = asyncio.Event()
            seat.listen(lambda keys, frame: answered.set())
            await answered.wait()
            if seat.participant == 'ben':
                seat.end('Nothing was saved.', 'https://panel.example/declined')

        games, pages = Games(), {code: Page() for code in ('anna', 'ben', 'cleo')}
        seats = Seats('taxi', games, PATIENCE, lambda count: count < 1, arrive=arrive)
        for code, page in pages.items():
            seats.enter(code, page)
            await until(lambda page=page: page.shown[0] == 'Do you agree?')
        assert games.opened == 0
        for page in pages.values():
            page.press(['y'], 1)
        await until(lambda: str(games) == 'anna 1')
        await until(lambda: 'number 1 in line' in pages['cleo'].shown[0])
        await until(lambda: pages['ben'].shown[0] == 'Nothing was saved.')
        pages['ben'].press(['enter'], 0)
        assert pages['ben'].left_to == 'https://panel.example/declined'
        await seats.close('stopped')
        assert games.opened == 1

    asyncio.run(story())
