"""The NiceGUI pages: a sign-in page for the participant's code, and a page for each seat."""

import asyncio
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import partial
from html import escape
from http import HTTPStatus
import json
import socket
from typing import Any, get_args

from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse
from humanopts_ros.limits import shown
from humanopts_teach.browser.connections import Server
from humanopts_teach.browser.guard import Guard, short_page
from humanopts_teach.browser.markup import head_html, PARTS, parts
from humanopts_teach.browser.seats import message, Press, prompt, Seats, Window
from humanopts_teach.browser.server_log import limited_log
from humanopts_teach.browser.speech import changes
from humanopts_teach.dialogue.app import App, MAX_TYPED
from humanopts_teach.dialogue.entry import TextScreen
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.panel import ScreenView
from humanopts_teach.language import languages, N_, speaking, spoken, translated
from humanopts_teach.lesson.store import CODE
from nicegui import app as pages
from nicegui import Client, core, ui
from nicegui.language import Language

_RECONNECTING = 10.0  # s, time to keep a disconnected page
_ANSWER = 1.0  # s, timeout for a page to answer
_MAX_COLUMN = 200  # characters
_HEADERS = {'browser': 'user-agent', 'language': 'accept-language'}  # by field of the event
_SIZE = 'return [innerWidth, innerHeight]'


class AddressError(Exception):
    """The address of a page is invalid; the message says why."""


@dataclass(frozen=True)
class Entrance:
    """
    Settings of the sign-in.

    :ivar proposed: default code.
    :ivar language: language of the pages, as in ``speaking``, unless the address has another.
    :ivar code: URL parameter with the participant's code; empty: none.
    :ivar columns: URL parameters to record.
    :ivar new_code: function that returns a code to assign; None: codes are not assigned.
    """

    proposed: str = ''
    language: str = ''
    code: str = ''
    columns: tuple[str, ...] = ()
    new_code: Callable[[], str] | None = None

    def language_of(self, request: Request) -> str:
        """
        Return the language of a page.

        :raises AddressError: the language is unknown.
        """
        given = request.query_params.get('lang', '')
        if given and given not in languages():
            known = ', '.join(languages())
            raise AddressError(N_(f'The address has an unknown language; choose from {known}.'))
        return given or self.language

    def columns_of(self, request: Request) -> dict[str, str]:
        """
        Return the recorded parameters in the address of a page.

        :raises AddressError: a value is too long, or not printable.
        """
        found = {name: request.query_params.get(name, '') for name in self.columns}
        for name, value in found.items():
            if len(value) > _MAX_COLUMN or not value.isprintable():
                raise AddressError(N_(f'The value of {name} in the address cannot be used.'))
        return {name: value for name, value in found.items() if value}


class PageWindow(Window):
    """A page that shows frames and forwards key presses."""

    def __init__(self, entrance: Entrance, request: Request) -> None:
        """
        Create the elements of the current page.

        :raises AddressError: the address of the page is invalid.
        """
        self.language = entrance.language_of(request)
        self._columns = entrance.columns_of(request)
        self._query = f'?{request.url.query}' if request.url.query else ''
        self._press: Press = lambda keys, frame: None
        self._client = ui.context.client
        self._client.page = copy(self._client.page)  # for this window only
        self._client.page.language = _quasar_language(self.language)
        ui.add_head_html(head_html())
        self._parts = {name: ui.html('', sanitize=False).classes(name) for name in PARTS}
        self._parts['said'].props('role=status')
        self._heard = ui.html('', sanitize=False).classes('heard').props('role=status')
        self._view: ScreenView | None = None  # view that is shown
        self._frame = ui.html('0', sanitize=False).classes('frame')
        ui.on('press', self._on_press)

    def show(self, view: ScreenView, frame: int) -> None:
        """Show a frame, updating only the parts that changed."""
        for name, html in parts(view).items():
            if self._parts[name].content != html:
                self._parts[name].set_content(html)
        self._frame.set_content(str(frame))
        if heard := changes(view, self._view):
            again = '\N{NO-BREAK SPACE}' * (frame % 2)  # so that equal texts are announced, too
            self._heard.set_content(escape(heard) + again)
        self._view = view

    def listen(self, press: Press) -> None:
        self._press = press

    def reload(self) -> None:
        self._client.run_javascript('location.reload()')

    def leave_to(self, url: str) -> None:
        self._client.run_javascript(f'location.assign({json.dumps(url)})')

    async def client(self) -> Mapping[str, Any]:
        headers = self._client.request.headers
        found: dict[str, Any] = {'columns': self._columns}
        found |= {name: headers.get(key, '')[:_MAX_COLUMN] for name, key in _HEADERS.items()}
        with suppress(TimeoutError):
            async with asyncio.timeout(_ANSWER):
                match await self._client.run_javascript(_SIZE, timeout=_ANSWER):
                    case [int(width), int(height)]:
                        found |= {'width': width, 'height': height}
        return found

    async def taken(self) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(_ANSWER):
                await self._client.run_javascript('0', timeout=_ANSWER)

    def go_to(self, path: str) -> None:
        """Open another page below the token, with the same parameters."""
        self._client.open(path + self._query)

    def _on_press(self, event: Any) -> None:
        """Forward valid key presses, as sent by ``page.js``."""
        given = event.args if isinstance(event.args, dict) else {}
        keys, frame = given.get('keys'), given.get('frame')
        if isinstance(keys, list) and len(keys) <= MAX_TYPED and isinstance(frame, int):
            self._press([key for key in keys if isinstance(key, str) and len(key) <= 9], frame)


