"""
Guards the pages: a client without the token reaches no part of NiceGUI.

The token is the first part of every path: of pages, of what they load, and of their sockets. A
stranger gets a short text, and no state is kept for one.
"""

from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
import ipaddress
from secrets import compare_digest
import socket
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Receive, Scope, Send

NO_TOKEN = 'This address is not complete. Open the one that was printed where the game runs.\n'
_NO_NAME = (
    'The server does not know this name of its machine. Open the address that was printed where '
    'the game runs, or start it there with --allow-host and the name.\n'
)
_FOREIGN = 'A page of another site has asked for this one. Open its address in a window.\n'
_PREFIX = b'x-forwarded-prefix'  # what NiceGUI puts before each path that it writes into a page


class Guard:
    """An ASGI application before another one, for which it acts as a reverse proxy."""

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        hosts: Collection[str],
        admitted: Callable[[Scope], AbstractContextManager[None]],
    ) -> None:
        """
        Guard an application.

        :param token: first part of each path; safe in a URL.
        :param hosts: names by which browsers may call the machine, besides its own. They may use
            any address: no name server can make a browser send another one than it connects to.
        :param admitted: held while a request is answered that has the token.
        """
        self._app, self._token, self._admitted = app, token.encode(), admitted
        self._given = {host.lower() for host in hosts}
        here = socket.gethostname().lower()
        self._hosts = {*self._given, 'localhost', here, f'{here.partition(".")[0]}.local'}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a stranger, or hand the request on without the token."""
        if scope['type'] == 'lifespan':
            await self._app(scope, receive, send)
            return
        if reason := self._refusal(scope):
            await _refuse(scope, send, reason)
            return
        headers, length = scope['headers'], 1 + len(self._token)
        before = b''.join(value for name, value in headers if name == _PREFIX)
        inner = {
            **scope,
            'path': scope['path'][length:] or '/',
            'raw_path': scope['raw_path'][length:] or b'/',
            'headers': [
                *(header for header in headers if header[0] != _PREFIX),
                (_PREFIX, before + b'/' + self._token),
            ],
        }
        with self._admitted(scope):
            await self._app(inner, receive, send)

    def _refusal(self, scope: Scope) -> str:
        """Return why a request is refused; empty: it is not."""
        given = [*scope['raw_path'].split(b'/', 2), b''][1]
        if not (scope['raw_path'].startswith(b'/') and compare_digest(given, self._token)):
            return NO_TOKEN
        hosts = [v.decode('latin-1').lower() for name, v in scope['headers'] if name == b'host']
        if len(hosts) != 1 or not self._knows(_host(f'//{hosts[0]}')):
            return _NO_NAME
        for name, value in scope['headers']:
            origin = value.decode('latin-1').lower()
            same = origin.partition('://')[2] == hosts[0] or _host(origin) in self._given
            if name == b'origin' and not same:
                return _FOREIGN
        return ''

    def _knows(self, host: str) -> bool:
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return host.removesuffix('.') in self._hosts
        return True


def _host(url: str) -> str:
    """Return the name or the address in a URL; empty: there is none."""
    try:
        return urlsplit(url).hostname or ''
    except ValueError:
        return ''


async def _refuse(scope: Scope, send: Send, reason: str) -> None:
    """Answer with a text, and end the connection: what else it sends is not read."""
    kind = 'http' if scope['type'] == 'http' else 'websocket.http'  # uvicorn has this extension
    body = reason.encode()
    headers = [
        (b'content-type', b'text/plain; charset=utf-8'),
        (b'content-length', str(len(body)).encode()),
        (b'connection', b'close'),
    ]
    await send({'type': f'{kind}.response.start', 'status': 404, 'headers': headers})
    await send({'type': f'{kind}.response.body', 'body': body})
