"""
The connections of the pages' server: strangers cost little, and nobody blocks others.

A connection belongs to a stranger until the first line of its first request names the token.
Strangers are limited in number and time, and get a short answer instead of uvicorn's.
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
_BACKLOG = 256  # connections that wait to be accepted
_NAMED = re.compile(rb'[A-Z]+ /([^/? ]*)')  # a request, and the first part of its path
_ANSWER = (
    f'HTTP/1.1 {HTTPStatus.NOT_FOUND} {HTTPStatus.NOT_FOUND.phrase}\r\n'
    f'content-type: text/plain; charset=utf-8\r\ncontent-length: {len(NO_TOKEN)}\r\n'
    f'connection: close\r\n\r\n{NO_TOKEN}'
).encode()


class _Connection(H11Protocol):
    """A connection of uvicorn, which a stranger cannot use."""

    def __init__(self, token: bytes, max_strangers: int, **others: Any) -> None:
        super().__init__(**others)
        self._token, self._max_strangers = token, max_strangers
        self._first = b''  # read so far, of a stranger
        self._known, self._since, self._network = False, time.monotonic(), ''

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for it: end the oldest stranger of the network that has most."""
        super().connection_made(transport)
        self._network = _network(self.client[0]) if self.client is not None else ''
        if len(self.connections) <= self._max_strangers:
            return
        strangers = [c for c in self.connections if isinstance(c, _Connection) and not c._known]
        if len(strangers) > self._max_strangers:
            most = Counter(each._network for each in strangers).most_common(1)[0][0]
            crowd = (each for each in strangers if each._network == most)
            min(crowd, key=lambda each: each._since)._abort()

    def data_received(self, data: bytes) -> None:
        """Answer a stranger, or hand everything to uvicorn."""
        if self._known:
            super().data_received(data)
            return
        self._first += data
        line, end, _ = self._first.partition(b'\n')
        named = _NAMED.match(line)
        if end and named is not None and compare_digest(named[1], self._token):
            self._known = True
            super().data_received(self._first)
        elif end or len(line) >= _MAX_LINE:
            self.transport.write(_ANSWER)
            self.transport.close()

    def on_response_complete(self) -> None:
        """Count the time until the next request from now on."""
        self._since = time.monotonic()
        super().on_response_complete()

    def end_late(self) -> None:
        """End it if it has had its time for a request; a slow network may still take an answer."""
        idle = self.cycle is None or self.cycle.response_complete
        late = time.monotonic() - self._since > MAX_SECONDS
        if idle and late and not self.transport.get_write_buffer_size():
            self._abort()

    def _abort(self) -> None:
        self.connections.discard(self)
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
        max_strangers = min(_MAX_STRANGERS, _open_files() // 4)
        settings = uvicorn.Config(
            app,
            http=partial(_Connection, token.encode(), max_strangers),  # type: ignore[arg-type]
            ws='wsproto',
            ws_max_size=_MAX_MESSAGE,
            backlog=_BACKLOG,
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
        for each in list(self.server_state.connections):
            if isinstance(each, _Connection):
                each.end_late()
        if self._stop():
            await self._close()
            self.should_exit = True
        return await super().on_tick(counter)


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
