"""
The connections of the pages' server: those that have not shown the token are few, and end soon.

So whatever strangers open, there are descriptors and time for those who teach.
"""

import asyncio
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
import ipaddress
import resource
import socket
import time

from starlette.types import ASGIApp, Scope
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

_MAX_SECONDS = 10.0  # that a connection has for a whole request
_MAX_STRANGERS = 512  # that are open at once; fewer where few files may be open
_MAX_FILES = 4096  # that this process asks for
_AT_ONCE = 16  # connections that are accepted before others get their turn
_QUEUE = 1024  # connections that the kernel keeps until then
_MAX_MESSAGE = 100_000  # bytes that a page sends at once
_KEY = 'transport'  # in the state of a request


class Strangers:
    """The open connections that have shown no token, or nothing since their last request."""

    def __init__(self) -> None:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = _MAX_FILES if hard == resource.RLIM_INFINITY else min(_MAX_FILES, hard)
        if soft != resource.RLIM_INFINITY and soft < wanted:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        self._most = min(_MAX_STRANGERS, wanted // 4)
        self._open: dict[asyncio.Transport, tuple[str, float]] = {}  # address, since when (s)

    def add(self, transport: asyncio.Transport) -> None:
        """Note a connection; where there are too many, one of whoever has most of them ends."""
        if len(self._open) >= self._most:
            self._forget_closed()
        while len(self._open) >= self._most:
            counts = Counter(network for network, _ in self._open.values())
            ((most, _),) = counts.most_common(1)
            self._end(next(t for t, (network, _) in self._open.items() if network == most))
        self._open[transport] = _network(transport), time.monotonic()

    def _forget_closed(self) -> None:
        self._open = {t: kept for t, kept in self._open.items() if not t.is_closing()}

    def _end(self, transport: asyncio.Transport) -> None:
        del self._open[transport]
        if not transport.get_write_buffer_size():  # else a slow network has yet to take a page
            transport.abort()

    def end_old(self) -> None:
        """End the connections that have had their time."""
        self._forget_closed()
        oldest = time.monotonic() - _MAX_SECONDS
        for transport in [t for t, (_, since) in self._open.items() if since < oldest]:
            self._end(transport)

    @contextmanager
    def admitted(self, scope: Scope) -> Iterator[None]:
        """Keep the connection of a request, whatever comes, until it is answered."""
        transport = scope['state'][_KEY]
        self._open.pop(transport, None)
        try:
            yield
        finally:
            if not transport.is_closing():
                self.add(transport)


def protocol(strangers: Strangers) -> type[H11Protocol]:
    """Return what reads requests, of limited size, and notes each connection."""

    class Connection(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.app_state = {**self.app_state, _KEY: transport}
            strangers.add(transport)

    return Connection


class Server(uvicorn.Server):
    """A server that leaves signals to the command, and accepts a few connections at a time."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take none."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; asyncio accepts as many at once as it is told that the kernel may keep."""
        await super().startup(sockets)
        for listening in sockets or []:
            listening.listen(_QUEUE)


def settings(app: ASGIApp, strangers: Strangers) -> uvicorn.Config:
    """Return the settings of a server whose connections are noted."""
    return uvicorn.Config(
        app,
        http=protocol(strangers),
        ws='wsproto',
        ws_max_size=_MAX_MESSAGE,
        backlog=_AT_ONCE,
        log_config=None,
        log_level='error',  # what strangers send is not worth a line
        proxy_headers=False,  # nothing here asks for addresses; anybody could forge them
        server_header=False,
        timeout_graceful_shutdown=1,
    )


def _network(transport: asyncio.Transport) -> str:
    """Return what one machine has: an address, or of IPv6 the first half of one."""
    address = ipaddress.ip_address(transport.get_extra_info('peername')[0].partition('%')[0])
    if address.version == 4:
        return str(address)
    return str(address.ipv4_mapped or address.exploded[:19])
