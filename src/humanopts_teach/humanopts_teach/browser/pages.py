"""The NiceGUI pages: a sign-in page for the participant's code, and a page for each seat."""

import asyncio
from collections.abc import Callable, Collection
from contextlib import suppress
from copy import copy
from functools import partial
from html import escape
import socket
from typing import Any

from fastapi import FastAPI
from fastapi.responses import HTMLResponse
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
from humanopts_teach.lesson.store import CODE, CODE_RULE
from nicegui import app as pages
from nicegui import Client, core, ui

_RECONNECTING = 10.0  # s, time to keep a disconnected page
_ANSWER = 1.0  # s, timeout for a page to confirm the last frame


class PageWindow(Window):
    """A page that shows frames and forwards key presses."""

    def __init__(self) -> None:
        """Create the elements of the current page."""
        self._press: Press = lambda keys, frame: None
        self._client = ui.context.client
        self._client.page = copy(self._client.page)  # of this window alone
        self._client.page.language = 'en-US'
        ui.add_head_html(head_html())
        self._parts = {name: ui.html('', sanitize=False).classes(name) for name in PARTS}
        self._parts['said'].props('role=status')
        self._heard = ui.html('', sanitize=False).classes('heard').props('role=status')
        self._view: ScreenView | None = None  # that is shown
        self._frame = ui.html('0', sanitize=False).classes('frame')
        ui.on('press', self._on_press)

    def show(self, view: ScreenView, frame: int) -> None:
        """Show a frame, updating only the parts that changed."""
        for name, html in parts(view).items():
            if self._parts[name].content != html:
                self._parts[name].set_content(html)
        self._frame.set_content(str(frame))
        if heard := changes(self._view, view):
            again = '\N{NO-BREAK SPACE}' * (frame % 2)  # equal texts are announced, too
            self._heard.set_content(escape(heard) + again)
        self._view = view

    def listen(self, press: Press) -> None:
        self._press = press

    def reload(self) -> None:
        self._client.run_javascript('location.reload()')

    async def taken(self) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(_ANSWER):
                await self._client.run_javascript('0', timeout=_ANSWER)

    def go_to(self, path: str) -> None:
        """Open another page below the token."""
        self._client.open(path)

    def _on_press(self, event: Any) -> None:
        """Forward valid key presses, as sent by ``page.js``."""
        given = event.args if isinstance(event.args, dict) else {}
        keys, frame = given.get('keys'), given.get('frame')
        if isinstance(keys, list) and len(keys) <= MAX_TYPED and isinstance(frame, int):
            self._press([key for key in keys if isinstance(key, str) and len(key) <= 9], frame)


def add_pages(seats: Seats, proposed: str) -> None:
    """
    Define the pages.

    :param proposed: default participant code.
    """

    @ui.page('/')
    def who() -> None:
        _ask_code(PageWindow(), seats.domain, proposed)

    @ui.page('/{participant}')
    def lesson(participant: str, client: Client) -> HTMLResponse | None:
        if not CODE.fullmatch(participant):
            return HTMLResponse(short_page(f'{participant} is not a code: {CODE_RULE}.'), 404)
        window = PageWindow()
        if similar := seats.similar(participant):
            text = (
                f'{similar} is known here. Are you {similar}? If not, go back: give another code.'
            )
            asked = message(('humanopts', seats.domain), text, f'go on as {similar}')
            prompt(window, asked, lambda: window.go_to(f'/{similar}'))
            return None

        def leave() -> None:
            if not client.has_socket_connection:  # a new one may open before the old one closes
                seats.leave(participant, window)

        client.on_connect(lambda: seats.enter(participant, window))
        client.on_disconnect(leave)
        return None


@pages.exception_handler(404)
def _not_found(*_: Any) -> HTMLResponse:
    return HTMLResponse(short_page('There is no such page. Check the address.'), 404)


def _ask_code(window: PageWindow, domain: str, proposed: str) -> None:
    """Ask for the participant's code and open the page of the seat."""

    def go(code: str, app: App) -> None:
        if CODE.fullmatch(code):
            window.go_to(f'/{code}')
        else:
            app.say(f'{code!r} is not a code: {CODE_RULE}.', bad=True)

    screen: TextScreen = opening(proposed)
    screen.submit = go
    app = App(screen)

    def show() -> None:
        head = 'humanopts', domain
        window.show(ScreenView(head, screen.panel(app), app.message), app.drawn())

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
    proposed: str,
    stop: Callable[[], bool],
    hosts: Collection[str] = (),
) -> None:
    """
    Serve the pages until ``stop`` returns True, then end all games.

    :param listening: socket that browsers connect to.
    :param token: first segment of every path; required for all requests.
    :param hosts: additional host names that browsers may use for this machine.
    """
    add_pages(seats, proposed)
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
    farewell = 'The game was stopped where it runs. Everything taught is saved.'
    server = Server(Guard(web, token, hosts), token, stop, partial(seats.close, farewell))
    with limited_log():
        await server.serve(sockets=[listening])
