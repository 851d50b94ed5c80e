"""
The connections of the page server: unauthenticated ones are cheap and cannot block others.

A connection is a stranger until the first line of its first request contains the token.
Strangers are limited in number and time, and receive a short response without uvicorn.
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

MAX_SECONDS = 10.0  # maximum time without a complete request
_MAX_STRANGERS = 512  # maximum number of strangers; lower if few files may be open
_MAX_FILES = 4096  # number of open files that this process requests
_MAX_LINE = 8192  # bytes
_MAX_MESSAGE = 100_000  # bytes, maximum size of a WebSocket message
_AT_ONCE = 16  # number of connections accepted per iteration of the event loop
_QUEUE = 1024  # length of the kernel's queue of pending connections
_NAMED = re.compile(rb'[A-Z]+ /([^/? ]*)')  # a request, and the first segment of its path
_ANSWER = (
    f'HTTP/1.1 {HTTPStatus.NOT_FOUND} {HTTPStatus.NOT_FOUND.phrase}\r\n'
    f'content-type: text/html; charset=utf-8\r\ncontent-length: {len(NO_TOKEN)}\r\n'
    f'connection: close\r\n\r\n{NO_TOKEN}'
).encode()


class _Stranger(asyncio.Protocol):
    """A connection before its first line, far cheaper than the uvicorn one that replaces it."""

    def __init__(
        self,
        token: bytes,
        strangers: 'set[_Stranger]',
        max_strangers: int,
        admitted: Callable[[], H11Protocol],
    ) -> None:
        self._token, self._admitted = token, admitted
        self._strangers, self._max_strangers = strangers, max_strangers
        self._first = b''  # bytes read so far
        self._since, self._network = time.monotonic(), ''
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register the connection; if full, drop the oldest one of the most frequent network."""
        self._transport = transport
        if (address := transport.get_extra_info('peername')) is not None:
            self._network = _network(address[0])
        self._strangers.add(self)
        if len(self._strangers) > self._max_strangers:
            most = Counter(each._network for each in self._strangers).most_common(1)[0][0]
            crowd = (each for each in self._strangers if each._network == most)
            min(crowd, key=lambda each: each._since).end()

    def data_received(self, data: bytes) -> None:
        """Respond, or hand the connection over to uvicorn."""
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
        """Abort the connection if it has exceeded its time limit."""
        if time.monotonic() - self._since > MAX_SECONDS:
            self.end()

    def end(self) -> None:
        """Abort the connection immediately."""
        self._strangers.discard(self)
        self._transport.abort()


class _Connection(H11Protocol):
    """A connection that presented the token in its first request."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._since = time.monotonic()
        super().connection_made(transport)

    def on_response_complete(self) -> None:
        """Restart the timeout for the next request."""
        self._since = time.monotonic()
        super().on_response_complete()

    def end_late(self) -> None:
        """Abort an idle connection after a timeout, but not while a response is being sent."""
        idle = self.cycle is None or self.cycle.response_complete
        late = time.monotonic() - self._since > MAX_SECONDS
        if idle and late and not self.transport.get_write_buffer_size():
            self.transport.abort()


class Server(uvicorn.Server):
    """A server that times out connections and leaves signal handling to the command."""

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        stop: Callable[[], bool],
        close: Callable[[], Awaitable[None]],
    ) -> None:
        """
        Prepare to serve.

        :param token: first segment of the path of every request.
        :param stop: function that returns whether to shut down.
        :param close: called before shutdown, while all pages are still connected.
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
            proxy_headers=False,  # client addresses are not used
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        super().__init__(settings)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture no signals."""
        yield

    async def on_tick(self, counter: int) -> bool:
        """Check all connections for timeouts, ten times per second."""
        for each in (*self._strangers, *self.server_state.connections):
            if isinstance(each, _Stranger | _Connection):  # not a WebSocket
                each.end_late()
        if self._stop():
            await self._close()
            self.should_exit = True
        return await super().on_tick(counter)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept connections; the kernel queues more than are accepted per iteration."""
        await super().startup(sockets)
        for each in sockets or ():
            each.listen(_QUEUE)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close all connections."""
        for each in list(self._strangers):
            each.end()
        await super().shutdown(sockets)


def _open_files() -> int:
    """Raise the limit of open files and return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_FILES if hard == resource.RLIM_INFINITY else min(_MAX_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


def _network(host: str) -> str:
    """Return the network of a host: an IPv4 address, or the first half of an IPv6 address."""
    address = ipaddress.ip_address(host.partition('%')[0])
    if address.version == 4:
        return host
    return str(address.ipv4_mapped or address.exploded[:19])
