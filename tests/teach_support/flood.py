"""
Strangers who flood a server: they know its address, and not the token.

As a program it takes the port and how many connections to keep open, prints a line once it has
opened each of them, and goes on until it is killed: what the server closes it opens again.
"""

import asyncio
from collections.abc import Callable
import json
import re
import subprocess
import sys
from typing import Any

PROMPT = '\x1b[2J\x1b[H[sudo] password for root: '  # no terminal may show it
_AGAIN = 2.0  # s until what was closed is opened again
_SOCKET = '/_nicegui_ws/socket.io/?EIO=4&transport='
_UPGRADE = (
    'Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
    'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n'
)
_SENT: tuple[str, ...] = (
    '',  # an idle connection
    'GET / HTTP/1.1\r\nHost: localhost\r\nX-Half',
    'POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\nslow',
    f'GET /{PROMPT}\r\n\r\n\0\xff' * 20,
    f'GET / HTTP/1.1\r\nHost: localhost\r\nX-Long: {"x" * 70_000}',
    'GET /favicon.ico HTTP/1.1\r\nHost: localhost\r\n\r\n' * 5,
    f'GET {_SOCKET}websocket HTTP/1.1\r\nHost: localhost\r\n{_UPGRADE}\r\n',
    'GET /nobody/anna HTTP/1.1\r\nHost: localhost\r\nUpgrade: h2c\r\nConnection: Upgrade\r\n\r\n',
)


async def _open_again(port: int, send: Callable[..., Any], opened: asyncio.Semaphore) -> None:
    while True:
        try:
            reader, writer = await asyncio.open_connection('127.0.0.1', port)
            opened.release()
            await send(port, reader, writer)
            while await reader.read(65536):
                pass
            writer.close()
        except OSError:
            pass
        await asyncio.sleep(_AGAIN)


def _sender(text: str) -> Callable[..., Any]:
    async def send(port: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(text.encode('latin-1'))
        await writer.drain()

    return send


async def _ask(port: int, method: str, path: str, body: str = '') -> str:
    reader, writer = await asyncio.open_connection('127.0.0.1', port)
    length = f'Host: localhost\r\nConnection: close\r\nContent-Length: {len(body)}\r\n'
    writer.write(f'{method} {path} HTTP/1.1\r\n{length}\r\n{body}'.encode('latin-1'))
    answer = await reader.read()
    writer.close()
    return answer.decode('latin-1')


async def _log(port: int, *_: object) -> None:
    """Send log events as the page of a stranger would, if there is one."""
    page = await _ask(port, 'GET', '/nobody')
    client = re.search(r"'client_id': '([^']*)'", page)
    opening = re.search(r'"sid":"([^"]*)"', await _ask(port, 'GET', f'{_SOCKET}polling'))
    if opening is None:
        return
    named = {'client_id': client.group(1) if client else 'x', 'level': 'error'}
    event = json.dumps(['log', {**named, 'message': PROMPT}])
    for body in ('40', f'42{event}', '42["event",5]', '42["ack",{}]'):
        await _ask(port, 'POST', f'{_SOCKET}polling&sid={opening.group(1)}', body)


async def _flood(port: int, count: int) -> None:
    senders = [*map(_sender, _SENT), _log]
    opened = asyncio.Semaphore(0)
    tasks = []
    for number in range(count):
        sender = senders[number % len(senders)]
        tasks.append(asyncio.create_task(_open_again(port, sender, opened)))
        await asyncio.sleep(0.0005)
    for _ in range(count):
        await opened.acquire()
    print('opened', flush=True)
    await asyncio.gather(*tasks)


class Flood:
    """The program, while a test goes on."""

    def __init__(self, port: int, count: int) -> None:
        command = [sys.executable, __file__, str(port), str(count)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def opened(self) -> None:
        """Wait until each connection was open once."""
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == 'opened\n'

    def close(self) -> None:
        """End it, and with it all of its connections."""
        self._process.kill()
        self._process.wait()


if __name__ == '__main__':
    asyncio.run(_flood(int(sys.argv[1]), int(sys.argv[2])))