def add_pages(seats: Seats, entrance: Entrance) -> None:
    """Define the pages."""

    @ui.page('/')
    def who(request: Request, client: Client) -> HTMLResponse | None:
        code = request.query_params.get(entrance.code) if entrance.code else None
        if code is not None:
            return seat(code, request, client)
        try:
            window = PageWindow(entrance, request)
        except AddressError as error:
            return _refusal(str(error), entrance.language)
        if 'assign' in request.query_params and entrance.new_code is not None:
            window.go_to(f'/{entrance.new_code()}')
        else:
            _ask_code(window, seats.domain, entrance.proposed)
        return None

    @ui.page('/{participant}')
    def lesson(participant: str, request: Request, client: Client) -> HTMLResponse | None:
        return seat(participant, request, client)

    def seat(participant: str, request: Request, client: Client) -> HTMLResponse | None:
        try:
            if not CODE.fullmatch(participant):
                raise AddressError(_not_a_code(participant))
            window = PageWindow(entrance, request)
        except AddressError as error:
            return _refusal(str(error), entrance.language)
        if similar := seats.similar(participant):
            text = N_(f'{similar} is known here. Are you {similar}? If not, use another code.')
            head, enter = ('humanopts', seats.domain), N_(f'continue as {similar}')
            asked = message(head, text, enter, window.language)
            prompt(window, asked, lambda: window.go_to(f'/{similar}'))
            return None

        def leave() -> None:
            if not client.has_socket_connection:  # a new one may open before the old one closes
                seats.leave(participant, window)

        client.on_connect(lambda: seats.enter(participant, window))
        client.on_disconnect(leave)
        return None

    @pages.exception_handler(404)
    def missing(*_: Any) -> HTMLResponse:
        return _refusal(N_('There is no such page. Check the address.'), entrance.language)


def _not_a_code(text: str) -> str:
    given = shown(text)
    return N_(f'{given!r} is not a valid code: use at most 60 letters, digits, - and _')


def _refusal(text: str, language: str) -> HTMLResponse:
    """Return a page with one sentence, for an invalid address."""
    with speaking(language):
        return HTMLResponse(short_page(translated(text), spoken()), HTTPStatus.NOT_FOUND)


def _quasar_language(language: str) -> Any:
    """Return NiceGUI's tag for a language; English if there is none."""
    with speaking(language):
        tag = spoken()
    known = get_args(Language)
    return next((each for each in (tag, tag.partition('-')[0]) if each in known), 'en-US')


def _ask_code(window: PageWindow, domain: str, proposed: str) -> None:
    """Ask for the participant's code and open the page of the seat."""

    def go(code: str, app: App) -> None:
        if CODE.fullmatch(code):
            window.go_to(f'/{code}')
        else:
            app.say(_not_a_code(code), bad=True)

    screen: TextScreen = opening(proposed)
    screen.submit = go
    app = App(screen)
    app.language = window.language

    def show() -> None:
        with speaking(app.language):
            panel = screen.panel(app)
        said, head = app.message, ('humanopts', domain)
        window.show(ScreenView(head, panel, said, language=app.language), app.drawn())

    def press(keys: list[str], frame: int) -> None:
        app.type([key for key in keys if len(key) == 1 or key in ('ctrl-u', 'enter')], frame)
        app.advance(0.0)
        if keys:
            show()

    window.listen(press)
    show()


async def serve(
    seats: Seats,
    listening: socket.socket,
    token: str,
    entrance: Entrance,
    stop: Callable[[], bool],
    hosts: Collection[str] = (),
) -> None:
    """
    Serve the pages until ``stop`` returns True, then end all games.

    :param listening: socket that browsers connect to.
    :param token: first segment of every path; required for all requests.
    :param hosts: additional host names that browsers may use for this machine.
    """
    add_pages(seats, entrance)
    web = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    ui.run_with(
        web,
        title='humanopts',
        dark=None,
        tailwind=False,
        mount_path=f'/{token}',
        reconnect_timeout=_RECONNECTING,
        show_welcome_message=False,
        viewport='width=device-width, initial-scale=1, viewport-fit=cover',
    )
    core.sio.on('log', lambda *_: None)  # pages must not write to the terminal
    farewell = N_('The game was stopped on the machine that runs it. Everything taught is saved.')
    server = Server(Guard(web, token, hosts), token, stop, partial(seats.close, farewell))
    with limited_log():
        await server.serve(sockets=[listening])
