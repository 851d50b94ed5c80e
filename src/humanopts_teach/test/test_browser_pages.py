"""Pages as a browser gets them over loopback: who is let in, what is shown, what is pressed."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
import gc
from pathlib import Path
import re
import socket
import statistics
import struct
import threading
import time
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import urlopen

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_teach.browser import connections
from humanopts_teach.browser.pages import Entrance, serve
from humanopts_teach.browser.seats import Press, Seat, Seats
from humanopts_teach.dialogue.app import App, MAX_KEYS
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.view import view
from humanopts_teach.lesson.requests import LessonView, Phase
import pytest
from teach_support.flood import Flood, PROMPT
from teach_support.page_client import PageClient

TOKEN = 'a-token'
ENTRANCE = Entrance('p1', '', 'PROLIFIC_PID', ('STUDY_ID',), lambda: 'a1b2c3')
NASTY = '<img src=x onerror=alert(1)>'
PATIENCE = 10.0  # s
UPGRADE = (
    'Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
    'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n'
)
STRANGERS = 2000
FLOODED = 3.0  # s


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
        if keys:
            seat.show(view(app), app.drawn())

    seat.show(view(app), app.drawn())
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
        seats = Seats('taxi', game, linger=PATIENCE)
        await serve(seats, listening, TOKEN, ENTRANCE, stop.is_set, ['lab.example'])

    thread = threading.Thread(target=asyncio.run, args=(serving(),))
    thread.start()
    yield f'http://127.0.0.1:{listening.getsockname()[1]}'
    stop.set()
    thread.join()


def ask(address: str, path: str, host: str = 'localhost', more: str = '') -> str:
    """Return all that the server answers before it closes the connection."""
    port = int(address.rpartition(':')[2])
    with socket.create_connection(('127.0.0.1', port), timeout=PATIENCE) as connection:
        asked = f'GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: close\r\n{more}\r\n'
        connection.sendall(asked.replace('PORT', str(port)).encode())
        return b''.join(iter(lambda: connection.recv(65536), b'')).decode()


@pytest.mark.parametrize(
    'path',
    [
        *('/', '/wrong', '/wrong/anna', f'/{TOKEN}x/anna', f'//{TOKEN}', f'/x/../{TOKEN}'),
        *('/favicon.ico', '/_nicegui_ws/socket.io/?EIO=4&transport=polling', '/%ff%00'),
        *(f'/?token={TOKEN}', f'http://localhost/{TOKEN}', f'/{TOKEN[:-1]}%6e'),
    ],
)
@pytest.mark.parametrize('more', ['', UPGRADE], ids=['page', 'socket'])
def test_a_stranger_gets_a_short_page_and_no_client(address: str, path: str, more: str) -> None:
    from nicegui import Client

    before = set(Client.instances)
    head, _, body = ask(address, path, more=more).partition('\r\n\r\n')
    assert re.match(r'HTTP/1.1 404 ', head), head
    assert 'text/html' in head
    assert 'cookie' not in head.lower()
    assert '<h1' in body
    assert 'This address is incomplete.' in body
    assert set(Client.instances) <= before


@pytest.mark.parametrize('more', ['', UPGRADE], ids=['page', 'socket'])
@pytest.mark.parametrize(
    ('host', 'origin', 'words'),
    [
        ('localhost', '', ''),
        ('127.0.0.1', 'http://127.0.0.1:PORT', ''),
        ('[::1]', '', ''),
        ('192.168.7.8', 'http://192.168.7.8:PORT', ''),
        (socket.gethostname(), '', ''),
        ('lab.example', 'https://lab.example', ''),  # through a proxy
        ('localhost', 'https://LAB.example', ''),
        ('rebound.example', '', 'does not accept this host name'),
        ('localhost.rebound.example', '', 'does not accept this host name'),
        ('localhost@rebound.example', '', 'does not accept this host name'),
        ('[', '', 'does not accept this host name'),
        ('localhost', 'http://rebound.example', 'Another site'),
        ('localhost', 'http://localhost:1', 'Another site'),
        ('localhost', 'http://localhost:PORT.rebound.example', 'Another site'),
        ('localhost', 'null', 'Another site'),
        ('localhost', 'http://[', 'Another site'),
    ],
)
def test_host_and_origin_are_those_of_the_page(
    address: str, host: str, origin: str, words: str, more: str
) -> None:
    path = f'/{TOKEN}/_nicegui_ws/socket.io/?EIO=5' if more else f'/{TOKEN}'
    given = f'Origin: {origin}\r\n' if origin else ''
    answer = ask(address, path, host, more + given)
    if words:
        assert answer.startswith('HTTP/1.1 404 ')
        assert words in answer
    elif more:  # engine.io itself refuses such a version
        assert answer.startswith('HTTP/1.1 403 ')
    else:
        assert answer.startswith('HTTP/1.1 200 ')


def test_nothing_is_asked_of_another_server(address: str) -> None:
    with PageClient(address, f'/{TOKEN}') as browser:
        links = re.findall(r'(?:src|href)="([^"]+)"', browser.page)
        assert links
        assert [link for link in links if '//' in link] == []


def test_a_code_leads_to_its_seat_and_one_that_differs_only_in_case_is_asked_about(
    address: str,
) -> None:
    with PageClient(address, f'/{TOKEN}') as browser, PageClient(address, f'/{TOKEN}/GIL') as page:
        assert 'Who is teaching?' in browser.shows('panel')
        browser.press('ctrl-u', *NASTY, 'enter')
        browser.until('said', '&lt;img')
        assert browser.opened == []
        browser.press('ctrl-u', *'anna', 'enter')
        browser.wait(lambda: browser.opened == [f'/{TOKEN}/anna'], 'the page of the seat')
        page.until('panel', 'Which?')
        with PageClient(address, f'/{TOKEN}/gil') as other:
            other.until('panel', 'GIL is known here. Are you GIL?')
            other.press('enter')
            other.wait(lambda: other.opened == [f'/{TOKEN}/GIL'], 'the page of the seat')


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
            page.until('said', name)


@pytest.mark.parametrize(
    'given',
    [{'keys': (5, None, {}), 'frame': 1}, {'keys': ('enter',) * (MAX_KEYS + 1)}, {'frame': 'x'}],
)
def test_what_no_page_sends_is_ignored(address: str, given: dict[str, Any]) -> None:
    with PageClient(address, f'/{TOKEN}/emil') as browser:
        browser.until('panel', 'Which?')
        browser.press(*given.get('keys', ('enter',)), frame=given.get('frame'))
        browser.press('2')
        browser.until('said', 'is picked')
        assert 'one is picked' not in browser.shows('said')


def test_what_a_page_logs_does_not_reach_the_terminal(
    address: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with PageClient(address, f'/{TOKEN}/hal') as page:
        page.until('panel', 'Which?')
        for level in ('error', 'warning', 'x\n'):
            named = {'client_id': page.query['client_id'], 'level': level, 'message': PROMPT}
            page.socket.emit('log', named)
        page.socket.emit('event', {'client_id': page.query['client_id'], 'id': PROMPT})
        page.socket.emit(PROMPT, PROMPT)
        with suppress(HTTPError):
            urlopen(f'{address}/{TOKEN}/{quote(PROMPT)}/x')
        page.press('2')
        page.until('said', 'is picked')
    output = ''.join(capfd.readouterr())
    assert '\x1b' not in output
    assert not any(line.startswith('[sudo]') for line in output.splitlines())


def test_connections_that_are_lost_leave_nothing_on_the_terminal(
    address: str, capfd: pytest.CaptureFixture[str]
) -> None:
    port = int(address.rpartition(':')[2])
    polling = f'/{TOKEN}/_nicegui_ws/socket.io/?EIO=4&transport=polling'
    head = 'HTTP/1.1\r\nHost: localhost\r\n'
    for sent in (
        f'POST {polling} {head}Content-Length: 9\r\n\r\n',  # the body is never sent
        f'GET {polling} {head}\r\n',
        f'GET {polling.replace("polling", "websocket")} {head}{UPGRADE}\r\n',
        f'GET /{TOKEN}/leo {head}\r\n',
    ):
        with socket.create_connection(('127.0.0.1', port), PATIENCE) as connection:
            connection.sendall(sent.encode())
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack('ii', 1, 0))
    page = PageClient(address, f'/{TOKEN}/lou')
    page.until('panel', 'Which?')
    page.socket.eio.ws.sock.setsockopt(
        socket.SOL_SOCKET, socket.SO_LINGER, struct.pack('ii', 1, 0)
    )
    page.socket.eio.ws.shutdown()
    with PageClient(address, f'/{TOKEN}/lou') as page:
        page.until('panel', 'Which?')
        page.press('1')
        page.until('said', 'one is picked')
    gc.collect()  # tasks that were forgotten would be reported
    assert capfd.readouterr().err == ''


def test_two_people_teach_while_strangers_keep_2000_connections_open(
    address: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with PageClient(address, f'/{TOKEN}/ida') as ida, PageClient(address, f'/{TOKEN}/jo') as jo:
        flood = Flood(int(address.rpartition(':')[2]), STRANGERS)
        try:
            flood.opened()
            waits = []
            end = time.monotonic() + FLOODED
            while time.monotonic() < end:
                for page in (ida, jo):
                    for key, name in (('1', '>one is'), ('2', '&lt;img')):
                        pressed = time.monotonic()
                        page.press(key)
                        page.until('said', name)
                        waits.append(time.monotonic() - pressed)
            with PageClient(address, f'/{TOKEN}/kim') as kim:  # comes in meanwhile
                kim.until('panel', 'Which?')
            assert ida.socket.connected
            assert jo.socket.connected
            open_files = len(list(Path('/proc/self/fd').iterdir()))
        finally:
            flood.close()
    output = ''.join(capfd.readouterr())
    print(f'{len(waits)} keys: median {statistics.median(waits):.3f} s, last {max(waits):.3f} s')
    assert statistics.median(waits) < 0.1
    assert max(waits) < 2.0
    assert open_files < 1000
    assert len(output) < 100_000
    assert '\x1b' not in output


def test_a_connection_without_a_whole_request_ends(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, 'MAX_SECONDS', 0.5)
    port = int(address.rpartition(':')[2])
    begun = f'POST /{TOKEN} HTTP/1.1\r\nHost: localhost\r\nContent-Le'
    sent = ('', 'GET /', f'GET /{TOKEN}', 'GET / HTTP/1.1\r\nHo', begun, f'GET /{"x" * 9000}')
    opened = [socket.create_connection(('127.0.0.1', port), PATIENCE / 2) for _ in sent]
    for connection, text in zip(opened, sent):
        connection.sendall(text.encode())
    for connection in opened:
        with connection, suppress(ConnectionError):
            while connection.recv(65536):
                pass


def test_each_request_of_a_connection_names_the_token(address: str) -> None:
    port = int(address.rpartition(':')[2])
    asked = 'GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n'
    with socket.create_connection(('127.0.0.1', port), timeout=PATIENCE) as connection:
        connection.sendall((asked.format(f'{TOKEN}/a%20b') + asked.format('wrong')).encode())
        answers = b''.join(iter(lambda: connection.recv(65536), b'')).decode()
    assert answers.count('HTTP/1.1 404 ') == 2
    assert 'is not a valid code' in answers
    assert 'This address is incomplete.' in answers


def test_a_page_has_its_farewell_before_the_server_is_gone(
    address: str, stop: threading.Event
) -> None:
    with PageClient(address, f'/{TOKEN}/gus') as page:
        page.until('panel', 'Which?')
        stop.set()
        page.until(
            'panel',
            'The game was stopped on the machine that runs it. Everything taught is saved.',
        )
