"""Pages as a browser gets them over loopback: who is let in, what is shown, what is pressed."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
import re
import socket
import threading
import time
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_teach.browser.seats import Press, Seat, Seats
from humanopts_teach.dialogue.app import App, MOST_KEYS
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.panel import view
from humanopts_teach.lesson.requests import LessonView, Phase
import pytest
from teach_support.page_client import PageClient

TOKEN = 'a-token'
NASTY = '<img src=x onerror=alert(1)>'
PATIENCE = 10.0  # s


@asynccontextmanager
async def game(seat: Seat) -> AsyncIterator[Press]:
    """Keep a dialogue with one list, whose items say that they were picked."""

    def picked(name: str) -> Callable[[App], None]:
        return lambda app: app.say(f'{name} is picked')

    items = [Item(name, '', picked(name)) for name in ('one', NASTY)]
    app = App(ListScreen('Which?', items))
    app.world.domain = make_domain('taxi')
    app.world.game = Transition(episode=1, state='taxi 2,3 passenger R destination B')
    app.world.lesson = LessonView(Phase.NO_OPTION)

    def press(keys: list[str], frame: int) -> None:
        app.type(keys, frame)
        app.advance(0.0)
        seat.show(view(app), app.drawn())

    press([], 0)
    yield press


@pytest.fixture(scope='module')
def stop() -> threading.Event:
    """Ends the server, once for all tests."""
    return threading.Event()


@pytest.fixture(scope='module')
def address(stop: threading.Event) -> Iterator[str]:
    """Pages that are served meanwhile."""
    listening = socket.create_server(('127.0.0.1', 0))

    async def serving() -> None:
        from humanopts_teach.browser.pages import serve  # NiceGUI is slow to import

        seats = Seats('taxi', game, linger=PATIENCE)
        await serve(seats, listening, TOKEN, 'p1', stop.is_set)

    thread = threading.Thread(target=asyncio.run, args=(serving(),))
    thread.start()
    yield f'http://127.0.0.1:{listening.getsockname()[1]}'
    stop.set()
    thread.join()


@pytest.mark.parametrize(
    'path', ['/wrong', '/wrong/anna', f'/{TOKEN}x/anna', f'/{TOKEN}/a%20b', '/']
)
def test_without_the_token_and_a_code_there_is_no_page(address: str, path: str) -> None:
    with pytest.raises(HTTPError, match='404') as error:
        urlopen(f'{address}{path}')
    assert 'parseElements' not in error.value.read().decode() or path == '/'


def test_nothing_is_asked_of_another_server(address: str) -> None:
    with PageClient(address, f'/{TOKEN}') as browser:
        links = re.findall(r'(?:src|href)="([^"]+)"', browser.page)
        assert links
        assert [link for link in links if '//' in link] == []


def test_a_code_leads_to_the_page_of_its_seat(address: str) -> None:
    with PageClient(address, f'/{TOKEN}') as browser:
        assert 'Who teaches?' in browser.shows('panel')
        browser.press('ctrl-u', *NASTY, 'enter')
        browser.until('said', '&lt;img')
        assert browser.opened == []
        browser.press('ctrl-u', *'anna', 'enter')
        deadline = time.monotonic() + PATIENCE
        while not browser.opened and time.monotonic() < deadline:
            time.sleep(0.005)
        assert browser.opened == [f'/{TOKEN}/anna']


def test_two_participants_and_one_who_loads_the_page_again(address: str) -> None:
    with PageClient(address, f'/{TOKEN}/ben') as ben:
        with PageClient(address, f'/{TOKEN}/cleo') as cleo:
            cleo.until('panel', 'Which?')
            cleo.press('enter')
            cleo.until('said', 'one is picked')
        with PageClient(address, f'/{TOKEN}/cleo') as cleo:
            cleo.until('said', 'one is picked')
            cleo.press('2')
            cleo.until('said', '&lt;img')
            assert NASTY not in cleo.shows('panel') + cleo.shows('said')
        ben.until('panel', 'Which?')
        assert 'picked' not in ben.shows('said')


def test_a_connection_that_is_noticed_late_to_be_gone_takes_nothing_from_the_new_one(
    address: str,
) -> None:
    with PageClient(address, f'/{TOKEN}/fay') as page:
        page.until('panel', 'Which?')
        before, page.socket = page.socket, page.connect()
        before.disconnect()
        for name, key in (('one', '1'), ('&lt;img', '2'), ('one', '1')):
            page.press(key)
            page.until('said', f'{name}')


def test_a_second_page_of_a_participant_asks_first(address: str) -> None:
    with PageClient(address, f'/{TOKEN}/dora') as first:
        first.until('panel', 'Which?')
        with PageClient(address, f'/{TOKEN}/dora') as second:
            second.until('panel', 'dora teaches in another window just now')
            second.press('enter')
            second.until('panel', 'Which?')
            first.until('panel', 'The lesson goes on in another window')


@pytest.mark.parametrize(
    'given',
    [{'keys': (5, None, {}), 'frame': 1}, {'keys': ('enter',) * (MOST_KEYS + 1)}, {'frame': 'x'}],
)
def test_what_no_page_sends_is_ignored(address: str, given: dict[str, Any]) -> None:
    with PageClient(address, f'/{TOKEN}/emil') as browser:
        browser.until('panel', 'Which?')
        browser.press(*given.get('keys', ('enter',)), frame=given.get('frame'))
        browser.press('2')
        browser.until('said', 'is picked')
        assert 'one is picked' not in browser.shows('said')


def test_a_page_has_its_farewell_before_the_server_is_gone(
    address: str, stop: threading.Event
) -> None:
    with PageClient(address, f'/{TOKEN}/gus') as page:
        page.until('panel', 'Which?')
        stop.set()
        page.until('panel', 'The game was stopped where it runs. Everything taught is saved.')
