"""
Access control for the pages: a client without the token cannot reach NiceGUI.

The token is the first segment of every path: pages, resources and sockets. Other clients receive
a short page, and no state is kept for them.
"""

from collections.abc import Collection
from html import escape
import ipaddress
from secrets import compare_digest
import socket
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

_NO_NAME = (
    'The server does not accept this host name. Open the address that was printed where '
    'the game runs, or start it there with --allow-host and the name.'
)
_FOREIGN = 'Another site requested this page. Open the address of the page in a window.'


def short_page(text: str, language: str = 'en') -> str:
    """Return a page with only a text, which is escaped."""
    style = 'font: 1.1rem/1.5 system-ui, sans-serif; max-width: 40rem; margin: 10vh auto'
    text = escape(text)
    return (
        f'<!doctype html><html lang="{escape(language)}"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta name="color-scheme" content="light dark"><title>{text}</title></head>'
        f'<body style="{style}; padding: 0 1rem"><main><h1 style="font: inherit">{text}</h1>'
        '</main></body></html>'
    )


NO_TOKEN = short_page('This address is incomplete. Open the full address that you were given.')


class Guard:
    """An ASGI application that forwards only authorised requests."""

    def __init__(self, app: ASGIApp, token: str, hosts: Collection[str]) -> None:
        """
        Guard an application.

        :param token: first segment of each path; URL-safe.
        :param hosts: additional host names that browsers may use. IP addresses are always
            accepted: DNS rebinding cannot make a browser send another address in the header.
        """
        self._app, self._token = app, token.encode()
        self._given = {host.lower() for host in hosts}
        here = socket.gethostname().lower()
        self._hosts = {*self._given, 'localhost', here, f'{here.partition(".")[0]}.local'}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject a request or forward it."""
        if scope['type'] == 'lifespan':
            await self._app(scope, receive, send)
            return
        if reason := self._refusal(scope):
            await _refuse(scope, send, reason)
            return
        if scope['path'].count('/') == 1:  # Starlette's redirect would drop a proxy's prefix
            scope = {**scope, 'path': f'{scope["path"]}/'}
        first = [await receive()]
        if first[0]['type'].endswith('.disconnect'):
            return  # the client has left already; engine.io would fail

        async def received() -> Message:
            return first.pop() if first else await receive()

        await self._app(scope, received, send)

    def _refusal(self, scope: Scope) -> str:
        """Return a page that says why a request is rejected; empty: it is accepted."""
        given = [*scope['raw_path'].split(b'/', 2), b''][1]
        if not (scope['raw_path'].startswith(b'/') and compare_digest(given, self._token)):
            return NO_TOKEN
        hosts = [v.decode('latin-1').lower() for name, v in scope['headers'] if name == b'host']
        if len(hosts) != 1 or not self._knows(_host(f'//{hosts[0]}')):
            return short_page(_NO_NAME)
        for name, value in scope['headers']:
            origin = value.decode('latin-1').lower()
            same = origin.partition('://')[2] == hosts[0] or _host(origin) in self._given
            if name == b'origin' and not same:
                return short_page(_FOREIGN)
        return ''

    def _knows(self, host: str) -> bool:
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return host.removesuffix('.') in self._hosts
        return True


def _host(url: str) -> str:
    """Return the host name or address in a URL; empty: none."""
    try:
        return urlsplit(url).hostname or ''
    except ValueError:
        return ''


async def _refuse(scope: Scope, send: Send, reason: str) -> None:
    """Respond with a page and close the connection without reading further data."""
    kind = 'http' if scope['type'] == 'http' else 'websocket.http'  # a uvicorn extension
    body = reason.encode()
    headers = [
        (b'content-type', b'text/html; charset=utf-8'),
        (b'content-length', str(len(body)).encode()),
        (b'connection', b'close'),
    ]
    await send({'type': f'{kind}.response.start', 'status': 404, 'headers': headers})
    await send({'type': f'{kind}.response.body', 'body': body})
