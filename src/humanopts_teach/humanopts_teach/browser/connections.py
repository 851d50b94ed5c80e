"""
The connections of the pages' server: a stranger costs next to nothing, and none keeps another out.

A gate accepts connections, and reads the first line of each. Those whose path begins with the
token go to uvicorn; the others get a short answer, or end when their time is over or others come.
"""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
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
from starlette.types import ASGIApp, Scope
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

_MAX_SECONDS = 10.0  # that a connection has for a whole request
_MAX_STRANGERS = 512  # that are open at once; fewer where few files may be open
_MAX_FILES = 4096  # that this process asks for
_MAX_LINE = 8192  # bytes
_MAX_MESSAGE = 100_000  # bytes that a page sends at once
_AT_ONCE = 16  # connections that are accepted before others get their turn
_QUEUE = 1024  # connections that the kernel keeps until then
_PAUSE = 0.1  # s without accepting, where there are no descriptors
_KEY = 'transport'  # in the state of a request
_NAMED = re.compile(rb'[A-Z]+ /([^/? ]*)')  # a request, and the first part of its path
_ANSWER = (
    f'HTTP/1.1 {HTTPStatus.NOT_FOUND} {HTTPStatus.NOT_FOUND.phrase}\r\n'
    f'content-type: text/plain; charset=utf-8\r\ncontent-length: {len(NO_TOKEN)}\r\n'
    f'connection: close\r\n\r\n{NO_TOKEN}'
).encode()


@dataclass
class _Stranger:
    """
    A connection that has not shown the token.

    :ivar since: when it came, s.
    :ivar first: what it has sent.
    """

    since: float
    first: bytearray = field(default_factory=bytearray)


class Gate:
    """Accepts connections, and hands on those that name the token."""

    def __init__(self, listening: socket.socket, token: str, server: 'Server') -> None:
        """Begin to accept; the event loop runs."""
        self._listening, self._token, self._server = listening, token.encode(), server
        self._most = min(_MAX_STRANGERS, _files() // 4)
        self._strangers: dict[str, dict[socket.socket, _Stranger]] = {}  # by network, oldest first
        self._loop = asyncio.get_running_loop()
        self._handing: set[asyncio.Task[Any]] = set()
        listening.setblocking(False)
        listening.listen(_QUEUE)
        self._listen()

    def _listen(self) -> None:
        if self._listening.fileno() >= 0:  # it is not closed
            self._loop.add_reader(self._listening, self._accept)

    def close(self) -> None:
        """Accept no more, and end all strangers."""
        self._loop.remove_reader(self._listening)
        self._listening.close()
        self._end_older(float('inf'))

    def end_old(self) -> None:
        """End the strangers that have had their time."""
        self._end_older(time.monotonic() - _MAX_SECONDS)

    def _end_older(self, oldest: float) -> None:
        for network, connections in list(self._strangers.items()):
            for connection in [c for c, s in connections.items() if s.since < oldest]:
                self._end(network, connection)

    def _accept(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                connection, address = self._listening.accept()
            except (BlockingIOError, ConnectionError):
                return
            except OSError:  # there are no descriptors
                self._make_room()
                self._loop.remove_reader(self._listening)
                self._loop.call_later(_PAUSE, self._listen)
                return
            connection.setblocking(False)
            if sum(map(len, self._strangers.values())) >= self._most:
                self._make_room()
            network = _network(address[0])
            self._strangers.setdefault(network, {})[connection] = _Stranger(time.monotonic())
            self._loop.add_reader(connection, self._read, network, connection)

    def _make_room(self) -> None:
        """End the oldest stranger of the network that has most."""
        if self._strangers:
            network, connections = max(self._strangers.items(), key=lambda item: len(item[1]))
            self._end(network, next(iter(connections)))

    def _read(self, network: str, connection: socket.socket) -> None:
        """Take what a stranger sends until the first line is whole."""
        first = self._strangers[network][connection].first
        try:
            sent = connection.recv(_MAX_LINE)
        except BlockingIOError:
            return
        except OSError:
            sent = b''
        first += sent
        line, end, _ = first.partition(b'\n')
        if sent and not end and len(first) < _MAX_LINE:
            return
        named = _NAMED.match(line)
        if end and named is not None and compare_digest(named[1], self._token):
            self._forget(network, connection)
            task = self._loop.create_task(self._server.take(connection, bytes(first)))
            self._handing.add(task)
            task.add_done_callback(self._handing.discard)
            return
        with suppress(OSError):
            connection.send(_ANSWER)
        self._end(network, connection)

    def _forget(self, network: str, connection: socket.socket) -> None:
        self._loop.remove_reader(connection)
        del self._strangers[network][connection]
        if not self._strangers[network]:
            del self._strangers[network]

    def _end(self, network: str, connection: socket.socket) -> None:
        self._forget(network, connection)
        connection.close()


class Idle:
    """The connections of people that have no request under way."""

    def __init__(self) -> None:
        self._since: dict[asyncio.Transport, float] = {}

    def add(self, transport: asyncio.Transport) -> None:
        """Note that a connection may begin with a request."""
        self._since[transport] = time.monotonic()

    def end_old(self) -> None:
        """End those that have had their time: a phone may have gone in the middle of a request."""
        oldest = time.monotonic() - _MAX_SECONDS
        for transport, since in list(self._since.items()):
            if transport.is_closing():
                del self._since[transport]
            # else a slow network has yet to take a page
            elif since < oldest and not transport.get_write_buffer_size():
                transport.abort()

    @contextmanager
    def admitted(self, scope: Scope) -> Iterator[None]:
        """Keep the connection of a request until it is answered."""
        transport = scope['state'][_KEY]
        self._since.pop(transport, None)
        try:
            yield
        finally:
            self.add(transport)


class _Connection(H11Protocol):
    """Reads requests, of limited size."""

    def __init__(self, idle: Idle, first: bytes, **others: Any) -> None:
        super().__init__(**others)
        self._idle, self._first = idle, first

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.app_state = {**self.app_state, _KEY: transport}
        self._idle.add(transport)
        self.data_received(self._first)


class Server(uvicorn.Server):
    """A server to which a gate hands connections; it leaves signals to the command."""

    def __init__(self, app: ASGIApp, idle: Idle) -> None:
        """Have no connections."""
        self._idle = idle
        settings = uvicorn.Config(
            app,
            ws='wsproto',
            ws_max_size=_MAX_MESSAGE,
            log_config=None,
            log_level='error',  # malformed requests are not logged
            proxy_headers=False,  # nothing here asks for addresses
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        super().__init__(settings)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take none."""
        yield

    async def take(self, connection: socket.socket, first: bytes) -> None:
        """
        Serve a connection.

        :param first: what has been read from it.
        """
        others = {
            'config': self.config,
            'server_state': self.server_state,
            'app_state': self.lifespan.state,
        }
        made = partial(_Connection, self._idle, first, **others)
        await asyncio.get_running_loop().connect_accepted_socket(made, connection)


def _files() -> int:
    """Return how many files this process may have open, after it has asked for more."""
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
