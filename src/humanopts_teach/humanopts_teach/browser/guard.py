"""
Guards the pages: a client without the token reaches no part of NiceGUI.

The token is the first part of every path: of pages, of what they load, and of their sockets. A
stranger gets a short text, and no state is kept for one.
"""

from collections.abc import Collection
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


class Guard:
    """An ASGI application that forwards only requests that may see the pages."""

    def __init__(self, app: ASGIApp, token: str, hosts: Collection[str]) -> None:
        """
        Guard an application.

        :param token: first part of each path; safe in a URL.
        :param hosts: names by which browsers may call the machine, besides its own. They may use
            any address: no name server can make a browser send another one than it connects to.
        """
        self._app, self._token = app, token.encode()
        self._given = {host.lower() for host in hosts}
        here = socket.gethostname().lower()
        self._hosts = {*self._given, 'localhost', here, f'{here.partition(".")[0]}.local'}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or forward it."""
        if scope['type'] != 'lifespan':
            if reason := self._refusal(scope):
                await _refuse(scope, send, reason)
                return
            if scope['path'].count('/') == 1:  # else Starlette redirects, past any proxy's prefix
                scope = {**scope, 'path': f'{scope["path"]}/'}
        await self._app(scope, receive, send)

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
