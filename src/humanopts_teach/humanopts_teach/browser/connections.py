"""
The connections of the pages' server: strangers cost little, and nobody blocks others.

A connection belongs to a stranger until the first line of its first request names the token.
Strangers are limited in number and time, and get a short answer without uvicorn.
"""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
import ipaddress
import re
import resource
from secrets import compare_digest
import socket
import time
from typing import Any

from humanopts_teach.browser.guard import NO_TOKEN
from starlette.types import ASGIApp
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_SECONDS = 10.0  # without a whole request
_MAX_STRANGERS = 512  # at once; fewer where few files may be open
_MAX_FILES = 4096  # that this process asks for
_MAX_LINE = 8192  # bytes
_MAX_MESSAGE = 100_000  # bytes that a page sends at once
_AT_ONCE = 16  # connections that are accepted before others get their turn
_QUEUE = 1024  # connections that the kernel keeps until then
_NAMED = re.compile(rb'[A-Z]+ /([^/? ]*)')  # a request, and the first part of its path
_ANSWER = (
    f'HTTP/1.1 {HTTPStatus.NOT_FOUND} {HTTPStatus.NOT_FOUND.phrase}\r\n'
    f'content-type: text/plain; charset=utf-8\r\ncontent-length: {len(NO_TOKEN)}\r\n'
    f'connection: close\r\n\r\n{NO_TOKEN}'
).encode()


class _Stranger(asyncio.Protocol):
    """A connection before its first line; far cheaper than uvicorn's, which replaces it."""

    def __init__(
        self,
        token: bytes,
        strangers: 'set[_Stranger]',
        max_strangers: int,
        admitted: Callable[[], H11Protocol],
    ) -> None:
        self._token, self._admitted = token, admitted
        self._strangers, self._max_strangers = strangers, max_strangers
        self._first = b''  # read so far
        self._since, self._network = time.monotonic(), ''
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Make room for it: end the oldest stranger of the network that has most."""
        self._transport = transport
        if (address := transport.get_extra_info('peername')) is not None:
            self._network = _network(address[0])
        self._strangers.add(self)
        if len(self._strangers) > self._max_strangers:
            most = Counter(each._network for each in self._strangers).most_common(1)[0][0]
            crowd = (each for each in self._strangers if each._network == most)
            min(crowd, key=lambda each: each._since).end()

    def data_received(self, data: bytes) -> None:
        """Answer, or hand the connection to uvicorn."""
        self._first += data
        line, end, _ = self._first.partition(b'\n')
        named = _NAMED.match(line)
        if end and named is not None and compare_digest(named[1], self._token):
            self._strangers.discard(self)
            protocol = self._admitted()
            self._transport.set_protocol(protocol)
            protocol.connection_made(self._transport)
            protocol.data_received(self._first)
        elif end or len(line) >= _MAX_LINE:
            self._transport.write(_ANSWER)
            self._transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        self._strangers.discard(self)

    def end_late(self) -> None:
        """End it if it has had its time."""
        if time.monotonic() - self._since > MAX_SECONDS:
            self.end()

    def end(self) -> None:
        """End it now."""
        self._strangers.discard(self)
        self._transport.abort()


class _Connection(H11Protocol):
    """A connection whose first request named the token."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._since = time.monotonic()
        super().connection_made(transport)

    def on_response_complete(self) -> None:
        """Count the time until the next request from now on."""
        self._since = time.monotonic()
        super().on_response_complete()

    def end_late(self) -> None:
        """End it without a request for long; a slow network may still take an answer."""
        idle = self.cycle is None or self.cycle.response_complete
        late = time.monotonic() - self._since > MAX_SECONDS
        if idle and late and not self.transport.get_write_buffer_size():
            self.transport.abort()


class Server(uvicorn.Server):
    """A server that ends late connections, and leaves signals to the command."""

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        stop: Callable[[], bool],
        close: Callable[[], Awaitable[None]],
    ) -> None:
        """
        Prepare to serve.

        :param token: first part of the path of every request.
        :param stop: returns whether to end.
        :param close: called before the end, while all pages are still connected.
        """
        self._stop, self._close = stop, close
        self._strangers: set[_Stranger] = set()
        most = min(_MAX_STRANGERS, _open_files() // 4)

        def arrived(**others: Any) -> _Stranger:
            admitted = partial(_Connection, **others)
            return _Stranger(token.encode(), self._strangers, most, admitted)

        settings = uvicorn.Config(
            app,
            http=arrived,  # type: ignore[arg-type]
            ws='wsproto',
            ws_max_size=_MAX_MESSAGE,
            backlog=_AT_ONCE,
            log_config=None,
            log_level='error',  # malformed requests are not logged
            proxy_headers=False,  # nothing here asks for addresses
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        super().__init__(settings)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield

    async def on_tick(self, counter: int) -> bool:
        """Look after the connections, ten times a second."""
        for each in (*self._strangers, *self.server_state.connections):
            if isinstance(each, _Stranger | _Connection):  # not a WebSocket
                each.end_late()
        if self._stop():
            await self._close()
            self.should_exit = True
        return await super().on_tick(counter)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept connections; the kernel keeps more of them than are accepted at once."""
        await super().startup(sockets)
        for each in sockets or ():
            each.listen(_QUEUE)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End all connections."""
        for each in list(self._strangers):
            each.end()
        await super().shutdown(sockets)


def _open_files() -> int:
    """Return how many files this process may have open, after asking for more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_FILES if hard == resource.RLIM_INFINITY else min(_MAX_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


def _network(host: str) -> str:
    """Return what one machine has: an address, or of IPv6 the first half of one."""
    address = ipaddress.ip_address(host.partition('%')[0])
    if address.version == 4:
        return host
    return str(address.ipv4_mapped or address.exploded[:19])
