"""Seats of participants: a game each, which outlives its page for a while and no longer."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from humanopts_teach.browser.seats import (
    another_fits,
    FAREWELL,
    GameError,
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

    def __init__(self) -> None:
        self.shown: tuple[str, int] = ('', 0)
        self.press: Press = lambda keys, frame: None
        self.reloaded = 0
        self.prompt = asyncio.Event()  # whether it takes at once what is shown
        self.prompt.set()

    def show(self, view: ScreenView, frame: int) -> None:
        """Keep the first line."""
        (line, *_) = view.panel.beside
        assert isinstance(line, Line)
        self.shown = line.text, frame

    def listen(self, press: Press) -> None:
        """Keep who is told what is pressed."""
        self.press = press

    def reload(self) -> None:
        """Count."""
        self.reloaded += 1

    async def taken(self) -> None:
        """Wait until it is prompt."""
        await self.prompt.wait()


class Games:
    """Games that show what was pressed, and how many there are."""

    def __init__(self) -> None:
        self.open: list[tuple[str, int]] = []
        self.opened = 0
        self.fault = ''

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
            seat.show(message((), f'{keys} on {frame}'), frame + 1)

        try:
            yield press
        finally:
            await asyncio.sleep(0)
            self.open.remove(place)


def run(
    story: Callable[[Seats, Games], Awaitable[None]],
    linger: float = PATIENCE,
    most: int = 9,
) -> None:
    """Tell a story with seats."""

    async def told() -> None:
        games = Games()
        seats = Seats('taxi', games, linger, lambda count: count < most)
        await story(seats, games)
        await seats.close('stopped')
        assert games.open == []

    asyncio.run(told())


async def until(condition: Callable[[], bool]) -> None:
    """Wait for something."""
    async with asyncio.timeout(PATIENCE):
        while not condition():
            await asyncio.sleep(0.001)


def test_a_page_that_stays_closed_ends_its_game_and_frees_its_place() -> None:
    async def story(seats: Seats, games: Games) -> None:
        anna, again, ben = Page(), Page(), Page()
        seats.enter('anna', anna)
        await until(lambda: bool(games.open))
        seats.leave('anna', anna)
        await until(lambda: not games.open)
        seats.enter('ben', ben)
        seats.enter('anna', again)
        await until(lambda: len(games.open) == 2)
        assert games.open == [('ben', 1), ('anna', 2)]

    run(story, LINGER)


def test_a_second_page_asks_before_it_takes_the_seat() -> None:
    async def story(seats: Seats, games: Games) -> None:
        first, second = Page(), Page()
        seats.enter('anna', first)
        await until(lambda: bool(games.open))
        seats.enter('anna', second)
        assert second.shown[0].startswith('anna teaches in another window just now.')
        second.press(['x'], 0)
        first.press(['a'], 1)
        assert first.shown == ("['a'] on 1", 2)
        second.press(['enter'], 0)
        assert first.shown[0] == 'The lesson goes on in another window.'
        assert second.shown == ("['a'] on 1", 2)
        first.press(['b'], 2)
        assert second.shown == ("['a'] on 1", 2)  # the first is heard no more
        first.press(['enter'], 0)
        assert first.reloaded == 1
        seats.leave('anna', first)
        second.press(['c'], 2)
        assert second.shown == ("['c'] on 2", 3)
        assert games.opened == 1

    run(story)


def test_a_second_page_gets_the_seat_when_the_first_is_closed() -> None:
    async def story(seats: Seats, games: Games) -> None:
        first, second, third = Page(), Page(), Page()
        seats.enter('anna', first)
        await until(lambda: bool(games.open))
        seats.enter('anna', second)
        seats.enter('anna', third)
        seats.leave('anna', second)
        seats.leave('anna', first)
        assert third.shown == ('begun', 1)

    run(story)


def test_who_quits_reads_that_everything_is_saved_and_can_come_back() -> None:
    async def story(seats: Seats, games: Games) -> None:
        page, again = Page(), Page()
        seats.enter('anna', page)
        await until(lambda: bool(games.open))
        page.press(['q'], 1)
        seats.enter('anna', again)  # before the first game is closed
        await until(lambda: games.opened == 2)
        await until(lambda: page.shown[0] == FAREWELL)
        page.press(['enter'], 0)
        assert page.reloaded == 1
        await until(lambda: again.shown == ('begun', 1))

    run(story)


def test_a_game_that_cannot_be_started_says_why() -> None:
    async def story(seats: Seats, games: Games) -> None:
        games.fault = 'The disk is full.'
        page = Page()
        seats.enter('anna', page)
        await until(lambda: page.shown[0] == f'The disk is full. {FAREWELL}')
        games.fault = ''
        seats.enter('anna', page)
        await until(lambda: page.shown == ('begun', 1))

    run(story)


def test_all_games_end_with_the_server_once_each_page_has_its_farewell() -> None:
    async def story(seats: Seats, games: Games) -> None:
        page = Page()
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

    run(story)


def test_who_finds_no_seat_is_told_the_position_and_comes_in_when_one_is_free() -> None:
    async def story(seats: Seats, games: Games) -> None:
        pages = {name: Page() for name in ('anna', 'ben', 'cleo', 'dora')}
        for name, page in pages.items():
            seats.enter(name, page)
            await until(lambda shown=page: shown.shown[0] == 'begun' or 'line' in shown.shown[0])
        for number, name in enumerate(('cleo', 'dora'), start=1):
            assert f'You are number {number} in line' in pages[name].shown[0]
        assert [who for who, _ in games.open] == ['anna', 'ben']
        pages['anna'].press(['q'], 1)
        await until(lambda: pages['cleo'].shown[0] == 'begun')
        await until(lambda: 'You are number 1 in line' in pages['dora'].shown[0])
        assert ('cleo', 1) in games.open

    run(story, most=2)


def test_a_place_in_line_outlives_its_page_for_a_while_and_lets_others_pass() -> None:
    async def story(seats: Seats, games: Games) -> None:
        pages = {name: Page() for name in ('anna', 'ben', 'cleo')}
        for name, page in pages.items():
            seats.enter(name, page)
            await until(lambda shown=page: shown.shown[0] == 'begun' or 'line' in shown.shown[0])
        seats.leave('ben', pages['ben'])
        await until(lambda: 'You are number 1 in line' in pages['cleo'].shown[0])
        again = Page()
        seats.enter('ben', again)  # loaded again
        await until(lambda: 'You are number 2 in line' in pages['cleo'].shown[0])
        assert 'You are number 1 in line' in again.shown[0]
        seats.leave('ben', again)
        pages['anna'].press(['q'], 1)
        await until(lambda: ('cleo', 1) in games.open)
        assert games.opened == 2

    run(story, most=1)


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
    assert another_fits(int(available * GB), 16 * GB, measured, games) is fits
